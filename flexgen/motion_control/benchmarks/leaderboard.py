"""The controllers that come with the benchmarks, and the table of their scores."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.errors import ArgumentError
from flexgen.loop.interface import Controller
from flexgen.motion_control.benchmarks.scenario import FOLDER, Scenario
from flexgen.motion_control.controllers import controller_of


def shipped(scenario: str) -> tuple[Path, ...]:
    """The files of the controllers that come with a benchmark."""
    return tuple(sorted((FOLDER / "controllers").glob(f"{scenario}-*.toml")))


def scenario_controller(given: Any, chosen: Scenario, motion: Sequence[np.ndarray]) -> tuple[Controller, str]:
    """A controller for a scenario, and its name; see `flexgen.score`."""
    title = ""
    if isinstance(given, str) and given == "reference":
        given, title = chosen.reference, given
    if isinstance(given, str):
        files = {path.stem.removeprefix(f"{chosen.name}-"): path for path in shipped(chosen.name)}
        if given in files:
            given, title = files[given], given
        elif "." not in given:
            known = ", ".join(["reference", *files])
            raise ArgumentError(
                f"controller: given {given!r}, expected one of {known}, a file .toml, .py (file.py:Class) or a "
                "shared library"
            )
    made, name = controller_of(given, chosen.model, chosen.sample_s, chosen.delay_s, motion)
    return made, title or name
