"""Inverse dynamics with splines of the non-actuated coordinates, for flat outputs.

At a flat point the non-actuated rows do not contain the acceleration of some coordinate, and their
zero lies at infinity; near it the zero dynamics is an oscillation much faster than the path. The
motion that is wanted has none of that oscillation: it is as smooth as the path. So each coordinate
is a spline of degree 7 with intervals that resolve the path, and its coefficients minimize the
squared residuals of the non-actuated rows

    min  sum_k | R(q_e, v_e, a_e, t_k) |^2,        R = [M a + c + g]_e - tau_e

by Gauss-Newton steps. The actuated coordinates follow from the output and its derivatives. The
motion is at rest before the path and after it. Whether the residuals are small enough is decided
by the simulation, as for every method.

Source: cf. M. Fliess, J. Levine, P. Martin, P. Rouchon, Int. J. Control 61(6), 1995 (flatness);
K. Khorasani, P. V. Kokotovic, IEEE TAC 31(2), 1986 (slow manifold of flexible joints).
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
from scipy.interpolate import BSpline

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.inversion.methods.method_result import MethodResult, with_motors
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.model.abilities import obstacle
from flexgen.paths.path import PathSample

# Four derivatives of the deflections reach the motor torque, and the last is still smooth.
DEGREE = 7
# Intervals of the splines on the path, for the usual mesh of a hundredth of the path: fewer than
# of the mesh, since shorter intervals let the fast oscillation in.
COARSER = 4
# Residuals of each interval; more than unknowns, so that their squares have one minimum.
PER_INTERVAL = 6
STEPS = 30
# Largest change of a coefficient, of the largest coefficient, in the last step.
CONVERGED = 1e-12
# Largest error of the output and its rates, relative: rounding.
RATES = 1e-12
# Part of the residuals, from which on a step is the last: they cannot be reduced further.
STALLED = 0.9
# Shortest part of a step; where it does not reduce the residuals, the minimum is reached.
SHORTEST = 1e-3


def solve(problem: InversionProblem, h: float) -> MethodResult:
    """Solve with splines of intervals of 4 ``h`` [s], or ``problem.mesh``. No options."""
    problem.check_options("spline")
    model = problem.equations.model
    path = problem.path
    if (reason := obstacle(model, "zero dynamics")) is not None:
        raise ArgumentError(f"method spline: {reason}; use closed-form")
    reduction = Reduction(problem.equations)
    length = COARSER * h if problem.mesh is None else h
    count = max(DEGREE, round(path.duration / length))
    basis = _Basis(path.duration, count)
    coefficients, steps = _minimize(problem, reduction, basis)
    n = int(np.ceil(path.duration / problem.step))
    period = path.duration / n
    after = int(np.ceil(problem.gear_settling / period))
    t = period * np.arange(n + after + 1)
    sample = path.sample(t)
    inner = [basis.matrix(t, order) @ coefficients for order in range(5)]
    q = _start(problem, reduction, t)
    q[:, reduction.i_e] = inner[0]
    q = reduction.close(q, reduction.targets(sample))
    motion = reduction.motion_through(sample, q, inner[1:])
    return with_motors(problem.equations, t, motion, iterations=steps, intervals=count)


class _Basis:
    """B-splines on the path that are constant before it and after it."""

    def __init__(self, duration: float, count: int) -> None:
        """B-splines on ``count`` equal intervals of the path's duration [s], and the points at
        which equations are evaluated.
        """
        step = duration / count
        self.duration = duration
        self.knots = step * np.arange(-DEGREE, count + DEGREE + 1)
        self.size = len(self.knots) - DEGREE - 1
        self.points = step * (np.arange(count * PER_INTERVAL) + 0.5) / PER_INTERVAL
        # The others reach beyond the path: their coefficients are those of the rests at its ends.
        self.free = slice(DEGREE, self.size - DEGREE)

    def matrix(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Derivative of an order of all splines (n, size); constant outside the path."""
        spline = BSpline(self.knots, np.eye(self.size), DEGREE)
        inside = np.clip(t, self.knots[DEGREE], self.knots[-DEGREE - 1])
        return spline.derivative(order)(inside) if order else spline(inside)


def _start(problem: InversionProblem, reduction: Reduction, t: np.ndarray) -> np.ndarray:
    """Quasi-static motion (n, n_a), a first guess."""
    start = reduction.start(problem.path).q_a
    return reduction.follow(problem.path, t, start)


def _minimize(
    problem: InversionProblem, reduction: Reduction, basis: _Basis
) -> tuple[np.ndarray, int]:
    """Coefficients (size, n_e) of the non-actuated coordinates with the least residuals of the
    equations at the points of the basis, by Gauss-Newton steps with a line search, and the number
    of steps.

    The coefficients beyond the ends are those of rest and stay fixed.
    """
    t = basis.points
    sample = problem.path.sample(t)
    rows = _residual_function(reduction, sample)
    guess = _start(problem, reduction, t)
    ends = _start(problem, reduction, np.array([0.0, problem.path.duration]))[:, reduction.i_e]
    matrices = [basis.matrix(t, order) for order in range(3)]
    free = basis.free
    middle = basis.size // 2
    fixed = np.vstack([np.tile(ends[0], (middle, 1)), np.tile(ends[1], (basis.size - middle, 1))])
    found = fixed.copy()
    inner = [matrix[:, free] for matrix in matrices]
    moved = guess[:, reduction.i_e] - matrices[0] @ fixed
    found[free] += np.linalg.lstsq(inner[0], moved, rcond=None)[0]
    n_e = found.shape[1]

    def residuals_of(coefficients: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        return rows(guess, [matrix @ coefficients for matrix in matrices])

    residual, slopes = residuals_of(found)
    for step in range(1, STEPS + 1):
        check_time(f"method spline, step {step}")
        # d R / d coefficients: (n, n_e rows, free, n_e columns)
        J = sum(
            slope[:, :, None, :] * matrix[:, None, :, None]
            for slope, matrix in zip(slopes, inner, strict=True)
        )
        assert isinstance(J, np.ndarray)
        J = J.reshape(residual.size, -1)
        change = np.linalg.lstsq(J, -residual.ravel(), rcond=None)[0].reshape(-1, n_e)
        size = float(np.linalg.norm(residual))
        part = 1.0
        while True:
            trial = found.copy()
            trial[free] += part * change
            after, later = residuals_of(trial)
            if np.isfinite(after).all() and np.linalg.norm(after) < size:
                break
            part /= 2
            if part < SHORTEST:
                return found, step
        stalled = np.linalg.norm(after) > STALLED * size
        found = trial
        residual = after
        slopes = later
        problem.log(f"splines, step {step}: residual {np.abs(residual).max():.1e} N m")
        if stalled or np.abs(part * change).max() <= CONVERGED * (1.0 + np.abs(found).max()):
            return found, step
    return found, STEPS


def _residual_function(
    reduction: Reduction, sample: PathSample
) -> Callable[[np.ndarray, list[np.ndarray]], tuple[np.ndarray, list[np.ndarray]]]:
    """Non-actuated rows (n, n_e) and their derivatives in (q_e, v_e, a_e), each (n, n_e, n_e).

    As a function of a guess (n, n_a), whose actuated coordinates are improved in place, and of the
    three levels of the non-actuated coordinates. The actuated ones are eliminated by the path.
    """
    stage = reduction.stage
    symbols = [ca.SX.sym(f"x{i}", *stage.size_in(i)) for i in range(4)]
    value = stage(*symbols)
    both = ca.Function("rows", symbols, [value, ca.densify(ca.jacobian(value, symbols[0]))])
    n_a = reduction.model.n_a
    n_e = len(reduction.i_e)
    outer = [level * n_a + i for level in range(3) for i in reduction.i_g]
    inner = [level * n_a + i for level in range(3) for i in reduction.i_e]
    targets = reduction.targets(sample)
    rates = [sample.derivative(1), sample.derivative(2)]
    n_rows = stage.size_out(0)[0]
    moving = np.zeros((len(targets), 3, n_a))

    def rows(guess: np.ndarray, levels: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
        """Residuals (n, n_e) [N m or N] and their derivatives in q_e, v_e and a_e, each (n, n_e,
        n_e).

        ``levels``: q_e, v_e, a_e (n, n_e). The actuated coordinates follow from the path, by
        Newton's method from ``guess`` (n, n_a), which is improved in place; the derivatives
        include this dependence.
        """
        n = len(guess)
        for level, part in enumerate(levels):
            moving[:, level, reduction.i_e] = part
        moving[:, 0, reduction.i_g] = guess[:, reduction.i_g]
        moving[:, 0] = reduction.close(moving[:, 0], targets)
        guess[:, reduction.i_g] = moving[:, 0, reduction.i_g]
        # the rates of the output are linear in v_g, then in a_g: two steps are exact
        for _ in range(3):
            x = moving.reshape(n, -1)
            residual, J = evaluate(both, x, targets, *rates)
            path_rows = residual[:, : n_rows - n_e]
            J_outer = J[:, : n_rows - n_e, outer]
            if np.abs(path_rows).max() <= RATES * (1.0 + np.abs(x).max()):
                break
            x[:, outer] -= np.linalg.solve(J_outer, path_rows[:, :, None])[:, :, 0]
        follow = np.linalg.solve(J_outer, J[:, : n_rows - n_e, inner])
        total = J[:, n_rows - n_e :, inner] - J[:, n_rows - n_e :, outer] @ follow
        slopes = [total[:, :, level * n_e : (level + 1) * n_e] for level in range(3)]
        return residual[:, n_rows - n_e :], slopes

    return rows
