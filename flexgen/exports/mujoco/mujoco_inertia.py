"""Inertias that MuJoCo accepts, with the same dynamics.

MuJoCo takes the inertia tensor of a real distribution of mass only: no principal moment exceeds
the sum of the other two. Tensors of regrouped parameters, and rotors of which only the axial
inertia is known, are none. A revolute joint turns both its bodies alike about every direction
across its axis a: with any number c,

    I_child + c (1 - a a'),    I_parent - c (1 - a a')

have the same kinetic energy (regrouping of W. Khalil and E. Dombre, Modeling, Identification and
Control of Robots, 2002, ch. 9). A joint that does not rotate leaves ``I_child + c 1``,
``I_parent - c 1`` free. What reaches the base has no effect.
"""

from __future__ import annotations

import numpy as np

from flexgen.base.errors import ModelError
from flexgen.model.elements import RobotModel

ROUNDING = 1e-14  # of the largest moment: what a sum of tensors can miss by rounding
PARALLEL = 1e-12  # sine of the angle between axes that are parallel


def missing(inertia: np.ndarray) -> float:
    """By how much the largest principal moment exceeds the sum of the others, or a moment is
    negative; <= 0: valid.
    """
    low, middle, high = np.linalg.eigvalsh(inertia)
    return float(max(high - low - middle, -low))


def free_directions(axes: list[np.ndarray]) -> np.ndarray | None:
    """The tensor that can be moved across the joints of a body, ``1 - a a'`` or 1; None if there
    is none.
    """
    if not axes:
        return np.eye(3)
    first = axes[0]
    if any(np.linalg.norm(np.cross(first, axis)) > PARALLEL for axis in axes):
        return None
    return np.eye(3) - np.outer(first, first)


def regroup(
    model: RobotModel, inertias: list[np.ndarray], turns: list[np.ndarray]
) -> list[np.ndarray]:
    """Tensors with the same dynamics that satisfy MuJoCo's condition.

    Parameters
    ----------
    model : RobotModel
    inertias : list of arrays (3, 3) [kg m^2]
        Of the bodies of the elements about their centers of mass, in the axes of their MuJoCo
        bodies.
    turns : list of arrays (3, 3)
        Rotation from the MuJoCo body of each element to that of its parent, with the joints at
        zero.

    Raises
    ------
    ModelError
        There are none.
    """
    out = [np.array(inertia) for inertia in inertias]
    names = list(model.parents)
    for k in reversed(range(len(out))):
        scale = float(np.abs(out[k]).max())
        if missing(out[k]) <= 0.0:
            continue
        if missing(out[k]) <= ROUNDING * scale:
            out[k] = out[k] + 2 * ROUNDING * scale * np.eye(3)
            continue
        axes = [np.array(dof.axis) for dof in model.elements[k].dofs if dof.type == "rotation"]
        free = free_directions(axes)
        amount = None if free is None else find_least(out[k], free)
        if free is None or amount is None:
            moments = ", ".join(f"{x:.6g}" for x in np.linalg.eigvalsh(out[k]))
            raise ModelError(
                model.file,
                0,
                f"element.{names[k]}.body.inertia",
                f"principal moments {moments} (with the share of the rotors and of the bodies "
                "behind)",
                "for MuJoCo no principal moment larger than the sum of the other two: the full "
                "inertia tensor",
            )
        out[k] = out[k] + amount * free
        if (parent := model.parents[names[k]]) != "base":
            out[names.index(parent)] -= amount * turns[k] @ free @ turns[k].T
    return out


def find_least(inertia: np.ndarray, free: np.ndarray) -> float | None:
    """The least c with a valid tensor ``inertia + c free``, a little enlarged; None if there is
    none.
    """
    scale = float(np.abs(inertia).max())
    high = scale
    while missing(inertia + high * free) > 0.0:
        high *= 2
        if high > 1e3 * scale:
            return None
    low = 0.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if missing(inertia + middle * free) <= 0.0 else (middle, high)
    return high + 4 * ROUNDING * scale


def principal(inertia: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Principal moments (3,) and axes (columns of a rotation matrix).

    MuJoCo takes principal axes that are tilted by less than about 1e-6 rad for those of the body
    and drops the tilt. Such axes are returned in another order: a permutation is far from the
    identity.
    """
    if not np.any(inertia - np.diag(np.diag(inertia))):
        return np.diag(inertia).copy(), np.eye(3)
    moments, axes = np.linalg.eigh(inertia)
    axes = axes * np.linalg.det(axes)
    if np.abs(axes - np.eye(3)).max() < 0.1:
        moments = moments[[1, 2, 0]]
        axes = axes[:, [1, 2, 0]]
    return moments, axes
