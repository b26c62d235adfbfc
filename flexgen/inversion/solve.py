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
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.files.trajectory_files import common_unit
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.registry import find_function, import_object
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import Equations, kept_equations, robot_of
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.dynamics.mechanics.output_columns import output_labels, output_units
from flexgen.inversion.choice import (
    check_applies,
    default_method,
    further_methods,
    is_worth_a_search,
)
from flexgen.inversion.hold import CommandName, Hold, with_hold
from flexgen.inversion.judge.reached import BestSolution, stage_of
from flexgen.inversion.judge.status import Status
from flexgen.inversion.judge.verification import verify_by_simulation, with_simulation
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.methods.method_table import AUTO, Method, find_method
from flexgen.inversion.problem.problem import (
    ACCURACY,
    HELPS,
    INTERVALS,
    LONGEST_SETTLING,
    InversionProblem,
)
from flexgen.inversion.problem.solve_arguments import check_arguments, without_effect
from flexgen.inversion.solution import (
    Solution,
    limit_warnings,
    relative_residual,
    residual_rows,
    within_limits,
)
from flexgen.model.abilities import needs
from flexgen.model.elements import Move, RobotModel
from flexgen.paths.path import find_move
from flexgen.simulation.integration.hold_names import HoldName
from flexgen.simulation.simulate import HELD_KEY

LONGEST = 5e-3  # s: longest interval of a mesh, unless the move takes minutes
ATTEMPTS = 3  # meshes, each with intervals half as long as the one before
# more, where only the residual between the samples is too large, or lq has nearly converged
RETRIES = 1
NEAR = 100.0  # times the accuracy: an error of lq that a finer mesh may still reduce to it
# relative: largest error of the energy balance of a simulation that verifies something
ENERGY = 1e-7
RESIDUAL = 1e-3  # largest relative residual of a result that is not verified
RIPPLE = 1e-2  # the same for the full method, whose torque may ripple between the Gauss points
# of the largest torque: estimated error of torques above which they are refused, although the tool
# follows
RIPPLE_MOST = 0.1
TIME_LIMIT = 120.0  # s
FURTHER = 60.0  # s: "auto" starts no further method after this time


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
    method: str = AUTO,
    *,
    preview: float | None = None,
    mesh: float | None = None,
    limits: Limits | None = None,
    verify: bool = True,
    accuracy: float = ACCURACY,
    hold: HoldName = "spline",
    sample_time: float | None = None,
    delay: float = 0.0,
    command: CommandName = "torque",
    time_limit: float | None = TIME_LIMIT,
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
        A move of the model file; default: its first.
    method : str
        A name of `flexgen.inversion.methods.method_table.method_names`, or ``"auto"``: "full" for
        complete motor coupling and springs with a kink; "lq" with limits or non-actuated
        coordinates, else "closed-form" (without a C compiler "full", "collocation"). If it fails,
        finer meshes and other methods are tried: ``details["attempts"]``.
    preview, mesh : float, optional [s]
        How long before the path the motion may begin; default, at most 60 s:
        `flexgen.analysis.zero_dynamics.zeros.preview`. Length of the intervals or steps; default,
        or less: a hundredth of the move, at most 5 ms ("lq" and "bvp" 10 ms).
    limits : Limits, optional
        "lq" modifies the path and keeps all but effective torques; "full", "collocation" torque,
        speed, deflection.
    verify, accuracy : bool, float [rad, and m for each meter of reach, at most m]
        Simulate the full model and measure the error; meshes are refined until it is at most
        ``accuracy``.
    hold, sample_time, delay, command : str, float [s], str
        Output of the controller between its samples: ``"spline"``, ``"linear"``, ``"zoh"``; see
        ``torque_command``; its sample time (default: 1 ms); from its tick to the instant at which
        the motor has the torque. Command ``"position"``: also channels ``command_m`` and
        ``command_g``, positions to send to the servo of the model.
    time_limit : float or None [s]
        After it, or Ctrl-C, the best solution so far is returned, with the reason in ``stopped``;
        None or 0: no limit.
    ignore_limits : bool
        Exceeded limits of the model file are warnings only, not a status of their own ("limits
        exceeded").
    fixed_joint : str, optional
        Keeps its value in a move of the tool, of an arm with more motors than outputs: see
        `flexgen.paths.geometry.redundancy`.
    fastest : bool
        Old (a DeprecationWarning): the fastest time law within ``limits``; now
        ``solve(model, fastest(model).move)``.
    force : array (n, 3), callable, Trajectory or file, optional [N]
        What a process exerts on the tool at times [s], world axes; also (n, 6) with moments [N m],
        (n, 2) in a plane.
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
    check_arguments(method, preview, mesh, accuracy, time_limit, limits)
    controller = Hold(hold, sample_time, delay, command)
    reached = BestSolution()
    given = preview, mesh, limits, verify, accuracy, log, dict(options or {}), force
    with running(time_limit or None) as deadline:
        try:
            problem = _problem(model, move, fixed_joint, fastest, given)
            solution = with_hold(problem, _find_solution(problem, method, reached), controller)
            solution = within_limits(solution, problem.limits, ignore_limits or fastest)
        except (Exception, KeyboardInterrupt) as error:
            stage = stage_of(error, deadline.is_interrupted)
            solution = reached.finish(stage, deadline.limit)
    solution = replace(
        solution, warnings=(*solution.warnings, *without_effect(solution.method, preview, mesh))
    )
    return replace(
        solution, wall_s=time.perf_counter() - began[0], cpu_s=time.process_time() - began[1]
    )


def _problem(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None,
    fixed_joint: str | None,
    fastest: bool,
    given: tuple[Any, ...],
) -> InversionProblem:
    """The problem of a move, or of its fastest time law, which keeps the limits; ``given``: from
    ``preview`` on.
    """
    from flexgen.base.calls.deprecation import warn_of_old
    from flexgen.paths.geometry.redundancy import problem_of_move

    preview, mesh, limits, verify, accuracy, log, options, force = given
    equations = _derive(model, log)
    if fastest:
        warn_of_old(
            "solve: given fastest=True, expected the move of flexgen.fastest: fastest(model, "
            "move).move"
        )
        move = find_function("Move.fastest")(equations.model, move, limits, log or False)
        limits = None
    check_time("the path of the move")
    equations, path = problem_of_move(
        equations, find_move(equations.model, move), fixed_joint, log
    )
    if force is not None:
        from flexgen.paths.force.process_force import make_force

        force = make_force(force, equations.model, path.duration)
    return InversionProblem(
        equations, path, preview, mesh, limits, verify, accuracy, log, options, force
    )


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
    """The solution by a method, or by the default method and what it falls back to."""
    robot = problem.equations.model
    chosen = find_method(default_method(robot, problem.limits) if method == AUTO else method)
    check_applies(chosen, robot, problem.limits, problem.force is not None)
    find = _automatic_solution if method == AUTO else _refine
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
    """The first verified solution: of the default method, or of a further one that applies to the
    model.

    ``details["attempts"]`` of the solution lists what failed before; so does the message of the
    error.
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
            found = _refine(problem, candidate, reached, failures)
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


def _raise_path_error(problem: InversionProblem) -> None:
    """SolverError where no finer mesh and no further method helps.

    Then the arm has no equilibrium along the path, or the limits do not let it rest at an end of
    the path.
    """
    from flexgen.inversion.problem.limits import check_limits_at_rest

    for checked in ("windows", "equilibrium"):  # computed on the first use
        getattr(problem, checked)
    check_limits_at_rest(problem)


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


def run_method(method: Method, problem: InversionProblem, h: float) -> MethodResult:
    """The result of a method on intervals of ``h`` [s]."""
    solver: Callable[[InversionProblem, float], MethodResult] = import_object(
        f"{method.module}:{method.function}"
    )
    result = solver(problem, h)
    from flexgen.inversion.problem.memory import with_memory  # here: it needs CasADi

    return with_memory(problem.equations, result)


def _refine(  # noqa: C901
    problem: InversionProblem,
    method: Method,
    reached: BestSolution,
    failures: list[tuple[str, SolverError]] | None = None,
) -> Solution | None:
    """The solution of one method, on finer meshes until it is verified.

    With the list ``failures`` a mesh on which the method fails is added there and the next one is
    tried; None where the method fails on all of them.
    """
    duration = problem.path.duration
    h = (
        max(min(duration / 100, LONGEST), duration / (INTERVALS / 4))
        if problem.mesh is None
        else float(problem.mesh)
    )
    attempts = 1 if (problem.mesh is not None or not method.refines) else ATTEMPTS
    best = None
    least = (True, np.inf)
    hidden = near = False
    for attempt in range(attempts + (RETRIES if attempts > 1 else 0)):
        last = attempt + 1 >= attempts
        if attempt >= attempts and (not least[0] or not (hidden or near)):
            break
        check_time(f"method {method.name}, intervals of {h / 2**attempt:.3g} s")
        try:
            solution = make_solution(
                problem, method.name, run_method(method, problem, h / 2**attempt)
            )
        except SolverError as error:
            if not least[0]:
                break
            if failures is None:
                raise
            _raise_path_error(problem)
            failures.append((f"{method.name}, intervals of {h / 2**attempt:.3g} s", error))
            problem.log(f"method {method.name} failed: {error}")
            continue
        reached.keep(solution)
        if not problem.verify:
            if last or residual_is_small(solution):
                _check_residual(solution)
                return solution
            problem.log(f"relative residual {solution.residual_relative:.1e}: halving the mesh")
            continue
        # the simulation of a program takes seconds, and so does that of a motion that decays
        # slowly; where gears with hysteresis reverse, the residual is large on every mesh
        long = (
            len(problem.path.segments) > 1
            or solution.trajectory.time[-1] > duration + 2 * LONGEST_SETTLING
        )
        long = long and "tau_h" not in solution.trajectory
        if (
            (hidden or long)
            and not residual_is_small(solution)
            and attempt + (not hidden) < attempts
        ):
            problem.log(f"relative residual {solution.residual_relative:.1e}: halving the mesh")
            continue
        checked = verify_by_simulation(problem, solution)
        simulation = checked.simulation
        worst = checked.worst
        solution = with_simulation(solution, checked)
        reached.keep(solution, worst)
        if solution.status == Status.BASELINE:
            return solution
        hidden = worst <= problem.accuracy and simulation.energy_error <= ENERGY
        near = method.name == "lq" and worst <= NEAR * problem.accuracy
        # a feedback reduces all errors; short residuals, at corners of a derivative of the path,
        # do nothing without it
        exact = (
            simulation.feedback is None
            or residual_is_small(solution)
            or min(checked.defect, checked.alone) <= problem.accuracy
        )
        accepted = hidden and exact
        hidden = hidden and not exact
        rough = _estimate_ripple(solution) if accepted else worst
        if accepted and rough == 0.0:
            return _with_ripple(solution)
        if best is not None and not least[0] and rough > HELPS * least[1]:
            break
        cause = "" if accepted else _friction_cause(problem, solution)
        refusal = _refusal(problem, worst, simulation.energy_error, cause)
        if best is None or (not accepted, rough) < least:  # on a finer mesh rounding may be larger
            missed = replace(
                solution,
                status=Status.TOLERANCE_NOT_MET,
                details={**solution.details, "missed": refusal}
                | ({"cause": cause} if cause else {}),
            )
            best = _with_ripple(solution) if accepted else missed
            least = (not accepted, rough)
        if accepted:
            reached.accepted = best
            refusal = f"torques are off by about {rough:.0e} of the largest"
        if not last or ((hidden or near) and attempt < attempts):
            problem.log(f"{refusal}: halving the mesh")
    assert best is not None or failures  # there is one attempt at least
    return best


def _friction_cause(problem: InversionProblem, solution: Solution) -> str:
    """The friction that no mesh resolves, where that is why the equations fail between samples."""
    if residual_is_small(solution):
        return ""
    from flexgen.inversion.judge.reversals import unresolved_friction

    return unresolved_friction(problem.equations, solution.trajectory)


def _refusal(problem: InversionProblem, worst: float, energy_error: float, cause: str = "") -> str:
    """Why a verified solution is not accepted."""
    if worst <= problem.accuracy and energy_error > ENERGY:
        return (
            f"the energy balance of the simulation is off by {energy_error:.1e}, allowed are "
            f"{ENERGY:.0e}"
        )
    more = f"; {cause}" if cause else ""
    if worst <= problem.accuracy:
        return (
            "the equations of motion do not hold between the samples, and the feedback hides how "
            f"far the tool is off{more}"
        )
    return (
        f"verified error {worst:.2e} is above {problem.accuracy:.0e} "
        f"[rad, and m for each meter of reach]{more}"
    )


def _estimate_ripple(solution: Solution) -> float:
    """Estimated error of torques that the mesh does not resolve, of the largest; 0: it does, or
    has many intervals.
    """
    resolved = solution.details.get("converged", True) or solution.intervals > INTERVALS
    return 0.0 if resolved else solution.details.get("torque_error", 0.0)


def _with_ripple(solution: Solution) -> Solution:
    """The verified solution, with a warning where the torque ripples between its samples.

    "tolerance not met" where the ripple is a large part of the torque: the tool hardly follows it,
    but the motors do.
    """
    if solution.residual_relative <= RIPPLE and solution.details.get("converged", True):
        return solution
    error = solution.details.get("torque_error")
    estimated = f", estimated error {error:.0e} of the largest torque" if error is not None else ""
    text = (
        "the samples do not resolve the motor torques: relative residual "
        f"{solution.residual_relative:.1e} between them{estimated}, although the tool follows; "
        "is the path rough, or close to a singular pose? Try another mesh"
    )
    noted = replace(solution, warnings=(*solution.warnings, text))
    if error is None or error <= RIPPLE_MOST or solution.details.get("converged", True):
        return noted
    cause = (
        f"the motor torques ripple: about {error:.0%} of the largest one is an error of the mesh; "
        "try a finer --mesh, a smoother move, or another --method"
    )
    details = {**solution.details, "missed": cause, "cause": cause, "ripple": error}
    return replace(noted, status=Status.TOLERANCE_NOT_MET, details=details)


def residual_is_small(solution: Solution) -> bool:
    """Whether the residual between the samples is small enough for a result that is not
    verified.
    """
    return solution.status == Status.BASELINE or solution.residual_relative <= (
        RIPPLE if solution.method == "full" else RESIDUAL
    )


def _check_residual(solution: Solution) -> None:
    """SolverError where the residual of a result that is not verified is too large."""
    if not residual_is_small(solution):
        raise SolverError(
            f"method {solution.method}: the result does not satisfy the equations of motion "
            f"between its samples: residual {solution.residual_max_Nm:.3g} N m, relative "
            f"residual {solution.residual_relative:.1e}; switch the verification on, or try a "
            "finer --mesh or a smoother move"
        )


def _trajectory(problem: InversionProblem, method: str, result: MethodResult) -> Trajectory:
    path = problem.path
    robot = problem.equations.model
    t = result.t
    d = result.motors
    sample = path.sample_orders(t, 2)
    names_a = tuple(c.name for c in robot.coordinates)
    names_m = tuple(m.name for m in robot.motors)
    names_g = tuple(names_a[i] for i in robot.i_g)
    reference = output_labels(robot)
    of_a = tuple(c.unit for c in robot.coordinates)
    of_g = tuple("N m" if of_a[i] == "rad" else "N" for i in robot.i_g)
    rows: list[tuple[str, np.ndarray, str | tuple[str, ...], str, tuple[str, ...]]] = [
        ("q_a", result.q, of_a, "arm coordinates", names_a),
        ("v_a", result.v, tuple(f"{u}/s" for u in of_a), "their speeds", names_a),
        ("a_a", result.a, tuple(f"{u}/s^2" for u in of_a), "their accelerations", names_a),
        ("q_m", d.q_m, "rad", "motor angles, motor side", names_m),
        ("v_m", d.v_m, "rad/s", "motor speeds, motor side", names_m),
        ("a_m", d.a_m, "rad/s^2", "motor accelerations, motor side", names_m),
        ("tau_m", d.tau_m, "N m", "motor torques, motor side", names_m),
        ("tau_g", result.tau_g, of_g, "gear torques, arm side", names_g),
        ("y_ref", sample.y[:, :, 0], output_units(robot), "reference output", reference["y_ref"]),
    ]
    if sample.R is not None:
        matrix = sample.R.reshape(len(t), 9)
        doc = "reference orientation, rows of the matrix"
        rows.append(("R_ref", matrix, "-", doc, reference["R_ref"]))
    if problem.force is not None:
        rows.append(problem.force.channel(t))
    if result.tau_h is not None:
        rows.append(
            ("tau_h", result.tau_h, of_g, "torques of the gears' hysteresis, arm side", names_g)
        )
    if result.tau_b is not None:
        rows.append(
            (
                "tau_b",
                result.tau_b,
                "N m",
                "torques of the bristles of the motors' friction",
                names_m,
            )
        )
    units = {
        name: (unit,) * len(labels) if isinstance(unit, str) else unit
        for name, _, unit, _, labels in rows
    }
    return Trajectory(
        t,
        {name: values for name, values, *_ in rows},
        {
            name: Port(name, (values.shape[1],), common_unit(units[name]), doc)
            for name, values, _, doc, _ in rows
        },
        {name: labels for name, *_, labels in rows},
        {
            "model": robot.name,
            "variant": robot.variant,
            "move": path.move.name,
            "kind": "solution",
            "torque": "smooth" if problem.limits is None else "limited",
            HELD_KEY: result.held if result.status != Status.BASELINE else 0.0,
        },
        units,
    )


def make_solution(problem: InversionProblem, method: str, result: MethodResult) -> Solution:
    """The solution of a problem from the result of a method, not verified yet.

    SolverError where it is not finite. Where its samples do not resolve the steps of the friction
    at reversals, it gets more samples there.
    """
    check_time(f"residuals of method {method}")
    solution = _make_solution(problem, method, result)
    if (
        solution.residual_relative <= RESIDUAL
        or problem.limits is not None
        or result.status == Status.BASELINE
    ):
        return solution
    from flexgen.inversion.judge.reversals import with_reversals

    check_time("samples around the reversals of motors")
    finer = with_reversals(problem.equations, result, problem.force)
    if finer is None:
        return solution
    found = _make_solution(problem, method, finer)
    return found if found.residual_relative < solution.residual_relative else solution


def _make_solution(problem: InversionProblem, method: str, result: MethodResult) -> Solution:
    equations = problem.equations
    path = problem.path
    trajectory = _trajectory(problem, method, result)
    rows = residual_rows(equations, trajectory)
    if not np.isfinite(rows).all():
        raise SolverError(
            f"method {method}: the result is not finite; try another --mesh or a smoother move"
        )
    return Solution(
        model=equations.model,
        move=path.move,
        method=method,
        status=result.status,
        verdict=result.verdict,
        trajectory=trajectory,
        residual_max_Nm=float(rows.max()),
        residual_relative=relative_residual(equations, trajectory, rows),
        iterations=result.iterations,
        wall_s=0.0,
        cpu_s=0.0,
        preactuation_s=result.preactuation,
        simulation=None,
        warnings=(
            *limit_warnings(equations.model, trajectory),
            *problem.too_rough,
            *result.warnings,
        ),
        intervals=result.intervals,
        details={**result.details, **problem.notes},
    )
