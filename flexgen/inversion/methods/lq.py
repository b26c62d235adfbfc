"""Stable inversion by linear-quadratic Gauss-Newton steps, in C: the default method of elastic arms.

Unknown are the accelerations of the non-actuated coordinates at three Gauss points of each interval, the control of the
double integrator y = (q_e, v_e). The squared residuals of the non-actuated rows R(q_e, v_e, a_e, t) of the reduced
problem are minimized, with small weights on the unknowns that only select the bounded motion among all motions that
satisfy the rows. The motion starts in equilibrium. No eigenvalues are needed, and points with a zero at infinity, where
the rows do not determine the acceleration, do no harm.

Order: the motion at the nodes is of order six in the interval length where the zero dynamics is slow against it, and of
order four where it is fast.

Source: cf. D. Chen, B. Paden, Int. J. Control 64(1), 1996 (stable inversion); J. B. Rawlings, D. Q. Mayne, M. Diehl,
Model Predictive Control, 2017, sec. 8.8 (Riccati recursion of Gauss-Newton steps).
"""

from __future__ import annotations

from functools import partial

import numpy as np

from flexgen.inversion.limits import enforce_limits
from flexgen.inversion.method_result import MethodResult
from flexgen.inversion.model_library import inversion_library
from flexgen.inversion.problem import InversionProblem
from flexgen.inversion.reduced_problem import Reduction
from flexgen.inversion.sampling import from_library, grid, sample_force, samples
from flexgen.inversion.settling import SETTLED, invert_until_settled
from flexgen.runtime.path_inversion import TOLERANCE

LONGEST = 1e-2  # s: longest interval


def solve(problem: InversionProblem, h: float) -> MethodResult:
    """Solve on intervals of 2 ``h`` [s], at most 10 ms. Option ``native``: compile for this processor."""
    problem.check_options("lq", "native")
    library = inversion_library(
        problem.equations,
        "lq",
        () if problem.force is None else ("invert", "force"),
        native=bool(problem.options.get("native", False)),
        progress=problem.progress,
    )
    path = problem.path
    n, period, samples_per_interval, n_pre, n_post = grid(problem, min(2 * h, LONGEST) if problem.mesh is None else h)
    y, dy, ddy = samples(Reduction(problem.equations), path, period, n)
    invert = partial(
        library.invert,
        y,
        dy,
        ddy,
        period=period,
        q_start=path.q_start,
        n_pre=n_pre,
        samples_per_interval=samples_per_interval,
        tolerance=TOLERANCE,
        settled=SETTLED * problem.accuracy,
        force=sample_force(problem, np.arange(n) * period),
    )
    found, warnings = invert_until_settled(problem, lambda n_post: invert(n_post=n_post), n_post)
    if problem.limits is not None:
        return enforce_limits(problem, found, samples_per_interval, TOLERANCE)
    return from_library(found, warnings)
