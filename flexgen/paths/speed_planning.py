"""Speed along a path of several stretches, each with its own bound: as fast as they and the changes of speed allow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np

from flexgen.errors import ArgumentError
from flexgen.paths.velocity_profiles import SpeedStep, speed_step, step_duration

BISECTIONS = 200  # of a speed: as many as double precision can tell apart, and ends earlier


@dataclass(frozen=True)
class Stretch:
    """A part of a path: its length and the bound on the speed there."""

    length: float
    speed: float


@dataclass(frozen=True)
class Phase:
    """From the speed ``first`` to ``last`` within ``duration`` [s], over ``length``; ``step`` None: at one speed."""

    first: float
    last: float
    duration: float
    length: float
    step: SpeedStep | None


@dataclass(frozen=True)
class SpeedLaw:
    """Distance along a path as a chain of `Phase`, at rest at both ends; ``slower`` stretches the time."""

    phases: tuple[Phase, ...]
    smoothness: int
    slower: float = 1.0

    @property
    def duration(self) -> float:
        """Of all phases [s]."""
        return float(self._starts[-1, 0]) * self.slower

    @property
    def length(self) -> float:
        """Distance at the end."""
        return float(self._starts[-1, 1])

    @cached_property
    def _starts(self) -> np.ndarray:
        """Time and distance at the start of each phase, and at the end, (m + 1, 2)."""
        steps = np.array([(phase.duration, phase.length) for phase in self.phases])
        return np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])

    @property
    def breaks(self) -> np.ndarray:
        """Instants at which derivatives above ``smoothness`` may jump [s]."""
        out = [self._starts[:, 0]]
        for phase, (start, _) in zip(self.phases, self._starts[:-1], strict=True):
            if phase.step is not None:
                out.append(start + phase.step.breaks)
        times = np.unique(np.concatenate(out))
        keep = np.append(True, np.diff(times) > 1e-13 * times[-1])
        return times[keep] * self.slower

    def slowed(self, factor: float) -> SpeedLaw:
        """The same with time stretched: speeds by 1/factor, accelerations by 1/factor^2, ..."""
        return replace(self, slower=self.slower * factor)

    def __call__(self, t: np.ndarray, order: int = 5) -> np.ndarray:
        """Distance and its time derivatives at the instants ``t`` [s], shape (n, order + 1)."""
        x = np.asarray(t, dtype=float) / self.slower
        starts, distances = self._starts.T
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
            part[:, 1] = phase.first
            if phase.step is not None:
                part += (phase.last - phase.first) * phase.step.with_integral(tau, order)
            out[here] = part
        out[:, 1:] /= self.slower ** np.arange(1, order + 1)
        return out


def speed_law(stretches: list[Stretch], bounds: tuple[float, ...], smoothness: int = 0) -> SpeedLaw:
    """The shortest chain of steps of speed along stretches, from rest to rest.

    Each stretch has at most one step up and one down, none crosses the end of a stretch.

    Parameters
    ----------
    stretches : list of Stretch
    bounds : of speed, acceleration, jerk, ... [m/s, m/s^2, ...], two or more
    smoothness : int
        0: trapezoids (as many continuous derivatives as bounds, less one), else of the polynomial steps.
    """
    if len(bounds) < 2 or not all(np.isfinite(b) and b > 0 for b in bounds):
        raise ArgumentError(
            f"profile: given {list(bounds)}, expected two or more positive bounds: speed, acceleration, jerk, ..."
        )
    if not (smoothness == 0 or 2 <= smoothness <= 9):
        raise ArgumentError(f"smoothness: given {smoothness}, expected 0 for trapezoids, or 2 to 9")
    if not all(np.isfinite(s.length) and s.length > 0 and s.speed > 0 for s in stretches) or not stretches:
        raise ArgumentError(f"stretches: given {stretches}, expected lengths and speeds above 0")
    higher = tuple(float(b) for b in bounds[1:])

    def way(a: float, b: float) -> float:
        """Distance over which the speed changes from a to b."""
        return (a + b) / 2 * step_duration(abs(b - a), higher, smoothness)

    def between(a: float, b: float) -> Callable[[float], float]:
        """Distance from the speed a over the given one to b."""
        return lambda peak: way(a, peak) + way(peak, b)

    caps = [min(s.speed, bounds[0]) for s in stretches]
    ends = [0.0, *(min(pair) for pair in pairwise(caps)), 0.0]
    for k, stretch in enumerate(stretches):  # what can be reached from the left, then from the right
        ends[k + 1] = _highest(partial(way, ends[k]), ends[k], ends[k + 1], stretch.length)
    for k, stretch in reversed(list(enumerate(stretches))):
        ends[k] = _highest(partial(way, ends[k + 1]), ends[k + 1], ends[k], stretch.length)
    phases: list[Phase] = []
    for k, stretch in enumerate(stretches):
        first, last = ends[k], ends[k + 1]
        peak = _highest(between(first, last), max(first, last), caps[k], stretch.length)
        rest = stretch.length - way(first, peak) - way(peak, last)
        if peak > first:
            phases.append(_change(first, peak, higher, smoothness))
        if rest > 0 and peak > 0:
            phases.append(Phase(peak, peak, rest / peak, rest, None))
        if peak > last:
            phases.append(_change(peak, last, higher, smoothness))
    return SpeedLaw(tuple(phases), smoothness or len(bounds) - 1)


def _change(a: float, b: float, bounds: tuple[float, ...], smoothness: int) -> Phase:
    step = speed_step(abs(b - a), bounds, smoothness)
    return Phase(a, b, step.duration, (a + b) / 2 * step.duration, step)


def _highest(way: Callable[[float], float], low: float, high: float, length: float) -> float:
    """The highest speed in low..high whose ``way`` (rising) is at most ``length``; low where none is."""
    if high <= low or way(high) <= length:
        return high
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if not low < middle < high:
            break
        low, high = (middle, high) if way(middle) <= length else (low, middle)
    return low
