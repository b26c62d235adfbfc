"""Forms of a robot that a datasheet does not have: gears whose stiffness rises with the load,
friction of the joints behind their gears, and a link that bends in its middle.

A form adds numbers to the model, so that records can determine them; with the first values of
these numbers it moves nearly as the robot of the file.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from flexgen.base.errors import FlexgenError
from flexgen.dynamics.mechanics.lagrangian import gears as gears_of
from flexgen.identification.commissioning.motion_block import Motion
from flexgen.identification.commissioning.unknowns import COULOMB_WIDTH, is_physical
from flexgen.model.elements import (
    Body,
    Dof,
    Element,
    LinearSpring,
    Placement,
    RobotModel,
    SmoothSpring,
)
from flexgen.model.friction import NO_FRICTION, Friction
from flexgen.model.reader import read

# Torque of a gear over its largest one, or over that of the records, at which its curve bends.
BEND = 0.1
# Standard deviation of the friction of a joint behind its gear, over the largest torque.
FRICTION = 0.01


@dataclass(frozen=True)
class Extent:
    """Largest torque [N m or N] of each joint, arm side, and its largest recorded speed [rad/s or
    m/s], by name.
    """

    torques: Mapping[str, float]
    speeds: Mapping[str, float]


def measure_extent(robot: RobotModel, motions: Sequence[Motion]) -> Extent:
    """Largest torques of the motors, or of the records where the file has no limit, and largest
    speeds of the records.
    """
    torques: dict[str, float] = {}
    speeds: dict[str, float] = {}
    for motor in robot.motors:
        for joint, ratio in zip(motor.drives, motor.ratio, strict=True):
            torques[joint] = abs(ratio) * (motor.torque_max or 0.0)
    inverse = np.linalg.inv(robot.eta)
    for motion in motions:
        record = motion.trajectory
        arm = np.abs(record["tau_m"] @ robot.eta).max(axis=0)
        rates = np.gradient(record["q_m"], record.time, axis=0) @ inverse.T
        tops = np.abs(rates).max(axis=0)
        for i, torque, top in zip(robot.i_g, arm.tolist(), tops.tolist(), strict=True):
            name = robot.coordinates[i].name
            torques[name] = torques.get(name) or torque
            speeds[name] = max(top, speeds.get(name, 0.0))
    return Extent(torques, speeds)


def with_curves(robot: RobotModel, extent: Extent) -> RobotModel | None:
    """The robot with springs of gears that stiffen; None: no gear has a linear spring."""
    ratios = {
        robot.coordinates[i].name: ratio
        for i, (_, ratio) in zip(robot.i_g, gears_of(robot), strict=True)
    }
    changed = []

    def change(dof: Dof) -> Dof:
        gear = dof.gear
        if gear is None or not isinstance(gear.spring, LinearSpring):
            return dof
        stiffness = gear.spring.stiffness
        side = ratios[dof.name] if gear.side == "motor" else 1.0
        torque = BEND * (extent.torques.get(dof.name) or 0.0) / side
        at = torque / stiffness if torque > 0.0 else 1e-4
        changed.append(dof.name)
        spring = SmoothSpring(low=0.8 * stiffness, high=stiffness, break_at=at)
        return replace(dof, gear=replace(gear, spring=spring))

    found = _with_dofs(robot, change)
    return found if changed else None


def with_joint_friction(robot: RobotModel, extent: Extent) -> RobotModel:
    """The robot whose joints behind elastic gears may have viscous and Coulomb friction; one for
    which the file states friction keeps it.
    """

    def change(dof: Dof) -> Dof:
        top = extent.speeds.get(dof.name, 0.0)
        if dof.gear is None or dof.gear.rigid or top <= 0.0 or type(dof.friction) is not Friction:
            return dof
        if dof.friction != NO_FRICTION:
            return dof
        return replace(dof, friction=replace(dof.friction, beta=1.0 / (COULOMB_WIDTH * top)))

    return _with_dofs(robot, change)


def friction_tolerances(robot: RobotModel, extent: Extent) -> dict[str, float]:
    """Name of a number of joint friction -> standard deviation, of a robot of
    `with_joint_friction`.
    """
    out = {}
    for coordinate in robot.coordinates:
        dof = coordinate.dof
        if dof is None or dof.gear is None or dof.gear.rigid:
            continue
        law = dof.friction
        if type(law) is not Friction or law != replace(NO_FRICTION, beta=law.beta):
            continue
        if law.beta <= 0.0:
            continue
        torque = FRICTION * extent.torques.get(dof.name, 0.0)
        top = extent.speeds.get(dof.name, 0.0)
        if torque > 0.0 and top > 0.0:
            out[f"{dof.name}.viscous"] = torque / top
            out[f"{dof.name}.coulomb"] = torque
    return out


@dataclass(frozen=True)
class BendingLink:
    """``robot`` with one link cut in its middle: ``tip`` is the outer half of ``link``."""

    robot: RobotModel
    link: str
    tip: str


def with_bending_link(robot: RobotModel) -> BendingLink | None:
    """The robot whose longest link between two joints with motors is cut in its middle, with
    springs about the two axes across it, as stiff as the stiffest one of the file.

    Each half has half of the mass and of the inertia that is left when both halves lie a quarter
    of the length from the middle; both together are the body of the file. Torsion is left to the
    bearings, which have the same axis.

    Returns
    -------
    None: there is no such link, no spring, or the model is not from a file.
    """
    index = _longest_link(robot)
    springs = [dof for element in robot.elements for dof in element.dofs if _is_bearing(dof)]
    if index is None or not springs or not robot.file or not robot.text:
        return None
    link = robot.elements[index]
    after = robot.elements[index + 1].origin.position
    halves = _halves(link.body, np.array(after))
    if halves is None:
        return None
    stiffest = max(springs, key=lambda dof: getattr(dof.spring, "stiffness", 0.0))
    tip = f"{link.name}_tip"
    data = json.loads(robot.text)["element"]
    data[index]["body"] = _body_table(halves[0])
    data[index + 1]["origin"] = data[index + 1]["origin"] | {"position": _list(0.5, after)}
    dofs = [
        {
            "name": f"{link.name}_bend_{name}",
            "type": "rotation",
            "axis": (np.round(axis, 12) + 0.0).tolist(),
            "spring": {"type": "linear", "stiffness": getattr(stiffest.spring, "stiffness", 0.0)},
            "damping": stiffest.damping,
        }
        for name, axis in zip("ab", _across(np.array(after)), strict=True)
    ]
    new = {
        "name": tip,
        "origin": {"position": _list(0.5, after)},
        "dof": dofs,
        "body": _body_table(halves[1]),
    }
    changes = {key: x for key, x in robot.overrides.items() if not key.startswith("element")} | {
        "element": [*data[: index + 1], new, *data[index + 1 :]]
    }
    try:
        made = read(robot.file, robot.variant or None, overrides=changes)
    except FlexgenError:  # such as a name that the file has already
        return None
    return BendingLink(made, link.name, tip)


def _longest_link(robot: RobotModel) -> int | None:
    """Index of the element with the longest way to the next one, both with motors; None: the robot
    is a tree, or a frame or sensor is in the way.
    """
    elements = robot.elements
    if any(element.parent is not None or element.beam is not None for element in elements):
        return None
    used = {getattr(sensor, "element", None) for sensor in robot.sensors}
    used |= {motor.carrier for motor in robot.motors}
    found = [
        (float(np.linalg.norm(after.origin.position)), k)
        for k, (element, after) in enumerate(pairwise(elements))
        if _has_motor(element) and _has_motor(after) and element.name not in used
        and element.link == Placement() and element.body.mass > 0.0
    ]  # fmt: skip
    length, index = max(found, default=(0.0, 0))
    return index if length > 0.0 else None


def _has_motor(element: Element) -> bool:
    """Whether a motor turns the element against the one before."""
    return any(dof.actuated for dof in element.dofs)


def _is_bearing(dof: Dof) -> bool:
    """Whether it is a rotation with a linear spring and no motor."""
    return dof.type == "rotation" and isinstance(dof.spring, LinearSpring)


def _halves(body: Body, length: np.ndarray) -> tuple[Body, Body] | None:
    """Halves of a body in the frames of the link and of its middle; None: not physical."""
    quarter = 0.25 * length
    spread = body.mass * (quarter @ quarter * np.eye(3) - np.outer(quarter, quarter))
    inertia = 0.5 * (np.array(body.inertia, float) - spread)
    com = tuple((np.array(body.com) - quarter).tolist())
    half = Body(0.5 * body.mass, com, tuple(tuple(row) for row in inertia.tolist()))
    return (half, half) if is_physical(half) else None


def _across(way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors across a way and each other, axes of the frame where it is along one."""
    unit = way / np.linalg.norm(way)
    along = int(np.argmax(np.abs(unit)))
    one = np.eye(3)[(along + 1) % 3]
    one = one - unit * (unit @ one)
    one = one / np.linalg.norm(one)
    return one, np.cross(unit, one)


def _body_table(body: Body) -> dict[str, Any]:
    """The table of a body in a model file."""
    i = body.inertia
    entries = [i[0][0], i[1][1], i[2][2], i[0][1], i[1][2], i[0][2]]
    return {"mass": body.mass, "com": list(body.com), "inertia": entries}


def _list(factor: float, vector: Sequence[float]) -> list[float]:
    """A vector times a factor."""
    return [factor * float(x) for x in vector]


def _with_dofs(robot: RobotModel, change: Callable[[Dof], Dof]) -> RobotModel:
    """The robot with changed degrees of freedom."""
    elements = tuple(
        replace(element, dofs=tuple(change(dof) for dof in element.dofs))
        for element in robot.elements
    )
    return replace(robot, elements=elements)
