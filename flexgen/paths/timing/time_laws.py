"""Rest-to-rest time laws: distance along a path over time, with derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import comb, factorial
from typing import ClassVar, Protocol

import numpy as np
from scipy.interpolate import BSpline

from flexgen.base.errors import ArgumentError


class Law(Protocol):
    """Distance along a path over time; at rest before 0 and from ``duration`` [s] on.

    ``smoothness``: number of continuous derivatives. ``breaks``: instants at which higher ones may
    jump.
    """

    @property
    def duration(self) -> float:
        """Duration [s]."""
        ...

    @property
    def smoothness(self) -> int:
        """Number of continuous derivatives."""
        ...

    @property
    def breaks(self) -> np.ndarray:
        """Instants at which higher derivatives may jump [s]."""
        ...

    def __call__(self, t: np.ndarray, order: int = 5) -> np.ndarray:
        """Values and derivatives (n, order + 1) at the instants ``t`` [s]."""
        ...


@dataclass(frozen=True)
class TimeLaw:
    """The shortest polynomial from 0 to ``length`` whose first ``smoothness`` derivatives vanish
    at both ends.

    ``s(u) = c int_0^u x^k (1 - x)^k dx``, ``c = (2k + 1)!/(k!)^2``, u = t / duration, constant
    outside [0, duration]: a polynomial of degree 2k + 1, k times continuously differentiable in
    time.

    Source: L. Biagiotti, C. Melchiorri, Trajectory Planning for Automatic Machines and Robots,
    2008, sec. 2.1.7.
    """

    duration: float
    smoothness: int
    length: float = 1.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.duration) and self.duration > 0):
            raise ArgumentError(f"duration: given {self.duration}, expected a time > 0 [s]")
        if not 0 <= self.smoothness <= 9:
            raise ArgumentError(
                f"smoothness: given {self.smoothness}, expected 0 to 9 continuous derivatives"
            )

    @property
    def breaks(self) -> np.ndarray:
        """The two ends."""
        return np.array([0.0, self.duration])

    @cached_property
    def polynomial(self) -> np.polynomial.Polynomial:
        """From 0 to 1 within 0 to 1."""
        k = self.smoothness
        scale = factorial(2 * k + 1) / factorial(k) ** 2
        coefficients = np.zeros(2 * k + 2)
        for i in range(k + 1):
            coefficients[k + i + 1] = scale * comb(k, i) * (-1) ** i / (k + i + 1)
        return np.polynomial.Polynomial(coefficients)

    def __call__(self, t: np.ndarray, order: int = 5) -> np.ndarray:
        """``s`` and its time derivatives at the instants ``t`` [s], shape (n, order + 1), 1/s^j in
        column j.
        """
        law = self.polynomial
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
        return out if self.length == 1.0 else self.length * out

    def with_integral(self, t: np.ndarray, order: int = 5) -> np.ndarray:
        """Integral of the law, the law and its derivatives at ``t`` in [0, duration], shape (n,
        order + 1).
        """
        t = np.clip(t, 0.0, self.duration)
        inner = self.polynomial.integ()
        u = t / self.duration
        late = u > 0.5
        value = inner(np.where(late, 1.0 - u, u))
        area = self.duration * np.where(late, u - 0.5 + value, value)
        return np.column_stack([self.length * area, self(t, order - 1)])


@dataclass(frozen=True)
class SplineLaw:
    """A B-spline of degree 7 from 0 to ``length``, at rest with five derivatives zero at both
    ends.

    ``inner``: its coefficients between the first six, which are 0, and the last six, which are 1;
    where they do not decrease, neither does the distance. The knots are equidistant: six
    derivatives are continuous inside.
    """

    duration: float
    inner: tuple[float, ...]
    length: float = 1.0

    DEGREE: ClassVar[int] = 7

    def __post_init__(self) -> None:
        if not (np.isfinite(self.duration) and self.duration > 0):
            raise ArgumentError(f"duration: given {self.duration}, expected a time > 0 [s]")
        if not 1 <= len(self.inner) <= 200 or not np.isfinite(self.inner).all():
            raise ArgumentError(
                f"timing: given {len(self.inner)} coefficients, expected 1 to 200 finite numbers"
            )

    @property
    def smoothness(self) -> int:
        """Five derivatives vanish at both ends."""
        return 5

    @property
    def breaks(self) -> np.ndarray:
        """The two ends; inside, derivatives up to order six are continuous."""
        return np.array([0.0, self.duration])

    @cached_property
    def spline(self) -> BSpline:
        """From 0 to 1 within 0 to 1."""
        ends = 6
        k = self.DEGREE
        c = np.concatenate([np.zeros(ends), self.inner, np.ones(ends)])
        knots = np.concatenate([np.zeros(k), np.linspace(0.0, 1.0, len(c) - k + 1), np.ones(k)])
        return BSpline(knots, c, k)

    def __call__(self, t: np.ndarray, order: int = 5) -> np.ndarray:
        """``s`` and its time derivatives at the instants ``t`` [s], shape (n, order + 1), 1/s^j in
        column j.
        """
        t = np.asarray(t, dtype=float)
        u = np.clip(t / self.duration, 0.0, 1.0)
        inside = (t > 0) & (t < self.duration)
        out = np.zeros((len(u), order + 1))
        out[:, 0] = np.where(u >= 1.0, 1.0, self.spline(u))
        for j in range(1, order + 1):
            out[:, j] = np.where(inside, self.spline(u, j) / self.duration**j, 0.0)
        return out if self.length == 1.0 else self.length * out


@dataclass(frozen=True)
class Clock:
    """The law of a path whose parameter is the time: distance equals time, from 0 to ``duration``
    [s].

    ``smoothness``: number of continuous derivatives of the path at its start and end, where it
    must be at rest.
    """

    duration: float
    smoothness: int

    @property
    def breaks(self) -> np.ndarray:
        """The two ends."""
        return np.array([0.0, self.duration])

    def __call__(self, t: np.ndarray, order: int = 5) -> np.ndarray:
        """Time and its derivatives, zero outside, shape (n, order + 1)."""
        t = np.asarray(t, dtype=float)
        out = np.zeros((len(t), order + 1))
        out[:, 0] = np.clip(t, 0.0, self.duration)
        out[:, 1] = (t > 0) & (t < self.duration)
        return out
