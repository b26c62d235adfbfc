"""The tool error that a solution claims, against an independent simulation of the whole move.

Open loop, or under the motor feedback that the solution names; by Pinocchio and scipy alone, until 0.5 s after the end.
"""

from __future__ import annotations

import signal
from types import FrameType
from typing import Any

from closed_loop_referee import closed_loop_error
from end_of_move import errors

from flexgen.inversion.solution import Solution
from flexgen.trajectory import Trajectory

FACTOR, ACCURACY = 1.2, 1e-9  # of a claim that holds; of the simulation here [m, rad]
RTOL = 1e-8  # of the simulation under feedback


class _Late(Exception):
    """The simulation took too long."""


def claimed_error(solution: Solution) -> float:
    """The larger of distance [m] and angle [rad] that the solution states."""
    return max(solution.tool_error_max_m or 0.0, solution.tool_error_max_rad or 0.0)


def simulated_error(solution: Solution, trajectory: Trajectory | None = None) -> float:
    """The same error [m, rad] of the whole move, without or with motor feedback, as in the solution."""
    assert solution.simulation is not None
    feedback, t = solution.simulation.feedback, solution.trajectory if trajectory is None else trajectory
    if feedback is None:
        return max(errors(solution.model, t, rtol=1e-12, atol=1e-14))  # 1e-10 was off by 1e-9 rad in a move
    gains = feedback.position_gain, feedback.speed_gain, feedback.integral_gain
    return closed_loop_error(solution.model, t, gains, rtol=RTOL)


def simulated_within(solution: Solution, seconds: int) -> float | None:
    """`simulated_error`; None: it took longer (sharp friction and light rotors are stiff)."""

    def late(number: int, frame: FrameType | None) -> Any:
        raise _Late

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        return simulated_error(solution)
    except _Late:
        return None
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def claim_holds(claimed: float, simulated: float) -> bool:
    """Whether a claimed error is that of the simulation, or larger."""
    return simulated <= FACTOR * claimed + ACCURACY
