"""Overlays: model files whose chain is read from a URDF file, converted to the tables of an
ordinary model file.

The table ``[urdf]`` names the file and the two ends of the chain; ``[joint.NAME]`` and
``[link.NAME]`` state what a URDF file cannot contain. All other keys are those of an ordinary
model file and stay unchanged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.errors import ModelError
from flexgen.base.spec.keys import Context
from flexgen.base.spec.ports import c_name_problem, identifier_problem
from flexgen.base.spec.tables import Table, as_number, bare, show
from flexgen.base.spec.toml_lines import Entry, wrap
from flexgen.model.elements import Body, UrdfJoint
from flexgen.model.format.format import JOINT, LINK, URDF
from flexgen.model.format.format_robot import BODY, DOF
from flexgen.model.urdf.joint_defaults import EVERY, merge
from flexgen.model.urdf.urdf import Inertial, Limit, Link, Pose, Urdf, among, key, zero_tiny
from flexgen.model.urdf.urdf_chain import MOVING, Chain, Segment, find_chain
from flexgen.model.urdf.urdf_loops import (
    Closure,
    Closures,
    find_closures,
    loop_name,
    loops_of_chain,
    passive_of_chain,
)
from flexgen.model.urdf.urdf_mimic import Motions
from flexgen.model.urdf.urdf_source import find_urdf

_RENAME = JOINT["rename"]
_EVERY = JOINT.without("rename", "before", "after", "passive").names  # of the table [joint."*"]
# s/rad or s/m: of the Coulomb friction of a URDF file, which is smoothed by tanh(beta speed); at
# 5 % of the speed of a usual joint, 1 rad/s or 0.3 m/s, it is 76 % of its value
BETA = {"revolute": 20.0, "continuous": 20.0, "prismatic": 66.0}
# Keys of the table of a fixed joint: degrees of freedom between the two links.
_AT_FIXED = ("before", "after")


def expand(root: Entry, folder: Path, shown: str) -> dict[str, UrdfJoint]:
    """Replace the tables ``urdf``, ``joint`` and ``link`` of a model file by ``element`` and
    ``motor`` tables; ``element`` tables of the file follow those of the chain, on its tip.

    Adds defaults for missing keys: the name of the robot in the URDF file, gravity along -z, all
    actuated joints as output, and a home at zero (midway between the limits if zero is outside of
    them).

    Parameters
    ----------
    root : Entry
        The model file, changed in place.
    folder : Path
        Relative paths in the file start here.
    shown : str
        Name of the model file in messages.

    Returns
    -------
    dict
        The joints of the URDF file by the names of their degrees of freedom.

    Raises
    ------
    ModelError
        One of the two files has an error.
    """
    top = Table(shown, root, "")
    overlay = _Overlay(top, folder)
    chain = overlay.chain()
    overlay.spread(chain)
    elements = overlay.elements(chain)
    motors = overlay.motors(chain)
    for name in ("urdf", "joint", "link"):
        root.value.pop(name, None)
    root.value["element"] = Entry(elements, overlay.table.line, overlay.urdf.file)
    given = root.value.get("motor")
    if given is None or isinstance(given.value, list):
        root.value["motor"] = Entry(
            [*motors, *(given.value if given else [])], overlay.table.line, shown
        )
    loops = overlay.loop_tables(chain)
    own = root.value.get("loop")
    if loops and (own is None or isinstance(own.value, list)):
        rows = [*loops, *(own.value if own else [])]
        root.value["loop"] = Entry(rows, overlay.table.line, overlay.urdf.file)
    for name, value in overlay.defaults(chain).items():
        root.value.setdefault(name, value)
    return overlay.sources(chain)


class _Overlay:
    """The tables of an overlay and its URDF file."""

    def __init__(self, top: Table, folder: Path) -> None:
        """``top``: the model file with a table [urdf]; ``folder``: of the file, for relative
        paths. Tables of joints and links are checked for names that the URDF has.
        """
        self.top = top
        table = top.table("urdf")
        assert table is not None
        self.table = table
        table.only(*URDF.names)
        path, shown = find_urdf(table, folder)
        self.urdf = Urdf(path, shown)
        with_loops = URDF["loops"].read(table, Context())
        self.closures = find_closures(self.urdf, path) if with_loops else Closures()
        # those that hold the chain, and their joints without a motor: found with the chain
        self.loops: tuple[Closure, ...] = ()
        self.passive: frozenset[str] = frozenset()
        self.limits = URDF["limits"].read(table, Context())
        self.dynamics = URDF["dynamics"].read(table, Context())
        self.joints = self._tables("joint", [*self.urdf.joints, EVERY], JOINT.names)
        self.every = self.joints.pop(EVERY, None)
        if self.every is not None:
            self.every.only(*_EVERY)
        self.links = self._tables("link", list(self.urdf.links), LINK.names)
        named = [(key, self.table.text(key)) for key in ("base", "tip")]
        named += [("branches", link) for link in URDF["branches"].read(self.table, Context())]
        self.ends = tuple(self._end(key, link) for key, link in named)

    def _tables(self, kind: str, known: list[str], keys: Sequence[str]) -> dict[str, Table]:
        """The tables ``[kind.NAME]`` of the overlay by name, which has to be one of ``known``,
        with these keys only.
        """
        outer = self.top.table(kind)
        out: dict[str, Table] = {}
        for name in outer.entries if outer is not None else ():
            assert outer is not None
            if name not in known:
                raise outer.fail(name, among(name, known), f"an unknown {kind} {show(name)}")
            table = outer.table(name)
            assert table is not None
            table.only(*keys)
            out[name] = table
        return out

    # --- the chain -------------------------------------------------------------------------------

    def chain(self) -> Chain:
        """The chain from base to tip, and its branches."""
        base, *tips = self.ends
        locked = self._read_locked()
        dropped = self._read_dropped()
        self._check_unfinished()
        self.loops = loops_of_chain(self.urdf, self.closures, base, tips, dropped, locked)
        self.passive = passive_of_chain(
            self.urdf, self.closures, self.loops, base, self.joints, locked
        )
        motion_of = Motions(self.urdf, locked, self.joints, self.passive)
        hinged = frozenset(
            name
            for name, table in self.joints.items()
            if any(side in table for side in _AT_FIXED) and motion_of(self.urdf.joints[name]).fixed
        )
        held = [link for loop in self.loops for link in loop.links]
        chain = find_chain(self.urdf, base, tips, motion_of, dropped, self._inertial, hinged, held)
        moving = {segment.joint.name for segment in chain.segments}
        for name in (name for tip in tips for name in dropped & self._above(tip)):
            raise self.table.fail("drop", f"joints outside the chain ({show(name)} is part of it)")
        for name, table in self.joints.items():
            if name not in moving:
                given = f"{show(name)}, which does not move"
                raise table.fail(
                    None, f"a moving joint of the chain: {among(name, sorted(moving))}", given
                )
            if name in hinged:
                table.only(*_AT_FIXED)
        named = {segment.link.name for segment in chain.segments} | {tips[0]}
        for name, table in self.links.items():
            if "rename" in table and name not in named:
                expected = (
                    "no new name for a link that is fixed to another one; links that can be "
                    f"renamed: {among(name, sorted(named))}"
                )
                raise table.fail("rename", expected)
        return chain

    def spread(self, chain: Chain) -> None:
        """Add the keys of ``[joint."*"]`` to the tables of joints that no mechanism moves."""
        if self.every is None:
            return
        driven = self.driven
        for segment in chain.moving:
            name = segment.joint.name
            if segment.motion.follows or name in self.passive:
                continue
            own = self.joints.get(name)
            entries = {} if own is None else own.entries
            default = self.every.entries
            if self._find_name("joint", name) in driven:  # by a [[motor]] table
                default = {key: entry for key, entry in default.items() if key != "motor"}
            table = own or self.every
            self.joints[name] = Table(
                self.top.file, Entry(merge(default, entries), table.line, table.file), table.key
            )

    def _end(self, name: str, link: str) -> str:
        if link not in self.urdf.links:
            raise self.table.fail(
                name, f"a link of {self.urdf.file}: {among(link, self.urdf.links)}"
            )
        return link

    def _above(self, link: str) -> set[str]:
        out = set()
        while (holder := self.urdf.parent_joint.get(link)) is not None:
            out.add(holder.name)
            link = holder.parent
        return out

    def _read_locked(self) -> dict[str, float]:
        """Positions of the joints under ``lock``."""
        locked: dict[str, float] = URDF["lock"].read(self.table, Context())
        movable = [joint.name for joint in self.urdf.joints.values() if joint.type in MOVING]
        for name in locked:
            if name not in movable:
                raise self.table.fail("lock", f"{among(name, movable)} instead of {show(name)}")
        return locked

    def _read_dropped(self) -> frozenset[str]:
        """Joints left out with all behind them; an error for a name that the URDF lacks."""
        names = URDF["drop"].read(self.table, Context())
        for name in names:
            if name not in self.urdf.joints:
                raise self.table.fail(
                    "drop", f"{among(name, self.urdf.joints)} instead of {show(name)}"
                )
        return frozenset(names)

    def _check_unfinished(self) -> None:
        """Raise an error that names all links whose bodies are still to be filled in."""
        names = URDF["unfinished"].read(self.table, Context())
        for name in names:
            if name not in self.urdf.links:
                expected = f"{among(name, self.urdf.links)} instead of {show(name)}"
                raise self.table.fail("unfinished", expected)
        empty = [name for name in names if self._inertial(self.urdf.links[name]) is None]
        if empty:
            given = f"bodies without mass: {', '.join(map(show, empty))}"
            expected = (
                "their masses [kg], centers of mass [m] and inertias [kg m^2], which "
                f"{self.urdf.file} does not have, in [link.{bare(empty[0])}] "
                "body = { mass = ..., com = [...], inertia = [...] }"
                + " and so on"
                * (len(empty) > 1)
            )
            raise self.table.fail("unfinished", expected, given)

    def _inertial(self, link: Link) -> Inertial | None:
        """Inertial data of a link: from the overlay where it states a body, else from the URDF.

        Mass [kg], center of mass [m] and inertia tensor [kg m^2] in the link frame. None: the link
        has no mass.

        A tensor is *reduced* where dynamic parameters of links were regrouped: then its largest
        principal moment may exceed the sum of the other two, which no rigid body has. The flag
        ``inertia_reduced`` permits this. The table of a link has it for the tensor of the URDF
        file, and the table ``body`` for its own tensor; a body accepts either.
        """
        link_table = self.links.get(link.name)
        reduced = link_table is not None and LINK["inertia_reduced"].read(link_table, Context())
        if link_table is None or "body" not in link_table:
            return self.urdf.inertial(link, reduced)
        body_table = link_table.table("body")
        assert body_table is not None
        body: Body = LINK["body"].read(link_table, Context())
        if body.mass == 0.0:
            return None
        reduced = reduced or BODY["inertia_reduced"].read(body_table, Context())
        return Inertial(body.mass, np.array(body.com), np.array(body.inertia), reduced)

    # --- the tables of a model file --------------------------------------------------------------

    def elements(self, chain: Chain) -> list[Entry]:
        """An element for each moving joint, and one for the tip if it differs from the last moving
        link; then the ``element`` tables of the overlay, the first one on the tip.
        """
        names = [self._name("link", segment.link.name) for segment in chain.segments]
        out = [self._element(segment, names, k) for k, segment in enumerate(chain.segments)]
        end = chain.carrier
        origin = self._placement(chain.tip, self.table.entries["tip"].line, self.table.file)
        if origin is not None:
            tip = self.urdf.links[self.ends[1]]
            parent = {} if end == len(out) - 1 else {"parent": names[end].value}
            names = [*names, self._name("link", tip.name)]
            end = len(out)
            out.append(self._here({"name": names[end], **parent, "origin": origin}, tip.node.line))
        carried = self._elements_behind(names[end] if end != len(out) - 1 else None)
        if carried:
            return [*out, *carried]
        if end != len(out) - 1:  # branches follow the element that carries the tool
            line = self.table.line
            file = self.table.file
            tool = self.top.entries.setdefault("tool", wrap({}, line, file))
            if isinstance(tool.value, dict):
                tool.value.setdefault("element", wrap(names[end].value, line, file))
        return out

    def _elements_behind(self, tip: Entry | None) -> list[Entry]:
        """The ``element`` tables of the overlay; ``tip``: where it is not the element before."""
        tables = self.top.tables("element", required=False)
        if tables and tip is not None:
            tables[0].entries.setdefault("parent", tip)
        return list(self.top.entries["element"].value) if tables else []

    def _element(self, segment: Segment, names: Sequence[Entry], k: int) -> Entry:
        """The element number ``k`` of the chain as a table of a model file: parent, pose, degrees
        of freedom, body. ``names``: of all elements.
        """
        line = segment.joint.node.line
        value: dict[str, Any] = {"name": names[k]}
        if segment.parent != k - 1:
            value["parent"] = "base" if segment.parent < 0 else names[segment.parent].value
        origin = self._placement(segment.origin, line, self.urdf.file)
        if origin is not None:
            value["origin"] = origin
        table = self.joints.get(segment.joint.name)
        before, after = (_additional_dofs(table, side) for side in ("before", "after"))
        if before and segment.motion.follows and segment.motion.offset != 0.0:
            assert table is not None
            given = "degrees of freedom before a joint that follows others with the offset "
            given += f"{segment.motion.offset:g}"
            raise table.fail("before", "no offset, or degrees of freedom after it", given)
        own = [] if segment.motion.fixed else [self._dof(segment)]
        value["dof"] = Entry([*before, *own, *after], line, self.urdf.file)
        if segment.body is not None:
            value["body"] = self._body(segment.body, segment.link.node.line)
        return self._here(value, line)

    def _dof(self, segment: Segment) -> Entry:
        """The degree of freedom of a joint as a table of a model file: axis and limits of the URDF
        file, and keys of the overlay, which take precedence; a joint that follows others has only
        its factors.
        """
        joint = segment.joint
        table = self.joints.get(segment.joint.name)
        rotary = joint.type != "prismatic"
        value: dict[str, Any] = {
            "name": self._name("joint", joint.name),
            "type": "rotation" if rotary else "translation",
            "axis": self.urdf.axis(joint),
        }
        mimic = self._mimic(segment)
        if mimic is not None:
            return self._here(value | {"mimic": mimic}, joint.node.line)
        if joint.name in self.passive:
            return self._here(value | self._keys_of_passive(segment), joint.node.line)
        limit = self._limit(segment)
        if limit is not None:
            unit = "_rad" if rotary else ""
            for name, number in (
                ("lower" + unit, limit.lower),
                ("upper" + unit, limit.upper),
                ("speed_max", limit.velocity),
            ):
                if number is not None:
                    value[name] = wrap(number, limit.line, self.urdf.file)
        if table is None or "friction" not in table:
            friction = self._friction(segment)
            if friction is not None:
                value["friction"] = friction
        if table is None or not ("gear" in table or "spring" in table):
            value["gear"] = {"type": "rigid"}
        if table is not None:
            for name in JOINT.names:
                if name in DOF.names and name in table:
                    value[name] = table.entries[name]
        return self._here(value, joint.node.line)

    def _keys_of_passive(self, segment: Segment) -> dict[str, Any]:
        """The keys of a joint that closed loops move: its position at home, roughly, and those
        that the overlay has in addition, for the reader to refuse.
        """
        table = self.joints.get(segment.joint.name)
        entries = {} if table is None else table.entries
        if "passive" in entries:
            return {
                name: entries[name]
                for name in JOINT.names
                if name in DOF.names and name in entries
            }
        near = "near" if segment.joint.type == "prismatic" else "near_rad"
        return {"passive": {near: self._home(segment)}}

    def _limit(self, segment: Segment) -> Limit | None:
        """Limits of the URDF file that nothing in the overlay replaces."""
        joint = segment.joint
        table = self.joints.get(segment.joint.name)
        if not self._flag(table, "limits", self.limits):
            return None
        given = set() if table is None else set(table.entries)
        replaced = [
            name
            for name in ("lower", "upper")
            if given & {name + unit for unit in ("", "_rad", "_deg")}
        ]
        motor = table.table("motor") if table is not None else None
        if self._find_name("joint", joint.name) in self.driven or (
            motor is not None and "torque_max" in motor
        ):
            replaced.append("effort")
        if "speed_max" in given:
            replaced.append("velocity")
        return self.urdf.limit(joint, replaced)

    def _mimic(self, segment: Segment) -> Entry | None:
        """Factors of the coordinates that move a joint by a mechanism: those of the overlay, else
        of the URDF file.
        """
        table = self.joints.get(segment.joint.name)
        motion = segment.motion
        if table is not None and "mimic" in table:
            return table.entries["mimic"]
        if not motion.follows:
            return None
        factors = {self._find_name("joint", name): x for name, x in motion.joints.items()}
        return wrap(factors | dict(motion.coordinates), motion.line, self.urdf.file)

    def sources(self, chain: Chain) -> dict[str, UrdfJoint]:
        """The joints of the URDF file by the names of their degrees of freedom."""
        out = {}
        for segment in chain.moving:
            joint = segment.joint
            limits = self.urdf.usable_limits(segment.joint)
            out[self._find_name("joint", joint.name)] = UrdfJoint(
                joint.name,
                segment.motion.offset if segment.motion.follows else 0.0,
                limits.get("lower"),
                limits.get("upper"),
                limits.get("velocity"),
                limits.get("effort"),
            )
        return out

    def _friction(self, segment: Segment) -> Entry | None:
        """Viscous friction of a joint by its element ``<dynamics>``; None without it. Coulomb
        friction is refused, since the model needs its slope near zero speed.
        """
        if not self.dynamics:
            return None
        line, viscous, coulomb = self.urdf.dynamics(segment.joint)
        if coulomb != 0.0:
            name = bare(segment.joint.name)
            raise self._fail(
                line,
                f"{key('joint', segment.joint.name)}.dynamics.friction",
                f"{coulomb:g}",
                f"in the overlay: [joint.{name}] friction = {{ viscous = {viscous:g}, coulomb = "
                f"{coulomb:g}, beta = {BETA[segment.joint.type]:g} }} (smoothed by tanh(beta "
                "speed)), or [urdf] dynamics = false",
            )
        return wrap({"viscous": viscous}, line, self.urdf.file) if viscous != 0.0 else None

    def loop_tables(self, chain: Chain) -> list[Entry]:
        """The closed loops of the chain as tables of a model file; none where both ends are on
        one body, as with locked joints.
        """
        out = []
        for loop in self.loops:
            places = [chain.places[link] for link in loop.links]
            if places[0][0] == places[1][0]:
                continue
            value: dict[str, Any] = {"name": loop_name(loop.name), "type": loop.type}
            for side, (number, pose), frame in zip(
                ("from", "to"), places, loop.poses, strict=True
            ):
                element: str | Entry = "base"
                if number >= 0:
                    element = self._name("link", chain.segments[number].link.name)
                placement = self._placement(pose @ frame, loop.line, loop.file)
                more = {} if placement is None else placement.value
                value[side] = Entry(
                    {"element": wrap(element) if isinstance(element, str) else element} | more,
                    loop.line,
                    loop.file,
                )
            made = {
                name: item if isinstance(item, Entry) else wrap(item, loop.line, loop.file)
                for name, item in value.items()
            }
            out.append(Entry(made, loop.line, loop.file))
        return out

    def motors(self, chain: Chain) -> list[Entry]:
        """A motor for each joint with a gear, except for joints that a ``[[motor]]`` of the
        overlay drives.
        """
        driven = self.driven
        out = []
        count = 0
        for segment in chain.moving:
            joint = segment.joint
            table = self.joints.get(segment.joint.name)
            own = table.table("motor") if table is not None else None
            name = self._find_name("joint", joint.name)
            way = self._way_without_motor(segment)
            if way:
                if table is not None and own is not None:
                    raise table.fail(
                        "motor",
                        f"either a motor or a {way} (non-actuated)",
                        f"both a motor and a {way}",
                    )
                continue
            count += 1
            if name in driven:
                if own is not None:
                    assert table is not None
                    raise table.fail(
                        "motor",
                        "either motor or a [[motor]] table",
                        f"both a motor and a [[motor]] of {show(name)}",
                    )
                continue
            value: dict[str, Any] = {"name": f"m{count}", "drives": name, "ratio": 1.0}
            if table is not None and _elastic(table):
                if own is None or "inertia" not in own:
                    expected = (
                        "motor = { ratio = ..., inertia = ... } together with an elastic gear"
                    )
                    raise (own or table).fail("inertia" if own else "motor", expected)
            else:
                value["inertia"] = 0.0
            if own is not None:
                if "drives" in own:
                    raise own.fail("drives", f"no key drives (this motor drives {name})")
                value |= own.entries
            limit = self._limit(segment)
            effort = None if limit is None else limit.effort
            ratio = value["ratio"]
            number = as_number(ratio.value if isinstance(ratio, Entry) else ratio)
            if limit is not None and effort is not None and number and "torque_max" not in value:
                value["torque_max"] = wrap(effort / abs(number), limit.line, self.urdf.file)
            entry = self._here(value, joint.node.line)
            if own is not None:
                entry.file = own.file
                entry.line = own.line
            out.append(entry)
        return out

    def _way_without_motor(self, segment: Segment) -> str:
        """The key of what moves a joint instead of a motor; empty for a joint with one."""
        table = self.joints.get(segment.joint.name)
        if self._mimic(segment) is not None:
            return "mimic"
        if segment.joint.name in self.passive:
            return "passive"
        return "spring" if table is not None and "spring" in table else ""

    @cached_property
    def driven(self) -> frozenset[str]:
        """Names of joints that the ``[[motor]]`` tables drive."""
        return frozenset(self._find_driven())

    def _find_driven(self) -> Iterator[str]:
        """Names of joints that the ``[[motor]]`` tables drive; the reader reports wrong tables."""
        entry = self.top.entries.get("motor")
        for motor in entry.value if entry is not None and isinstance(entry.value, list) else ():
            drives = motor.value.get("drives") if isinstance(motor.value, dict) else None
            if drives is None:
                continue
            for item in drives.value if isinstance(drives.value, list) else [drives]:
                if isinstance(item.value, str):
                    yield item.value

    def defaults(self, chain: Chain) -> dict[str, Entry]:
        """Defaults for the keys that an overlay may omit."""
        file = self.urdf.file
        table = self.table
        out: dict[str, Any] = {}
        if "name" not in self.top:
            problem = c_name_problem(self.urdf.name)
            if problem is not None:
                what = f"a name for the robot that URDF calls {show(self.urdf.name)}: {problem}"
                raise self.top.fail(
                    "name", f"{what} ('flexgen new NAME --urdf FILE' writes a file with one)"
                )
            out["name"] = self.urdf.name
        out["description"] = (
            f"from {show(self.ends[0])} to {show(self.ends[1])} of {Path(file).name}"
        )
        out["gravity"] = [0.0, 0.0, -9.81]
        actuated = [s for s in chain.moving if not self._way_without_motor(s)]
        out["output"] = {
            "type": "joint",
            "joints": [self._find_name("joint", s.joint.name) for s in actuated],
        }
        if "home_deg" not in self.top and "home_rad" not in self.top:
            out["home_rad"] = [self._home(segment) for segment in actuated]
        return {name: wrap(value, table.line, table.file) for name, value in out.items()}

    def _home(self, segment: Segment) -> float:
        """Home of a joint [rad or m]: zero, or the middle between its limits if zero is outside of
        them; a single limit where there is only one.
        """
        table = self.joints.get(segment.joint.name)
        limit = self._limit(segment)
        ends: dict[str, float | None] = {"lower": None, "upper": None}
        if limit is not None:
            ends = {"lower": limit.lower, "upper": limit.upper}
        if table is not None:
            for name in ends:
                if name in table:
                    ends[name] = table.number(name)
                elif table.unit_key(name, required=False):
                    ends[name] = table.angle(name)
        lower = ends["lower"]
        upper = ends["upper"]
        if (lower is None or lower <= 0.0) and (upper is None or upper >= 0.0):
            return 0.0
        if lower is not None and upper is not None:
            return (lower + upper) / 2
        return lower if lower is not None and lower > 0.0 else upper or 0.0

    # --- entries ---------------------------------------------------------------------------------

    def _fail(self, line: int, where: str, given: str, expected: str) -> ModelError:
        return ModelError(self.urdf.file, line, where, given, expected)

    def _flag(self, table: Table | None, name: str, default: bool) -> bool:
        return table.flag(name) if table is not None and name in table else default

    def _find_name(self, kind: str, name: str) -> str:
        """Name of a link or joint in the model: ``rename`` of the overlay, else the name in the
        URDF file.
        """
        table = (self.joints if kind == "joint" else self.links).get(name)
        if table is not None and "rename" in table:
            renamed: str = _RENAME.read(table, Context())
            return renamed
        problem = identifier_problem(name)
        if kind == "link" and name == "base":
            problem = "another name (base is the ground)"
        if problem is not None:
            node = (self.urdf.joints if kind == "joint" else self.urdf.links)[name].node
            expected = f'{problem} (in the overlay: [{kind}.{bare(name)}] rename = "...")'
            raise self._fail(node.line, f"{key(kind, name)}.name", show(name), expected)
        return name

    def _name(self, kind: str, name: str) -> Entry:
        """Name of a link or joint in the model, as the entry that states it."""
        table = (self.joints if kind == "joint" else self.links).get(name)
        if table is not None and "rename" in table:
            _RENAME.read(table, Context())
            return table.entries["rename"]
        node = (self.urdf.joints if kind == "joint" else self.urdf.links)[name].node
        return Entry(self._find_name(kind, name), node.line, self.urdf.file)

    def _here(self, value: dict[str, Any], line: int) -> Entry:
        """A table with the position of a line of the URDF file; values that already are Entries
        stay unchanged.
        """
        file = self.urdf.file
        made = {
            name: item if isinstance(item, Entry) else wrap(item, line, file)
            for name, item in value.items()
        }
        return Entry(made, line, file)

    def _placement(self, pose: Pose, line: int, file: str) -> Entry | None:
        """A placement table; None for the identity."""
        value: dict[str, Any] = {}
        position = zero_tiny(pose.position.tolist())
        if any(position):
            value["position"] = position
        if (pose.rotation != np.eye(3)).any():
            value["rotation"] = zero_tiny(pose.rotation.ravel().tolist())
        return wrap(value, line, file) if value else None

    def _body(self, body: Inertial, line: int) -> Entry:
        """A body table."""
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = body.inertia.tolist()
        moments = zero_tiny([xx, yy, zz, xy, yz, xz])
        value = {"mass": body.mass, "com": zero_tiny(body.com.tolist()), "inertia": moments}
        entry = wrap(value, line, self.urdf.file)
        low, middle, high = np.linalg.eigvalsh(body.inertia).tolist()
        # already checked with the tolerance for URDF files
        if body.reduced or low + middle < high:
            entry.value["inertia_reduced"] = wrap(True, line, self.urdf.file)
        return entry


def _additional_dofs(table: Table | None, side: str) -> list[Entry]:
    """Additional degrees of freedom that an overlay puts ``before`` or ``after`` a joint.

    Such as the elastic coordinates of its bearing: they move about the same point. ``table``: of
    the joint in the overlay. Empty: the overlay has no table for the joint, or none on this side.
    """
    if table is None or side not in table:
        return []
    # Only checks the value: an error where it is not a list of tables. The entries themselves are
    # copied into the model, since they carry the lines of the file for later errors.
    table.tables(side)
    entries: list[Entry] = table.entries[side].value
    return entries


def _elastic(table: Table) -> bool:
    """Whether the gear of a joint is elastic; the reader reports a wrong gear."""
    gear = table.entries.get("gear")
    kind = gear.value.get("type") if gear is not None and isinstance(gear.value, dict) else None
    return kind is not None and kind.value == "elastic"
