"""A robot in MuJoCo that learns a move: three axes with elastic gears, a lateral spring in the
upper arm, friction, a sampled P-PI cascade, a tracker. Nothing of it is computed by flexgen.

`model_text` is what its user knows: the same arm with stiffnesses, masses and friction that are
10 to 20 % off.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

RATIO = 100.0
STIFFNESS = np.array([1.5e5, 1.5e5, 8.0e4])  # of the gears, arm side [N m/rad]
DAMPING = np.array([150.0, 150.0, 80.0])  # [N m s/rad]
LATERAL = (1.2e5, 60.0)  # spring and damper of the upper arm [N m/rad, N m s/rad]
ROTORS = np.array([30.0, 30.0, 15.0])  # inertias, arm side [kg m^2]
COULOMB = np.array([30.0, 30.0, 15.0])  # friction, arm side [N m]
VISCOUS = np.array([60.0, 60.0, 30.0])  # [N m s/rad]
SLIDING = 2e-3  # speed at which friction is 76 % of Coulomb's, arm side [rad/s]
UPPER = 0.6  # lengths [m]
FORE = 0.5
STEP = 1e-4  # of the integration [s]
SAMPLE = 1e-3  # of the controller [s]
# Bandwidths of position and speed [rad/s], and rate of the integral part [1/s].
POSITION = 2 * np.pi * 5.0
SPEED = 2 * np.pi * 15.0
INTEGRAL = 2 * np.pi * 0.5

XML = f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{STEP}" integrator="RK4" gravity="0 0 -9.81"/>
  <worldbody>
    <body>
      <joint name="q1" type="hinge" axis="0 0 1"/>
      <inertial pos="0 0 0.1" mass="40" diaginertia="1 1 1"/>
      <body pos="0 0 0.3">
        <joint name="q2" type="hinge" axis="0 1 0"/>
        <joint name="side" type="hinge" axis="0 0 1" stiffness="{LATERAL[0]}"
               damping="{LATERAL[1]}"/>
        <inertial pos="0.3 0 0" mass="28" diaginertia="0.2 0.9 0.9"/>
        <body pos="{UPPER} 0 0">
          <joint name="q3" type="hinge" axis="0 1 0"/>
          <inertial pos="0.25 0 0" mass="18" diaginertia="0.1 0.5 0.5"/>
          <site name="tool" pos="{FORE} 0 0"/>
        </body>
      </body>
    </body>
    <body pos="0 5 0"><joint type="hinge" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{ROTORS[0]} {ROTORS[0]} {ROTORS[0]}"/></body>
    <body pos="0 5 0"><joint type="hinge" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{ROTORS[1]} {ROTORS[1]} {ROTORS[1]}"/></body>
    <body pos="0 5 0"><joint type="hinge" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{ROTORS[2]} {ROTORS[2]} {ROTORS[2]}"/></body>
  </worldbody>
</mujoco>
"""
GEARED = [0, 1, 3]  # of the joints q1, q2, side, q3
ROTOR = slice(4, 7)

MODEL = """
name = "trial_arm"
gravity = [0.0, 0.0, -9.81]
home_rad = [0.0, -0.6, 1.2]

[[element]]
name = "column"
body = {{ mass = 40.0, com = [0, 0, 0.1], inertia = [1, 1, 1] }}

[[element.dof]]
name = "q1"
type = "rotation"
axis = [0, 0, 1]
gear = {{ type = "elastic", side = "arm", damping = 150.0, {0} }}

[[element]]
name = "upper"
origin = {{ position = [0, 0, 0.3] }}
body = {{ mass = 29.4, com = [0.3, 0, 0], inertia = [0.2, 0.9, 0.9] }}

[[element.dof]]
name = "q2"
type = "rotation"
axis = [0, 1, 0]
gear = {{ type = "elastic", side = "arm", damping = 150.0, {1} }}

[[element.dof]]
name = "side"
type = "rotation"
axis = [0, 0, 1]
spring = {{ type = "linear", stiffness = {3} }}
damping = 60.0

[[element]]
name = "fore"
origin = {{ position = [0.6, 0, 0] }}
body = {{ mass = 17.1, com = [0.25, 0, 0], inertia = [0.1, 0.5, 0.5] }}

[[element.dof]]
name = "q3"
type = "rotation"
axis = [0, 1, 0]
gear = {{ type = "elastic", side = "arm", damping = 80.0, {2} }}

[[motor]]
name = "m1"
drives = "q1"
ratio = 100
inertia = 30e-4
friction = {{ viscous = 60e-4 }}

[[motor]]
name = "m2"
drives = "q2"
ratio = 100
inertia = 30e-4
friction = {{ viscous = 60e-4 }}

[[motor]]
name = "m3"
drives = "q3"
ratio = 100
inertia = 15e-4
friction = {{ viscous = 30e-4 }}

[tool]
position = [0.5, 0, 0]

[output]
type = "tool_position"
axes = "xyz"

[[move]]
name = "line"
type = "tool_line"
start_rad = [0.0, -0.6, 1.2]
displacement = [-0.1, 0.3, 0.15]
duration = 0.8
smoothness = 5

[[move]]
name = "circle"
type = "tool_circle"
start_rad = [0.0, -0.6, 1.2]
center = [-0.1, 0.0, 0.0]
axis = [0.0, 1.0, 1.0]
angle_deg = 360
duration = 1.6
smoothness = 5

[[move]]
name = "corner"
type = "tool_polyline"
start_rad = [0.0, -0.6, 1.2]
legs = [
    {{ displacement = [-0.15, 0.0, 0.1], zone = 0.04 }},
    {{ displacement = [0.0, 0.2, 0.0] }},
]
duration = 1.2
smoothness = 5
"""


def model_text(factors: tuple[float, ...] = (0.85, 1.15, 0.8, 1.2)) -> str:
    """The model file with the stiffnesses of the gears and of the lateral spring, over the true
    ones.
    """
    gears = (
        f'spring = {{ type = "linear", stiffness = {k * x} }}'
        for k, x in zip(STIFFNESS, factors, strict=False)
    )
    return MODEL.format(*gears, LATERAL[0] * factors[3])


@dataclass(frozen=True)
class Run:
    """A run: instants [s], zero where the path begins; tool (n, 3) [m], motors (n, 3) [rad]."""

    time: np.ndarray
    tool: np.ndarray
    motors: np.ndarray


def run(trajectory, seed: int = 0, after: float = 0.4, until: float | None = None) -> Run:
    """Run the torques and references of a trajectory with the cascade; from its rest, which the
    integral part holds. ``seed``: of the small differences between runs; ``until`` [s].
    """
    m = mujoco.MjModel.from_xml_string(XML)
    d = mujoco.MjData(m)
    rng = np.random.default_rng(seed)
    end = (float(trajectory.time[-1]) if until is None else until) + after
    begin = float(trajectory.time[0]) - 0.2
    ticks = begin + SAMPLE * np.arange(int((end - begin) / SAMPLE))
    inside = np.clip(ticks, trajectory.time[0], trajectory.time[-1])
    q_ref, tau = (
        np.stack([np.interp(inside, trajectory.time, x) for x in trajectory[name].T], axis=1)
        for name in ("q_m", "tau_m")
    )
    q_ref = q_ref / RATIO
    tau = tau * RATIO
    # Rest: the arm sags under its weight behind gears that hold their motors at the reference.
    d.qpos[GEARED] = q_ref[0]
    d.qpos[ROTOR] = q_ref[0]
    holding = np.zeros(3)
    for _ in range(60):
        d.qvel[:] = 0.0
        mujoco.mj_forward(m, d)
        holding = d.qfrc_bias[GEARED]
        d.qpos[GEARED] = q_ref[0] - holding / STIFFNESS
        d.qpos[2] = -d.qfrc_bias[2] / LATERAL[0]
    inertia = ROTORS + np.array([25.0, 20.0, 4.0])
    integral = holding - tau[0]
    torque = holding.copy()
    old = q_ref[0].copy()
    rows = []
    for k, wanted in enumerate(q_ref):
        q = np.round((d.qpos[ROTOR] + 2e-8 * rng.normal(size=3)) / 1e-7) * 1e-7
        rows.append((d.site_xpos[0].copy(), d.qpos[ROTOR].copy()))
        speed = (q - old) / SAMPLE
        wanted_speed = (wanted - q_ref[max(k - 1, 0)]) / SAMPLE
        away = wanted_speed - speed + POSITION * (wanted - q)
        integral = integral + SAMPLE * INTEGRAL * SPEED * inertia * away
        now = torque  # one sample of delay
        torque = tau[k] + SPEED * inertia * away + integral
        old = q
        for _ in range(round(SAMPLE / STEP)):
            theta = d.qpos[ROTOR]
            omega = d.qvel[ROTOR]
            gear = STIFFNESS * (theta - d.qpos[GEARED])
            gear = gear + DAMPING * (omega - d.qvel[GEARED])
            friction = COULOMB * np.tanh(omega / SLIDING) + VISCOUS * omega
            d.qfrc_applied[GEARED] = gear
            d.qfrc_applied[ROTOR] = now - gear - friction
            mujoco.mj_step(m, d)
    tool, motors = (np.array(x) for x in zip(*rows, strict=True))
    return Run(ticks, tool, RATIO * motors)


def write_record(
    file,
    done: Run,
    *,
    what: str = "tool",
    every: int = 4,
    noise: float = 5e-6,
    clock: float = 3.7,
    frame: tuple[float, ...] = (0.0,) * 6,
    seed: int = 0,
) -> None:
    """Write a record of a tracker at a ``frame`` (position, rotation vector) with its clock, or of
    the motors.
    """
    rng = np.random.default_rng(seed + 77)
    time = done.time[::every] + clock
    if what == "motors":
        table = np.column_stack([time, done.motors[::every]])
        header = "time_s,q_m[m1] rad,q_m[m2] rad,q_m[m3] rad"
    else:
        R = Rotation.from_rotvec(frame[3:]).as_matrix()
        p = (done.tool[::every] - np.array(frame[:3])) @ R
        table = np.column_stack([time, 1e3 * (p + noise * rng.normal(size=p.shape))])
        header = "time_s,x_mm,y_mm,z_mm"
    np.savetxt(file, table, fmt="%.9g", delimiter=",", header=header, comments="")
