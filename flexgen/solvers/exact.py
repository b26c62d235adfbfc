"""The methods that follow the path exactly by IPOPT or in closed form, and the full model: from a question to answers.

What is found on a mesh of the reduced problem becomes samples of the whole motion here.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.errors import ArgumentError, SolverError
from flexgen.problems.path import PathSample
from flexgen.solvers.answer import Answer
from flexgen.solvers.collocation import collocate
from flexgen.solvers.drives import drives
from flexgen.solvers.full import collocate_full
from flexgen.solvers.question import Question
from flexgen.solvers.reduction import Motion, Reduction
from flexgen.solvers.solution import motion_residual
from flexgen.solvers.tableaus import gauss

STAGES = 3
SAMPLES = 200_000  # of a closed form


def closed_form(ask: Question, h: float) -> Answer:
    """Models without non-actuated coordinates: the motion follows from the path and its derivatives at each instant."""
    ask.only("closed-form")
    equations, path = ask.equations, ask.path
    if equations.model.n_e:
        raise ArgumentError(
            f"method closed-form: model {equations.model.name} has {equations.model.n_e} non-actuated coordinates, "
            "use lq"
        )
    n = int(min(np.ceil(path.duration / ask.step), SAMPLES))
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
    return sampled(ask, t, motion)


def collocation(ask: Question, h: float) -> Answer:
    """Optimal control on the reduced problem, solved by IPOPT; under limits, where the tool gives way, on the full one.

    The reduced problem has the path built in.
    """
    ask.only("collocation")
    if ask.limits is not None:
        return full(ask, h)
    reduction, path = Reduction(ask.equations), ask.path
    lead, nodes = ask.nodes(h)
    found = collocate(reduction, path, nodes, stages=STAGES, progress=ask.progress)
    parts = max(1, int(np.ceil(np.diff(nodes).max() / ask.step - 1e-9)))
    t, q_e, v_e, guess = found.dense(gauss(STAGES), parts)
    sample = path.sample(t)
    guess[:, list(ask.equations.model.i_e)] = q_e
    q = reduction.close(guess, reduction.targets(sample))
    motion, doubtful = reduction.motion(sample, q, v_e)
    candidates = [motion] if motion is not None else []
    if doubtful:
        candidates.append(_read_off(reduction, sample, t, q, nodes, found.q_e))
    answers = [
        sampled(
            ask,
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
    return min(answers, key=lambda answer: float(motion_residual(ask.equations, answer).max()))


def full(ask: Question, h: float) -> Answer:
    """Optimal control on the full model: limits, complete motor coupling, springs with kinks."""
    ask.only("full")
    lead, nodes = ask.nodes(2 * h)
    found = collocate_full(ask.equations, ask.path, nodes, ask.limits, progress=ask.progress)
    m = found.motion
    return Answer(
        found.t,
        m.q,
        m.v,
        m.a,
        m.tau_g[:, :, 0],
        found.drives,
        lead,
        status="limited" if found.limited else "solved",
        verdict=found.nlp.status,
        iterations=found.nlp.iterations,
        intervals=len(nodes) - 1,
    )


def sampled(
    ask: Question,
    t: np.ndarray,
    motion: Motion,
    *,
    lead: float = 0.0,
    verdict: str = "",
    iterations: int = 0,
    intervals: int = 0,
) -> Answer:
    """The answer of a motion of the arm whose derivatives are known: the drives follow."""
    motors = drives(ask.equations, t, motion.q, motion.v, motion.a, motion.tau_g)
    return Answer(
        t, motion.q, motion.v, motion.a, motion.tau_g[:, :, 0], motors, lead, "solved", verdict, iterations, intervals
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
