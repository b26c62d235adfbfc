"""The robots of the comparison, and a model as the text file that Pinocchio's side reads."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

import flexgen
from flexgen.model.elements import Body, Dof, Element, Gear, Motor, Output, Placement, RobotModel

FOLDER = Path(__file__).resolve().parent.parent / "tests" / "support" / "robots"

Pose = tuple[np.ndarray, np.ndarray]


def chain(n: int, seed: int = 1) -> RobotModel:
    """A chain of n revolute joints with random placements and inertias: no zero anywhere that
    could save work.
    """
    rng = np.random.default_rng([seed, n])
    elements = []
    motors = []
    for k in range(n):
        spread = rng.normal(size=(3, 3)) * 0.1
        second = spread @ spread.T  # of the mass about its centre
        body = Body(
            mass=float(rng.uniform(1.0, 5.0)),
            com=_vector(rng.uniform(-0.2, 0.2, 3)),
            inertia=_matrix(np.trace(second) * np.eye(3) - second),
        )
        origin = Placement(_vector(rng.uniform(-0.4, 0.4, 3)), _matrix(_random_rotation(rng)))
        dof = Dof(f"q{k + 1}", "rotation", (0.0, 0.0, 1.0), gear=Gear(rigid=True))
        elements.append(Element(f"link{k + 1}", (dof,), origin, body=body))
        motors.append(Motor(f"m{k + 1}", 0.0, (dof.name,), (1.0,)))
    return RobotModel(
        name=f"chain{n}",
        description="dense random chain",
        source="random numbers",
        gravity=(0.0, 0.0, -9.81),
        base=Placement(),
        elements=tuple(elements),
        motors=tuple(motors),
        tool=Placement(),
        payload=Body(),
        output=Output("tool_position"),
        home=(0.0,) * n,
        moves=(),
        text=f"chain {n} {seed}",
    )


ROBOTS: dict[str, Callable[[], RobotModel]] = {
    **{
        name: lambda name=name: flexgen.read(FOLDER / f"{name}.toml")
        for name in ("ur5", "panda", "ur5_elastic")
    },
    **{f"chain{n}": lambda n=n: chain(n) for n in (12, 18, 30)},
}


def write_mujoco(model: RobotModel, path: Path) -> None:
    """Write a model as a binary file of MuJoCo, by the converter of the tests."""
    import mujoco

    sys.path.insert(0, str(FOLDER.parent))
    from mujoco_referee import MujocoReferee

    referee = MujocoReferee(model, rotors=False)
    assert list(referee.at_q) == list(referee.at_v) == list(range(model.n_a))
    mujoco.mj_saveModel(referee.m, str(path), None)


def pinocchio_text(model: RobotModel) -> str:
    """Write a model in the format that peers_pinocchio.cpp reads: gravity, number of joints, one
    line per joint.

    A line has kind, position and rotation (rows) of the joint in the previous one, then mass,
    center of mass and inertia (rows) of the body fixed to it. An axis along x, y or z becomes
    Pinocchio's joint for that axis, as in its URDF reader. Any other axis is rotated to z by the
    placements around it, so that the slower joint with a free axis is not used.
    """
    lines: list[tuple[str, Pose]] = []
    bodies: list[list[tuple[Pose, Body]]] = []
    pose = _pose(model.base)
    for element in model.elements:
        if element.beam is not None:
            raise ValueError(
                f"{model.name}: given a beam, expected rigid bodies: Pinocchio has no beams"
            )
        pose = _then(pose, _pose(element.origin))
        for dof in element.dofs:
            letter, turn = _axis(np.array(dof.axis))
            lines.append(
                (
                    ("R" if dof.type == "rotation" else "P") + letter,
                    _then(pose, (np.zeros(3), turn)),
                )
            )
            bodies.append([])
            pose = (np.zeros(3), turn.T)
        pose = _then(pose, _pose(element.link))
        if bodies:
            bodies[-1].append((pose, element.body))
    bodies[-1].append((_then(pose, _pose(model.tool)), model.payload))
    texts = [" ".join(map(repr, map(float, model.gravity))), str(len(lines))]
    for (kind, (position, rotation)), riding in zip(lines, bodies, strict=True):
        mass, com, inertia = _lumped(riding)
        numbers = [*position, *rotation.ravel(), mass, *com, *inertia.ravel()]
        texts.append(" ".join([kind, *(repr(float(x)) for x in numbers)]))
    return "\n".join(texts) + "\n"


def _axis(axis: np.ndarray) -> tuple[str, np.ndarray]:
    """The letter of the joint, and the rotation R with ``R e = axis`` for that letter's unit
    vector e.
    """
    for letter, unit in zip("XYZ", np.eye(3), strict=True):
        if np.array_equal(axis, unit):
            return letter, np.eye(3)
    x = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    x /= np.linalg.norm(x)
    return "Z", np.column_stack([x, np.cross(axis, x), axis])


def _lumped(riding: list[tuple[Pose, Body]]) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, center of mass and inertia about it of rigidly joined bodies."""
    mass = sum(body.mass for _, body in riding)
    if mass == 0.0:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    centres = [p + R @ np.array(body.com) for (p, R), body in riding]
    com = sum(body.mass * centre for (_, body), centre in zip(riding, centres, strict=True)) / mass
    inertia = np.zeros((3, 3))
    for ((_, R), body), centre in zip(riding, centres, strict=True):
        d = centre - com
        inertia += R @ np.array(body.inertia) @ R.T + body.mass * (
            d @ d * np.eye(3) - np.outer(d, d)
        )
    return mass, com, inertia


def _pose(placement: Placement) -> Pose:
    return np.array(placement.position), np.array(placement.rotation)


def _then(first: Pose, second: Pose) -> Pose:
    return first[0] + first[1] @ second[0], first[1] @ second[1]


def _vector(x: np.ndarray) -> tuple[float, ...]:
    return tuple(float(value) for value in x)


def _matrix(x: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(_vector(row) for row in x)


def _random_rotation(rng: np.random.Generator) -> np.ndarray:
    quaternion = rng.normal(size=4)
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
