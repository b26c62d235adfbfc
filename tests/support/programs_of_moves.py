"""A program of ten motions of a six-axis robot whose model file has limits of every kind."""

from __future__ import annotations

import numpy as np

import flexgen
from flexgen import MoveJ, MoveL

TORQUES = (8.2, 6.7, 9.7, 1.33, 1.18, 0.53)  # N m, motor side
LIMITS = {
    "torque_max": TORQUES,
    "speed_max": (260.0, 310.0, 96.0, 146.0, 70.0, 260.0),
    "torque_rate_max": (235.0, 246.0, 200.0, 159.0, 173.0, 141.0),
    "torque_rms_max": (1.37, 2.6, 4.77, 0.30, 0.42, 0.17),
}
GEARS = {
    "element.body1.dof.q1": 710.0,
    "element.body2.dof.q2": 1120.0,
    "element.body3.dof.q3": 503.0,
}
SPRINGS = {
    "element.body1.dof.t1z": 7.1e-4,
    "element.body2.dof.b1y": 2.1e-4,
    "element.body2.dof.t2y": 2.4e-3,
    "element.body3.dof.t3z": 2.9e-3,
    "element.body4.dof.t4x": 1.06e-3,
    "element.body5.dof.t5y": 3.0e-4,
}


def ten_motions() -> tuple[flexgen.RobotModel, flexgen.Program]:
    """The robot manutec_r3_18 with limits of torque, rate, speed, heat, gears, bearings and tool,
    and a program.
    """
    plain = flexgen.read("manutec_r3_18")
    keys: dict[str, object] = {"tool.speed_max": 1.2, "tool.acceleration_max": 8.0}
    for k, motor in enumerate(plain.motors):
        keys |= {f"motor.{motor.name}.{name}": values[k] for name, values in LIMITS.items()}
        torque = TORQUES[k]
        speed = LIMITS["speed_max"][k]
        keys[f"motor.{motor.name}.torque_speed"] = [
            [0.0, torque],
            [0.5 * speed, torque],
            [1.1 * speed, 0.3 * torque],
        ]
    keys |= {f"{place}.gear.torque_max": torque for place, torque in GEARS.items()}
    keys |= {f"{place}.deflection_max": size for place, size in SPRINGS.items()}
    return flexgen.read("manutec_r3_18", overrides=keys), _program(np.array(plain.home))


def _program(home: np.ndarray) -> flexgen.Program:
    def near(*degrees: float) -> tuple[float, ...]:
        return tuple(home + np.deg2rad(degrees))

    steps = (
        MoveJ(near(20, 5, -5, 10, -10, 20)),
        MoveL((0.0, 0.1, -0.1)),
        MoveL((0.1, 0.0, -0.05)),
        MoveJ(near(-20, 10, -10, 20, 10, -20), zone=0.1),
        MoveJ(near(-30, 0, 0, 0, 0, 0)),
        MoveL((0.0, -0.1, -0.1)),
        MoveL((0.0, 0.1, 0.0), zone=0.03, speed=0.4),
        MoveL((0.1, 0.0, 0.0)),
        MoveJ(near(10, 10, 0, -20, 0, 10), pause=0.2),
        MoveL((-0.1, 0.05, -0.1)),
        MoveL((0.0, -0.1, 0.1)),
        MoveJ(near(0, 0, 0, 0, 0, 0)),
    )
    # m/s, rad/s and their derivatives
    tool = (0.5, 2.0, 20.0, 200.0)
    joints = (1.5, 6.0, 60.0, 600.0)
    return flexgen.Program(
        "ten", start=tuple(home), smoothness=5, steps=steps, profile=tool, joint_profile=joints
    )
