"""Derivatives of samples by polynomials over a window, and forces through the same filter.

The second derivative of the polynomials is a weighted mean of the second differences of the
samples,

    sum_i c_i q_(k+i) = sum_i w_i (q_(k+i+1) - 2 q_(k+i) + q_(k+i-1)),      w: c summed twice

and so forces through the weights w are the filtered masses times accelerations, also where these
have a step. The mean of the polynomials themselves is another filter: with it, Coulomb friction is
0.2 % too small.

Source: A. Savitzky and M. Golay, Analytical Chemistry 36(8), 1964.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import correlate1d
from scipy.signal import savgol_coeffs, savgol_filter

# samples and degree of the polynomials
WINDOW = 31
ORDER = 5
WEIGHTS = np.cumsum(np.cumsum(savgol_coeffs(WINDOW, ORDER, deriv=2)))[:-2]
INNER = slice(WINDOW // 2, -(WINDOW // 2))  # samples with a whole window


def derivatives(q: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples (n, ...) and their two derivatives by the polynomials."""
    q, v, a = (savgol_filter(q, WINDOW, ORDER, deriv=k, delta=step, axis=0) for k in range(3))
    return q, v, a


def smooth_forces(f: np.ndarray) -> np.ndarray:
    """Forces (n, ...) through the filter of the second derivatives (see the text of this module),
    so that they are those of filtered accelerations.

    The first and last half window has no such mean: there the polynomials themselves are taken.
    """
    out: np.ndarray = savgol_filter(f, WINDOW, ORDER, axis=0)
    out[INNER] = correlate1d(f, WEIGHTS, axis=0)[INNER]
    return out
