"""Rows of the tables that describe tasks: home position, output, reference moves and programs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.spec.keys import (
    REQUIRED,
    Check,
    Context,
    Format,
    Key,
    Kinds,
    Type,
    among,
    angle,
    choice,
    direction,
    list_of,
    listed,
    name,
    number,
    sub,
    text,
    vector,
    whole,
    words,
)
from flexgen.base.spec.tables import Table, closest, show
from flexgen.model.elements import (
    OF_ROTATION,
    ZERO,
    Coordinate,
    Matrix,
    Output,
    Vector,
    coordinates_of,
)
from flexgen.model.format.format_robot import PLACEMENT, RPY
from flexgen.model.moves import (
    DEGREES,
    RADIUS,
    TOOL_MOVES,
    Carrier,
    Move,
    MoveC,
    MoveL,
    PoseTarget,
    Posture,
    WorkFrame,
)

PROFILE_MAX = 8  # number of bounds: the speed and seven of its derivatives
MOST_TURNS = 100
MISSING = "no frame, or a table [[frame]] with this name"
FLAT = 1e-9  # largest change of the axis of an output by a frame that is not tilted
TOOL = ("tool_position", "tool_position_angle", "tool_pose")
TURNING = ("tool_position_angle", "tool_pose")  # with a rotation


# --- output --------------------------------------------------------------------------------------


def _check_axes(table: Table, here: Context) -> None:
    axes = here.values["axes"]
    if not axes or axes != "".join(axis for axis in "xyz" if axis in axes):
        raise table.fail("axes", 'one or more letters of "xyz", in this order')


def _read_joints(table: Table, key: Key, here: Context) -> Output:
    """The output of named joints: a combination with weight 1 for each."""
    units = {
        coordinate.name: coordinate.unit for coordinate in coordinates_of(here.of_file("element"))
    }
    joints = table.words(key.name)
    for joint in joints:
        if joint not in units:
            raise table.fail(key.name, closest(joint, units))
    used = {units[joint] for joint in joints}
    weights = tuple(tuple(float(one == joint) for one in units) for joint in joints)
    return Output("combination", "", weights, used.pop() if len(used) == 1 else "mixed")


def _read_further(table: Table, key: Key, here: Context) -> Matrix:
    """The weights (k, n_a) of actuated coordinates that are outputs after those of the tool."""
    coordinates = coordinates_of(here.of_file("element"))
    actuated = [c.name for c in coordinates if c.actuated]
    joints = table.words(key.name)
    for joint in joints:
        if joint not in actuated:
            raise table.fail(key.name, closest(joint, actuated))
    return tuple(tuple(float(c.name == joint) for c in coordinates) for joint in joints)


def _read_posture(table: Table, key: Key, here: Context) -> Posture:
    """The rule by which a move chooses the joints that the tool leaves free."""
    names = [c.name for c in list_actuated(here)]
    inner = table.table(key.name)
    assert inner is not None  # the key is there
    inner.only("joints", "weights")
    parts: dict[str, dict[str, float]] = {"joints": {}, "weights": {}}
    for part, found in parts.items():
        own = inner.table(part)
        if own is not None:
            own.only(*names)
            found.update((name, own.number(name)) for name in names if name in own)
    posture = Posture(
        tuple(parts["joints"]),
        tuple(parts["joints"].values()),
        tuple(parts["weights"]),
        tuple(parts["weights"].values()),
    )
    spare = len(names) - here.of_file("output").of_tool.size
    if spare < 1:
        raise table.fail(key.name, "no posture, because the tool determines all joints")
    if len(posture.joints) > spare:
        raise inner.fail("joints", f"at most {spare} joints: the tool determines the others")
    if not all(weight > 0.0 for weight in posture.weights):
        raise inner.fail("weights", "numbers > 0")
    return posture


def _read_rows(table: Table, key: Key, here: Context) -> Matrix:
    """Weights (n_y, n_a) of an output, row by row; an error where rows are zero or depend on each
    other.
    """
    names = [coordinate.name for coordinate in coordinates_of(here.of_file("element"))]
    rows = []
    for row in table.tables(key.name):
        row.only(*names)
        rows.append(tuple(row.number(one, 0.0) for one in names))
        if not any(rows[-1]):
            raise row.fail(None, "at least one weight that is not 0")
    scaled = np.array(rows) / np.abs(rows).max(axis=1, keepdims=True)
    if np.linalg.matrix_rank(scaled, tol=1e-9) < len(rows):
        raise table.fail(key.name, "linearly independent rows")
    return tuple(rows)


_WEIGHTS = {
    "type": "object",
    "additionalProperties": number().schema | {"description": "weight of this coordinate"},
}
_ROWS = Type(_read_rows, {"type": "array", "items": _WEIGHTS, "minItems": 1})
_FURTHER = Key(
    "joints",
    Type(_read_further, words().schema),
    "actuated coordinates that are outputs too, after the position and the angle of the tool",
    default=(),
    attribute="weights",
)
_AXES = 'axes of the position: one or more letters of "xyz", in this order'
_AXES_KEY = Key("axes", text(pattern="^(?=.)x?y?z?$"), _AXES, default="xyz", check=_check_axes)
_AXIS = "axis of the angle, world axes; the angle counts counterclockwise about it"
_REFERENCE = (
    "axis of the tool frame whose direction, projected along rotation_axis, gives the angle"
)
OUTPUT = Kinds(
    "the quantities that a reference path prescribes; as many as motors",
    {
        "tool_position": Format(
            "position of the tool",
            (_AXES_KEY, _FURTHER),
            Output,
        ),
        "tool_position_angle": Format(
            "position of the tool and its angle about one axis",
            (
                _AXES_KEY,
                Key("rotation_axis", direction(), _AXIS),
                Key("reference", choice("x", "y", "z"), _REFERENCE, default="x"),
                _FURTHER,
            ),
            partial(Output, unit="mixed"),
        ),
        "tool_pose": Format(
            "position and orientation of the tool", (_FURTHER,), partial(Output, unit="mixed")
        ),
        "joint": Format(
            "arm coordinates",
            (
                Key(
                    "joints",
                    Type(_read_joints, words().schema),
                    "the arm coordinates that are the outputs",
                ),
            ),
            lambda type, joints: joints,
        ),
        "combination": Format(
            "weighted sums",
            (
                Key(
                    "rows",
                    _ROWS,
                    "weighted sums of arm coordinates, one an output",
                    attribute="weights",
                ),
                Key("unit", choice("m", "rad", "mixed"), "unit of the outputs"),
            ),
            partial(Output, axes=""),
        ),
    },
    typed=True,
)


# --- keys of several tables ----------------------------------------------------------------------


def list_actuated(here: Context) -> list[Coordinate]:
    """The actuated coordinates of the robot."""
    return [c for c in coordinates_of(here.of_file("element")) if c.actuated]


def _read_joint_position(table: Table, key: Key, here: Context) -> Vector:
    """The actuated coordinates, which must be within their limits."""
    actuated = list_actuated(here)
    names = ", ".join(c.name for c in actuated)
    values = table.angles(
        key.name, [c.unit == "rad" for c in actuated], what=f"the actuated coordinates {names}"
    )
    for c, value in zip(actuated, values, strict=True):
        lower = c.dof.lower if c.dof is not None else None
        upper = c.dof.upper if c.dof is not None else None
        slack = 1e-12 * (1.0 + abs(value))
        if (lower is not None and value < lower - slack) or (
            upper is not None and value > upper + slack
        ):
            low = "-inf" if lower is None else f"{lower:.6g}"
            high = "inf" if upper is None else f"{upper:.6g}"
            given = f"{c.name} = {value:.6g} {c.unit}"
            raise table.fail(
                table.unit_key(key.name),
                f"{c.name} within its limits {low}..{high} {c.unit}",
                given,
            )
    return values


def joint_position(name: str, doc: str, default: Any = REQUIRED) -> Key:
    """The actuated coordinates; lengths are in m under both keys."""
    kind = Type(_read_joint_position, vector().schema, angle=True)
    return Key(name, kind, f"{doc}: the actuated coordinates", "rad; m", default)


def joint_factor(table: Table, full: str, stem: str, here: Context) -> float:
    """From the unit of a key of joints to rad; ModelError for degrees of an arm with
    translations.
    """
    if full.endswith("_deg") and not all(c.unit == "rad" for c in list_actuated(here)):
        raise table.fail(full, f"{stem}_rad, because some coordinates are lengths [m]")
    return math.radians(1.0) if full.endswith("_deg") else 1.0


def read_profile(table: Table, key: Key, here: Context) -> Vector:
    """Bounds on speed, acceleration, jerk, ..."""
    full = key.name if not key.type.angle else table.unit_key(key.name) or ""
    scale = joint_factor(table, full, key.name, here) if key.type.angle else 1.0
    values = table.vector(
        full, range(2, PROFILE_MAX + 1), what="bounds on speed, acceleration, jerk, ..."
    )
    if not all(value > 0 for value in values):
        raise table.fail(full, "numbers > 0")
    return tuple(scale * value for value in values)


BOUNDS = list_of(number(above=0.0).schema, range(2, PROFILE_MAX + 1))
_ALONG = "bounds on speed, acceleration, jerk, ... along the path; the duration is computed"
PROFILE = Key("profile", Type(read_profile, BOUNDS), _ALONG, default=())


def _read_rotation(table: Table, key: Key, here: Context) -> Vector:
    """The rotation vector of a move of the tool [rad]."""
    only_of_a_pose(table, key, "rotation", here)
    rotation = table.angles(key.name, (True,) * 3)
    output = here.of_file("output")
    if output.has_angle and output.is_tilted_by(rotation):
        raise table.fail(
            table.unit_key(key.name),
            f"a rotation about the axis of the output, {output.axis_text}: a multiple of it",
        )
    return rotation


def only_of_a_pose(table: Table, key: Key, what: str, here: Context) -> None:
    """Raise an error for a key of an output without rotation."""
    full = table.unit_key(key.name)
    if here.of_file("output").type not in TURNING:
        raise table.fail(full, f"no {what}, or {OF_ROTATION}")


def rotation(doc: str) -> Key:
    """The rotation of the tool in a move or step."""
    return Key("rotation", Type(_read_rotation, vector(3).schema, angle=True), doc, "rad", ZERO)


RADIUS_KEY = Key(
    "radius", number(above=0.0), "a rotation counts as path length radius * angle", "m", RADIUS
)


# --- frames --------------------------------------------------------------------------------------


def _work_frame(
    position: Vector, rotation: Matrix, rpy: Matrix | None, name: str, element: str
) -> WorkFrame:
    return WorkFrame(name, position, rotation if rpy is None else rpy, element)


def _read_element(table: Table, key: Key, here: Context) -> str:
    """The name of an element of the robot."""
    names = [element.name for element in here.of_file("element")]
    given = table.text(key.name)
    if given not in names:
        raise table.fail(key.name, closest(given, names))
    return given


FRAME = Format(
    "frame of a workpiece or a fixture in the world or on an element; moves name it",
    (
        Key("name", name("frame"), "name of the frame"),
        Key(
            "element",
            Type(_read_element, text().schema),
            "element that carries the frame, from whose tip it is placed; default: it stands in "
            "the world",
            default="",
        ),
        *PLACEMENT.keys,
    ),
    make=_work_frame,
)


def _find_frame(table: Table, key: Key, here: Context) -> WorkFrame:
    """The frame with this name."""
    frames = {frame.name: frame for frame in here.of_file("frame")}
    given = table.text(key.name)
    if given not in frames:
        raise table.fail(key.name, closest(given, frames) if frames else MISSING)
    return frames[given]


def _read_frame(table: Table, key: Key, here: Context) -> WorkFrame:
    """The frame with this name; of an output with an angle it must not tilt the axis."""
    found = _find_frame(table, key, here)
    if found.element:
        if "type" not in table or table.text("type") not in TOOL_MOVES:
            raise table.fail(
                key.name,
                f"a frame in the world: only the moves {', '.join(TOOL_MOVES)} can be stated in a "
                "frame that an element carries",
            )
        if "profile" in table:
            raise table.fail(key.name, "a duration and a smoothness", "a profile")
        return found
    output = here.of_file("output")
    axis = np.array(output.rotation_axis or ZERO, dtype=float)
    tilted = np.array(found.rotation) @ axis
    if output.has_angle and np.linalg.norm(tilted - axis) > FLAT:
        raise table.fail(
            key.name, f"a frame that is not tilted against the output's axis {output.axis_text}"
        )
    return found


def _frame_of_all(table: Table, here: Context) -> Any:
    """The frame of the table that contains the list, if it names one."""
    outer = here.outer
    return None if outer is None or "frame" not in outer else _read_frame(outer, FRAME_KEY, here)


_IN_FRAME = "frame in which it is stated, in place of the world; vectors have its axes"
FRAME_KEY = Key("frame", Type(_read_frame, {"type": "string"}), _IN_FRAME, default=None)
FRAME_OF_STEP = replace(
    FRAME_KEY,
    doc="frame in which the step is stated; default: that of the program",
    default=_frame_of_all,
)


def _read_vector_of_angles(table: Table, key: Key, here: Context) -> Vector:
    """A rotation vector [rad]."""
    return table.angles(key.name, (True,) * 3)


CARRIED = Format(
    "motion of the frame of a move, in proportion to the path; its axes at the start",
    (
        Key("displacement", vector(3), "displacement of the frame", "m", ZERO),
        Key(
            "rotation",
            Type(_read_vector_of_angles, vector(3).schema, angle=True),
            "rotation vector of the frame, about its origin",
            "rad",
            ZERO,
        ),
    ),
    make=partial(Carrier, ZERO),
)


def _check_carried(table: Table, here: Context) -> None:
    """Refuse a moving frame without a frame, or of a move without a duration."""
    if here.values["carried"] is None:
        return
    if here.values["frame"] is None:
        raise table.fail("carried", "a move with a frame", "no frame")
    if here.values["frame"].element:
        raise table.fail("carried", "a frame in the world: an element carries this one", "both")
    if "profile" in table:
        raise table.fail("carried", "a duration and a smoothness", "a profile")


CARRIED_KEY = Key(
    "carried", sub(CARRIED), CARRIED.doc, default=None, check=_check_carried, attribute="carrier"
)


def _check_fixed_tool(table: Table, here: Context) -> None:
    """Refuse a tool in the room where the pose of the workpiece is not the output, or the path is
    stated in another frame.
    """
    if here.values["fixed_tool"] is None:
        return
    if here.of_file("output").type != "tool_pose":
        raise table.fail(
            "fixed_tool",
            'an output of type "tool_pose": the position and orientation of the workpiece in the '
            "hand of the robot",
        )
    if "frame" in table:
        raise table.fail("fixed_tool", "no frame: the path is stated in that of the workpiece")
    if "profile" in table:
        raise table.fail("fixed_tool", "a duration and a smoothness", "a profile")


FIXED_TOOL_KEY = Key(
    "fixed_tool",
    Type(_find_frame, {"type": "string"}),
    "frame of a tool that stands in the room while the robot carries the workpiece; the path is "
    "that of this tool, from where it is at the start, in the axes of the workpiece, those of "
    "[tool]",
    default=None,
    check=_check_fixed_tool,
)


def in_frame(make: Callable[..., Any], **values: Any) -> Any:
    """A move in world axes, from one that is stated in a frame."""
    frame = values.pop("frame")
    carrier = values.pop("carried", None)
    made = make(**values) if carrier is None else make(carrier=carrier, **values)
    return made if frame is None else frame.place(made)


def step_in_frame(make: Callable[..., Any], **values: Any) -> Any:
    """A step in world axes, from one that is stated in a frame."""
    frame = values.pop("frame")
    made = make(**values)
    return made if frame is None else frame.place_step(made)


# --- poses of the tool as ends of joint moves ----------------------------------------------------


def _read_configuration(table: Table, key: Key, here: Context) -> tuple[int, ...]:
    values = table.vector(key.name, 3, what="signs of shoulder, elbow and wrist")
    if not all(value in (-1.0, 1.0) for value in values):
        raise table.fail(key.name, "1 or -1 for each of shoulder, elbow and wrist")
    return tuple(int(value) for value in values)


def _read_turns(table: Table, key: Key, here: Context) -> tuple[int, ...]:
    """Whole turns of each actuated joint, 0 for a length."""
    actuated = list_actuated(here)
    values = table.vector(
        key.name, len(actuated), what="whole turns of " + ", ".join(c.name for c in actuated)
    )
    if not all(value == int(value) and abs(value) <= MOST_TURNS for value in values):
        raise table.fail(key.name, f"whole numbers from -{MOST_TURNS} to {MOST_TURNS}")
    for c, value in zip(actuated, values, strict=True):
        if value and c.unit != "rad":
            raise table.fail(key.name, f"0 for {c.name}, which is a length")
    return tuple(int(value) for value in values)


def _pose_given(table: Table) -> list[str]:
    return [
        name
        for name in ("position", "rpy_rad", "rpy_deg", "configuration", "turns")
        if name in table
    ]


def check_end(table: Table, here: Context) -> None:
    """Raise an error for joints and a pose as the end, and for a pose of an arm that has no six
    joints.
    """
    given = _pose_given(table)
    actuated = list_actuated(here)
    if given and table.unit_key("end", required=False) is not None:
        raise table.fail(given[0], "either end or a pose of the tool", "both")
    if given and len(actuated) != 6:
        names = ", ".join(c.name for c in actuated)
        expected = (
            f"end, because the arm has not six actuated coordinates but {len(actuated)}: {names}"
        )
        raise table.fail(given[0], expected)


def _if_pose(table: Table, here: Context) -> Any:
    return REQUIRED if _pose_given(table) else None


def with_target(make: Callable[..., Any], **values: Any) -> Any:
    """A joint move with the pose of the tool at its end, if there is one."""
    position, *pose = (values.pop(name) for name in ("position", "rpy", "configuration", "turns"))
    return make(target=None if position is None else PoseTarget(position, *pose), **values)


_SIGNS = Type(_read_configuration, list_of({"enum": [-1, 1]}, 3))
_OF_ARM = "joint configuration at the end: signs of shoulder, elbow and wrist"
CONFIGURATION = Key("configuration", _SIGNS, _OF_ARM, default=())
_TURN = {"type": "integer", "minimum": -MOST_TURNS, "maximum": MOST_TURNS}
_ORIENTATION = "orientation of the tool at the end, world axes: roll, pitch, yaw"


def end_of_joints(doc: str) -> tuple[Key, ...]:
    """The end of a joint move: joints, or a pose of the tool."""
    return (
        Key(
            "position",
            vector(3),
            "where the tool ends, in the world",
            "m",
            _if_pose,
            "m, world axes and origin",
        ),
        Key("rpy", RPY, _ORIENTATION, "rad", _if_pose),
        CONFIGURATION,
        Key(
            "turns",
            Type(_read_turns, list_of(_TURN, 6)),
            "whole turns of each joint at the end",
            default=(),
        ),
        joint_position("end", doc, lambda table, here: () if _pose_given(table) else REQUIRED),
    )


# --- moves ---------------------------------------------------------------------------------------


def _check_profile(table: Table, here: Context) -> None:
    if here.values["profile"] and "duration" in table:
        raise table.fail(
            "duration", "either duration or profile (which determines the duration)", "both"
        )


def _time(sampled: bool = False, check: Check | None = None) -> tuple[Key, ...]:
    """The keys of the time law of a move; all may be missing for samples with their own time
    (``sampled``). ``check``: of the smoothness.
    """

    def default(zero: float, table: Table, here: Context) -> Any:
        own = sampled and "duration" not in table and "smoothness" not in table
        return zero if here.values["profile"] or own else REQUIRED

    derivatives = "number of continuous derivatives of the path, zero at both ends"
    return (
        replace(PROFILE, check=_check_profile),
        Key("duration", number(above=0.0), "duration", "s", partial(default, 0.0)),
        Key("smoothness", whole(3, 9), derivatives, default=partial(default, 0), check=check),
    )


def _needs_tool(table: Table, here: Context) -> None:
    """The error of a move of the tool in a model whose output is something else."""
    if here.of_file("output").type not in TOOL:
        expected = "joint or output_line, because the output is not the tool's position or pose"
        raise table.fail(
            "type",
            f'{expected}, or a table [output] with type = "tool_pose" or "tool_position", or '
            '"tool_position_angle" with the rotation about one axis',
        )


def _needs_outputs(table: Table, here: Context) -> None:
    if here.of_file("output").type in TOOL:
        raise table.fail(
            "type", "joint or tool_line, because the output is the tool's position or pose"
        )


def _check_circle(table: Table, here: Context) -> None:
    center = here.values["center"]
    axis = here.values["axis"]
    off = np.array(center) - np.dot(center, axis) * np.array(axis)
    if not np.linalg.norm(off) > 1e-9 * (1.0 + float(np.linalg.norm(center))):
        raise table.fail("center", "a center that is not on the axis through the start")


def _check_angle(table: Table, here: Context) -> None:
    if not here.values["angle"]:
        raise table.fail(table.unit_key("angle"), "an angle that is not 0")


def _check_leg(table: Table, here: Context) -> None:
    if here.last and "zone" in table:
        raise table.fail("zone", "no zone in the last leg")
    if "speed" in table and here.outer is not None and "profile" not in here.outer:
        raise table.fail("speed", "no speed, or a profile of the move")


def _make_leg(via: Vector, **values: Any) -> MoveL:
    return MoveC(via=via, **values) if via else MoveL(**values)


def _read_samples(table: Table, key: Key, here: Context) -> str:
    """The path of a file of samples, relative to the file that names it."""
    given = table.text(key.name)
    path = Path(table.entries[key.name].file or table.file).parent / given
    try:
        there = path.suffix in (".csv", ".npz") and path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        there = False
    if not there:
        # The name of a file stands at the end of its path: a long path is shown whole.
        shown = show(given, limit=LONGEST_PATH)
        raise table.fail(key.name, f"the {_SAMPLED}", given=shown)
    return str(path)


def _way(doc: str, note: str) -> Key:
    return Key("displacement", vector(3), doc, "m", note=note)


_ROTATION = rotation("rotation of the tool, as rotation vector in world axes")
_FROM_LEG = "m, world axes, from the start of the leg"
LEG = Format(
    "line, or arc with via",
    (
        _way("displacement of the tool in this leg, world axes", _FROM_LEG),
        Key("speed", number(above=0.0), "largest speed in this leg", "m/s", None),
        Key(
            "zone",
            number(above=0.0),
            "distance from the corner at which its rounding begins",
            "m",
            lambda table, here: 0.0 if here.last else REQUIRED,
        ),
        _ROTATION,
        Key(
            "via",
            vector(3),
            "point of the arc, from the start of the leg, world axes",
            "m",
            (),
            _FROM_LEG,
        ),
    ),
    make=_make_leg,
    before=_check_leg,
    where=True,
)


_START = joint_position("start", "where the move starts")
_TOOL_LINE = _way("displacement of the tool, world axes", "m, world axes")
_CENTER = "center, from the position at the start, world axes"
_OUTPUTS = Type(
    lambda table, key, here: table.vector(
        key.name, here.of_file("output").size, what="one number per output"
    ),
    vector().schema,
)
_SMOOTH = "largest deviation from the samples; a smooth path instead of one through them"
# Characters of a path in a message: the longest path that an operating system opens.
LONGEST_PATH = 4096
_SAMPLED = "path of a .csv or .npz file, relative to the folder of this file"
_TO = "straight line in the joint coordinates, to these or to a pose of the tool"
_AT_START = "m, world axes, from the start"
_CIRCLE = (
    Key("center", vector(3), _CENTER, "m", note=_AT_START),
    Key("axis", direction(), "direction of the axis, world axes", check=_check_circle),
    Key("angle", angle(), "angle of the arc", "rad", check=_check_angle),
)
_LEGS = Key("legs", listed(LEG, plural=False), "lines and arcs")


_BY_JOINT = {"type": "object", "additionalProperties": number().schema}
_POSTURE = Key(
    "posture",
    Type(
        _read_posture,
        {
            "type": "object",
            "propertyNames": {"enum": ["joints", "weights"]},
            "additionalProperties": _BY_JOINT,
        },
    ),
    "how the joints that the tool leaves free are chosen: `joints`, whose change in the move is "
    "given, 0 for fixed; `weights` of the squared speeds of the others",
    default=None,
)


def _of_tool(doc: str, *keys: Key) -> Format:
    return Format(
        doc,
        (FRAME_KEY, CARRIED_KEY, FIXED_TOOL_KEY, _START, *_time(), RADIUS_KEY, *keys, _POSTURE),
        partial(in_frame, Move),
        before=_needs_tool,
        where=True,
    )


MOVE = Kinds(
    "move",
    {
        "tool_line": _of_tool("straight line of the tool", _TOOL_LINE, _ROTATION),
        "tool_circle": _of_tool("arc of the tool about an axis", *_CIRCLE, _ROTATION),
        "tool_polyline": _of_tool("lines and arcs of the tool with rounded corners", _LEGS),
        "sampled": Format(
            "spline through samples",
            (
                replace(_START, default=()),
                *_time(sampled=True),
                RADIUS_KEY,
                Key("degree", among(*DEGREES), "degree of the spline", default=7),
                Key("smooth", number(above=0.0), _SMOOTH, "rad; m", default=0.0),
                Key("file", Type(_read_samples, text().schema), _SAMPLED),
            ),
            make=Move,
            where=True,
        ),
        "joint": Format(
            _TO,
            (FRAME_KEY, _START, *_time(check=check_end), *end_of_joints("where the move ends")),
            make=partial(in_frame, partial(with_target, Move)),
            where=True,
        ),
        "output_line": Format(
            "straight line of the outputs",
            (_START, *_time(), Key("displacement", _OUTPUTS, "displacement of each output")),
            make=Move,
            before=_needs_outputs,
            where=True,
        ),
    },
    shared=(Key("name", name("move"), "name of the move"),),
    typed=True,
)
