"""The methods that follow the path exactly by IPOPT or in closed form, and the full model: from a question to answers.

What is found on a mesh of the reduced problem becomes samples of the whole motion here.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.errors import ArgumentError, SolverError
from flexgen.inversion.method_result import MethodResult
from flexgen.inversion.methods.collocation import collocate
from flexgen.inversion.methods.full_model import collocate_full
from flexgen.inversion.motor_side import drives
from flexgen.inversion.problem import InversionProblem
from flexgen.inversion.reduced_problem import Motion, Reduction
from flexgen.inversion.solution import motion_residual
from flexgen.inversion.status import Status
from flexgen.numerics.tableaus import gauss
from flexgen.paths.path import PathSample

STAGES = 3
SAMPLES = 200_000  # of a closed form


def closed_form(problem: InversionProblem, h: float) -> MethodResult:
    """Models without non-actuated coordinates: the motion follows from the path and its derivatives at each instant."""
    problem.only("closed-form")
    equations, path = problem.equations, problem.path
    if equations.model.n_e:
        raise ArgumentError(
            f"method closed-form: model {equations.model.name} has {equations.model.n_e} non-actuated coordinates, "
            "use lq"
        )
    n = int(min(np.ceil(path.duration / problem.step), SAMPLES))
    t = np.linspace(0.0, path.duration, n + 1)
    sample = path.sample(t)
    reduction = Reduction(equations)
    if sample.q_g is not None:
        motion = reduction.joint_motion(sample.q_g)
    else:
        q = reduction.close(reduction.follow(path, t, reduction.start(path).q_a), reduction.targets(sample))
        found, _ = reduction.motion(sample, q, np.zeros((len(t), 0)))
        if found is None:
            raise SolverError(f"move {path.move.name}: the path passes a singular pose; choose another path")
        motion = found
    return sampled(problem, t, motion)


def collocation(problem: InversionProblem, h: float) -> MethodResult:
    """Optimal control on the reduced problem, solved by IPOPT; under limits, where the tool gives way, on the full one.

    The reduced problem has the path built in.
    """
    problem.only("collocation")
    if problem.limits is not None:
        return full(problem, h)
    reduction, path = Reduction(problem.equations), problem.path
    lead, nodes = problem.nodes(h)
    found = collocate(reduction, path, nodes, stages=STAGES, progress=problem.progress)
    parts = max(1, int(np.ceil(np.diff(nodes).max() / problem.step - 1e-9)))
    t, q_e, v_e, guess = found.dense(gauss(STAGES), parts)
    sample = path.sample(t)
    guess[:, list(problem.equations.model.i_e)] = q_e
    q = reduction.close(guess, reduction.targets(sample))
    motion, doubtful = reduction.motion(sample, q, v_e)
    candidates = [motion] if motion is not None else []
    if doubtful:
        candidates.append(_read_off(reduction, sample, t, q, nodes, found.q_e))
    answers = [
        sampled(
            problem,
            t,
            candidate,
            lead=lead,
            verdict=found.nlp.status,
            iterations=found.nlp.iterations,
            intervals=len(nodes) - 1,
        )
        for candidate in candidates
    ]
    if len(answers) == 1:
        return answers[0]
    return min(answers, key=lambda answer: float(motion_residual(problem.equations, answer).max()))


def full(problem: InversionProblem, h: float) -> MethodResult:
    """Optimal control on the full model: limits, complete motor coupling, springs with kinks."""
    problem.only("full")
    lead, nodes = problem.nodes(2 * h)
    found = collocate_full(problem.equations, problem.path, nodes, problem.limits, progress=problem.progress)
    m = found.motion
    return MethodResult(
        found.t,
        m.q,
        m.v,
        m.a,
        m.tau_g[:, :, 0],
        found.drives,
        lead,
        status=Status.LIMITS_ACTIVE if found.limited else Status.SOLVED,
        verdict=found.nlp.status,
        iterations=found.nlp.iterations,
        intervals=len(nodes) - 1,
    )


def sampled(
    problem: InversionProblem,
    t: np.ndarray,
    motion: Motion,
    *,
    lead: float = 0.0,
    verdict: str = "",
    iterations: int = 0,
    intervals: int = 0,
) -> MethodResult:
    """The answer of a motion of the arm whose derivatives are known: the drives follow."""
    motors = drives(problem.equations, t, motion.q, motion.v, motion.a, motion.tau_g)
    return MethodResult(
        t,
        motion.q,
        motion.v,
        motion.a,
        motion.tau_g[:, :, 0],
        motors,
        lead,
        Status.SOLVED,
        verdict,
        iterations,
        intervals,
    )


def _read_off(
    reduction: Reduction, sample: PathSample, t: np.ndarray, q: np.ndarray, nodes: np.ndarray, q_e: np.ndarray
) -> Motion:
    """The motion with the derivatives of the non-actuated coordinates read off the solution itself, by a spline."""
    # it was at rest before: without samples from then a spline's derivatives are poor at its end
    before = nodes[0] - (nodes[1] - nodes[0]) * np.arange(8, 0, -1)
    smooth = make_interp_spline(np.r_[before, nodes], np.vstack([np.tile(q_e[0], (len(before), 1)), q_e]), k=7)
    q = q.copy()
    q[:, reduction.i_e] = smooth(t)
    return reduction.motion_through(
        sample, reduction.close(q, reduction.targets(sample)), [smooth(t, k) for k in (1, 2, 3, 4)]
    )
