"""The law of an element of hysteresis: its rate, and from it the torque along a deflection that
moves in one direction.

    z' = K_h (d' (1 - gamma |x|^n) - (1 - gamma) |d'| |x|^n sign(x)),    x = z/W

or that of another package, z' = K_h d' g(s x), s = sign(d'). Everything that needs the law calls
`law_rate`, or the `Curve` that is made of it. Along a path u = K_h |d - d_r|/W in one direction s
from a reversal the part y = s x obeys y' = g(y), the same equation for all elements whose laws
have the same numbers: their torques are pieces of one curve.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import quad
from scipy.interpolate import PPoly

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.memory import Hysteresis, HysteresisLaw

# of a curve: pieces in a unit over n, degree, halvings where powers are not smooth
KNOTS = 12
DEGREE = 7
DENSE = 20.0
SLID = 40.0  # time constants with which y comes to 1, at the end of a curve
# iterations
PICARD = 40
NEWTON = 60
REACHED = 1e-13  # of y = 1, where curves in C end
PARTS = np.linspace(-1.0, 1.0, 2001)  # at which a law of another package is checked
EXACT = 1e-9  # of its curve, over the slip torque, and of its values at 0 and 1
FLATTEST = 0.05  # of its fall before 1


@lru_cache(256)
def shape_of(element: HysteresisLaw) -> HysteresisLaw:
    """The law of an element without its size: elements with the same one have the same curve.

    Raises
    ------
    ArgumentError
        It is an invalid law of another package.
    """
    if not isinstance(element, Hysteresis):
        g = np.asarray(element_slope(PARTS, element), dtype=float) + 0.0 * PARTS
        fits = (
            np.isfinite(g).all()
            and (g[:-1] > 0.0).all()
            and abs(g[-1]) < EXACT
            and abs(g[1000] - 1.0) < EXACT
        )
        if not (fits and _end(element) >= FLATTEST):
            found = (
                f"{g[0]:.3g}, {g[1000]:.3g} and {g[-1]:.3g} at -1, 0 and 1, at least "
                f"{g[:-1].min():.3g} before 1"
            )
            raise ArgumentError(
                f"hysteresis law {type(element).__name__}: its slope(y) is {found}, expected 1 "
                "at 0, positive numbers before 1, and a fall to 0 at 1 with a slope of "
                f"-{FLATTEST:g} or less"
            )
    return replace(element, lost_motion=1.0, stiffness=1.0)


def is_dahl(law: HysteresisLaw) -> bool:
    """Whether the law is Dahl's, whose curve is an exponential function."""
    return isinstance(law, Hysteresis) and law.exponent == 1.0 and law.gamma == 0.0


@cache
def bend_of(law: HysteresisLaw) -> float:
    """A bound of the second derivative of the curve over its first one, ``|g'(y)|``."""
    if isinstance(law, Hysteresis):
        return law.exponent * (abs(law.gamma) + 1.0 - law.gamma)
    return float(np.abs(np.gradient(element_slope(PARTS, law), PARTS)).max())


def sharpness_of(law: HysteresisLaw) -> float:
    """Sharpness of the onset of slip of an element, n of `Hysteresis`: 1 for Dahl's law."""
    return law.exponent if isinstance(law, Hysteresis) else max(1.0, bend_of(law))


def _end(law: HysteresisLaw) -> float:
    """``-g'(1)``: how fast a sliding element comes to its slip torque."""
    return (
        law.exponent
        if isinstance(law, Hysteresis)
        else float(element_slope(PARTS, law)[-2] / (1.0 - PARTS[-2]))
    )


def law_rate(law: HysteresisLaw, rate: Any, z: Any, slip: Any) -> Any:
    """Rate of the torque z over K_h; CasADi expressions or arrays, see `element_rate`.

    A law of another package has its slope g in both directions: d' g(x) for d' > 0, d' g(-x) for
    d' < 0, written without a branch.
    """
    if isinstance(law, Hysteresis):
        return element_rate(rate, z, slip, law.exponent, law.gamma)
    x = z / slip
    forward = element_slope(x, law)
    back = element_slope(-x, law)
    return rate * (forward + back) / 2 + abs(rate) * (forward - back) / 2


def element_rate(rate: Any, z: Any, slip: Any, exponent: Any, gamma: float) -> Any:
    """Rate of the torque z of `Hysteresis` over K_h: equation above; CasADi expressions or arrays.

    ``rate``: d' [rad/s]; ``z``, ``slip`` W: torques [N m], or parts of any torque; ``exponent``:
    an expression, too.
    """
    if not isinstance(exponent, ca.SX) and exponent == 1.0 and gamma == 0.0:  # Dahl's law
        return rate - abs(rate) * z / slip
    x = z / slip
    # its derivative exists at zero, that of |x|^(n - 1) x in CasADi not
    power = abs(x) ** exponent
    sign = ca.sign(x) if isinstance(x, (ca.SX, ca.MX)) else np.sign(x)
    return rate * (1.0 - gamma * power) - (1.0 - gamma) * abs(rate) * power * sign


def element_slope(y: Any, law: HysteresisLaw) -> Any:
    """g(y) = dy/du, for parts y of the slip torque in the direction of the motion."""
    if isinstance(law, Hysteresis):
        return np.asarray(element_rate(1.0, np.asarray(y), 1.0, law.exponent, law.gamma))
    if not hasattr(law, "slope"):
        raise ArgumentError(
            f"hysteresis: given a {type(law).__name__}, expected a law with a method slope"
        )
    return law.slope(y)


@dataclass(frozen=True)
class Curve:
    """The part y of the slip torque over the path u, y(0) = 0: from y = -1 until it is 1."""

    law: HysteresisLaw
    pieces: PPoly

    def at(self, u: np.ndarray) -> np.ndarray:
        """y at the paths u, which are not before y = -1."""
        first = self.pieces.x[0]
        last = self.pieces.x[-1]
        return np.minimum(self.pieces(np.minimum(np.maximum(u, first), last)), 1.0)

    def slope(self, y: np.ndarray) -> np.ndarray:
        """dy/du."""
        return np.asarray(element_slope(y, self.law))

    def table(self) -> tuple[tuple[int, int, int], np.ndarray]:
        """The pieces until y is 1 within `REACHED`, for C.

        Returns
        -------
        parts : tuple of int
            Rows at which the pieces begin, those that are dense about y = 0, and those behind
            them; before and behind the dense ones they have one length each.
        rows : array (n, 10)
            Path at which a piece begins, one over its length, coefficients of powers of the part
            of it, from 1 on.
        """
        x = self.pieces.x[:-1]
        width = np.diff(self.pieces.x)
        zero = int(np.flatnonzero(x == 0.0)[0])
        late = zero + int(DENSE) + 1
        count = late + int(np.searchsorted(self.pieces(x[late:]), 1.0 - REACHED)) + 1
        powers = self.pieces.c[::-1] * width ** np.arange(DEGREE + 1)[:, None]
        rows = np.column_stack([x, 1.0 / width, powers.T])[:count]
        return (0, zero - int(DENSE) - 1, late), rows

    def path(self, y: np.ndarray) -> np.ndarray:
        """The u with y(u) = y, by Newton's method within the bounds of a piece; y in [-1, 1]."""
        x = self.pieces.x
        k = np.clip(np.searchsorted(self.pieces(x), y) - 1, 0, len(x) - 2)
        low = x[k]
        high = x[k + 1]
        u = (low + high) / 2
        for _ in range(NEWTON):
            off = self.pieces(u) - y
            low = np.where(off < 0.0, u, low)
            high = np.where(off < 0.0, high, u)
            slope = self.slope(np.clip(y, -1.0, 1.0 - 1e-15))
            step = u - off / np.maximum(slope, 1e-16)
            u = np.where((step > low) & (step < high), step, (low + high) / 2)
        return np.where(np.asarray(y) >= self.pieces(x[-1]), x[-1], u)


@cache
def curve_of(law: HysteresisLaw) -> Curve:
    """The curve y(u) of elements with this law, ``y' = g(y)``, y(0) = 0, from y = -1 until it is
    1.

    Collocation polynomials between knots that are dense at u = 0, where powers of abs(y) are not
    smooth; each is found by Picard iteration, forward and backward from 0.

    Raises
    ------
    ArgumentError
        The law of another package has a curve that polynomials do not follow, or comes too slowly
        to 1.
    """
    exponent = sharpness_of(law)
    first = -quad(
        lambda y: 1.0 / float(element_slope(y, law)), -1.0, 0.0, epsabs=1e-14, epsrel=1e-13
    )[0]
    size = 1.0 / KNOTS
    grown = 2.0 ** -np.arange(DENSE, -1.0, -1.0)
    longest = SLID * exponent / _end(law)
    late = size * grown[-1] + np.arange(1.0, KNOTS * (exponent + 1.0 + longest)) * size / exponent
    before = max(1, int(np.ceil(KNOTS * exponent)))
    early = -np.arange(before, 0.0, -1.0) / before
    outward = np.concatenate([first * (1.0 + 1e-9) * early[:-1], first / before * grown[::-1]])
    knots = np.concatenate([-np.abs(outward), [0.0], size * grown, late])
    nodes = (1.0 - np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)) / 2
    powers = np.linalg.inv(np.vander(nodes))
    integrals = (
        np.vander(nodes, DEGREE + 2)[:, :-1] / np.arange(DEGREE + 1, 0, -1) @ powers
    )  # of a polynomial, to nodes
    zero = int(np.flatnonzero(knots == 0.0)[0])
    pieces = np.empty((DEGREE + 1, len(knots) - 1))
    for order, known, end in (
        (range(zero, len(knots) - 1), 0, -1),
        (range(zero - 1, -1, -1), -1, 0),
    ):
        y = 0.0
        for k in order:
            width = knots[k + 1] - knots[k]
            values = np.full(DEGREE + 1, y)
            for _ in range(PICARD):
                change = width * integrals @ element_slope(np.clip(values, -2.0, 1.0), law)
                values = y + change - change[known]
            pieces[:, k] = powers @ (values - values[0]) / width ** np.arange(DEGREE, -1, -1)
            pieces[-1, k] = values[0]
            y = values[end]
    curve = Curve(law, PPoly(pieces, knots))
    return curve if isinstance(law, Hysteresis) else _check(curve)


def _check(curve: Curve) -> Curve:
    """The curve of a law of another package; ArgumentError where it does not obey the law, or does
    not come to 1.
    """
    x = curve.pieces.x
    y = curve.pieces(u := (x[1:] + x[:-1]) / 2)
    off = float(np.abs(curve.pieces.derivative()(u) - curve.slope(np.clip(y, -1.0, 1.0))).max())
    left = 1.0 - float(curve.pieces(x[-1]))
    if not (off < EXACT and left < REACHED):
        raise ArgumentError(
            f"hysteresis law {type(curve.law).__name__}: its curve differs from its slope by "
            f"{off:.1e} and ends {left:.1e} before 1, expected less than {EXACT:.0e} and "
            f"{REACHED:.0e}; choose a smoother slope(y)"
        )
    return curve
