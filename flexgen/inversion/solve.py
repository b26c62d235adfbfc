"""Inverse dynamics of a move: motor torques, verified by a forward simulation of the full
model.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from flexgen.base.calls.deadline import check_time, running
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import NotNegative, Positive, TimeLimit
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.registry import find_function
from flexgen.dynamics.mechanics.equations import Equations, kept_equations, robot_of
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.inversion.choice import (
    check_applies,
    default_method,
    further_methods,
    is_worth_a_search,
)
from flexgen.inversion.hold import CommandName, Hold, with_hold
from flexgen.inversion.judge.attempt import ATTEMPTS
from flexgen.inversion.judge.reached import BestSolution, stage_of
from flexgen.inversion.judge.status import Status
from flexgen.inversion.methods.method_table import AUTO, Method, MethodName, find_method
from flexgen.inversion.problem.problem import ACCURACY, InversionProblem, SolveOptions
from flexgen.inversion.problem.solve_arguments import check_arguments, without_effect
from flexgen.inversion.refinement import refine
from flexgen.inversion.solution import Solution, within_limits
from flexgen.model.abilities import needs
from flexgen.model.elements import Move, RobotModel
from flexgen.paths.path import find_move
from flexgen.simulation.integration.hold_names import HoldName

# Default time limit [s].
TIME_LIMIT = 120.0
# "auto" starts no further method after this time [s].
FURTHER = 60.0


@checked_types(
    own=(
        "method",
        "preview",
        "mesh",
        "limits",
        "accuracy",
        "hold",
        "sample_time",
        "delay",
        "time_limit",
        "force",
    )
)
@reported("solve")
@needs("solve")
def solve(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None = None,
    method: MethodName = AUTO,
    *,
    preview: NotNegative | None = None,
    mesh: Positive | None = None,
    limits: Limits | None = None,
    verify: bool = True,
    accuracy: Positive = ACCURACY,
    hold: HoldName = "spline",
    sample_time: Positive | None = None,
    delay: NotNegative = 0.0,
    command: CommandName = "torque",
    time_limit: TimeLimit | None = TIME_LIMIT,
    ignore_limits: bool = False,
    fixed_joint: str | None = None,
    fastest: bool = False,
    force: np.ndarray
    | Callable[[np.ndarray], np.ndarray]
    | Trajectory
    | str
    | FilePath
    | None = None,
    progress: Choice = None,
    options: Mapping[str, Any] | None = None,
) -> Solution:
    """Find the motor torques that make the output track a move.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    move : str or Move, optional
        A move or program of the model file; default: the first.
    method : str
        Method of inverse dynamics. A name of
        `flexgen.inversion.methods.method_table.method_names`, or ``"auto"``: "full" for complete
        motor coupling and springs with a kink; "lq" with limits or non-actuated coordinates, else
        "closed-form" (without a C compiler "full", "collocation"). If it fails, finer meshes and
        other methods are tried: ``details["attempts"]``.
    preview : float, optional [s]
        Longest time that the motion may start before the path. Default, at most 60 s:
        `flexgen.analysis.zero_dynamics.zeros.preview`.
    mesh : float, optional [s]
        Length of the mesh intervals. Or of the steps; default, or less: a hundredth of the move,
        at most 5 ms ("lq" and "bvp" 10 ms).
    limits : Limits, optional
        "lq" modifies the path and keeps all but effective torques; "full", "collocation" torque,
        speed, deflection.
    verify : bool
        Simulate the full model and measure the error; meshes are refined until it is at most
        ``accuracy``. False: skip the verification by forward simulation.
    accuracy : float
        Largest accepted output error [m and rad]. In m for each meter of reach, at most m.
    hold : str
        What the controller does between its ticks: ``"spline"`` (default), ``"linear"``, or
        ``"zoh"`` (zero-order hold). See ``torque_command``.
    sample_time : float, optional [s]
        Sample time of the controller; default: 0.001.
    delay : float [s]
        Time from a tick of the controller until the motor has the torque.
    command : str
        ``position``: also write ``command_m`` and ``command_g``, to send to the servo of the
        model. Channels with positions.
    time_limit : float or None [s]
        Time limit of each solve; 0: no limit. After it, or Ctrl-C, the best solution so far is
        returned, with the reason in ``stopped``; None: no limit too.
    ignore_limits : bool
        Report a solution beyond the limits of the model file as solved (for studies). Exceeded
        limits are warnings only then, not a status of their own ("limits exceeded").
    fixed_joint : str, optional
        Of an arm with more motors than outputs: the joint that keeps its value in a move of the
        tool. See `flexgen.paths.geometry.redundancy`.
    fastest : bool
        Old (a DeprecationWarning): the fastest time law within ``limits``; now
        ``solve(model, fastest(model).move)``.
    force : array (n, 3), callable, Trajectory or file, optional [N]
        Force of a process on the tool along the move: a trajectory with the channel ``force``
        (.csv, .npz). Or an array or a function of times [s], world axes; also (n, 6) with moments
        [N m], (n, 2) in a plane.
    progress : callable or bool, optional
    options : mapping, optional
        Options of single methods, see their modules.

    Returns
    -------
    Solution

    Raises
    ------
    ArgumentError, SolverError
        Unknown move or method, or a method that does not apply; no solution: the text gives reason
        and what to try.

    Examples
    --------
    >>> solution = flexgen.solve("elbow", "line")
    >>> print(solution.status, "by", solution.method)
    solved by closed-form
    >>> torque = solution.trajectory["tau_m"]  # N m
    >>> torque.shape, float(abs(torque).max().round(2))
    ((1005, 2), 19.76)
    """
    began = (time.perf_counter(), time.process_time())
    log = progress if callable(progress) else None
    asked = SolveOptions(
        preview=preview,
        mesh=mesh,
        limits=limits,
        verify=verify,
        accuracy=accuracy,
        progress=log,
        options=dict(options or {}),
    )
    check_arguments(method, time_limit, asked)
    controller = Hold(hold, sample_time, delay, command)
    reached = BestSolution()
    with running(time_limit or None) as deadline:
        try:
            problem = _problem(model, move, asked, force, fixed_joint, fastest)
            solution = with_hold(problem, _find_solution(problem, method, reached), controller)
            solution = within_limits(solution, problem.limits, ignore_limits or fastest)
        except (Exception, KeyboardInterrupt) as error:
            stage = stage_of(error, deadline.is_interrupted)
            solution = reached.finish(stage, deadline.limit)
    solution = replace(
        solution, warnings=(*solution.warnings, *without_effect(solution.method, asked))
    )
    return replace(
        solution, wall_s=time.perf_counter() - began[0], cpu_s=time.process_time() - began[1]
    )


def _problem(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None,
    options: SolveOptions,
    force: Any,
    fixed_joint: str | None,
    fastest: bool,
) -> InversionProblem:
    """The problem of a move, or with ``fastest`` of its fastest time law, which keeps the limits;
    ``force``: on the tool; ``fixed_joint``: the joint of a redundant arm that is held.
    """
    from flexgen.base.calls.deprecation import warn_of_old
    from flexgen.paths.geometry.redundancy import problem_of_move

    log = options.progress
    equations = _derive(model, log)
    if fastest:
        warn_of_old(
            "solve: given fastest=True, expected the move of flexgen.fastest: fastest(model, "
            "move).move"
        )
        move = find_function("Move.fastest")(equations.model, move, options.limits, log or False)
        options = replace(options, limits=None)
    check_time("the path of the move")
    equations, path = problem_of_move(
        equations, find_move(equations.model, move), fixed_joint, log
    )
    if force is None:
        return InversionProblem(equations, path, **options.fields())
    from flexgen.paths.force.process_force import make_force

    pushed = make_force(force, equations.model, path.duration)
    return InversionProblem(equations, path, force=pushed, **options.fields())


def _derive(
    model: str | FilePath | RobotModel | Equations, log: Callable[[str], None] | None
) -> Equations:
    """The equations of motion of a model."""
    if isinstance(model, Equations):
        return model
    if log is not None:
        log("deriving the equations of motion")
    check_time("deriving the equations of motion")
    return kept_equations(robot_of(model))


def _find_solution(problem: InversionProblem, method: str, reached: BestSolution) -> Solution:
    """The solution by a method, or by the default method and those to which it falls back.
    ``reached`` keeps the best solution so far for the end of a time limit.
    """
    robot = problem.equations.model
    chosen = find_method(default_method(robot, problem.limits) if method == AUTO else method)
    check_applies(chosen, robot, problem.limits, problem.force is not None)
    find = _automatic_solution if method == AUTO else refine
    try:
        found = find(problem, chosen, reached)
    except SolverError as error:
        joints = all(segment.space == "joint" for segment in problem.path.segments)
        if not (joints and robot.output.type != "combination" and "singular pose" in str(error)):
            raise
        advice = (
            'joints pass singular poses of the tool: give the model an output of type "joint" '
            "for this move"
        )
        raise SolverError(f"{error}; {advice}") from error
    assert found is not None  # without a list of failures they are raised
    # what follows is not accepted yet
    reached.solution = found
    reached.accepted = None
    return found


def _automatic_solution(
    problem: InversionProblem, method: Method, reached: BestSolution
) -> Solution:
    """The first verified solution: of the default ``method``, or of a further one that applies to
    the model and is worth its time.

    ``details["attempts"]`` of the solution lists what failed before; so does the message of the
    error. Where no method meets the tolerance the first solution found is returned, with that
    status.
    """
    began = time.perf_counter()
    best: Solution | None = None
    failures: list[tuple[str, SolverError]] = []
    outcomes = reached.tried
    for candidate in (method, *further_methods(problem, method)):
        if candidate is not method:
            if time.perf_counter() - began > FURTHER:
                outcomes.append(f"{candidate.name}: not started, {FURTHER:g} s are over")
                continue
            if not is_worth_a_search(problem, candidate, reached.error):
                outcomes.append(f"{candidate.name}: not started, a search cannot gain enough")
                continue
            problem.log(f"trying method {candidate.name}; before: {outcomes[-1]}")
        count = len(failures)
        try:
            found = refine(problem, candidate, reached, failures)
        except ArgumentError as error:  # a further method can have requirements of its own
            if candidate is method:
                raise
            outcomes.append(f"{candidate.name}: {error}")
            continue
        finally:
            outcomes += [f"{label}: {error}" for label, error in failures[count:]]
        if found is None and _is_unreachable(problem, failures[count:]):
            break
        if found is None:
            continue
        # no other method is quieter on a mesh that does not resolve the torques
        if found.status != Status.TOLERANCE_NOT_MET or "ripple" in found.details:
            return (
                replace(found, details={**found.details, "attempts": outcomes})
                if outcomes
                else found
            )
        best = best or found
        outcomes.append(f"{candidate.name}: {found.details.get('missed', found.status)}")
    # where the default method found a motion, undamped motion is not why its error is too large
    is_found = best is not None and best.method == method.name
    reason = "" if is_found else _undamped_reason(problem)
    if best is not None:
        warnings = (*best.warnings, reason) if reason else best.warnings
        return replace(best, warnings=warnings, details={**best.details, "attempts": outcomes})
    cause = failures[0][1]
    raise SolverError(f"{reason or cause}; tried: {'; '.join(outcomes)}") from cause


def _undamped_reason(problem: InversionProblem) -> str:
    """Undamped internal motion as the reason why no method was successful; empty: there is
    none.
    """
    from flexgen.inversion.judge.undamped import advise_undamped

    try:
        undamped = problem.undamped
    except SolverError:
        return ""
    return "" if undamped is None else advise_undamped(undamped, problem.path.duration)


def _is_unreachable(problem: InversionProblem, failures: list[tuple[str, SolverError]]) -> bool:
    """Whether a method left the reach of the tool, or a singular pose, on all its meshes."""
    from flexgen.inversion.methods.lq import DIVERGED, UNREACHABLE

    # joints and their combinations have no singular poses
    tool = problem.equations.model.output.type != "combination"
    return (
        tool
        and len(failures) == ATTEMPTS
        and all(UNREACHABLE in str(error) or DIVERGED in str(error) for _, error in failures)
    )
