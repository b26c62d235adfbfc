"""The motor torque between the samples of a trajectory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator, PPoly, make_interp_spline

DEGREE, SAMPLES = 5, 10  # of the polynomials of a limited torque, and samples of each
ON_GRID = 1e-7  # relative distance up to which samples are on a grid


def torque_curve(t: np.ndarray, torque: np.ndarray, *, limited: bool) -> Callable[[Any], np.ndarray]:
    """Motor torque (n_m) at an instant, or (k, n_m) at k of them, from samples (n, n_m) at the instants ``t`` (n,) [s].

    A quintic spline; ``limited``: the polynomials that were sampled, or a monotone cubic, since a spline overshoots
    where the torque reaches its limit.
    """
    if not limited:
        return make_interp_spline(t, torque, k=min(5, len(t) - 1))
    return _sampled_polynomials(t, torque) or PchipInterpolator(t, torque)


def _sampled_polynomials(t: np.ndarray, torque: np.ndarray) -> PPoly | None:
    """The piecewise polynomial that was sampled, if all samples lie on one; else None.

    The torques of optimal control are polynomials of degree ``DEGREE`` on each interval of the mesh, with ``SAMPLES``
    samples each, and kinks between intervals where a bound becomes active.
    """
    n, left = divmod(len(t) - 1, SAMPLES)
    if n == 0 or left:
        return None
    at = SAMPLES * np.arange(n)[:, None] + np.arange(SAMPLES + 1)
    width = np.diff(t[::SAMPLES])
    theta = np.linspace(0.0, 1.0, SAMPLES + 1)
    if np.abs((t[at] - t[at[:, :1]]) / width[:, None] - theta).max() > ON_GRID:
        return None
    powers = theta[:, None] ** np.arange(DEGREE, -1, -1)
    samples = torque[at]  # (n, SAMPLES + 1, n_m)
    coefficients = np.einsum("dp,npm->ndm", np.linalg.pinv(powers), samples)
    if np.abs(np.einsum("pd,ndm->npm", powers, coefficients) - samples).max() > ON_GRID * np.abs(torque).max():
        return None
    scaled = coefficients / width[:, None, None] ** np.arange(DEGREE, -1, -1)[:, None]
    return PPoly(scaled.transpose(1, 0, 2), t[::SAMPLES])
