"""Solution: motor torques along a move, with the figures of their verification."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.display import both_measured, choose_scales, format_size
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.results import Result
from flexgen.base.rows import Data, Part, Prose, Row
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.limits import KEPT, KEPT_TO, Limits, limits_of_model
from flexgen.dynamics.mechanics.output_columns import columns_in, unit_of
from flexgen.inversion.judge.status import Status
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.model.elements import Move, RobotModel
from flexgen.simulation.integration.hold import TorqueCommand
from flexgen.simulation.result import Simulation, error_figures, error_lines

if TYPE_CHECKING:
    from flexgen.paths.accuracy.figures import PathAccuracy

STATE_CHANNELS = ("q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m")
# Part of the largest torque of a kind, arm or motors, by which residuals of rows with smaller
# torques are divided at least: a row without torque would make any rounding error large.
SMALL_TORQUE = 1e-3
# Largest torque [N m or N] of a kind that has none: nothing is divided by zero.
NO_TORQUE = 1e-9
# [m]: shorter lines change their direction at once
SHORTEST = 1e-3
LENGTH_SLACK = 1e-9  # [m], rounding of the length of a line
INTERRUPTED = "interrupted by Ctrl-C"  # why a solution is the best so far


@checked_result
@dataclass(frozen=True, repr=False)
class Solution(Result):
    """Motor torques along a move, with the figures of their verification.

    ``print(solution)`` shows the main figures, `plot` draws them, `report` writes a page with all
    of them.

    Attributes
    ----------
    model, move
        The robot, and the move with the duration that its path has.
    method : str
        Name of the method that found it.
    status : Status
        How far the solution can be relied on.
    verdict : str
        Message of the solver; empty for the closed form.
    trajectory : Trajectory
        Channels ``q_a v_a a_a q_m v_m a_m tau_m tau_g y_ref``; where there are any, ``R_ref``,
        ``force``, ``tau_h`` of hysteresis, ``tau_b`` of friction with a state,
        ``command_m command_g`` of positions to send.
    residual_max_Nm : float [N m, or N for translations]
        Largest residual of the full equations of motion at the midpoints between the samples.
    residual_relative : float
        The same, each row relative to the largest torque in it.
    iterations : int
        Of the solver.
    wall_s, cpu_s : float [s]
        Time to solve and verify.
    preactuation_s : float [s]
        How long before the path the motion begins.
    simulation : Simulation or None
        The verification; None where it was switched off.
    warnings : tuple of str
        Exceeded limits of the model file, and instants where the path is not smooth enough.
    plan_error_max_m, plan_error_max_rad : float or None [m], [rad]
        Where limits keep the motion off its path: largest distance and angle between the simulated
        output and the planned one; None where the output has no such part. ``plan_error_max`` is
        the larger number of the two.
    path_distance_max_m : float or None [m]
        Where limits keep the motion off its path: largest distance of the simulated tool from the
        path, whatever the time. ``tool_error_max_m`` is the distance from the point of the path at
        the same time.
    intervals : int
        Of the solver's mesh; 0 for a method without mesh.
    details : mapping
        Further figures of the method, JSON types.
    torque_command : TorqueCommand or None
        The torques that a controller sends at its ticks; None where no hold was given: the samples
        of the trajectory, with a spline through them.
    held_simulation : Simulation or None
        The verification under the torques of ``torque_command`` with their hold.
    stopped : str
        Why it is the best solution so far: the time limit and the stage in which it ended, or
        Ctrl-C; else empty.

    Examples
    --------
    >>> solution = flexgen.solve("elbow")
    >>> print(solution.status, solution.warnings)
    solved ()
    >>> simulated = solution.simulation
    >>> f"{simulated.torque_max_Nm:.2f} N m, {simulated.speed_max_rad_s:.0f} rad/s"
    '19.76 N m, 331 rad/s'
    """

    model: RobotModel
    move: Move
    method: str
    status: Status
    verdict: str
    trajectory: Trajectory
    residual_max_Nm: float
    residual_relative: float
    iterations: int
    wall_s: float
    cpu_s: float
    preactuation_s: float
    simulation: Simulation | None
    warnings: tuple[str, ...] = ()
    plan_error_max_m: float | None = None
    plan_error_max_rad: float | None = None
    path_distance_max_m: float | None = None
    intervals: int = 0
    details: Mapping[str, Any] = field(default_factory=dict)
    torque_command: TorqueCommand | None = None
    held_simulation: Simulation | None = None
    stopped: str = ""

    def __repr__(self) -> str:
        return (
            f"<Solution {self.model.title}, move {self.move.name}: {self.status}, method "
            f"{self.method}>"
        )

    def __str__(self) -> str:
        """Status, tool error, largest torque and speed, trajectory, warnings; methods that were
        left before.
        """
        t = self.trajectory.time
        torque = np.abs(self.trajectory["tau_m"]).max()
        speed = np.abs(self.trajectory["v_m"]).max()
        attempts = [f"  tried before: {text}" for text in self.details.get("attempts", ())]
        return "\n".join(
            [
                f"{self.model.title}, move {self.move.name}: {self.status} by method "
                f"{self.method} in {self.wall_s:.3g} s",
                f"  {self._error_text()}",
                f"  motor torque up to {torque:.4g} N m, motor speed up to {speed:.4g} rad/s",
                (
                    f"  {len(t)} samples from {t[0]:.4g} to {t[-1]:.4g} s, pre-actuation "
                    f"{self.preactuation_s:.3g} s"
                ),
                *(
                    [f"  warning: {' '.join(text.split())}" for text in self.warnings]
                    or ["  warnings: none"]
                ),
                *([f"  note: {note}"] if (note := self.model.not_measured_sentence) else []),
                *attempts,
            ]
        )

    def _error_text(self) -> str:
        """The line of `__str__` on the error of the output."""
        what = "output" if self.model.output.type == "combination" else "tool"
        if self.simulation is None:
            return f"{what} error not measured (no verification by simulation)"
        held = both_measured(*self._held_errors(), choose_scales(self.figures()))
        more = (
            f", with {self.torque_command.title()} {held}" if self.torque_command and held else ""
        )
        if self.status == Status.LIMITS_ACTIVE:
            distance = self.path_distance_max_m
            scales = choose_scales(self.figures(), (distance, "m"))
            errors = both_measured(self.tool_error_max_m, self.tool_error_max_rad, scales)
            where = f"{errors} from the reference at the same time"
            if distance is not None:
                where = f"{format_size(distance, 'm', scales)} from the path ({where})"
            return f"{what} up to {where} because limits are active{more}"
        return "\n  ".join(error_lines(self.simulation, what)) + more

    def _held_errors(self) -> tuple[float | None, float | None]:
        """Largest distance [m] and angle [rad] of the output from the path with the hold of the
        controller.
        """
        run = self.held_simulation
        return (None, None) if run is None else (run.tool_error_max_m, run.tool_error_max_rad)

    def to_dataframe(self) -> Any:
        """The trajectory as a pandas.DataFrame, see `flexgen.Trajectory.to_dataframe`."""
        return self.trajectory.to_dataframe()

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended the computation; the solution is the best so far."""
        return self.stopped == INTERRUPTED

    @property
    def mesh_s(self) -> float | None:
        """Length of the intervals of the solver's mesh [s], their mean; None for a method without
        mesh.
        """
        time = self.trajectory.time
        return float(time[-1] - time[0]) / self.intervals if self.intervals else None

    @property
    def plan_error_max(self) -> float | None:
        """The larger number of ``plan_error_max_m`` and ``plan_error_max_rad``; None where there
        is neither.
        """
        given = [x for x in (self.plan_error_max_m, self.plan_error_max_rad) if x is not None]
        return max(given, default=None)

    @property
    def tool_error_max_m(self) -> float | None:
        """Largest distance of the simulated output from the path [m]; None where it was not
        measured.
        """
        return None if self.simulation is None else self.simulation.tool_error_max_m

    @property
    def tool_error_max_rad(self) -> float | None:
        """Largest angle between the simulated output and the path [rad]; None where it was not
        measured.
        """
        return None if self.simulation is None else self.simulation.tool_error_max_rad

    def accuracy(self, band: float = 1e-4) -> PathAccuracy:
        """Path accuracy, settling, overshoot and speed of the simulated robot in the sense of
        ISO 9283.

        Parameters
        ----------
        band : float [m, or rad where the output has no lengths]
            Half width of the band of the settling time.

        Returns
        -------
        PathAccuracy
            Of one robot: without repeatabilities.

        Raises
        ------
        ArgumentError
            The solution was not verified by a simulation; the band is not a positive number.
        """
        from flexgen.paths.accuracy.corners import corner_figures, find_corners
        from flexgen.paths.accuracy.figures import path_accuracy

        if self.simulation is None or self._unverified:
            raise ArgumentError(
                "accuracy: given a solution without verification, expected one with verify=True"
            )
        run = self.simulation.trajectory
        wanted = self.trajectory
        unit = unit_of(self.model)
        columns = columns_in(self.model, unit)
        y = np.column_stack(
            [np.interp(run.time, wanted.time, x) for x in wanted["y_ref"].T[columns]]
        )
        attained = (y + run["error"][:, columns])[None]
        named: dict[str, Any] = {"robots": (self.model.name,), "unit": unit, "band": band}
        if "R_ref" in wanted:
            R_ref = np.column_stack(
                [np.interp(run.time, wanted.time, x) for x in wanted["R_ref"].T]
            )
            R = evaluate(derive(self.model).function("forward_kinematics"), run["q_a"])[1]
            named["orientations"] = R_ref.reshape(-1, 3, 3), R[None]
        motion = run.time, y, attained
        found = path_accuracy(*motion, self.move.duration, **named)
        return replace(found, **corner_figures(find_corners(self.model, self.move), *motion))

    @property
    def _unverified(self) -> bool:
        return self.simulation is None or "error" not in self.simulation.trajectory

    def content(self) -> tuple[Part, ...]:
        """The figures, notes on the path, and the methods that were tried before."""
        command = self.torque_command
        lines = [*self.details.get("notes", ()), self.model.not_measured_sentence]
        notes = [Prose(f"note: {line}", "notes") for line in lines if line]
        unknown = self.model.not_measured
        tried = [Prose(f"tried before: {x}", "tried") for x in self.details.get("attempts", ())]
        return (
            Data("model", self.model.name),
            Data("move", self.move.name),
            Prose(f"{self.model.title}, move {self.move.name}", is_title=True),
            *self.figures(),
            *notes,
            *tried,
            *([Data("not_measured", list(unknown))] if unknown else []),
            Data("stopped", self.stopped),
            Data("accuracy", None if self._unverified else self.accuracy().to_dict()),
            Data("details", dict(self.details)),
            Data("warnings", list(self.warnings)),
            Data("hold", None if command is None else command.hold),
            Data("sample_time_s", None if command is None else command.sample_time),
            Data("delay_s", None if command is None else command.delay),
            Data("trajectory", None),
            Data("torque_command", None),
        )

    def figures(self) -> tuple[Row, ...]:
        """The figures of the solution, in SI units: what tables, JSON and reports show."""
        combined = self.model.output.type == "combination"
        what = "output" if combined else "tool"
        label = None
        if self.status == Status.LIMITS_ACTIVE:
            label = (
                f"distance of the {what} from the reference at the same time (limits active), "
                "largest"
            )
        command = self.torque_command
        held_errors = self._held_errors()
        held = f"simulated {what} error with the hold of the controller, largest"
        if command is not None:
            held = f"simulated {what} error with {command.title()}, largest"
        simulation = self.simulation
        tau = self.trajectory["tau_m"]
        speed = self.trajectory["v_m"]
        return (
            Row("status", self.status.value, "", "status"),
            Row("method", self.method, "", "method"),
            Row("message of the solver", self.verdict, "", "verdict"),
            Row("iterations", self.iterations, "", "iterations"),
            Row("mesh intervals", self.intervals or None, "", "intervals"),
            Row("mean length of the mesh intervals", self.mesh_s, "s", "mesh_s"),
            Row("wall time to solve and verify", self.wall_s, "s", "wall_s"),
            Row("processor time to solve and verify", self.cpu_s, "s", "cpu_s"),
            Row("pre-actuation", self.preactuation_s, "s", "preactuation_s"),
            Row("motor torque, largest", float(np.abs(tau).max()), "N m", "torque_max_Nm"),
            Row("motor speed, largest", float(np.abs(speed).max()), "rad/s", "speed_max_rad_s"),
            *self._force_figures(),
            Row(
                "residual of the equations of motion, largest",
                self.residual_max_Nm,
                "N m",
                "residual_max_Nm",
            ),
            Row("relative residual", self.residual_relative, "relative", "residual_relative"),
            *error_figures(simulation, what, label),
            Row(
                f"distance of the {what} from the path (limits active), largest",
                self.path_distance_max_m,
                "m",
                "path_distance_max_m",
            ),
            Row(held, held_errors[0], "m", "held_error_max_m"),
            Row(held, held_errors[1], "rad", "held_error_max_rad"),
            *(
                Row(
                    "simulated error from the modified path, largest",
                    value,
                    unit,
                    f"plan_error_max_{unit}",
                )
                for value, unit in ((self.plan_error_max_m, "m"), (self.plan_error_max_rad, "rad"))
            ),
            Row(
                "energy error of the simulation",
                None if simulation is None else simulation.energy_error,
                "relative",
                "energy_error",
            ),
        )

    def _force_figures(self) -> tuple[Row, ...]:
        """The largest force of a process on the tool, where one was given."""
        if "force" not in self.trajectory:
            return ()
        largest = float(np.linalg.norm(self.trajectory["force"][:, :3], axis=1).max())
        return (Row("force of the process on the tool, largest", largest, "N", "force_max_N"),)


def residual_rows(equations: Equations, trajectory: Trajectory) -> np.ndarray:
    """Largest residual of each equation of motion, (dof,), at the midpoints between the samples [N
    m or N].

    Rows: arm coordinates, then the motors behind elastic gears.
    """
    from flexgen.simulation.verification.growth import Motion
    from flexgen.simulation.verification.residual import midpoint_residual

    names = (*STATE_CHANNELS, "force", "tau_h")
    channels = trajectory.channels
    motion = Motion(
        trajectory.time, **{name: channels[name] for name in names if name in channels}
    )
    rows = midpoint_residual(equations, motion, trajectory.meta.get("torque") == "limited")
    return np.abs(rows).max(axis=0)


def motion_residual(equations: Equations, result: MethodResult) -> np.ndarray:
    """Largest residual of each equation of motion (dof,) of a method result, as
    `residual_rows`.
    """
    from flexgen.simulation.verification.growth import Motion
    from flexgen.simulation.verification.residual import midpoint_residual

    m = result.motors
    motion = Motion(result.t, result.q, result.v, result.a, m.q_m, m.v_m, m.a_m, m.tau_m)
    return np.abs(midpoint_residual(equations, motion)).max(axis=0)


def relative_residual(equations: Equations, trajectory: Trajectory, rows: np.ndarray) -> float:
    """Largest relative residual of the equations of motion along a trajectory, without a unit.

    Each residual is divided by the largest torque (or force) of its row in the trajectory: gear
    torque of an actuated coordinate, spring torque of an elastic one, motor torque of a motor. A
    row with less than `SMALL_TORQUE` of the largest torque of its kind, arm or motors, is divided
    by this part of the largest one.

    ``rows`` (dof,) [N m or N]: from `residual_rows`, arm coordinates first, then the motors behind
    elastic gears (``i_m``).
    """
    robot = equations.model
    arm = np.zeros(robot.n_a)
    arm[list(robot.i_g)] = np.abs(trajectory["tau_g"]).max(axis=0)
    if robot.n_e:
        elastic = evaluate(
            equations.function("elastic_torque"), trajectory["q_a"], trajectory["v_a"]
        )[0]
        arm[list(robot.i_e)] = np.abs(elastic.reshape(-1, robot.n_e)).max(axis=0)
    motors = np.abs(trajectory["tau_m"]).max(axis=0)[list(robot.i_m)]
    scales = [np.maximum(x, SMALL_TORQUE * x.max(initial=NO_TORQUE)) for x in (arm, motors)]
    return float((rows / np.concatenate(scales)).max())


def limit_warnings(robot: RobotModel, trajectory: Trajectory) -> tuple[str, ...]:
    """Warnings: limits of the model file that the trajectory exceeds.

    Methods that keep limits may exceed them by a thousandth between their points.
    """
    slack = 1e-3 if trajectory.meta.get("torque") == "limited" else 1e-9
    out = []
    for j, motor in enumerate(robot.motors):
        for channel, limit, unit in (
            ("tau_m", motor.torque_max, "N m"),
            ("v_m", motor.speed_max, "rad/s"),
        ):
            largest = float(np.abs(trajectory[channel][:, j]).max())
            if limit is not None and largest > limit * (1 + slack):
                what = "torque" if channel == "tau_m" else "speed"
                out.append(
                    f"motor {motor.name}: {what} {largest:.4g} {unit} exceeds its limit "
                    f"{limit:.4g} {unit}"
                )
    out += exceeded_limits(
        robot, limits_of_model(robot).without("torque", "speed"), trajectory, slack
    )
    for i, coordinate in enumerate(robot.coordinates):
        dof = coordinate.dof
        if dof is None:
            continue
        q, v, a = (trajectory[x][:, i] for x in ("q_a", "v_a", "a_a"))
        u = coordinate.unit
        if dof.lower is not None and q.min() < dof.lower - 1e-9:
            out.append(
                f"coordinate {dof.name}: {q.min():.4g} {u} is below its limit {dof.lower:.4g} {u}"
            )
        if dof.upper is not None and q.max() > dof.upper + 1e-9:
            out.append(
                f"coordinate {dof.name}: {q.max():.4g} {u} is above its limit {dof.upper:.4g} {u}"
            )
        for values, limit, unit in (
            (v, dof.speed_max, f"{u}/s"),
            (a, dof.acceleration_max, f"{u}/s^2"),
        ):
            if limit is not None and np.abs(values).max() > limit * (1 + 1e-9):
                out.append(
                    f"coordinate {dof.name}: {np.abs(values).max():.4g} {unit} exceeds its "
                    f"limit {limit:.4g} {unit}"
                )
    return tuple(out) + line_warnings(robot, trajectory)


def line_warnings(robot: RobotModel, trajectory: Trajectory) -> tuple[str, ...]:
    """Lines between two points whose length leaves their stroke or limits in a motion, or whose
    ends almost meet.
    """
    if not robot.lines:
        return ()
    from flexgen.dynamics.mechanics.equations import kept_equations

    states = kept_equations(robot).function("line_states")
    lengths = evaluate(states, trajectory["q_a"], trajectory["v_a"])[0]
    out = []
    for line, length in zip(robot.lines, lengths.T, strict=True):
        low, high = line.range
        low = max(low, SHORTEST)
        shortest = float(length.min())
        longest = float(length.max())
        if shortest < low - LENGTH_SLACK:
            out.append(f"line {line.name}: {shortest:.4g} m is below its limit {low:.4g} m")
        if longest > high + LENGTH_SLACK:
            out.append(f"line {line.name}: {longest:.4g} m is above its limit {high:.4g} m")
    return tuple(out)


def exceeded_limits(
    robot: RobotModel, limits: Limits, trajectory: Trajectory, slack: float = 1e-3
) -> tuple[str, ...]:
    """Which of some limits the trajectory exceeds, by more than the relative ``slack``."""
    if limits.without("thermal_time") == Limits(reserve=limits.reserve):
        return ()
    from flexgen.dynamics.mechanics.limit_use import uses_of_limits

    moving = np.flatnonzero(np.diff(trajectory["y_ref"], axis=0).any(axis=1))
    end = float(trajectory.time[moving[-1] + 1]) if len(moving) else np.inf
    uses = uses_of_limits(robot, limits, trajectory.__getitem__, trajectory.time, end)
    return tuple(use.warning() for use in uses if use.part > 1 + slack)


def within_limits(solution: Solution, given: Limits | None, ignore: bool) -> Solution:
    """The solution, "limits exceeded" where it is solved beyond limits of the model file that are
    not ignored (``ignore``), or beyond those of the ``given`` limits that its method does not
    keep.
    """
    more = (
        ()
        if given is None
        else exceeded_limits(solution.model, given.without(*KEPT), solution.trajectory, KEPT_TO)
    )
    solution = replace(solution, warnings=tuple(dict.fromkeys((*solution.warnings, *more))))
    if solution.status not in (Status.SOLVED, Status.LIMITS_ACTIVE):
        return solution
    robot = solution.model
    path = solution.trajectory
    active = solution.status == Status.LIMITS_ACTIVE
    # a path that limits changed leaves the speeds of joints for which it was planned
    if not more and not ignore:
        more = (
            exceeded_limits(robot, limits_of_model(robot), path, KEPT_TO)
            if active
            else limit_warnings(robot, path)
        )
    return replace(solution, status=Status.LIMITS_EXCEEDED) if more else solution
