"""The true robot: rigid bodies of MuJoCo, gears, friction, drives and encoders of its own.

Nothing here comes from flexgen. MuJoCo has the bodies, the springs and dampers without a motor,
and the rotors, each a body of its own with the inertia J n^2 that turns with the arm side: the
rotors do not feel the rotation of their links. Gears and friction are torques on the joints:

    rotor:  J n^2 theta'' = n (tau - friction(n theta')) - (1 + e'(theta)) torque
    joint:  torque - friction(q') acts on q
    torque = K x - (K - K0) d0 tanh(x / d0) + D x' + K_v (x - z),  x = theta + e(theta) - q

The drives have a sample time, take the feedforward and the reference of each sample, and their
torque acts one sample later.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

from benchmarks.commissioning.chains import Body, Chain
from benchmarks.commissioning.drive import Cascade

GRAVITY = 9.81  # m/s^2


@dataclass(frozen=True)
class Hardware:
    """Sample time and imperfections of drives and encoders, motor side."""

    sample_s: float = 2.5e-4
    steps: int = 2  # of the simulation in a sample
    resolution: float = 6e-6  # rad: a count of the encoder
    encoder_noise: float = 5e-6  # rad
    torque_noise: float = 0.01  # N m


@dataclass(frozen=True)
class Motion:
    """Record of a run: one row for each sample of the drives."""

    time: np.ndarray  # (N,) s
    angles: np.ndarray  # (N, n) rad, motor side, as the encoders show them
    torques: np.ndarray  # (N, n) N m, motor side, as the drives command them
    tool: np.ndarray  # (N, 3) m
    ball: np.ndarray  # (N, 3) m
    deflections: np.ndarray  # (N, m) rad: the axes without a motor


def inertial(body: Body) -> str:
    """Of a body in MJCF."""
    i = body.inertia
    entries = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]
    return (
        f'<inertial pos="{numbers(body.com)}" mass="{numbers(body.mass)}" '
        f'fullinertia="{numbers(entries)}"/>'
    )


def numbers(values: object) -> str:
    """Separated by spaces, with all digits."""
    return " ".join(repr(float(value)) for value in np.asarray(values, dtype=float).ravel())


def mjcf(chain: Chain, step_s: float) -> str:
    """The arm as a text for MuJoCo: rotors first, then the axes in the order of the chain."""
    rotors = [
        f'<body name="rotor{number}"><joint name="rotor{number}" type="hinge" axis="0 0 1"/>'
        f'<inertial pos="0 0 0" mass="1" '
        f'diaginertia="{numbers([gear.rotor * gear.ratio**2] * 3)}"/></body>'
        for number, gear in enumerate(chain.gears)
    ]
    arm = ""
    for link in chain.links:
        arm += f'<body name={quoteattr(link.name)} pos="{numbers(link.origin)}">'
        arm += inertial(link.body)
        for axis in link.axes:
            arm += (
                f'<joint name={quoteattr(axis.name)} type="hinge" axis="{numbers(axis.axis)}" '
                f'stiffness="{numbers(axis.stiffness)}" damping="{numbers(axis.damping)}"/>'
            )
    arm += f'<body name="payload">{inertial(chain.payload)}</body>'
    arm += f'<site name="tool" pos="{numbers(chain.tool)}"/>'
    arm += f'<site name="ball" pos="{numbers(chain.ball)}"/>'
    arm += "</body>" * len(chain.links)
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{step_s!r}" '
        f'integrator="implicitfast" gravity="0 0 {-GRAVITY}"/>'
        f"<worldbody>{''.join(rotors)}{arm}</worldbody></mujoco>"
    )


class Plant:
    """A true robot with its drives. Random numbers of noise follow from the seed."""

    def __init__(self, chain: Chain, seed: int = 0, hardware: Hardware | None = None) -> None:
        self.chain = chain
        self.hardware = hardware or Hardware()
        self.random = np.random.default_rng(seed)
        self.step_s = self.hardware.sample_s / self.hardware.steps
        self.model = mujoco.MjModel.from_xml_string(mjcf(chain, self.step_s))
        self.data = mujoco.MjData(self.model)
        gears = chain.gears
        self.n = len(gears)
        self.ratio = chain.ratios
        axes = chain.axes
        self.joints = np.array([self.n + i for i, axis in enumerate(axes) if axis.gear])
        self.springs = np.array([self.n + i for i, axis in enumerate(axes) if not axis.gear])
        self.stiffness = np.array([gear.stiffness for gear in gears])
        self.damping = np.array([gear.damping for gear in gears])
        self.missing = self.stiffness * (1.0 - np.array([gear.soft for gear in gears]))
        self.width = np.array([gear.width for gear in gears])
        self.relaxing = np.array([gear.relaxing for gear in gears])
        self.forgotten = 1.0 - np.exp(-self.step_s / np.array([g.relaxation for g in gears]))
        self.error = np.array([gear.error for gear in gears])
        self.cycles = np.array([gear.cycles * gear.ratio for gear in gears])
        motor = [gear.motor_friction for gear in gears]
        joint = [gear.joint_friction for gear in gears]
        # of the motors on the arm side, then of the joints
        self.viscous = np.array(
            [f.viscous * r**2 for f, r in zip(motor, self.ratio, strict=True)]
            + [f.viscous for f in joint]
        )
        self.coulomb = np.array(
            [f.coulomb * r for f, r in zip(motor, self.ratio, strict=True)]
            + [f.coulomb for f in joint]
        )
        self.slope = np.array(
            [r / f.width for f, r in zip(motor, self.ratio, strict=True)]
            + [1.0 / f.width for f in joint]
        )
        self.rubbing = np.concatenate([np.arange(self.n), self.joints])
        self.relaxed = np.zeros(self.n)
        self.torque_max = np.array([gear.torque_max for gear in gears])

    def gear_torque(self, x: np.ndarray) -> np.ndarray:
        """Elastic torque of the gears (n,) [N m] under constant deflections [rad]."""
        return self.stiffness * x - self.missing * self.width * np.tanh(x / self.width)

    def rest(self, angles: np.ndarray, friction: np.ndarray | None = None) -> np.ndarray:
        """Bring the arm to rest with the motors at these angles (n,) [rad, motor side].

        Newton's method with the springs as slopes, since gravity changes little over a
        deflection. `friction` (n,) [N m] is the torque of the joints' friction at rest.

        Returns
        -------
        Torques of the motors (n,) [N m, motor side] that hold it.

        """
        data = self.data
        mujoco.mj_resetData(self.model, data)
        theta = np.asarray(angles) / self.ratio
        data.qpos[: self.n] = theta
        shown = theta + self.error * np.sin(self.cycles * theta)
        data.qpos[self.joints] = shown
        extra = np.zeros(self.n) if friction is None else friction
        stiffness = np.maximum(self.model.jnt_stiffness, 1.0)
        for _ in range(60):
            mujoco.mj_inverse(self.model, data)
            miss = np.array(data.qfrc_inverse)
            x = shown - data.qpos[self.joints]
            miss[self.joints] -= self.gear_torque(x) + extra
            slopes = self.stiffness - self.missing / np.cosh(x / self.width) ** 2
            stiffness[self.joints] = slopes
            step = miss / stiffness
            step[: self.n] = 0.0
            data.qpos[:] -= step
            if np.abs(step).max() < 1e-13:
                break
        else:
            raise ValueError(f"{self.chain.name}: no rest at {np.asarray(angles).tolist()}")
        x = shown - data.qpos[self.joints]
        self.relaxed = x.copy()
        mujoco.mj_forward(self.model, data)
        rate = 1.0 + self.error * self.cycles * np.cos(self.cycles * theta)
        return np.asarray(rate * self.gear_torque(x) / self.ratio)

    def positions(self) -> tuple[np.ndarray, np.ndarray]:
        """Tool and ball (3,) [m] in the present state."""
        return (
            np.array(self.data.site("tool").xpos),
            np.array(self.data.site("ball").xpos),
        )

    def advance(self, torque: np.ndarray) -> None:
        """One step of the simulation with these motor torques (n,) [N m, motor side]."""
        data = self.data
        position = data.qpos
        speed = data.qvel
        force = data.qfrc_applied
        theta = position[: self.n]
        phase = self.cycles * theta
        rate = 1.0 + self.error * self.cycles * np.cos(phase)
        x = theta + self.error * np.sin(phase) - position[self.joints]
        change = rate * speed[: self.n] - speed[self.joints]
        moment = self.gear_torque(x) + self.damping * change + self.relaxing * (x - self.relaxed)
        self.relaxed += self.forgotten * (x - self.relaxed)
        rub = speed[self.rubbing]
        friction = self.viscous * rub + self.coulomb * np.tanh(self.slope * rub)
        force[: self.n] = self.ratio * torque - rate * moment - friction[: self.n]
        force[self.joints] = moment - friction[self.n :]
        mujoco.mj_step(self.model, data)

    def run(self, reference: np.ndarray, feedforward: np.ndarray | None = None) -> Motion:
        """Start at rest at the first reference and follow it.

        Parameters
        ----------
        reference
            Motor angles (N, n) [rad] at the sample time of the drives.
        feedforward
            Torques (N, n) [N m, motor side] in addition to those of the cascade.

        """
        count = len(reference)
        hardware = self.hardware
        given = np.zeros((count, self.n)) if feedforward is None else feedforward
        held = self.rest(reference[0])
        drive = Cascade(self.chain, hardware.sample_s)
        drive.hold(held - given[0])
        noise = hardware.encoder_noise * self.random.normal(size=(count, self.n))
        ripple = hardware.torque_noise * self.random.normal(size=(count, self.n))
        angles = np.empty((count, self.n))
        torques = np.empty((count, self.n))
        tool = np.empty((count, 3))
        ball = np.empty((count, 3))
        deflections = np.empty((count, len(self.springs)))
        tool_site = self.data.site("tool").xpos
        ball_site = self.data.site("ball").xpos
        late = held
        for k in range(count):
            angles[k] = self.encoders(noise[k])
            deflections[k] = self.data.qpos[self.springs]
            asked = given[k] + drive.torque(reference[k] - angles[k])
            torques[k] = np.clip(asked, -self.torque_max, self.torque_max)
            for step in range(hardware.steps):
                self.advance(late + ripple[k])
                if step == 0:  # MuJoCo computed them at the beginning of its step
                    tool[k] = tool_site
                    ball[k] = ball_site
            late = torques[k]
        time = hardware.sample_s * np.arange(count)
        return Motion(time, angles, torques, tool, ball, deflections)

    def encoders(self, noise: np.ndarray) -> np.ndarray:
        """Motor angles (n,) [rad] as the encoders show them with this noise [rad]."""
        exact = self.ratio * self.data.qpos[: self.n] + noise
        count = self.hardware.resolution
        return np.asarray(count * np.round(exact / count)) if count > 0 else exact
