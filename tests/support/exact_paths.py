"""Independent paths in 60 digits: positions from their definition, derivatives by differences in
high precision.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import comb
from typing import Any

import mpmath as mp
import numpy as np

DIGITS = 60
Function = Callable[[Any], list]


def polynomial_law(duration: float, k: int) -> Callable[[Any], Any]:
    """The rest-to-rest polynomial from 0 to 1, by its defining integral."""

    def law(t: Any) -> Any:
        u = t / mp.mpf(duration)
        area = sum(
            (-1) ** i * mp.mpf(comb(k, i)) * u ** (k + i + 1) / (k + i + 1) for i in range(k + 1)
        )
        return area * mp.factorial(2 * k + 1) / mp.factorial(k) ** 2

    return law


def derivatives(f: Function, t: float, order: int) -> np.ndarray:
    """Derivatives 0 to ``order`` of each entry of f at t, (entries, order + 1), from its values at
    nine instants.

    The error of the polynomial through them is of the order h^(9 - order), negligible in double
    precision.
    """
    with mp.workdps(DIGITS):
        h = mp.mpf(10) ** -8
        values = mp.matrix([f(mp.mpf(t) + k * h) for k in range(-4, 5)])
        powers = mp.matrix(
            [[mp.mpf(k) ** j / mp.factorial(j) for j in range(9)] for k in range(-4, 5)]
        )
        taylor = mp.inverse(powers) * values
        return np.array(
            [[float(taylor[j, i] / h**j) for j in range(order + 1)] for i in range(values.cols)]
        )


def turn(axis: Sequence[float], angle: Any) -> Any:
    """Rotation matrix about an axis of any length."""
    a = mp.matrix([mp.mpf(x) for x in axis])
    a = a / mp.norm(a)
    hat = mp.matrix([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    return mp.eye(3) + mp.sin(angle) * hat + (1 - mp.cos(angle)) * hat * hat


def spin(entries: np.ndarray) -> np.ndarray:
    """Angular velocity and derivatives (3, k) from the derivatives (9, k + 1) of a rotation
    matrix, rows in turn.
    """
    R = entries.reshape(3, 3, -1)
    out = np.zeros((3, R.shape[2] - 1))
    for k in range(out.shape[1]):
        S = sum(comb(k, i) * R[:, :, i + 1] @ R[:, :, k - i].T for i in range(k + 1))
        out[:, k] = (S[2, 1] - S[1, 2]) / 2, (S[0, 2] - S[2, 0]) / 2, (S[1, 0] - S[0, 1]) / 2
    return out


def bump_integrals(k: int) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """The step a'(x) on [-1, 1] and its integral a(x), from the bump (1 - x^2)^k by exact
    integration.
    """

    def terms() -> tuple[list, Any]:
        parts = [((-1) ** i * mp.mpf(comb(k, i)), 2 * i) for i in range(k + 1)]
        return parts, sum(2 * c / (n + 1) for c, n in parts)

    def step(x: Any) -> Any:
        parts, whole = terms()
        return sum(c * (x ** (n + 1) + 1) / (n + 1) for c, n in parts) / whole

    def area(x: Any) -> Any:
        parts, whole = terms()
        return sum(c * ((x ** (n + 2) - 1) / (n + 2) + x + 1) / (n + 1) for c, n in parts) / whole

    return step, area


def corner_pace(d1: Sequence[Any], d2: Sequence[Any]) -> Callable[[Any], Any]:
    """Speed in a rounded corner between unit directions, against its parameter x in [-1, 1]."""
    step, _ = bump_integrals(4)
    c = sum(a * b for a, b in zip(d1, d2, strict=True))
    return lambda x: mp.sqrt((1 - step(x)) ** 2 + step(x) ** 2 + 2 * step(x) * (1 - step(x)) * c)


def corner_length(d1: Sequence[Any], d2: Sequence[Any], zone: Any) -> Any:
    """Arc length of a rounded corner."""
    return zone * mp.quad(corner_pace(d1, d2), [-1, 0, 1], method="gauss-legendre")


def corner_point(d1: Sequence[Any], d2: Sequence[Any], zone: Any, arc: Any) -> Any:
    """Where a rounded corner is, ``arc`` after its start: its parameter x in [-1, 1]."""
    pace = corner_pace(d1, d2)
    x = -1 + arc / zone
    for _ in range(9):  # Newton's method doubles the digits
        covered = zone * mp.quad(pace, [-1, (x - 1) / 2, x], method="gauss-legendre")
        x = x - (covered - arc) / (zone * pace(x))
    return x
