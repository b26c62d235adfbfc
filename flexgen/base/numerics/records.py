"""Faults that records show: lost samples, transients that have not decayed.

A transient is in the first period more than in the later ones, noise is in all alike: with the
spectra ``X_p`` of the periods, ``E_p = sum |X_{p+1} - X_p|^2`` is the same for all p up to its
scatter, and ``E_1`` larger with a transient.

Source: R. Pintelon and J. Schoukens, System Identification, 2nd ed. 2012, sec. 2.5 (transients of
periodic signals).
"""

from __future__ import annotations

import numpy as np

# least steps, over the resolution, in which one repeated sample is seen; in coarser ones a number
# of them
FINE = 100
COARSE = 4
# median of the magnitude of normal numbers, over their standard deviation
NORMAL = 0.6745
# standard deviations of second differences from which on a jump is none of noise or of a count
OF_NOISE = 5.0
# Of samples that are lost without a gap in the times: difference of the steps before and after
# over their mean, at most; deviation of the number of lost samples from a whole one; its size over
# its standard deviation, and that of the residuals of all axes; most samples lost at once.
EVEN = 0.3
WHOLE = 0.2
CLEAR = 12.0
CONSISTENT = 4.0
# A step over its standard deviation from which on an axis tells, too.
SEEN = 5.0
LOST_AT_ONCE = 20
# Standard deviation of a step over the largest one, at least; difference of equal steps in time.
FINEST = 2e-3
# Speed of an axis that moves, over its largest one.
MOVING = 0.1
# Standard deviation of the difference of steps, in counts of an encoder, at least.
COUNT = 0.6
STEADY = 0.02
TRANSIENT = "a transient remains"  # the words of a warning that withholds intervals
SURE = 6.0  # standard deviations of a ratio of powers
SMALLEST = 1e-4  # transient over signal


def lost_samples(x: np.ndarray) -> np.ndarray:
    """Where samples of ``x`` (n,) repeat the one before and a jump makes up for it.

    Once where the steps are far above the resolution, else `COARSE` times. The jump is far above
    the noise. An axis that stands still and starts has no such jump; nor has an encoder at rest,
    whose counts go forth and back, also where other steps of it were interpolated.
    """
    steps = np.abs(np.diff(x))
    if not steps.any():
        return np.zeros(0, dtype=int)
    least = float(steps[steps > 0].min())
    still = 1 if np.median(steps) > FINE * least else COARSE
    run = np.asarray(np.lib.stride_tricks.sliding_window_view(steps == 0, still).all(axis=1))[:-2]
    jump = steps[still:-1]
    after = steps[still + 1 :]
    bends = np.abs(np.diff(x, 2))
    # at rest most of them are zero, the others are those of a count
    noise = float(np.median(bends[bends > 0])) / NORMAL
    above = (jump >= 5 * least) & (jump > OF_NOISE * noise)
    return np.asarray(np.flatnonzero(run & above & (jump > 1.5 * after)))


def skipped_samples(t: np.ndarray, x: np.ndarray) -> list[tuple[int, int]]:
    """Where all axes advance by the steps of several samples at once, though the times do not.

    A sample that is lost, with times that are written as if it were not, leaves a step that is
    longer by the m lost ones in each axis that moves,

        e = step_k - (step_(k-1) + step_(k+1))/2 = m v h,    v h = (step_(k-1) + step_(k+1))/2

    Least squares over the axes give m; it is a whole number that all axes agree on, two at least.

    Parameters
    ----------
    t : array (n,) [s]
    x : array (n, axes) [rad or m]

    Returns
    -------
    list of (index, count)
        The sample before the long step, and the lost ones.
    """
    if len(t) < 8:
        return []
    h = np.diff(t)
    step = np.diff(x, axis=0)
    way = (step[:-2] + step[2:]) / 2
    excess = step[1:-1] - way
    moves = np.abs(step).max(axis=0) > 0.0
    # while the axis moves: at rest there is less noise
    fast = np.abs(way) > MOVING * np.abs(way).max(axis=0)
    moving = np.ma.masked_array(np.abs(excess), ~fast)
    middle = np.ma.filled(np.ma.median(moving, axis=0), 0.0) / NORMAL
    count = np.where(step != 0.0, np.abs(step), np.inf).min(axis=0)
    sd = np.maximum(middle, FINEST * np.abs(step).max(axis=0))
    # of an encoder steps differ by a count
    sd = np.where(moves, np.maximum(sd, COUNT * count), 1.0)
    even = np.abs(step[2:] - step[:-2]) <= EVEN * np.abs(way) + 4.0 * sd
    weight = even * moves / sd**2
    power = (weight * way**2).sum(axis=1)
    m = (weight * way * excess).sum(axis=1) / np.where(power > 0.0, power, 1.0)
    whole = np.round(m)
    squares = weight * (excess - whole[:, None] * way) ** 2
    left = np.sqrt(squares.max(axis=1))
    # a jump of one axis alone may be its own
    agree = (np.abs(way) * np.sqrt(weight) > SEEN).sum(axis=1) >= 2
    sure = agree & (np.sqrt(power) > CLEAR)
    steady = np.abs(h - np.median(h)) < STEADY * np.median(h)
    steady = steady[:-2] & steady[1:-1] & steady[2:]
    found = (whole >= 1) & (whole <= LOST_AT_ONCE) & (np.abs(m - whole) < WHOLE)
    at = np.flatnonzero(found & sure & steady & (left < CONSISTENT))
    return [(int(k) + 1, int(whole[k])) for k in at]


def first_period_excess(X: np.ndarray) -> np.ndarray:
    """``E_1`` over the mean of the others, per channel (c,); 1 where it can be scatter or is below
    `SMALLEST`.

    ``X`` (..., periods, lines, c): complex spectra of records. With fewer than three periods all
    are 1.
    """
    X = X.reshape(-1, *X.shape[-3:])
    if X.shape[1] < 3:
        return np.ones(X.shape[-1])
    power = np.abs(np.diff(X, axis=1)) ** 2
    later = power[:, 1:].mean(axis=(0, 1))  # (lines, c)
    each = later.sum(axis=0)
    # real numbers of the same power
    count = 2 * len(X) * each**2 / np.maximum((later**2).sum(axis=0), 1e-300)
    ratio = power[:, 0].mean(axis=0).sum(axis=0) / np.maximum(each, 1e-300)
    large = power[:, 0].mean(axis=(0, 1)) > SMALLEST**2 * (np.abs(X) ** 2).mean(axis=(0, 1, 2))
    return np.asarray(
        np.where((ratio > 1 + SURE * np.sqrt(4 / np.maximum(count, 1))) & large, ratio, 1.0)
    )


def first_period_differs(*signals: np.ndarray) -> np.ndarray:
    """Where (c,) the first period of one of the signals differs from the others."""
    return np.asarray(np.any([first_period_excess(X) > 1.0 for X in signals], axis=0))


def slow_transients(X: np.ndarray) -> np.ndarray:
    """Where (c,) a transient is in all periods: differences shrink by a factor r, |r| above the
    1/2 of noise.
    """
    D = np.diff(X.reshape(-1, *X.shape[-3:]), axis=1)
    if D.shape[1] < 2:
        return np.zeros(X.shape[-1], bool)
    power = (np.abs(D) ** 2).mean(axis=(0, 1))  # (lines, c)
    each = power.sum(axis=0)
    pairs = D.shape[0] * (D.shape[1] - 1)
    kept = np.abs((D[:, 1:] * D[:, :-1].conj()).sum(axis=(0, 1, 2))) / np.maximum(
        pairs * each, 1e-300
    )
    count = pairs * each**2 / np.maximum((power**2).sum(axis=0), 1e-300)
    large = power.mean(axis=0) > SMALLEST**2 * (np.abs(X) ** 2).reshape(-1, X.shape[-1]).mean(
        axis=0
    )
    return np.asarray((kept > 0.5 + SURE / np.sqrt(np.maximum(count, 1))) & large)
