"""Why a solution cannot be used: the first reason that holds, and advice that helps."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.inversion.judge.attempt import ENERGY
from flexgen.inversion.judge.status import Status
from flexgen.inversion.judge.undamped import UNDAMPED
from flexgen.inversion.problem.problem_text import problem_of
from flexgen.inversion.solution import Solution
from flexgen.inversion.unverified_solution import RESIDUAL
from flexgen.simulation.motor_feedback import MotorFeedback

ACCURACY = 1e-4  # m
HERTZ = ("position_hz", "speed_hz", "integral_hz")


@cache
def solved() -> Solution:
    """A verified solution, by a method other than lq."""
    return flexgen.solve("elbow")


def missed(energy: float = 0.0, **changes: Any) -> Solution:
    """A solution that misses its accuracy by far."""
    found = solved()
    assert found.simulation is not None
    fixed: dict[str, Any] = {
        "simulation": replace(found.simulation, energy_error=energy, tool_error_max_m=2e-3),
        "status": Status.TOLERANCE_NOT_MET,
        "warnings": (),
        "details": {},
        "plan_error_max_m": None,
    }
    return replace(found, **{**fixed, **changes})


TO_PATH = "the simulated output deviates from the path by 2 mm, more than the accuracy 0.0001; "
TIME = f"{TO_PATH}give the move more time or "
HELD = "the hold makes the output deviate"
TEXTS: dict[str, tuple[dict[str, Any], str]] = {
    "time": (
        {"stopped": "time is over", "warnings": (HELD,)},
        "time is over; the trajectory is the best so far",
    ),
    "hold": ({"warnings": ("a", f"{UNDAMPED}: it swings", HELD, f"{HELD} more")}, HELD),
    "swing": (
        {"warnings": ("a", f"{UNDAMPED}: it swings"), "details": {"cause": "b"}},
        f"{UNDAMPED}: it swings",
    ),
    "cause": ({"details": {"cause": "it is too stiff"}, "energy": 1.0}, "it is too stiff"),
    "energy": (
        {"energy": 1.01 * ENERGY},
        f"the energy balance of the simulation has an error of {1.01 * ENERGY:.1e}, so it verifies"
        " nothing; check whether the model is too stiff",
    ),
    "energy that is small": ({"energy": ENERGY}, f"{TIME}take --method auto or lq, or a finer"),
    "other methods": ({}, f"{TIME}take --method auto or lq, or a finer --mesh"),
    "method lq": ({"method": "lq"}, f"{TIME}a finer --mesh"),
    "plan": (
        {"plan_error_max_m": 3e-3, "method": "lq"},
        TO_PATH.replace("path by 2", "plan by 3")
        + "loosen the limits, give the move more time or a finer --mesh",
    ),
    "residual without a feedback": ({"residual_relative": 1.0, "method": "lq"}, TIME),
}


@pytest.mark.parametrize("case", TEXTS)
def test_the_first_reason_that_holds_is_told(case: str) -> None:
    changes, text = TEXTS[case]
    assert problem_of(missed(**changes), ACCURACY).startswith(f"tolerance not met: {text}")


@pytest.mark.parametrize(("part", "told"), [(1.0, False), (1.01, True)])
def test_under_a_feedback_the_equations_are_the_reason(part: float, told: bool) -> None:
    """Their residual would hide behind it."""
    found = missed(residual_relative=part * RESIDUAL, method="lq")
    gains = [np.ones(len(found.model.motors))] * 4
    feedback = MotorFeedback(*gains, dict.fromkeys(HERTZ, 1.0))
    found = replace(found, simulation=replace(found.simulation, feedback=feedback))
    text = problem_of(found, ACCURACY)
    assert text.startswith(
        "tolerance not met: the torques do not satisfy the equations of motion: relative residual "
        f"{part * RESIDUAL:.1e}; try a finer --mesh or a smoother move"
        if told
        else f"tolerance not met: {TIME}a finer --mesh"
    )


def test_a_solution_that_can_be_used_has_no_reason() -> None:
    assert problem_of(replace(missed(), status=Status.SOLVED), ACCURACY) == ""


SLOWER = "give the move more time, or keep torques and speeds with --limits"
ELSEWHERE = "choose another target or path: more time does not help beyond a range"
STUDY = "for studies use --ignore-limits"


@pytest.mark.parametrize(
    ("torques", "ranges", "advice"),
    [
        (1, 0, f"; {SLOWER}; {STUDY}"),
        (2, 0, f", and 1 more (see the warnings); {SLOWER}; {STUDY}"),
        (1, 1, f", and 1 more (see the warnings); {ELSEWHERE}; {SLOWER}; {STUDY}"),
        (0, 2, f", and 1 more (see the warnings); {ELSEWHERE}; {STUDY}"),
    ],
)
def test_limits_that_are_exceeded_have_their_advice(
    torques: int, ranges: int, advice: str
) -> None:
    """More time helps where a torque exceeds its limit, and not where a range is left."""
    found = solved()
    motors = tuple(
        replace(motor, torque_max=1e-3 if k < torques else None)
        for k, motor in enumerate(found.model.motors)
    )
    elements = tuple(
        replace(
            one,
            dofs=tuple(
                replace(
                    dof, lower=10.0 if k < ranges else None, upper=11.0 if k < ranges else None
                )
                for dof in one.dofs
            ),
        )
        for k, one in enumerate(found.model.elements)
    )
    model = replace(found.model, motors=motors, elements=elements)
    text = problem_of(replace(found, model=model, status=Status.LIMITS_EXCEEDED), ACCURACY)
    first = f"motor {motors[0].name}: torque " if torques else "coordinate "
    assert text.startswith(f"limits exceeded: {first}") and text.endswith(advice)


def test_limits_of_a_stream_are_known_by_its_warning_alone() -> None:
    found = replace(
        solved(), status=Status.LIMITS_EXCEEDED, warnings=("a", "m1 exceeds its limit")
    )
    text = f"limits exceeded: m1 exceeds its limit; {SLOWER}; {STUDY}"
    assert problem_of(found, ACCURACY) == text
