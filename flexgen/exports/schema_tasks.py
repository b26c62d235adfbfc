"""Schema of the tables that describe tasks and measurements: output, moves, programs, sensors."""

from __future__ import annotations

from flexgen.exports.schema_types import (
    Schema,
    angle,
    choice,
    const,
    name,
    number,
    one_of,
    picked,
    string,
    table,
    tables,
    vector,
    whole,
    words,
)
from flexgen.model import sensors, task_tables
from flexgen.model.moves import DEGREES, RADIUS
from flexgen.model.programs import tables as program_tables
from flexgen.model.programs.targets import MOST_TURNS

_PROFILE = "bounds on speed, acceleration, jerk, ... along the path; the duration is computed"


def joint_positions(stem: str, text: str) -> dict[str, Schema]:
    """The actuated coordinates; lengths are in m under both keys."""
    return {f"{stem}_{unit}": vector(f"{text}: the actuated coordinates [{unit}; m]") for unit in ("rad", "deg")}


def configuration() -> dict[str, Schema]:
    """The joint configuration at a pose of the tool."""
    signs = {
        "type": "array",
        "description": "joint configuration at the end: signs of shoulder, elbow and wrist",
        "items": {"enum": [-1, 1]},
        "minItems": 3,
        "maxItems": 3,
    }
    return {"configuration": signs}


def pose() -> dict[str, Schema]:
    """A pose of the tool as the end of a joint move, of arms with six actuated coordinates."""
    return {
        "position": vector("where the tool ends, in the world [m]", 3),
        **angle("rpy", "orientation of the tool at the end, world axes: roll, pitch, yaw", vector_3),
        **configuration(),
        "turns": {
            "type": "array",
            "description": "whole turns of each joint at the end",
            "items": {"type": "integer", "minimum": -MOST_TURNS, "maximum": MOST_TURNS},
            "minItems": 6,
            "maxItems": 6,
        },
    }


def profile(text: str) -> Schema:
    """Bounds on the speed and its derivatives."""
    return vector(text, *range(2, task_tables.PROFILE_MAX + 1), above=0.0)


def output() -> Schema:
    """The output that a reference path prescribes."""
    axes = string('axes of the position: one or more letters of "xyz", in this order', pattern="^(?=.)x?y?z?$")
    weights = {"type": "object", "additionalProperties": number("weight of this coordinate")}
    kinds = {
        "tool_position": ({"axes": axes | {"default": "xyz"}}, ()),
        "tool_pose": ({}, ()),
        "joint": ({"joints": words("the arm coordinates that are the outputs")}, ("joints",)),
        "combination": (
            {
                "rows": tables("weighted sums of arm coordinates, one an output", weights),
                "unit": choice("unit of the outputs", ("m", "rad", "mixed")),
            },
            ("rows", "unit"),
        ),
    }
    texts = ("position of the tool", "position and orientation of the tool", "arm coordinates", "weighted sums")
    return one_of(
        "the quantities that a reference path prescribes; as many as motors",
        [
            table(text, {"type": const(kind, text), **own}, ["type", *needed])
            for (kind, (own, needed)), text in zip(kinds.items(), texts, strict=True)
        ],
    )


def moves() -> Schema:
    """Reference moves."""
    smoothness = whole("number of continuous derivatives of the path, zero at both ends", 3, 9)
    shared = {
        "name": name("name of the move"),
        **joint_positions("start", "where the move starts"),
        "duration": number("duration [s]", above=0.0),
        "smoothness": smoothness,
        "profile": profile(_PROFILE),
    }
    rotation = angle("rotation", "rotation of the tool, as rotation vector in world axes", vector_3)
    radius = number("a rotation counts as path length radius * angle [m]", above=0.0, default=RADIUS)
    displacement = vector("displacement of the tool, world axes [m]", 3)
    leg = {
        "displacement": vector("displacement of the tool in this leg, world axes [m]", 3),
        "via": vector("point of the arc, from the start of the leg, world axes [m]", 3),
        **rotation,
        "zone": number("distance from the corner at which its rounding begins [m]", above=0.0),
        "speed": number("largest speed in this leg [m/s]", above=0.0),
    }
    kinds: dict[str, tuple[str, dict[str, Schema], tuple[str, ...]]] = {
        "tool_line": (
            "straight line of the tool",
            {"displacement": displacement, **rotation, "radius": radius},
            ("displacement",),
        ),
        "tool_circle": (
            "arc of the tool about an axis",
            {
                "center": vector("center, from the position at the start, world axes [m]", 3),
                "axis": vector("direction of the axis, world axes", 3),
                **angle("angle", "angle of the arc"),
                **rotation,
                "radius": radius,
            },
            ("center", "axis"),
        ),
        "tool_polyline": (
            "lines and arcs of the tool with rounded corners",
            {"legs": tables("lines and arcs", table("line, or arc with via", leg, ["displacement"])), "radius": radius},
            ("legs",),
        ),
        "sampled": (
            "spline through samples",
            {
                "file": string("path of a .csv or .npz file, relative to the folder of this file"),
                "degree": {"description": "degree of the spline", "enum": list(DEGREES), "default": 7},
                "radius": radius,
            },
            ("file",),
        ),
        "joint": (
            "straight line in the joint coordinates, to these or to a pose of the tool",
            {**joint_positions("end", "where the move ends"), **pose()},
            (),
        ),
        "output_line": (
            "straight line of the outputs",
            {"displacement": vector("displacement of each output")},
            ("displacement",),
        ),
    }
    return tables(
        "reference moves that start and end at rest",
        one_of(
            "move",
            [
                table(text, {**shared, "type": const(kind, text), **own}, ["name", "type", *needed])
                for kind, (text, own, needed) in kinds.items()
            ],
        ),
        least=0,
    )


def vector_3(text: str) -> Schema:
    """A vector in space."""
    return vector(text, 3)


def programs() -> Schema:
    """Sequences of steps that are executed as one move."""
    own: dict[str, Schema] = {
        **pose(),
        "displacement": vector("from where the step begins, world axes [m]", 3),
        "position": vector("where the step ends, in the world [m]", 3),
        "via": vector("point of the arc; same origin as the end [m]", 3),
        **angle("rotation", "rotation vector in this step, world axes", vector_3),
        **angle("rpy", "orientation at the end, world axes: roll, pitch, yaw", vector_3),
        "speed": number("largest speed of the tool [m/s]", above=0.0),
        "zone": number("distance from the end at which the rounding to the next step begins [m]", least=0.0),
        "pause": number("pause after the step [s]", least=0.0, default=0.0),
        **joint_positions("end", "where the step ends"),
        **angle("speed", "largest joint speed", number, above=0.0),
        **angle("zone", "distance from the end at which the rounding begins", number, least=0.0),
    }
    texts = {"MoveJ": "line in the joint coordinates", "MoveL": "line of the tool", "MoveC": "arc of the tool"}
    steps = [
        table(
            texts[kind],
            {"type": const(kind, texts[kind]), **picked(keys, own)},
            ["type", *(["via"] if kind == "MoveC" else [])],
        )
        for kind, keys in program_tables._KEYS.items()
    ]
    keys = {
        "name": name("name of the program"),
        **joint_positions("start", "where the program starts"),
        "profile": profile(f"of MoveL and MoveC: {_PROFILE}"),
        "joint_profile_rad": profile("bounds on joint speed, acceleration, jerk, ... of MoveJ [rad/s, ...]"),
        "joint_profile_deg": profile("bounds on joint speed, acceleration, jerk, ... of MoveJ [deg/s, ...]"),
        "smoothness": whole("number of continuous derivatives of the speed changes", 3, 9),
        "radius": number("a rotation counts as path length radius * angle [m]", above=0.0, default=RADIUS),
        "step": tables("steps in their order", one_of("step", steps)),
    }
    return tables("sequences of steps", table("program", keys, ["name", "step"]), least=0)


def sensor_list() -> Schema:
    """Sensors beside the motor encoders."""
    axis = {
        "anyOf": [
            {"enum": ["x", "y", "z"]},
            {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3},
        ]
    }
    place: dict[str, Schema] = {
        "element": string('the element whose body carries the sensor, or "tool"'),
        "position": vector("in the frame of that body (of a tracker: of the tool) [m]", 3),
        "axes": {
            "type": "array",
            "description": "measured directions: x, y, z or vectors; default all three",
            "items": axis,
            "minItems": 1,
            "maxItems": 3,
        },
        "coordinate": string("the arm coordinate that the encoder measures"),
    }
    own = {
        "accelerometer": ("element", "position", "axes"),
        "gyro": ("element", "axes"),
        "link_encoder": ("coordinate",),
        "tracker": ("position", "axes"),
    }
    texts = {
        "accelerometer": "acceleration minus gravity at a point of a body",
        "gyro": "angular velocity of a body",
        "link_encoder": "an arm coordinate",
        "tracker": "position of a point of the tool in the world",
    }
    out = []
    for kind, units in sensors.UNITS.items():
        keys = {
            "name": name("name of the sensor"),
            "type": const(kind, texts[kind]),
            "unit": choice("unit of what the sensor sends", list(units)),
            "noise": number("standard deviation of a sample, in this unit", least=0.0, default=0.0),
            "sample_s": number("sample time [s]; default: that of the drives", above=0.0),
            "delay_s": number("time from the motion to the sample [s]", least=0.0, default=0.0),
            **{key: place[key] for key in own[kind]},
        }
        needed = ["name", "type", "unit", *(key for key in own[kind] if key in ("element", "coordinate"))]
        out.append(table(texts[kind], keys, needed))
    return tables("sensors beside the motor encoders", one_of("sensor", out)) | {"maxItems": sensors.MOST}
