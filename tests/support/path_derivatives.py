"""Derivatives of a sampled path against finite differences."""

from __future__ import annotations

import numpy as np

# Central differences of step 1e-4 s on quantities whose third derivative is below 1e6 of their own
# size.
DIFFERENCE = 2e-5


def derivatives_agree(t: np.ndarray, values: np.ndarray) -> float:
    """Largest relative difference between each derivative (last axis) and the finite difference of
    the one before.
    """
    worst = 0.0
    inner = slice(2, -2)
    h = t[1] - t[0]
    for k in range(values.shape[-1] - 1):
        y = values[..., k]
        slope = (-y[4:] + 8 * y[3:-1] - 8 * y[1:-3] + y[:-4]) / (12 * h)
        given = values[inner][..., k + 1]
        worst = max(worst, np.abs(slope - given).max() / max(np.abs(given).max(), 1e-12))
    return worst
