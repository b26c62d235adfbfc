"""The controller of a name, a file or an object."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.registry import extension, names
from flexgen.feedback.loop.controller_files import file_controller, is_system, system_controller
from flexgen.feedback.loop.controllers import Cascade, Linear
from flexgen.feedback.loop.gains import PID, PPI, lowest_locked_hz
from flexgen.feedback.loop.interface import Compiled, Controller, PlugIn, PythonController, Setup
from flexgen.feedback.loop.model_law import LinearDesign, ModelLaw
from flexgen.model.elements import RobotModel
from flexgen.model.position_servo.filters import Notch

CUT = 1e-3
"""Part of a frequency by which it must be lower to count as cut."""

BUILT_IN = ("ppi", "ppi_notch", "none")


class FeedforwardOnly:
    """No feedback."""

    def compiled(self, setup: Setup) -> Compiled:
        """A linear controller without gain."""
        n_y = setup.n_y
        n_m = setup.n_m
        return Linear(
            np.zeros((0, 0)), np.zeros((0, n_y)), np.zeros((n_m, 0)), np.zeros((n_m, n_y))
        ).compiled(setup)


def controller_of(
    given: Any,
    model: RobotModel,
    sample_time: float,
    delay: float,
    motion: Sequence[np.ndarray],
    samples: int = 1,
) -> tuple[Controller, str]:
    """A controller from what `flexgen.control` takes, and its name.

    Parameters
    ----------
    given : str, Path or object
    model : RobotModel
    sample_time, delay : float [s]
    motion : sequence of arrays (parts, ...)
        ``q_a v_a a_a q_m v_m a_m tau_m`` in the parts of the motion.
    samples : int
        Of each part.

    Raises
    ------
    ArgumentError
        There is no such controller, or it does not fit the model.
    BuildError
        A shared library cannot be loaded.
    """
    late = sample_time + delay
    name = type(given).__name__
    if isinstance(given, str | Path):
        given, name = _find_controller(str(given), model, [x[:1] for x in motion])
    if isinstance(given, PPI):
        begin = [x[:1] for x in motion]
        title = _ppi_name(given, model, late, begin) if name in ("PPI", "ppi") else name
        return given.cascade(model, late, begin), title
    if isinstance(given, LinearDesign):
        return given.linear(model, sample_time, delay, motion, samples), given.title
    if isinstance(given, PID):
        return given.cascade(), name
    if isinstance(given, ModelLaw):
        return given, name
    if isinstance(given, Cascade | Linear | PlugIn | PythonController | FeedforwardOnly):
        return given, name
    if is_system(given):
        return system_controller(given, sample_time), "state space"
    return PythonController(given), name


def _ppi_name(ppi: PPI, model: RobotModel, late_s: float, motion: Sequence[np.ndarray]) -> str:
    """The name with the frequencies in use [Hz], and with the speed bandwidth asked for where it
    was cut because of ``late_s``, sample time and delay [s].
    """
    asked = ppi.frequencies(model, motion)
    used = ppi.speeds_in_use(model, late_s, motion)
    shown = {key: f"{value:.3g}" for key, value in asked.items()}
    cut = used < (1.0 - CUT) * asked["speed_hz"]
    if cut.any():
        ends = f"{used.min():.3g}", f"{used.max():.3g}"
        shown["speed_hz"] = ends[0] if ends[0] == ends[1] else " to ".join(ends)
    title = f"ppi {'/'.join(shown.values())} Hz"
    if not cut.any():
        return title
    return (
        f"{title} (position/speed/integral; speed cut from {asked['speed_hz']:.3g} Hz, because "
        f"sample time and delay are {1e3 * late_s:.3g} ms)"
    )


def _find_controller(
    text: str, model: RobotModel, motion: Sequence[np.ndarray]
) -> tuple[Any, str]:
    """The controller that a text names, and its name in tables: a built-in one, a law of the
    registry with default numbers, or a file.

    The frequency of a notch is the lowest one of the arm with held motors at the first point of
    ``motion``.
    """
    if text == "none":
        return FeedforwardOnly(), "feedforward only"
    if text == "ppi":
        return PPI(), "ppi"
    if text == "ppi_notch":
        lowest = lowest_locked_hz(model, motion)
        if not lowest:
            raise ArgumentError(
                f"controller: the model {model.name} has no elasticity, so no notch frequency; "
                "use ppi"
            )
        notch = Notch(lowest, 0.3, 0.9)
        return PPI(filters=(notch,)), f"ppi with a notch at {notch.frequency_hz:.3g} Hz"
    if text in names("laws"):
        return _default_law(text), text
    found = file_controller(text)
    if found is None:
        known = ", ".join((*BUILT_IN, *names("laws")))
        raise ArgumentError(
            f"controller: given {text!r}, expected one of {known}, a file .toml, .py "
            "(file.py:Class), a shared library, or an object with reset() and step(k, y, ref)"
        )
    return found, Path(text).name


def _default_law(name: str) -> Any:
    """A registered law with its default parameters."""
    law = extension("laws", name)
    try:
        return law()
    except TypeError as error:
        raise ArgumentError(
            f"controller: given {name!r}, which cannot be made without parameters ({error}); "
            f"give a file .toml with "
            f'type = "{name}"'
        ) from error
