"""Faults of experiments: robots that differ from their model, and records that are not what their
file says.

Each fault has a robot (the model that is fitted), a true robot, and a change of the recorded
samples or spectra.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import flexgen
from flexgen.dynamics.mechanics.parameters import select, with_values
from flexgen.identification.experiments.experiment import Experiment
from flexgen.identification.rigid.missing_springs import without
from flexgen.model.elements import BacklashSpring, RobotModel, SmoothSpring
from flexgen.model.friction import Friction

NOISE = flexgen.DriveHardware(encoder_noise_rad=1e-5, torque_noise_Nm=0.02)
SPREAD = 0.2  # of the true springs and dampers
POSES = 4
LINES = 40
PERIOD_S = 2.0
SPEED = 0.03

Robot = Callable[[RobotModel], RobotModel]
Samples = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Fault:
    """``name``; ``cause``: how an explanation begins that names it; ``robot``: the model that is
    fitted.

    ``model``: the model that is fitted, from the robot; ``truth``: the true robot; ``spectra``,
    ``samples``: changes of the record; ``plan``: arguments of `excite`.
    """

    name: str
    cause: str
    robot: str = "planar5_nmp"
    truth: Robot = lambda robot: robot
    model: Robot = lambda robot: robot
    spectra: Callable[[Experiment], Experiment] = lambda experiment: experiment
    samples: Samples | None = None
    plan: tuple[tuple[str, Any], ...] = ()
    gravity: bool = True


def plain(name: str) -> RobotModel:
    """The model with viscous friction only."""
    model = flexgen.read(name)
    motors = (
        replace(m, friction=replace(m.friction, coulomb=0.0, stribeck=0.0)) for m in model.motors
    )
    return replace(model, motors=tuple(motors))


def another(model: RobotModel, seed: int) -> RobotModel:
    """The robot with other springs and dampers."""
    rng = np.random.default_rng(seed)
    names = ["stiffness", "damping"]
    limit = np.log1p(SPREAD)
    values = {
        p.name: p.value * float(np.exp(rng.uniform(-limit, limit))) for p in select(model, names)
    }
    return with_values(model, values)


def times(factor: float, *names: str) -> Robot:
    """The robot with some numbers times a factor."""
    return lambda robot: with_values(
        robot, {p.name: factor * p.value for p in select(robot, list(names))}
    )


def masses(factor: float) -> Robot:
    """All bodies and the payload that much heavier; inertias too."""

    def change(robot: RobotModel) -> RobotModel:
        bodies = [e.name for e in robot.elements if e.body is not None and e.body.mass > 0]
        parts = [
            f"{b}.{x}"
            for b in bodies
            for x in ("mass", *(f"inertia_{k}" for k in ("xx", "yy", "zz", "xy", "xz", "yz")))
        ]
        parts += ["payload.mass"] * (robot.payload is not None and robot.payload.mass > 0)
        return times(factor, *parts)(robot)

    return change


def gear(joint: str, make: Callable[[float], Any]) -> Robot:
    """Another spring in a gear, made from its stiffness."""

    def change(robot: RobotModel) -> RobotModel:
        def dof(d: Any) -> Any:
            if d.name != joint or d.gear is None:
                return d
            return replace(d, gear=replace(d.gear, spring=make(d.gear.spring.stiffness)))

        return replace(
            robot, elements=tuple(replace(e, dofs=tuple(map(dof, e.dofs))) for e in robot.elements)
        )

    return change


def coulomb_of_motors(*levels: float) -> Robot:
    """Coulomb friction of the motors [N m], motor side."""

    def change(robot: RobotModel) -> RobotModel:
        laws = [
            replace(m.friction, coulomb=c, beta=2.0)
            for m, c in zip(robot.motors, levels, strict=True)
        ]
        motors = (replace(m, friction=law) for m, law in zip(robot.motors, laws, strict=True))
        return replace(robot, motors=tuple(motors))

    return change


def friction_of_joint(joint: str, coulomb: float, beta: float) -> Robot:
    """Coulomb friction of a joint [N m]: parallel to a spring without motor it is hysteresis."""

    def change(robot: RobotModel) -> RobotModel:
        law = Friction(coulomb=coulomb, beta=beta)
        elements = (
            replace(
                e, dofs=tuple(replace(d, friction=law) if d.name == joint else d for d in e.dofs)
            )
            for e in robot.elements
        )
        return replace(robot, elements=tuple(elements))

    return change


def of_spectra(torques: Any = None, angles: Any = None) -> Callable[[Experiment], Experiment]:
    """Functions of the spectra (..., lines, n_m) of torques and angles, and of the frequencies
    (lines, 1) [Hz].
    """

    def change(x: Experiment) -> Experiment:
        hz = x.plan.frequencies[:, None]
        tau_m = x.tau_m if torques is None else torques(x.tau_m, hz)
        q_m = x.q_m if angles is None else angles(x.q_m, hz)
        return replace(x, tau_m=tau_m, q_m=q_m, offsets=None, beside=None)

    return change


def scaled(*factors: float) -> Any:
    """Each channel times a factor."""
    return lambda x, hz: x * np.array(factors)


def exchanged(x: np.ndarray, hz: np.ndarray) -> np.ndarray:
    """The channels of two motors exchanged."""
    return x[..., ::-1]


def later(seconds: float) -> Any:
    """The channels that much later."""
    return lambda x, hz: x * np.exp(-2j * np.pi * hz * seconds)


def stretched(factor: float) -> Callable[[Experiment], Experiment]:
    """The record with a sample time that is wrong by a factor: the file has a longer period."""

    def change(x: Experiment) -> Experiment:
        hardware = replace(x.plan.hardware, sample_s=factor * x.plan.hardware.sample_s)
        return replace(
            x, plan=replace(x.plan, hardware=hardware, period_s=factor * x.plan.period_s)
        )

    return change


def clipped(part: float) -> Samples:
    """Recorded torques that end at a part of their largest deviation."""

    def change(q_m: np.ndarray, tau_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        middle = tau_m.mean(axis=0)
        most = part * np.abs(tau_m - middle).max(axis=0)
        return q_m, np.clip(tau_m, middle - most, middle + most)

    return change


def held(part: float) -> Samples:
    """A part of the recorded angles, in bursts of five, repeats the sample before."""

    def change(q_m: np.ndarray, tau_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(7)
        kept = np.arange(len(q_m))
        for first in rng.integers(1, len(q_m) - 5, int(part * len(q_m) / 5)):
            kept[first : first + 5] = first - 1
        return q_m[kept], tau_m

    return change


def backlash(stiffness: float) -> BacklashSpring:
    """A gap with the stiffness of the gear beyond it."""
    return BacklashSpring(stiffness, gap=1e-4, smoothing=2e-5)


def progressive(stiffness: float) -> SmoothSpring:
    """Half the stiffness at small torques."""
    return SmoothSpring(0.5 * stiffness, stiffness, break_at=2e-4)


FAULTS = (
    Fault("none, planar5_nmp", ""),
    Fault("none, elbow", "", "elbow"),
    Fault("none, manutec_r3_18", "", "manutec_r3_18"),
    Fault(
        "mass of the last body 20 % larger, elbow",
        "mass of fore",
        "elbow",
        times(1.2, "fore.mass"),
    ),
    Fault(
        "payload 20 % heavier, manutec_r3_18",
        "payload",
        "manutec_r3_18",
        times(1.2, "payload.mass"),
    ),
    Fault("mass of the last body 20 % larger", "mass of arm3", truth=times(1.2, "arm3.mass")),
    Fault("all masses 5 % larger, planar5_nmp", "all masses", truth=masses(1.05)),
    Fault("all masses 5 % larger, elbow", "all masses", "elbow", masses(1.05)),
    Fault("rotor inertia 1 10 % larger", "rotor inertia of m1", truth=times(1.1, "m1.inertia")),
    Fault("torques 1 sample late", "torques that act", spectra=of_spectra(torques=later(5e-4))),
    Fault(
        "torques not held, as the file says",
        "torques that act",
        spectra=lambda x: replace(x, hold="none"),
    ),
    Fault("sample time 1 % wrong", "sample time", spectra=stretched(1.01)),
    Fault(
        "sign of torque 1",
        "the sign of the torque of m1",
        spectra=of_spectra(torques=scaled(-1, 1)),
    ),
    Fault(
        "sign of angle 2, elbow",
        "the sign of the angle of m2",
        "elbow",
        spectra=of_spectra(angles=scaled(1, -1)),
    ),
    Fault(
        "torque 1 5 % too large",
        "torque of m1 5 % too large",
        spectra=of_spectra(torques=scaled(1.05, 1)),
    ),
    Fault(
        "angle 2 5 % too large",
        "angle of m2 5 % too large",
        spectra=of_spectra(angles=scaled(1, 1.05)),
    ),
    Fault(
        "degrees for radians",
        "angles in degrees",
        spectra=of_spectra(angles=scaled(180 / np.pi, 180 / np.pi)),
    ),
    Fault(
        "torques exchanged",
        "exchanged torques of m1 and m2",
        spectra=of_spectra(torques=exchanged),
    ),
    Fault(
        "angles exchanged, elbow",
        "exchanged angles of m1 and m2",
        "elbow",
        spectra=of_spectra(angles=exchanged),
    ),
    Fault("torques clipped at half", "at its limit", samples=clipped(0.5)),
    Fault("5 % of the angles lost", "samples", samples=held(0.05)),
    Fault(
        "spring q3 missing",
        "a missing spring",
        model=lambda robot: without(robot, "q3"),
        truth=lambda robot: robot,
    ),
    Fault(
        "spring t5y missing",
        "a missing spring",
        "manutec_r3_18",
        model=lambda robot: without(robot, "t5y"),
    ),
    Fault("hysteresis of q3", "hysteresis", truth=friction_of_joint("q3", 20.0, 100.0)),
    Fault("backlash of gear 1", "backlash", truth=gear("q1", backlash), gravity=False),
    Fault("Coulomb friction of the motors", "Coulomb", truth=coulomb_of_motors(0.3, 0.2)),
    Fault("gear 1 soft at small torques", "softer", truth=gear("q1", progressive), gravity=False),
    Fault(
        "one transient period of 1 s",
        "transient",
        "elbow",
        plan=(("period_s", 1.0), ("transients", 1)),
    ),
    Fault(
        "drive of m2 gives 90 % of its torque",
        "torque of m2",
        "manutec_r3_18",
        spectra=of_spectra(torques=scaled(1, 1 / 0.9, 1, 1, 1, 1)),
    ),
)
