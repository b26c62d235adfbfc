"""Models whose gears have hysteresis, and such a robot in MuJoCo with a law of its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import flexgen
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.memory import HysteresisLaw
from flexgen.exports.mujoco.mujoco import mjcf
from flexgen.exports.mujoco.mujoco_checks import with_friction
from flexgen.model.friction import friction_key

ARCMIN = np.pi / 180 / 60
FREQUENCY = 10.0  # Hz, of the motor feedback


def hysteretic(
    name: str, lost_motion: float = ARCMIN, share: float = 1.0, **overrides: Any
) -> flexgen.RobotModel:
    """A model of models/ whose elastic gears have hysteresis; K_h is ``share`` of their
    stiffness.
    """
    made = dict(overrides)
    for element in flexgen.read(name).elements:
        for dof in element.dofs:
            if dof.gear is not None and dof.gear.spring is not None:
                key = f"element.{element.name}.dof.{dof.name}.gear.hysteresis"
                made[key] = {
                    "lost_motion": lost_motion,
                    "stiffness": share * dof.gear.spring.stiffness,
                }
    return with_friction(flexgen.read(name, overrides=made), "viscous")


@dataclass(frozen=True)
class Element:
    """Lost motion and stiffness of an element, over those of the gear; exponent and gamma."""

    lost: float
    stiffness: float
    exponent: float = 1.0
    gamma: float = 0.0

    def slope(self, z: float, s: float, K: float) -> float:
        """``dz/dp`` of a gear of stiffness ``K`` that turns in the direction ``s``; see
        `Elements`.
        """
        x = z / (0.5 * self.lost * ARCMIN * K)
        ahead = self.gamma if s * x > 0 else -self.gamma
        part = abs(x) ** (self.exponent - 1.0) * x * (1.0 - self.gamma + ahead)
        return self.stiffness * K * (1.0 - s * part)

    def moved(self, z: float, h: float, K: float) -> float:
        """The torque after this gear has turned by ``h``."""
        s = math.copysign(1.0, h)
        k1 = self.slope(z, s, K)
        k2 = self.slope(z + h / 2 * k1, s, K)
        k3 = self.slope(z + h / 2 * k2, s, K)
        return z + h / 6 * (k1 + 2 * k2 + 2 * k3 + self.slope(z + h * k3, s, K))


@dataclass(frozen=True)
class Logistic(HysteresisLaw):
    """A law that another package may add: ``z' = K_h d' (1 - s x)(1 + bend s x)``."""

    bend: float = friction_key("1", default=0.6)

    def slope(self, y: Any) -> Any:
        return (1.0 - y) * (1.0 + self.bend * y)


class LogisticElement(Element):
    """The logistic law in numbers."""

    def slope(self, z: float, s: float, K: float) -> float:
        x = s * z / (0.5 * self.lost * ARCMIN * K)
        return self.stiffness * K * (1.0 - x) * (1.0 + 0.6 * x)


SLIPS = (Element(0.2, 0.5), Element(0.3, 0.3), Element(0.5, 0.2))  # of one arcmin in all
BENT = (Element(0.2, 0.5, 1.0, 0.3), Element(0.3, 0.3, 2.0, 0.5), Element(0.5, 0.2, 3.7, -0.4))


def with_elements(
    name: str, elements: Sequence[Element], factor: float = 1.0, **overrides: Any
) -> flexgen.RobotModel:
    """A model of models/ whose elastic gears have these elements; their lost motions add up to
    ``factor`` ARCMIN.
    """
    made = dict(overrides)
    for element in flexgen.read(name).elements:
        for dof in element.dofs:
            if dof.gear is not None and dof.gear.spring is not None:
                made[f"element.{element.name}.dof.{dof.name}.gear.hysteresis"] = [
                    {
                        "lost_motion": factor * ARCMIN * each.lost,
                        "stiffness": each.stiffness * dof.gear.spring.stiffness,
                        "exponent": each.exponent,
                        "gamma": each.gamma,
                    }
                    for each in elements
                ]
    return with_friction(flexgen.read(name, overrides=made), "viscous")


def with_law(name: str, factor: float = 1.0, **overrides: Any) -> flexgen.RobotModel:
    """A model of models/ whose elastic gears have hysteresis by `Logistic`, ``factor`` arcmin,
    K_h = K/2.
    """
    model = hysteretic(name, factor * ARCMIN, 0.5, **overrides)

    def changed(dof: Any) -> Any:
        if dof.gear is None or dof.gear.hysteresis is None:
            return dof
        own = dof.gear.hysteresis
        return replace(
            dof, gear=replace(dof.gear, hysteresis=Logistic(own.lost_motion, own.stiffness))
        )

    elements = (
        replace(element, dofs=tuple(map(changed, element.dofs))) for element in model.elements
    )
    return replace(model, elements=tuple(elements))


def joint_stiffness(model: flexgen.RobotModel) -> np.ndarray:
    """Stiffness of the gears, all elastic, at the joints (n_g,)."""
    found = []
    for k, i in enumerate(model.i_g):
        gear = model.coordinates[i].dof.gear
        ratio = np.abs(model.eta[:, k]).max() if gear.side == "motor" else 1.0
        found.append(ratio**2 * gear.spring.stiffness)
    return np.array(found)


class Gears:
    """Dahl's law in the deflections of gears, from where each began its step; in numbers, as
    `Elements`.
    """

    def __init__(self, stiffness: np.ndarray, slip: np.ndarray, p: np.ndarray) -> None:
        self.slip = slip.tolist()
        self.rate = (-stiffness / slip).tolist()
        self.p = p.tolist()
        self.z = [0.0] * len(p)

    def each_at(self, p: list[float]) -> list[float]:
        out = []
        for now, before, z, slip, rate in zip(
            p, self.p, self.z, self.slip, self.rate, strict=True
        ):
            end = math.copysign(slip, now - before)
            out.append(end + (z - end) * math.exp(rate * abs(now - before)))
        return out

    def at(self, p: np.ndarray) -> np.ndarray:
        return np.array(self.each_at(p.tolist()))

    def keep(self, p: np.ndarray) -> None:
        now = p.tolist()
        self.z = self.each_at(now)
        self.p = now


class Elements:
    """Bouc and Wen's law ``dz/dp = K (1 - s |x|^(n-1) x (beta + gamma sign(s x)))``, s = sign(dp),
    by Runge and Kutta.

    ``stiffness``, ``slip`` (elements, n_g); the torques are those of all elements.
    """

    def __init__(self, elements: Sequence[Element], K: np.ndarray, p: np.ndarray) -> None:
        self.elements = elements
        self.K = K.tolist()
        self.p = p.tolist()
        self.z = [[0.0] * len(elements) for _ in K]

    def each_at(self, p: np.ndarray) -> list[list[float]]:
        """Torques of the elements of each gear; in numbers, since small arrays take three times as
        long.
        """
        out = []
        for K, now, before, z in zip(self.K, p.tolist(), self.p, self.z, strict=True):
            h = now - before
            out.append([each.moved(x, h, K) for each, x in zip(self.elements, z, strict=True)])
        return out

    def at(self, p: np.ndarray) -> np.ndarray:
        return np.array([sum(gear) for gear in self.each_at(p)])

    def keep(self, p: np.ndarray) -> None:
        self.z = self.each_at(p)
        self.p = p.tolist()


Law = Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]]


class Plant:
    """A robot in MuJoCo with torques of its own on joints and rotors, RK4.

    ``law(q_g, v_g, q_m, v_m, tau_m)``: torques on joints and rotors in addition to springs,
    dampers and frictions, and what the motors give; ``kept(q_g, q_m)`` is called after each step;
    ``torque(t, q_m, v_m)``: what they shall give.
    """

    def __init__(
        self,
        name: str,
        law: Law,
        kept: Callable[[np.ndarray, np.ndarray], None],
        torque: Callable[[float, np.ndarray, np.ndarray], np.ndarray],
        step: float,
    ) -> None:
        import mujoco

        self.model = with_friction(flexgen.read(name), "viscous")
        self.law = law
        self.kept = kept
        self.torque = torque
        self.m = mujoco.MjModel.from_xml_string(mjcf(self.model))
        self.d = mujoco.MjData(self.m)
        names = [c.name for c in self.model.coordinates] + [
            f"rotor.{motor.name}" for motor in self.model.motors
        ]
        self.at = self.m.jnt_dofadr[[self.m.joint(joint).id for joint in names]]
        arm = self.at[: self.model.n_a]
        self.rotors = self.at[self.model.n_a :]
        self.joints = arm[list(self.model.i_g)]
        self.motors = [self.m.actuator(motor.name).id for motor in self.model.motors]
        self.m.opt.timestep = step
        self.m.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4

    def run(self, start: float, q: np.ndarray, steps: int, look: Callable[[int], None]) -> None:
        """``look(k)`` after each step k, from rest at (q_a, q_m) at the time ``start`` [s]."""
        import mujoco

        joints = self.joints
        rotors = self.rotors
        motors = self.motors

        angles = self.d.qpos
        speeds = self.d.qvel
        applied = self.d.qfrc_applied
        given = self.d.ctrl
        law = self.law
        torque = self.torque

        def control(m: Any, d: Any) -> None:
            q = angles[rotors]
            v = speeds[rotors]
            own = law(angles[joints], speeds[joints], q, v, torque(d.time, q, v))
            applied[joints], applied[rotors], given[motors] = own

        self.d.qpos[self.at] = q
        self.d.time = start
        self.kept(self.d.qpos[joints], self.d.qpos[rotors])
        mujoco.set_mjcb_control(control)
        try:
            for k in range(steps):
                mujoco.mj_step(self.m, self.d)
                self.kept(angles[joints], angles[rotors])
                look(k)
        finally:
            mujoco.set_mjcb_control(None)


def feedback_gains(model: flexgen.RobotModel) -> tuple[np.ndarray, np.ndarray]:
    """Gains [N m/rad, N m s/rad] of a motor feedback of `FREQUENCY`."""
    inertia = np.array([motor.inertia for motor in model.motors])
    w = 2 * np.pi * FREQUENCY
    return inertia * w**2, 2 * inertia * w


def tool_error_in_mujoco(
    name: str,
    path: Trajectory,
    law: Law,
    kept: Callable[[np.ndarray, np.ndarray], None] = lambda q_g, q_m: None,
    *,
    step: float = 2e-4,
    feedback: bool = True,
) -> float:
    """Largest distance [m] of MuJoCo's tool from the path until 0.1 s after it, PD about the
    torque of the path.

    ``law`` and ``kept``: see `Plant`.
    """
    import mujoco

    start = float(path.time[0])
    end = float(path.time[-1])
    steps = round((end - start + 0.1) / step)
    given = path.at(np.clip(start + step / 2 * np.arange(2 * steps + 3), start, end))

    def torque(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        k = round((t - start) / (step / 2))
        return tau[k] + k_p * (angles[k] - q) + k_v * (speeds[k] - v)

    plant = Plant(name, law, kept, torque, step)
    k_p, k_v = (feedback * gain for gain in feedback_gains(plant.model))
    tau = given["tau_m"]
    angles = given["q_m"]
    speeds = given["v_m"]
    tool = plant.d.site_xpos[plant.m.site("tool").id]
    seen = np.empty((steps, 3))

    def look(k: int) -> None:
        mujoco.mj_kinematics(plant.m, plant.d)
        seen[k] = tool

    plant.run(start, np.concatenate([path["q_a"][0], path["q_m"][0]]), steps, look)
    axes = "xyz" if plant.model.output.type == "tool_pose" else plant.model.output.axes
    wanted = given["y_ref"][2 : 2 * steps + 1 : 2, : min(3, path["y_ref"].shape[1])]
    return float(
        np.linalg.norm(seen[:, ["xyz".index(axis) for axis in axes]] - wanted, axis=1).max()
    )


def with_lost_motion(
    name: str, lost_motion: float, start: np.ndarray, share: float = 1.0
) -> tuple[Law, Any]:
    """``law`` and ``kept`` of a robot whose gears have hysteresis; ``start``: their deflections
    (n_g,) at rest.
    """
    K = joint_stiffness(flexgen.read(name))
    return law_of_gears(name, Gears(share * K, 0.5 * lost_motion * K + 1e-30, start))


def law_of_gears(name: str, gears: Gears | Elements) -> tuple[Law, Any]:
    """``law`` and ``kept`` of a robot with these gears."""
    inverse = np.linalg.inv(flexgen.read(name).eta)
    back = -inverse.T

    def law(
        q_g: np.ndarray, v_g: np.ndarray, q_m: np.ndarray, v_m: np.ndarray, tau: np.ndarray
    ) -> Any:
        z = gears.at(inverse @ q_m - q_g)
        return z, back @ z, tau

    def kept(q_g: np.ndarray, q_m: np.ndarray) -> None:
        gears.keep(inverse @ q_m - q_g)

    return law, kept


def error_with_elements(
    name: str, path: Trajectory, elements: Sequence[Element], *, feedback: bool = True
) -> float:
    """`tool_error_in_mujoco` of a robot whose gears have these elements."""
    model = flexgen.read(name)
    start = np.linalg.inv(model.eta) @ path["q_m"][0] - path["q_a"][0][list(model.i_g)]
    law, kept = law_of_gears(name, Elements(elements, joint_stiffness(model), start))
    return tool_error_in_mujoco(name, path, law, kept, feedback=feedback)


def error_in_mujoco(
    name: str,
    path: Trajectory,
    lost_motion: float,
    *,
    share: float = 1.0,
    step: float = 2e-4,
    feedback: bool = True,
) -> float:
    """`tool_error_in_mujoco` of a robot whose gears have ``lost_motion`` [rad]; zero: without
    hysteresis.
    """
    model = flexgen.read(name)
    start = np.linalg.inv(model.eta) @ path["q_m"][0] - path["q_a"][0][list(model.i_g)]
    law, kept = with_lost_motion(name, lost_motion, start, share)
    return tool_error_in_mujoco(name, path, law, kept, step=step, feedback=feedback)
