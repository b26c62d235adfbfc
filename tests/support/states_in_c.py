"""Libraries of models whose elements have states: their whole paths and streams."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.mechanics.signatures import INVERSION
from flexgen.runtime.inversion.path_inversion import Inverter
from flexgen.runtime.library import Library

GEARS = {"q1": "element.upper.dof.q1.gear", "q2": "element.fore.dof.q2.gear"}  # of elbow
HORIZON = 20  # intervals of a stream


def functions_of(model: flexgen.RobotModel) -> list[str]:
    return [name for name in INVERSION if name != "inversion_jacobians" or model.n_e]


def library_of(model: flexgen.RobotModel) -> Library:
    return library_with(model, functions_of(model), ("invert", "stream"))


def path_of(
    model: flexgen.RobotModel, period: float, still: int = 0
) -> tuple[Any, list[np.ndarray]]:
    """A move and samples of its output with two derivatives, between ``still`` ones at rest."""
    move = flexgen.plan(model)
    t = np.clip(
        (np.arange(round(move.duration / period) + 1 + 2 * still) - still) * period,
        0.0,
        move.duration,
    )
    y, dy, ddy = (np.ascontiguousarray(x) for x in move.sample(t).y.transpose(2, 0, 1)[:3])
    inside = ((t > 0.0) & (t < move.duration))[:, None]
    return move, [y, dy * inside, ddy * inside]


def difference(one: Any, other: Any, leave: int = 8) -> float:
    """Largest relative difference of the motors' motion and torques, but for the last samples,
    held differently.
    """
    pairs = [(getattr(one, name), getattr(other, name)) for name in ("q_m", "v_m", "tau_m")]
    return max(float(np.abs(a - b)[:-leave].max() / np.abs(b).max()) for a, b in pairs)


def inverted(
    model: flexgen.RobotModel, monkeypatch: pytest.MonkeyPatch
) -> tuple[flexgen.Solution, Any, dict]:
    """The solution with the motors in Python, and how `solve` calls the C for the arm."""
    calls = []
    own = Inverter.__call__
    with monkeypatch.context() as patch:
        patch.setattr(
            Inverter,
            "__call__",
            lambda self, *x, **named: (calls.append((x, named)), own(self, *x, **named))[1],
        )
        solution = flexgen.solve(model, verify=False, progress=False)
    return solution, *calls[-1]


def streamed(
    library: Library, samples: list[np.ndarray], q_start: np.ndarray, period: float, **options: Any
) -> np.ndarray:
    """Motor torques of a stream at the samples."""
    y, dy, ddy = samples
    stream = library.stream(y[0], q_start, period=period, intervals=HORIZON, **options)
    found = [stream.update(y[k], dy[k], ddy[k]) for k in range(1, len(y))]
    assert all(each.converged for each in found[HORIZON:])
    return np.concatenate([each.tau_m for each in found])[HORIZON - 1 :]


def stream_errors(model: flexgen.RobotModel, library: Library) -> float:
    """Largest difference of the torques of a stream to those of the whole path, relative."""
    move, samples = path_of(model, 1e-3, still=2 * HORIZON)
    whole = library.invert(*samples, period=1e-3, q_start=move.q_start).tau_m
    torques = streamed(library, samples, move.q_start, 1e-3)
    return float(np.abs(torques - whole[: len(torques)]).max() / np.abs(whole).max())
