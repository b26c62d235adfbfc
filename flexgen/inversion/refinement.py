"""One method on meshes of halved intervals, until `judge` accepts a solution or stops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import SolverError
from flexgen.base.registry import import_object
from flexgen.inversion.judge.attempt import (
    ATTEMPTS,
    Attempt,
    Measured,
    Verdict,
    is_worth_a_simulation,
    judge,
)
from flexgen.inversion.judge.reached import BestSolution
from flexgen.inversion.judge.status import Status
from flexgen.inversion.judge.verification import verify_by_simulation, with_simulation
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.methods.method_table import Method
from flexgen.inversion.problem.problem import INTERVALS, LONGEST_SETTLING, InversionProblem
from flexgen.inversion.solution import Solution
from flexgen.inversion.unverified_solution import RIPPLE, make_solution, residual_is_small

# Longest interval of the first mesh [s], unless the move takes minutes.
LONGEST = 5e-3
# Intervals of the first mesh on a path shorter than 0.5 s.
FEWEST = 100
# Estimated error of torques, relative to the largest one, above which they are refused although
# the tool follows.
RIPPLE_MOST = 0.1


def refine(
    problem: InversionProblem,
    method: Method,
    reached: BestSolution,
    failures: list[tuple[str, SolverError]] | None = None,
) -> Solution | None:
    """The solution of one method, on finer meshes until it is accepted.

    Parameters
    ----------
    problem : InversionProblem
    method : Method
    reached : BestSolution
        Gets each solution, for the end of the time limit.
    failures : list, optional
        Gets mesh and error where the method fails on a mesh, and the next mesh is tried; without
        it the error is raised.

    Returns
    -------
    Solution or None
        None where the method fails on all meshes.

    Raises
    ------
    SolverError
        The method failed; or the solution is not verified, and its residual is too large.
    """
    attempt = None
    while True:
        attempt = attempt_mesh(problem, method, reached, attempt)
        verdict = judge(attempt)
        if attempt.failure is not None and attempt.fallback is None:
            _note_failure(problem, method, attempt, failures)
        elif verdict is Verdict.REFINE:
            problem.log(f"{attempt.missed}: halving the mesh")
        if verdict is Verdict.ACCEPT:
            return _solution_of(attempt)
        if attempt.accepted and attempt.best is not None:
            reached.accepted = _solution_of(attempt.best)
        if verdict is Verdict.STOP:
            return _best_solution(attempt)


def attempt_mesh(
    problem: InversionProblem,
    method: Method,
    reached: BestSolution,
    before: Attempt | None = None,
) -> Attempt:
    """The attempt of a method on the mesh after that of the attempt ``before`` (None: the first).

    Its solution is kept in ``reached`` before it is judged, so that the best one is known where
    the time is over. It is simulated where it is worth that; an error of the method is the
    attempt's failure.
    """
    attempt = Attempt(
        number=0 if before is None else before.number + 1,
        planned=ATTEMPTS if problem.mesh is None and method.refines else 1,
        accuracy=problem.accuracy,
        verified=problem.verify,
        converging=method.name == "lq",
        before=before,
    )
    h = _interval(problem, attempt.number)
    check_time(f"method {method.name}, intervals of {h:.3g} s")
    try:
        solution = make_solution(problem, method.name, run_method(method, problem, h))
    except SolverError as error:
        return replace(attempt, failure=error)
    reached.keep(solution)
    attempt = replace(
        attempt,
        solution=solution,
        small_residual=residual_is_small(solution),
        residual=solution.residual_relative,
        slow=_is_slow_to_simulate(problem, solution),
        baseline=solution.status == Status.BASELINE,
        ripple=estimate_ripple(solution),
    )
    if not problem.verify or not is_worth_a_simulation(attempt):
        return attempt
    return _simulate(problem, attempt, reached)


def _interval(problem: InversionProblem, number: int) -> float:
    """Length of the intervals [s] of a mesh, halved from mesh to mesh."""
    if problem.mesh is not None:
        return float(problem.mesh) / 2**number
    duration = problem.path.duration
    longest = max(min(duration / FEWEST, LONGEST), duration / (INTERVALS / 4))
    return longest / 2**number


def _is_slow_to_simulate(problem: InversionProblem, solution: Solution) -> bool:
    """Whether the simulation takes seconds: of a program, or of a motion that decays slowly.

    Not with hysteresis: where its gears reverse, the residual is large on every mesh.
    """
    if "tau_h" in solution.trajectory:
        return False
    end = problem.path.duration + 2 * LONGEST_SETTLING
    return len(problem.path.segments) > 1 or bool(solution.trajectory.time[-1] > end)


def _simulate(problem: InversionProblem, attempt: Attempt, reached: BestSolution) -> Attempt:
    """The attempt with the figures of its verification."""
    checked = verify_by_simulation(problem, attempt.solution)
    solution = with_simulation(attempt.solution, checked)
    reached.keep(solution, checked.worst)
    guided = checked.simulation.feedback is not None
    measured = Measured(
        checked.worst,
        checked.simulation.energy_error,
        min(checked.defect, checked.alone) if guided else None,
    )
    attempt = replace(attempt, solution=solution, measured=measured)
    if attempt.accepted or attempt.baseline:
        return attempt
    return replace(attempt, cause=_friction_cause(problem, solution))


def _note_failure(
    problem: InversionProblem,
    method: Method,
    attempt: Attempt,
    failures: list[tuple[str, SolverError]] | None,
) -> None:
    """Add the failure of an attempt to the list, with method and interval; without a list its
    error is raised. A path that no method can follow ends the search with an error of its own.
    """
    error = attempt.failure
    assert isinstance(error, SolverError)
    if failures is None:
        raise error
    _raise_path_error(problem)
    h = _interval(problem, attempt.number)
    failures.append((f"{method.name}, intervals of {h:.3g} s", error))
    problem.log(f"method {method.name} failed: {error}")


def _best_solution(last: Attempt) -> Solution | None:
    """The best solution of all meshes; None where the method failed on all of them.

    SolverError for a solution that is not verified, and whose residual is too large.
    """
    if last.best is not None:
        return _solution_of(last.best)
    if last.failure is None:
        raise _residual_error(last.solution)
    return None


def _solution_of(attempt: Attempt) -> Solution:
    """The solution of an attempt, with what its verdict adds to it."""
    solution: Solution = attempt.solution
    if attempt.measured is None or attempt.baseline:
        return solution
    if attempt.accepted:
        return with_ripple(solution)
    cause = {"cause": attempt.cause} if attempt.cause else {}
    details = {**solution.details, "missed": attempt.missed, **cause}
    return replace(solution, status=Status.TOLERANCE_NOT_MET, details=details)


def _raise_path_error(problem: InversionProblem) -> None:
    """SolverError where no finer mesh and no further method helps.

    Then the arm has no equilibrium along the path, or the limits do not let it rest at an end of
    the path.
    """
    from flexgen.inversion.problem.limits import check_limits_at_rest

    for checked in ("windows", "equilibrium"):  # computed on the first use
        getattr(problem, checked)
    check_limits_at_rest(problem)


def run_method(method: Method, problem: InversionProblem, h: float) -> MethodResult:
    """The result of a method on intervals of ``h`` [s].

    Methods solve the robot without memory; torques of hysteresis and of bristles are added here.
    """
    solver: Callable[[InversionProblem, float], MethodResult] = import_object(
        f"{method.module}:{method.function}"
    )
    result = solver(problem, h)
    from flexgen.inversion.problem.memory import with_memory  # here: it needs CasADi

    return with_memory(problem.equations, result)


def _friction_cause(problem: InversionProblem, solution: Solution) -> str:
    """The friction that no mesh resolves, where that is why the equations fail between samples."""
    if residual_is_small(solution):
        return ""
    from flexgen.inversion.judge.reversals import unresolved_friction

    return unresolved_friction(problem.equations, solution.trajectory)


def estimate_ripple(solution: Solution) -> float:
    """Estimated error of torques that the mesh does not resolve, of the largest; 0: it does, or
    has many intervals.
    """
    resolved = solution.details.get("converged", True) or solution.intervals > INTERVALS
    return 0.0 if resolved else solution.details.get("torque_error", 0.0)


def with_ripple(solution: Solution) -> Solution:
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


def _residual_error(solution: Solution) -> SolverError:
    """The error of a result that is not verified, and whose residual is too large."""
    return SolverError(
        f"method {solution.method}: the result does not satisfy the equations of motion "
        f"between its samples: residual {solution.residual_max_Nm:.3g} N m, relative "
        f"residual {solution.residual_relative:.1e}; switch the verification on, or try a "
        "finer --mesh or a smoother move"
    )
