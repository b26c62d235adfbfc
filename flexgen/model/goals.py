"""Tables of a model file to what a robot is asked to do: its home, its outputs and its reference moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexgen.model.check import Table, closest
from flexgen.model.elements import ZERO, Coordinate, Move, Output

_TOOL = ("tool_position", "tool_pose")


def output(table: Table, coordinates: Sequence[Coordinate]) -> Output:
    """What a reference prescribes; joints become a combination."""
    table.only("type", "axes", "joints", "rows", "unit")
    kind = table.choice("type", (*_TOOL, "joint", "combination"))
    extra = {"tool_position": ("axes",), "tool_pose": (), "joint": ("joints",), "combination": ("rows", "unit")}
    table.only("type", *extra[kind])
    if kind == "tool_position":
        axes = table.text("axes", "xyz")
        if not axes or axes != "".join(axis for axis in "xyz" if axis in axes):
            raise table.fail("axes", 'some of "xyz", in this order')
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
            raise row.fail(None, "a weight that is not 0")
    scaled = np.array(rows) / np.abs(rows).max(axis=1, keepdims=True)
    if np.linalg.matrix_rank(scaled, tol=1e-9) < len(rows):
        raise table.fail("rows", "rows that do not depend on each other")
    return Output("combination", "", tuple(rows), table.choice("unit", ("m", "rad", "mixed")))


def posture(table: Table, stem: str, actuated: Sequence[Coordinate]) -> tuple[float, ...]:
    """Actuated coordinates under ``stem_rad`` or ``stem_deg``, within their limits."""
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


def moves(root: Table, target: Output, actuated: Sequence[Coordinate]) -> tuple[Move, ...]:
    """The named reference moves; each must fit what the output prescribes."""
    common = ("name", "type", "start_rad", "start_deg", "duration", "smoothness")
    extra = {
        "tool_line": ("displacement", "rotation_rad", "rotation_deg"),
        "joint": ("end_rad", "end_deg"),
        "output_line": ("displacement",),
    }
    out: list[Move] = []
    for table in root.tables("move", required=False):
        table.only(*common, *(key for keys in extra.values() for key in keys))
        name = table.name(taken=[move.name for move in out])
        kind = table.choice("type", tuple(extra))
        table.only(*common, *extra[kind])
        if kind == "tool_line" and target.type not in _TOOL:
            raise table.fail("type", "joint or output_line, because the output is not the tool's position or pose")
        if kind == "output_line" and target.type in _TOOL:
            raise table.fail("type", "joint or tool_line, because the output is the tool's position or pose")
        if kind == "tool_line" and table.unit_key("rotation", required=False) and target.type != "tool_pose":
            raise table.fail(table.unit_key("rotation") or "", 'no rotation, or an output of type "tool_pose"')
        size = 3 if kind == "tool_line" else target.size
        what = "m, world axes" if kind == "tool_line" else "one for each output"
        out.append(
            Move(
                name,
                kind,
                posture(table, "start", actuated),
                table.number("duration", above=0.0),
                table.whole("smoothness", 3, 9),
                displacement=() if kind == "joint" else table.vector("displacement", size, what=what),
                rotation=table.angles("rotation", (True,) * 3, ZERO) if kind == "tool_line" else ZERO,
                end=posture(table, "end", actuated) if kind == "joint" else (),
            )
        )
    return tuple(out)
