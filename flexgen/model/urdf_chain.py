"""The serial chain between two links of a URDF file: moving joints, and the bodies that fixed joints lump together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from flexgen.errors import ModelError
from flexgen.model.checked_table import bare, show
from flexgen.model.urdf import Inertial, Joint, Link, Pose, Urdf, key, nowhere

MOVING = ("revolute", "continuous", "prismatic")

InertialOf = Callable[[Link], Inertial | None]


@dataclass(frozen=True)
class Segment:
    """A moving joint with what it carries.

    ``origin``: where the joint stands in the frame of the previous segment's link (in the base link for the first).
    ``body``: everything that is fixed to its child link, in the child's frame; None where that has no mass.
    """

    joint: Joint
    link: Link
    origin: Pose
    body: Inertial | None


@dataclass(frozen=True)
class Chain:
    """The segments from the base to the tip, and the pose of the tip in the last link."""

    segments: tuple[Segment, ...]
    tip: Pose


def follow(
    urdf: Urdf, base: str, tip: str, locked: Mapping[str, float], dropped: frozenset[str], inertial: InertialOf
) -> Chain:
    """The chain from ``base`` to ``tip``.

    Parameters
    ----------
    urdf : Urdf
    base, tip : str
        Names of links; the base is the ground, so that what else hangs on it does not matter.
    locked : mapping
        Joints that are fixed at a position [rad or m].
    dropped : set
        Joints beside the chain that are left out with all that hangs on them.
    inertial : callable
        The inertial of a link, or None.

    Raises
    ------
    ModelError
        There is no such chain, or something that moves hangs on it.
    """
    segments: list[Segment] = []
    joint, link, origin = None, urdf.links[base], nowhere()
    bodies: list[Inertial] = []
    here = nowhere()  # the link reached so far, in the frame of the last moving link or of the base
    path = _path(urdf, base, tip)
    on_path = {step.name for step in path}
    for step in path:
        if not step.movable or step.name in locked:
            here = here @ placed(urdf, step, locked)
        else:
            if joint is not None:
                segments.append(Segment(joint, link, origin, lumped(bodies)))
            joint, link = step, urdf.links[step.child]
            origin, here, bodies = here @ urdf.origin(step), nowhere(), []
            _check_type(urdf, step)
        if joint is not None:
            bodies += _fixed_to(urdf, step.child, here, on_path, locked, dropped, inertial)
    if joint is None:
        line = urdf.links[tip].node.line
        given = f"no moving joint between {show(base)} and {show(tip)}"
        urdf.fail(line, key("link", tip), given, "links with at least one in between")
    segments.append(Segment(joint, link, origin, lumped(bodies)))
    return Chain(tuple(segments), here)


def lumped(bodies: list[Inertial]) -> Inertial | None:
    """Bodies that are fixed to each other, as one.

    ``I = sum(I_k + m_k (|d_k|^2 1 - d_k d_k'))`` with d_k from the common centre to that of body k.
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


def placed(urdf: Urdf, joint: Joint, locked: Mapping[str, float]) -> Pose:
    """The child link in the parent link, for a joint that is fixed or locked."""
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
    """The joints from the base to the tip."""
    out: list[Joint] = []
    link = tip
    while link != base:
        holder = urdf.holder.get(link)
        if holder is None:
            given = f"{show(tip)}, which does not hang on {show(base)} but on {show(link)}"
            urdf.fail(urdf.links[tip].node.line, key("link", tip), given, "a tip behind the base")
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
        given = "a joint of the chain that follows another one"
        urdf.fail(line, f"{key('joint', joint.name)}.mimic", given, f"joints that move by themselves {lock}")


def _fixed_to(
    urdf: Urdf,
    name: str,
    pose: Pose,
    on_path: set[str],
    locked: Mapping[str, float],
    dropped: frozenset[str],
    inertial: InertialOf,
) -> list[Inertial]:
    """The bodies of a link at a pose and of all that is fixed to it beside the chain."""
    out: list[Inertial] = []
    todo = [(name, pose)]
    while todo:
        name, pose = todo.pop()
        body = inertial(urdf.links[name])
        if body is not None:
            out.append(body.seen_from(pose))
        for joint in urdf.held[name]:
            if joint.name in on_path or joint.name in dropped:
                continue
            if joint.movable and joint.name not in locked:
                raise _loose(urdf, joint)
            todo.append((joint.child, pose @ placed(urdf, joint, locked)))
    return out


def _loose(urdf: Urdf, joint: Joint) -> ModelError:
    """The error for a joint beside the chain that moves."""
    given = f"a {joint.type} joint beside the chain"
    expected = f"in the overlay [urdf] drop = [{show(joint.name)}] (left out with all that hangs on it)"
    if joint.type in MOVING:
        expected += f" or lock = {{ {bare(joint.name)} = 0.0 }} (fixed there, its masses count)"
    return ModelError(urdf.file, joint.node.line, key("joint", joint.name), given, expected)
