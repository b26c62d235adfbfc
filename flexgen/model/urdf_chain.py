"""Serial chain between two links of a URDF file: its moving joints and the bodies that they move."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from flexgen.errors import ModelError
from flexgen.model.urdf import Inertial, Joint, Link, Pose, Urdf, identity_pose, key
from flexgen.spec.tables import bare, show

MOVING = ("revolute", "continuous", "prismatic")

InertialOf = Callable[[Link], Inertial | None]


@dataclass(frozen=True)
class Segment:
    """A moving joint and the body that it moves.

    ``origin``: pose of the joint in the link of the previous segment (in the base link for the first one). ``body``:
    all links fixed to the child link, lumped, in the frame of the child; None if their mass is 0.
    """

    joint: Joint
    link: Link
    origin: Pose
    body: Inertial | None


@dataclass(frozen=True)
class Chain:
    """Segments from the base to the tip, and the pose of the tip in the last link."""

    segments: tuple[Segment, ...]
    tip: Pose


def find_chain(
    urdf: Urdf, base: str, tip: str, locked: Mapping[str, float], dropped: frozenset[str], inertial: InertialOf
) -> Chain:
    """Find the chain from ``base`` to ``tip``.

    Parameters
    ----------
    urdf : Urdf
    base, tip : str
        Names of links; the base is the ground, and other branches at the base are ignored.
    locked : mapping
        Positions of joints that are fixed [rad or m].
    dropped : set
        Joints outside the chain that are left out with all links behind them.
    inertial : callable
        Returns the inertial of a link, or None.

    Raises
    ------
    ModelError
        There is no such chain, or a joint outside the chain can move.
    """
    segments: list[Segment] = []
    joint, link, origin = None, urdf.links[base], identity_pose()
    bodies: list[Inertial] = []
    here = identity_pose()  # the current link, in the frame of the last moving link or of the base
    path = _path(urdf, base, tip)
    on_path = {step.name for step in path}
    for step in path:
        if not step.movable or step.name in locked:
            here = here @ fixed_pose(urdf, step, locked)
        else:
            if joint is not None:
                segments.append(Segment(joint, link, origin, lump_bodies(bodies)))
            joint, link = step, urdf.links[step.child]
            origin, here, bodies = here @ urdf.origin(step), identity_pose(), []
            _check_type(urdf, step)
        if joint is not None:
            bodies += _collect_fixed(urdf, step.child, here, on_path, locked, dropped, inertial)
    if joint is None:
        line = urdf.links[tip].node.line
        given = f"no moving joint between {show(base)} and {show(tip)}"
        urdf.fail(line, key("link", tip), given, "a chain with at least one moving joint")
    segments.append(Segment(joint, link, origin, lump_bodies(bodies)))
    return Chain(tuple(segments), here)


def lump_bodies(bodies: list[Inertial]) -> Inertial | None:
    """Lump bodies that are fixed to each other into one.

    ``I = sum(I_k + m_k (|d_k|^2 1 - d_k d_k'))`` with d_k from the common center of mass to that of body k.
    """
    if len(bodies) < 2:
        return bodies[0] if bodies else None
    mass = sum(body.mass for body in bodies)
    com = sum((body.mass / mass * body.com for body in bodies), np.zeros(3))
    inertia = np.zeros((3, 3))
    for body in bodies:
        d = body.com - com
        inertia += body.inertia + body.mass * (d @ d * np.eye(3) - np.outer(d, d))
    return Inertial(mass, com, inertia, any(body.reduced for body in bodies))


def fixed_pose(urdf: Urdf, joint: Joint, locked: Mapping[str, float]) -> Pose:
    """Pose of the child link in the parent link, for a joint that is fixed or locked."""
    pose, value = urdf.origin(joint), locked.get(joint.name, 0.0)
    if value == 0.0:
        return pose
    axis = np.array(urdf.axis(joint))
    if joint.type == "prismatic":
        return pose @ Pose(np.eye(3), value * axis)
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + np.sin(value) * cross + (1.0 - np.cos(value)) * cross @ cross
    return pose @ Pose(turn, np.zeros(3))


def _path(urdf: Urdf, base: str, tip: str) -> list[Joint]:
    """Joints from the base to the tip."""
    out: list[Joint] = []
    link = tip
    while link != base:
        holder = urdf.parent_joint.get(link)
        if holder is None:
            given = f"{show(tip)}, which is not behind {show(base)} (its root is {show(link)})"
            urdf.fail(
                urdf.links[tip].node.line, key("link", tip), given, "a tip that is behind the base in the tree of links"
            )
        out.append(holder)
        link = holder.parent
    return out[::-1]


def _check_type(urdf: Urdf, joint: Joint) -> None:
    lock = f"(or in the overlay: [urdf] lock = {{ {bare(joint.name)} = 0.0 }})"
    if joint.type not in MOVING:
        expected = "revolute, continuous, prismatic or fixed"
        urdf.fail(joint.node.line, f"{key('joint', joint.name)}.type", show(joint.type), expected)
    line = urdf.mimics(joint)
    if line is not None:
        given = "a joint of the chain that mimics another one"
        urdf.fail(line, f"{key('joint', joint.name)}.mimic", given, f"independent joints {lock}")


def _collect_fixed(
    urdf: Urdf,
    name: str,
    pose: Pose,
    on_path: set[str],
    locked: Mapping[str, float],
    dropped: frozenset[str],
    inertial: InertialOf,
) -> list[Inertial]:
    """Bodies of a link with this pose and of all links outside the chain that are fixed to it."""
    out: list[Inertial] = []
    todo = [(name, pose)]
    while todo:
        name, pose = todo.pop()
        body = inertial(urdf.links[name])
        if body is not None:
            out.append(body.express_in_parent(pose))
        for joint in urdf.child_joints[name]:
            if joint.name in on_path or joint.name in dropped:
                continue
            if joint.movable and joint.name not in locked:
                raise _loose(urdf, joint)
            todo.append((joint.child, pose @ fixed_pose(urdf, joint, locked)))
    return out


def _loose(urdf: Urdf, joint: Joint) -> ModelError:
    """The error for a joint outside the chain that can move."""
    given = f"a {joint.type} joint outside the chain"
    expected = f"in the overlay [urdf] drop = [{show(joint.name)}] (omits the joint and all links behind it)"
    if joint.type in MOVING:
        expected += f" or lock = {{ {bare(joint.name)} = 0.0 }} (fixes it at this position, its links are kept)"
    return ModelError(urdf.file, joint.node.line, key("joint", joint.name), given, expected)
