"""The torques that a controller sends for a solution, and their verification."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

from flexgen.base.display import both_measured
from flexgen.base.motion.torque_curve import read_degree
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.registry import find_function
from flexgen.inversion.judge.status import Status
from flexgen.inversion.judge.verification import verify_by_simulation
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.solution import Solution
from flexgen.simulation.integration.hold import SAMPLE_TIME, TorqueCommand, check_hold, hold_torque
from flexgen.simulation.integration.hold_names import HoldName

CommandName = Literal["torque", "position"]


@dataclass(frozen=True)
class Hold:
    """Output of a controller between its samples.

    Attributes
    ----------
    kind : str
        ``"spline"``, ``"linear"`` or ``"zoh"``.
    sample_time : float or None [s]
        Default: that of the samples for a spline, else 1 ms.
    delay : float [s]
        From a tick to the instant at which the motor has the torque.
    command : str
        ``"torque"``, or ``"position"``: what is sent to the servo of the model too.

    Raises
    ------
    ArgumentError
        A value is out of range.
    """

    kind: HoldName = "spline"
    sample_time: float | None = None
    delay: float = 0.0
    command: CommandName = "torque"

    def __post_init__(self) -> None:
        check_hold(self.kind, self.sample_time, self.delay)

    @property
    def is_default(self) -> bool:
        """Whether the samples of the solution are what the controller sends."""
        return replace(self, command="torque") == Hold()


def torque_command(trajectory: Trajectory, hold: Hold) -> TorqueCommand:
    """The torques that a controller with this hold sends for a solution."""
    sample_time = SAMPLE_TIME if hold.sample_time is None else float(hold.sample_time)
    time, values = hold_torque(
        trajectory.time,
        trajectory["tau_m"],
        hold.kind,
        sample_time,
        float(hold.delay),
        limited=trajectory.meta.get("torque") == "limited",
        degree=read_degree(trajectory.meta),
    )
    meta: dict[str, Any] = {
        key: trajectory.meta[key] for key in ("model", "variant", "move") if key in trajectory.meta
    }
    return TorqueCommand(
        time, values, trajectory.labels["tau_m"], hold.kind, sample_time, float(hold.delay), meta
    )


def with_hold(problem: InversionProblem, solution: Solution, hold: Hold) -> Solution:
    """The solution with what the controller sends, verified with its hold unless verification is
    off.

    The status is "tolerance not met" where the held torques make the output deviate by more than
    the accuracy.
    """
    if hold.command == "position":
        problem.log("inverting the servo")
        solution = find_function("Solution.positions")(solution)
    if hold.is_default:
        return solution
    command = torque_command(solution.trajectory, hold)
    if solution.simulation is None:
        return replace(solution, torque_command=command)
    problem.log(f"verifying the torques of the controller: {command.title()}")
    checked = verify_by_simulation(problem, solution, command)
    found = replace(solution, torque_command=command, held_simulation=checked.simulation)
    if checked.worst <= problem.accuracy or solution.status in (
        Status.BASELINE,
        Status.TOLERANCE_NOT_MET,
    ):
        return found
    run = checked.simulation
    errors = both_measured(*(checked.plan_error or (run.tool_error_max_m, run.tool_error_max_rad)))
    warning = (
        f"the {command.title()} makes the output deviate by {errors}, more than the accuracy "
        f"{problem.accuracy:.3g}; use a shorter sample time or a linear hold"
    )
    return replace(found, status=Status.TOLERANCE_NOT_MET, warnings=(*found.warnings, warning))
