"""Readers of ``[[program]]`` tables: sequences of MoveJ, MoveL and MoveC with speeds and zones."""

from __future__ import annotations

import math
from collections.abc import Sequence

from flexgen.model.checked_table import Table
from flexgen.model.component_tables import rotation_matrix
from flexgen.model.elements import Coordinate, Matrix, Output
from flexgen.model.moves import MoveC, MoveJ, MoveL, Program, Step
from flexgen.model.programs.targets import POSE_KEYS, read_configuration, read_target
from flexgen.model.task_tables import position_in_file, read_joint_position, read_profile, read_radius, read_rotation

_TOOL = ("tool_position", "tool_pose")
_ENDS = ("displacement", "position", "rotation_rad", "rotation_deg", "rpy_rad", "rpy_deg", "speed", "zone", "pause")
_KEYS = {
    "MoveJ": ("end_rad", "end_deg", *POSE_KEYS, "speed_rad", "speed_deg", "zone_rad", "zone_deg", "pause"),
    "MoveL": (*_ENDS, "configuration"),
    "MoveC": ("via", *_ENDS, "configuration"),
}


def read_programs(
    root: Table, target: Output, actuated: Sequence[Coordinate], taken: Sequence[str] = ()
) -> tuple[Program, ...]:
    """Read the programs of a file; their names must not be in ``taken``."""
    out: list[Program] = []
    for table in root.tables("program", required=False):
        table.only(
            "name",
            "start_rad",
            "start_deg",
            "profile",
            "joint_profile_rad",
            "joint_profile_deg",
            "smoothness",
            "radius",
            "step",
        )
        name = table.name(taken=[*taken, *(program.name for program in out)])
        start = read_joint_position(table, "start", actuated)
        bounds, bounds_j = read_profile(table, "profile"), _joint_profile(table, actuated)
        smoothness = table.whole("smoothness", 3, 9) if "smoothness" in table else 0
        size = read_radius(table)
        tables = table.tables("step")
        steps = tuple(_step(step, target, actuated) for step in tables)
        for kind, given, key in ((MoveL, bounds, "profile"), (MoveJ, bounds_j, "joint_profile_rad")):
            if not given and any(isinstance(step, kind) for step in steps):
                first = next(step for step in steps if isinstance(step, kind))
                which = type(first).__name__
                raise table.fail(key, f"bounds on speed, acceleration, ... of the steps {which}", "nothing")
        _zones(tables, steps)
        out.append(
            Program(
                name,
                start=start,
                steps=steps,
                profile=bounds,
                joint_profile=bounds_j,
                smoothness=smoothness,
                radius=size,
                where=position_in_file(table),
            )
        )
    return tuple(out)


def _joint_profile(table: Table, actuated: Sequence[Coordinate]) -> tuple[float, ...]:
    key = table.unit_key("joint_profile", required=False)
    if key is None:
        return ()
    if key.endswith("_deg") and not all(c.unit == "rad" for c in actuated):
        raise table.fail(key, "joint_profile_rad, because some coordinates are lengths [m]")
    return read_profile(table, key, math.radians(1.0) if key.endswith("_deg") else 1.0)


def _zones(tables: Sequence[Table], steps: Sequence[Step]) -> None:
    """Raise an error for a zone where the robot has to stop."""
    for k, (table, step) in enumerate(zip(tables, steps, strict=True)):
        key = "zone" if "zone" in table else (table.unit_key("zone", required=False) or "zone")
        if step.zone > 0 and k + 1 == len(steps):
            raise table.fail(key, "no zone, or 0, at the end of the program")
        if step.zone > 0 and step.pause > 0:
            raise table.fail("pause", "no pause in a step with a zone")
        if step.zone > 0 and steps[k + 1].space != step.space:
            raise table.fail(key, "no zone, or 0, between a MoveJ and a move of the tool: the robot has to stop there")


def _step(table: Table, target: Output, actuated: Sequence[Coordinate]) -> Step:
    table.only("type", *(key for keys in _KEYS.values() for key in keys))
    kind = table.choice("type", tuple(_KEYS))
    table.only("type", *_KEYS[kind])
    pause = table.number("pause", 0.0, least=0.0)
    if kind == "MoveJ":
        return _joints(table, actuated, pause)
    if target.type not in _TOOL:
        raise table.fail("type", "MoveJ, because the output is not the tool's position or pose")
    if "displacement" in table and "position" in table:
        raise table.fail("position", "either displacement or position", "both")
    absolute = "position" in table
    origin = "world axes and origin" if absolute else "world axes, from where the step begins"
    end = table.vector("position" if absolute else "displacement", 3, what=f"m, {origin}")
    rotated, orientation = read_rotation(table, target), _orientation(table, target)
    speed, zone = table.optional("speed", above=0.0), table.number("zone", 0.0, least=0.0)
    place = {"position": end} if absolute else {"displacement": end}
    given = {"rotation": rotated, "orientation": orientation, "speed": speed, "zone": zone, "pause": pause, **place}
    given["configuration"] = read_configuration(table)
    if kind == "MoveL":
        return MoveL(where=position_in_file(table), **given)  # type: ignore[arg-type]
    via = table.vector("via", 3, what=f"m, {origin}")
    return MoveC(via=via, where=position_in_file(table), **given)  # type: ignore[arg-type]


def _joints(table: Table, actuated: Sequence[Coordinate], pause: float) -> MoveJ:
    def size(stem: str) -> float | None:
        key = table.unit_key(stem, required=False)
        if key is None:
            return None
        if key.endswith("_deg") and not all(c.unit == "rad" for c in actuated):
            raise table.fail(key, f"{stem}_rad, because some coordinates are lengths [m]")
        value = table.number(key, least=0.0) if stem == "zone" else table.number(key, above=0.0)
        return math.radians(value) if key.endswith("_deg") else value

    target = read_target(table, actuated)
    end = () if target is not None else read_joint_position(table, "end", actuated)
    return MoveJ(end, size("speed"), size("zone") or 0.0, pause, position_in_file(table), target)


def _orientation(table: Table, target: Output) -> Matrix:
    """Orientation of the tool at the end of a step as a matrix in world axes; empty if it is not given."""
    key = table.unit_key("rpy", required=False)
    if key is None:
        return ()
    if target.type != "tool_pose":
        raise table.fail(key, 'no orientation, or an output of type "tool_pose"')
    other = table.unit_key("rotation", required=False)
    if other is not None:
        raise table.fail(key, "either rotation or rpy", f"both {other} and {key}")
    return rotation_matrix(table.vector(key, 3, what="roll, pitch, yaw"), key.endswith("_deg"))
