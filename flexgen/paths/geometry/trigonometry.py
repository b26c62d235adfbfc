"""Sine, cosine and square root with the bits of the emitted C: a path has the same bits in Python
and in C.
"""

from __future__ import annotations

import numpy as np

# The numbers of flexgen/codegen/clib/precision_double.h; tests/client/test_path_sampler.py
# compares the results. adding the second rounds to a whole number
_PER_QUARTER = 0.6366197723675814
_SHIFT = 6755399441055744.0
_HALF_PI = (1.5707963267341256, 6.077094383272197e-11, 6.12323399538461e-17, 3.5215598651832e-27)
_SINE = (
    (-0.16666666666666632, 0.008333333333322425),
    (-0.00019841269829816863, 2.755731369519521e-06),
    (-2.5050758648160705e-08, 1.5896827621544008e-10),
)
_COSINE = (
    (0.0416666666666666, -0.0013888888888874138),
    (2.4801587289491742e-05, -2.755731435521654e-07),
    (2.087572368084499e-09, -1.1359669674695726e-11),
)
_ANGLE_MAX = 1e6  # rad


def sine_cosine(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sine and cosine of angles [rad], to rounding; NaN above 1e6 rad.

    The angle is ``k pi/2 + r`` with ``|r| <= pi/4``; two polynomials in r^2, exchanged for odd k.

    Source: W. Cody, W. Waite, Software Manual for the Elementary Functions, 1980, ch. 8.
    """
    x = np.asarray(x, dtype=float)
    with np.errstate(invalid="ignore"):
        k = (x * _PER_QUARTER + _SHIFT) - _SHIFT
        rough = (x - k * _HALF_PI[0]) - k * _HALF_PI[1]
        w = k * _HALF_PI[2]
        r = rough - w
        tail = (w - (rough - r)) + k * _HALF_PI[3]
        tail = np.where(np.abs(x) > _ANGLE_MAX, np.nan, tail)
    z = r * r
    half = 0.5 * z
    most = 1.0 - half
    s = r - (tail * most - (z * r) * _polynomial(_SINE, z))
    c = most + ((z * z) * _polynomial(_COSINE, z) + (((1.0 - most) - half) + tail * r))
    quarter = np.where(np.isfinite(k), k, 0.0) % 4.0
    odd = quarter % 2.0 == 1.0
    sine = np.where(odd, c, s)
    cosine = np.where(odd, s, c)
    return np.where(quarter >= 2.0, -sine, sine), np.where(
        (quarter == 1.0) | (quarter == 2.0), -cosine, cosine
    )


def root(x: np.ndarray) -> np.ndarray:
    """Square root by Newton's method, to rounding: `square_root` of the emitted C. Numbers that
    are not between 0 and 1e300 are returned as they are.
    """
    x = np.asarray(x, dtype=float)
    inside = (x > 0.0) & (x < 1e300)
    known = np.where(inside, x, 1.0)
    r = np.ones_like(known)
    while (large := r * r > 4.0 * known).any():
        r = np.where(large, 0.5 * r, r)
    while (small := r * r < 0.25 * known).any():
        r = np.where(small, 2.0 * r, r)
    for _ in range(7):
        r = 0.5 * (r + known / r)
    return np.where(inside, r, x)


def _polynomial(pairs: tuple[tuple[float, float], ...], z: np.ndarray) -> np.ndarray:
    """The polynomial of degree 5 in z, in the order of operations of the C."""
    (a0, a1), (a2, a3), (a4, a5) = pairs
    z2 = z * z
    return np.asarray(((a0 + a1 * z) + z2 * (a2 + a3 * z)) + (z2 * z2) * (a4 + a5 * z))
