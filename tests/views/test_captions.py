"""Captions of the pictures of a report: what they say of early torques, of errors after the
samples and of zeros along the path, of real solutions in which one fact is planted.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import SolverError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.views.reports import pictures


@cache
def solution(name: str = "elbow", verify: bool = True) -> flexgen.Solution:
    return flexgen.solve(name, "line", verify=verify)


@cache
def analysis() -> Any:
    return flexgen.analyze("elbow", solution().move.start)


def captions(given: flexgen.Solution, of: Any = None) -> dict[str, str]:
    found = pictures.pictures(derive(given.model), given, of, Limits())
    return {picture.name: picture.caption for picture in found}


BECAUSE = "It starts before the path because the zero dynamics is unstable: only pre-actuation"
NONE = "No zero is unstable, so no pre-actuation is needed."
FULL = "Before the path it results from the optimization, which weighs the tool error and changes"


@pytest.mark.parametrize(
    ("method", "phase", "first", "told"),
    [
        ("lq", "non-minimum phase", -0.1, BECAUSE),
        ("lq", "non-minimum phase", 0.0, NONE),
        ("lq", "minimum phase", -0.1, NONE),
        ("full", "non-minimum phase", -0.1, FULL),
    ],
)
def test_the_torque_has_a_reason_to_begin_early(
    method: str, phase: str, first: float, told: str
) -> None:
    given = solution()
    trajectory = replace(given.trajectory, time=given.trajectory.time + first)
    shifted = replace(given, method=method, trajectory=trajectory, simulation=None)
    of = "planar5_nmp" if phase == "non-minimum phase" else "elbow"
    zeros = flexgen.analyze(of).zeros
    assert zeros.phase == phase
    assert (
        f"Torque of each motor. {told}"
        in captions(shifted, replace(analysis(), zeros=zeros))["torques"]
    )
    assert captions(shifted)["torques"] == "Torque of each motor."


@pytest.mark.parametrize(
    ("length", "angle", "told"),
    [
        (3.9e-3, None, False),
        (4.1e-3, None, True),
        (None, 4.1e-3, True),
        (1e-4, 4e-3, True),
        (None, None, False),
    ],
)
def test_errors_of_twice_those_that_are_drawn_are_explained(
    length: float | None, angle: float | None, told: bool
) -> None:
    run = solution().simulation
    assert run is not None
    drawn = run.trajectory
    error = np.zeros_like(drawn["error"])
    error[3, 1] = -2e-3
    changed = replace(drawn, channels={**drawn.channels, "error": error})
    planted = replace(run, trajectory=changed, tool_error_max_m=length, tool_error_max_rad=angle)
    text = captions(replace(solution(), simulation=planted))["errors"]
    later = " The errors in the summary are larger: they also cover the time after the samples"
    assert (later in text) == told
    assert "errors" not in captions(replace(solution(), simulation=None))


@pytest.mark.parametrize("changed", ["", "no zeros", "singular", "obstacle"])
def test_zeros_along_a_path_are_drawn_where_there_are_any(
    changed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = solution("planar5_nmp", False)
    real = pictures.zero_path

    def zero_path(*arguments: Any) -> Any:
        if changed == "singular":
            raise SolverError("singular")
        found = real(*arguments)
        return replace(found, zeros=np.nan * found.zeros) if changed else found

    monkeypatch.setattr(pictures, "zero_path", zero_path)
    if changed == "obstacle":
        monkeypatch.setattr(pictures, "obstacle", lambda model, part: "it has rigid gears")
    found = captions(given)
    assert ("zeros_along" in found) == (not changed)
    if not changed:
        verdict = flexgen.analyze("planar5_nmp", path=flexgen.plan("planar5_nmp")).zero_path
        assert verdict is not None
        told = f"{verdict.verdict[:1].upper()}{verdict.verdict[1:]}."
        assert found["zeros_along"] == (f"Zeros at the equilibrium poses along the path. {told}")
    assert "zeros_along" not in captions(replace(solution(), simulation=None))
