"""Speed along a path with piecewise constant speed bounds, as fast as the bounds on acceleration,
jerk, ... allow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.paths.timing.velocity_profiles import SpeedStep, speed_step, step_duration

BISECTIONS = 200  # of a speed, at most; stops earlier at the resolution of double precision


@dataclass(frozen=True)
class Stretch:
    """A stretch of a path: its length and the bound on its speed."""

    length: float
    speed: float


@dataclass(frozen=True)
class Phase:
    """Speed from ``first`` to ``last`` within ``duration`` [s] over ``length``; ``step`` None:
    constant speed.
    """

    first: float
    last: float
    duration: float
    length: float
    step: SpeedStep | None


@dataclass(frozen=True)
class SpeedLaw:
    """Distance over time as a sequence of `Phase`, at rest at both ends; ``time_scale`` stretches
    the time.
    """

    phases: tuple[Phase, ...]
    smoothness: int
    time_scale: float = 1.0

    @property
    def duration(self) -> float:
        """Duration of all phases [s]."""
        return float(self.starts[-1, 0]) * self.time_scale

    @property
    def length(self) -> float:
        """Distance covered at the end."""
        return float(self.starts[-1, 1])

    @cached_property
    def starts(self) -> np.ndarray:
        """Time and distance at the start of each phase, and at the end, (m + 1, 2)."""
        increments = np.array([(phase.duration, phase.length) for phase in self.phases])
        return np.vstack([np.zeros((1, 2)), np.cumsum(increments, axis=0)])

    @property
    def breaks(self) -> np.ndarray:
        """Instants at which derivatives above ``smoothness`` may jump [s]."""
        out = [self.starts[:, 0]]
        for phase, (start, _) in zip(self.phases, self.starts[:-1], strict=True):
            if phase.step is not None:
                out.append(start + phase.step.breaks)
        times = np.unique(np.concatenate(out))
        keep = np.append(True, np.diff(times) > 1e-13 * times[-1])
        return times[keep] * self.time_scale

    def slow_down(self, factor: float) -> SpeedLaw:
        """This law with the time multiplied by ``factor``: speeds / factor, accelerations /
        factor^2, ...
        """
        return replace(self, time_scale=self.time_scale * factor)

    def __call__(self, t: np.ndarray, order: int = 5) -> np.ndarray:
        """Distance and its time derivatives at the instants ``t`` [s], shape (n, order + 1)."""
        x = np.asarray(t, dtype=float) / self.time_scale
        starts, distances = self.starts.T
        out = np.zeros((len(x), order + 1))
        out[:, 0] = np.where(x > 0, self.length, 0.0)
        inside = (x > 0) & (x < starts[-1])
        at = np.clip(np.searchsorted(starts, x, side="right") - 1, 0, len(self.phases) - 1)
        for k, phase in enumerate(self.phases):
            here = inside & (at == k)
            if not here.any():
                continue
            tau = x[here] - starts[k]
            part = np.zeros((len(tau), order + 1))
            part[:, 0] = distances[k] + phase.first * tau
            part[:, 1:2] = phase.first
            if phase.step is not None:
                part += (phase.last - phase.first) * phase.step.with_integral(tau, order)
            out[here] = part
        out[:, 1:] /= self.time_scale ** np.arange(1, order + 1)
        return out


def speed_law(
    stretches: list[Stretch], bounds: tuple[float, ...], smoothness: int = 0
) -> SpeedLaw:
    """The shortest sequence of speed changes along stretches, from rest to rest.

    Each stretch has at most one increase and one decrease of speed; none crosses the end of a
    stretch.

    Parameters
    ----------
    stretches : list of Stretch
    bounds : of speed, acceleration, jerk, ... [m/s, m/s^2, ...], two or more
    smoothness : int
        0: trapezoids (continuous derivatives: number of bounds minus one); else that of polynomial
        changes of speed.
    """
    if len(bounds) < 2 or not all(np.isfinite(b) and b > 0 for b in bounds):
        raise ArgumentError(
            f"profile: given {list(bounds)}, expected two or more positive bounds: speed, "
            "acceleration, jerk, ..."
        )
    if not (smoothness == 0 or 2 <= smoothness <= 9):
        raise ArgumentError(
            f"smoothness: given {smoothness}, expected 0 for trapezoids, or 2 to 9"
        )
    if (
        not all(np.isfinite(s.length) and s.length > 0 and s.speed > 0 for s in stretches)
        or not stretches
    ):
        raise ArgumentError(
            f"stretches: given {stretches}, expected one or more with length > 0 and speed > 0"
        )
    higher = tuple(float(b) for b in bounds[1:])

    def distance(a: float, b: float) -> float:
        """Distance over which the speed changes from a to b."""
        return (a + b) / 2 * step_duration(abs(b - a), higher, smoothness)

    def between(a: float, b: float) -> Callable[[float], float]:
        """Distance from the speed a to b over a peak speed."""
        return lambda peak: distance(a, peak) + distance(peak, b)

    caps = [min(s.speed, bounds[0]) for s in stretches]
    ends = [0.0, *(min(pair) for pair in pairwise(caps)), 0.0]
    for k, stretch in enumerate(stretches):  # forward pass, then backward pass
        ends[k + 1] = _highest(partial(distance, ends[k]), ends[k], ends[k + 1], stretch.length)
    for k, stretch in reversed(list(enumerate(stretches))):
        ends[k] = _highest(partial(distance, ends[k + 1]), ends[k + 1], ends[k], stretch.length)
    phases: list[Phase] = []
    for k, stretch in enumerate(stretches):
        first = ends[k]
        last = ends[k + 1]
        peak = _highest(between(first, last), max(first, last), caps[k], stretch.length)
        cruise = stretch.length - distance(first, peak) - distance(peak, last)
        if peak > first:
            phases.append(_change(first, peak, higher, smoothness))
        if cruise > 0 and peak > 0:
            phases.append(Phase(peak, peak, cruise / peak, cruise, None))
        if peak > last:
            phases.append(_change(peak, last, higher, smoothness))
    return SpeedLaw(tuple(phases), smoothness or len(bounds) - 1)


def _change(a: float, b: float, bounds: tuple[float, ...], smoothness: int) -> Phase:
    step = speed_step(abs(b - a), bounds, smoothness)
    return Phase(a, b, step.duration, (a + b) / 2 * step.duration, step)


def _highest(distance: Callable[[float], float], low: float, high: float, length: float) -> float:
    """The highest speed in low..high whose ``distance`` (rising) is at most ``length``; low if
    there is none.
    """
    if high <= low or distance(high) <= length:
        return high
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if not low < middle < high:
            break
        low, high = (middle, high) if distance(middle) <= length else (low, middle)
    return low
