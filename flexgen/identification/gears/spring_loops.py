"""Torque of a spring and its elements of hysteresis along a measured deflection, from the laws
alone: a locked or slow test has no dynamics.

    tau(t) = spring(d(t)) + sum_i z_i(t) + offset

Between two reversals of the deflection the part y = s z/W of the slip torque is a piece of one
curve, ``dy/du = g(y)`` over the path ``u = K_h |d - d_r|/W`` in the direction s (see
`flexgen.dynamics.hysteresis.hysteresis_law`). So a branch is one evaluation of the curve for all
its samples. Reversals that are noise of the deflection would narrow the loops: they are taken
out, and each branch is monotone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cache
from itertools import pairwise

import casadi as ca
import numpy as np

from flexgen.base.spec.memory import Hysteresis
from flexgen.dynamics.hysteresis.hysteresis_law import element_slope
from flexgen.dynamics.mechanics.force_laws import spring_torque
from flexgen.identification.records.deflection_record import DeflectionRecord
from flexgen.model.elements import (
    BacklashSpring,
    CubicSpring,
    LinearSpring,
    PiecewiseSpring,
    SmoothSpring,
    Spring,
)

SPRINGS: dict[str, type[Spring]] = {
    "linear": LinearSpring,
    "cubic": CubicSpring,
    "smooth": SmoothSpring,
    "piecewise": PiecewiseSpring,
    "backlash": BacklashSpring,
}
MOST = 4000  # samples of a record that are compared; neighbors of longer ones are averaged
NOISES = 5.0  # standard deviations of the noise of the deflection that a reversal has, at least
# A median of |second differences| of white noise over its standard deviation.
SECOND_DIFFERENCE = 0.6745 * np.sqrt(6.0)
# Of the table of a curve: knots in w = -log(1 - y), and the last of them, where y is 1.
KNOTS = 3000
SLID = 32.0


@dataclass(frozen=True, eq=False)
class Branches:
    """A record as monotone branches.

    ``deflection`` (n,), without reversals that are noise; ``torque`` (n,) as measured; ``time``
    (n,); ``turns``: first sample of each branch and the last sample of all; ``noise``: standard
    deviations of deflection and torque; ``name`` of the record.
    """

    name: str
    time: np.ndarray
    deflection: np.ndarray
    torque: np.ndarray
    turns: tuple[int, ...]
    noise: tuple[float, float]


def branches_of(record: DeflectionRecord) -> Branches:
    """The branches of a record."""
    every = -(-len(record.time) // MOST)
    count = len(record.time) // every * every
    time, d, torque = (
        x[:count].reshape(-1, every).mean(axis=1)
        for x in (record.time, record.deflection, record.torque)
    )
    noise = noise_of(d), noise_of(torque)
    least = max(NOISES * noise[0], 1e-9 * float(np.ptp(d)))
    turns = turning_points(d, least)
    smooth = d.copy()
    for first, last in pairwise(turns):
        part = d[first : last + 1]
        sign = 1.0 if part[-1] >= part[0] else -1.0
        highest = np.maximum.accumulate(sign * part)
        lowest = np.minimum.accumulate(sign * part[::-1])[::-1]
        smooth[first : last + 1] = sign * (highest + lowest) / 2
    return Branches(record.name, time, smooth, torque, turns, noise)


def noise_of(x: np.ndarray) -> float:
    """Standard deviation of the white noise of a slow signal (n,), from its second differences;
    those of steps, which are few, do not count.
    """
    return float(np.median(np.abs(np.diff(x, 2))) / SECOND_DIFFERENCE)


def turning_points(x: np.ndarray, least: float) -> tuple[int, ...]:
    """Indices of the extrema of a signal (n,) between which it changes by more than ``least``;
    the first and last sample are among them.
    """
    turns = [0]
    high = low = 0
    direction = 0
    for k in range(1, len(x)):
        if x[k] > x[high]:
            high = k
        if x[k] < x[low]:
            low = k
        if direction >= 0 and x[high] - x[k] > least:
            turns += [high] if high > turns[-1] else []
            direction = -1
            low = k
            high = k
        elif direction <= 0 and x[k] - x[low] > least:
            turns += [low] if low > turns[-1] else []
            direction = 1
            high = k
            low = k
    return (*turns, len(x) - 1) if turns[-1] < len(x) - 1 else tuple(turns)


@dataclass(frozen=True)
class Element:
    """An element of hysteresis: ``stiffness`` K_h, ``reach`` W/K_h [rad or m], the deflection
    after which it slips, and its law, without sizes.
    """

    stiffness: float
    reach: float
    law: Hysteresis


def loop_torque(elements: Sequence[Element], record: Branches, start: float) -> np.ndarray:
    """Sum of the torques z (n,) of the elements, which begin at the part ``start`` of their slip
    torques.
    """
    out = np.zeros(len(record.deflection))
    for element in elements:
        curve = _Curve(element.law)
        y = start
        for first, last in pairwise(record.turns):
            way = record.deflection[first : last + 1] - record.deflection[first]
            sign = 1.0 if way[-1] >= 0.0 else -1.0
            part = sign * curve.along(sign * y, np.abs(way) / element.reach)
            out[first : last + 1] += (
                element.stiffness
                * element.reach
                * (part if first == 0 else np.concatenate([[0.0], part[1:]]))
            )
            y = float(part[-1])
    return out


class _Curve:
    """The part y of the slip torque over the path u, as a table in w = -log(1 - y), in which
    it is nearly linear where the element slips.
    """

    def __init__(self, law: Hysteresis) -> None:
        self.w = np.linspace(-np.log(2.0), SLID, KNOTS)
        middle = (self.w[1:] + self.w[:-1]) / 2
        # Simpson's rule for du = exp(-w) dw / g
        rate, at_middle = (self._rate(law, w) for w in (self.w, middle))
        pieces = (rate[1:] + 4 * at_middle + rate[:-1]) * np.diff(self.w) / 6
        self.u = np.concatenate([[0.0], np.cumsum(pieces)])

    @staticmethod
    def _rate(law: Hysteresis, w: np.ndarray) -> np.ndarray:
        """du/dw."""
        fall = np.exp(-w)
        return np.asarray(fall / np.maximum(element_slope(1.0 - fall, law), 1e-16))

    def along(self, y: float, path: np.ndarray) -> np.ndarray:
        """y after paths (n,) from ``y``."""
        start = np.interp(-np.log(max(1.0 - y, np.exp(-SLID))), self.w, self.u)
        return np.asarray(1.0 - np.exp(-np.interp(start + path, self.u, self.w)))


@cache
def spring_function(kind: str) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Torque (n,) of a spring of a kind at deflections (n,), with its numbers in the order of its
    class.
    """
    count = len(numbers_of_spring(kind))
    d = ca.SX.sym("d")
    p = ca.SX.sym("p", count)
    torque = ca.Function("torque", [d, p], [spring_torque(SPRINGS[kind](*ca.vertsplit(p)), d)])

    def evaluate(deflection: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        return np.asarray(torque(deflection[None, :], numbers)).ravel()

    return evaluate


def numbers_of_spring(kind: str) -> tuple[str, ...]:
    """Names of the numbers of a spring of a kind, in the order of its class."""
    return tuple(field.name for field in fields(SPRINGS[kind]))


def kind_of_spring(spring: Spring) -> str:
    """The kind of a spring in a model file."""
    return next(kind for kind, cls in SPRINGS.items() if type(spring) is cls)
