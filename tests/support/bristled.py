"""Models whose motors have friction with a state, and such a robot in MuJoCo with a law of its
own.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from hysteretic import tool_error_in_mujoco

import flexgen
from flexgen.base.motion.trajectory import Trajectory
from flexgen.exports.mujoco.mujoco_checks import with_friction

NUMBERS = {
    "coulomb": 0.5,
    "static": 0.8,
    "stribeck_speed": 4.0,
    "stiffness": 800.0,
    "damping": 1.5,
}
PRESLIDING = 1e-3  # rad at the motor: deflection of the bristles before they slip


def tables(
    name: str, share: float = 0.1, presliding: float = PRESLIDING
) -> dict[str, dict[str, float]]:
    """Numbers of each motor: Coulomb torque a ``share`` of the typical torque of its path, 1.5
    times that at rest.
    """
    model = with_friction(flexgen.read(name), "viscous")
    torque = flexgen.solve(model, verify=False, progress=False).trajectory["tau_m"].std(axis=0)
    out = {}
    for motor, typical in zip(model.motors, torque, strict=True):
        coulomb = float(share * typical)
        stiffness = 1.5 * coulomb / presliding
        damping = 0.6 * float(np.sqrt(stiffness * motor.inertia))
        out[motor.name] = {
            "coulomb": coulomb,
            "static": 1.5 * coulomb,
            "stribeck_speed": 4.0,
            "stiffness": stiffness,
            "damping": damping,
        }
    return out


def bristled(
    name: str, numbers: dict[str, dict[str, float]], **overrides: Any
) -> flexgen.RobotModel:
    """The model with these tables ``lugre`` and viscous friction."""
    changes = {f"motor.{motor}.lugre": table for motor, table in numbers.items()}
    return with_friction(flexgen.read(name, overrides=changes | overrides), "viscous")


class Bristles:
    """The LuGre law of motors over the angles that they turn from where each began its step."""

    def __init__(self, numbers: dict[str, dict[str, float]], q: np.ndarray) -> None:
        self.motors = [
            _Bristle(row, angle) for row, angle in zip(numbers.values(), q.tolist(), strict=True)
        ]

    def torque(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        given = zip(self.motors, q.tolist(), v.tolist(), strict=True)
        return np.array([motor.torque(angle, speed) for motor, angle, speed in given])

    def keep(self, q: np.ndarray) -> None:
        for motor, angle in zip(self.motors, q.tolist(), strict=True):
            motor.keep(angle)


class _Bristle:
    """The law of one motor, in numbers: small arrays take three times as long."""

    def __init__(self, row: dict[str, float], q: float) -> None:
        names = "coulomb", "static", "stribeck_speed", "stiffness", "damping"
        self.c, self.s, self.vs, self.s0, self.s1 = (row[k] for k in names)
        self.q = q
        self.v = 0.0
        self.z = 0.0
        self.last = 0.0

    def level(self, v: float) -> float:
        return self.c + (self.s - self.c) * math.exp(-((v / self.vs) ** 2))

    def at(self, q: float, v: float) -> float:
        g = self.level((self.v + v) / 2)
        moved = q - self.q
        end = math.copysign(g / self.s0, moved)
        return end + (self.z - end) * math.exp(-abs(moved) * self.s0 / g)

    def torque(self, q: float, v: float) -> float:
        z = self.at(q, v)
        self.last = v
        return self.s0 * z + self.s1 * (v - self.s0 * abs(v) * z / self.level(v))

    def keep(self, q: float) -> None:
        self.z = self.at(q, self.last)
        self.q = q
        self.v = self.last


def error_in_mujoco(
    name: str,
    path: Trajectory,
    numbers: dict[str, dict[str, float]] | None,
    *,
    step: float = 1e-4,
    feedback: bool = True,
) -> float:
    """Tool error [m] of a robot whose motors have this friction; None: viscous friction alone."""
    if numbers is None:
        return tool_error_in_mujoco(
            name, path, lambda q_g, v_g, q_m, v_m, tau: (0.0, 0.0, tau), step=step
        )
    law = Bristles(numbers, path["q_m"][0].copy())

    def torques(q_g: Any, v_g: Any, q_m: np.ndarray, v_m: np.ndarray, tau: np.ndarray) -> Any:
        return 0.0, -law.torque(q_m, v_m), tau

    return tool_error_in_mujoco(
        name, path, torques, lambda q_g, q_m: law.keep(q_m), step=step, feedback=feedback
    )
