"""Inverse dynamics in closed form, for models without non-actuated coordinates.

The motion of the arm follows from the path and its derivatives at each instant,

    Gamma(q) = Z,   W v = Z',   W a + W' v = Z'',  ...,      tau_g = M(q) a + c(q, v) + g(q)

and the motors follow from the gear torques (`flexgen.inversion.motor_side`).
"""

from __future__ import annotations

import numpy as np

from flexgen.errors import ArgumentError, SolverError
from flexgen.inversion.method_result import MethodResult, with_motors
from flexgen.inversion.problem import InversionProblem
from flexgen.inversion.reduced_problem import Reduction

SAMPLES = 200_000  # at most


def solve(problem: InversionProblem, h: float) -> MethodResult:
    """Solve in closed form at each sample; ``h`` is not used. No options."""
    problem.check_options("closed-form")
    equations, path = problem.equations, problem.path
    if equations.model.n_e:
        raise ArgumentError(
            f"method closed-form: model {equations.model.name} has {equations.model.n_e} non-actuated coordinates, "
            "expected none; use lq"
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
    return with_motors(equations, t, motion)
