"""The state with which a simulation begins: at rest, or with the speeds of the first sample."""

from __future__ import annotations

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.dynamics.mechanics.statics import Equilibrium
from flexgen.model.elements import RobotModel


def start_state(
    robot: RobotModel,
    data: Trajectory,
    given: dict[str, np.ndarray],
    start: Equilibrium | None,
    moving: bool,
) -> np.ndarray:
    """The state (q_a, q_me, v_a, v_me) with which the simulation begins: ``start``, or the first
    sample, at rest or with its speeds (``moving``).
    """
    q_a, q_m = (given["q_a"][0], given["q_m"][0]) if start is None else (start.q_a, start.q_m)
    return np.concatenate([q_a, q_m[list(robot.i_m)], _first_speed(robot, data, moving)])


def _first_speed(robot: RobotModel, data: Trajectory, moving: bool) -> np.ndarray:
    """Speeds (dof,) [rad/s or m/s] at the start: zero, or those of the first sample if ``moving``;
    ArgumentError where the trajectory has none, or in another unit.
    """
    if not moving:
        return np.zeros(robot.dof)
    parts = []
    for name, wanted in (
        ("v_a", {c.name: f"{c.unit}/s" for c in robot.coordinates}),
        ("v_m", {robot.motors[j].name: "rad/s" for j in robot.i_m}),
    ):
        labels = list(wanted)
        if name not in data.channels or not set(labels) <= set(data.labels[name]):
            raise ArgumentError(
                f"moving: the trajectory has no channel {name} of {robot.name}, expected its "
                "speeds"
            )
        columns = [data.labels[name].index(label) for label in labels]
        for k, label in zip(columns, labels, strict=True):
            unit = data.units[name][k]
            # (one unit for all columns: rad or m)
            if unit != wanted[label] and " or " not in unit:
                raise ArgumentError(
                    f"moving: given {name} in {unit}, expected {wanted[label]} (column {label})"
                )
        parts.append(data[name][0, columns])
    speed = np.concatenate(parts)
    if not np.isfinite(speed).all():
        raise ArgumentError("moving: given speeds that are not finite, expected finite numbers")
    return speed
