"""The low pass of measured errors, in frequency and in time.

    Q e = w(t) (low pass e)(t) + (1 - w(t)) e_end

The low pass is of second order, forwards and backwards: half of the amplitude is left at its
frequency, without a delay. The window w goes from 0 at both ends to 1 by ``3 s^2 - 2 s^3``, with a
continuous first derivative: a smoother one, such as that with three, is steeper in its middle, and
learning was unstable with it at a frequency at which it is stable with this one. ``e_end`` are the
mean errors at rest at both ends.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

# Length of both ends of the window in which the correction becomes constant [s].
BLEND_S = 0.1
# Length at both ends of a record whose mean is the error at rest [s].
REST_S = 0.03
# Largest frequency of the low pass over the rate of the record.
MOST = 0.4


def low_pass(time: np.ndarray, error: np.ndarray, frequency_hz: float) -> np.ndarray:
    """An error (n, k) at equal steps, passed through the low pass; constant before and after."""
    step = float(time[-1] - time[0]) / (len(time) - 1)
    sections = butter(2, min(frequency_hz, MOST / step), fs=1.0 / step, output="sos")
    count = int(np.ceil(2.0 / (frequency_hz * step)))
    rest = max(1, round(REST_S / step))
    first = np.broadcast_to(error[:rest].mean(axis=0), (count, error.shape[1]))
    last = np.broadcast_to(error[-rest:].mean(axis=0), (count, error.shape[1]))
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
        Increasing; from its first to its last instant is the window.
    frequency_hz : float [Hz]
    """
    step = float(time[-1] - time[0]) / (len(time) - 1)
    rest = max(1, round(REST_S / step))
    first = error[:rest].mean(axis=0)
    last = error[-rest:].mean(axis=0)
    smooth = make_interp_spline(time, low_pass(time, error, frequency_hz), k=3)
    begin = max(float(grid[0]), float(time[0]))
    end = min(float(grid[-1]), float(time[-1]))
    weight = _ramp((grid - begin) / BLEND_S) * _ramp((end - grid) / BLEND_S)
    ends = np.where((grid < 0.5 * (begin + end))[:, None], first, last)
    inside = np.asarray(smooth(np.clip(grid, begin, end)))
    return np.asarray(weight[:, None] * inside + (1.0 - weight[:, None]) * ends)


def _ramp(s: np.ndarray) -> np.ndarray:
    """``3 s^2 - 2 s^3`` between 0 and 1."""
    s = np.clip(s, 0.0, 1.0)
    return np.asarray(s * s * (3.0 - 2.0 * s))
