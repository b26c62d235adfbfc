"""Problems of estimation: weighted least squares with a loss, a Gaussian prior and bounds.

    min  sum rho(|r_i(x)| / s) + (x - x_0)' P (x - x_0),      lower <= x <= upper

r: residuals, in groups i that count as one length; s: their scale, which a loss may take anew from
the residuals at each step; P: information of the prior. The function is linearized for a step to

    value + 2 g's + s'A s,      A = J' W J,  g = J' W r,      W: weights of the loss at x

Where residuals are too many to be stored, a problem is stated by its sums: value, g and A.

Source: P. J. Huber, Robust Statistics, 1981, ch. 7 (losses, scales from the residuals).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

Sums = tuple[float, np.ndarray, np.ndarray]  # value, g, A
Scale = Callable[[np.ndarray], float]
Bounds = tuple[np.ndarray, np.ndarray]  # lower and upper (n,)

LEAST_SIZE = 1e-12  # of a residual over its scale, so that its weight is finite


def _one(residual: np.ndarray) -> float:
    return 1.0


@dataclass(frozen=True)
class Prior:
    """Gaussian prior: ``center`` (n,), ``information`` (n, n), the inverse of its covariance."""

    center: np.ndarray
    information: np.ndarray

    @classmethod
    def of_sd(cls, center: np.ndarray, sd: np.ndarray) -> Prior:
        """Independent numbers with standard deviations (n,); infinity: nothing is known."""
        return cls(center, np.diag(np.asarray(sd, float) ** -2.0))

    @classmethod
    def nothing(cls, count: int) -> Prior:
        """The prior of numbers of which nothing is known."""
        return cls(np.zeros(count), np.zeros((count, count)))

    def value(self, x: np.ndarray) -> float:
        """``(x - x_0)' P (x - x_0)``."""
        away = x - self.center
        return float(away @ self.information @ away)

    def slope(self, x: np.ndarray) -> np.ndarray:
        """Half the gradient of `value` (n,)."""
        return np.asarray(self.information @ (x - self.center))


@dataclass(frozen=True)
class Squares:
    """Loss ``sum (r/s)^2``; ``scale``: s from the residuals, 1 by default."""

    scale: Scale = _one

    def value(self, residual: np.ndarray, scale: float) -> float:
        """Sum of the losses."""
        return float(residual @ residual) / scale**2

    def roots(self, residual: np.ndarray, scale: float) -> np.ndarray:
        """Roots of the weights W of the residuals (N,)."""
        return np.full(len(residual), 1.0 / scale)


@dataclass(frozen=True)
class Huber:
    """Loss of lengths: ``rho(u) = u^2`` up to ``tuning`` k, ``2 k u - k^2`` beyond, which limits
    gross errors.

    Parameters
    ----------
    tuning : float
        k, in standard deviations of one residual.
    rows : int
        Residuals of a group, whose length u counts.
    scale : callable
        s from the residuals.
    points : int
        Number of points in each group of equal lengths: its loss is
        ``points * rho(|r|/(s sqrt(points)))``.
    """

    tuning: float
    rows: int = 1
    scale: Scale = _one
    points: int = 1

    def _sizes(self, residual: np.ndarray, scale: float) -> np.ndarray:
        lengths = np.linalg.norm(residual.reshape(-1, self.rows), axis=1)
        return np.asarray(lengths / (scale * np.sqrt(self.points)))

    def value(self, residual: np.ndarray, scale: float) -> float:
        """Sum of the losses."""
        k = self.tuning
        u = self._sizes(residual, scale)
        return float(self.points * np.where(u > k, 2 * k * u - k**2, u**2).sum())

    def roots(self, residual: np.ndarray, scale: float) -> np.ndarray:
        """Roots of the weights W of the residuals (N,)."""
        sizes = np.maximum(self._sizes(residual, scale), LEAST_SIZE)
        weights = np.minimum(1.0, self.tuning / sizes)
        return np.repeat(np.sqrt(weights), self.rows) / scale


Loss = Squares | Huber


@dataclass(frozen=True)
class Linearization:
    """A problem at x, for one step.

    Parameters
    ----------
    x : array (n,)
    value : float
        Loss without the prior.
    slope, matrix : arrays (n,), (n, n)
        g and A, without the prior.
    cost : callable
        Loss at other x, with the scale that it has here.
    rows, gaps : arrays (N, n), (N,)
        W^(1/2) J and W^(1/2) r; empty where the problem is stated by sums.
    roots : array (N,)
        W^(1/2).
    """

    x: np.ndarray
    value: float
    slope: np.ndarray
    matrix: np.ndarray
    cost: Callable[[np.ndarray], float]
    rows: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    gaps: np.ndarray = field(default_factory=lambda: np.zeros(0))
    roots: np.ndarray = field(default_factory=lambda: np.zeros(0))


class Problem:
    """A problem of estimation.

    Parameters
    ----------
    residual : callable
        x (n,) -> r (N,). It may raise SolverError where the model has no solution; such a step is
        refused.
    jacobian : callable
        x (n,) -> J (N, n), called where the residual was called last.
    prior : Prior
    bounds : (lower, upper), arrays (n,)
    loss : Squares or Huber

    Examples
    --------
    >>> import numpy as np
    >>> from flexgen.identification.estimator.minimize import minimize
    >>> from flexgen.identification.estimator.problem import Prior, Problem
    >>> free = np.full(1, np.inf)
    >>> problem = Problem(
    ...     lambda x: x - np.array([1.0, 3.0]),
    ...     lambda x: np.ones((2, 1)),
    ...     Prior.nothing(1),
    ...     (-free, free),
    ... )
    >>> print(minimize(problem, np.zeros(1)).x)
    [2.]
    """

    def __init__(
        self,
        residual: Callable[[np.ndarray], np.ndarray],
        jacobian: Callable[[np.ndarray], np.ndarray],
        prior: Prior,
        bounds: Bounds,
        loss: Loss | None = None,
    ) -> None:
        self._residual = residual
        self._jacobian = jacobian
        self.prior = prior
        self.bounds = bounds
        self.loss = Squares() if loss is None else loss
        self._known: tuple[np.ndarray, np.ndarray] | None = None

    @staticmethod
    def of_sums(
        sums: Callable[[np.ndarray], Sums],
        cost: Callable[[np.ndarray], float],
        prior: Prior,
        bounds: Bounds,
    ) -> Problem:
        """The problem whose residuals are not stored: ``value, g, A`` at x, and the value
        alone.
        """
        return _Summed(sums, cost, prior, bounds)

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Residuals (N,); those of the last x are kept."""
        if self._known is None or not np.array_equal(self._known[0], x):
            self._known = x.copy(), self._residual(x)
        return self._known[1]

    def linearize(self, x: np.ndarray) -> Linearization:
        """The problem at x."""
        r = self.residual(x)
        scale = self.loss.scale(r)
        roots = self.loss.roots(r, scale)
        rows = roots[:, None] * self._jacobian(x)
        gaps = roots * r

        def cost(there: np.ndarray) -> float:
            return self.loss.value(self.residual(there), scale)

        value = self.loss.value(r, scale)
        return Linearization(x, value, rows.T @ gaps, rows.T @ rows, cost, rows, gaps, roots)


class _Summed(Problem):
    """A problem by its sums."""

    def __init__(
        self,
        sums: Callable[[np.ndarray], Sums],
        cost: Callable[[np.ndarray], float],
        prior: Prior,
        bounds: Bounds,
    ) -> None:
        self._sums = sums
        self._cost = cost
        self.prior = prior
        self.bounds = bounds

    def linearize(self, x: np.ndarray) -> Linearization:
        """The problem at x."""
        return Linearization(x, *self._sums(x), self._cost)


def as_real(r: np.ndarray, J: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Complex residuals and derivatives (..., n) as real numbers, (2 N,) and (2 N, n)."""
    assert J is not None
    flat = J.reshape(-1, J.shape[-1])
    return stack(r), np.vstack([flat.real, flat.imag])


def stack(r: np.ndarray) -> np.ndarray:
    """Complex numbers as real ones (2 N,)."""
    return np.concatenate([r.real.ravel(), r.imag.ravel()])


def normal(r: np.ndarray, J: np.ndarray | None) -> Sums:
    """The sums of complex residuals and their derivatives: ``|r|^2``, ``Re J^H r``,
    ``Re J^H J``.
    """
    flat, real = as_real(r, J)
    return float(flat @ flat), real.T @ flat, real.T @ real
