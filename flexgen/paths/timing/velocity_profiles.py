"""Velocity profiles: smooth changes of speed, as short as the bounds on their derivatives
allow.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations
from math import prod
from typing import Protocol

import numpy as np

from flexgen.paths.timing.time_laws import TimeLaw

SAME = 1e-13  # of the duration; knots that are closer are merged


class SpeedStep(Protocol):
    """A step from 0 to 1 within ``duration``, odd about its middle, such as `TimeLaw`."""

    @property
    def duration(self) -> float:
        """Of the whole [s]."""
        ...

    @property
    def smoothness(self) -> int:
        """Number of continuous derivatives."""
        ...

    @property
    def breaks(self) -> np.ndarray:
        """Instants at which higher derivatives may jump [s]."""
        ...

    def with_integral(self, t: np.ndarray, order: int = 5) -> np.ndarray:
        """Integral of the step, the step and its derivatives at ``t`` in [0, duration], shape (n,
        order + 1).
        """
        ...


@dataclass(frozen=True)
class TrapezoidStep:
    """A step whose p-th derivative is piecewise constant: the convolution of boxes of lengths
    ``times`` (p) [s].

    ``h(t) = 1/prod(T) sum_S (-1)^|S| (t - sum_S T)_+^p / p!`` over all subsets S of the boxes; p =
    1 is a ramp, p = 2 an S of three segments, p = 3 one of seven. It is p - 1 times continuously
    differentiable.

    Source: L. Biagiotti, C. Melchiorri, Automatica 48(8), 2012 (trajectories as chains of moving
    averages).
    """

    times: tuple[float, ...]

    @property
    def duration(self) -> float:
        """Sum of the lengths of the boxes [s]."""
        return sum(self.times)

    @property
    def smoothness(self) -> int:
        """Number of continuous derivatives."""
        return len(self.times) - 1

    @cached_property
    def polynomials(self) -> tuple[np.ndarray, np.ndarray]:
        """Knots (m,) [s] of the first half, and the derivatives -1 (the integral) to p at each,
        (m, p + 2).

        The p-th derivative is a step function whose jumps are at the sums of subsets of ``times``;
        from one knot to the next all derivatives follow by Taylor's formula.
        """
        p = len(self.times)
        end = self.duration
        corners = sorted(
            (sum(chosen), (-1.0) ** size)
            for size in range(p + 1)
            for chosen in combinations(self.times, size)
        )
        knots: list[float] = []
        jumps: list[float] = []
        for instant, jump in corners:
            if instant > end / 2 * (1 + SAME):
                break
            if knots and instant - knots[-1] <= SAME * end:
                jumps[-1] += jump
            else:
                knots.append(instant)
                jumps.append(jump)
        values = np.zeros((len(knots), p + 2))
        for i in range(len(knots)):
            if i:
                values[i] = _taylor(
                    values[i - 1][None], np.array([knots[i] - knots[i - 1]]), p + 2
                )[0]
            values[i, p + 1] += jumps[i] / prod(self.times)
        return np.array(knots), values

    @property
    def breaks(self) -> np.ndarray:
        """All instants at which the p-th derivative jumps."""
        knots = self.polynomials[0]
        return np.unique(np.concatenate([knots, self.duration - knots[::-1]]))

    def with_integral(self, t: np.ndarray, order: int = 5) -> np.ndarray:
        """Integral of the step, the step and its derivatives at ``t`` in [0, duration], shape (n,
        order + 1).
        """
        knots, values = self.polynomials
        end = self.duration
        t = np.clip(t, 0.0, end)
        late = t > end / 2
        x = np.where(late, end - t, t)
        at = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 1)
        out = _taylor(values[at], x - knots[at], order + 1)
        mirror = (-1.0) ** np.arange(order + 1)  # of the derivatives of h(end - t) = 1 - h(t)
        mirrored = out * mirror
        mirrored[:, 0] += t - end / 2
        mirrored[:, 1:2] += 1.0
        return np.where(late[:, None], mirrored, out)


def _taylor(values: np.ndarray, dt: np.ndarray, size: int) -> np.ndarray:
    """Derivatives 0 to size - 1 of polynomials, ``dt`` (n) after an instant at which they are
    ``values`` (n, k).
    """
    k = values.shape[1]
    out = np.zeros((len(values), size))
    for j in range(min(k, size)):
        for i in range(k - 1, j - 1, -1):
            out[:, j] = values[:, i] + out[:, j] * dt / (i - j + 1)
    return out


def box_times(size: float, bounds: tuple[float, ...]) -> tuple[float, ...]:
    """Lengths of the boxes of a step of the given size whose k-th derivative stays below
    ``bounds[k - 1]``, all > 0.

    The highest derivative reaches its bound. From there down, each box is as long as the bounds on
    lower derivatives allow when all lower boxes have their minimum length: the sum of the boxes
    above, so that no peaks add up.

    Source: cf. P. Lambrechts, M. Boerlage, M. Steinbuch, Control Engineering Practice 13(2), 2005.
    """
    p = len(bounds)
    limits = [size, *bounds]
    amplitude = bounds[-1]
    above = 0.0
    times: list[float] = []
    for k in range(p, 0, -1):
        longest = min(
            _box(limits[k - 1 - j] / (amplitude * 2.0 ** (j * (j - 1) / 2)), above, j)
            for j in range(k)
        )
        longest = max(longest, above)
        times.append(longest)
        amplitude *= longest
        above += longest
    return tuple(reversed(times))


def _box(value: float, above: float, j: int) -> float:
    """The root x >= 0 of ``x (above + x)^j = value`` (positive): the longest box with which a
    derivative j orders lower keeps its bound.

    By Newton's method from the right, where the function is convex.
    """
    if j == 0:
        return value
    x = value ** (1.0 / (j + 1))
    for _ in range(60):
        f = x * (above + x) ** j - value
        step = f / ((above + x) ** j + j * x * (above + x) ** (j - 1))
        x -= step
        if step <= 1e-16 * x:
            break
    return x


@lru_cache(maxsize=64)
def _peak(smoothness: int, order: int) -> float:
    """Largest derivative of an order of the polynomial step of duration 1."""
    law = TimeLaw(1.0, smoothness)
    t = np.clip(np.linspace(0, 1, 20001), 1e-9, 1 - 1e-9)  # not the ends, where the law is at rest
    return float(np.abs(law(t, order)[:, order]).max()) * (1 + 1e-7)


def speed_step(size: float, bounds: tuple[float, ...], smoothness: int) -> SpeedStep:
    """The shortest change of speed by ``size`` [m/s].

    Parameters
    ----------
    size : float, > 0
    bounds : of acceleration, jerk, snap, ... [m/s^2, m/s^3, ...]
    smoothness : int
        0: trapezoids; else the number of continuous derivatives of the position.
    """
    if smoothness == 0:
        return TrapezoidStep(box_times(size, bounds))
    k = smoothness - 1
    times = [
        (size * _peak(k, j) / bound) ** (1 / j)
        for j, bound in enumerate(bounds, 1)
        if j <= 2 * k + 1
    ]
    return TimeLaw(max(times), k)


def step_duration(size: float, bounds: tuple[float, ...], smoothness: int) -> float:
    """Duration [s] of the `speed_step`; 0 for none."""
    return speed_step(size, bounds, smoothness).duration if size > 0 else 0.0
