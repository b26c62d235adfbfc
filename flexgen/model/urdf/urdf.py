"""URDF files: the tree of links and joints, and checked access to their numbers.

Only data for the dynamics of an arm are read; everything else (visuals, collisions, transmissions,
extensions) is ignored. The tree is checked as a whole. The numbers of a link or joint are checked
when they are used: errors in unused links and joints are not reported.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from flexgen.base.errors import ModelError
from flexgen.base.spec.tables import LARGEST, SMALLEST, bare, open_file, show
from flexgen.base.spec.toml_lines import WIDTH
from flexgen.base.spec.xml_lines import MarkupError, Node, parse
from flexgen.model.format.format_robot import rotation_matrix

SIZE_MAX = 2_000_000  # bytes
TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
# Types of <constraint>, and the closed loops that they make.
CONSTRAINTS = {"spherical": "point", "revolute": "axis", "continuous": "axis", "fixed": "pose"}
# of the triangle inequality, relative to the largest moment: files have about six digits
INERTIA_TOLERANCE = 1e-6

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "iyz", "ixz")
_CHILDREN = {
    "robot": ("link", "joint", "constraint"),
    "link": ("inertial", "visual", "collision"),
    "joint": (
        # those of the format
        "origin parent child axis limit dynamics mimic calibration safety_controller"
    ).split(),
    "inertial": ("origin", "mass", "inertia"),
    "constraint": (
        # those of the proposal for closed loops
        "parent parent_origin parent_axis child child_origin child_axis"
    ).split(),
}
# Key of an overlay that leaves the closed loops of a file out, for a message.
WITHOUT_LOOPS = "(or in the overlay: [urdf] loops = false)"


@dataclass(frozen=True)
class Pose:
    """Pose of a child frame in its parent: ``p_parent = position + rotation @ p_child``, position
    in m.
    """

    rotation: np.ndarray
    position: np.ndarray

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.rotation @ other.rotation, self.position + self.rotation @ other.position)


def identity_pose() -> Pose:
    """The identity pose."""
    return Pose(np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class Inertial:
    """Mass [kg], center of mass [m] and inertia tensor about it [kg m^2], in the axes of a
    frame.
    """

    mass: float
    com: np.ndarray
    inertia: np.ndarray
    reduced: bool = False  # the principal moments need not satisfy the triangle inequality

    def express_in_parent(self, pose: Pose) -> Inertial:
        """Inertia of the body, expressed in the parent of the frame with this pose."""
        R = pose.rotation
        return Inertial(
            self.mass, pose.position + R @ self.com, R @ self.inertia @ R.T, self.reduced
        )


@dataclass(frozen=True)
class Stated:
    """The numbers of <inertial>; the inertia tensor has the axes of its <origin>, ``axes``."""

    mass: float
    com: np.ndarray
    inertia: np.ndarray
    axes: np.ndarray


@dataclass(frozen=True)
class Limit:
    """Limits of a joint, or None in their place.

    ``lower``, ``upper`` [rad or m], ``effort`` [N m or N], ``velocity`` [its unit/s].
    """

    line: int
    lower: float | None
    upper: float | None
    effort: float | None
    velocity: float | None


@dataclass(frozen=True)
class Mimic:
    """<mimic> of a joint: its position is ``factor q_leader + offset`` [rad or m]."""

    line: int
    leader: str
    factor: float
    offset: float


@dataclass(frozen=True)
class Link:
    """A link: its name and its element in the file."""

    name: str
    node: Node


@dataclass(frozen=True)
class Joint:
    """A joint between two links, and its element in the file."""

    name: str
    type: str
    parent: str
    child: str
    node: Node

    @property
    def movable(self) -> bool:
        """Whether the child can move relative to the parent."""
        return self.type != "fixed"


@dataclass(frozen=True)
class Constraint:
    """<constraint>: an end of its parent link and one of its child link that coincide.

    ``type``: a key of `CONSTRAINTS`; ``poses``: of the two ends in their links, where z is the
    axis of a revolute one.
    """

    name: str
    type: str
    parent: str
    child: str
    poses: tuple[Pose, Pose]
    line: int


class Urdf:
    """Links and joints of a URDF file; the methods return checked numbers or raise ModelError.

    Parameters
    ----------
    path : Path
        The file.
    file : str
        Name of the file in messages.

    Raises
    ------
    ModelError
        The file is not valid: malformed, too large, not one tree of links, or with a duplicate
        name.
    """

    def __init__(self, path: Path, file: str) -> None:
        self.file = file
        try:
            with open_file(path, "rb") as stream:
                raw = stream.read(SIZE_MAX + 1)
        except OSError as error:
            self.fail(
                0, "file", f"a file that cannot be read ({error.strerror})", "a readable URDF file"
            )
        if len(raw) > SIZE_MAX:
            self.fail(0, "file", f"more than {SIZE_MAX} bytes", f"at most {SIZE_MAX} bytes")
        try:
            root = parse(raw)
        except MarkupError as error:
            self.fail(error.line, "file", error.given, error.expected)
        if root.tag != "robot":
            self.fail(
                root.line,
                "file",
                f"the element {show(root.tag)}",
                "a URDF file, which starts with <robot name=...>",
            )
        self._check_spelling(root, "robot")
        self.name = self._attribute(root, "robot", "name")
        self.links: dict[str, Link] = {}
        self.joints: dict[str, Joint] = {}
        for node in root.children:
            if node.tag == "link":
                name = self._attribute(node, "link", "name")
                self._once(node, "link", name, self.links)
                self.links[name] = Link(name, node)
        for node in root.children:
            if node.tag == "joint":
                name = self._attribute(node, "joint", "name")
                self._once(node, "joint", name, self.joints)
                self.joints[name] = self._joint(node, name)
        self._root = root
        self._check_tree(root)

    def fail(self, line: int, key: str, given: str, expected: str) -> NoReturn:
        """Raise the error for a line of this file."""
        raise ModelError(self.file, line, key, given, expected)

    # --- the tree --------------------------------------------------------------------------------

    @cached_property
    def parent_joint(self) -> dict[str, Joint]:
        """Parent joint of each link, by the name of the link."""
        return {joint.child: joint for joint in self.joints.values()}

    @cached_property
    def child_joints(self) -> dict[str, list[Joint]]:
        """Child joints of each link, by the name of the link."""
        out: dict[str, list[Joint]] = {name: [] for name in self.links}
        for joint in self.joints.values():
            out[joint.parent].append(joint)
        return out

    def _once(self, node: Node, kind: str, name: str, known: dict[str, Any]) -> None:
        if name in known:
            first = known[name].node.line
            given = f"a second {kind} {show(name)}, the first one is in line {first}"
            self.fail(node.line, key(kind, name), given, f"each {kind} once")

    def _joint(self, node: Node, name: str) -> Joint:
        """A joint with its type and the links it connects, both of which have to exist."""
        here = key("joint", name)
        self._check_spelling(node, here)
        kind = self._attribute(node, here, "type")
        if kind not in TYPES:
            self.fail(node.line, f"{here}.type", show(kind), among(kind, TYPES))
        ends = [self._link_of(node, here, end) for end in ("parent", "child")]
        return Joint(name, kind, ends[0], ends[1], node)

    def _link_of(self, node: Node, here: str, end: str) -> str:
        """The link of <parent> or <child>, which has to exist."""
        inner = self._child(node, here, end)
        if inner is None:
            self.fail(node.line, f"{here}.{end}", "nothing", f'<{end} link="..."/>')
        link = self._attribute(inner, f"{here}.{end}", "link")
        if link not in self.links:
            self.fail(
                inner.line,
                f"{here}.{end}",
                f"an unknown link {show(link)}",
                among(link, self.links),
            )
        return link

    def _check_tree(self, root: Node) -> None:
        """Check that there is one root, and that each other link has one parent and is reached
        from the root.
        """
        first: dict[str, Joint] = {}
        for joint in self.joints.values():
            other = first.setdefault(joint.child, joint)
            if other is not joint:
                given = (
                    f"{show(joint.child)}, which already is the child of joint {show(other.name)}"
                )
                self.fail(
                    joint.node.line,
                    f"{key('joint', joint.name)}.child",
                    given,
                    "one parent for each link",
                )
        roots = [name for name in self.links if name not in first]
        if len(roots) > 1:
            line = self.links[roots[1]].node.line
            given = f"two links without a parent, {show(roots[0])} and {show(roots[1])}"
            self.fail(line, "robot", given, "one tree of links")
        reached = set(roots)
        todo = list(roots)
        while todo:
            for joint in self.child_joints[todo.pop()]:
                reached.add(joint.child)
                todo.append(joint.child)
        for name, link in self.links.items():
            if name not in reached:
                self.fail(
                    link.node.line,
                    key("link", name),
                    "a link in a loop of joints",
                    "one tree of links",
                )
        if not self.links:
            self.fail(root.line, "robot", "no link", "links and joints")

    # --- closed loops ----------------------------------------------------------------------------

    def constraints(self) -> list[Constraint]:
        """The elements <constraint>, checked as a whole."""
        out: dict[str, Constraint] = {}
        for node in (child for child in self._root.children if child.tag == "constraint"):
            name = self._attribute(node, "constraint", "name")
            if name in out:
                given = f"a second constraint {show(name)}, the first one is in line "
                given += str(out[name].line)
                self.fail(node.line, key("constraint", name), given, "each constraint once")
            out[name] = self._constraint(node, name)
        return list(out.values())

    def _constraint(self, node: Node, name: str) -> Constraint:
        """An element <constraint> with its type, links and ends."""
        here = key("constraint", name)
        for child in node.children:
            if child.tag not in _CHILDREN["constraint"]:
                expected = f"{among(child.tag, _CHILDREN['constraint'])} {WITHOUT_LOOPS}"
                self.fail(
                    child.line, here, f"an unknown element <{show(child.tag)[1:-1]}>", expected
                )
        kind = self._attribute(node, here, "type")
        if kind not in CONSTRAINTS:
            expected = f"{among(kind, CONSTRAINTS)}, or another one as a link with a joint in the "
            expected += f"tree and one of these {WITHOUT_LOOPS}"
            self.fail(node.line, f"{here}.type", show(kind), expected)
        links = (self._link_of(node, here, "parent"), self._link_of(node, here, "child"))
        poses = (self._end(node, here, "parent", kind), self._end(node, here, "child", kind))
        return Constraint(name, kind, *links, poses, node.line)

    def _end(self, node: Node, here: str, side: str, kind: str) -> Pose:
        """Pose of an end of a constraint in its link; z is the axis of a revolute one."""
        pose = self._pose(node, here, f"{side}_origin")
        if CONSTRAINTS[kind] != "axis":
            return pose
        inner = self._child(node, here, f"{side}_axis")
        if inner is None:
            axis = [1.0, 0.0, 0.0]  # the default of the format
        else:
            axis = self._numbers(inner, f"{here}.{side}_axis", "xyz", 3)
            if not any(axis):
                given = show(inner.attributes["xyz"])
                expected = "a direction that is not zero"
                self.fail(inner.line, f"{here}.{side}_axis.xyz", given, expected)
        return pose @ Pose(frame_of_axis(axis), np.zeros(3))

    def driven_joints(self) -> frozenset[str] | None:
        """Names of the joints that <transmission> or <ros2_control> drives; None without them."""
        out = set()
        stated = False
        for node in self._root.children:
            if node.tag not in ("transmission", "ros2_control"):
                continue
            stated = True
            for child in (child for child in node.children if child.tag == "joint"):
                commands = [inner for inner in child.children if inner.tag == "command_interface"]
                if node.tag == "transmission" or commands:
                    out.add(child.attributes.get("name", ""))
        return frozenset(out) if stated else None

    # --- checked access --------------------------------------------------------------------------

    def _check_spelling(self, node: Node, here: str) -> None:
        """Raise an error for an element with a misspelled name; extensions are ignored."""
        known = _CHILDREN[node.tag]
        odd = {child.tag: child for child in reversed(node.children) if child.tag not in known}
        for child in list(odd.values())[:100]:
            near = difflib.get_close_matches(child.tag.lower(), known, 1, 0.8)
            if near:
                self.fail(child.line, here, f"an unknown element {show(child.tag)}", near[0])

    def _child(self, node: Node, here: str, tag: str) -> Node | None:
        found = [child for child in node.children if child.tag == tag]
        if len(found) > 1:
            self.fail(found[1].line, f"{here}.{tag}", f"a second <{tag}>", f"one <{tag}>")
        return found[0] if found else None

    def _attribute(self, node: Node, here: str, name: str) -> str:
        """The text of an attribute that has to be there; ``here``: place in the file, for the
        error.
        """
        value = node.attributes.get(name, "")
        if not value.strip():
            given = "nothing" if name not in node.attributes else "an empty string"
            self.fail(node.line, f"{here}.{name}", given, f'the attribute {name}="..."')
        if len(value) > WIDTH:
            self.fail(
                node.line,
                f"{here}.{name}",
                f"a text of {len(value)} characters",
                f"at most {WIDTH}",
            )
        return value

    def _numbers(
        self,
        node: Node,
        here: str,
        name: str,
        count: int = 1,
        default: Sequence[float] | None = None,
        hint: str = "",
    ) -> list[float]:
        """The ``count`` numbers of an attribute, tiny ones as zero; ``default`` where it is
        missing. Errors have the place ``here`` and the ``hint``, an alternative way.
        """
        if default is not None and name not in node.attributes:
            return list(default)
        expected = "a number" if count == 1 else f"{count} numbers"
        text = self._attribute(node, here, name)
        words = text.split()
        if len(words) != count or not all(_NUMBER.fullmatch(word) for word in words):
            if "${" in text:
                hint = " (the file seems to be xacro source that is not expanded)"
            self.fail(node.line, f"{here}.{name}", show(text), expected + hint)
        values = [float(word) for word in words]
        largest = max(map(abs, values))
        if not largest <= LARGEST:
            self.fail(
                node.line,
                f"{here}.{name}",
                show(text),
                f"{expected} of magnitude at most {LARGEST:g}{hint}",
            )
        return zero_tiny(values)

    def _pose(self, node: Node, here: str, tag: str = "origin") -> Pose:
        """The <origin> of a joint or an inertial, or another element ``tag``; the identity if
        there is none.
        """
        origin = self._child(node, here, tag)
        if origin is None:
            return identity_pose()
        here = f"{here}.{tag}"
        rpy = self._numbers(origin, here, "rpy", 3, (0.0, 0.0, 0.0))
        position = self._numbers(origin, here, "xyz", 3, (0.0, 0.0, 0.0))
        return Pose(np.array(rotation_matrix(tuple(rpy), degrees=False)), np.array(position))

    def origin(self, joint: Joint) -> Pose:
        """Pose of a joint in its parent link."""
        return self._pose(joint.node, key("joint", joint.name))

    def axis(self, joint: Joint) -> list[float]:
        """The axis of a joint in its own frame, normalized to length 1."""
        values = self._axis(joint)
        length = math.hypot(*values)
        if length == 0.0:
            node = self._child(joint.node, key("joint", joint.name), "axis")
            assert node is not None
            here = f"{key('joint', joint.name)}.axis.xyz"
            given = show(node.attributes["xyz"])
            expected = "a direction that is not zero"
            self.fail(node.line, here, given, expected)
        return [x / length for x in values]

    def axis_length(self, joint: Joint) -> float:
        """The length of the axis of a joint as it is in the file."""
        return math.hypot(*self._axis(joint))

    def _axis(self, joint: Joint) -> list[float]:
        """Direction (3,) of the axis of a joint, x where the file has none, of any length."""
        here = key("joint", joint.name)
        node = self._child(joint.node, here, "axis")
        if node is None:
            return [1.0, 0.0, 0.0]  # the default of the format
        return self._numbers(node, f"{here}.axis", "xyz", 3)

    def mimic(self, joint: Joint) -> Mimic | None:
        """<mimic> of a joint, or None if there is none."""
        here = key("joint", joint.name)
        node = self._child(joint.node, here, "mimic")
        if node is None:
            return None
        factor = self._numbers(node, f"{here}.mimic", "multiplier", 1, (1.0,))[0]
        offset = self._numbers(node, f"{here}.mimic", "offset", 1, (0.0,))[0]
        return Mimic(node.line, node.attributes.get("joint", ""), factor, offset)

    def limit(self, joint: Joint, replaced: Collection[str] = ()) -> Limit | None:
        """Limits of a movable joint; None for a joint that needs none and has none.

        Parameters
        ----------
        joint : Joint
        replaced : collection of str
            Attributes of <limit> that other values replace: not read, None in their place.
        """
        where = key("joint", joint.name)
        needed = [name for name in self._limits_of(joint) if name not in replaced]
        node = self._child(joint.node, where, "limit")
        if node is None:
            if joint.type == "continuous" or not needed:
                return None
            names = ", ".join(sorted(needed, key=("lower", "upper", "effort", "velocity").index))
            given = "nothing"
            expected = f"<limit> with {names} {_switch(joint)}"
            self.fail(joint.node.line, f"{where}.limit", given, expected)
        found = {name: self._limit(joint, node, name) for name in needed}
        lower = found.get("lower")
        upper = found.get("upper")
        if lower is not None and upper is not None and lower >= upper:
            given = f"lower {lower:g}, upper {upper:g}"
            expected = f"a lower limit below the upper one {_switch(joint)}"
            self.fail(node.line, f"{where}.limit", given, expected)
        return Limit(node.line, lower, upper, found.get("effort"), found.get("velocity"))

    def usable_limits(self, joint: Joint) -> dict[str, float]:
        """Those numbers of <limit> that are right; neither of two ends in a wrong order."""
        where = key("joint", joint.name)
        out: dict[str, float] = {}
        for name in self._limits_of(joint):
            try:
                node = self._child(joint.node, where, "limit")
                if node is not None:
                    out[name] = self._limit(joint, node, name)
            except ModelError:
                continue
        if "lower" in out and "upper" in out and out["lower"] >= out["upper"]:
            del out["lower"], out["upper"]
        return out

    @staticmethod
    def _limits_of(joint: Joint) -> tuple[str, ...]:
        """The attributes of <limit> that a joint of this type needs, in the order of the
        checks.
        """
        rates = ("effort", "velocity")
        return rates if joint.type == "continuous" else (*rates, "lower", "upper")

    def _limit(self, joint: Joint, node: Node, name: str) -> float:
        """The number ``name`` of the element <limit> ``node``; effort and velocity have to be
        above zero.
        """
        here = f"{key('joint', joint.name)}.limit"
        if name not in node.attributes:
            self.fail(node.line, f"{here}.{name}", "nothing", f"a number {_switch(joint)}")
        (value,) = self._numbers(node, here, name, hint=f" {_switch(joint)}")
        if name in ("effort", "velocity") and value <= 0.0:
            given = show(node.attributes[name])
            expected = f"a number > 0 {_switch(joint)}"
            self.fail(node.line, f"{here}.{name}", given, expected)
        return value

    def dynamics(self, joint: Joint) -> tuple[int, float, float]:
        """Line, viscous damping [N m s/rad or N s/m] and Coulomb friction [N m or N] of a joint;
        zero by default.
        """
        where = key("joint", joint.name)
        node = self._child(joint.node, where, "dynamics")
        if node is None:
            return joint.node.line, 0.0, 0.0
        values = []
        for name in ("damping", "friction"):
            (value,) = self._numbers(node, f"{where}.dynamics", name, 1, (0.0,))
            if value < 0.0:
                self.fail(
                    node.line,
                    f"{where}.dynamics.{name}",
                    show(node.attributes[name]),
                    "a number >= 0",
                )
            values.append(value)
        return node.line, values[0], values[1]

    def inertial(self, link: Link, reduced: bool = False) -> Inertial | None:
        """Mass, center of mass and inertia of a link in its frame; None for a massless link.

        ``reduced``: the largest principal moment may exceed the sum of the other two.
        """
        body = self.stated_inertial(link)
        if body is None:
            return None
        here = f"{key('link', link.name)}.inertial"
        lines = self._lines(link)
        if body.mass < 0.0:
            self.fail(lines["mass"], f"{here}.mass.value", f"{body.mass:g}", "a number >= 0")
        if body.mass == 0.0 and body.inertia.any():
            given = "an inertia without a mass"
            expected = "a mass > 0, or no inertia"
            self.fail(lines["inertia"], f"{here}.inertia", given, expected)
        if body.inertia.any():
            self._check_inertia(body.inertia, lines["inertia"], link, reduced)
        if body.mass == 0.0:
            return None
        R = body.axes
        return Inertial(body.mass, body.com, R @ body.inertia @ R.T, reduced)

    def stated_inertial(self, link: Link) -> Stated | None:
        """The numbers of <inertial>, which need not be those of a body; None if there is none."""
        where = key("link", link.name)
        self._check_spelling(link.node, where)
        node = self._child(link.node, where, "inertial")
        if node is None:
            return None
        here = f"{where}.inertial"
        self._check_spelling(node, here)
        parts = {tag: self._child(node, here, tag) for tag in ("mass", "inertia")}
        for tag, part in parts.items():
            if part is None:
                self.fail(node.line, f"{here}.{tag}", "nothing", f"<{tag}> in <inertial>")
        mass = parts["mass"]
        inertia = parts["inertia"]
        assert mass is not None
        assert inertia is not None
        (value,) = self._numbers(mass, f"{here}.mass", "value")
        moments = [self._numbers(inertia, f"{here}.inertia", name)[0] for name in _MOMENTS]
        xx, yy, zz, xy, yz, xz = moments
        pose = self._pose(node, here)
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return Stated(value, pose.position, tensor, pose.rotation)

    def _lines(self, link: Link) -> dict[str, int]:
        """Lines of the parts of <inertial>."""
        node = next(child for child in link.node.children if child.tag == "inertial")
        return {child.tag: child.line for child in node.children}

    def _check_inertia(self, tensor: np.ndarray, line: int, link: Link, reduced: bool) -> None:
        """Refuse a tensor [kg m^2] that is not that of a body: a negative principal moment, or,
        unless it is ``reduced`` by the inertia of rotors, one larger than the sum of the others.
        """
        here = f"{key('link', link.name)}.inertial.inertia"
        largest = float(np.abs(tensor).max())
        low, middle, high = np.linalg.eigvalsh(tensor / largest).tolist()
        given = "principal moments " + ", ".join(f"{x * largest:.6g}" for x in (low, middle, high))
        table = f"in the overlay: [link.{bare(link.name)}]"
        if low < -1e-9:
            self.fail(
                line,
                here,
                given,
                f"principal moments >= 0 (or {table} body = {{ mass = ..., inertia = [...] }})",
            )
        if not reduced and low + middle < high * (1.0 - INERTIA_TOLERANCE):
            wanted = (
                f"no moment larger than the sum of the other two (or {table} inertia_reduced = "
                "true)"
            )
            self.fail(line, here, given, wanted)


def _switch(joint: Joint) -> str:
    """Key of an overlay that switches a wrong limit off, for a message."""
    return f"(or in the overlay: [joint.{bare(joint.name)}] limits = false)"


def key(kind: str, name: str) -> str:
    """Key of a link or joint in an error message."""
    return f"{kind}.{bare(name) if len(name) <= 60 else show(name)}"


def frame_of_axis(axis: Sequence[float]) -> np.ndarray:
    """A rotation matrix whose z axis has this direction; the identity for z itself."""
    z = np.array(axis) / math.hypot(*axis)
    if z[0] == 0.0 and z[1] == 0.0 and z[2] > 0.0:
        return np.eye(3)
    # the coordinate axis that is most nearly across
    across = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(across, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def zero_tiny(values: Iterable[float]) -> list[float]:
    """Replace numbers below the smallest magnitude of a model by 0."""
    return [x if abs(x) >= SMALLEST else 0.0 for x in values]


def among(word: str, names: Iterable[str]) -> str:
    """Text for a message: the most similar known name, if any, and the first known names."""
    known = list(names)[:1000]
    if not known:
        return "no name"
    near = difflib.get_close_matches(word, known, 1)
    listed = ", ".join(show(name) for name in known[:8]) + (", ..." if len(known) > 8 else "")
    return f"{show(near[0])} (there are: {listed})" if near else f"one of {listed}"
