"""The low pass of measured errors, in frequency and in time.

    Q e = low pass of (w(t) e(t) + (1 - w(t)) e_end)

The window w goes from 0 at both ends of the record to 1 by ``3 s^2 - 2 s^3``, with a continuous
first derivative: a smoother one, such as that with three, is steeper in its middle, and learning
was unstable with it at a frequency at which it is stable with this one. ``e_end`` are the mean
errors at rest at both ends. The low pass, of second order, forwards and backwards, comes after it:
half of the amplitude is left at its frequency, without a delay, and the correction is as smooth as
the torques of elastic robots need it. At `WIDE` times its frequency the noise of the record is
taken away before.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

# Length of both ends of the window in which the correction becomes constant [s].
BLEND_S = 0.1
# Distance of the window from the ends of the grid, over a period of the low pass, and at most [s]:
# there the correction is constant again.
SETTLED = 3.0
SETTLED_MOST_S = 0.35
# Length at both ends of a record whose mean is the error at rest [s].
REST_S = 0.03
# Largest frequency of a low pass over the rate of the samples.
MOST = 0.4
# Frequency up to which errors are shown, over that up to which they are learned: above are
# vibrations that no correction reaches, and the noise of the tracker.
WIDE = 5.0


def low_pass(time: np.ndarray, error: np.ndarray, frequency_hz: float) -> np.ndarray:
    """An error (n, k) at equal steps, passed through the low pass; constant before and after."""
    step = float(time[-1] - time[0]) / (len(time) - 1)
    sections = butter(2, min(frequency_hz, MOST / step), fs=1.0 / step, output="sos")
    count = int(np.ceil(2.0 / (frequency_hz * step)))
    first, last = (np.broadcast_to(e, (count, error.shape[1])) for e in _ends(step, error))
    passed = sosfiltfilt(sections, np.concatenate([first, error, last]), axis=0, padtype=None)
    return np.asarray(passed[count:-count])


def learned_part(
    time: np.ndarray, error: np.ndarray, grid: np.ndarray, frequency_hz: float
) -> np.ndarray:
    """``Q e`` (m, k) at the instants ``grid`` (m,) [s].

    Parameters
    ----------
    time : array (n,) [s]
        At equal steps, zero where the path begins.
    error : array (n, k)
    grid : array (m,) [s]
        At equal steps; from its first to its last instant is the window, or the record where that
        is shorter.
    frequency_hz : float [Hz]
    """
    step = float(time[-1] - time[0]) / (len(time) - 1)
    first, last = _ends(step, error)
    shown = low_pass(time, error, WIDE * frequency_hz)
    settled = min(SETTLED / frequency_hz, SETTLED_MOST_S)
    begin = max(float(grid[0]) + settled, float(time[0]))
    end = min(float(grid[-1]) - settled, float(time[-1]))
    inside = np.asarray(make_interp_spline(time, shown, k=3)(np.clip(grid, begin, end)))
    weight = (_ramp((grid - begin) / BLEND_S) * _ramp((end - grid) / BLEND_S))[:, None]
    ends = np.where((grid < 0.5 * (begin + end))[:, None], first, last)
    return low_pass(grid, weight * inside + (1.0 - weight) * ends, frequency_hz)


def _ends(step: float, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean errors (k,) at rest at both ends."""
    rest = max(1, round(REST_S / step))
    return error[:rest].mean(axis=0), error[-rest:].mean(axis=0)


def _ramp(s: np.ndarray) -> np.ndarray:
    """``3 s^2 - 2 s^3`` between 0 and 1."""
    s = np.clip(s, 0.0, 1.0)
    return np.asarray(s * s * (3.0 - 2.0 * s))
