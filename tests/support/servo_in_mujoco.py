"""A position servo as in textbooks, and a robot in MuJoCo under it; models with servos. Shares no
code with flexgen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from scipy.signal import bilinear, lfilter

import flexgen
from flexgen.exports.mujoco.mujoco import mjcf
from flexgen.exports.mujoco.mujoco_checks import with_friction

STEP = 1e-4  # s, of MuJoCo
TABLE = """
type = "cascade"
position_gain = [30.0, 25.0]
speed_gain = [1.5, 0.4]
integral_gain = [6.0, 6.0]
speed_feedforward = 0.8
reference_filter_s = 0.003
delay = 0.0005
notch = [{ frequency_hz = 60.0 }]
low_pass = [{ frequency_hz = 400.0, damping = 0.9 }]
"""


PLAIN = "\n".join(
    line for line in TABLE.splitlines() if line.split(" ")[0] not in ("delay", "notch", "low_pass")
)
GAINS = [np.array([30.0, 25.0]), np.array([1.5, 0.4]), np.array([6.0, 6.0])]


def with_servo(folder: Path, table: str, name: str = "planar5_nmp") -> Path:
    """The file of a model with a servo."""
    file = folder / f"{name}_servo.toml"
    file.write_text(Path(flexgen.read(name).file).read_text() + f"\n[servo]\n{table}")
    return file


Section = tuple[np.ndarray, np.ndarray]  # numerator and denominator in 1/z


def sampled(b: Sequence[float], a: Sequence[float], hz: float, h: float) -> Section:
    """A filter of order two in s/w, highest power first, by the bilinear transform with the
    frequency in place.
    """
    scale = np.tan(np.pi * hz * h) ** -np.arange(2.0, -1.0, -1.0)
    return bilinear(np.array(b) * scale, np.array(a) * scale, fs=0.5)


@dataclass
class OwnServo:
    """A P-PI servo as in textbooks, sample by sample, about the torque that holds the robot where
    it begins.
    """

    k_p: np.ndarray
    k_v: np.ndarray
    k_i: np.ndarray
    hold: np.ndarray
    start: np.ndarray
    feedforward: float = 1.0
    filter_s: float = 0.0
    h: float = 5e-4
    filters: Sequence[Section] = ()  # of the torque

    def __post_init__(self) -> None:
        self.memories = [np.zeros((2, len(self.start))) for _ in self.filters]
        self.reference = self.start.copy()
        self.before = self.start.copy()
        self.angle = self.start.copy()
        self.integral = np.zeros_like(self.start)

    def torque(self, command: np.ndarray, angle: np.ndarray) -> np.ndarray:
        share = 1.0 if self.filter_s == 0.0 else 1.0 - np.exp(-self.h / self.filter_s)
        self.reference = self.reference + share * (command - self.reference)
        wanted = self.feedforward * (self.reference - self.before) / self.h + self.k_p * (
            self.reference - angle
        )
        error = wanted - (angle - self.angle) / self.h
        self.integral = self.integral + self.h * error
        self.before = self.reference
        self.angle = angle
        u = self.k_v * (error + self.k_i * self.integral)
        for k, (b, a) in enumerate(self.filters):
            out, self.memories[k] = lfilter(b, a, u[None], axis=0, zi=self.memories[k])
            u = out[0]
        return self.hold + u


class InMujoco:
    """A robot in MuJoCo under servos."""

    def __init__(self, model: flexgen.RobotModel, q_a: np.ndarray, q_m: np.ndarray) -> None:
        self.model = model
        self.i_m = list(model.i_m)
        self.m = mujoco.MjModel.from_xml_string(mjcf(model))
        self.d = mujoco.MjData(self.m)
        names = [c.name for c in model.coordinates] + [
            f"rotor.{model.motors[j].name}" for j in self.i_m
        ]
        self.at = self.m.jnt_dofadr[[self.m.joint(name).id for name in names]]
        self.motors = [self.m.actuator(motor.name).id for motor in model.motors]
        self.m.opt.timestep = STEP
        self.d.qpos[self.at] = np.concatenate([q_a, q_m[self.i_m]])

    @property
    def angles(self) -> np.ndarray:
        arm = self.d.qpos[self.at[: self.model.n_a]]
        out = self.model.eta @ arm[list(self.model.i_g)]  # of rigid gears
        out[self.i_m] = self.d.qpos[self.at[self.model.n_a :]]
        return out

    def follow(
        self, servo: OwnServo, command, first: float, last: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Instants, arm angles and motor angles at the samples of the servo."""
        steps = round(servo.h / STEP)
        times = []
        arm = []
        motors = []
        for k in range(round((last - first) / servo.h)):
            t = first + k * servo.h
            times.append(t)
            arm.append(self.d.qpos[self.at[: self.model.n_a]].copy())
            motors.append(self.angles)
            self.d.ctrl[self.motors] = servo.torque(command(t), motors[-1])
            mujoco.mj_step(self.m, self.d, nstep=steps)
        return np.array(times), np.array(arm), np.array(motors)


def robot_of(name: str) -> flexgen.RobotModel:
    return with_friction(flexgen.read(name), "viscous")  # what MuJoCo has
