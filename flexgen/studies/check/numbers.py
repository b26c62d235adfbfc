"""Checks of the numbers of a model file: drives, springs, bodies.

The ranges are those of real robots, widened: Manutec r3 (Otter 1995), KUKA KR300 (Weigand et al.)
and KR500, an ABB arm (Wernholt and Gunnarsson 2006), the four-mass benchmark (Moberg and Oehr
2009). Over them, each spring has a natural frequency of 3.2 to 74 Hz with all other coordinates
locked and a damping ratio of 0.005 to 0.36, the rotors have 0.12 to 280 times the inertia of their
arm, and gravity deflects a gear by at most 2 mrad.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.dynamics.mechanics.statics import Equilibrium
from flexgen.model.elements import Body, Coordinate, Motor, RobotModel, Spring
from flexgen.model.friction import steepness
from flexgen.studies.check.finding import OK, UNUSUAL, Finding, Usual, make_finding

RATIO = Usual(0.9, 500.0, 1e-2, 1e4)  # of a rotation
RATIO_TRANSLATION = Usual(5.0, 2e4, 1e-2, 1e6)  # rad/m: pinions of 0.2 m to screws of 0.3 mm
ROTOR = Usual(1e-7, 0.1, 1e-10, 10.0)  # kg m^2
ROTOR_TO_ARM = Usual(0.02, 500.0, 1e-4, 1e5)
FREQUENCY = Usual(3.0, 300.0, 0.05, 2e4)  # Hz
DAMPING = Usual(1e-3, 0.4, 0.0, 30.0)
SAG = Usual(0.0, 0.01, 0.0, 0.5)  # rad
SAG_TRANSLATION = Usual(0.0, 0.005, 0.0, 0.2)  # m
MOTOR_SPEED = Usual(10.0, 1100.0, 0.1, 2e4)  # rad/s
JOINT_SPEED = Usual(0.05, 20.0, 1e-3, 1e3)  # rad/s
JOINT_SPEED_TRANSLATION = Usual(0.01, 10.0, 1e-4, 100.0)  # m/s
MOVE_SPEED = Usual(0.0, 50.0, 0.0, 1e3)  # rad/s
MOVE_SPEED_TRANSLATION = Usual(0.0, 10.0, 0.0, 100.0)  # m/s
# 1/s: how fast the friction of a motor at rest slows it down, beta coulomb / inertia; a simulation
# follows no faster one than the largest
HOLD = Usual(0.0, 1e6, 0.0, 1e9)
# beta times the change of the motor speed in a sample of 1 ms at a reversal: above 5 the friction
# jumps between samples
REVERSAL = Usual(0.0, 5.0)
TORQUE = Usual(1.0, math.inf)  # of the largest motor torque to that of gravity at home
DENSITY = Usual(1.0, math.inf, 0.1)  # inertia to that of a steel ball of the same mass
SIZE = Usual(0.0, 1.0, 0.0, 1e3)  # inertia to mass times the square of the length of the chain
SHARE = Usual(0.0, 5.0, 0.0, 200.0)  # mass of a body to that of all others
GRAVITY = Usual(0.0, 30.0, 0.0, 300.0)  # m/s^2
LENGTH = Usual(1e-3, 100.0, 1e-5, 1e4)  # m, of the chain
STEEL = 7850.0  # kg/m^3
HOME = "at home"


def stiffness(spring: Spring) -> tuple[float, str]:
    """The smallest stiffness of a spring outside a dead band, and its key."""
    low = getattr(spring, "low", None)
    return (low, "low") if low is not None else (getattr(spring, "stiffness", 0.0), "stiffness")


def dof_key(coordinate: Coordinate) -> str:
    """The place of a degree of freedom in the model file."""
    return f"element.{coordinate.element}.dof.{coordinate.name}"


def drives(robot: RobotModel, M: np.ndarray, rest: Equilibrium) -> Iterator[Finding]:
    """Ratio, rotor inertia, speeds and torque of each motor; ``M`` (n_a, n_a): mass matrix of the
    arm at the pose ``rest``.
    """
    for j, motor in enumerate(robot.motors):
        for name, ratio in zip(motor.drives, motor.ratio, strict=True):
            i = next(i for i in robot.i_g if robot.coordinates[i].name == name)
            yield from _ratio_findings(motor, robot.coordinates[i], ratio, M[i, i])
        yield from _speeds(robot, motor)
        yield from _friction(motor)
        yield from _report_torque(motor, abs(float(rest.tau_m[j])), HOME)


def _report_torque(motor: Motor, load: float, where: str) -> Iterator[Finding]:
    """The largest torque of a motor against the one that holds the arm [N m]."""
    if motor.torque_max and load > 1e-9 * motor.torque_max:
        text = f"torque of the motor to that of gravity {where}"
        advice = "torque_max is at the motor, not at the joint; or ratio, masses, gravity"
        yield make_finding(
            f"motor.{motor.name}.torque_max", text, motor.torque_max / load, "", TORQUE, advice
        )


def report_still(
    robot: RobotModel, M: np.ndarray, rest: Equilibrium, where: str
) -> Iterator[Finding]:
    """Findings that depend on the pose: motors that hold the arm, and springs."""
    for j, motor in enumerate(robot.motors):
        yield from _report_torque(motor, abs(float(rest.tau_m[j])), where)
    yield from springs(robot, M, rest, where)


def _ratio_findings(
    motor: Motor, joint: Coordinate, ratio: float, arm: float
) -> Iterator[Finding]:
    """Findings for one joint that a motor drives with the ``ratio`` q_motor / q_joint; ``arm``:
    inertia of the arm at the joint [kg m^2, kg].

    Of ratio and rotor inertia the one farther from the usual is blamed for a large rotor.
    """
    translation = joint.unit == "m"
    size = abs(ratio)
    usual = RATIO_TRANSLATION if translation else RATIO
    unit, kind = ("rad/m", "a translation") if translation else ("rad/rad", "a rotation")
    by_unit = (
        " in rad/m: 2 pi over the lead of a screw, 1 over the radius of a pinion, times the gear"
        * translation
    )
    advice = f"the ratio is q_motor / q_joint{by_unit}; not a percentage, and not its inverse"
    yield make_finding(f"motor.{motor.name}.ratio", f"ratio of {kind}", size, unit, usual, advice)
    if motor.inertia == 0.0:
        return
    advice = "inertia in kg m^2: 1 g cm^2 is 1e-7, 1 kg cm^2 is 1e-4"
    yield make_finding(
        f"motor.{motor.name}.inertia", "rotor inertia", motor.inertia, "kg m^2", ROTOR, advice
    )
    if arm > 0.0:
        worst = "ratio" if usual.distance(size) >= ROTOR.distance(motor.inertia) else "inertia"
        advice = (
            f"{worst} of the motor (it is on the motor side), or the masses and inertias of the "
            "arm"
        )
        text = f"rotor inertia times ratio^2 to the inertia of the arm at {joint.name}"
        yield make_finding(
            f"motor.{motor.name}.{worst}",
            text,
            motor.inertia * ratio**2 / arm,
            "",
            ROTOR_TO_ARM,
            advice,
        )


def _friction(motor: Motor) -> Iterator[Finding]:
    """Decay of the speed of the motor near rest, by a steep friction."""
    law = motor.friction
    level = law.coulomb + law.stribeck
    if not steepness(law) or motor.inertia == 0.0 or level == 0.0:
        return
    advice = (
        "beta in s/rad at the motor: the friction is fully developed above the speed 2/beta; or "
        "coulomb in N m"
    )
    text = "beta coulomb / inertia, the decay of its speed near rest"
    rate = steepness(law) * level / motor.inertia
    yield make_finding(f"motor.{motor.name}.friction.beta", text, rate, "1/s", HOLD, advice)


def _speeds(robot: RobotModel, motor: Motor) -> Iterator[Finding]:
    """Limits of the speeds of a motor and its joints."""
    key = f"motor.{motor.name}.speed_max"
    advice = "speed_max in rad/s: 1000 rpm are 105 rad/s"
    if motor.speed_max:
        yield make_finding(key, "motor speed", motor.speed_max, "rad/s", MOTOR_SPEED, advice)
    for name, ratio in zip(motor.drives, motor.ratio, strict=True):
        joint = next(c for c in robot.coordinates if c.name == name)
        usual = JOINT_SPEED_TRANSLATION if joint.unit == "m" else JOINT_SPEED
        unit = f"{joint.unit}/s"
        if motor.speed_max:
            text = f"speed of {name} at the largest motor speed"
            yield make_finding(
                key, text, motor.speed_max / abs(ratio), unit, usual, f"{advice}; or the ratio"
            )
        assert joint.dof is not None
        if joint.dof.speed_max:
            advice_joint = f"speed_max in {unit}" + ": 180 degrees/s are 3.14 rad/s" * (
                joint.unit == "rad"
            )
            yield make_finding(
                f"{dof_key(joint)}.speed_max",
                "joint speed",
                joint.dof.speed_max,
                unit,
                usual,
                advice_joint,
            )


def springs(
    robot: RobotModel, M: np.ndarray, rest: Equilibrium, where: str = HOME
) -> Iterator[Finding]:
    """Natural frequency, damping ratio and static deflection of each spring, all other coordinates
    locked.

    ``M`` (n_a, n_a): mass matrix of the arm at the pose ``rest``, which ``where`` names.
    """
    gear_of = {
        i: (g, *gear) for g, (i, gear) in enumerate(zip(robot.i_g, gears(robot), strict=True))
    }
    for i, joint in enumerate(robot.coordinates):
        dof = joint.dof
        inertia = float(M[i, i])
        if dof is None or inertia <= 0.0:
            continue
        if i in gear_of:
            g, gear, side = gear_of[i]
            if gear.spring is None:
                continue
            key = f"{dof_key(joint)}.gear"
            spring = gear.spring
            damping = gear.damping
            factor = side**2
            K = stiffness(spring)[0] * factor
            deflection = float(rest.tau_g[g]) / K
        else:
            assert dof.spring is not None
            key = dof_key(joint)
            spring = dof.spring
            damping = dof.damping
            factor = 1.0
            K = stiffness(spring)[0]
            deflection = float(rest.q_a[i])
        if K > 0.0:
            name = stiffness(spring)[1]
            numbers = K, damping * factor, inertia, abs(deflection)
            yield from _spring(joint, key, name, numbers, where)


def _spring(
    joint: Coordinate,
    key: str,
    name: str,
    numbers: tuple[float, float, float, float],
    where: str = HOME,
) -> Iterator[Finding]:
    """Findings for the spring ``name`` of the model key ``key``.

    ``numbers``: stiffness K, damping D and inertia on the arm side, and the deflection under
    gravity at the pose ``where`` [rad, m].
    """
    K, D, inertia, deflection = numbers
    unit = "N m/rad" if joint.unit == "rad" else "N/m"
    by_degree = (
        ": 1 N m/deg is 57.3 N m/rad, 1 N m/arcmin is 3438"
        if joint.unit == "rad"
        else ": 1 N/um is 1e6"
    )
    place = f"{key}.spring.{name}"
    advice = f"stiffness in {unit}{by_degree}; side of the gear; masses and inertias"
    frequency = math.sqrt(K / inertia) / (2 * math.pi)
    at = "" if where == HOME else f" {where}"
    text = f"lowest mode of the spring{at}"
    yield make_finding(place, text, frequency, "Hz", FREQUENCY, advice)
    usual = SAG if joint.unit == "rad" else SAG_TRANSLATION
    if deflection > 0.0:
        yield make_finding(
            place, f"deflection by gravity {where}", deflection, joint.unit, usual, advice
        )
    ratio = D / (2.0 * math.sqrt(K * inertia))
    advice = f"damping in {unit.replace('/', ' s/')} on the side of the spring, or the stiffness"
    if D == 0.0:
        text = "0: no damping"
        ratio_text = f"damping ratio of the spring{at}"
        yield Finding(UNUSUAL, f"{key}.damping", ratio_text, text, str(DAMPING), advice)
        return
    name = f"damping ratio of the spring{at}" + ", overdamped" * (ratio >= 1.0)
    yield make_finding(f"{key}.damping", name, ratio, "", DAMPING, advice)


def sizes(robot: RobotModel) -> Iterator[Finding]:
    """Gravity and the length of the chain, where they are not those of a robot."""
    gravity = float(np.linalg.norm(robot.gravity))
    advice = "gravity in m/s^2: 9.81 on the Earth"
    found = [make_finding("gravity", "gravity", gravity, "m/s^2", GRAVITY, advice)]
    length = _length(robot)
    advice = "positions of origin, link, com and tool in m: 1 mm is 1e-3"
    if length > 0.0:
        found.append(make_finding("element", "length of the chain", length, "m", LENGTH, advice))
    yield from (finding for finding in found if finding.mark != OK)


def bodies(robot: RobotModel) -> Iterator[Finding]:
    """Mass against inertia, inertia against size, and mass against the other bodies."""
    named = [(f"element.{element.name}.body", element.body) for element in robot.elements]
    named += [("payload", robot.payload)]
    beams = sum(
        e.beam.mass_per_length * e.beam.length for e in robot.elements if e.beam is not None
    )
    total = sum(body.mass for _, body in named) + beams
    length = _length(robot)
    for key, body in named:
        if body.mass == 0.0:
            continue
        trace = float(np.trace(np.array(body.inertia)))
        if trace > 0.0:
            yield from _shape(key, body, trace, length)
        if total > body.mass * (1.0 + 1e-9):
            share = body.mass / (total - body.mass)
            advice = "mass in kg: 1 g is 1e-3"
            yield make_finding(
                f"{key}.mass", "mass to that of all other bodies", share, "", SHARE, advice
            )


def _shape(key: str, body: Body, trace: float, length: float) -> Iterator[Finding]:
    """Inertia against mass: a ball of steel is the most compact body, and none is larger than the
    arm.

    ``trace``: of the inertia about the center of mass [kg m^2]; ``length``: of the arm [m], 0:
    unknown.
    """
    radius = (3.0 * body.mass / (4.0 * math.pi * STEEL)) ** (1.0 / 3.0)
    dense = trace / (1.2 * body.mass * radius**2)  # 3 times 2/5 m r^2
    advice = "mass in kg (1 g is 1e-3), or the inertia in kg m^2"
    yield make_finding(
        f"{key}.mass", "inertia to that of a steel ball of this mass", dense, "", DENSITY, advice
    )
    if length > 0.0:
        size = trace / (2.0 * body.mass * length**2)
        advice = "inertia in kg m^2: 1 g cm^2 is 1e-7, 1 kg mm^2 is 1e-6; or the mass in kg"
        yield make_finding(
            f"{key}.inertia",
            "inertia to mass times length of the arm squared",
            size,
            "",
            SIZE,
            advice,
        )


def _length(robot: RobotModel) -> float:
    """Length of the chain of frames [m], without the base."""
    places = [place for e in robot.elements for place in (e.origin, e.link)] + [robot.tool]
    beams = sum(element.beam.length for element in robot.elements if element.beam is not None)
    centers = max((float(np.linalg.norm(e.body.com)) for e in robot.elements), default=0.0)
    return max(
        sum(float(np.linalg.norm(place.position)) for place in places) + beams, 2.0 * centers
    )


def report_overdamped(poles: np.ndarray, slow: float) -> Finding:
    """The real poles that are faster than ``slow`` [1/s]: modes that do not swing, for
    information.

    Coulomb friction that is smooth at rest makes some; springs with too much damping have a
    finding of their own.
    """
    real = [z.real for z in poles if abs(z.imag) <= 1e-6 * abs(z) and z.real < -slow]
    if not real:
        return Finding(OK, "modes", "overdamped modes", "none", "none, or by friction at rest")
    shown = ", ".join(f"{value:.4g}" for value in real[:6]) + (", ..." if len(real) > 6 else "")
    return Finding(
        OK,
        "modes",
        "overdamped modes (real poles)",
        f"{shown} 1/s",
        "none, or by friction at rest",
    )
