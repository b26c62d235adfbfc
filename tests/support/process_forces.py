"""Forces of a cutter on the tool, as functions of time, and MuJoCo with a force on the tool."""

from __future__ import annotations

import numpy as np

import flexgen
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.exports.mujoco.mujoco import mjcf

HZ = 40.0  # of a cutter with four flutes at 600 1/min
SIZE = 300.0  # N
PLANE = np.array([0.6, 0.8])
SPACE = np.array([0.6, 0.48, 0.64])


def milling(duration: float, direction: np.ndarray = SPACE, size: float = SIZE, hz: float = HZ):
    """A sinusoidal force that begins and ends smoothly within 50 ms, as a function of time."""

    def force(t: np.ndarray) -> np.ndarray:
        r = np.clip(np.minimum(t, duration - t) / 0.05, 0.0, 1.0)
        window = r**4 * (35 - 84 * r + 70 * r**2 - 20 * r**3)
        return (size * np.sin(2 * np.pi * hz * t) * window)[:, None] * direction

    return force


def duration_of(equations) -> float:
    return flexgen.plan(equations).duration


def error_in_mujoco(
    equations, path: Trajectory, sign: float = 1.0, step: float | None = None
) -> float:
    """Largest distance [m] of MuJoCo's tool from the path, under the torque and ``sign`` times the
    force: RK4.
    """
    import mujoco

    model = equations.model
    m = mujoco.MjModel.from_xml_string(mjcf(model))
    d = mujoco.MjData(m)
    names = [c.name for c in model.coordinates] + [
        f"rotor.{model.motors[j].name}" for j in model.i_m
    ]
    at = m.jnt_dofadr[[m.joint(name).id for name in names]]
    motors = [m.actuator(motor.name).id for motor in model.motors]
    site = m.site("tool").id
    body = m.site_bodyid[site]
    start = float(path.time[0])
    end = float(path.time[-1])
    steps = round((end - start) / (step or m.opt.timestep))
    m.opt.timestep = h = (end - start) / steps
    given = path.at(np.linspace(start, end, 2 * steps + 1))
    torques = given["tau_m"]
    forces = sign * given["force"]
    i_m = list(model.i_m)

    def control(m, d):
        k = min(round((d.time - start) / (h / 2)), 2 * steps)
        d.ctrl[motors] = torques[k]
        d.xfrc_applied[body, :3] = forces[k, :3]
        d.xfrc_applied[body, 3:] = forces[k, 3:] + np.cross(
            d.site_xpos[site] - d.xipos[body], forces[k, :3]
        )

    d.time = start
    d.qpos[at] = np.concatenate([path["q_a"][0], path["q_m"][0][i_m]])
    moved = [d.qpos[at].copy()]
    mujoco.set_mjcb_control(control)
    try:
        for _ in range(steps):
            mujoco.mj_step(m, d)
            moved.append(d.qpos[at].copy())
    finally:
        mujoco.set_mjcb_control(None)
    y = evaluate(equations.function("output"), np.array(moved)[:, : model.n_a])[0].reshape(
        steps + 1, -1
    )
    return float(np.linalg.norm(y - given["y_ref"][::2], axis=1).max())
