"""Closed loops of a URDF robot: of elements <constraint>, and of a YAML file next to the file,
and the joints without a motor that they move.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexgen.base.errors import ModelError
from flexgen.base.spec.tables import SMALLEST, Table, bare, file_bytes, show
from flexgen.base.spec.toml_lines import Entry, TextError
from flexgen.model.urdf.urdf import (
    CONSTRAINTS,
    WITHOUT_LOOPS,
    Joint,
    Pose,
    Urdf,
    among,
    frame_of_axis,
    identity_pose,
    key,
)
from flexgen.model.urdf.urdf_chain import MOVING, joint_pose
from flexgen.model.urdf.yaml_text import parse

# Name of the file in which exporters of CAD programs write where they have cut a loop.
NEXT_TO = "loop_closures.yaml"
HINGE = "axis"  # key of that file: direction of a hinge
SIZE_MAX = 1_000_000  # bytes
# Types of the closures of an extended URDF: a point in 3 dimensions, a pose in 6.
_DIMENSIONS = {"3d": "point", "6d": "pose"}


@dataclass(frozen=True)
class Closure:
    """A closed loop: two frames coincide.

    ``type``: as of a table ``[[loop]]``; ``poses``: of the two frames in their links.
    """

    name: str
    type: str
    links: tuple[str, str]
    poses: tuple[Pose, Pose]
    file: str
    line: int
    key: str


@dataclass(frozen=True)
class Closures:
    """The closed loops of a robot.

    ``driven``: the joints with a motor; ``passive``: those without; None where the files do not
    state them.
    """

    loops: tuple[Closure, ...] = ()
    driven: frozenset[str] | None = None
    passive: frozenset[str] | None = None


def find_closures(urdf: Urdf, path: Path) -> Closures:
    """The closed loops that a URDF file and the YAML file next to it state.

    Parameters
    ----------
    urdf : Urdf
    path : Path
        Of the URDF file.

    Raises
    ------
    ModelError
        A type, a link or a joint is unknown, or a number is missing.
    """
    loops = [
        Closure(
            c.name,
            CONSTRAINTS[c.type],
            (c.parent, c.child),
            c.poses,
            urdf.file,
            c.line,
            key("constraint", c.name),
        )
        for c in urdf.constraints()
    ]
    stated = Closures(tuple(loops), urdf.driven_joints())
    next_to = file_of_closures(path)
    if next_to is None:
        return stated
    shown = (
        str(Path(urdf.file).with_name(next_to.name)) if "://" not in urdf.file else str(next_to)
    )
    root = _read(next_to, shown)
    return (
        _loops_of_frames(urdf, root, stated)
        if "closed_loop" in root
        else _loops_of_cuts(urdf, root, stated)
    )


def file_of_closures(path: Path) -> Path | None:
    """The YAML file next to a URDF file that states its closed loops, or None.

    ``loop_closures.yaml``, or the one with the name of the URDF file that has a key
    ``closed_loop``.
    """
    next_to = path.with_name(NEXT_TO)
    if next_to.is_file():
        return next_to
    extended = path.with_suffix(".yaml")
    if not extended.is_file():
        return None
    raw = file_bytes(extended, "urdf")[:SIZE_MAX]
    return extended if re.search(rb"^closed_loop\s*:", raw, re.MULTILINE) else None


# --- files ---------------------------------------------------------------------------------------


def _read(path: Path, shown: str) -> Table:
    """The content of a YAML file."""
    raw = file_bytes(path, "urdf", shown)
    if len(raw) > SIZE_MAX:
        given = f"more than {SIZE_MAX} bytes"
        raise ModelError(shown, 0, "file", given, f"at most {SIZE_MAX} bytes")
    try:
        text = raw.removeprefix(codecs.BOM_UTF8).decode("utf-8")
        return Table(shown, _without_tiny(parse(text, shown)), "")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        given = f"the byte 0x{raw[error.start]:02x}"
        raise ModelError(shown, line, "file", given, "text in UTF-8") from None
    except TextError as error:
        expected = f"{error.expected} {WITHOUT_LOOPS}"
        raise ModelError(shown, error.line, "file", error.given, expected) from None


def _without_tiny(entry: Entry) -> Entry:
    """The entry with 0 for numbers that are rounding errors."""
    value = entry.value
    if isinstance(value, dict):
        value = {name: _without_tiny(item) for name, item in value.items()}
    elif isinstance(value, list):
        value = [_without_tiny(item) for item in value]
    elif isinstance(value, float) and abs(value) < SMALLEST:
        value = 0.0
    return Entry(value, entry.line, entry.file)


def _loops_of_cuts(urdf: Urdf, root: Table, stated: Closures) -> Closures:
    """Loops that an exporter of a CAD program has cut at a hinge.

    ``closures``: two links, and a point and an axis in the frame of the root link with all joints
    at zero; ``dependent`` and ``independent``: joints.
    """
    if "closures" not in root:
        given = f"the keys {', '.join(map(bare, root.entries)) or 'of no loop'}"
        raise root.fail("closures", f"closures, dependent, independent {WITHOUT_LOOPS}", given)
    root.only("closures", "dependent", "independent")
    loops = []
    for k, table in enumerate(root.tables("closures", required=False)):
        table.only("link_a", "link_b", "point", HINGE)
        links = (_link(urdf, table, "link_a"), _link(urdf, table, "link_b"))
        hinge = Pose(frame_of_axis(table.axis(HINGE)), np.array(table.vector("point", 3)))
        poses = tuple(_inverse(_at_zero(urdf, link)) @ hinge for link in links)
        loops.append(
            Closure(
                f"closure{k + 1}",
                "axis",
                links,
                (poses[0], poses[1]),
                root.file,
                table.line,
                table.key,
            )
        )
    passive = _joints(urdf, root, "dependent")
    driven = _joints(urdf, root, "independent")
    return Closures((*stated.loops, *loops), stated.driven if driven is None else driven, passive)


def _loops_of_frames(urdf: Urdf, root: Table, stated: Closures) -> Closures:
    """Loops of an extended URDF, as tools for Pinocchio write them.

    ``closed_loop``: pairs of frames, which are links or joints; ``type``: 3d or 6d of each;
    ``name_mot``: joints with a motor.
    """
    root.only("closed_loop", "type", "name_mot", "joint_name", "joint_type")
    pairs = root.plain("closed_loop", "a list of pairs of frames")
    kinds = root.plain("type", "3d or 6d for each pair") if "type" in root else ["6d"] * len(pairs)
    if not isinstance(pairs, list) or not isinstance(kinds, list) or len(kinds) != len(pairs):
        raise root.fail("type", "as many types as pairs under closed_loop")
    if root.plain("joint_name", "") if "joint_name" in root else ():
        raise root.fail(
            "joint_name",
            f"no joints of another type: write them as revolute joints {WITHOUT_LOOPS}",
        )
    line = root.entries["closed_loop"].line
    loops = []
    for k, (pair, kind) in enumerate(zip(pairs, kinds, strict=True)):
        if not isinstance(pair, list) or len(pair) != 2:
            raise root.fail("closed_loop", "a list of pairs of frames", show(pair))
        if str(kind).lower() not in _DIMENSIONS:
            raise root.fail("type", "3d or 6d for each pair", show(kind))
        here = f"closed_loop[{k}]"
        first, second = (_frame(urdf, root, here, str(name)) for name in pair)
        loops.append(
            Closure(
                f"closure{k + 1}",
                _DIMENSIONS[str(kind).lower()],
                (first, second),
                (identity_pose(), identity_pose()),
                root.file,
                line,
                here,
            )
        )
    driven = _joints(urdf, root, "name_mot")
    return Closures((*stated.loops, *loops), stated.driven if driven is None else driven)


def _link(urdf: Urdf, table: Table, name: str) -> str:
    """The link under a key, which the URDF file has to have."""
    link = table.text(name)
    if link not in urdf.links:
        raise table.fail(name, f"a link of {urdf.file}: {among(link, urdf.links)} {WITHOUT_LOOPS}")
    return link


def _frame(urdf: Urdf, root: Table, here: str, name: str) -> str:
    """The link with this name, or the one that the joint with this name moves."""
    if name in urdf.joints:
        return urdf.joints[name].child
    if name not in urdf.links:
        expected = f"a link or joint of {urdf.file}: {among(name, urdf.links)} {WITHOUT_LOOPS}"
        line = root.entries["closed_loop"].line
        raise ModelError(root.file, line, here, f"an unknown frame {show(name)}", expected)
    return name


def _joints(urdf: Urdf, root: Table, name: str) -> frozenset[str] | None:
    """The joints under a key; None where it is missing."""
    if name not in root:
        return None
    words = root.words(name, 0)
    for word in words:
        if word not in urdf.joints:
            expected = f"joints of {urdf.file}: {among(word, urdf.joints)} {WITHOUT_LOOPS}"
            raise root.fail(name, expected, f"an unknown joint {show(word)}")
    return frozenset(words)


def _at_zero(urdf: Urdf, link: str) -> Pose:
    """Pose of a link in the root link with all joints at zero."""
    pose = identity_pose()
    while (holder := urdf.parent_joint.get(link)) is not None:
        pose = joint_pose(urdf, holder, 0.0) @ pose
        link = holder.parent
    return pose


def _inverse(pose: Pose) -> Pose:
    return Pose(pose.rotation.T, -pose.rotation.T @ pose.position)


# --- the loops of a chain ------------------------------------------------------------------------


def loops_of_chain(
    urdf: Urdf,
    found: Closures,
    base: str,
    tips: Sequence[str],
    dropped: Collection[str],
    locked: Collection[str] = (),
) -> tuple[Closure, ...]:
    """The loops that hold a link of the chain from ``base`` to the ``tips``, or of a branch that
    such a loop holds; not those behind a joint that is left out.

    Raises
    ------
    ModelError
        An end of such a loop is not behind the base.
    """
    moving = {j.name for tip in tips for j in _free_joints(_above(urdf, tip, base), locked)}
    left = [
        loop
        for loop in found.loops
        if not any(j.name in dropped for link in loop.links for j in _above(urdf, link, base))
    ]
    used: list[Closure] = []
    while held := [loop for loop in left if moving & _joints_above(urdf, loop, base, locked)]:
        for loop in held:
            for link in loop.links:
                _check_behind(urdf, loop, link, base)
            moving |= _joints_above(urdf, loop, base, locked)
            left.remove(loop)
        used += held
    return tuple(loop for loop in found.loops if loop in used)


def passive_of_chain(
    urdf: Urdf,
    found: Closures,
    loops: Sequence[Closure],
    base: str,
    stated: Mapping[str, Table],
    locked: Collection[str] = (),
) -> frozenset[str]:
    """The joints of the ``loops`` that have no motor.

    Those that the overlay names; else those of the YAML file, or those that neither
    <transmission> nor <ros2_control> drives.

    Parameters
    ----------
    urdf : Urdf
    found : Closures
    loops : sequence of Closure
        Of the chain.
    base : str
    stated : mapping
        The tables of joints in the overlay: one with another kind of motion has precedence.
    locked : collection of str

    Raises
    ------
    ModelError
        Nothing states which joints of the loops have no motor.
    """
    named = {name for name, table in stated.items() if "passive" in table}
    ways = ("gear", "spring", "mimic", "motor")
    others = {name for name, table in stated.items() if any(way in table for way in ways)}
    inside = [name for loop in loops for name in joints_of_loop(urdf, loop, base, locked)]
    if found.passive is not None:
        named |= {name for name in found.passive if name in inside} - others
    elif found.driven is not None:
        idle = (name for name in inside if name not in found.driven)
        named |= {name for name in idle if urdf.mimic(urdf.joints[name]) is None} - others
    if loops and not named:
        names = list(dict.fromkeys(inside))
        first = bare(names[-1]) if names else "NAME"
        loop = loops[0]
        raise ModelError(
            loop.file,
            loop.line,
            loop.key,
            f"a closed loop of the joints {', '.join(map(show, names))}, none of them without a "
            "motor",
            f"in the overlay: [joint.{first}] passive = {{ near_rad = 0.0 }} for each joint "
            "without a motor; or <transmission>, <ros2_control> or the keys of "
            f"{NEXT_TO} that name the joints with one {WITHOUT_LOOPS}",
        )
    return frozenset(named)


def joints_of_loop(
    urdf: Urdf, loop: Closure, base: str, locked: Collection[str] = ()
) -> list[str]:
    """The moving joints between the two ends of a loop, without those that move both."""
    first, second = (
        [j.name for j in _free_joints(_above(urdf, link, base), locked)] for link in loop.links
    )
    return [n for n in (*first[::-1], *second[::-1]) if (n in first) != (n in second)]


def loop_name(name: str) -> str:
    """A name of a table ``[[loop]]``: letters, digits and underscores."""
    plain = re.sub(r"(\W|_)+", "_", name, flags=re.ASCII)
    return plain if re.match(r"[A-Za-z]", plain) else f"loop_{plain}"


def _joints_above(urdf: Urdf, loop: Closure, base: str, locked: Collection[str]) -> set[str]:
    """The moving joints above the two ends of a loop, up to the base."""
    return {j.name for link in loop.links for j in _free_joints(_above(urdf, link, base), locked)}


def _free_joints(joints: Iterable[Joint], locked: Collection[str]) -> list[Joint]:
    return [j for j in joints if j.type in MOVING and j.name not in locked]


def _above(urdf: Urdf, link: str, base: str) -> list[Joint]:
    """The joints above a link, up to the base or the root."""
    out = []
    while link != base and (holder := urdf.parent_joint.get(link)) is not None:
        out.append(holder)
        link = holder.parent
    return out


def _check_behind(urdf: Urdf, loop: Closure, link: str, base: str) -> None:
    """Raise an error for an end of a loop that is not behind the base."""
    above = _above(urdf, link, base)
    if link == base or (above and above[-1].parent == base):
        return
    root = above[-1].parent if above else link
    raise ModelError(
        loop.file,
        loop.line,
        loop.key,
        f"a closed loop with {show(link)}, which is not behind the base {show(base)}",
        f"a base that is before both links, such as {show(root)} {WITHOUT_LOOPS}",
    )
