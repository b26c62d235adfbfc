"""Limits: bounds on torques, speeds, deflections and the tool that a solution has to keep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_class
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.arguments import is_number, is_whole
from flexgen.dynamics.mechanics.equations import Equations, robot_of
from flexgen.model.elements import RobotModel, Tool

MOST = 10_000  # motors, and non-actuated coordinates
Points = tuple[tuple[float, float], ...]
# Sequences of bounds, and for each of what there is one.
EACH = {
    "torque": "motor",
    "speed": "motor",
    "deflection": "non-actuated coordinate",
    "torque_rate": "motor",
    "torque_rms": "motor",
    "thermal_time": "motor",
    "gear_torque": "gear",
    "gear_torque_rms": "gear",
    "joint_speed": "gear",
    "joint_acceleration": "gear",
}
KEPT = ("torque", "speed", "deflection")  # by all methods of `solve` that keep limits
# relative: the method lq keeps limits to a thousandth, in samples of a rougher tolerance
KEPT_TO = 1.1e-3


@checked_class
@dataclass(frozen=True)
class Limits:
    """Bounds on torques, speeds, deflections and the tool; None: no bounds of that kind.

    `from_model` reads them from the model file, or makes them from one number for all motors.
    `fastest` keeps all of them, `solve` all but the effective ones (``torque_rms``,
    ``gear_torque_rms``), of which it states what its solution exceeds. Its methods "full" and
    "collocation" keep ``torque``, ``speed`` and ``deflection`` alone.

    Attributes
    ----------
    torque, speed : tuple of float [N m], [rad/s]
        One entry for each motor, motor side.
    deflection : tuple of float [rad or m]
        One entry for each non-actuated coordinate, in chain order.
    torque_rate : tuple of float [N m/s]
        Of each motor's torque.
    torque_rms, thermal_time : tuple of float [N m], [s]
        Root mean square of each motor's torque: of its square filtered with the time constant,
        from 0 at the start; an infinite one: over the time of the path.
    torque_speed : tuple of tuples of (float, float) [rad/s, N m]
        For each motor points of the largest torque over the speed; empty: no curve.
    gear_torque, gear_torque_rms : tuple of float [N m or N]
        Of each gear at its joint: largest torque, and root mean square over the motion.
    joint_speed, joint_acceleration : tuple of float [rad/s or m/s, rad/s^2 or m/s^2]
        Of each actuated coordinate.
    tool_speed, tool_acceleration : float [m/s], [m/s^2]
        Of the tool's origin.
    reserve : float
        Part of the torques, the torque curves and the gear torques that is left for feedback, 0 to
        below 1.

    Examples
    --------
    >>> flexgen.Limits.from_model("elbow", torque=20.0)
    Limits(torque=(20.0, 20.0))
    >>> flexgen.Limits(torque_rate=(500.0, 400.0), tool_speed=1.5, reserve=0.1)  # N m/s, m/s
    Limits(torque_rate=(500.0, 400.0), tool_speed=1.5, reserve=0.1)
    """

    torque: tuple[float, ...] | None = None
    speed: tuple[float, ...] | None = None
    deflection: tuple[float, ...] | None = None
    torque_rate: tuple[float, ...] | None = None
    torque_rms: tuple[float, ...] | None = None
    thermal_time: tuple[float, ...] | None = None
    torque_speed: tuple[Points, ...] | None = None
    gear_torque: tuple[float, ...] | None = None
    gear_torque_rms: tuple[float, ...] | None = None
    joint_speed: tuple[float, ...] | None = None
    joint_acceleration: tuple[float, ...] | None = None
    tool_speed: float | None = None
    tool_acceleration: float | None = None
    reserve: float = 0.0

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name, each in EACH.items():
            values = getattr(self, name)
            if values is not None and not _are_numbers(values):
                raise ArgumentError(
                    f"limits: given {name} {show_value(values)}, expected a sequence of "
                    f"numbers, one for each {each}"
                )
            if values is not None and not all(x > 0 for x in values):
                raise ArgumentError(
                    f"limits: given {name} {show_value(values)}, expected {len(values)} positive "
                    f"numbers, one for each {each}"
                )
        for name, unit in (("tool_speed", "m/s"), ("tool_acceleration", "m/s^2")):
            value = getattr(self, name)
            if value is not None and not (is_number(value) and value > 0):
                raise ArgumentError(
                    f"limits: given {name} {show_value(value)}, expected a number > 0 in {unit}"
                )
        if not (is_number(self.reserve) and 0.0 <= self.reserve < 1.0):
            raise ArgumentError(
                f"limits: given reserve {show_value(self.reserve)}, expected a number from 0 to "
                "below 1"
            )
        for curve in self.torque_speed or ():
            _check_curve(curve)

    @classmethod
    def from_model(
        cls,
        model: str | Path | RobotModel | Equations,
        *,
        torque: float | Sequence[float] | None = None,
        speed: float | Sequence[float] | None = None,
        deflection: float | Sequence[float] | None = None,
        reserve: float = 0.0,
    ) -> Limits:
        """The limits of motors, gears, springs and tool in the model file; with bounds given here,
        these alone.

        Those of the speed and the acceleration of joints are not among them: they bound planned
        paths.

        Parameters
        ----------
        model : name, path, RobotModel or Equations
        torque, speed : float or sequence of float, optional [N m], [rad/s]
            Motor side; one number for all motors, or one for each.
        deflection : float or sequence of float, optional [rad or m]
            One number for all non-actuated coordinates, or one for each.
        reserve : float
            Part of the torques that is left for feedback.

        Returns
        -------
        Limits

        Raises
        ------
        ArgumentError
            The model file states none; a bound is not positive, or their number does not fit the
            model.
        """
        robot = robot_of(model)
        sizes = {"torque": robot.n_m, "speed": robot.n_m, "deflection": robot.n_e}
        given = {"torque": torque, "speed": speed, "deflection": deflection}
        if all(values is None for values in given.values()):
            found = limits_of_model(robot)
            if found == cls():
                raise ArgumentError(
                    f"limits: model {robot.name} states none, expected torque_max or speed_max "
                    "of a motor; add them to the model file"
                )
            every = (found.torque, found.speed)
            inf = (np.inf,) * robot.n_m
            torque, speed = (inf if values is None else values for values in every)
            return replace(found, torque=torque, speed=speed, reserve=reserve)
        out: dict[str, Any] = {}
        for name, values in given.items():
            if values is not None:
                if isinstance(values, Real) and not float(values) > 0:
                    raise ArgumentError(
                        f"limits: given {name} {show_value(values)}, expected {sizes[name]} "
                        "positive numbers"
                    )
                each: Any = (values,) * sizes[name] if isinstance(values, Real) else values
                out[name] = tuple(float(x) for x in _bounds(name, each, sizes[name]))
        return cls(**out, reserve=reserve)

    def merge(self, robot: RobotModel) -> Limits:
        """These limits, and those of the model file of the kinds that have no bounds here."""
        own = limits_of_model(robot)
        more = {
            one.name: getattr(own, one.name)
            for one in fields(self)
            if getattr(self, one.name) is None
        }
        merged = replace(self, **more)
        if merged.thermal_time is not None and merged.torque_rms is None:
            raise ArgumentError(
                f"limits: given thermal_time {show_value(self.thermal_time)} alone, expected "
                "torque_rms in addition"
            )
        return merged

    def arrays(self, n_m: int) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of torque, less the reserve, and speed (n_m,), infinite where there is none.

        ArgumentError where the sizes differ.
        """
        torque = _bounds("torque", self.torque, n_m)
        return torque * (1.0 - self.reserve) if self.reserve else torque, _bounds(
            "speed", self.speed, n_m
        )

    def deflections(self, n_e: int) -> np.ndarray:
        """Bounds of the non-actuated coordinates (n_e,), infinite where there is none."""
        return _bounds("deflection", self.deflection, n_e)

    def bounds(self, name: str, size: int) -> np.ndarray:
        """Bounds of one kind (size,), infinite where there is none; ArgumentError for another kind
        or number.
        """
        if name not in EACH:
            raise ArgumentError(
                f"limits: given kind {show_value(name)}, expected one of {', '.join(EACH)}"
            )
        return _bounds(name, getattr(self, name), size)

    def for_library(self, model: str | Path | RobotModel | Equations) -> dict[str, Any]:
        """Arguments of `Library.invert_limited` and `Stream.limit_all` that keep these limits,
        less the reserve.

        Effective values (``torque_rms``, ``gear_torque_rms``) are not among them: they are those
        of a whole motion. Limits of the tool are where the output is its position or pose.

        Parameters
        ----------
        model : name, path, RobotModel or Equations

        Returns
        -------
        dict of str to array, float or list
            ``torque_max``, ``speed_max``, ``deflection_max``, and the names of all others that
            have bounds.

        Raises
        ------
        ArgumentError
            The number of the bounds of one kind does not fit the model.

        Examples
        --------
        >>> flexgen.Limits(torque=(20.0, 10.0), reserve=0.1).for_library("planar5_nmp")[
        ...     "torque_max"
        ... ]
        array([18.,  9.])
        """
        robot = robot_of(model)
        torque, speed = self.arrays(robot.n_m)
        sizes = {"gear": robot.n_g, "motor": robot.n_m}
        left = 1.0 - self.reserve
        curves = self.torque_speed or ((),) * robot.n_m
        if len(curves) != robot.n_m:
            raise ArgumentError(
                f"limits: given torque_speed of {len(curves)} motors, expected a curve or () "
                f"for each of {robot.n_m}"
            )
        for k, curve in enumerate(curves):
            if curve:
                torque[k] = min(torque[k], left * curve[0][1])
        out = {
            "torque_max": torque,
            "speed_max": speed,
            "deflection_max": self.deflections(robot.n_e),
        }
        for name in ("gear_torque", "torque_rate", "joint_speed", "joint_acceleration"):
            if getattr(self, name) is not None:
                out[f"{name}_max"] = (left if name == "gear_torque" else 1.0) * self.bounds(
                    name, sizes[EACH[name]]
                )
        more: dict[str, Any] = {}
        if robot.output.type != "combination":
            more = {
                f"{name}_max": getattr(self, name) or 0.0
                for name in ("tool_speed", "tool_acceleration")
            }
        if self.torque_speed is not None:
            more["torque_speed"] = [
                [(v, left * tau) for v, tau in curve] for curve in self.torque_speed
            ]
        return out | more

    def without(self, *names: str) -> Limits:
        """These limits without the named kinds."""
        if unknown := set(names) - {*EACH, "torque_speed", "tool_speed", "tool_acceleration"}:
            raise ArgumentError(
                f"limits: given kinds {show_value(sorted(unknown))}, expected fields of "
                "flexgen.Limits"
            )
        none: dict[str, Any] = dict.fromkeys(names)
        return replace(self, **none)


def limits_of_model(robot: RobotModel) -> Limits:
    """All limits of a model file but those of the joints, which have them in their own keys:
    motors, gears, springs without motor and tool.
    """

    def known(parts: Sequence[Any], name: str) -> Any:
        """The number ``name`` of each motor, joint or spring, infinite where it has none; None
        where no one has it.
        """
        values = [getattr(part, name, None) for part in parts]
        return (
            None
            if all(x is None for x in values)
            else tuple(np.inf if x is None else float(x) for x in values)
        )

    gears = [c.dof.gear for c in robot.coordinates if c.dof is not None and c.dof.gear is not None]
    springs = [robot.coordinates[i].dof for i in robot.i_e]
    curves = tuple(motor.torque_speed for motor in robot.motors)
    tool = robot.tool if isinstance(robot.tool, Tool) else Tool()
    motors = {
        name: known(robot.motors, f"{name}_max")
        for name in ("torque", "speed", "torque_rate", "torque_rms")
    }
    return Limits(
        **motors,
        deflection=known(springs, "deflection_max"),
        thermal_time=known(robot.motors, "thermal_time"),
        torque_speed=curves if any(curves) else None,
        gear_torque=known(gears, "torque_max"),
        gear_torque_rms=known(gears, "torque_rms_max"),
        tool_speed=tool.speed_max,
        tool_acceleration=tool.acceleration_max,
    )


def _are_numbers(values: Any) -> bool:
    """Whether the values are a sequence or an array of real numbers; their number is free."""
    if (
        isinstance(values, str | bytes)
        or not isinstance(values, Sequence | np.ndarray)
        or np.ndim(values) != 1
    ):
        return False
    return all(isinstance(x, Real) and not isinstance(x, bool | np.bool_) for x in values)


def _check_curve(curve: Any) -> None:
    """ArgumentError where points are not those of a torque that falls over the speed, faster and
    faster.
    """
    from flexgen.base.spec.curve import TORQUE_SPEED, points_of

    if points_of(curve) is None:
        raise ArgumentError(
            f"limits: given torque_speed {show_value(curve)}, expected {TORQUE_SPEED}"
        )


def _bounds(name: str, values: Sequence[float] | None, size: int) -> np.ndarray:
    """The bounds ``name`` as an array (size,); infinite where there are none. ArgumentError for
    another number of them, or one that is not positive.
    """
    if not is_whole(size, 0, MOST):
        raise ArgumentError(
            f"limits, number of {name} bounds: given {show_value(size)}, expected 0 to {MOST}"
        )
    if values is None:
        return np.full(size, np.inf)
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if array.shape != (size,) or not (array > 0).all():
        raise ArgumentError(f"limits: given {name} {values}, expected {size} positive numbers")
    return array
