"""Models with Fourier sums of the motor angles, and such a robot in MuJoCo with sums of its
own.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from hysteretic import ARCMIN, Law, joint_stiffness, tool_error_in_mujoco

import flexgen
from flexgen.base.motion.trajectory import Trajectory
from flexgen.exports.mujoco.mujoco_checks import with_friction

# rad
ERROR = {
    "harmonics": [1, 2],
    "cos": [0.2 * ARCMIN, -0.35 * ARCMIN],
    "sin": [-0.1 * ARCMIN, 0.25 * ARCMIN],
}
COGGING = {"harmonics": [2, 6], "cos": [0.02, -0.03], "sin": [0.05, 0.01]}  # N m
RIPPLE = {"harmonics": [1, 6], "cos": [0.02, 0.01], "sin": [-0.01, 0.015]}


def harmonic(
    name: str, size: float = 1.0, error: bool = True, torque: bool = True
) -> flexgen.RobotModel:
    """A model of models/ with sums of the motor angles in all gears and motors, ``size`` times
    those above.
    """

    def sized(table: dict[str, Any]) -> dict[str, Any]:
        return table | {key: [size * x for x in table[key]] for key in ("cos", "sin")}

    made: dict[str, Any] = {}
    for element in flexgen.read(name).elements:
        for dof in element.dofs:
            if dof.gear is not None and dof.gear.spring is not None and error:
                made[f"element.{element.name}.dof.{dof.name}.gear.transmission_error"] = sized(
                    ERROR
                )
    for motor in flexgen.read(name).motors:
        if torque:
            made |= {
                f"motor.{motor.name}.cogging": sized(COGGING),
                f"motor.{motor.name}.torque_ripple": sized(RIPPLE),
            }
    return with_friction(flexgen.read(name, overrides=made), "viscous")


def value(table: dict[str, Any], q: np.ndarray, order: int = 0) -> np.ndarray:
    """The sum at the angles ``q``, or a derivative; in numbers, since small arrays take five times
    as long.
    """
    out = []
    shift = order * math.pi / 2
    for angle in np.ravel(q).tolist():
        parts = zip(table["harmonics"], table["cos"], table["sin"], strict=True)
        out.append(
            sum(
                k**order * (c * math.cos(k * angle + shift) + s * math.sin(k * angle + shift))
                for k, c, s in parts
            )
        )
    return np.array(out).reshape(np.shape(q))


def law_with_sums(name: str, size: float = 1.0, ripple: float = 1.0) -> Law:
    """Law of `Plant` for ``size`` times the sums above, ``ripple`` times the ripple; each motor
    has its joint.
    """
    model = flexgen.read(name)
    ratios = np.diag(model.eta)
    assert np.array_equal(np.diag(ratios), model.eta)
    K = joint_stiffness(model)
    D = np.array(
        [
            gear.damping * (n**2 if gear.side == "motor" else 1.0)
            for gear, n in zip(
                (model.coordinates[i].dof.gear for i in model.i_g), ratios, strict=True
            )
        ]
    )

    def law(
        q_g: np.ndarray, v_g: np.ndarray, q_m: np.ndarray, v_m: np.ndarray, tau: np.ndarray
    ) -> Any:
        e = size * value(ERROR, q_m)
        slope = size * value(ERROR, q_m, 1)
        plain = K * (q_m / ratios - q_g) + D * (v_m / ratios - v_g)  # MuJoCo has these
        torque = plain - K * e - D * slope * v_m
        on_motors = plain / ratios - torque * (1 / ratios - slope) + size * value(COGGING, q_m)
        return torque - plain, on_motors, tau * (1 + size * ripple * value(RIPPLE, q_m))

    return law


def error_in_mujoco(name: str, path: Trajectory, size: float = 1.0, **options: Any) -> float:
    """`tool_error_in_mujoco` of a robot with ``size`` times the sums above."""
    return tool_error_in_mujoco(name, path, law_with_sums(name, size), **options)
