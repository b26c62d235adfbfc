"""Arc length of a curve over its parameter, and the parameter at a given arc length, to rounding."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)
STEPS = 12  # of Newton's method; it converges in three


class ArcTable:
    """Integral of ``rate`` (parameter values (n,) to (n,), positive) over the panels between ``knots`` (m + 1)."""

    def __init__(self, rate: Callable[[np.ndarray], np.ndarray], knots: np.ndarray) -> None:
        self.rate, self.knots = rate, knots
        panels = self._integral(knots[:-1], knots[1:])
        self.lengths = np.concatenate([[0.0], np.cumsum(panels)])

    @property
    def length(self) -> float:
        """Of the whole curve."""
        return float(self.lengths[-1])

    def _integral(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        half = (b - a) / 2
        points = (a + half)[:, None] + half[:, None] * NODES
        return half * (self.rate(points.ravel()).reshape(points.shape) @ WEIGHTS)

    def parameter(self, s: np.ndarray) -> np.ndarray:
        """The parameter (n,) at the arc lengths ``s`` (n,)."""
        at = np.clip(np.searchsorted(self.lengths, s, side="right") - 1, 0, len(self.knots) - 2)
        low, high = self.knots[at], self.knots[at + 1]
        rest = s - self.lengths[at]
        u = low + rest / (self.lengths[at + 1] - self.lengths[at]) * (high - low)
        for _ in range(STEPS):
            step = (self._integral(low, u) - rest) / self.rate(u)
            u = np.clip(u - step, low, high)
            if np.abs(step).max(initial=0.0) <= 4e-16 * max(1.0, float(np.abs(self.knots).max())):
                break
        return u
