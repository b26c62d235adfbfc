"""The motor torque between the samples of a trajectory."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import PchipInterpolator, PPoly, make_interp_spline

DEGREE, SAMPLES = 5, 10  # of the polynomials of a limited torque, and samples of each
ON_GRID = 1e-7  # relative distance up to which samples are on a grid


def torque_curve(t: np.ndarray, torque: np.ndarray, *, limited: bool) -> PPoly:
    """Motor torque (n_m) at an instant, or (k, n_m) at k of them, from samples (n, n_m) at the instants ``t`` (n,) [s].

    A quintic spline; ``limited``: the polynomials that were sampled, or a monotone cubic, since a spline overshoots
    where the torque reaches its limit.
    """
    if not limited:
        return spline(t, torque)
    return _sampled_polynomials(t, torque) or PchipInterpolator(t, torque)


def spline(t: np.ndarray, torque: np.ndarray) -> PPoly:
    """The quintic spline through samples; a polynomial where there are fewer than six."""
    curve = make_interp_spline(t, torque, k=min(DEGREE, len(t) - 1))
    knots = np.unique(curve.t)  # those at both ends are repeated
    derivatives = [curve.derivative(m)(knots[:-1]) / math.factorial(m) for m in range(curve.k, 0, -1)]
    return PPoly(np.stack([*derivatives, curve(knots[:-1])]), knots)


def constant(torque: np.ndarray, begin: float, end: float) -> PPoly:
    """The same torque (n_m,) at all instants."""
    return PPoly(np.asarray(torque, float)[None, None, :], [begin, end])


def then_constant(curve: PPoly, last: np.ndarray) -> PPoly:
    """A torque, and from its end on the torque ``last`` (n_m,)."""
    held = np.zeros((len(curve.c), 1, len(last)))
    held[-1, 0] = last
    return PPoly(np.concatenate([curve.c, held], axis=1), np.append(curve.x, curve.x[-1] + 1.0))


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
