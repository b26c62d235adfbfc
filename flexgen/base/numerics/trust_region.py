"""Nonlinear least squares by a trust region on the normal equations, with a Gaussian prior and
bounds.

    min  ||r(x)||^2 + sum ((x - x_0)/sd)^2,      g = Re J^H r + prior,  A = Re J^H J + prior

The step is the minimum of the quadratic model within a sphere, from the eigenvalues of A.
Residuals are summed into g and A by the caller, so that their Jacobian is never stored as a whole.

Source: J. Nocedal and S. Wright, Numerical Optimization, 2nd ed. 2006, ch. 4.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flexgen.base.calls.deadline import best_known, check_time, is_over, keep_best
from flexgen.base.errors import SolverError

Sums = tuple[float, np.ndarray, np.ndarray]  # ||r||^2, Re J^H r, Re J^H J
RADIUS = 0.5  # of the step in x
LARGEST_RADIUS = 3.0  # mostly logarithms
ITERATIONS = 100
# Where to stop: distance to the minimum of the quadratic model over the standard deviation, and
# size of a step.
DISTANCE_IN_SD = 1e-3
SMALL_STEP = 1e-9
# Of a wrong model: mean square of residuals, with 1 for noise; so many steps that gain less than
# this part.
WRONG = 10.0
FEW = 10
LITTLE = 0.02


@dataclass(frozen=True)
class Fit:
    """Result of a fit.

    ``x`` (n,), ``cost``: ||r||^2 without the prior; ``objective``: with it; ``A`` (n, n): Re J^H J
    without the prior; ``iterations``, ``converged``; ``at_bound`` (n,): parameters that a bound
    holds; ``wrong``: see `minimize`.
    """

    x: np.ndarray
    cost: float
    objective: float
    A: np.ndarray
    iterations: int
    converged: bool
    at_bound: np.ndarray
    wrong: bool = False


def minimize(
    sums: Callable[[np.ndarray], Sums],
    cost: Callable[[np.ndarray], float],
    start: np.ndarray,
    center: np.ndarray,
    prior_sd: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    *,
    distance: float = DISTANCE_IN_SD,
    count: int | None = None,
) -> Fit:
    """Minimize the sum of squares.

    Parameters
    ----------
    sums, cost : callables
        ``||r||^2`` with and without the sums of the normal equations. They may raise SolverError
        where the model has no solution; such a step is refused.
    start, center : arrays (n,)
        Where the search begins, and the center of the prior.
    prior_sd : array (n,)
    bounds : (lower, upper), arrays (n,)
    distance : float
        Stop where the minimum of the quadratic model is nearer than this, in standard deviations.
    count : int, optional
        Of the residuals: where their mean square exceeds `WRONG`, and steps gain little, the model
        is ``wrong``, and the search stops.
    """
    lower, upper = bounds
    weight = prior_sd**-2.0
    x = np.clip(start, lower, upper)
    began = time.perf_counter()
    value, g, A = sums(x)

    def objective(at: np.ndarray, of: float) -> float:
        return of + float(weight @ (at - center) ** 2)

    radius = RADIUS
    total = objective(x, value)
    converged = False
    wrong = False
    n = 0
    held = np.zeros(len(x), bool)
    totals = [total]
    best_known(time.perf_counter() - began)
    with keep_best():
        for n in range(1, ITERATIONS + 1):  # noqa: B007, the number of iterations is a result
            if is_over():
                break
            check_time("identify")
            whole = g + weight * (x - center)
            matrix = A + np.diag(weight)
            held = ((x <= lower) & (whole > 0)) | ((x >= upper) & (whole < 0))
            free = ~held
            if not free.any():
                converged = True
                break
            step = np.zeros(len(x))
            step[free] = _step(matrix[np.ix_(free, free)], whole[free], radius)
            there = np.clip(x + step, lower, upper)  # exactly at a bound where one is reached
            step = there - x
            # of the objective, by the quadratic model
            gain = -float(2 * whole @ step + step @ matrix @ step)
            size = float(np.linalg.norm(step))
            inner = np.ix_(free, free)
            left = float(whole[free] @ np.linalg.lstsq(matrix[inner], whole[free], rcond=1e-14)[0])
            if size < SMALL_STEP or left < distance**2:
                converged = True
                break
            try:
                new = cost(there)
            except SolverError:
                radius = size / 4
                continue
            ratio = (total - objective(there, new)) / gain if gain > 0 else -1.0
            if not np.isfinite(ratio) or ratio < 1e-4:
                radius = size / 4
                if radius < SMALL_STEP:
                    converged = gain <= 1e-9 * total  # rounding: nothing left to gain
                    break
                continue
            # the sums first: a search that ends in them keeps the step before
            value, g, A = sums(there)
            x = there
            total = objective(x, value)
            totals.append(total)
            if wrong := count is not None and value > WRONG * count and _gains_little(totals):
                break
            if ratio > 0.75 and size > 0.8 * radius:
                radius = min(2 * radius, LARGEST_RADIUS)
            elif ratio < 0.25:
                radius = size / 2
    return Fit(x, value, total, A, n, converged, held, wrong)


def _gains_little(totals: list[float]) -> bool:
    """Whether the last `FEW` steps gained less than the part `LITTLE` of the objective."""
    return len(totals) > FEW and totals[-1] > (1 - LITTLE) * totals[-1 - FEW]


def _step(A: np.ndarray, g: np.ndarray, radius: float) -> np.ndarray:
    """Minimum of ``2 g's + s'A s`` within ``||s|| <= radius``."""
    values, vectors = np.linalg.eigh(A)
    values = np.maximum(values, 1e-14 * values[-1])
    along = vectors.T @ g
    step = -along / values
    if np.linalg.norm(step) <= radius:
        return vectors @ step
    low = 0.0
    high = float(np.linalg.norm(along)) / radius
    for _ in range(200):
        shift = (low * high) ** 0.5 if low > 0 else high * 1e-3
        step = -along / (values + shift)
        if np.linalg.norm(step) > radius:
            low = shift
        else:
            high = shift
        if abs(np.linalg.norm(step) - radius) < 0.05 * radius or high - low < 1e-12 * high:
            break
        if low == 0.0 and high < 1e-300:
            break
    return vectors @ step


def as_real(r: np.ndarray, J: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Complex residuals and derivatives (..., n) as real numbers, (2 N,) and (2 N, n)."""
    assert J is not None
    flat = J.reshape(-1, J.shape[-1])
    return stack(r), np.vstack([flat.real, flat.imag])


def stack(r: np.ndarray) -> np.ndarray:
    """Complex numbers as real ones (2 N,)."""
    return np.concatenate([r.real.ravel(), r.imag.ravel()])


def normal(r: np.ndarray, J: np.ndarray | None) -> Sums:
    """The sums of residuals and their derivatives."""
    flat, real = as_real(r, J)
    return float(flat @ flat), real.T @ flat, real.T @ real
