"""Models whose motors have friction that depends on load and temperature, and this law in NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
from hysteretic import joint_stiffness, tool_error_in_mujoco

import flexgen
from flexgen.trajectory import Trajectory

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


def loaded(name: str, temperature: float = 20.0, **changed: float) -> flexgen.RobotModel:
    """A model of models/ all of whose motors have this friction."""
    table: dict[str, Any] = {"type": "gear", **NUMBERS, **changed}
    made: dict[str, Any] = {f"motor.{motor.name}.friction": table for motor in flexgen.read(name).motors}
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
    name: str, path: Trajectory, temperature: float = 20.0, *, step: float = 1e-4, **changed: float
) -> float:
    """Tool error [m] of a robot in MuJoCo whose motors have this friction, gear torques by its own springs."""
    model = flexgen.read(name)
    K, inverse, own = joint_stiffness(model), np.linalg.inv(model.eta), _own_viscous(model)
    D = np.array([_damping(model, k) for k in range(model.n_g)])

    def law(q_g: np.ndarray, v_g: np.ndarray, q_m: np.ndarray, v_m: np.ndarray, tau: np.ndarray) -> Any:
        load = inverse.T @ (K * (inverse @ q_m - q_g) + D * (inverse @ v_m - v_g))
        return 0.0, own * v_m - torque(v_m, load, temperature, **changed), tau

    return tool_error_in_mujoco(name, path, law, step=step)


def _own_viscous(model: flexgen.RobotModel) -> np.ndarray:
    """Viscous frictions that the model in MuJoCo has itself."""
    return np.array([motor.friction.viscous for motor in model.motors])


def _damping(model: flexgen.RobotModel, k: int) -> float:
    gear = model.coordinates[model.i_g[k]].dof.gear
    ratio = np.abs(model.eta[:, k]).max() if gear.side == "motor" else 1.0
    return float(ratio**2 * gear.damping)
