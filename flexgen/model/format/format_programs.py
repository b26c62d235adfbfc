"""Rows of the tables of programs: sequences of MoveJ, MoveL and MoveC with speeds and zones."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

from flexgen.base.spec.keys import (
    REQUIRED,
    Context,
    Format,
    Key,
    Kinds,
    Type,
    listed,
    name,
    number,
    vector,
    whole,
)
from flexgen.base.spec.tables import Table
from flexgen.model.elements import Matrix
from flexgen.model.format.format_robot import RPY
from flexgen.model.format.format_tasks import (
    BOUNDS,
    CONFIGURATION,
    FRAME_KEY,
    FRAME_OF_STEP,
    PROFILE,
    RADIUS_KEY,
    TOOL,
    check_end,
    end_of_joints,
    joint_factor,
    joint_position,
    only_of_a_pose,
    read_profile,
    rotation,
    step_in_frame,
    with_target,
)
from flexgen.model.moves import MoveC, MoveJ, MoveL, Program, WorkFrame


def _check_place(table: Table, here: Context) -> None:
    if here.of_file("output").type not in TOOL:
        raise table.fail("type", "MoveJ, because the output is not the tool's position or pose")
    if "displacement" in table and "position" in table:
        raise table.fail("position", "either displacement or position", "both")


def _read_orientation(table: Table, key: Key, here: Context) -> Matrix:
    """Orientation of the tool at the end of a step as a matrix in world axes."""
    only_of_a_pose(table, key, "orientation", here)
    other = table.unit_key("rotation", required=False)
    if other is not None:
        full = table.unit_key(key.name)
        raise table.fail(full, "either rotation or rpy", f"both {other} and {full}")
    orientation: Matrix = RPY.read(table, key, here)
    return orientation


def _of_joints(kind: Type) -> Type:
    """A number in rad or m, of all joints."""

    def read_size(table: Table, key: Key, here: Context) -> float:
        full = table.unit_key(key.name) or ""
        factor = joint_factor(table, full, key.name, here)
        value: float = kind.read(table, replace(key, name=full), here)
        return math.radians(value) if factor != 1.0 else value

    return Type(read_size, kind.schema, angle=True)


def _unless_position(table: Table, here: Context) -> Any:
    return () if "position" in table else REQUIRED


_OF_STEP = "m, world axes, from where the step begins"
_OF_WORLD = "m, world axes and origin"
_RPY = Type(_read_orientation, vector(3).schema, angle=True)
_PAUSE = Key("pause", number(least=0.0), "pause after the step", "s", 0.0)
_LINE = (
    FRAME_OF_STEP,
    replace(_PAUSE, check=_check_place),
    Key(
        "displacement",
        vector(3),
        "from where the step begins, world axes",
        "m",
        _unless_position,
        _OF_STEP,
    ),
    Key("position", vector(3), "where the step ends, in the world", "m", (), _OF_WORLD),
    rotation("rotation vector in this step, world axes"),
    Key(
        "rpy",
        _RPY,
        "orientation at the end, world axes: roll, pitch, yaw",
        "rad",
        (),
        attribute="orientation",
    ),
    Key("speed", number(above=0.0), "largest speed of the tool", "m/s", None),
    Key(
        "zone",
        number(least=0.0),
        "distance from the end at which the rounding to the next step begins",
        "m",
        0.0,
    ),
    CONFIGURATION,
)
_VIA = Type(
    lambda table, key, here: table.vector(
        key.name, 3, what=_OF_WORLD if "position" in table else _OF_STEP
    ),
    vector(3).schema,
)
_SPEED = _of_joints(number(above=0.0))
_ZONE = _of_joints(number(least=0.0))
_VIA_KEY = Key("via", _VIA, "point of the arc; same origin as the end", "m")
STEP = Kinds(
    "step",
    {
        "MoveJ": Format(
            "line in the joint coordinates",
            (
                FRAME_OF_STEP,
                replace(_PAUSE, check=check_end),
                *end_of_joints("where the step ends"),
                Key("speed", _SPEED, "largest joint speed", "rad/s", None),
                Key(
                    "zone", _ZONE, "distance from the end at which the rounding begins", "rad", 0.0
                ),
            ),
            make=partial(step_in_frame, partial(with_target, MoveJ)),
            where=True,
        ),
        "MoveL": Format("line of the tool", _LINE, partial(step_in_frame, MoveL), where=True),
        "MoveC": Format(
            "arc of the tool", (*_LINE, _VIA_KEY), partial(step_in_frame, MoveC), where=True
        ),
    },
)


def _check_steps(table: Table, here: Context) -> None:
    """Raise an error for steps without bounds, and for a zone where the robot has to stop."""
    steps = here.values["step"]
    tables = table.tables("step")
    for kind, key, full in (
        (MoveL, "profile", "profile"),
        (MoveJ, "joint_profile", "joint_profile_rad"),
    ):
        first = next((step for step in steps if isinstance(step, kind)), None)
        if not here.values[key] and first is not None:
            which = type(first).__name__
            raise table.fail(
                full, f"bounds on speed, acceleration, ... of the steps {which}", "nothing"
            )
    for k, (inner, step) in enumerate(zip(tables, steps, strict=True)):
        full = "zone" if "zone" in inner else (inner.unit_key("zone", required=False) or "zone")
        if step.zone > 0 and k + 1 == len(steps):
            raise inner.fail(full, "no zone, or 0, at the end of the program")
        if step.zone > 0 and step.pause > 0:
            raise inner.fail("pause", "no pause in a step with a zone")
        if step.zone > 0 and steps[k + 1].space != step.space:
            raise inner.fail(
                full,
                "no zone, or 0, between a MoveJ and a move of the tool: the robot has to stop "
                "there",
            )


def _make_program(frame: WorkFrame | None, **values: Any) -> Program:
    """A program; its steps are in world axes already."""
    return Program(**values)


_OF_MOVEJ = "bounds on joint speed, acceleration, jerk, ... of MoveJ"
PROGRAM = Format(
    "program",
    (
        Key("name", name("move"), "name of the program"),
        replace(FRAME_KEY, doc="frame in which the steps are stated that name no other"),
        joint_position("start", "where the program starts"),
        replace(PROFILE, doc=f"of MoveL and MoveC: {PROFILE.doc}"),
        Key("joint_profile", Type(read_profile, BOUNDS, angle=True), _OF_MOVEJ, "rad/s, ...", ()),
        Key(
            "smoothness",
            whole(3, 9),
            "number of continuous derivatives of the speed changes",
            default=0,
        ),
        RADIUS_KEY,
        Key("step", listed(STEP), "steps in their order", check=_check_steps),
    ),
    make=_make_program,
    where=True,
)
