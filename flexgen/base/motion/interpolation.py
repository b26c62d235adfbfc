"""Interpolation of trajectories: the curves that the simulation and the verification use between
samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.interpolate import PPoly, make_interp_spline

from flexgen.base.checks.counts import show_value
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.torque_curve import interval_polynomials, read_degree, torque_curve

# channels that are derivatives of each other
MOTIONS = (("q_a", "v_a", "a_a"), ("q_m", "v_m", "a_m"))
DEGREE = 5


def interpolate(
    grid: np.ndarray, channels: Mapping[str, np.ndarray], meta: Mapping[str, Any], t: Any
) -> dict[str, np.ndarray]:
    """All channels of a trajectory at other instants; see
    `flexgen.base.motion.trajectory.Trajectory.at`.

    Coordinates with their speeds and accelerations are one curve, by Hermite interpolation, or,
    where the trajectory states a degree of collocation, by integrating that polynomial; the motor
    torque is its `torque_curve`, others are splines.

    Parameters
    ----------
    grid : array (n,) [s]
        Instants of the samples.
    channels : mapping of str to array (n, width)
    meta : mapping
        Meta data of the trajectory, which state how the motor torque was sampled.
    t : float or array (k,) [s]

    Returns
    -------
    dict
        Each channel with shape (width,), or (k, width) for an array.

    Raises
    ------
    ArgumentError
        An instant is not a number or outside of the trajectory.
    """
    try:
        at = np.asarray(t, dtype=float)
    except (TypeError, ValueError, OverflowError):
        at = np.array(np.nan)
    if at.ndim > 1 or not ((at >= grid[0]) & (at <= grid[-1])).all():
        what = (
            f"shape {at.shape}"
            if at.ndim > 1
            else "an instant that is outside"
            if at.ndim
            else show_value(t)
        )
        raise ArgumentError(
            f"t: given {what}, expected one or more instants from {grid[0]:g} to {grid[-1]:g} s"
        )
    found: dict[str, np.ndarray] = {}
    degree = read_degree(meta)
    for names in MOTIONS:
        given = [name for name in names if name in channels]
        if given[:1] == [names[0]] and given == list(names[: len(given)]):
            samples = [channels[name] for name in given]
            curve = (
                _hermite(grid, samples)
                if degree is None or len(given) < 3
                else _integrate(grid, samples, degree)
            )
            found |= {name: np.asarray(curve(at, order)) for order, name in enumerate(given)}
    for name in channels:
        if name == "tau_m":
            limited = meta.get("torque") == "limited"
            found[name] = np.asarray(
                torque_curve(grid, channels[name], limited=limited, degree=degree)(at)
            )
        elif name not in found:
            found[name] = np.asarray(
                make_interp_spline(grid, channels[name], k=min(DEGREE, len(grid) - 1))(at)
            )
    return {name: found[name] for name in channels}


def _integrate(t: np.ndarray, x: list[np.ndarray], degree: int) -> PPoly:
    """The motion whose acceleration is a polynomial on each interval, from samples of angle, speed
    and acceleration.

    Each interval begins with its own sample of angle and speed.
    """
    a = interval_polynomials(t, x[2], degree)
    ends = np.searchsorted(t, a.x[:-1])
    powers = np.arange(degree, -1, -1)[:, None, None]
    c = a.c / ((powers + 1) * (powers + 2))
    return PPoly(np.concatenate([c, x[1][ends][None], x[0][ends][None]]), a.x)


def _hermite(t: np.ndarray, x: list[np.ndarray]) -> PPoly:
    """Polynomials of least degree through samples of a motion: values, and where given first and
    second derivatives.

    Degree 1, 3 or 5 in the time since the left sample.
    """
    h = np.diff(t)[:, None]
    low = [x[k][:-1] / (1.0, 1.0, 2.0)[k] for k in range(len(x))]
    # What the part of low degree misses at the right sample: value, first and second derivative.
    miss = x[0][1:] - sum(c * h**k for k, c in enumerate(low))
    if len(x) == 1:
        high = [miss / h]
    elif len(x) == 2:
        rate = (x[1][1:] - low[1]) * h
        high = [(3 * miss - rate) / h**2, (rate - 2 * miss) / h**3]
    else:
        rate = (x[1][1:] - low[1] - 2 * low[2] * h) * h
        bend = (x[2][1:] - 2 * low[2]) * h**2 / 2
        high = [
            (10 * miss - 4 * rate + bend) / h**3,
            (-15 * miss + 7 * rate - 2 * bend) / h**4,
            (6 * miss - 3 * rate + bend) / h**5,
        ]
    return PPoly(np.stack([*high[::-1], *low[::-1]]), t)
