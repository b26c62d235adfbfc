"""Models whose motors have friction that depends on load and temperature, and this law in
NumPy.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from hysteretic import joint_stiffness, tool_error_in_mujoco, with_lost_motion

import flexgen
from flexgen.base.motion.trajectory import Trajectory

NUMBERS: dict[str, float] = {
    "viscous": 2e-3,
    "coulomb": 0.1,
    "stribeck": 0.05,
    "alpha": 0.1,
    "beta": 0.5,
    "load_coulomb": 0.08,
    "load_stribeck": 0.04,
    "load_alpha": 0.2,
    "load_smoothing": 0.3,
    "viscous_share": 0.7,
    "viscous_decay": 20.0,
    "stribeck_slope": 1e-3,
    "stribeck_speed_slope": 0.2,
}


def loaded(
    name: str, temperature: float = 20.0, lost_motion: float = 0.0, **changed: float
) -> flexgen.RobotModel:
    """A model of models/ all of whose motors have this friction; its gears have the
    ``lost_motion`` [rad].
    """
    table: dict[str, Any] = {"type": "gear", **NUMBERS, **changed}
    model = flexgen.read(name)
    made: dict[str, Any] = {f"motor.{motor.name}.friction": table for motor in model.motors}
    for element in model.elements if lost_motion else ():
        for dof in (dof for dof in element.dofs if dof.gear is not None):
            own = {"lost_motion": lost_motion, "stiffness": dof.gear.spring.stiffness}
            made[f"element.{element.name}.dof.{dof.name}.gear.hysteresis"] = own
    return flexgen.read(name, overrides=made | {"temperature": temperature})


def torque(v: Any, load: Any, temperature: float = 20.0, **changed: float) -> Any:
    """The friction torque by the equation of the documentation."""
    n = {"reference_temperature": 20.0, "temperature_rise": 0.0, "offset": 0.0} | NUMBERS | changed
    warmer = temperature + n["temperature_rise"] - n["reference_temperature"]
    viscous = n["viscous"] * (1 + n["viscous_share"] * (np.exp(-warmer / n["viscous_decay"]) - 1))
    stribeck = max(0.0, n["stribeck"] + n["stribeck_slope"] * warmer)
    speed = max(0.01 / n["alpha"], 1 / n["alpha"] + n["stribeck_speed_slope"] * warmer)
    size = np.hypot(load, n["load_smoothing"]) - n["load_smoothing"]
    level = n["coulomb"] + n["load_coulomb"] * size + stribeck / np.cosh(v / speed)
    level = level + n["load_stribeck"] * size / np.cosh(n["load_alpha"] * v)
    return viscous * v + level * np.tanh(n["beta"] * v) + n["offset"]


def error_in_mujoco(
    name: str,
    path: Trajectory,
    temperature: float = 20.0,
    lost_motion: float = 0.0,
    **changed: float,
) -> float:
    """Tool error [m] of a robot in MuJoCo whose motors have this friction, gear torques by its own
    springs.
    """
    model = flexgen.read(name)
    K = joint_stiffness(model)
    inverse = np.linalg.inv(model.eta)
    own = _own_viscous(model)
    D = np.array([_damping(model, k) for k in range(model.n_g)])

    start = inverse @ path["q_m"][0] - path["q_a"][0][list(model.i_g)]
    lossy, kept = with_lost_motion(name, lost_motion, start)

    def law(
        q_g: np.ndarray, v_g: np.ndarray, q_m: np.ndarray, v_m: np.ndarray, tau: np.ndarray
    ) -> Any:
        z, on_motors, _ = lossy(q_g, v_g, q_m, v_m, tau) if lost_motion else (0.0, 0.0, tau)
        load = inverse.T @ (K * (inverse @ q_m - q_g) + D * (inverse @ v_m - v_g) + z)
        return z, on_motors + own * v_m - torque(v_m, load, temperature, **changed), tau

    return tool_error_in_mujoco(name, path, law, kept)


def _own_viscous(model: flexgen.RobotModel) -> np.ndarray:
    """Viscous frictions that the model in MuJoCo has itself."""
    return np.array([motor.friction.viscous for motor in model.motors])


def _damping(model: flexgen.RobotModel, k: int) -> float:
    gear = model.coordinates[model.i_g[k]].dof.gear
    ratio = np.abs(model.eta[:, k]).max() if gear.side == "motor" else 1.0
    return float(ratio**2 * gear.damping)
