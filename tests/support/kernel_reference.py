"""Minimax polynomials of the kernel by Remez' exchange, at 50 digits: where the kernel's
coefficients come from.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import mpmath as mp

Function = Callable[[mp.mpf], mp.mpf]
DIGITS = 50


def minimax(
    f: Function, weight: Function, low: mp.mpf, high: mp.mpf, count: int
) -> tuple[list[mp.mpf], float]:
    """Polynomial with ``count`` coefficients that minimises the largest
    ``|weight (polynomial - f)|`` on an interval.

    Remez' exchange: the error of the best polynomial takes its largest size at ``count + 1``
    points with alternating signs. Solve for the polynomial whose error does so at given points,
    move the points to the extrema, repeat.

    Parameters
    ----------
    f, weight : callable
        What is approximated, and how much an error counts.
    low, high : mpf
        The interval.
    count : int
        Number of coefficients.

    Returns
    -------
    tuple of list of mpf, float
        Coefficients of 1, x, x^2, ..., and the largest weighted error.
    """
    with mp.workdps(DIGITS):
        middle = (high + low) / 2
        half = (high - low) / 2
        points = [middle - half * mp.cos(mp.pi * k / count) for k in range(count + 1)]
        for _ in range(8):
            rows = mp.matrix(count + 1, count + 1)
            right = mp.matrix(count + 1, 1)
            for i, x in enumerate(points):
                for j in range(count):
                    rows[i, j] = x**j
                rows[i, count] = (-1) ** i / weight(x)
                right[i] = f(x)
            solution = mp.lu_solve(rows, right)
            coefficients = [solution[j] for j in range(count)]

            def error(x: mp.mpf, c: list[mp.mpf] = coefficients) -> mp.mpf:
                return weight(x) * (mp.polyval(c[::-1], x) - f(x))

            points = _extrema(error, points, low, high)
        return coefficients, max(abs(error(x)) for x in points)


def _extrema(error: Function, points: list[mp.mpf], low: mp.mpf, high: mp.mpf) -> list[mp.mpf]:
    """The extrema of an error that alternates: one between each two zeros, by golden section, and
    the two ends.
    """
    ends = [low]
    for a, b in pairwise(points):  # a zero lies between two points of alternating sign
        fa = error(a)
        for _ in range(30):
            m = (a + b) / 2
            if error(m) * fa > 0:
                a = m
            else:
                b = m
        ends.append((a + b) / 2)
    ends.append(high)
    ratio = (mp.sqrt(5) - 1) / 2
    found = []
    for a, b in pairwise(ends):
        c = b - ratio * (b - a)
        d = a + ratio * (b - a)
        for _ in range(40):
            if abs(error(c)) > abs(error(d)):
                b = d
                d = c
                c = b - ratio * (b - a)
            else:
                a = c
                c = d
                d = a + ratio * (b - a)
        found.append(max(a, b, (a + b) / 2, key=lambda x: abs(error(x))))
    found[0] = low if abs(error(low)) >= abs(error(found[0])) else found[0]
    found[-1] = high if abs(error(high)) >= abs(error(found[-1])) else found[-1]
    return found
