"""Arc length of a curve over its parameter, and the parameter at a given arc length, to
rounding.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)
NEWTON_STEPS = 12  # at most; three are enough


class ArcTable:
    """Arc length over the parameter: integral of ``speed``, u (n,) to |dp/du| > 0 (n,), between
    ``knots`` (m + 1).
    """

    def __init__(self, speed: Callable[[np.ndarray], np.ndarray], knots: np.ndarray) -> None:
        self.speed = speed
        self.knots = knots
        panels = self._integral(knots[:-1], knots[1:])
        self.lengths = np.concatenate([[0.0], np.cumsum(panels)])

    @property
    def resolution(self) -> float:
        """A step of Newton's method that is rounding."""
        return 4e-16 * max(1.0, float(np.abs(self.knots).max()))

    @property
    def length(self) -> float:
        """Arc length of the whole curve."""
        return float(self.lengths[-1])

    def _integral(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Arc length (m,) between the parameters a and b (m,), by Gauss quadrature of speed."""
        half = (b - a) / 2
        points = (a + half)[:, None] + half[:, None] * NODES
        speeds = self.speed(points.ravel()).reshape(points.shape)
        total = np.zeros(len(half))
        for j, weight in enumerate(WEIGHTS):  # one order of operations, also in C
            total = total + speeds[:, j] * weight
        return half * total

    def parameter(self, s: np.ndarray) -> np.ndarray:
        """The parameter (n,) at the arc lengths ``s`` (n,)."""
        panel = np.clip(np.searchsorted(self.lengths, s, side="right") - 1, 0, len(self.knots) - 2)
        low = self.knots[panel]
        high = self.knots[panel + 1]
        remaining = s - self.lengths[panel]
        u = low + remaining / (self.lengths[panel + 1] - self.lengths[panel]) * (high - low)
        moving = np.arange(len(u))  # a point does not depend on the others
        for _ in range(NEWTON_STEPS):
            if not len(moving):
                break
            a = low[moving]
            b = high[moving]
            step = (self._integral(a, u[moving]) - remaining[moving]) / self.speed(u[moving])
            u[moving] = np.clip(u[moving] - step, a, b)
            moving = moving[np.abs(step) > self.resolution]
        return u
