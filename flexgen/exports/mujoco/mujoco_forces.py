"""Springs, dampers, drives, drags and lines as tendons of an MJCF file, and its actuators.

A fixed tendon is a sum of joint values, ``L = sum_i coef_i q_i``; its spring, damper and inertia
act on this sum.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree.ElementTree import Element

import numpy as np

from flexgen.base.spec.lines import RodLine, SpringLine
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.exports.mechanisms import held_axes, lengths_of_mechanisms, mechanisms
from flexgen.exports.mujoco.mujoco_checks import Drive, common_axis, refusal, slack_length
from flexgen.exports.poses import chain
from flexgen.exports.xml_text import add, numbers
from flexgen.model.elements import (
    BacklashSpring,
    CubicSpring,
    LinearSpring,
    Placement,
    RobotModel,
    SmoothSpring,
    Spring,
)

# time steps in which a constraint is met; part of a force that it takes at once
STIFF = 4.0
CLOSE = 0.9999
FAR = 1e9  # rad or m: a spring whose range begins there acts in one direction only


def add_tendons(model: RobotModel, drives: Sequence[Drive], tendons: Element) -> None:
    """Add the gears, the nonlinear springs, the drives of several joints, the mechanisms, and the
    drags.
    """
    _gears(model, tendons)
    for coordinate in model.coordinates:
        dof = coordinate.dof
        if dof is not None and dof.spring is not None and not isinstance(dof.spring, LinearSpring):
            _spring(tendons, f"spring.{dof.name}", dof.spring, dof.damping, {dof.name: 1.0})
    for drive in drives:
        if not drive.elastic:
            _rigid_drive(tendons, drive)
    _mechanisms(model, tendons)
    _drags(model, tendons)
    _lines(model, tendons)


def _lines(model: RobotModel, tendons: Element) -> None:
    """Springs and rods between two points as spatial tendons between the sites of `add_sites`."""
    for line in model.lines:
        assert isinstance(line, SpringLine | RodLine)  # others are refused by check_lines
        tendon = add(
            tendons,
            "spatial",
            name=f"line.{line.name}",
            springlength=slack_length(line),
            stiffness=line.stiffness,
            damping=line.damping,
        )
        for end in ("from", "to"):
            add(tendon, "site", site=f"line.{line.name}.{end}")


def add_sites(model: RobotModel, holders: Mapping[str, Element]) -> None:
    """Mark the ends of lines on the bodies of the file, ``holders``, by element."""
    frames = {"base": model.base} | {element.name: element.link for element in model.elements}
    for line in model.lines:
        for end, anchor in (("from", line.start), ("to", line.end)):
            at = chain(frames[anchor.element], Placement(anchor.position)).position
            add(holders[anchor.element], "site", name=f"line.{line.name}.{end}", pos=at)


def add_constraints(model: RobotModel, step: float, equalities: Element) -> None:
    """Hold the axes that mechanisms move; ``step`` [s]: of the file."""
    for name in mechanisms(model):
        add(
            equalities,
            "tendon",
            tendon1=f"mechanism.{name}",
            solref=(STIFF * step, 1.0),
            solimp=(CLOSE, CLOSE, 1e-3),
        )


def add_actuators(drives: Sequence[Drive], actuators: Element) -> None:
    """A motor each [N m, motor side]; its limit is written down and not active."""
    for drive in drives:
        motor = drive.motor
        if drive.elastic:
            made = add(actuators, "motor", name=motor.name, joint=f"rotor.{motor.name}")
        elif len(drive.ratios) == 1:
            ((joint, ratio),) = drive.ratios.items()
            made = add(actuators, "motor", name=motor.name, joint=joint, gear=ratio)
        else:
            made = add(actuators, "motor", name=motor.name, tendon=f"drive.{motor.name}")
        if motor.torque_max is not None:
            made.set("ctrllimited", "false")
            made.set("ctrlrange", numbers([-motor.torque_max, motor.torque_max]))


def _gears(model: RobotModel, tendons: Element) -> None:
    """Elastic gears: deflection ``f (eta^-1 q_m - q_g)``, f from the arm side to the side of the
    spring.
    """
    inverse = np.linalg.inv(model.eta)
    for k, (i, (gear, factor)) in enumerate(zip(model.i_g, gears(model), strict=True)):
        if gear.spring is not None:
            name = model.coordinates[i].name
            ends = {
                f"rotor.{motor.name}": factor * inverse[k, j]
                for j, motor in enumerate(model.motors)
            }
            _spring(tendons, f"gear.{name}", gear.spring, gear.damping, {**ends, name: -factor})


def _spring(
    tendons: Element, name: str, spring: Spring, damping: float, ends: Mapping[str, float]
) -> None:
    """A spring as a sum of tendons: one for small deflections, and what changes beyond the break.

    Beyond the break at b, with e = |d| - b: a piecewise spring adds (high - low) e, a smooth one
    -(high - low) (e^2/b + e^3/(3 b^2)) to the cubic polynomial that holds up to b.
    """
    if isinstance(spring, LinearSpring):
        _tendon(tendons, name, ends, [spring.stiffness], damping=damping)
    elif isinstance(spring, CubicSpring):
        _tendon(tendons, name, ends, [spring.stiffness, 0.0, spring.cubic], damping=damping)
    else:
        assert not isinstance(spring, BacklashSpring)  # refused by check_laws
        low = spring.low
        step = spring.high - spring.low
        b = spring.break_at
        smooth = isinstance(spring, SmoothSpring)
        near = [low, 0.0, step / (3 * b**2)] if smooth else [low]
        beyond = [0.0, -step / b, -step / (3 * b**2)] if smooth else [step]
        _tendon(tendons, name, ends, near, damping=damping)
        _tendon(tendons, f"{name}.above", ends, beyond, upper=b)
        _tendon(
            tendons, f"{name}.below", {joint: -x for joint, x in ends.items()}, beyond, upper=b
        )


def _rigid_drive(tendons: Element, drive: Drive) -> None:
    """Write the friction and the rotor of a motor behind rigid gears as tendons.

    Friction acts on the speed relative to the carrier of the motor, ``ratios`` times the joint
    speeds; the inertia on the absolute one, to which the carrier adds ``turning``. A motor of one
    joint, whose carrier does not turn the rotor, has no tendon: that joint has both.
    """
    motor = drive.motor
    ratios = drive.ratios
    turning = drive.turning or {}
    if len(ratios) > 1 or turning:
        made = _tendon(
            tendons, f"drive.{motor.name}", ratios, [0.0], damping=motor.friction.viscous
        )
        if motor.friction.coulomb:
            made.set("frictionloss", numbers(motor.friction.coulomb))
        speed = {
            key: ratios.get(key, 0.0) + turning.get(key, 0.0) for key in {**ratios, **turning}
        }
        _tendon(tendons, f"rotor.{motor.name}", speed, [0.0]).set(
            "armature", numbers(motor.inertia)
        )


def _mechanisms(model: RobotModel, tendons: Element) -> None:
    """Tendons that keep their length; without armature MuJoCo divides by zero where two axes turn
    a body alike.
    """
    armatures, loose = held_axes(model)
    if loose:
        raise refusal(
            model,
            loose,
            "an axis that moves without inertia where no mechanism holds it",
            "one with inertia",
        )
    for name, ends in lengths_of_mechanisms(model).items():
        _tendon(tendons, f"mechanism.{name}", ends, [0.0]).set(
            "armature", numbers(armatures[name])
        )


def _drags(model: RobotModel, tendons: Element) -> None:
    """Drags on bodies that turn about one direction: on the sum of their joints."""
    bodies = [(f"element.{each.name}.body", each.name, each.body) for each in model.elements]
    for key, name, body in (*bodies, ("payload", model.tip, model.payload)):
        if not body.rotational_drag:
            continue
        spin = common_axis(model, name)
        if spin is None:
            given = "a drag on a body that turns about several directions"
            raise refusal(model, f"{key}.rotational_drag", given, "no drag on this body")
        if spin[1]:
            made = "payload.drag" if key == "payload" else f"drag.{name}"
            _tendon(tendons, made, spin[1], [0.0], damping=body.rotational_drag)


def _tendon(
    tendons: Element,
    name: str,
    ends: Mapping[str, float],
    stiffness: Sequence[float],
    *,
    damping: float = 0.0,
    upper: float | None = None,
) -> Element:
    """A fixed tendon, a sum of joints with the coefficients ``ends``, with a spring.

    ``stiffness``: coefficients of its force in powers of the length, from 1 on; ``upper``: the
    spring acts on what exceeds this length only.
    """
    rest = 0.0 if upper is None else [-FAR, upper]
    tendon = add(tendons, "fixed", name=name, stiffness=stiffness, springlength=rest)
    if damping:
        tendon.set("damping", numbers(damping))
    for joint, coefficient in ends.items():
        if coefficient:
            add(tendon, "joint", joint=joint, coef=coefficient)
    return tendon
