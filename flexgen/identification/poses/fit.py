"""Static poses as a problem of estimation: robust least squares with Gaussian priors, see
`flexgen.identification.estimator`.

    min  sum rho(|y - y_measured| / s) + sum ((x - x_0)/sd)^2,
    rho(u) = u^2 for u <= k, 2 k u - k^2 beyond

One length per point and not one per axis, so that the fit does not depend on the axes. The scale
``s`` is the median of the errors over 1.54, the median of the length of a vector of three unit
Gaussians; of touches and readings of one number over 0.674. Errors with a stated standard
deviation are divided by it, over the median of those that are stated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from flexgen.identification.estimator.minimize import Search, minimize
from flexgen.identification.estimator.problem import (
    Huber,
    Linearization,
    Loss,
    Prior,
    Problem,
    Squares,
)
from flexgen.identification.poses.parameters import Unknown
from flexgen.identification.poses.statics import Near, Numbers, Rest, Statics

TUNING = 2.5  # k of Huber's function: 2.5 standard deviations of one axis
MEDIAN_LENGTH = 1.538172  # of a vector of three unit Gaussians
MEDIAN_SIZE = 0.6744898  # of one unit Gaussian, without its sign
STEPS = 40
SMALL_GAIN = 1e-6  # of the objective, as a part: where the search ends
# of the range of the points, at most of 1 m: least scale, also of poses without noise
SHARPEST = 1e-6
LEAST = 1e-3  # least compliance, as a part of that of the model: a stiffness of 1000 times


@dataclass(frozen=True)
class Minimum:
    """``x`` (p,), ``rest``, ``errors`` (N, k) [m], ``scale`` [m]; ``converged``: it is one.

    ``sizes`` (N, k): errors over the scale.
    """

    x: np.ndarray
    rest: Rest
    errors: np.ndarray
    scale: float
    converged: bool
    sizes: np.ndarray


class Poses(Problem):
    """Measured positions, unknowns with their priors and bounds; see `fit`.

    ``whitening`` (N, 3 k, 3 k): with it the errors of a pose are ``W r`` with unit covariance, and
    count as one length; without it each point counts, over the scale. ``weights`` (N, k): factors
    of the errors. ``fixed_scale`` [m]: of the errors, where it is known.
    """

    def __init__(
        self,
        statics: Statics,
        measured: np.ndarray,
        unknowns: Sequence[Unknown],
        robust: bool,
        whitening: np.ndarray | None = None,
        weights: np.ndarray | None = None,
        fixed_scale: float | None = None,
    ) -> None:
        self.statics = statics
        self.robust = robust
        self.fixed_scale = fixed_scale
        self.weights = weights
        self.medians: np.ndarray | float = MEDIAN_LENGTH
        if statics.touches is not None:
            self.medians = np.where(statics.touches.touched, MEDIAN_SIZE, MEDIAN_LENGTH)
        self.unknowns = unknowns
        self.whitening = whitening
        self.valid = np.isfinite(measured).all(axis=2)
        self.measured = np.where(self.valid[..., None], measured, 0.0)
        self.sharpest = SHARPEST * min(
            1.0, float(np.ptp(measured[self.valid], axis=0).max()) or 1.0
        )
        # where equilibria of numbers nearby are searched from
        self.near: Near | None = None
        start = np.array([u.start for u in unknowns])
        lower = np.array(
            [LEAST * u.start if u.kind == "compliance" else -np.inf for u in unknowns]
        )
        bounds = lower, np.full(len(unknowns), np.inf)
        prior = Prior.of_sd(start, np.array([u.sd for u in unknowns]))
        super().__init__(self._residuals, self._slopes, prior, bounds, self._loss(robust))

    def _loss(self, robust: bool) -> Loss:
        points = self.measured.shape[1]
        if self.whitening is not None:
            return Huber(TUNING, 3 * points, points=points) if robust else Squares()
        return Huber(TUNING, 3, self._scale_of) if robust else Squares(self._scale_of)

    @property
    def lower(self) -> np.ndarray:
        """Least x (p,)."""
        return self.bounds[0]

    def numbers(self, x: np.ndarray) -> Numbers:
        """All numbers of the tree."""
        return Numbers.of(self.statics.tree, self.unknowns, x)

    def rest(self, x: np.ndarray) -> Rest:
        """The rest of the arm at the poses.

        Raises
        ------
        SolverError
            There is no equilibrium.
        """
        return self.statics.rest(self.numbers(x), self.near)

    def lengths(self, rest: Rest) -> np.ndarray:
        """Distances (N, k) [m] from the measured points, times weights; zero where nothing was
        measured.
        """
        return np.linalg.norm(self._gap(rest), axis=2)

    def scale(self, lengths: np.ndarray) -> float:
        """Standard deviation of one axis [m] from the median of the lengths."""
        return max(float(np.median((lengths / self.medians)[self.valid])), self.sharpest)

    def _scale_of(self, residual: np.ndarray) -> float:
        if self.fixed_scale is not None:
            return self.fixed_scale
        return self.scale(np.linalg.norm(residual.reshape(*self.valid.shape, 3), axis=2))

    def _gap(self, rest: Rest) -> np.ndarray:
        gap = np.where(self.valid[..., None], rest.measured - self.measured, 0.0)
        return gap if self.weights is None else gap * self.weights[..., None]

    def _whiten(self, rows: np.ndarray) -> np.ndarray:
        """Rows (N, 3 k, ...) whose errors have unit covariance."""
        return rows if self.whitening is None else self.whitening @ rows

    def _residuals(self, x: np.ndarray) -> np.ndarray:
        self._rest = self.rest(x)
        gap = self._gap(self._rest)
        return self._whiten(gap.reshape(len(gap), -1, 1)).ravel()

    def whiten_columns(self, columns: np.ndarray) -> np.ndarray:
        """Derivatives (N, k, 3, m) of the measured positions as those of the residuals,
        (3 k N, m).
        """
        J = np.where(self.valid[:, :, None, None], columns, 0.0)
        if self.weights is not None:
            J = J * self.weights[:, :, None, None]
        return self._whiten(J.reshape(len(J), -1, J.shape[-1])).reshape(-1, J.shape[-1])

    def _slopes(self, x: np.ndarray) -> np.ndarray:
        J, self.near = self.statics.slopes(self.numbers(x), self._rest, self.unknowns)
        return self.whiten_columns(J)


def fit(
    problem: Poses,
    start: np.ndarray,
    near: Near | None = None,
    progress: Callable[[str], None] | None = None,
) -> Minimum:
    """Minimize the objective from the values ``start`` (p,); ``near``: where the search for
    equilibria starts.

    Raises
    ------
    SolverError
        There is no equilibrium at the start.
    """
    problem.near = near

    def tell(step: int, here: Linearization) -> None:
        if progress is None:
            return
        mean = problem.lengths(problem.rest(here.x))[problem.valid].mean()
        progress(f"step {step - 1}: mean error {1e3 * mean:.3f} mm")

    # numbers of different units, which move together along arcs
    search = Search(
        gain=SMALL_GAIN, steps=STEPS, curvature=True, bends=True, stage="calibrate", tell=tell
    )
    found = minimize(problem, start.astype(float), search)
    rest = problem.rest(found.x)
    lengths = problem.lengths(rest)
    scale = problem.scale(lengths)
    sizes = np.where(problem.valid, lengths, np.nan) / scale
    touches = problem.statics.touches
    levels = False if touches is None else touches.levels  # no distances
    errors = np.where(problem.valid & ~np.array(levels), lengths, np.nan)
    if problem.weights is not None:
        errors = errors / problem.weights
    return Minimum(found.x, rest, errors, scale, found.converged, sizes)
