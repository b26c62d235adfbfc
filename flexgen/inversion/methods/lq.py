"""Stable inversion by linear-quadratic Gauss-Newton steps, in C: the default method of elastic
arms.

Unknown are the accelerations of the non-actuated coordinates at three Gauss points of each
interval, the control of the double integrator y = (q_e, v_e). The squared residuals of the
non-actuated rows R(q_e, v_e, a_e, t) of the reduced problem are minimized, with small weights on
the unknowns that only select the bounded motion among all motions that satisfy the rows. The
motion starts in equilibrium. No eigenvalues are needed, and points with a zero at infinity, where
the rows do not determine the acceleration, do no harm.

Order: the motion at the nodes is of order six in the interval length where the zero dynamics is
slow against it, and of order four where it is fast.

Source: cf. D. Chen, B. Paden, Int. J. Control 64(1), 1996 (stable inversion); J. B. Rawlings, D.
Q. Mayne, M. Diehl, Model Predictive Control, 2017, sec. 8.8 (Riccati recursion of Gauss-Newton
steps).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from flexgen.base.calls.deadline import OutOfTime
from flexgen.base.errors import SolverError
from flexgen.codegen.emission.interface import STATUSES
from flexgen.inversion.judge.settling import SETTLED, invert_until_settled
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.problem.limits import enforce_limits
from flexgen.inversion.problem.model_library import SOLVERS, inversion_library
from flexgen.inversion.problem.problem import HELPS, INTERVALS, InversionProblem
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import from_library, grid, sample_force, samples
from flexgen.runtime.inversion.path_inversion import TOLERANCE

if TYPE_CHECKING:
    from flexgen.runtime.inversion.path_inversion import Inversion

UNREACHABLE = next(status.text for status in STATUSES if status.name == "UNREACHABLE")
# part of the reason where an iteration ended so, though the path is within reach
DIVERGED = "the iteration diverged"
LONGEST = 1e-2  # s: longest interval
PARTS = (2, 4)  # of an interval, where an inversion is not accurate by its own estimate


def solve(problem: InversionProblem, h: float) -> MethodResult:
    """Solve on intervals of 2 ``h`` [s], at most 10 ms. Option ``native``: compile for this
    processor.

    Where the inversion has not converged, since its mesh does not resolve the torques, shorter
    intervals are taken where they help. A simulation does not show such torques: the tool hardly
    follows ripples between the nodes.
    """
    settled = SETTLED * problem.accuracy
    found, warnings, samples_per_interval = invert_path(problem, "lq", h, settled=settled)
    first = found.intervals
    for parts in PARTS if problem.mesh is None and problem.limits is None else ():
        if found.converged or parts * first > 2 * INTERVALS:
            break
        problem.log(
            f"torques are off by about {found.torque_error:.0e} of the largest: halving the mesh"
        )
        try:
            finer, noted, _ = invert_path(problem, "lq", h, parts, settled=settled)
        except (SolverError, OutOfTime):
            break
        if finer.converged or finer.torque_error <= HELPS * found.torque_error:
            found = finer
            warnings = noted
    if problem.limits is not None:
        return replace(
            enforce_limits(problem, found, samples_per_interval, TOLERANCE), warnings=warnings
        )
    result = from_library(found, warnings)
    # the torque of a load that swings on must not be held
    moves_on = found.n_post > 0 and bool(np.any(found.v_a[-1])) and problem.swings
    return replace(result, held=0.0) if moves_on else result


def invert_path(
    problem: InversionProblem, method: str, h: float, parts: int = 1, **more: Any
) -> tuple[Inversion, tuple[str, ...], int]:
    """The inversion by "lq" or "bvp", its warnings, and the samples of each interval.

    The intervals have the length 2 ``h`` [s], at most 10 ms, or ``problem.mesh``, divided by
    ``parts``.
    """
    problem.check_options(method, "native")
    library = inversion_library(
        problem.equations,
        method,
        () if problem.force is None else (SOLVERS[method], "force"),
        native=bool(problem.options.get("native", False)),
        progress=problem.progress,
    )
    n, period, samples_per_interval, n_pre, n_post = grid(
        problem, (min(2 * h, LONGEST) if problem.mesh is None else h) / parts
    )
    invert = partial(
        getattr(library, SOLVERS[method]),
        *samples(Reduction(problem.equations), problem.path, period, n),
        period=period,
        q_start=problem.path.q_start,
        n_pre=n_pre,
        samples_per_interval=samples_per_interval,
        tolerance=TOLERANCE,
        force=sample_force(problem, np.arange(n) * period),
        **more,
    )
    try:
        found, warnings = invert_until_settled(
            problem, lambda n_post: invert(n_post=n_post), n_post
        )
    except SolverError as error:
        raise _explain(problem, error) from error
    return found, warnings, samples_per_interval


def _explain(problem: InversionProblem, error: SolverError) -> SolverError:
    """The error, or a truer one.

    An iteration that diverges leaves the poses that the output can reach. The path itself does not
    where the zeros along it are known, since they belong to rests with the output on the path.
    """
    if UNREACHABLE not in str(error):
        return error
    try:
        rests = problem.zeros
    except SolverError:
        return error
    if not rests:
        return error
    return SolverError(
        f"invert: {DIVERGED}: the output can rest at each place of the path, but the deflections "
        f"of a motion over {problem.path.duration:.3g} s became too large for it; give the move "
        "more time, or check the stiffness of the springs"
    )
