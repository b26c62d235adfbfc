"""Limits: bounds on motor torque, motor speed and deflection that a solution has to keep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.counts import show_value
from flexgen.display import short_repr
from flexgen.errors import ArgumentError
from flexgen.mechanics.equations import Equations, robot_of
from flexgen.model.elements import RobotModel
from flexgen.spec.arguments import is_whole
from flexgen.type_checks import checked_class

MOST = 10_000  # motors, and non-actuated coordinates


@checked_class
@dataclass(frozen=True)
class Limits:
    """Bounds on motor torque, motor speed and deflection; None: no bounds of that kind.

    `from_model` reads them from the model file, or makes them from one number for all motors.

    Attributes
    ----------
    torque, speed : tuple of float [N m], [rad/s]
        One entry for each motor, motor side.
    deflection : tuple of float [rad or m]
        One entry for each non-actuated coordinate, in chain order.

    Examples
    --------
    >>> flexgen.Limits.from_model("elbow", torque=20.0)
    Limits(torque=(20.0, 20.0))
    """

    torque: tuple[float, ...] | None = None
    speed: tuple[float, ...] | None = None
    deflection: tuple[float, ...] | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name in ("torque", "speed", "deflection"):
            values = getattr(self, name)
            if values is not None and not _are_numbers(values):
                each = "non-actuated coordinate" if name == "deflection" else "motor"
                raise ArgumentError(
                    f"limits: given {name} {show_value(values)}, expected a sequence of numbers, one for each {each}"
                )

    @classmethod
    def from_model(
        cls,
        model: str | Path | RobotModel | Equations,
        *,
        torque: float | Sequence[float] | None = None,
        speed: float | Sequence[float] | None = None,
        deflection: float | Sequence[float] | None = None,
    ) -> Limits:
        """The limits of torque and speed in the model file; with bounds given here, these alone.

        Parameters
        ----------
        model : name, path, RobotModel or Equations
        torque, speed : float or sequence of float, optional [N m], [rad/s]
            Motor side; one number for all motors, or one for each.
        deflection : float or sequence of float, optional [rad or m]
            One number for all non-actuated coordinates, or one for each.

        Returns
        -------
        Limits

        Raises
        ------
        ArgumentError
            The model file states none; a bound is not positive, or their number does not fit the model.
        """
        robot = robot_of(model)
        sizes = {"torque": robot.n_m, "speed": robot.n_m, "deflection": robot.n_e}
        given = {"torque": torque, "speed": speed, "deflection": deflection}
        if all(values is None for values in given.values()):
            torque = tuple(np.inf if m.torque_max is None else m.torque_max for m in robot.motors)
            speed = tuple(np.inf if m.speed_max is None else m.speed_max for m in robot.motors)
            if np.isinf([*torque, *speed]).all():
                raise ArgumentError(
                    f"limits: model {robot.name} states none, expected torque_max or speed_max of a motor; add them to "
                    "the model file"
                )
            return cls(torque, speed)
        out = {}
        for name, values in given.items():
            if values is not None:
                each: Any = (values,) * sizes[name] if isinstance(values, Real) else values
                out[name] = tuple(float(x) for x in _bounds(name, each, sizes[name]))
        return cls(**out)

    def arrays(self, n_m: int) -> tuple[np.ndarray, np.ndarray]:
        """Torque and speed bounds (n_m,), infinite where there is none; ArgumentError where the sizes differ."""
        return _bounds("torque", self.torque, n_m), _bounds("speed", self.speed, n_m)

    def deflections(self, n_e: int) -> np.ndarray:
        """Bounds of the non-actuated coordinates (n_e,), infinite where there is none."""
        return _bounds("deflection", self.deflection, n_e)


def _are_numbers(values: Any) -> bool:
    """Whether the values are a sequence or an array of real numbers; their signs and their number are free."""
    if isinstance(values, str | bytes) or not isinstance(values, Sequence | np.ndarray) or np.ndim(values) != 1:
        return False
    return all(isinstance(x, Real) and not isinstance(x, bool | np.bool_) for x in values)


def _bounds(name: str, values: Sequence[float] | None, size: int) -> np.ndarray:
    if not is_whole(size, 0, MOST):
        raise ArgumentError(f"limits, number of {name} bounds: given {show_value(size)}, expected 0 to {MOST}")
    if values is None:
        return np.full(size, np.inf)
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if array.shape != (size,) or not (array > 0).all():
        raise ArgumentError(f"limits: given {name} {values}, expected {size} positive numbers")
    return array
