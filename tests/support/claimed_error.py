"""The errors of the output that a solution states, against an independent simulation of the whole
move.

Each error is simulated as the solution names it: in open loop or with the motor feedback, until
its time after the end.
"""

from __future__ import annotations

import signal
from types import FrameType
from typing import Any

from whole_move import Gains, Pair, WholeMove

from flexgen.base.motion.trajectory import Trajectory
from flexgen.inversion.solution import Solution
from flexgen.simulation.result import AFTER, Simulation

FACTOR = 1.2  # of a claim that holds
ACCURACY = 1e-9  # of the simulation here [m, rad]


class _Late(Exception):
    """The simulation took too long."""


def gains_of(simulation: Simulation) -> Gains | None:
    """The gains of the feedback that a simulation names; None: open loop."""
    feedback = simulation.feedback
    return (
        None
        if feedback is None
        else (feedback.position_gain, feedback.speed_gain, feedback.integral_gain)
    )


def claimed_error(solution: Solution) -> float:
    """The larger of distance [m] and angle [rad] that the solution states."""
    return largest((solution.tool_error_max_m, solution.tool_error_max_rad))


def simulated_error(solution: Solution, trajectory: Trajectory | None = None) -> float:
    """The error [m, rad] of the whole move in simulation, without or with motor feedback, as in
    the solution.
    """
    run = solution.simulation
    t = solution.trajectory if trajectory is None else trajectory
    assert run is not None
    return largest(WholeMove(solution.model, gains_of(run)).errors(t, (run.held_s,))[0])


def largest(errors: Pair) -> float:
    """The larger of distance [m] and angle [rad]."""
    return max(errors[0] or 0.0, errors[1] or 0.0)


def false_claims(solution: Solution) -> list[str]:
    """The stated errors that the simulation of the whole move contradicts."""
    run = solution.simulation
    t = solution.trajectory
    assert run is not None
    title = "open loop" if run.feedback is None else "with motor feedback"
    found = WholeMove(solution.model, gains_of(run)).errors(t, (run.held_s, AFTER))
    rows = [
        (title, (run.tool_error_max_m, run.tool_error_max_rad), found[0]),
        (f"{title}, {AFTER:g} s", (run.later_error_max_m, run.later_error_max_rad), found[1]),
    ]
    alone = run.open_loop
    if alone is not None:
        pair = WholeMove(solution.model).errors(t, (run.held_s,))[0]
        rows.append(("open loop", (alone.tool_error_max_m, alone.tool_error_max_rad), pair))
    return [
        f"{name}: stated {stated}, simulated {simulated}"
        for name, claim, pair in rows
        for stated, simulated in zip(claim, pair, strict=True)
        if not (stated is None or simulated is None or claim_holds(stated, simulated))
    ]


def claims_within(solution: Solution, seconds: int) -> list[str] | None:
    """`false_claims`; None: it took longer (sharp friction and light rotors are stiff)."""

    def late(number: int, frame: FrameType | None) -> Any:
        raise _Late

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        return false_claims(solution)
    except _Late:
        return None
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def claim_holds(claimed: float, simulated: float) -> bool:
    """Whether a claimed error is that of the simulation, or larger."""
    return simulated <= FACTOR * claimed + ACCURACY
