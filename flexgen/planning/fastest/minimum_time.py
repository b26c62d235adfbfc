"""Minimum-time motion along a path: a time law whose exact torques keep all limits.

    minimize T  subject to  |tau_m| <= tau_max,  |v_m| <= v_max,  |dtau_m/dt| <= rate_max,
                            |deflection| <= limit

over T and the inner coefficients c of a spline time law
(`flexgen.paths.timing.time_laws.SplineLaw`). Torques and motion are those of the exact inversion
of the elastic robot in C, before, on and after the path. A sequence of linear programs with a
trust region: slopes by differences of inversions, violations by an exact penalty,

    min dT + w sigma,   |g + G dx| <= 1 + sigma,   c does not decrease,   |dx| <= trust

Lower bound: the minimum time of the rigid robot with discontinuous torques, by reachability
analysis of squared speeds.

Source: H. Pham, Q.-C. Pham, IEEE Trans. Robotics 34(3), 2018 (reachable squared speeds along a
path).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path as FilePath
from time import perf_counter, process_time
from typing import Annotated, Any

import numpy as np

from flexgen.base.calls.deadline import OutOfTime, running
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import Bound, Positive, TimeLimit
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.display import lines_of
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.registry import find_function, provides
from flexgen.base.results import Result
from flexgen.base.rows import Column, Data, Part, Prose, Row, Table
from flexgen.base.spec.arguments import check_not_negative
from flexgen.dynamics.mechanics.equations import Equations, derive, robot_of
from flexgen.dynamics.mechanics.limit_use import limit_rows
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.inversion.solution import Solution
from flexgen.inversion.solve import solve
from flexgen.model.abilities import needs
from flexgen.model.elements import Move, RobotModel
from flexgen.model.moves import Program
from flexgen.paths.force.place_force import force_along, make_place_force, of_motion
from flexgen.paths.path import Path, check_range, find_move
from flexgen.planning.fastest.program_time import ProgramSearch, legs_of
from flexgen.planning.fastest.residual_vibration import (
    unit_of_vibration,
    vibrating_coordinates,
)
from flexgen.planning.fastest.rigid_time import rigid_time
from flexgen.planning.fastest.slowing import KEPT
from flexgen.planning.fastest.stated_speeds import stated_speeds
from flexgen.planning.fastest.time_search import FEWEST, FINER, MESH_S, TimeSearch

COEFFICIENTS = 16
Coefficients = Annotated[int, Bound(4, 60, words="4 to 60")]
Vibration = Annotated[
    float,
    Bound(0.0, excluded=True, words="a size > 0 in m, or rad where the output has no lengths"),
]
TIME_LIMIT = 600.0  # s, of a search
CHECKS = 20  # of the solution
DENSE = 8  # instants in each interval of its samples
INTERVALS = 4000  # of its mesh where it is refined
# of the largest torque of a curve; excesses of what it allows below it are relative to all of it
NO_TORQUE = 0.1
# searches with a margin; relative excess of a limit that is accepted
AGAINST = "95 %"
ROUNDS = 5
SLACK = 1e-3


@checked_result
@dataclass(frozen=True, repr=False)
class FastestMove(Result):
    """Result of `flexgen.fastest`.

    Attributes
    ----------
    solution : Solution
        The move with its new time law, solved and verified.
    default : Solution
        The move as it was given; a program is not verified.
    limits : Limits
    duration_s, default_s, rigid_s : float [s]
        Of the path, of the path as given, and the lower bound of a rigid robot.
    vibration : dict
        Largest vibration after the path of robots with less and more stiffness, of the new motion,
        by name, in `unit`; empty for a robot without springs.
    default_vibration : dict
        The same of the move as it was given.
    excess : float
        Largest excess of a limit, relative to it.
    coefficients : int
    programs, inversions : int
        Linear programs, and inversions of the path.
    cpu_s, wall_s : float [s]
        Time of the search.
    history : tuple of float
        Duration after each step [s].
    margin : tuple of float [N m]
        Torque of each motor reserved for the feedback of 95 % of the robots; empty without
        ``against``.
    force : callable or None
        The force of the process along the new motion, as `flexgen.solve` and `flexgen.control`
        take it.

    Examples
    --------
    >>> quick = flexgen.fastest("elbow", "line", coefficients=4)
    >>> quick.rigid_s < quick.duration_s < quick.default_s
    True
    """

    solution: Solution
    default: Solution
    limits: Limits
    duration_s: float
    default_s: float
    rigid_s: float
    vibration: dict[str, float]
    default_vibration: dict[str, float]
    excess: float
    coefficients: int
    programs: int
    inversions: int
    cpu_s: float
    wall_s: float
    history: tuple[float, ...]
    margin: tuple[float, ...] = ()
    force: Callable[[np.ndarray], np.ndarray] | None = None

    @property
    def unit(self) -> str:
        """Unit of the vibrations: ``"m"``, or ``"rad"`` where what vibrates has no lengths."""
        return unit_of_vibration(self.solution.model)

    @property
    def vibrating(self) -> tuple[str, ...]:
        """Names of the coordinates of the vibrations; empty: the output."""
        model = self.solution.model
        return tuple(model.coordinates[i].name for i in vibrating_coordinates(model))

    @property
    def vibration_m(self) -> dict[str, float]:
        """``vibration`` [m]; empty where the output has no lengths."""
        return self.vibration if self.unit == "m" else {}

    @property
    def default_vibration_m(self) -> dict[str, float]:
        """``default_vibration`` [m]; empty where the output has no lengths."""
        return self.default_vibration if self.unit == "m" else {}

    @property
    def move(self) -> Move:
        """The move with its new time law."""
        return self.solution.move

    @property
    def assumed(self) -> dict[str, float]:
        """Torque limits [N m] taken from the largest torques of the given move, for motors without
        a limit in the model file.
        """
        largest = np.abs(self.default.trajectory["tau_m"]).max(axis=0)
        names = [motor.name for motor in self.solution.model.motors]
        return {
            name: x
            for name, x, y in zip(names, self.limits.torque or (), largest, strict=True)
            if x == y
        }

    def __repr__(self) -> str:
        return (
            f"<FastestMove {self.solution.model.name}: {self.default_s:.4g} -> "
            f"{self.duration_s:.4g} s>"
        )

    def __str__(self) -> str:
        """Durations, limits and effort."""
        return lines_of(self.content())

    def content(self) -> tuple[Part, ...]:
        """Durations, limits and effort, and the solution of the new motion."""
        change = self.duration_s / self.default_s - 1
        shorter = f"{100 * change:+.0f} %"
        solution = self.solution.to_dict()
        tool = [row for row in self.solution.figures() if row.key.startswith("tool_error_max")]
        return (
            Prose(f"{self.solution.model.name}, move {self.move.name}", is_title=True),
            Data("model", self.solution.model.name),
            Data("move", self.move.name),
            Row("duration of the path", self.duration_s, "s", "duration_s", note=shorter),
            Data("change", change),
            Row("duration as given", self.default_s, "s", "default_s"),
            Row("duration of a rigid robot whose torques may jump", self.rigid_s, "s", "rigid_s"),
            Row("largest excess of a limit, relative", max(self.excess, 0.0)),
            Data("excess", self.excess),
            *(
                Row(f"torque limit of {name}, as of the move as given", torque, "N m")
                for name, torque in self.assumed.items()
            ),
            *self._margins(),
            *self._vibrations(),
            *(replace(row, key="") for row in tool),
            Row("coefficients of the time law", self.coefficients, "", "coefficients"),
            Row("linear programs", self.programs, "", "programs"),
            Row("inversions", self.inversions, "", "inversions"),
            Row("processor time of the search", self.cpu_s, "s", "cpu_s"),
            Data("assumed_torque_max_Nm", self.assumed),
            Data("timing", list(self.move.timing)),
            Data("laws", [list(law) for law in getattr(self.move, "laws", ())]),
            Data("history_s", list(self.history)),
            Data("margin_Nm", list(self.margin)),
            Data("solution", solution),
            Prose(f"the solution of the new motion: {self.solution.status}"),
        )

    def _margins(self) -> tuple[Row, ...]:
        """Torques that are left for the feedback, a row for each motor."""
        motors = [motor.name for motor in self.solution.model.motors]
        named = zip(motors, self.margin, strict=False)
        label = f"torque left for the feedback of {AGAINST} of the robots"
        return tuple(Row(f"{label}, {motor}", torque, "N m") for motor, torque in named)

    def _vibrations(self) -> tuple[Part, ...]:
        """A table of the vibrations after the path, of the new motion and of the move as given."""
        of = f" of {', '.join(self.vibrating)}" if self.vibrating else ""
        columns = (
            Column(f"vibration{of} after the path"),
            Column("new", self.unit),
            Column("as given", self.unit),
        )
        cells = tuple(
            (name, size, self.default_vibration[name]) for name, size in self.vibration.items()
        )
        return (
            *([Table(columns, cells, f"Vibration{of} after the path")] if cells else []),
            Data(f"vibration_{self.unit}", self.vibration),
            Data(f"default_vibration_{self.unit}", self.default_vibration),
        )


@checked_types(own=("time_limit", "force"))
@reported("fastest")
@needs("fastest")
def fastest(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None = None,
    *,
    limits: Limits | None = None,
    torque_rate: Positive | None = None,
    vibration: Vibration | None = None,
    coefficients: Coefficients = COEFFICIENTS,
    against: str | None = None,
    force: np.ndarray | Callable[[np.ndarray], np.ndarray] | str | FilePath | None = None,
    time_limit: TimeLimit | None = TIME_LIMIT,
    progress: Choice = None,
) -> FastestMove:
    """Find the fastest time law of a move that keeps the limits exactly.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    move : str or Move, optional
        A move or program of the model file; default: the first.
    limits : Limits, optional
        Default: those of the model file, without those of its joints; a motor without torque limit
        there gets the largest torque of the move as it is given.
    torque_rate : float, optional
        Bound of the rates of the torques, as a multiple of the largest one of the move as it is
        given. It lowers the vibration of robots that differ from the model, and costs time.
    vibration : float, optional [m, or rad where the output has no lengths]
        Bound of the vibration after the path [m], of robots with 10 % less and more stiffness
        under control. Of the tool, under a P-PI cascade; of a robot whose output is its joints
        behind rigid gears, of its coordinates without motor, such as a payload: see
        `flexgen.planning.fastest.residual_vibration`. The robots are simulated in every step.
    coefficients : int
        Of each time law, 4 to 60. The inner ones: more are faster and take longer.
    against : str, optional
        '95 %': of the robots drawn from ``[uncertainty]`` 95 % keep the torque limits with motor
        feedback. At each instant, with the motor feedback of `flexgen.predict`; the search is
        repeated with the torque that this feedback leaves. Not with torque-speed curves.
    force : array (n, 3), callable or file, optional [N]
        Force of a process on the tool [N] that the limits are kept with, over the place on the
        path: CSV with the columns place, fx, fy, fz; the place is 0 at the start and 1 at the end
        of a move. See `flexgen.paths.force.place_force`.
    time_limit : float or None [s]
        Time limit of the search; 0: no limit. None: unlimited too.
    progress : callable or bool, optional

    Returns
    -------
    FastestMove

    Raises
    ------
    ArgumentError
        An argument is out of range, the path is one through samples, or ``vibration`` is given for
        a program.
    SolverError
        The move has no solution, the limits cannot be kept at the speeds that were tried, or the
        time limit is over.

    Examples
    --------
    >>> quick = flexgen.fastest("elbow", "line", coefficients=4)
    >>> f"{quick.duration_s:.2f} s instead of {quick.default_s:.2f} s"
    '0.87 s instead of 1.00 s'
    """
    if limits is not None and not isinstance(limits, Limits):
        raise ArgumentError(f"limits: given {limits!r}, expected an object of flexgen.Limits")
    if against not in (None, AGAINST):
        raise ArgumentError(f"against: given {against!r}, expected {AGAINST!r} or None")
    if against is not None and force is not None:
        raise ArgumentError(
            "against: given with a force, expected one of both: the feedback is predicted "
            "without it"
        )
    robot = robot_of(model)
    if against is not None and robot.uncertainty is None:
        raise ArgumentError(
            f"against: given {robot.title} without a table [uncertainty], expected one in its file"
        )
    if against is not None and (limits or Limits()).merge(robot).torque_speed is not None:
        raise ArgumentError(
            "against: given with torque-speed curves, expected none; Limits(reserve=) leaves "
            "torque"
        )
    check_not_negative(
        "time_limit",
        0.0 if time_limit is None else time_limit,
        "a time >= 0 in s; None or 0: no limit",
    )
    try:
        with running(time_limit or None):
            asked = _Asked(limits, torque_rate, vibration, coefficients, force)
            find = partial(_find_fastest, robot, move, asked, progress)
            return find() if against is None else with_margin(find, progress)
    except OutOfTime as error:
        raise SolverError(
            f"fastest: the time limit of {time_limit:g} s is over ({error}); allow more with "
            "time_limit= (--time-limit SECONDS), or take fewer coefficients"
        ) from None


@dataclass(frozen=True)
class _Asked:
    """Arguments of `fastest`."""

    limits: Limits | None
    torque_rate: float | None
    vibration: float | None
    coefficients: int
    force: Any


def with_margin(find: Callable[..., FastestMove], progress: Choice) -> FastestMove:
    """The fastest move whose torques, with those of the feedback of 95 % of the robots, keep the
    limits.

    ``find``: the search, with the margin of the torque limits (n_m,) [N m] as argument; it is
    repeated with a larger margin while torques exceed the limits. SolverError where this does not
    converge.
    """
    found = find()
    limits = np.array(found.limits.torque)
    margin = np.zeros(len(limits))
    for _ in range(ROUNDS):
        low, high = find_function("FastestMove.torques")(found.solution, progress=progress)
        over = np.maximum(np.abs(low), np.abs(high)).max(axis=0) - limits
        if (over <= SLACK * limits).all():
            return replace(found, margin=tuple(margin.tolist()))
        margin = margin + np.maximum(over, 0.0)
        if (margin >= limits).any():
            break
        found = find(margin=margin)
    raise SolverError(
        f"fastest: the feedback of {AGAINST} of the robots needs {np.round(margin, 3).tolist()} "
        f"N m or more of the torque limits {limits.tolist()} N m; know the model better "
        "(smaller numbers in [uncertainty]), or allow larger torques"
    )


def _find_fastest(
    robot: RobotModel,
    move: str | Move | None,
    asked: _Asked,
    progress: Choice,
    margin: np.ndarray | None = None,
) -> FastestMove:
    """The fastest time law; arguments of `fastest`, checked; ``margin`` (n_m,): torques [N m]
    subtracted from the limits.
    """
    tell = progress if callable(progress) else (lambda line: None)
    tell("solving the move as it is given")
    path = Path(derive(robot), find_move(robot, move))
    several = isinstance(path.move, Program)
    shown = progress if callable(progress) else None
    force = (
        None if asked.force is None else make_place_force(asked.force, robot, len(path.segments))
    )
    default = _solve_as_given(
        robot, path, several, None if force is None else force_along(force, path), shown
    )
    check_range(path)
    kept = limits_of(robot, asked.limits, asked.torque_rate, default)
    own = kept
    if margin is not None:
        own = replace(kept, torque=tuple((np.array(kept.torque) - margin).tolist()))
    search: TimeSearch | ProgramSearch
    if not several:
        (speeds,) = stated_speeds(path.move)
        search = TimeSearch(
            path, default, own, asked.vibration, asked.coefficients, tell, speeds, force
        )
    elif asked.vibration is not None:
        raise ArgumentError(
            f"vibration: given for the program {default.move.name}, expected a single move"
        )
    else:
        search = ProgramSearch(path, default, own, asked.coefficients, tell, force)
    began = perf_counter()
    cpu = process_time()
    x: Any
    x, history = search.run()
    if isinstance(search, TimeSearch) and search.swings is not None:
        x = search.calm(x, history)
    seconds = perf_counter() - began, process_time() - cpu
    mesh = None
    share = 0
    for _ in range(CHECKS):
        timed = search.move(x)
        tell(f"verifying {timed.duration:.4f} s")
        pushing = None if force is None else force_along(force, search.retime(x))
        found = solve(robot, timed, mesh=mesh, ignore_limits=True, force=pushing, progress=shown)
        over = _excesses(found, own, search.windows(x))
        if over.max() <= KEPT:
            break
        fine = max(min(MESH_S, timed.duration / FEWEST) / FINER, timed.duration / INTERVALS)
        if mesh is None and found.method == "lq" and fine < (found.mesh_s or np.inf):
            mesh = fine  # torques ripple with the mesh, and their rates more
        else:
            share = min(share + 1, 3)
            x = search.slower(x, np.where(over > KEPT, share * over, 0.0))
    else:
        raise SolverError(
            f"fastest: a limit stays exceeded by {over.max():.1e} of it; increase it"
        )
    new, given = (search.vibrations(solution) for solution in (found, default))
    rigid = [
        rigid_time(leg, *own.arrays(robot.n_m), of_motion(force, k))
        for k, leg in enumerate(legs_of(path))
    ]
    pauses = path.duration - sum(segment.law.duration for segment in path.segments)
    return FastestMove(
        solution=found,
        default=default,
        limits=kept,
        duration_s=timed.duration,
        default_s=path.duration,
        rigid_s=sum(rigid) + (pauses if several else 0.0),
        vibration=new,
        default_vibration=given,
        excess=max(search.excess(x), float(over.max())),
        coefficients=asked.coefficients,
        programs=search.programs,
        inversions=search.inversions,
        cpu_s=seconds[1],
        wall_s=seconds[0],
        history=tuple(history),
        force=pushing,
    )


def _excesses(found: Solution, limits: Limits, windows: list[tuple[float, float]]) -> np.ndarray:
    """Largest excess of a limit along a solution in each of some windows of time [s], relative;
    effective torques, which are means over the motion, count in all windows.

    Instants between the samples are included. The excess of a torque-speed curve is relative to
    the torque that the curve allows at the speed of the motor, or, where this is nearly zero, the
    part that `limit_rows` gives.
    """
    path = found.trajectory
    end = float(found.move.duration)
    time = np.interp(
        np.arange(DENSE * (len(path.time) - 1) + 1) / DENSE, np.arange(len(path.time)), path.time
    )
    over = np.full(len(windows), -1.0)
    for row in limit_rows(found.model, limits, path.at(time).__getitem__, time, end=end):
        allowed = row.bounds > NO_TORQUE * row.bounds.max(axis=0)
        parts = np.abs(
            np.where(allowed, row.values, row.parts) / np.where(allowed, row.bounds, 1.0)
        ).max(axis=1)
        for k, (low, high) in enumerate(windows):
            inside = (
                slice(None)
                if "effective" in row.quantity
                else slice(*np.searchsorted(time, (low, high)))
            )
            over[k] = max(over[k], float(parts[inside].max(initial=0.0)) - 1.0)
    return over


def _solve_as_given(
    robot: RobotModel, path: Path, several: bool, force: Any, shown: Choice
) -> Solution:
    """The solution of the given move. A program (``several`` segments) is simulated only where its
    residual alone does not verify it; ``force``: on the tool in time.
    """
    if several:
        try:
            return solve(robot, path.move, verify=False, force=force, progress=shown)
        except SolverError:
            pass
    return solve(robot, path.move, force=force, progress=shown)


def limits_of(
    robot: RobotModel, given: Limits | None, torque_rate: float | None, default: Solution
) -> Limits:
    """The given limits, else those of the model file; every motor gets a torque limit.

    ``torque_rate``: a bound of the rates as a multiple of those of the ``default`` move.
    """
    kept = (given or Limits()).merge(robot)
    tau = default.trajectory["tau_m"]
    time = default.trajectory.time
    torque = kept.bounds("torque", robot.n_m)
    largest = np.abs(tau).max(axis=0)
    kept = replace(kept, torque=tuple(map(float, np.where(np.isfinite(torque), torque, largest))))
    if torque_rate is not None:
        rate = np.minimum(
            kept.bounds("torque_rate", robot.n_m),
            torque_rate * np.abs(np.gradient(tau, time, axis=0)).max(axis=0),
        )
        kept = replace(kept, torque_rate=tuple(map(float, rate)))
    return kept


@provides("Move.fastest")
def fastest_move(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None,
    limits: Limits | None,
    progress: Choice,
) -> Move:
    """The move with its fastest time law; `flexgen.solve` calls it."""
    return fastest(model, move, limits=limits, progress=progress).move
