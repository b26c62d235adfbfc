"""The controllers that come with the benchmarks, and the table of their scores."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.registry import extension, own_names
from flexgen.feedback.loop.controller_files import is_system
from flexgen.feedback.loop.controllers import Cascade, Linear
from flexgen.feedback.loop.gains import PID, PPI
from flexgen.feedback.loop.interface import Controller
from flexgen.feedback.loop.model_law import LinearDesign, ModelLaw
from flexgen.feedback.loop.named_controllers import FeedforwardOnly, controller_of
from flexgen.feedback.loop.python_files import LIBRARIES, is_python
from flexgen.studies.scenarios.foreign import ForeignController
from flexgen.studies.scenarios.scenario import Scenario
from flexgen.studies.scenarios.scenario_file import FOLDER

OURS = (PPI, PID, Cascade, Linear, FeedforwardOnly, ModelLaw)


def find_shipped_controllers(scenario: str, version: int = 2) -> dict[str, Path]:
    """The files of the controllers that come with a benchmark, by name; those for later versions
    replace the first.
    """
    found: dict[str, Path] = {}
    for path in sorted((FOLDER / "controllers").glob(f"{scenario}-*.toml")):
        name = path.stem.removeprefix(f"{scenario}-")
        head, _, rest = name.partition("-")
        number, name = (int(head), rest) if head.isdecimal() else (1, name)
        if number <= version and (name not in found or number > 1):
            found[name] = path
    return found


def controller_names(chosen: Scenario, given: Sequence[str]) -> list[str]:
    """The controllers of a scenario that are given; ``"all"`` is the reference and those that come
    with it.
    """
    shipped = ["reference", *find_shipped_controllers(chosen.name, chosen.version)]
    return [one for name in given for one in (shipped if name == "all" else [name])]


def scenario_controller(
    given: Any, chosen: Scenario, motion: Sequence[np.ndarray]
) -> tuple[Controller, str]:
    """A controller for a scenario, and its name; see `flexgen.score`. Code of others comes as a
    `ForeignController`.

    ``given``: ``"reference"``, the name of one shipped with the scenario, a file, or a controller;
    ``motion``: the scenario's planned motion, for models of controllers.
    """
    title = ""
    if isinstance(given, str) and given == "reference":
        title = given
        given = chosen.reference
    if isinstance(given, str):
        files = find_shipped_controllers(chosen.name, chosen.version)
        if given in files:
            title = given
            given = files[given]
        elif "." not in given:
            known = ", ".join(["reference", *files])
            raise ArgumentError(
                f"controller: given {given!r}, expected one of {known}, a file .toml, .py "
                "(file.py:Class) or a shared library"
            )
    if is_foreign(given):
        made = ForeignController(given)
        return made, made.name
    built, name = controller_of(given, chosen.model, chosen.sample_s, chosen.delay_s, motion)
    if type(built) not in (Cascade, Linear, FeedforwardOnly):
        raise ArgumentError(
            f"controller: given {name}, expected one that regulates without the planned motion: "
            "PPI, PID, LQG, LoopShaping, Cascade, Linear, a file or an object with reset() and "
            "step(k, y, ref)"
        )
    return built, title or name


def is_foreign(given: Any) -> bool:
    """Whether a controller is third-party code: a Python file, a shared library, or an object with
    its own method ``step``.
    """
    if isinstance(given, (str, Path)):
        return is_python(str(given)) or str(given).endswith(LIBRARIES)
    if isinstance(given, LinearDesign):
        return not isinstance(given, tuple(extension("laws", name) for name in own_names("laws")))
    return not isinstance(given, OURS) and not is_system(given)
