"""Keys of an overlay with which a URDF file can be read: all at once, each with a note.

The URDF file is not changed. What no key of an overlay repairs is collected too, and reported in
one message.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar

import numpy as np

from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.spec.tables import show
from flexgen.model.urdf.overlay import BETA
from flexgen.model.urdf.urdf import Inertial, Joint, Link, Stated, Urdf, zero_tiny
from flexgen.model.urdf.urdf_chain import MOVING
from flexgen.model.urdf.urdf_loops import NEXT_TO, Closures, loops_of_chain, passive_of_chain
from flexgen.model.urdf.urdf_mimic import Motion, Motions
from flexgen.studies.templates.urdf_names import new_names

# kg, of a body whose file states an inertia without a mass: too little to be felt
MASS_OF_AN_INERTIA = 1e-12

AXIS_TOLERANCE = 1e-3  # of the length of an axis, which has few digits, to be named

_T = TypeVar("_T")


@dataclass
class Repairs:
    """The tables of an overlay that repair a URDF file.

    ``joints``, ``links``: tables by the names in the file. ``lock``: positions of joints that are
    fixed [rad or m].
    ``notes``: a line for each repair. ``problems``: what is not repaired. ``torques``: largest
    torques at the joints
    [N m or N], of limits that are otherwise left out.
    """

    base: str
    tip: str
    joints: dict[str, dict[str, Any]] = field(default_factory=dict)
    links: dict[str, dict[str, Any]] = field(default_factory=dict)
    lock: dict[str, float] = field(default_factory=dict)
    drop: list[str] = field(default_factory=list)
    branches: list[str] = field(default_factory=list)
    unfinished: list[str] = field(default_factory=list)
    torques: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    def joint(self, name: str, **keys: Any) -> None:
        """Add keys to the table of a joint."""
        self.joints.setdefault(name, {}).update(keys)

    def link(self, name: str, **keys: Any) -> None:
        """Add keys to the table of a link."""
        self.links.setdefault(name, {}).update(keys)


def find_repairs(urdf: Urdf, base: str, tip: str, closures: Closures | None = None) -> Repairs:
    """The repairs of the chain between two links of a URDF file, and of the branches that closed
    loops hold.

    Raises
    ------
    ArgumentError
        One message with all that cannot be repaired.
    """
    repairs = Repairs(base, tip)
    path = path_between(urdf, base, tip)
    if closures is not None:
        path = _close_loops(urdf, repairs, path, closures)
    _lock_branches(urdf, repairs, path)
    moving = _repair_motions(urdf, repairs, path)
    for joint in moving.values():
        _repair_axis(urdf, repairs, joint)
    for joint in (joint for joint in moving.values() if _has_limits(urdf, repairs, joint)):
        _repair_limits(urdf, repairs, joint)
        _repair_friction(urdf, repairs, joint)
    _repair_names(repairs, moving)
    for link in _links_behind(urdf, repairs, moving):
        _repair_body(urdf, repairs, link)
    if not moving and not repairs.problems:
        repairs.problems.append(
            f"link {show(tip)}: no moving joint between {show(base)} and it, expected "
            "FILE.urdf#BASE:TIP"
        )
    refuse_problems(urdf, repairs)
    return repairs


def refuse_problems(urdf: Urdf, repairs: Repairs) -> None:
    """Raise an error for all problems, if there are some."""
    if not repairs.problems:
        return
    listed = "\n".join(f"  {problem}" for problem in repairs.problems)
    count = f"{len(repairs.problems)} error" + "s" * (len(repairs.problems) > 1)
    raise ArgumentError(
        f"urdf: given {urdf.file} with {count} that no overlay repairs, expected a file "
        f"without:\n{listed}"
    )


def path_between(urdf: Urdf, base: str, tip: str) -> list[Joint]:
    """The joints from the base to the tip; ArgumentError where the tip is not behind the base."""
    out: list[Joint] = []
    link = tip
    while link != base:
        holder = urdf.parent_joint.get(link)
        if holder is None:
            raise ArgumentError(
                f"urdf: given the ends {show(base)} and {show(tip)}, expected a tip that is "
                f"behind the base in the tree of links (the root of {show(tip)} is {show(link)})"
            )
        out.append(holder)
        link = holder.parent
    return out[::-1]


# --- closed loops --------------------------------------------------------------------------------


def _close_loops(
    urdf: Urdf, repairs: Repairs, path: list[Joint], closures: Closures
) -> list[Joint]:
    """The path with the branches that closed loops hold; their joints without a motor are
    passive.
    """
    base = repairs.base
    loops = loops_of_chain(urdf, closures, base, [repairs.tip], ())
    passive = _try(partial(passive_of_chain, urdf, closures, loops, base, {}))
    if isinstance(passive, ModelError):
        repairs.problems.append(
            f"line {passive.line}, {passive.key}: given {passive.given}, expected <transmission> "
            f"or <ros2_control> for those with one, or a file {NEXT_TO} with its keys dependent "
            "and independent"
        )
        refuse_problems(urdf, repairs)
        return path
    for loop in loops:
        for link in loop.links:
            path = path + [j for j in path_between(urdf, base, link) if j not in path]
    for joint in (joint for joint in path if joint.name in passive):
        near = "near" if joint.type == "prismatic" else "near_rad"
        repairs.joint(joint.name, passive={near: 0.0})
        repairs.notes.append(
            f"joint {show(joint.name)}: passive, moved by the closed loops "
            f"{', '.join(loop.name for loop in loops)}: no motor, no limits and no friction"
        )
    return path


# --- joints --------------------------------------------------------------------------------------


def _lock_branches(urdf: Urdf, repairs: Repairs, path: list[Joint]) -> None:
    """Lock the joints of other branches at zero, and drop those that cannot be locked."""
    chain = {joint.name for joint in path}
    above = {joint.name for joint in path_between(urdf, _root(urdf, repairs.base), repairs.base)}
    for joint in urdf.joints.values():
        if joint.name in chain or joint.name in above or not joint.movable:
            continue
        if joint.type in MOVING:
            repairs.lock[joint.name] = 0.0
        else:
            repairs.drop.append(joint.name)
            repairs.notes.append(
                f"joint {show(joint.name)}: {joint.type}, left out with all links behind it"
            )
    # followers of locked joints are where these have them
    for name in list(repairs.lock):
        locked = {other: 0.0 for other in repairs.lock if other != name}
        motion = _try(partial(Motions(urdf, locked), urdf.joints[name]))
        if isinstance(motion, Motion) and motion.follows:
            _place_follower(repairs, urdf.joints[name], motion)
        elif isinstance(motion, Motion) and motion.fixed:
            del repairs.lock[name]
            if motion.offset != 0.0:
                repairs.notes.append(
                    f"joint {show(name)}: at {motion.offset:g}, where the joint that it follows "
                    "has it at zero"
                )


def _place_follower(repairs: Repairs, joint: Joint, motion: Motion) -> None:
    """Lock a follower on another branch where it is with the joint of the chain at zero."""
    repairs.lock[joint.name] = motion.offset
    names = ", ".join(map(show, motion.joints))
    repairs.notes.append(
        f"joint {show(joint.name)}: locked at {motion.offset:g} although it follows {names}; "
        f"[urdf] branches = [{show(joint.child)}] instead of the lock makes it move"
    )


def _root(urdf: Urdf, link: str) -> str:
    """The root of a link."""
    while link in urdf.parent_joint:
        link = urdf.parent_joint[link].parent
    return link


def _repair_motions(urdf: Urdf, repairs: Repairs, path: list[Joint]) -> dict[str, Joint]:
    """The joints of the chain that move; followers of joints outside of it are fixed."""
    moving: dict[str, Joint] = {}
    for joint in (joint for joint in path if joint.movable):
        if joint.type not in MOVING:
            repairs.problems.append(
                f"joint {show(joint.name)} (line {joint.node.line}): {joint.type}, between base "
                "and tip; expected a "
                f"base behind it, such as {show(joint.child)}"
            )
            continue
        motion = _try(partial(_motion, urdf, repairs, joint))
        if isinstance(motion, ModelError):
            repairs.joint(joint.name, gear={"type": "rigid"})
            repairs.notes.append(
                f"joint {show(joint.name)}: a coordinate of its own, since its <mimic> is wrong: "
                f"{motion.given}"
            )
            moving[joint.name] = joint
        elif not motion.fixed:
            moving[joint.name] = joint
    return _fix_loose_followers(urdf, repairs, path, moving)


def _fix_loose_followers(
    urdf: Urdf, repairs: Repairs, path: list[Joint], moving: dict[str, Joint]
) -> dict[str, Joint]:
    """Lock joints before the base that joints of the chain follow, and name the fixed ones."""
    for joint in list(moving.values()):
        motion = _motion(urdf, repairs, joint)
        for leader in (name for name in motion.joints if name not in moving):
            repairs.lock[leader] = 0.0
        if _motion(urdf, repairs, joint).fixed:
            del moving[joint.name]
    fixed = [
        joint
        for joint in path
        if joint.type in MOVING and joint.name not in moving and joint.name not in repairs.lock
    ]
    if fixed and not moving:  # a chain of followers only: their leaders are branches
        return _free_leaders(urdf, repairs, fixed)
    for joint in fixed:
        place = _motion(urdf, repairs, joint).offset
        mimic = urdf.mimic(joint)
        leader = "" if mimic is None else mimic.leader
        repairs.notes.append(
            f"joint {show(joint.name)}: fixed at {place:g}, since it follows {show(leader)}, "
            "which is locked; [urdf] branches with the link behind that one instead of the "
            "lock makes both move"
        )
    return moving


def _free_leaders(urdf: Urdf, repairs: Repairs, fixed: list[Joint]) -> dict[str, Joint]:
    """Make branches of the joints that the ``fixed`` joints of the chain follow; the joints that
    move then.
    """
    moving: dict[str, Joint] = {}
    for joint in fixed:
        leader = next(iter(Motions(urdf, {})(joint).joints), "")
        if leader not in urdf.joints:
            continue
        child = urdf.joints[leader].child
        repairs.lock.pop(leader, None)
        if child not in repairs.branches:
            repairs.branches.append(child)
            repairs.notes.append(
                f"link {show(child)}: a branch of the robot, since joint {show(joint.name)} "
                f"follows {show(leader)}"
            )
        for one in path_between(urdf, repairs.base, child):
            if one.type in MOVING and not _motion(urdf, repairs, one).fixed:
                moving[one.name] = one
        moving[joint.name] = joint
    # other joints that follow them stay where they are
    root = path_between(urdf, _root(urdf, repairs.base), repairs.base)
    known = {*moving, *repairs.lock, *(joint.name for joint in (*fixed, *root))}
    for joint in urdf.joints.values():
        if joint.type in MOVING and joint.name not in known:
            motion = _try(partial(Motions(urdf, repairs.lock), joint))
            if isinstance(motion, Motion) and motion.follows:
                _place_follower(repairs, joint, motion)
    return moving


def _motion(urdf: Urdf, repairs: Repairs, joint: Joint) -> Motion:
    """The motion of a joint with the locks so far; a joint with a gear of its own follows none."""
    if {"gear", "passive"} & repairs.joints.get(joint.name, {}).keys():
        return Motion(joint.node.line, joints={joint.name: 1.0}, own=True)
    return Motions(urdf, repairs.lock)(joint)


def _has_limits(urdf: Urdf, repairs: Repairs, joint: Joint) -> bool:
    """Whether limits and friction of a joint are read: not those that others move."""
    passive = "passive" in repairs.joints.get(joint.name, {})
    return not passive and not _motion(urdf, repairs, joint).follows


def _repair_axis(urdf: Urdf, repairs: Repairs, joint: Joint) -> None:
    """Name an axis that the reader normalizes, and an invalid axis or pose."""
    node = next((child for child in joint.node.children if child.tag == "axis"), None)
    length = _try(partial(urdf.axis_length, joint))
    if node is not None and isinstance(length, float) and abs(length - 1.0) > AXIS_TOLERANCE:
        text = show(node.attributes["xyz"])
        repairs.notes.append(f"joint {show(joint.name)}: axis {text} normalized to length 1")
    for read in (urdf.axis, urdf.origin):
        found = _try(partial(read, joint))
        if isinstance(found, ModelError):
            repairs.problems.append(_text(found))


def _repair_limits(urdf: Urdf, repairs: Repairs, joint: Joint) -> None:
    """Leave out limits that no joint has, and keep the others."""
    error = _try(partial(urdf.limit, joint))
    if not isinstance(error, ModelError):
        return
    node = next((child for child in joint.node.children if child.tag == "limit"), None)
    stated = {} if node is None else node.attributes
    names = ("lower", "upper", "effort", "velocity")
    good = urdf.usable_limits(joint)
    bad = [
        f"{name} {show(stated[name])}" if name in stated else f"{name} missing"
        for name in names
        if name not in good
    ]
    if joint.type == "continuous":
        bad = [text for text in bad if text.partition(" ")[0] in ("effort", "velocity")]
    unit = "" if joint.type == "prismatic" else "_rad"
    keys: dict[str, Any] = {"limits": False}
    keys |= {name + unit: good[name] for name in ("lower", "upper") if name in good}
    keys |= {"speed_max": good["velocity"]} if "velocity" in good else {}
    if "effort" in good:
        repairs.torques[joint.name] = good["effort"]
    repairs.joint(joint.name, **keys)
    repairs.notes.append(f"joint {show(joint.name)}: limits left out: {', '.join(bad)}")


def _repair_friction(urdf: Urdf, repairs: Repairs, joint: Joint) -> None:
    """Make Coulomb friction smooth, and leave out one that is negative or no number."""
    found = _try(partial(urdf.dynamics, joint))
    if isinstance(found, ModelError):
        repairs.joint(joint.name, friction={"viscous": 0.0})
        repairs.notes.append(
            f"joint {show(joint.name)}: no friction, since that of the file is {found.given}"
        )
        return
    _, viscous, coulomb = found
    if coulomb == 0.0:
        return
    repairs.joint(
        joint.name, friction={"viscous": viscous, "coulomb": coulomb, "beta": BETA[joint.type]}
    )
    repairs.notes.append(
        f"joint {show(joint.name)}: Coulomb friction {coulomb:g} made smooth, beta = "
        f"{BETA[joint.type]:g}"
    )


def _repair_names(repairs: Repairs, moving: dict[str, Joint]) -> None:
    """Give names that are not identifiers new ones."""
    joints = list(moving)
    links = list(dict.fromkeys([*(joint.child for joint in moving.values()), repairs.tip]))
    for kind, names, refused in (("joint", joints, ()), ("link", links, ("base",))):
        table = repairs.joint if kind == "joint" else repairs.link
        for name, new in new_names(names, kind, refused).items():
            table(name, rename=new)
            repairs.notes.append(f"{kind} {show(name)}: called {new} in the model")


# --- bodies --------------------------------------------------------------------------------------


def _links_behind(urdf: Urdf, repairs: Repairs, moving: dict[str, Joint]) -> list[Link]:
    """The links that move, in the order of the tree."""
    out: dict[str, Link] = {}
    todo = [joint.child for joint in reversed(moving.values())]
    while todo:
        name = todo.pop()
        if name in out:
            continue
        out[name] = urdf.links[name]
        todo += [
            joint.child for joint in urdf.child_joints[name] if joint.name not in repairs.drop
        ]
    return list(out.values())


def _repair_body(urdf: Urdf, repairs: Repairs, link: Link) -> None:
    """Replace the numbers of a body that no body has."""
    error = _try(partial(urdf.inertial, link))
    if not isinstance(error, ModelError):
        return
    if not isinstance(_try(partial(urdf.inertial, link, True)), ModelError):
        repairs.link(link.name, inertia_reduced=True)
        repairs.notes.append(
            f"link {show(link.name)}: inertia_reduced, since it has {error.given}, one larger "
            "than the others together"
        )
        return
    stated = _try(partial(urdf.stated_inertial, link))
    if isinstance(stated, ModelError) or stated is None or stated.mass < 0.0:
        repairs.unfinished.append(link.name)
        repairs.notes.append(f"link {show(link.name)}: no body: {_text(error)}")
        return
    body = _closest_body(stated)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = body.inertia.tolist()
    table: dict[str, Any] = {
        "mass": body.mass,
        "com": zero_tiny(body.com.tolist()),
        "inertia": zero_tiny([xx, yy, zz, xy, yz, xz]),
    }
    if body.reduced:
        table["inertia_reduced"] = True
    repairs.link(link.name, body=table)
    what = (
        f"mass {MASS_OF_AN_INERTIA:g} kg, since the file has {error.given}"
        if stated.mass == 0.0
        else f"the closest inertia that a body can have, since it has {error.given}"
    )
    repairs.notes.append(f"link {show(link.name)}: {what}")


def _closest_body(stated: Stated) -> Inertial:
    """The closest body: principal moments below zero are zero, a mass of zero is a small one."""
    moments, axes = np.linalg.eigh(stated.inertia)
    moments = np.maximum(moments, 0.0)
    turn = stated.axes @ axes
    tensor = turn @ np.diag(moments) @ turn.T
    reduced = bool(moments[0] + moments[1] < moments[2])
    mass = stated.mass or MASS_OF_AN_INERTIA
    return Inertial(mass, stated.com, (tensor + tensor.T) / 2.0, reduced)


def _try(read: Callable[[], _T]) -> _T | ModelError:
    """Result of a function, or the error that it raises."""
    try:
        return read()
    except ModelError as error:
        return error


def _text(error: ModelError) -> str:
    """An error without the name of the file."""
    return f"line {error.line}, {error.key}: given {error.given}, expected {error.expected}"
