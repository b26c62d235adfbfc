"""Size of the residuals of a fit, and whether they are white.

Source: L. Ljung, System Identification, 2nd ed. 1999, sec. 16.5 (whiteness).
"""

from __future__ import annotations

import math

import numpy as np

LAGS = 20  # of the autocorrelations that are compared with those of white noise


def rms(error: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Root of the mean square of the errors (n, outputs) of samples that move; nan: none does."""
    count = moving.sum(axis=0)
    return np.asarray(
        np.sqrt((error**2 * moving).sum(axis=0) / np.where(count > 0, count, np.nan))
    )


def whiteness(errors: np.ndarray, Q: np.ndarray) -> tuple[float, ...]:
    """Part of the autocorrelations of residuals (segments, samples, n_y) within the 99 % band of
    white noise.

    ``Q`` (segments, samples * n_y, n_z): what was fitted in each segment; residuals are orthogonal
    to it, and so not quite white even where the noise is.
    """
    P = Q.reshape(*errors.shape, -1)
    count = errors.shape[0] * errors.shape[1]
    power = (errors**2).sum(axis=(0, 1))
    left = count - (P**2).sum(axis=(0, 1, 3))
    inside = []
    for lag in range(1, min(LAGS, errors.shape[1] - 1) + 1):
        found = (errors[:, lag:] * errors[:, :-lag]).sum(axis=(0, 1)) / power
        expected = -(P[:, lag:] * P[:, :-lag]).sum(axis=(0, 1, 3)) / left
        inside.append(np.abs(found - expected) < 2.58 / math.sqrt(count))
    return tuple(np.mean(inside, axis=0).tolist())
