"""The motor torque between the samples of a trajectory."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator, PPoly, make_interp_spline

from flexgen.base.errors import ArgumentError

# key of meta data: a polynomial of this degree on each `SAMPLES` samples, with jumps
POLYNOMIALS = "torque_degree"
DEGREE = 5  # of the polynomials of a limited torque
SAMPLES = 10  # and samples of each
ON_GRID = 1e-7  # relative distance up to which samples are on a grid


def torque_curve(
    t: np.ndarray, torque: np.ndarray, *, limited: bool, degree: int | None = None
) -> PPoly:
    """Motor torque (n_m) at an instant, or (k, n_m) at k of them, from samples (n, n_m) at the
    instants ``t`` (n,) [s].

    A quintic spline; ``limited``: the polynomials that were sampled, or a monotone cubic, since a
    spline overshoots where the torque reaches its limit; ``degree``: polynomials that may jump,
    see `interval_polynomials`.
    """
    if degree is not None:
        return interval_polynomials(t, torque, degree)
    if not limited:
        return spline(t, torque)
    return _sampled_polynomials(t, torque) or PchipInterpolator(t, torque)


def spline(t: np.ndarray, torque: np.ndarray) -> PPoly:
    """The quintic spline through samples; a polynomial where there are fewer than six."""
    curve = make_interp_spline(t, torque, k=min(DEGREE, len(t) - 1))
    knots = np.unique(curve.t)  # those at both ends are repeated
    derivatives = [
        curve.derivative(m)(knots[:-1]) / math.factorial(m) for m in range(curve.k, 0, -1)
    ]
    return PPoly(np.stack([*derivatives, curve(knots[:-1])]), knots)


def constant(torque: np.ndarray, begin: float, end: float) -> PPoly:
    """Constant torque (n_m,) from ``begin`` to ``end`` [s]."""
    return PPoly(np.asarray(torque, float)[None, None, :], [begin, end])


def then_constant(curve: PPoly, last: np.ndarray) -> PPoly:
    """A torque, and from its end on the torque ``last`` (n_m,)."""
    held = np.zeros((len(curve.c), 1, len(last)))
    held[-1, 0] = last
    return PPoly(np.concatenate([curve.c, held], axis=1), np.append(curve.x, curve.x[-1] + 1.0))


def interval_polynomials(t: np.ndarray, samples: np.ndarray, degree: int) -> PPoly:
    """Polynomials (n_m,) on intervals of `SAMPLES` samples each, which may jump between the
    intervals.

    The sample where two intervals meet is that of the later one.

    Raises
    ------
    ArgumentError
        The samples do not lie on such polynomials.
    """
    at, width, theta = _intervals(t, f"polynomials of degree {degree}")
    powers = theta[:SAMPLES, None] ** np.arange(degree, -1, -1)
    own = samples[at[:, :SAMPLES]]
    coefficients = np.einsum("dp,npm->dnm", np.linalg.pinv(powers), own)
    miss = np.abs(np.einsum("pd,dnm->npm", powers, coefficients) - own).max()
    if not miss <= ON_GRID * max(np.abs(samples).max(), 1e-300):
        raise ArgumentError(
            f"trajectory: given samples that are up to {miss:.3g} from the polynomials of "
            f"degree {degree} that its meta data state ({POLYNOMIALS}), expected samples of "
            f"them; remove {POLYNOMIALS} where you edit torques"
        )
    scaled = coefficients / width[None, :, None] ** np.arange(degree, -1, -1)[:, None, None]
    return PPoly(scaled, t[::SAMPLES])


def read_degree(meta: Mapping[str, Any]) -> int | None:
    """The degree of the polynomials of the motor torque, where meta data of a trajectory state
    one.
    """
    degree = meta.get(POLYNOMIALS)
    if degree is None or (type(degree) is int and 0 <= degree <= DEGREE):
        return degree
    raise ArgumentError(
        f"trajectory: given {POLYNOMIALS} = {str(degree)[:40]}, expected an integer from 0 to "
        f"{DEGREE}"
    )


def _intervals(t: np.ndarray, what: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples (N, SAMPLES + 1) of each interval, widths (N,) [s], and relative places of the
    samples; ArgumentError where the instants are not intervals of equal steps, which ``what``
    needs.
    """
    n, left = divmod(len(t) - 1, SAMPLES)
    theta = np.linspace(0.0, 1.0, SAMPLES + 1)
    at = SAMPLES * np.arange(n)[:, None] + np.arange(SAMPLES + 1)
    if (
        n == 0
        or left
        or np.abs((t[at] - t[at[:, :1]]) / np.diff(t[::SAMPLES])[:, None] - theta).max() > ON_GRID
    ):
        raise ArgumentError(
            f"trajectory: given {len(t)} instants, expected intervals of {SAMPLES} equal steps "
            f"for {what}"
        )
    return at, np.diff(t[::SAMPLES]), theta


def side_by_side(curves: Sequence[PPoly], begin: float, end: float) -> PPoly:
    """Several piecewise polynomials (n_k,) as one (sum of n_k,), from ``begin`` to ``end``."""
    inner = [curve.x[(curve.x > begin) & (curve.x < end)] for curve in curves]
    breaks = np.unique(np.concatenate([[begin, end], *inner]))
    degree = max(len(curve.c) for curve in curves) - 1
    derivatives = [
        np.hstack(
            [curve.derivative(m)(breaks[:-1]) if m else curve(breaks[:-1]) for curve in curves]
        )
        / math.factorial(m)
        for m in range(degree, -1, -1)
    ]
    return PPoly(np.stack(derivatives), breaks)


def _sampled_polynomials(t: np.ndarray, torque: np.ndarray) -> PPoly | None:
    """The piecewise polynomial that was sampled, if all samples lie on one; else None.

    The torques of optimal control are polynomials of degree ``DEGREE`` on each interval of the
    mesh, with ``SAMPLES`` samples each, and kinks between intervals where a bound becomes active.
    """
    try:
        at, width, theta = _intervals(t, "polynomials")
    except ArgumentError:
        return None
    powers = theta[:, None] ** np.arange(DEGREE, -1, -1)
    samples = torque[at]  # (n, SAMPLES + 1, n_m)
    coefficients = np.einsum("dp,npm->ndm", np.linalg.pinv(powers), samples)
    if (
        np.abs(np.einsum("pd,ndm->npm", powers, coefficients) - samples).max()
        > ON_GRID * np.abs(torque).max()
    ):
        return None
    scaled = coefficients / width[:, None, None] ** np.arange(DEGREE, -1, -1)[:, None]
    return PPoly(scaled.transpose(1, 0, 2), t[::SAMPLES])
