"""Models whose gears have hysteresis, and such a robot in MuJoCo with a law of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import flexgen
from flexgen.exports.mujoco import mjcf
from flexgen.exports.mujoco_checks import with_friction
from flexgen.trajectory import Trajectory

ARCMIN = np.pi / 180 / 60
FREQUENCY = 10.0  # Hz, of the motor feedback


def hysteretic(name: str, lost_motion: float = ARCMIN, share: float = 1.0, **overrides: Any) -> flexgen.RobotModel:
    """A model of models/ whose elastic gears have hysteresis; K_h is ``share`` of their stiffness."""
    made = dict(overrides)
    for element in flexgen.read(name).elements:
        for dof in element.dofs:
            if dof.gear is not None and dof.gear.spring is not None:
                key = f"element.{element.name}.dof.{dof.name}.gear.hysteresis"
                made[key] = {"lost_motion": lost_motion, "stiffness": share * dof.gear.spring.stiffness}
    return with_friction(flexgen.read(name, overrides=made), "viscous")


def joint_stiffness(model: flexgen.RobotModel) -> np.ndarray:
    """Stiffness of the gears, all elastic, at the joints (n_g,)."""
    found = []
    for k, i in enumerate(model.i_g):
        gear = model.coordinates[i].dof.gear
        ratio = np.abs(model.eta[:, k]).max() if gear.side == "motor" else 1.0
        found.append(ratio**2 * gear.spring.stiffness)
    return np.array(found)


class Gears:
    """Dahl's law in the deflections of gears, from where each began its step."""

    def __init__(self, stiffness: np.ndarray, slip: np.ndarray, p: np.ndarray) -> None:
        self.stiffness, self.slip, self.p, self.z = stiffness, slip, p, np.zeros(len(p))

    def at(self, p: np.ndarray) -> np.ndarray:
        end = np.sign(p - self.p) * self.slip
        return end + (self.z - end) * np.exp(-np.abs(p - self.p) * self.stiffness / self.slip)

    def keep(self, p: np.ndarray) -> None:
        self.z, self.p = self.at(p), p


Law = Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]]


def tool_error_in_mujoco(
    name: str,
    path: Trajectory,
    law: Law,
    kept: Callable[[np.ndarray, np.ndarray], None] = lambda q_g, q_m: None,
    *,
    step: float = 1e-4,
    feedback: bool = True,
) -> float:
    """Largest distance [m] of MuJoCo's tool from the path until 0.1 s after it, RK4, PD about the torque of the path.

    ``law(q_g, v_g, q_m, v_m, tau_m)``: torques on joints and rotors in addition to springs, dampers and frictions, and
    what the motors give; ``kept(q_g, q_m)`` is called after each step.
    """
    import mujoco

    model = with_friction(flexgen.read(name), "viscous")
    m = mujoco.MjModel.from_xml_string(mjcf(model))
    d = mujoco.MjData(m)
    names = [c.name for c in model.coordinates] + [f"rotor.{motor.name}" for motor in model.motors]
    at = m.jnt_dofadr[[m.joint(joint).id for joint in names]]
    arm, rotors = at[: model.n_a], at[model.n_a :]
    joints = arm[list(model.i_g)]
    motors, site = [m.actuator(motor.name).id for motor in model.motors], m.site("tool").id
    d.qpos[at] = np.concatenate([path["q_a"][0], path["q_m"][0]])
    inertia = np.array([motor.inertia for motor in model.motors])
    k_p, k_v = inertia * (2 * np.pi * FREQUENCY) ** 2 * feedback, 2 * inertia * 2 * np.pi * FREQUENCY * feedback
    start, end = float(path.time[0]), float(path.time[-1])
    steps = round((end - start + 0.1) / step)
    m.opt.timestep, m.opt.integrator = step, mujoco.mjtIntegrator.mjINT_RK4
    d.time = start
    given = path.at(np.clip(start + step / 2 * np.arange(2 * steps + 3), start, end))

    def control(m: Any, d: Any) -> None:
        k = round((d.time - start) / (step / 2))
        q, v = d.qpos[rotors], d.qvel[rotors]
        tau = given["tau_m"][k] + k_p * (given["q_m"][k] - q) + k_v * (given["v_m"][k] - v)
        d.qfrc_applied[joints], d.qfrc_applied[rotors], d.ctrl[motors] = law(d.qpos[joints], d.qvel[joints], q, v, tau)

    worst, output = 0.0, list(range(path["y_ref"].shape[1]))[:3]
    kept(d.qpos[joints], d.qpos[rotors])
    mujoco.set_mjcb_control(control)
    try:
        for k in range(steps):
            mujoco.mj_step(m, d)
            kept(d.qpos[joints], d.qpos[rotors])
            mujoco.mj_kinematics(m, d)
            wanted = given["y_ref"][2 * (k + 1)]
            axes = "xyz" if model.output.type == "tool_pose" else model.output.axes
            tool = d.site_xpos[site][["xyz".index(axis) for axis in axes]]
            worst = max(worst, float(np.linalg.norm(tool - wanted[output])))
    finally:
        mujoco.set_mjcb_control(None)
    return worst


def error_in_mujoco(
    name: str, path: Trajectory, lost_motion: float, *, share: float = 1.0, step: float = 1e-4, feedback: bool = True
) -> float:
    """`tool_error_in_mujoco` of a robot whose gears have ``lost_motion`` [rad]; zero: without hysteresis."""
    model = flexgen.read(name)
    K, inverse = joint_stiffness(model), np.linalg.inv(model.eta)
    start = inverse @ path["q_m"][0] - path["q_a"][0][list(model.i_g)]
    gears = Gears(share * K, 0.5 * lost_motion * K + 1e-30, start)

    def law(q_g: np.ndarray, v_g: np.ndarray, q_m: np.ndarray, v_m: np.ndarray, tau: np.ndarray) -> Any:
        z = gears.at(inverse @ q_m - q_g)
        return z, -inverse.T @ z, tau

    def kept(q_g: np.ndarray, q_m: np.ndarray) -> None:
        gears.keep(inverse @ q_m - q_g)

    return tool_error_in_mujoco(name, path, law, kept, step=step, feedback=feedback)
