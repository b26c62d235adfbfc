"""Records at equal steps: jitter of the clock, unequal steps, several rates, gaps.

Steps that differ by less than `EVEN` are equal, and the samples stay as they are. Otherwise:

1. A step longer than `GAP` usual ones is a gap. The record is cut there; nothing is invented
   inside.
2. Between gaps the stamps either are the instants of the samples, or the samples are equidistant
   and the stamps are late by a random time. The record itself tells: each sample of the angles is
   predicted by the cubic through its four neighbors, once at the stamps, once at equal steps, and
   the smaller residuals decide.
3. Quintic splines through the samples give values at equal steps, those of the slowest channel. Of
   a sine of frequency f in samples at most h apart the error is below ``1.3 (2 f h)^6`` of its
   amplitude: 8e-5 at a tenth of the rate.
4. A channel with a higher rate passes a filter without phase first, which keeps amplitudes within
   1e-4 below 0.35 of the new rate and takes away what would be aliased, from half of it on, to
   1e-4.

A constant stays that constant, and counts of an encoder at rest stay within one count.

Source: C. de Boor, A Practical Guide to Splines, 2001, ch. XIII; J. Kaiser, 1974 (window of the
filter).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.signal import firwin, oaconvolve

from flexgen.base.errors import ArgumentError

# Largest difference of a step from the median, relative, up to which steps are equal: a clock in
# whole microseconds at 20 kHz.
EVEN = 0.02
# Length of a gap in usual steps: one missing sample is bridged by the spline, two are a gap.
GAP = 2.5
# Percentile of the steps that is the usual one: steps of 10 and 12 ms in turns have 12 ms.
USUAL = 98.0
# Part of the residuals at the stamps, from which on the stamps are taken as noise of the clock.
CLEARLY = 0.8
# Samples of a running median, at least: more where the stamps scatter by more, so that the
# median itself scatters by less than a quarter of a step (SURE deviations of it).
WINDOW = 31
SURE = 20.0
# Steps by which this median may leave a straight line if no sample is lost.
STEADY = 0.5
DEGREE = 5
# Over the median step: with closer stamps a quintic spline would enlarge noise.
CLOSE = 0.3
# Passband and stopband of the filter against aliasing, over the new rate.
PASS = 0.35
STOP = 0.5
# Error of the filter, and its length for that in taps per ratio of the rates (Kaiser's formula).
DECIBELS = 80.0
# Rates that differ by less are interpolated without a filter.
SAME_RATE = 1.3
# Part of a step by which equal steps may end after the last sample: a line through stamps that
# scatter is not known better, and a last period would lack one sample.
BEYOND = 1e-2
# Samples of a piece between gaps, at least.
FEWEST = 16
# Part of the changes of an angle that are in every m-th row, from which on it was sampled there
# only.
REGULAR = 0.99
# Fewest changes of an angle from which that is decided, and the largest m.
CHANGES = 20
LARGEST_RATIO = 64


@dataclass(frozen=True)
class Gap:
    """Where samples are missing: last instant before and first one after [s]."""

    begin: float
    end: float

    def __str__(self) -> str:
        length = self.end - self.begin
        return f"{length:.4g} s from {self.begin:.6g} to {self.end:.6g} s"


@dataclass(frozen=True, eq=False)
class Clock:
    """Instants of the samples of a channel.

    ``time`` (n,) [s], increasing; ``step``: the mean one between gaps [s]; ``pieces``: slices
    between gaps; ``gaps``; ``even``: as recorded, at equal steps; ``note``: what was done to the
    stamps, or empty.
    """

    time: np.ndarray
    step: float
    pieces: tuple[slice, ...]
    gaps: tuple[Gap, ...]
    even: bool
    note: str


@dataclass(frozen=True, eq=False)
class Piece:
    """Samples at equal steps between two gaps: ``time`` (n,) [s], ``values`` (n, k)."""

    time: np.ndarray
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class Sampled:
    """A record at equal steps.

    ``pieces``: between the gaps; ``gaps``: of all channels; ``step`` [s]; ``resampled``: whether
    values are interpolated; ``notes``: what was done, as sentences.
    """

    pieces: tuple[Piece, ...]
    gaps: tuple[Gap, ...]
    step: float
    resampled: bool
    notes: tuple[str, ...]


def read_clock(where: str, time: np.ndarray, probes: np.ndarray) -> Clock:
    """The instants of samples from their stamps.

    Equal stamps are taken as they are, with gaps where samples are missing. Stamps that scatter
    are replaced by equal steps, unless the signals are clearly smoother over the stamps
    themselves; these are then the instants.

    Parameters
    ----------
    where : str
        File, for the error.
    time : array (n,) [s]
    probes : array (n, k)
        Smooth signals, such as angles, that tell whether the stamps are the instants of the
        samples.

    Returns
    -------
    Clock

    Raises
    ------
    ArgumentError
        The stamps do not increase, and the samples are not equidistant either.
    """
    steps = np.diff(time)
    step = float(np.median(steps)) if len(steps) else 0.0
    if not step > 0.0:
        k = int(np.argmax(steps <= 0.0)) if len(steps) else 0
        raise ArgumentError(
            f"{where}: time goes from {time[k]:.6g} to {time[min(k + 1, len(time) - 1)]:.6g} s at "
            f"sample {k}, expected times that increase"
        )
    mean = float((time[-1] - time[0]) / (len(time) - 1))
    if (np.abs(steps - step) <= EVEN * step).all():
        return Clock(time, mean, (slice(0, len(time)),), (), True, "")
    usual = max(step, float(np.percentile(steps, USUAL)))
    after = np.flatnonzero(steps > GAP * usual) + 1
    edges = [0, *after.tolist(), len(time)]
    pieces = [slice(a, b) for a, b in pairwise(edges)]
    gaps = tuple(Gap(float(time[k - 1]), float(time[k])) for k in after)
    inner = np.delete(steps, after - 1)
    if (np.abs(inner - step) <= EVEN * step).all():
        return Clock(time, float(inner.mean()), tuple(pieces), gaps, False, "")
    lines = _lines(time, pieces)
    equal = None if lines is None else _roughness(lines, probes, pieces)
    if (inner <= 0.0).any():
        if equal is None:
            k = int(np.flatnonzero(steps <= 0.0)[0])
            raise ArgumentError(
                f"{where}: time goes from {time[k]:.9g} to {time[k + 1]:.9g} s at sample {k}, "
                "expected times that increase"
            )
    elif equal is None or equal > CLEARLY * _roughness(time, probes, pieces):
        low, high = 1e3 * np.percentile(inner, [1.0, 99.0])
        note = f"steps of {low:.4g} to {high:.4g} ms"
        return Clock(time, float(inner.mean()), tuple(pieces), gaps, False, note)
    assert lines is not None
    late = 1e3 * float(np.std(time - lines))
    step = float(np.median(np.diff(lines)))
    note = f"time stamps scatter by {late:.3g} ms about equal steps of {1e3 * step:.6g} ms"
    return Clock(lines, step, tuple(pieces), gaps, False, note)


def _lines(time: np.ndarray, pieces: Sequence[slice]) -> np.ndarray | None:
    """Equal steps [s] through the stamps of each piece; None where samples are lost: the running
    median of the differences is not constant. Short pieces keep their stamps.
    """
    out = np.array(time, dtype=float)
    for piece in pieces:
        t = time[piece]
        if len(t) < FEWEST:
            continue
        k = np.arange(len(t))
        slope, first = np.polyfit(k, t - t[0], 1)
        out[piece] = t[0] + first + slope * k
        away = t - out[piece]
        scatter = float(np.std(np.diff(away))) / np.sqrt(2.0) / slope
        size = int(np.clip((SURE * scatter) ** 2, WINDOW, max(len(t) // 4, WINDOW)))
        size = min(size, len(t) // 2)
        running = np.median(np.lib.stride_tricks.sliding_window_view(away, size), axis=1)
        if np.ptp(running) > 2 * STEADY * slope:
            return None
    return out


def _roughness(time: np.ndarray, probes: np.ndarray, pieces: Sequence[slice]) -> float:
    """Rms residual of the cubic through four neighbors of the ``probes`` (n, k) at the instants
    ``time``, over that at equal steps: below 1 where these instants are nearer to the true ones.
    """
    found = []
    plain = []
    for piece in pieces:
        x = probes[piece]
        if len(x) < FEWEST:
            continue
        found.append(_cubic_residual(time[piece], x))
        plain.append(_cubic_residual(np.arange(len(x), dtype=float), x))
    if not found:
        return 1.0
    size = np.sqrt((np.concatenate(plain) ** 2).mean(axis=0))
    scaled = np.concatenate(found) / np.maximum(size, 1e-300)
    return float(np.sqrt((scaled[:, size > 0.0] ** 2).mean())) if (size > 0.0).any() else 1.0


def _cubic_residual(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Samples (n - 4, k) less the cubic through the two before and the two after each."""
    at = np.stack([t[:-4], t[1:-3], t[3:-1], t[4:]]) - t[2:-2]
    near = np.stack([x[:-4], x[1:-3], x[3:-1], x[4:]])
    weights = np.ones_like(at)
    for i in range(4):
        for j in range(4):
            if i != j:
                weights[i] *= -at[j] / (at[i] - at[j])
    return np.asarray(x[2:-2] - np.einsum("in,ink->nk", weights, near))


def drop_repeats(time: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The samples of an angle that is written several times until its next one: the first of each.

    A recorder that is m times as fast as an encoder writes each angle m times. The largest m from
    2 on is taken for which `REGULAR` of the changes are in the same one of every m rows; with
    fewer than `CHANGES` changes this is not decided.

    Parameters
    ----------
    time, x : arrays (n,)
        Instants [s], angles [rad].

    Returns
    -------
    time, x : arrays (k,)
        All of them where values do not repeat regularly.
    """
    changes = np.flatnonzero(np.diff(x) != 0.0) + 1
    if len(changes) < CHANGES:
        return time, x
    for ratio in range(min(LARGEST_RATIO, len(x) // CHANGES), 1, -1):
        counts = np.bincount(changes % ratio, minlength=ratio)
        first = int(np.argmax(counts))
        if counts[first] >= REGULAR * len(changes):
            return time[first::ratio], x[first::ratio]
    return time, x


def resample(
    where: str,
    times: Sequence[np.ndarray],
    values: Sequence[np.ndarray],
    smooth: Sequence[bool],
    *,
    step: float | None = None,
    period: float | None = None,
    instants: bool = False,
) -> Sampled:
    """Channels at equal steps; see the head of this module.

    Parameters
    ----------
    where : str
        File, for errors.
    times, values : sequences of arrays (n_i,)
        Of each channel; channels of one rate share one array of times.
    smooth : sequence of bool
        Channels that tell whether stamps are instants, such as angles.
    step : float, optional [s]
        Default: that of the slowest channel.
    period : float, optional [s]
        The step is a whole part of it.
    instants : bool
        Values at the new instants, without the filter against aliasing.

    Raises
    ------
    ArgumentError
        Stamps do not increase, or channels have no time in common.
    """
    own: list[int] = []
    groups: list[np.ndarray] = []
    for t in times:
        same = (k for k, g in enumerate(groups) if g is t or np.array_equal(g, t))
        at = next(same, len(groups))
        if at == len(groups):
            groups.append(t)
        own.append(at)
    clocks = []
    for k, t in enumerate(groups):
        members = [i for i, group in enumerate(own) if group == k]
        probes = [i for i in members if smooth[i]] or members
        clocks.append(read_clock(where, t, np.stack([values[i] for i in probes], axis=1)))
    if len(clocks) == 1 and clocks[0].even and step is None and period is None:
        piece = Piece(clocks[0].time, np.stack(list(values), axis=1))
        return Sampled((piece,), (), clocks[0].step, False, ())
    slowest = max(clocks, key=lambda clock: clock.step)
    h = step or slowest.step
    if period is not None:
        h = period / max(2, round(period / h))
    spans = _common(clocks, FEWEST * h)
    if not spans:
        raise ArgumentError(
            f"{where}: given channels without {FEWEST} samples in common between gaps, expected "
            "a longer record"
        )
    pieces = []
    for begin, end in spans:
        first = slowest.time[np.searchsorted(slowest.time, begin - 1e-9 * h)]
        n = int((end - first) / h + BEYOND) + 1
        t = first + h * np.arange(n)
        columns = [
            _column(clocks[k], x, t, h, begin, instants) for k, x in zip(own, values, strict=True)
        ]
        pieces.append(Piece(t, np.stack(columns, axis=1)))
    gaps = sorted({(gap.begin, gap.end) for clock in clocks for gap in clock.gaps})
    notes = list(dict.fromkeys(clock.note for clock in clocks if clock.note))
    if len({round(np.log(clock.step) / 0.02) for clock in clocks}) > 1:
        rates = ", ".join(f"{1 / clock.step:.4g} Hz" for clock in clocks)
        notes.append(f"channels at {rates}")
    if notes:
        notes.append(f"read at equal steps of {1e3 * h:.6g} ms")
    notes += [f"gap of {Gap(*gap)}" for gap in gaps]
    return Sampled(tuple(pieces), tuple(Gap(*gap) for gap in gaps), h, True, tuple(notes))


def _common(clocks: Sequence[Clock], least: float) -> list[tuple[float, float]]:
    """Spans [s] of at least this length that no gap of any clock is in."""
    spans = [(-np.inf, np.inf)]
    for clock in clocks:
        own = [(clock.time[p.start], clock.time[p.stop - 1]) for p in clock.pieces]
        both = ((max(a, c), min(b, d)) for a, b in spans for c, d in own)
        spans = [(a, b) for a, b in both if b - a >= least]
    return [(float(a), float(b)) for a, b in spans]


def _column(
    clock: Clock, x: np.ndarray, t: np.ndarray, h: float, begin: float, instants: bool
) -> np.ndarray:
    """A channel ``x`` of samples at the instants ``t`` (n,), equal steps of ``h`` [s] within the
    piece of its clock that has ``begin`` [s]; without what a slower rate would alias, unless only
    values at ``instants`` are asked for.
    """
    k = int(np.searchsorted(clock.time, begin + 1e-9 * h, side="right")) - 1
    piece = next(p for p in clock.pieces if p.start <= max(k, 0) < p.stop)
    own_t = clock.time[piece]
    own_x = x[piece]
    if h < SAME_RATE * clock.step or instants:
        return _spline(own_t, own_x)(np.clip(t, own_t[0], own_t[-1]))
    ratio = round(h / clock.step)
    fine = t[0] + h / ratio * np.arange(ratio * (len(t) - 1) + 1)
    samples = _spline(own_t, own_x)(np.clip(fine, own_t[0], own_t[-1]))
    return low_pass(samples, ratio)[::ratio]


def low_pass(x: np.ndarray, ratio: int) -> np.ndarray:
    """Samples x (n,) without what a rate lower by ``ratio`` would alias: a filter with a Kaiser
    window and no delay; mirrored at the ends.
    """
    width = (STOP - PASS) / ratio
    half = int(np.ceil((DECIBELS - 7.95) / (14.36 * width) / 2))
    window = ("kaiser", 0.1102 * (DECIBELS - 8.7))
    taps = firwin(2 * half + 1, (PASS + STOP) / ratio, window=window)
    padded = np.pad(x, half, mode="reflect", reflect_type="odd")
    return np.asarray(oaconvolve(padded, taps, mode="valid"))


def _spline(t: np.ndarray, x: np.ndarray) -> BSpline:
    """The spline through samples; of lower degree where stamps are close to each other."""
    steps = np.diff(t)
    degree = DEGREE if steps.min() > CLOSE * np.median(steps) else 1
    return make_interp_spline(t, x, k=min(degree, len(t) - 1))
