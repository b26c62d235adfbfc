"""Axes that mechanisms move, and what inertia they have where the mechanisms are left out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from flexgen.model.elements import LinearSpring, RobotModel
from flexgen.model.inertia import mass_matrix

# least eigenvalue of an inertia matrix scaled to unit diagonal with which other programs compute
REGULAR = 1e-9


def mechanisms(model: RobotModel) -> dict[str, dict[str, float]]:
    """Axes that a mechanism moves: the factors of the coordinates that they follow."""
    return {
        dof.name: dict(dof.mimic)
        for element in model.elements
        for dof in element.dofs
        if dof.mimic
    }


def lengths_of_mechanisms(model: RobotModel) -> dict[str, dict[str, float]]:
    """The sums of axes that mechanisms keep at zero, by the axis that is moved."""
    return {
        name: {name: 1.0} | {joint: -x for joint, x in own.items()}
        for name, own in mechanisms(model).items()
    }


def held_axes(model: RobotModel) -> tuple[dict[str, float], str]:
    """Inertia at home of each axis that a mechanism moves, as if this were free [kg m^2 or kg].

    A program that holds the axis by a constraint may add ``I L'^2/2`` to the kinetic energy, with
    the sum L of the mechanism: L is constant, so that no motion changes, and the inertia matrix of
    the free robot becomes regular.

    Returns
    -------
    inertias : dict
        By name of the axis; 0 where the sum has axes on several branches.
    loose : str
        Key of an axis along which this inertia matrix is singular; empty where there is none.
    """
    lengths = lengths_of_mechanisms(model)
    if not lengths:
        return {}, ""
    free = tuple(
        replace(
            e,
            dofs=tuple(
                replace(d, mimic=(), spring=LinearSpring(0.0)) if d.mimic else d for d in e.dofs
            ),
        )
        for e in model.elements
    )
    robot = replace(model, elements=free)
    names = [c.name for c in robot.coordinates]
    home = dict.fromkeys(names, 0.0) | dict(
        zip((model.coordinates[i].name for i in model.i_g), model.home, strict=True)
    )
    for name, own in mechanisms(model).items():
        home[name] = sum(x * home[joint] for joint, x in own.items())
    M = mass_matrix(robot, np.array([home[name] for name in names]))
    inertias = {name: float(M[names.index(name), names.index(name)]) for name in lengths}
    for name, ends in lengths.items():
        inertias[name] *= on_one_chain(model, ends)
        row = np.array([ends.get(joint, 0.0) for joint in names])
        M += inertias[name] * np.outer(row, row)
    size = np.sqrt(np.diag(M))
    share = np.where(size == 0.0, 1.0, 0.0)
    if size.all():
        values, vectors = np.linalg.eigh(M / np.outer(size, size))
        if values[0] > REGULAR:
            return inertias, ""
        share = np.abs(vectors[:, 0])
    loose = max(lengths, key=lambda name: float(share[names.index(name)]))
    places = {dof.name: element.name for element in model.elements for dof in element.dofs}
    return inertias, f"element.{places[loose]}.dof.{loose}.mimic"


def on_one_chain(model: RobotModel, joints: Iterable[str]) -> bool:
    """Whether one chain of elements has all the joints: MuJoCo ignores the armature of a tendon
    across branches.
    """
    wanted = set(joints)
    holders = {e.name: {dof.name for dof in e.dofs} for e in model.elements}
    for name in holders:
        found: set[str] = set()
        above = name
        while above in holders:
            found = found | holders[above]
            above = model.parents[above]
        if wanted <= found:
            return True
    return False
