"""The part of a URDF file between its base, its tip and the ends of other branches: moving joints
and their bodies.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexgen.base.errors import ModelError
from flexgen.base.spec.tables import bare, show
from flexgen.model.urdf.urdf import Inertial, Joint, Link, Pose, Urdf, identity_pose, key
from flexgen.model.urdf.urdf_mimic import Motion, check_leaders

MOVING = ("revolute", "continuous", "prismatic")

InertialOf = Callable[[Link], Inertial | None]
MotionOf = Callable[[Joint], Motion]


@dataclass(frozen=True)
class Segment:
    """A moving joint and the body that it moves.

    Or a fixed joint at which the overlay has degrees of freedom: ``motion.fixed``.
    ``motion``: of the joint. ``origin``: pose of the joint, at the offset of its motion, in the
    link of the segment ``parent`` (in the base link for -1). ``body``: all links fixed to the
    child link, lumped, in the frame of the child; None if their mass is 0.
    """

    joint: Joint
    motion: Motion
    link: Link
    origin: Pose
    parent: int
    body: Inertial | None = None


@dataclass(frozen=True)
class Chain:
    """Segments in the order of the file, parents and joints that others follow first.

    ``tip``: pose of the tip in the link of segment ``carrier``. ``places``: segment of each link
    of the chain, and the pose of the link in that of the segment; -1 for the base.
    """

    segments: tuple[Segment, ...]
    tip: Pose
    carrier: int
    places: Mapping[str, tuple[int, Pose]]

    @property
    def moving(self) -> tuple[Segment, ...]:
        """The segments whose joints move in the URDF file, also as others do."""
        return tuple(one for one in self.segments if not one.motion.fixed)


def find_chain(
    urdf: Urdf,
    base: str,
    tips: Sequence[str],
    motion_of: MotionOf,
    dropped: frozenset[str],
    inertial: InertialOf,
    hinged: frozenset[str] = frozenset(),
    held: Sequence[str] = (),
) -> Chain:
    """Find the chain from ``base`` to the first of the ``tips``, and the branches to the others.

    Parameters
    ----------
    urdf : Urdf
    base : str
        Name of the link that is the ground; other branches there are ignored.
    tips : sequence of str
        Names of links.
    motion_of : callable
        Returns the motion of a joint: fixed joints are not part of the chain.
    dropped : set
        Joints outside the chain that are left out with all links behind them.
    inertial : callable
        Returns the inertial of a link, or None.
    hinged : set
        Fixed joints at which the overlay has degrees of freedom: they divide the body.
    held : sequence of str
        Links that closed loops hold: the branches to them are part of the chain.

    Raises
    ------
    ModelError
        There is no such chain, or a joint outside of it can move.
    """
    segments: list[Segment] = []
    bodies: list[list[Inertial]] = []
    on_path = {step.name: step for tip in (*tips, *held) for step in path_to(urdf, base, tip)}
    # the segment of each link, and the pose of the link in its frame
    found: dict[str, tuple[int, Pose]] = {base: (-1, identity_pose())}
    left = {name: joint for name, joint in urdf.joints.items() if name in on_path}
    while left:
        step = _next(left, found, motion_of)
        del left[step.name]
        last, here = found[step.parent]
        motion = motion_of(step)
        pose = here @ joint_pose(urdf, step, 0.0 if motion.own else motion.offset)
        if motion.fixed and step.name not in hinged:
            here = pose
        else:
            if not motion.fixed:
                _check_type(urdf, step)
                check_leaders(urdf, step, motion, on_path)
            segments.append(Segment(step, motion, urdf.links[step.child], pose, last))
            bodies.append([])
            last = len(segments) - 1
            here = identity_pose()
        if last >= 0:
            bodies[last] += _collect_fixed(
                urdf, step.child, here, on_path, motion_of, dropped, inertial
            )
        found[step.child] = last, here
    for tip in tips:
        if found[tip][0] < 0:
            line = urdf.links[tip].node.line
            given = f"no moving joint between {show(base)} and {show(tip)}"
            urdf.fail(line, key("link", tip), given, "a chain with at least one moving joint")
    carrier, pose = found[tips[0]]
    whole = (
        replace(one, body=lump_bodies(own)) for one, own in zip(segments, bodies, strict=True)
    )
    return Chain(tuple(whole), pose, carrier, found)


def _next(left: Mapping[str, Joint], found: Collection[str], motion_of: MotionOf) -> Joint:
    """The next joint whose parent link is found; if possible one that follows none that is
    left.
    """
    ready = [joint for joint in left.values() if joint.parent in found]
    for joint in ready:
        if not any(name in left for name in motion_of(joint).joints if name != joint.name):
            return joint
    return ready[0]  # it follows a joint behind it


def lump_bodies(bodies: list[Inertial]) -> Inertial | None:
    """Lump bodies that are fixed to each other into one.

    ``I = sum(I_k + m_k (|d_k|^2 1 - d_k d_k'))`` with d_k from the common center of mass to that
    of body k.
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


def joint_pose(urdf: Urdf, joint: Joint, value: float) -> Pose:
    """Pose of the child link in the parent link at a position of the joint [rad or m]."""
    pose = urdf.origin(joint)
    if value == 0.0:
        return pose
    axis = np.array(urdf.axis(joint))
    if joint.type == "prismatic":
        return pose @ Pose(np.eye(3), value * axis)
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + np.sin(value) * cross + (1.0 - np.cos(value)) * cross @ cross
    return pose @ Pose(turn, np.zeros(3))


def path_to(urdf: Urdf, base: str, tip: str) -> list[Joint]:
    """Joints from the link ``base`` to the link ``tip``; an error where the base is not above the
    tip.
    """
    out: list[Joint] = []
    link = tip
    while link != base:
        holder = urdf.parent_joint.get(link)
        if holder is None:
            given = f"{show(tip)}, which is not behind {show(base)} (its root is {show(link)})"
            urdf.fail(
                urdf.links[tip].node.line,
                key("link", tip),
                given,
                "a tip that is behind the base in the tree of links",
            )
        out.append(holder)
        link = holder.parent
    return out[::-1]


def _check_type(urdf: Urdf, joint: Joint) -> None:
    if joint.type not in MOVING:
        expected = "revolute, continuous, prismatic or fixed"
        urdf.fail(joint.node.line, f"{key('joint', joint.name)}.type", show(joint.type), expected)


def _collect_fixed(
    urdf: Urdf,
    name: str,
    pose: Pose,
    on_path: Collection[str],
    motion_of: MotionOf,
    dropped: frozenset[str],
    inertial: InertialOf,
) -> list[Inertial]:
    """Bodies of the link ``name`` with this pose and of all links outside the chain that are fixed
    to it, in the frame of the pose.

    ``on_path``: joints of the chain; ``dropped``: joints that are left out; a joint that moves is
    refused.
    """
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
            motion = motion_of(joint)
            if not motion.fixed:
                raise _loose(urdf, joint)
            todo.append((joint.child, pose @ joint_pose(urdf, joint, motion.offset)))
    return out


def _loose(urdf: Urdf, joint: Joint) -> ModelError:
    """The error for a joint outside the chain that can move."""
    given = f"a {joint.type} joint outside the chain"
    expected = (
        f"in the overlay [urdf] drop = [{show(joint.name)}] (omits the joint and all links "
        "behind it)"
    )
    if joint.type in MOVING:
        expected += f", branches = [{show(joint.child)}] (makes it a branch of the robot)"
        expected += (
            f" or lock = {{ {bare(joint.name)} = 0.0 }} (fixes it at this position, its links "
            "are kept)"
        )
    return ModelError(urdf.file, joint.node.line, key("joint", joint.name), given, expected)
