"""Utilization of the limits by a motion.

torque          |tau_m| <= (1 - r) tau_max,       with the reserve r
torque_speed    |tau_m|/(1 - r) + k |v_m| <= c,
each edge of the curve, and |v_m| <= its last speed
torque_rate     |tau_m(t + h) - tau_m(t)|/h <= rate_max
torque_rms      y <= rms_max^2,  T y' = tau_m^2 - y,  y(0) = 0;
without T: the mean of tau_m^2 <= rms_max^2
gear_torque     |tau_g| <= (1 - r) max,           and their mean square
others          speeds and accelerations of motors, joints and the tool, and deflections
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.model.elements import RobotModel

ToolMotion = tuple[np.ndarray, np.ndarray]  # speed and acceleration of its origin (n,)
# an array (n, k) of samples by name: q_a v_a a_a tau_g v_m tau_m
Channel = Callable[[str], np.ndarray]


@dataclass(frozen=True)
class LimitRow:
    """A quantity of a motion and its bounds.

    ``parts`` (n, k): the quantity over its bound, at n instants, of k parts with ``names`` and
    ``units``; an effective value has a single instant. ``values`` and ``bounds`` (n, k) [unit].
    """

    quantity: str
    units: tuple[str, ...]
    names: tuple[str, ...]
    parts: np.ndarray
    values: np.ndarray
    bounds: np.ndarray


@dataclass(frozen=True)
class LimitUse:
    """The largest use of one limit: its part of the bound, the value and the bound [unit], and the
    instant [s].

    ``time_s`` is None for an effective value over the whole motion.
    """

    quantity: str
    name: str
    unit: str
    part: float
    value: float
    bound: float
    time_s: float | None

    def __str__(self) -> str:
        """One line."""
        when = "" if self.time_s is None else f" at {self.time_s:.3f} s"
        return (
            f"{self.quantity} of {self.name}: {self.value:.4g} {self.unit}{when}, "
            f"{100 * self.part:.1f} % of its limit {self.bound:.4g} {self.unit}"
        )

    def warning(self) -> str:
        """A warning, for a use above 100 %."""
        value, bound = (f"{x:.4g} {self.unit}" for x in (self.value, self.bound))
        return f"{self.name}: {self.quantity} {value} exceeds its limit {bound}"


def limit_rows(
    model: RobotModel,
    limits: Limits,
    channel: Channel,
    time: np.ndarray,
    tool: Callable[[], ToolMotion] | None = None,
    end: float = np.inf,
) -> Iterator[LimitRow]:
    """The quantities that have bounds, along a motion.

    Parameters
    ----------
    model : RobotModel
    limits : Limits
    channel : callable
        Arrays (n, k) of the motion by name: ``q_a``, ``v_a``, ``a_a``, ``tau_g``, ``v_m``,
        ``tau_m``.
    time : array (n,) [s]
        Instants of the samples.
    tool : callable, optional
        Gives the motion of the tool where it is known; default: from the kinematics.
    end : float [s]
        Of the path, which begins at 0: a mean square without a time constant is that between these
        instants: a long rest after the path would make it small. Default: that of all samples.

    Yields
    ------
    LimitRow
    """
    left = 1.0 - limits.reserve
    motors = tuple(motor.name for motor in model.motors)
    joints, springs = (
        tuple(model.coordinates[i].name for i in part) for part in (model.i_g, model.i_e)
    )
    units_g, units_e = (
        tuple(model.coordinates[i].unit for i in part) for part in (model.i_g, model.i_e)
    )
    i_g = list(model.i_g)
    i_e = list(model.i_e)
    of_gear = tuple("N m" if unit == "rad" else "N" for unit in units_g)
    speeds_g, rates_g = (tuple(f"{unit}/{per}" for unit in units_g) for per in ("s", "s^2"))
    shares = {"torque": left, "gear_torque": left}
    simple: tuple[
        tuple[str, str, tuple[str, ...], tuple[str, ...], Callable[[], np.ndarray]], ...
    ] = (
        ("torque", "motor torque", _each("N m", motors), motors, lambda: channel("tau_m")),
        ("speed", "motor speed", _each("rad/s", motors), motors, lambda: channel("v_m")),
        ("deflection", "deflection", units_e, springs, lambda: channel("q_a")[:, i_e]),
        (
            "torque_rate",
            "rate of the torque",
            _each("N m/s", motors),
            motors,
            lambda: _rate(channel("tau_m"), time),
        ),
        ("gear_torque", "gear torque", of_gear, joints, lambda: channel("tau_g")),
        ("joint_speed", "speed", speeds_g, joints, lambda: channel("v_a")[:, i_g]),
        ("joint_acceleration", "acceleration", rates_g, joints, lambda: channel("a_a")[:, i_g]),
    )
    for key, quantity, units, names, values in simple:
        if getattr(limits, key) is not None:
            yield _row(
                quantity,
                units,
                names,
                values(),
                shares.get(key, 1.0) * limits.bounds(key, len(names)),
            )
    if limits.torque_speed is not None:
        yield from _curve_rows(limits, motors, channel("tau_m"), channel("v_m"))
    if limits.torque_rms is not None:
        times = limits.bounds("thermal_time", model.n_m)
        effective = _effective(channel("tau_m"), times, time, end)
        yield _row(
            "effective torque",
            _each("N m", motors),
            motors,
            effective,
            limits.bounds("torque_rms", model.n_m),
        )
    if limits.gear_torque_rms is not None:
        effective = _effective(channel("tau_g"), np.full(model.n_g, np.inf), time, end)
        yield _row(
            "effective gear torque",
            of_gear,
            joints,
            effective,
            limits.bounds("gear_torque_rms", model.n_g),
        )
    if limits.tool_speed is not None or limits.tool_acceleration is not None:
        known = tool or partial(tool_motion, derive(model), *map(channel, ("q_a", "v_a", "a_a")))
        yield from _tool_rows(limits, known())


def uses_of_limits(
    model: RobotModel, limits: Limits, channel: Channel, time: np.ndarray, end: float = np.inf
) -> tuple[LimitUse, ...]:
    """The largest use of each limit along a motion; arguments of `limit_rows`."""
    out: dict[tuple[str, str], LimitUse] = {}
    for row in limit_rows(model, limits, channel, time, end=end):
        at = np.abs(row.parts).argmax(axis=0)
        for k, name in enumerate(row.names):
            part, value = (float(abs(x[at[k], k])) for x in (row.parts, row.values))
            known = out.get((row.quantity, name))
            if np.isfinite(row.bounds[at[k], k]) and (known is None or part > known.part):
                when = None if len(row.parts) == 1 else float(time[at[k]])
                bound = max(float(row.bounds[at[k], k]), 0.0)
                out[row.quantity, name] = LimitUse(
                    row.quantity, name, row.units[k], part, value, bound, when
                )
    return tuple(out.values())


def _row(
    quantity: str,
    units: tuple[str, ...],
    names: tuple[str, ...],
    values: np.ndarray,
    bounds: np.ndarray,
) -> LimitRow:
    """A row of a quantity (n, k), whose use is value over bound; ``bounds``: (n, k), or (k,) for
    all instants.
    """
    return LimitRow(
        quantity, units, names, values / bounds, values, np.broadcast_to(bounds, values.shape)
    )


def _each(unit: str, names: tuple[str, ...]) -> tuple[str, ...]:
    return (unit,) * len(names)


def _curve_rows(
    limits: Limits, motors: tuple[str, ...], tau: np.ndarray, speed: np.ndarray
) -> Iterator[LimitRow]:
    """Of each motor with a torque-speed curve its edges, ``abs(tau)/c + abs(speed) k/c <= 1`` for
    both signs of the torque, and its largest speed.

    c: torque at rest [N m]; k: loss with speed [N m s/rad]. The reserve of the limits lowers the
    torque that is left. ``tau``, ``speed`` (n, n_m).
    """
    left = 1.0 - limits.reserve
    for j, (name, curve) in enumerate(zip(motors, limits.torque_speed or (), strict=True)):
        if not curve:
            continue
        c, k = edges_of_curve(curve).T
        own = tau[:, j : j + 1]
        load = np.abs(speed[:, j : j + 1]) * k
        parts = np.hstack([own / left + load, own / left - load]) / np.tile(c, 2)
        values, allowed = (
            np.tile(x, (1, 2 * len(k) // x.shape[1])) for x in (own, left * (c - load))
        )
        names = (name,) * len(parts.T)
        yield LimitRow("torque at its speed", _each("N m", names), names, parts, values, allowed)
        yield _row(
            "speed of its torque curve",
            ("rad/s",),
            (name,),
            speed[:, j : j + 1],
            np.array([curve[-1][0]]),
        )


def edges_of_curve(points: Sequence[Sequence[float]]) -> np.ndarray:
    """Of each edge of a torque-speed curve the torque at rest [N m], and what the speed takes from
    it [N m s/rad].
    """
    speeds, torques = np.array(points).T
    k = -np.diff(torques) / np.diff(speeds)
    return np.stack([torques[1:] + k * speeds[1:], k], axis=1)


def edges_of_curves(curves: Sequence[Sequence[Sequence[float]]]) -> np.ndarray:
    """Motor, torque at rest and what the speed takes from it, of each edge of the curves of motors
    (n, 3).
    """
    rows = [
        (j, *edge) for j, curve in enumerate(curves) if curve for edge in edges_of_curve(curve)
    ]
    return np.array(rows, dtype=float).reshape(-1, 3)


def _rate(values: np.ndarray, time: np.ndarray) -> np.ndarray:
    return np.diff(values, axis=0) / np.diff(time)[:, None]


def _effective(
    values: np.ndarray, constants: np.ndarray, time: np.ndarray, end: float
) -> np.ndarray:
    """Effective values (n, k), or (1, k) where all time constants are infinite."""
    on_path = slice(None) if np.isinf(end) else (time >= 0.0) & (time <= end)
    mean = np.sqrt((values[on_path] ** 2).mean(axis=0, keepdims=True))
    if np.isinf(constants).all():
        return mean
    from scipy.signal import lfilter  # two fifths of the import of `flexgen.solve`

    out = np.repeat(mean, len(values), axis=0)
    for j in np.flatnonzero(np.isfinite(constants)):
        part = -np.expm1(-(time[-1] - time[0]) / (len(time) - 1) / constants[j])
        out[:, j] = np.sqrt(lfilter([part], [1.0, part - 1.0], values[:, j] ** 2))
    return out


def tool_motion(equations: Equations, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> ToolMotion:
    """Speed and acceleration (n,) of the tool's origin for positions, speeds and accelerations (n,
    n_a) of the arm.
    """
    J = evaluate(equations.function("jacobian"), q)[0].reshape(len(q), 6, -1)[:, :3]
    dJ = evaluate(equations.function("jacobian_dot"), q, v)[0].reshape(len(q), 6, -1)[:, :3]
    speed, acceleration = (np.einsum("nij,nj->ni", J, x) for x in (v, a))
    return norms(speed, acceleration + np.einsum("nij,nj->ni", dJ, v))


def norms(*vectors: np.ndarray) -> ToolMotion:
    """Norms (n,) of vectors (n, 3)."""
    speed, acceleration = (np.linalg.norm(x, axis=1) for x in vectors)
    return speed, acceleration


def _tool_rows(limits: Limits, motion: ToolMotion) -> Iterator[LimitRow]:
    """Rows of the speed [m/s] and the acceleration [m/s^2] of the tool, where they are limited."""
    named = (
        ("speed", "m/s", limits.tool_speed),
        ("acceleration", "m/s^2", limits.tool_acceleration),
    )
    for (quantity, unit, bound), values in zip(named, motion, strict=True):
        if bound is not None:
            yield _row(quantity, (unit,), ("the tool",), values[:, None], np.array([bound]))
