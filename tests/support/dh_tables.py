"""Drawn tables of Denavit-Hartenberg parameters, and their kinematics by textbook matrices."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

NAMES = ("xx", "yy", "zz", "xy", "yz", "xz")
UNITS = {
    "length": {"mm": 1e-3, "m": 1.0, "cm": 1e-2},
    "angle": {"deg": math.pi / 180.0, "rad": 1.0},
    "inertia": {"kg m^2": 1.0, "kg cm^2": 1e-4},
    "mass": {"kg": 1.0, "g": 1e-3},
}


@dataclass(frozen=True)
class Joint:
    """A row in SI units."""

    kind: str
    a: float
    alpha: float
    d: float
    theta: float
    direction: float
    mass: float
    com: np.ndarray
    inertia: np.ndarray


def draw(seed: int, count: int, translations: bool = True) -> list[Joint]:
    """Joints with all parameters, and bodies that exist."""
    rng = np.random.default_rng(seed)
    joints = []
    for k in range(count):
        kind = "translation" if translations and k and rng.random() < 0.25 else "rotation"
        points = rng.normal(size=(8, 3)) * 0.2
        mass = float(rng.uniform(1.0, 30.0))
        centered = points - points.mean(axis=0)
        inertia = mass / 8.0 * sum(p @ p * np.eye(3) - np.outer(p, p) for p in centered)
        joints.append(
            Joint(
                kind,
                *(float(x) for x in rng.uniform(-0.6, 0.6, 1)),
                float(rng.choice([0.0, math.pi / 2, -math.pi / 2, rng.uniform(-2.0, 2.0)])),
                float(rng.uniform(-0.5, 0.5)),
                float(rng.choice([0.0, math.pi / 2, rng.uniform(-3.0, 3.0)])),
                float(rng.choice([1.0, -1.0])),
                mass,
                rng.uniform(-0.3, 0.3, 3),
                inertia,
            )
        )
    return joints


def write(path, joints: list[Joint], rng: np.random.Generator) -> None:
    """The joints as a table with drawn units."""
    chosen = {name: str(rng.choice(list(units))) for name, units in UNITS.items()}

    def number(value: float, kind: str) -> str:
        return repr(value / UNITS[kind][chosen[kind]])

    length = chosen["length"]
    angle = chosen["angle"]
    header = ["joint", "type", f"a [{length}]", f"alpha [{angle}]", f"d [{length}]"]
    header += [f"theta [{angle}]", "direction", f"mass [{chosen['mass']}]"]
    header += [f"com_{axis} [{length}]" for axis in "xyz"]
    header += [f"i{name} [{chosen['inertia']}]" for name in NAMES]
    lines = [",".join(header)]
    for k, joint in enumerate(joints):
        tensor = joint.inertia
        entries = (*np.diag(tensor), tensor[0, 1], tensor[1, 2], tensor[0, 2])
        row = [f"j{k}", joint.kind, number(joint.a, "length"), number(joint.alpha, "angle")]
        row += [number(joint.d, "length"), number(joint.theta, "angle"), f"{joint.direction:g}"]
        row += [number(joint.mass, "mass")]
        row += [number(float(x), "length") for x in joint.com]
        row += [number(float(x), "inertia") for x in entries]
        lines.append(",".join(row))
    path.write_text("\n".join(lines))


def step(joint: Joint, convention: str, q: float) -> np.ndarray:
    """The matrix (4, 4) of a joint, by Siciliano (standard) and Craig (modified)."""
    rotary = joint.kind == "rotation"
    theta = joint.theta + (joint.direction * q if rotary else 0.0)
    d = joint.d + (0.0 if rotary else joint.direction * q)
    ct = math.cos(theta)
    st = math.sin(theta)
    ca = math.cos(joint.alpha)
    sa = math.sin(joint.alpha)
    if convention == "standard":
        rows = [
            [ct, -st * ca, st * sa, joint.a * ct],
            [st, ct * ca, -ct * sa, joint.a * st],
            [0.0, sa, ca, d],
        ]
    else:
        rows = [
            [ct, -st, 0.0, joint.a],
            [st * ca, ct * ca, -sa, -sa * d],
            [st * sa, ct * sa, ca, ca * d],
        ]
    return np.array([*rows, [0.0, 0.0, 0.0, 1.0]])


def frames(joints: list[Joint], convention: str, q: np.ndarray) -> list[np.ndarray]:
    """The frames 1 to n in the world."""
    out = [np.eye(4)]
    for joint, value in zip(joints, q, strict=True):
        out.append(out[-1] @ step(joint, convention, float(value)))
    return out[1:]


def axes(
    joints: list[Joint], convention: str, q: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Direction and a point of each axis: z of frame i-1 (standard) or i (modified)."""
    after = frames(joints, convention, q)
    at = [np.eye(4), *after[:-1]] if convention == "standard" else after
    return [(joint.direction * T[:3, 2], T[:3, 3]) for joint, T in zip(joints, at, strict=True)]


def mass_matrix(joints: list[Joint], convention: str, q: np.ndarray) -> np.ndarray:
    """Inertia matrix (n, n): sums over bodies with Jacobians of their centers."""
    n = len(joints)
    M = np.zeros((n, n))
    lines = axes(joints, convention, q)
    for k, (joint, T) in enumerate(zip(joints, frames(joints, convention, q), strict=True)):
        center = T[:3, :3] @ joint.com + T[:3, 3]
        tensor = T[:3, :3] @ joint.inertia @ T[:3, :3].T
        J_v = np.zeros((3, n))
        J_w = np.zeros((3, n))
        for i in range(k + 1):
            axis, point = lines[i]
            rotary = joints[i].kind == "rotation"
            J_v[:, i] = np.cross(axis, center - point) if rotary else axis
            J_w[:, i] = axis if rotary else 0.0
        M += joint.mass * J_v.T @ J_v + J_w.T @ tensor @ J_w
    return M


def pinocchio_model(joints: list[Joint], convention: str):
    """The arm as a chain of joints of Pinocchio about, or along, z."""
    import pinocchio as pin

    model = pin.Model()
    parent = 0
    before = pin.SE3.Identity()
    for k, joint in enumerate(joints):
        turn = pin.SE3(pin.utils.rotate("z", joint.theta), np.zeros(3))
        up = pin.SE3(np.eye(3), np.array([0.0, 0.0, joint.d]))
        out = pin.SE3(np.eye(3), np.array([joint.a, 0.0, 0.0]))
        tilt = pin.SE3(pin.utils.rotate("x", joint.alpha), np.zeros(3))
        constant = (tilt * out, turn * up) if convention == "modified" else None
        first, last = constant or (pin.SE3.Identity(), turn * up * out * tilt)
        axis = np.array([0.0, 0.0, joint.direction])
        rotary = joint.kind == "rotation"
        kind = pin.JointModelRevoluteUnaligned if rotary else pin.JointModelPrismaticUnaligned
        parent = model.addJoint(parent, kind(axis), before * first, f"j{k}")
        body = pin.Inertia(joint.mass, joint.com, joint.inertia)
        model.appendBodyToJoint(parent, body, last)
        before = last
    model.addFrame(pin.Frame("flange", parent, 0, before, pin.FrameType.OP_FRAME))
    return model
