"""Hold: the motor torque between the ticks of a controller, and the values that it has to send.

A controller sends one torque at each tick ``t_k``, a multiple of its sample time ``T`` after the
start of the trajectory. The motor has this torque from ``s_k = t_k + delay`` on. Between ``s_k``
and ``s_(k+1)`` the drive

* ``"zoh"`` holds it (zero-order hold),
* ``"linear"`` follows a straight line to the next one,
* ``"spline"`` follows the quintic spline through all of them.

Samples of the continuous torque tau are the wrong values for the first two: a held sample is late
by ``T / 2``, and a chord lies on the inner side of a curve. The values are chosen such that the
signal at the motor has the same slow part as tau, up to terms of order ``T^4``:

    zoh      u_k = m_k - (m_(k-1) - 2 m_k + m_(k+1)) / 12,
    m_k the mean of tau from s_k to s_(k+1)
    linear   u   = the straight lines with the least squared distance from tau

The means alone leave an error of ``T^2 / 12`` times the acceleration that tau causes, because a
mean smooths tau and the hold smooths the means again; the second difference takes this back. Where
limits are active, the values are the means alone, and those of the straight lines stay within the
largest and smallest torque.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.interpolate import PPoly, make_interp_spline
from scipy.linalg import solve_banded

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.torque_curve import (
    POLYNOMIALS,
    SAMPLES,
    constant,
    interval_polynomials,
    read_degree,
    spline,
    then_constant,
    torque_curve,
)
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.arguments import is_number
from flexgen.base.spec.ports import Port
from flexgen.simulation.integration.hold_names import HOLDS, HoldName

SAMPLE_TIME = 1e-3  # s
MOST = 1_000_000  # ticks
SAME = 1e-9  # share of the sample time: instants that are as close are the same
GAUSS = 4  # points on each piece: exact for polynomials of degree 7


@checked_result
@dataclass(frozen=True, repr=False)
class TorqueCommand:
    """Motor torques that a controller sends, one row for each tick.

    Attributes
    ----------
    time : array (n,) [s]
        Ticks: when the torques are sent. The motor has them from ``time + delay`` on.
    values : array (n, n_m) [N m]
    labels : tuple of str
        Names of the motors.
    hold : str
        ``"spline"``, ``"linear"`` or ``"zoh"``.
    sample_time, delay : float [s]
    meta : mapping
        Model, variant and move.

    Examples
    --------
    >>> command = flexgen.solve("elbow", hold="zoh", sample_time=4e-3, delay=1e-3).torque_command
    >>> command.values.shape  # ticks, motors
    (253, 2)
    >>> print(command.save("torques.csv"))
    torques.csv
    """

    time: np.ndarray
    values: np.ndarray
    labels: tuple[str, ...]
    hold: HoldName
    sample_time: float
    delay: float
    meta: Mapping[str, Any]

    def __repr__(self) -> str:
        return f"<TorqueCommand: {self.title()}, {len(self.time)} ticks from {self.time[0]:.4g} s>"

    def title(self) -> str:
        """The hold in words: ``zero-order hold at 1 ms, delay 0.2 ms``."""
        late = f", delay {1e3 * self.delay:.4g} ms" if self.delay else ""
        return f"{HOLDS[self.hold]} at {1e3 * self.sample_time:.4g} ms{late}"

    @property
    def edges(self) -> np.ndarray:
        """Instants [s] at which the torque of the motors jumps or has a corner."""
        arrivals = self.time + self.delay
        return arrivals[[0, -1]] if self.hold == "spline" else arrivals

    def between(self, begin: float, end: float) -> PPoly:
        """The torque of the motors (n_m,), a polynomial of the instant from ``begin`` to ``end``
        without edges between.

        Before the first edge it is the first torque, after the last one the last.
        """
        edges = self.edges
        values = self.values
        k = int(np.searchsorted(edges, (begin + end) / 2)) - 1
        if k < 0 or k >= len(edges) - 1:
            return constant(values[0 if k < 0 else -1], begin, end)
        if self.hold == "spline":
            return spline(self.time + self.delay, values)
        if self.hold == "zoh":
            return constant(values[k], begin, end)
        rate = (values[k + 1] - values[k]) / (edges[k + 1] - edges[k])
        return PPoly(np.stack([rate, values[k]])[:, None, :], edges[k : k + 2])

    def at(self, instants: np.ndarray) -> np.ndarray:
        """The torque of the motors (k, n_m) at instants (k,) [s]; at an edge that of the interval
        that begins there.
        """
        arrivals = self.time + self.delay
        values = self.values
        if self.hold == "zoh":
            return np.asarray(
                values[(np.searchsorted(arrivals, instants, side="right") - 1).clip(0)]
            )
        degree = 1 if self.hold == "linear" else 5
        curve = make_interp_spline(arrivals, values, k=min(degree, len(arrivals) - 1))
        return np.asarray(curve(np.clip(instants, arrivals[0], arrivals[-1])))

    def trajectory(self) -> Trajectory:
        """Ticks and torques as a trajectory with the channel ``tau_m``; ``meta`` has hold, sample
        time and delay.
        """
        port = Port("tau_m", (len(self.labels),), "N m", "motor torques to send, motor side")
        meta = {"hold": self.hold, "sample_time": self.sample_time, "delay": self.delay}
        return Trajectory(
            self.time,
            {"tau_m": self.values},
            {"tau_m": port},
            {"tau_m": self.labels},
            {**self.meta, "kind": "torque command", **meta},
        )

    def save(self, path: str | Path) -> Path:
        """Write ticks and torques to a ``.csv`` or ``.npz`` file, see
        `flexgen.Trajectory.save`.
        """
        return self.trajectory().save(path)


@dataclass(frozen=True, repr=False)
class PolynomialTorque(TorqueCommand):
    """A polynomial of the motor torques on each of several intervals, which may jump between them.

    ``time`` are the ends of the intervals, ``values`` the torques that begin there.

    Attributes
    ----------
    curve : PPoly
        The polynomials (n_m,).
    """

    curve: PPoly

    def title(self) -> str:
        """The torque in words."""
        return f"polynomials of degree {len(self.curve.c) - 1} on {len(self.time) - 1} intervals"

    @property
    def edges(self) -> np.ndarray:
        """Instants [s] at which the torque may jump."""
        return self.time

    def between(self, begin: float, end: float) -> PPoly:
        """The torque (n_m,) as a polynomial of the instant between two edges; constant before and
        after all.
        """
        k = int(np.searchsorted(self.time, (begin + end) / 2)) - 1
        if k < 0 or k >= len(self.time) - 1:
            return constant(self.values[0 if k < 0 else -1], begin, end)
        return PPoly(self.curve.c[:, k : k + 1], self.time[k : k + 2])

    def at(self, instants: np.ndarray) -> np.ndarray:
        """The torque (k, n_m) at instants (k,) [s]; at an edge that of the interval that begins
        there.
        """
        return np.asarray(self.curve(np.clip(instants, self.time[0], self.time[-1])))

    def trajectory(self) -> Trajectory:
        """Samples of the polynomials as a trajectory with the channel ``tau_m``; ``meta`` has
        their degree.
        """
        share = np.arange(SAMPLES) / SAMPLES
        time = np.append(
            (self.time[:-1, None] + np.diff(self.time)[:, None] * share).ravel(), self.time[-1]
        )
        port = Port("tau_m", (len(self.labels),), "N m", "motor torques, motor side")
        meta = {
            **self.meta,
            "kind": "torque command",
            "torque": "limited",
            POLYNOMIALS: len(self.curve.c) - 1,
        }
        return Trajectory(
            time, {"tau_m": self.at(time)}, {"tau_m": port}, {"tau_m": self.labels}, meta
        )


def command_in(
    time: np.ndarray, values: np.ndarray, labels: tuple[str, ...], meta: Mapping[str, Any]
) -> TorqueCommand | None:
    """The torques that a controller sent, where a trajectory states how its drive held them, or
    that they jump.

    Parameters
    ----------
    time : array (n,) [s]
        Ticks of the controller.
    values : array (n, n_m) [N m]
    labels : tuple of str
        Names of the motors.
    meta : mapping
        Of the trajectory: ``hold``, and with ``"linear"`` or ``"zoh"`` also ``sample_time`` and
        ``delay`` [s]; ``torque_degree`` of torques that are polynomials with jumps.

    Returns
    -------
    TorqueCommand or None
        None: neither is stated, the torque is continuous.

    Raises
    ------
    ArgumentError
        Hold, sample time or delay are out of range, or the instants are not one sample time apart.
    """
    degree = read_degree(meta)
    if degree is not None:
        curve = interval_polynomials(time, values, degree)
        ends = time[::SAMPLES]
        own = {key: meta[key] for key in ("model", "variant", "move") if key in meta}
        step = float(np.diff(ends).mean())
        return PolynomialTorque(ends, values[::SAMPLES], labels, "spline", step, 0.0, own, curve)
    hold = meta.get("hold")
    if hold is None or hold == "spline":
        return None
    sample_time = meta.get("sample_time")
    delay = meta.get("delay", 0.0)
    check_hold(hold, sample_time, delay)
    if sample_time is None or np.abs(np.diff(time) - sample_time).max() > 1e-6 * sample_time:
        raise ArgumentError(
            f"trajectory: given torques held for the sample time {sample_time!r} s at other "
            "instants, expected rows one sample time apart"
        )
    return TorqueCommand(time, values, labels, hold, float(sample_time), float(delay), {})


def hold_torque(
    t: np.ndarray,
    tau: np.ndarray,
    hold: str,
    sample_time: float,
    delay: float = 0.0,
    *,
    limited: bool = False,
    degree: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Ticks of a controller and the torques that it has to send, see the text of this module.

    ``"zoh"``: means of the torque between ticks less 1/12 of their second difference (not with
    limits); ``"linear"``: the polygon with the least squared distance; ``"spline"``: samples.

    Parameters
    ----------
    t : array (n,) [s]
    tau : array (n, n_m) [N m]
        Samples of the continuous torque, which is constant before the first and after the last
        one.
    hold : str
        ``"spline"``, ``"linear"`` or ``"zoh"``.
    sample_time : float [s]
        Of the controller.
    delay : float [s]
        From a tick to the instant at which the motor has the torque.
    limited : bool
        Whether limits may be active, see `torque_curve`.
    degree : int, optional
        Of polynomials that may jump, see `torque_curve`.

    Returns
    -------
    time : array (k,) [s]
        Multiples of the sample time from ``t[0]``; the first torque is at the motor at ``t[0]`` or
        before it.
    values : array (k, n_m) [N m]
        The last row is ``tau[-1]``.

    Raises
    ------
    ArgumentError
        An argument is out of range.
    """
    check_hold(hold, sample_time, delay)
    first = -int(np.ceil(delay / sample_time - SAME))
    last = int(np.ceil((t[-1] - t[0] - delay) / sample_time - SAME))
    if last - first > MOST:
        raise ArgumentError(
            f"sample_time: given {sample_time:.3g} s, which makes {last - first} ticks, "
            f"expected at most {MOST}; take a longer sample time"
        )
    time = t[0] + sample_time * np.arange(first, max(last, first + 1) + 1)
    curve = extend_constant(t, tau, limited, degree)
    edges = time + delay
    if hold == "spline":
        return time, curve(edges)
    left, right = _moments(t, curve, edges)
    if hold == "zoh":
        values = np.vstack([left + right, tau[-1:]])
        if not limited:
            values[:-1] -= _second_difference(values)[:-1] / 12
        return time, values
    values = _projection(curve(edges), left, right)
    return time, np.clip(values, tau.min(axis=0), tau.max(axis=0)) if limited else values


def check_hold(hold: str, sample_time: float | None, delay: float) -> None:
    """ArgumentError where the hold of a controller is out of range."""
    if hold not in HOLDS:
        raise ArgumentError(f"hold: given {hold!r}, expected one of {', '.join(HOLDS)}")
    if sample_time is not None and not (is_number(sample_time) and sample_time > 0):
        raise ArgumentError(f"sample_time: given {sample_time!r}, expected a positive time in s")
    if not (is_number(delay) and delay >= 0):
        raise ArgumentError(f"delay: given {delay!r}, expected zero or a positive time in s")


def extend_constant(
    t: np.ndarray, tau: np.ndarray, limited: bool, degree: int | None = None
) -> Callable[[np.ndarray], np.ndarray]:
    """The continuous torque [N m] as a function of instants, from samples ``tau`` (n, n_m) at
    ``t`` (n,) [s]; constant before the first and after the last one. ``limited``, ``degree``: how
    `torque_curve` interpolates.
    """
    curve = then_constant(torque_curve(t, tau, limited=limited, degree=degree), tau[-1])
    return lambda instants: np.asarray(curve(np.maximum(instants, t[0])))


def _moments(
    t: np.ndarray, curve: Callable[[np.ndarray], np.ndarray], edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Means of ``(1 - x) tau`` and of ``x tau`` on each interval between two ``edges`` [s], where
    x goes from 0 to 1: (intervals, n_m) [N m] each.

    Gauss quadrature on pieces that end at the samples ``t``, where the ``curve`` is less smooth.
    """
    inside = t[(t > edges[0]) & (t < edges[-1])]
    ends = np.unique(np.concatenate([edges, inside]))
    own = np.searchsorted(edges, (ends[:-1] + ends[1:]) / 2) - 1  # the interval of each piece
    points, weights = leggauss(GAUSS)
    length = np.diff(ends)
    instants = ends[:-1, None] + length[:, None] * (points + 1) / 2
    width = np.diff(edges)[own]
    x = (instants - edges[own][:, None]) / width[:, None]
    share = weights / 2 * (length / width)[:, None]
    torque = curve(instants.ravel()).reshape(*instants.shape, -1)
    starts = np.searchsorted(own, np.arange(len(edges) - 1))
    left, right = (np.einsum("pg,pgm->pm", w * share, torque) for w in (1 - x, x))
    return np.add.reduceat(left, starts), np.add.reduceat(right, starts)


def _second_difference(values: np.ndarray) -> np.ndarray:
    """``u_(k-1) - 2 u_k + u_(k+1)`` of the rows, with constant values before and after."""
    padded = np.concatenate([values[:1], values, values[-1:]])
    return np.asarray(padded[2:] - 2 * values + padded[:-2])


def _projection(ends: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Values (n, n_m) [N m] at the edges of the polygon with the least squared distance from a
    torque with the moments ``left``, ``right`` (n - 1, n_m); the first and last value are those in
    ``ends``.

    ``(u_(k-1) + 4 u_k + u_(k+1)) / 6 = right_(k-1) + left_k``.
    """
    values = ends.copy()
    n = len(ends) - 2
    if n < 1:
        return values
    moments = right[:-1] + left[1:]
    moments[0] -= ends[0] / 6
    moments[-1] -= ends[-1] / 6
    bands = np.array([[1 / 6], [4 / 6], [1 / 6]]) * np.ones(n)
    values[1:-1] = solve_banded((1, 1), bands, moments)
    return values
