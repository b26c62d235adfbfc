"""Readers of the tables that describe tasks: home position, output and reference moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from flexgen.model.checked_table import Table, closest
from flexgen.model.elements import ZERO, Coordinate, Output
from flexgen.model.moves import DEGREES, RADIUS, Move, MoveC, MoveL, Where
from flexgen.model.programs.targets import POSE_KEYS, read_target

PROFILE_MAX = 8  # number of bounds: the speed and seven of its derivatives

_TOOL = ("tool_position", "tool_pose")


def read_output(table: Table, coordinates: Sequence[Coordinate]) -> Output:
    """Read the output; joints become a combination."""
    table.only("type", "axes", "joints", "rows", "unit")
    kind = table.choice("type", (*_TOOL, "joint", "combination"))
    extra = {"tool_position": ("axes",), "tool_pose": (), "joint": ("joints",), "combination": ("rows", "unit")}
    table.only("type", *extra[kind])
    if kind == "tool_position":
        axes = table.text("axes", "xyz")
        if not axes or axes != "".join(axis for axis in "xyz" if axis in axes):
            raise table.fail("axes", 'one or more letters of "xyz", in this order')
        return Output(kind, axes)
    if kind == "tool_pose":
        return Output(kind, unit="mixed")
    units = {coordinate.name: coordinate.unit for coordinate in coordinates}
    if kind == "joint":
        joints = table.words("joints")
        for name in joints:
            if name not in units:
                raise table.fail("joints", closest(name, units))
        used = {units[name] for name in joints}
        weights = tuple(tuple(float(name == joint) for name in units) for joint in joints)
        return Output("combination", "", weights, used.pop() if len(used) == 1 else "mixed")
    rows = []
    for row in table.tables("rows"):
        row.only(*units)
        rows.append(tuple(row.number(name, 0.0) for name in units))
        if not any(rows[-1]):
            raise row.fail(None, "at least one weight that is not 0")
    scaled = np.array(rows) / np.abs(rows).max(axis=1, keepdims=True)
    if np.linalg.matrix_rank(scaled, tol=1e-9) < len(rows):
        raise table.fail("rows", "linearly independent rows")
    return Output("combination", "", tuple(rows), table.choice("unit", ("m", "rad", "mixed")))


def read_joint_position(table: Table, stem: str, actuated: Sequence[Coordinate]) -> tuple[float, ...]:
    """Read the actuated coordinates under ``stem_rad`` or ``stem_deg``, which must be within their limits."""
    names = ", ".join(c.name for c in actuated)
    values = table.angles(stem, [c.unit == "rad" for c in actuated], what=f"the actuated coordinates {names}")
    for c, value in zip(actuated, values, strict=True):
        lower = c.dof.lower if c.dof is not None else None
        upper = c.dof.upper if c.dof is not None else None
        slack = 1e-12 * (1.0 + abs(value))
        if (lower is not None and value < lower - slack) or (upper is not None and value > upper + slack):
            low = "-inf" if lower is None else f"{lower:.6g}"
            high = "inf" if upper is None else f"{upper:.6g}"
            key = table.unit_key(stem)
            given = f"{c.name} = {value:.6g} {c.unit}"
            raise table.fail(key or stem, f"{c.name} within its limits {low}..{high} {c.unit}", given)
    return values


def position_in_file(table: Table) -> Where:
    """Position of a table in its file, for later messages."""
    return Where(table.file, table.line, table.key, tuple((key, e.line) for key, e in table.entries.items()))


def read_profile(table: Table, key: str, scale: float = 1.0) -> tuple[float, ...]:
    """Read bounds on speed, acceleration, jerk, ...; empty if the key is missing."""
    if key not in table:
        return ()
    what = "bounds on speed, acceleration, jerk, ..."
    values = table.vector(key, range(2, PROFILE_MAX + 1), what=what)
    if not all(value > 0 for value in values):
        raise table.fail(key, "numbers > 0")
    return tuple(scale * value for value in values)


def _time(table: Table, kind: str) -> tuple[float, int, tuple[float, ...]]:
    """Read duration, smoothness and profile of a move; all may be missing for samples with their own time."""
    bounds = read_profile(table, "profile")
    if bounds:
        if "duration" in table:
            raise table.fail("duration", "either duration or profile (which determines the duration)", "both")
        return 0.0, table.whole("smoothness", 3, 9) if "smoothness" in table else 0, bounds
    if kind == "sampled" and "duration" not in table and "smoothness" not in table:
        return 0.0, 0, ()
    return table.number("duration", above=0.0), table.whole("smoothness", 3, 9), ()


def read_rotation(table: Table, target: Output) -> tuple[float, ...]:
    """Read the rotation vector of a move of the tool [rad]."""
    key = table.unit_key("rotation", required=False)
    if key and target.type != "tool_pose":
        raise table.fail(key, 'no rotation, or an output of type "tool_pose"')
    return table.angles("rotation", (True,) * 3, ZERO)


def read_radius(table: Table) -> float:
    """Read the radius that converts a rotation of the tool into a path length [m]."""
    return table.number("radius", RADIUS, above=0.0)


def _legs(table: Table, target: Output) -> tuple[MoveL, ...]:
    """Read the lines and arcs of a polyline."""
    out: list[MoveL] = []
    legs = table.tables("legs")
    for k, leg in enumerate(legs):
        leg.only("displacement", "via", "rotation_rad", "rotation_deg", "zone", "speed")
        if k + 1 == len(legs) and "zone" in leg:
            raise leg.fail("zone", "no zone in the last leg")
        if "speed" in leg and "profile" not in table:
            raise leg.fail("speed", "no speed, or a profile of the move")
        way = leg.vector("displacement", 3, what="m, world axes, from the start of the leg")
        speed, zone = leg.optional("speed", above=0.0), leg.number("zone", above=0.0) if k + 1 < len(legs) else 0.0
        line = MoveL(way, rotation=read_rotation(leg, target), speed=speed, zone=zone, where=position_in_file(leg))
        if "via" in leg:
            via = leg.vector("via", 3, what="m, world axes, from the start of the leg")
            line = MoveC(way, rotation=line.rotation, speed=speed, zone=zone, where=line.where, via=via)
        out.append(line)
    return tuple(out)


def _samples(table: Table) -> str:
    """Read the path of a file of samples, relative to the file that names it."""
    text = table.text("file")
    path = Path(table.entries["file"].file or table.file).parent / text
    try:
        there = path.suffix in (".csv", ".npz") and path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        there = False
    if not there:
        raise table.fail("file", "the path of a .csv or .npz file, relative to the folder of this file")
    return str(path)


def read_moves(root: Table, target: Output, actuated: Sequence[Coordinate]) -> tuple[Move, ...]:
    """Read the reference moves; each must fit the output."""
    common = ("name", "type", "start_rad", "start_deg", "duration", "smoothness", "profile")
    turning = ("rotation_rad", "rotation_deg", "radius")
    extra = {
        "tool_line": ("displacement", *turning),
        "tool_circle": ("center", "axis", "angle_rad", "angle_deg", *turning),
        "tool_polyline": ("legs", "radius"),
        "sampled": ("file", "degree", "radius"),
        "joint": ("end_rad", "end_deg", *POSE_KEYS),
        "output_line": ("displacement",),
    }
    out: list[Move] = []
    for table in root.tables("move", required=False):
        table.only(*common, *(key for keys in extra.values() for key in keys))
        name = table.name(taken=[move.name for move in out])
        kind = table.choice("type", tuple(extra))
        table.only(*common, *extra[kind])
        if kind.startswith("tool") and target.type not in _TOOL:
            raise table.fail("type", "joint or output_line, because the output is not the tool's position or pose")
        if kind == "output_line" and target.type in _TOOL:
            raise table.fail("type", "joint or tool_line, because the output is the tool's position or pose")
        started = kind != "sampled" or table.unit_key("start", required=False)
        start = read_joint_position(table, "start", actuated) if started else ()
        duration, smoothness, bounds = _time(table, kind)
        move = Move(name, kind, start, duration, smoothness, profile=bounds, where=position_in_file(table))
        if kind.startswith("tool") or kind == "sampled":
            move = replace(move, radius=read_radius(table))
        if kind == "tool_line":
            way = table.vector("displacement", 3, what="m, world axes")
            move = replace(move, displacement=way, rotation=read_rotation(table, target))
        elif kind == "tool_circle":
            move = _circle(table, move, target)
        elif kind == "tool_polyline":
            move = replace(move, legs=_legs(table, target))
        elif kind == "sampled":
            degree = int(table.number("degree", 7.0))
            if "degree" in table and table.entries["degree"].value not in DEGREES:
                raise table.fail("degree", "one of " + ", ".join(map(str, DEGREES)))
            move = replace(move, file=_samples(table), degree=degree)
        elif kind == "joint":
            pose = read_target(table, actuated)
            end = () if pose is not None else read_joint_position(table, "end", actuated)
            move = replace(move, end=end, target=pose)
        else:
            move = replace(move, displacement=table.vector("displacement", target.size, what="one number per output"))
        out.append(move)
    return tuple(out)


def _circle(table: Table, move: Move, target: Output) -> Move:
    """Read an arc about a center."""
    center, axis = table.vector("center", 3, what="m, world axes, from the start"), table.axis("axis")
    off = np.array(center) - np.dot(center, axis) * np.array(axis)
    if not np.linalg.norm(off) > 1e-9 * (1.0 + float(np.linalg.norm(center))):
        raise table.fail("center", "a center that is not on the axis through the start")
    angle = table.angle("angle")
    if not angle:
        key = table.unit_key("angle")
        raise table.fail(key, "an angle that is not 0")
    return replace(move, center=center, axis=axis, angle=angle, rotation=read_rotation(table, target))
