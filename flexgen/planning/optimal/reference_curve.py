"""The target of the output along a path, as numbers over time or as a polynomial of the path
parameter.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.polynomial import chebyshev

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.quasistatic import targets
from flexgen.paths.path import Path
from flexgen.paths.timing.time_laws import Clock

DEGREES = (1, 8, 16, 32, 64)
CLOSE = 1e-9  # m, or entries of a rotation matrix: largest error of the polynomial


def path_by_parameter(path: Path) -> tuple[Path, float]:
    """Path with the arc length as its time, and its total length; ArgumentError for several
    segments.
    """
    if len(path.segments) != 1:
        raise ArgumentError(
            f"move {path.move.name}: given one of {len(path.segments)} segments, expected a "
            "single one; use one phase for each segment"
        )
    segment = path.segments[0]
    length = float(segment.law(np.array([1e9]), 0)[0, 0])
    by_length = copy.copy(path)
    by_length.segments = (replace(segment, law=Clock(length, 5)),)
    by_length.duration = length
    return by_length, length


def targets_at(path: Path, s: np.ndarray) -> np.ndarray:
    """Targets (k, n_t) of the output at path parameters ``s`` (k,)."""
    by_length, length = path_by_parameter(path)
    return targets(by_length.sample(length * np.clip(s, 1e-12, 1 - 1e-12)))


def curve(path: Path, s: ca.SX) -> ca.SX:
    """The target (n_t,) of the output as a polynomial of the path parameter.

    Chebyshev polynomials of the least degree in `DEGREES` whose error is below `CLOSE`; linear
    beyond the ends where the path is a straight line.

    Raises
    ------
    ArgumentError
        The path has several segments or corners.
    """
    checked = np.linspace(0.0, 1.0, 501)
    values = targets_at(path, checked)
    for degree in DEGREES:
        at = (chebyshev.chebpts1(degree + 1) + 1) / 2
        coefficients = chebyshev.chebfit(2 * at - 1, targets_at(path, at), degree)
        if np.abs(chebyshev.chebval(2 * checked - 1, coefficients).T - values).max() < CLOSE:
            break
    else:
        raise ArgumentError(
            f"move {path.move.name}: its curve is not a smooth function of the path parameter, "
            "expected one without corners; use one phase for each smooth part"
        )
    coefficients[np.abs(coefficients) < 1e-14 * max(1.0, float(np.abs(values).max()))] = 0.0
    x = 2 * s - 1
    rows = []
    for column in coefficients.T:
        low = ca.SX(0)
        high = ca.SX(0)
        for c in column[:0:-1]:  # Clenshaw
            low, high = 2 * x * low - high + float(c), low
        rows.append(x * low - high + float(column[0]))
    return ca.vertcat(*rows)
