"""Models with one spring without motor more, or less."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexgen.model.elements import Body, Dof, Element, LinearSpring, RobotModel

PEDESTAL = "pedestal"  # name of the body on which a robot stands that has none
# Radius of gyration of the pedestal [m] where a search begins, with the mass of the robot.
GYRATION = 0.2


def additions(model: RobotModel) -> list[tuple[Dof, RobotModel]]:
    """Models with one more spring: rotations about the axes perpendicular to each joint that are
    not there yet.

    And about all three axes of a body that slides, or whose element has no motor.
    """
    out = []
    for e, element in enumerate(model.elements):
        new = []
        if element.body.mass > 0 and all(dof.gear is None for dof in element.dofs):
            new = [
                (len(element.dofs), f"{element.name}_{'xyz'[k]}", axis)
                for k, axis in enumerate(np.eye(3))
            ]
        for at, dof in enumerate(element.dofs):
            if dof.gear is None:
                continue
            along = [np.array(dof.axis)] if dof.type == "translation" else []
            axes = [*perpendicular(np.array(dof.axis)), *along]
            new += [(at + 1, f"{dof.name}_{'uvw'[k]}", axis) for k, axis in enumerate(axes)]
        there = [d.axis for d in element.dofs if d.spring is not None and d.type == "rotation"]
        for at, name, axis in new:
            if any(abs(float(np.dot(each, axis))) > 0.99 for each in there):
                continue
            added = Dof(
                name, "rotation", tuple(axis.tolist()), spring=LinearSpring(1.0), damping=1.0
            )
            changed = replace(element, dofs=(*element.dofs[:at], added, *element.dofs[at:]))
            elements = (*model.elements[:e], changed, *model.elements[e + 1 :])
            out.append((added, replace(model, elements=elements)))
    return out


def base_springs(model: RobotModel) -> list[tuple[Dof, RobotModel]]:
    """Models that stand on a pedestal with a spring about an axis x, y or z of the base; none for
    a robot whose first element has no motor, since its springs are those of a base.

    The pedestal has the mass of the robot, and an inertia that is not known.
    """
    first = model.elements[0]
    if first.dofs and all(dof.gear is None for dof in first.dofs):
        return []
    mass = sum(element.body.mass for element in model.elements)
    inertia = mass * GYRATION**2
    body = Body(mass, inertia=tuple(map(tuple, (inertia * np.eye(3)).tolist())))
    moved = tuple(replace(e, parent=PEDESTAL) if e.parent == "base" else e for e in model.elements)
    out = []
    for name, axis in zip("xyz", np.eye(3), strict=True):
        spring = LinearSpring(1.0)
        dof = Dof(f"base_{name}", "rotation", tuple(axis.tolist()), spring=spring, damping=1.0)
        pedestal = Element(PEDESTAL, (dof,), body=body)
        out.append((dof, replace(model, elements=(pedestal, *moved))))
    return out


def perpendicular(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors perpendicular to an axis and to each other; coordinate axes where the axis
    is one.
    """
    first = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = first - axis * (axis @ first)
    first = first / np.linalg.norm(first)
    return first, np.cross(axis, first)


def without(model: RobotModel, name: str) -> RobotModel:
    """The model with a coordinate without motor stiff: left out."""
    elements = tuple(
        replace(e, dofs=tuple(dof for dof in e.dofs if dof.name != name)) for e in model.elements
    )
    return replace(model, elements=elements)


def with_spring(model: RobotModel, name: str, stiffness: float, damping: float) -> RobotModel:
    """The model with other numbers of a spring without motor."""
    elements = tuple(
        replace(
            e,
            dofs=tuple(
                replace(d, spring=LinearSpring(stiffness), damping=damping)
                if d.name == name
                else d
                for d in e.dofs
            ),
        )
        for e in model.elements
    )
    return replace(model, elements=elements)
