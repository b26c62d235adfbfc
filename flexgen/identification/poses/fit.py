"""Robust least squares with Gaussian priors: Gauss-Newton steps with damping, weights of Huber.

    min  sum rho(|y - y_measured| / s) + sum ((x - x_0)/sd)^2,
    rho(u) = u^2 for u <= k, 2 k u - k^2 beyond

One length per point and not one per axis, so that the fit does not depend on the axes. The scale
``s`` is the median of the errors over 1.54, the median of the length of a vector of three unit
Gaussians; of touches and readings of one number over 0.674. Errors with a stated standard
deviation are divided by it, over the median of those that are stated.

Source: P. J. Huber, Robust Statistics, 1981, ch. 7; J. Nocedal and S. Wright, Numerical
Optimization, 2006, ch. 10.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from flexgen.base.calls.deadline import best_known, check_time, is_over, keep_best
from flexgen.base.errors import SolverError
from flexgen.identification.poses.parameters import Unknown
from flexgen.identification.poses.statics import Near, Numbers, Rest, Statics

TUNING = 2.5  # k of Huber's function: 2.5 standard deviations of one axis
MEDIAN_LENGTH = 1.538172  # of a vector of three unit Gaussians
MEDIAN_SIZE = 0.6744898  # of one unit Gaussian, without its sign
# Least eigenvalue of the part of its errors that a fit leaves to a pose: of less, the pose alone
# determines a number, and its errors tell nothing about their deviation.
LEAST_LEFT = 1e-6
STEPS = 40
SMALL_GAIN = 2e-5  # of the objective, as a part: where the search ends
LEAST_GAIN = 1e-6  # in squares of standard deviations, where the errors are zero but for rounding
DAMPING = 1e-3
LEAST_DAMPING = 1e-9
MOST_DAMPING = 1e8
# of the range of the points, at most of 1 m: least scale, also of poses without noise
SHARPEST = 1e-6
FLAT = 1e-12  # part of the curvature along a number that directions without any information get
PROBE = 0.1  # part of a step over which its bend is measured
BEND = 0.4  # largest acceleration, as a part of the step
AS_PLANNED = 0.75  # of the gain that a step promised: a valley along which steps gain less bends
LEAST = 1e-3  # least compliance, as a part of that of the model: a stiffness of 1000 times


@dataclass(frozen=True)
class Minimum:
    """``x`` (p,), ``rest``, ``gap`` (N, k, 3), ``errors`` (N, k) [m], ``scale`` [m];
    ``converged``: it is one.

    ``damping``: of the last steps, where a search nearby starts; ``sizes`` (N, k): errors over the
    scale.
    """

    x: np.ndarray
    rest: Rest
    gap: np.ndarray
    errors: np.ndarray
    scale: float
    converged: bool
    damping: float
    sizes: np.ndarray


class Problem:
    """Measured positions, unknowns with their priors and bounds; see `fit`.

    ``whitening`` (N, 3 k, 3 k): with it the errors of a pose are ``W r`` with unit covariance, and
    count as one length; without it each point counts, over the scale. ``weights`` (N, k): factors
    of the errors.
    """

    def __init__(
        self,
        statics: Statics,
        measured: np.ndarray,
        unknowns: Sequence[Unknown],
        robust: bool,
        whitening: np.ndarray | None = None,
        weights: np.ndarray | None = None,
    ) -> None:
        self.statics = statics
        self.unknowns = unknowns
        self.robust = robust
        self.whitening = whitening
        self.weights = weights
        self.medians: np.ndarray | None = None
        if statics.touches is not None:
            self.medians = np.where(statics.touches.touched, MEDIAN_SIZE, MEDIAN_LENGTH)
        self.valid = np.isfinite(measured).all(axis=2)
        self.measured = np.where(self.valid[..., None], measured, 0.0)
        self.sharpest = SHARPEST * min(
            1.0, float(np.ptp(measured[self.valid], axis=0).max()) or 1.0
        )
        self.center = np.array([u.start for u in unknowns])
        self.precision = np.array([u.sd for u in unknowns]) ** -2.0
        self.lower = np.array(
            [LEAST * u.start if u.kind == "compliance" else -np.inf for u in unknowns]
        )

    def numbers(self, x: np.ndarray) -> Numbers:
        """All numbers of the tree."""
        return Numbers.of(self.statics.tree, self.unknowns, x)

    def evaluate(self, x: np.ndarray, near: Near | None) -> tuple[Rest, np.ndarray, np.ndarray]:
        """The rest, the differences (N, k, 3), and their lengths (N, k) [m].

        Differences are times their weights, and zero where nothing was measured.
        """
        rest = self.statics.rest(self.numbers(x), near)
        gap = np.where(self.valid[..., None], rest.measured - self.measured, 0.0)
        if self.weights is not None:
            gap = gap * self.weights[..., None]
        return rest, gap, np.linalg.norm(gap, axis=2)

    def scale(self, lengths: np.ndarray) -> float:
        """Standard deviation of one axis [m] from the median of the lengths."""
        if self.medians is not None:
            return max(float(np.median((lengths / self.medians)[self.valid])), self.sharpest)
        return max(float(np.median(lengths[self.valid])) / MEDIAN_LENGTH, self.sharpest)

    def objective(self, x: np.ndarray, gap: np.ndarray, scale: float) -> float:
        """The function that is minimized."""
        u, count = self._sizes(gap, scale)
        loss = np.where(u > TUNING, 2 * TUNING * u - TUNING**2, u**2) if self.robust else u**2
        return float(count * loss.sum() + (self.precision * (x - self.center) ** 2).sum())

    def _sizes(self, gap: np.ndarray, scale: float) -> tuple[np.ndarray, int]:
        """Sizes of the errors for the loss, (N, k), or with a whitening (N, 1) for k points; and
        this k, else 1.
        """
        if self.whitening is None:
            return np.linalg.norm(gap, axis=2) / scale, 1
        k = gap.shape[1]
        z = (self.whitening @ gap.reshape(len(gap), -1, 1))[..., 0]
        return np.linalg.norm(z, axis=1, keepdims=True) / np.sqrt(k), k

    def slopes(self, x: np.ndarray, rest: Rest, gap: np.ndarray, scale: float) -> Slopes:
        """Sums of the normal equations."""
        u, _ = self._sizes(gap, scale)
        weights = (
            np.minimum(1.0, TUNING / np.maximum(u, 1e-12)) if self.robust else np.ones(u.shape)
        )
        J, near = self.statics.slopes(self.numbers(x), rest, self.unknowns)
        J = np.where(self.valid[:, :, None, None], J, 0.0)
        if self.weights is not None:
            J = J * self.weights[:, :, None, None]
        N = len(J)
        p = len(x)
        rows = J.reshape(N, -1, p)
        r = gap.reshape(N, -1)
        if self.whitening is None:
            w = np.repeat(weights, 3, axis=1) / scale**2
        else:
            rows = self.whitening @ rows
            r = (self.whitening @ r[..., None])[..., 0]
            w = np.broadcast_to(weights, r.shape)
        rows = np.sqrt(w)[..., None] * rows
        r = np.sqrt(w) * r
        flat = rows.reshape(-1, p)
        return Slopes(flat.T @ flat, rows, r, self.precision * (x - self.center), np.sqrt(w), near)

    def curvature(self, slopes: Slopes) -> np.ndarray:
        """Half the curvature (p, p) of the objective, also along numbers without any
        information.
        """
        matrix = slopes.A + np.diag(self.precision)
        return np.asarray(matrix + FLAT * np.diag(np.diag(matrix)))

    def bend(self, x: np.ndarray, slopes: Slopes, step: np.ndarray) -> np.ndarray:
        """J' W y'' (p,), y'': second derivative of the positions along a step, from a small part
        of it.

        Raises
        ------
        SolverError
            There is no equilibrium.
        """
        _, gap, _ = self.evaluate(x + PROBE * step, slopes.near)
        r = gap.reshape(len(gap), -1)
        r = r if self.whitening is None else (self.whitening @ r[..., None])[..., 0]
        change = (slopes.roots * r - slopes.gaps) / PROBE
        return np.asarray(
            np.einsum("nr,nrp->p", 2.0 / PROBE * (change - slopes.rows @ step), slopes.rows)
        )


@dataclass(frozen=True)
class Slopes:
    """``A`` (p, p): J' W J; ``rows`` (N, 3 k, p): W^1/2 J of each pose; ``gaps`` (N, 3 k): W^1/2
    r; ``prior`` (p,).

    ``roots`` (N, 3 k): of the weights; ``near``: where equilibria of numbers nearby are searched
    from.
    """

    A: np.ndarray
    rows: np.ndarray
    gaps: np.ndarray
    prior: np.ndarray
    roots: np.ndarray
    near: Near

    @property
    def whole(self) -> np.ndarray:
        """Half the slope of the objective."""
        return np.asarray(np.einsum("nr,nrp->p", self.gaps, self.rows) + self.prior)

    def leave_out_each(self, free: np.ndarray, inverse: np.ndarray) -> np.ndarray:
        """J' W r (N, p) of each pose, r in a fit without the pose.

        ``inverse``: of the Hessian of the free numbers. A pose that determines a number alone has
        no errors in any fit: it has one row for each error, of the size of the scale.
        """
        rows = self.rows[:, :, free]
        # part of its errors that the fit leaves
        own = np.eye(rows.shape[1]) - rows @ inverse @ rows.transpose(0, 2, 1)
        alone = np.linalg.eigvalsh(own)[:, 0] < LEAST_LEFT
        if alone.any():
            own[alone] = np.eye(rows.shape[1])
        g = np.einsum("nr,nrp->np", np.linalg.solve(own, self.gaps[..., None])[..., 0], rows)
        if not alone.any():
            return np.asarray(g)
        return np.concatenate([g[~alone], rows[alone].reshape(-1, rows.shape[2])])


def fit(
    problem: Problem,
    start: np.ndarray,
    near: Near | None = None,
    damping: float = DAMPING,
    progress: Callable[[str], None] | None = None,
) -> Minimum:
    """Minimize the objective from the values ``start`` (p,); ``near``: where the search for
    equilibria starts.

    Raises
    ------
    SolverError
        There is no equilibrium at the start.
    """
    x = np.maximum(start.astype(float), problem.lower)
    converged = False
    straight = True
    rest, gap, lengths = problem.evaluate(x, near)
    best_known()
    with keep_best():
        for count in range(STEPS):
            if is_over():
                break
            check_time("calibrate")
            scale = problem.scale(lengths)
            if progress is not None:
                progress(f"step {count}: mean error {1e3 * lengths[problem.valid].mean():.3f} mm")
            slopes = problem.slopes(x, rest, gap, scale)
            matrix = slopes.A + np.diag(problem.precision)
            before = problem.objective(x, gap, scale)
            after = np.inf
            given = damping
            while damping < MOST_DAMPING:
                damped = matrix + damping * np.diag(np.diag(matrix))
                try:
                    step = _bounded_step(damped, slopes.whole, problem.lower - x)
                    there = x + (
                        step if straight else _bent_step(problem, x, slopes, damped, step)
                    )
                    trial = problem.evaluate(there, slopes.near)
                    after = problem.objective(there, trial[1], scale)
                except SolverError:
                    after = np.inf
                if after <= before:
                    break
                damping = 10.0 * damping
                straight = False
            if not after <= before:
                converged = True  # no step along the slope lowers the objective: rounding
                break
            step = there - x
            planned = -(2.0 * slopes.whole @ step + step @ matrix @ step)
            straight = damping == given and before - after > AS_PLANNED * planned
            x = there
            rest, gap, lengths = trial
            damping = max(damping / 10.0, LEAST_DAMPING)
            if before - after < SMALL_GAIN * before + LEAST_GAIN:
                converged = True
                break
    scale = problem.scale(lengths)
    sizes = np.where(problem.valid, lengths / scale, np.nan)
    errors = np.where(problem.valid, lengths, np.nan)
    if problem.weights is not None:
        errors = errors / problem.weights
    return Minimum(x, rest, gap, errors, scale, converged, damping, sizes)


def _bent_step(
    problem: Problem, x: np.ndarray, slopes: Slopes, matrix: np.ndarray, step: np.ndarray
) -> np.ndarray:
    """The step, and where it is small against that, the acceleration along a valley that bends."""
    least = problem.lower - x
    more = np.where(
        step > least, -0.5 * np.linalg.solve(matrix, problem.bend(x, slopes, step)), 0.0
    )
    size = np.diag(matrix)
    small = size @ more**2 < BEND**2 * (size @ step**2)
    return np.maximum(step + more, least) if small else step


def _bounded_step(matrix: np.ndarray, slope: np.ndarray, least: np.ndarray) -> np.ndarray:
    """The step with ``step >= least`` that minimizes ``2 slope' step + step' matrix step``: an
    active set.
    """
    held = np.zeros(len(slope), bool)
    step = np.zeros(len(slope))
    for _ in range(2 * len(slope)):
        free = ~held
        step[held] = least[held]
        step[free] = -np.linalg.solve(
            matrix[np.ix_(free, free)], slope[free] + matrix[np.ix_(free, held)] @ least[held]
        )
        low = free & (step < least)
        if low.any():
            held |= low
            continue
        force = slope + matrix @ step  # >= 0 where a bound has to hold
        released = held & (force < -1e-9 * np.abs(slope).max())
        if not released.any():
            break
        held[np.argmin(np.where(released, force, np.inf))] = False
    return np.maximum(step, least)
