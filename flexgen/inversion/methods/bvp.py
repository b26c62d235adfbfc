"""Stable inversion as a two-point boundary value problem of the zero dynamics, in C: the independent check of ``lq``.

The non-actuated rows R(q_e, v_e, a_e, t) = 0 of the reduced problem hold at three Gauss points of each interval; at the
start the deviation from rest has no part that fades, at the end none that grows:

    P_s (y - y_rest) = 0 (start),    P_u (y - y_rest) = 0 (end),    y = (q_e, v_e),

where the rows P_s and P_u vanish on the unstable and the stable subspace of ``A s^2 + D s + K`` at rest. Newton's
method solves all together, a step by elimination with row pivoting. Nothing is weighed, so that the residual is zero up
to rounding; for the same reason it needs as many unstable zeros at the start as at the end, and none on the imaginary
axis or at infinity: it refuses such a path, which ``lq`` solves.

Order: the motion at the nodes is of order six in the interval length where the zero dynamics is slow against it, and of
order four where it is fast.

Source: U. M. Ascher, R. M. M. Mattheij, R. D. Russell, Numerical Solution of Boundary Value Problems for Ordinary
Differential Equations, 1995, ch. 5 (collocation), 6 (dichotomy), 7 (elimination); J. D. Roberts, Int. J. Control 32(4),
1980 (matrix sign function).
"""

from __future__ import annotations

from dataclasses import replace

from flexgen.errors import ArgumentError
from flexgen.inversion.method_result import MethodResult
from flexgen.inversion.methods.lq import LONGEST, TOLERANCE
from flexgen.inversion.model_library import inversion_library
from flexgen.inversion.problem import InversionProblem
from flexgen.inversion.reduced_problem import Reduction
from flexgen.inversion.sampling import from_library, grid, samples


def solve(problem: InversionProblem, h: float) -> MethodResult:
    """Invert along the whole path. Options: ``native`` (bool): compile for this processor."""
    problem.only("bvp", "native")
    model = problem.equations.model
    if not model.n_e:
        raise ArgumentError(
            f"method bvp: model {model.name} has no coordinates without motor and so no zero dynamics to solve for, "
            "expected some; use closed-form"
        )
    library = inversion_library(
        problem.equations, "bvp", native=bool(problem.options.get("native", False)), progress=problem.progress
    )
    n, period, every, lead, tail = grid(problem, min(2 * h, LONGEST) if problem.mesh is None else h)
    found = library.bvp(
        *samples(Reduction(problem.equations), problem.path, period, n),
        period=period,
        q_start=problem.path.q_start,
        n_pre=lead,
        n_post=tail,
        samples_per_interval=every,
        tolerance=TOLERANCE,
    )
    solved = from_library(found)
    start, end = found.unstable_zeros_start, found.unstable_zeros_end
    details = {**solved.details, "unstable_zeros_start": start, "unstable_zeros_end": end}
    return replace(solved, details=details, verdict=f"{start} unstable zeros bound at the end of the motion")
