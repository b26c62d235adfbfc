"""Rest-to-rest time laws: how far along a path, at which instant, with derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, factorial

import numpy as np

from flexgen.errors import ArgumentError


@dataclass(frozen=True)
class TimeLaw:
    """The shortest polynomial from 0 to 1 whose first ``smoothness`` derivatives vanish at both ends.

    ``s(u) = c int_0^u x^k (1 - x)^k dx``, ``c = (2k + 1)!/(k!)^2``, u = t / duration, constant outside [0, duration]: a
    polynomial of degree 2k + 1, k times continuously differentiable in time.

    Source: L. Biagiotti, C. Melchiorri, Trajectory Planning for Automatic Machines and Robots, 2008, sec. 2.1.7.
    """

    duration: float
    smoothness: int

    def __post_init__(self) -> None:
        if not (np.isfinite(self.duration) and self.duration > 0):
            raise ArgumentError(f"duration: given {self.duration}, expected a positive time in s")
        if not 0 <= self.smoothness <= 9:
            raise ArgumentError(f"smoothness: given {self.smoothness}, expected 0 to 9 continuous derivatives")

    def __call__(self, t: np.ndarray, order: int = 5) -> np.ndarray:
        """``s`` and its time derivatives at the instants ``t`` [s], shape (n, order + 1), unit 1/s^j in column j."""
        k = self.smoothness
        scale = factorial(2 * k + 1) / factorial(k) ** 2
        coefficients = np.zeros(2 * k + 2)
        for i in range(k + 1):
            coefficients[k + i + 1] = scale * comb(k, i) * (-1) ** i / (k + i + 1)
        law = np.polynomial.Polynomial(coefficients)
        u = np.clip(np.asarray(t, dtype=float) / self.duration, 0.0, 1.0)
        late = u > 0.5  # s(1 - u) = 1 - s(u): evaluating near zero keeps the digits
        x = np.where(late, 1.0 - u, u)
        inside = (np.asarray(t) > 0) & (np.asarray(t) < self.duration)
        out = np.zeros((len(u), order + 1))
        for j in range(order + 1):
            value = law(x) if j == 0 else law.deriv(j)(x)
            if j == 0:
                out[:, 0] = np.where(late, 1.0 - value, value)
            else:
                sign = np.where(late, (-1.0) ** (j + 1), 1.0)
                out[:, j] = np.where(inside, sign * value / self.duration**j, 0.0)
        return out
