"""Stable inversion as a two-point boundary value problem of the zero dynamics, in C: an
independent check of ``lq``.

The non-actuated rows R(q_e, v_e, a_e, t) = 0 of the reduced problem hold at three Gauss points of
each interval; at the start the deviation from equilibrium has no decaying (stable) part, at the
end no growing (unstable) part:

    P_s (y - y_eq) = 0 (start),    P_u (y - y_eq) = 0 (end),    y = (q_e, v_e),

where the rows P_s and P_u vanish on the unstable and the stable subspace of ``A s^2 + D s + K`` at
the equilibrium. Newton's method solves all equations together, each step by elimination with row
pivoting. The residual is zero up to rounding. The method needs equal numbers of unstable zeros at
start and end, and none on the imaginary axis or at infinity; otherwise it refuses the path, and
``lq`` solves it.

Order: the motion at the nodes is of order six in the interval length where the zero dynamics is
slow against it, and of order four where it is fast.

Source: U. M. Ascher, R. M. M. Mattheij, R. D. Russell, Numerical Solution of Boundary Value
Problems for Ordinary Differential Equations, 1995, ch. 5 (collocation), 6 (dichotomy), 7
(elimination); J. D. Roberts, Int. J. Control 32(4), 1980 (matrix sign function).
"""

from __future__ import annotations

from dataclasses import replace

from flexgen.base.errors import ArgumentError
from flexgen.inversion.methods.lq import invert_path
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.problem.sampling import from_library
from flexgen.model.abilities import obstacle


def solve(problem: InversionProblem, h: float) -> MethodResult:
    """Solve on intervals of 2 ``h`` [s], at most 10 ms. Option ``native``: compile for this
    processor.
    """
    model = problem.equations.model
    if (reason := obstacle(model, "zero dynamics")) is not None:
        raise ArgumentError(f"method bvp: {reason}; use closed-form")
    found, warnings, _ = invert_path(problem, "bvp", h)
    solved = from_library(found, warnings)
    start = found.unstable_zeros_start
    end = found.unstable_zeros_end
    details = {**solved.details, "unstable_zeros_start": start, "unstable_zeros_end": end}
    return replace(
        solved, details=details, verdict=f"{start} unstable zeros at the end of the motion"
    )
