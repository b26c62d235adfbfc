"""Rows of a model file: its root, variants, and the tables of an overlay on a URDF file."""

from __future__ import annotations

from dataclasses import replace

from flexgen.model import format_robot as robot
from flexgen.model.elements import Body, Matrix, Placement, Tool, Vector
from flexgen.model.format_devices import MOST, MOTOR, SENSOR, check_motors
from flexgen.model.format_programs import PROGRAM
from flexgen.model.format_tasks import MOVE, OUTPUT, joint_position
from flexgen.spec.keys import (
    Context,
    Format,
    Key,
    Schema,
    Type,
    angle,
    any_table,
    choice,
    flag,
    known,
    listed,
    name,
    number,
    sub,
    text,
    vector,
    words,
)
from flexgen.spec.ports import c_name_problem
from flexgen.spec.schema import table_schema
from flexgen.spec.tables import IDENTIFIER, Table


def _tool(position: Vector, rotation: Matrix, rpy: Matrix | None, element: str) -> Placement:
    pose = position, rotation if rpy is None else rpy
    return Tool(*pose, element) if element else Placement(*pose)


_CARRIER = "the element that carries tool and payload; default: the last one"
_TOOL = Format(
    "tool frame, from the tip of the element that carries it",
    (*robot.PLACEMENT.keys, Key("element", known(lambda here: [*here.names["element"]]), _CARRIER, default="")),
    make=_tool,
)


# --- the file ---------------------------------------------------------------------------------------------------------


_FLANGE = "pose of the tool frame, from the tip of the element that carries it"
_COMPLETE = "complete: rotors also turn with the bodies that carry them"
_LOAD = "load, in the frame of the tip of the element that carries the tool; com: by default at the tool"
_SENSORS = "sensors in addition to the motor encoders"
MODEL = Format(
    "robot model of flexgen",  # keys in the order of reading
    (
        Key("motor_coupling", choice("simplified", "complete"), _COMPLETE, default="simplified"),
        Key("element", listed(robot.ELEMENT), "the links, parents before their children", check=robot.check_size),
        Key("tool", sub(_TOOL), _FLANGE, default=Placement()),
        Key("name", name(problem_of=c_name_problem), "name of the robot, the prefix of every C symbol"),
        Key("description", text(), "one line", default=""),
        Key("source", text(), "where the numbers come from", default=""),
        Key("gravity", vector(3), "gravity, world axes", "m/s^2", note="m/s^2, world axes"),
        Key("base", sub(robot.PLACEMENT), "pose of the base in the world", default=Placement()),
        Key("motor", listed(MOTOR), "motors, as many as actuated coordinates", check=check_motors),
        Key("payload", sub(robot.BODY), _LOAD, default=lambda table, here: Body(com=here.values["tool"].position)),
        Key("output", sub(OUTPUT), OUTPUT.doc, note="the output that a reference prescribes"),
        Key("move", listed(MOVE, least=0), "reference moves that start and end at rest", default=()),
        joint_position("home", "home position"),
        Key("sensor", listed(SENSOR, most=MOST), _SENSORS, default=(), note="sensors"),
        Key("program", listed(PROGRAM, least=0), "sequences of steps", default=()),
    ),
)
PROGRAMS = Format("moves and programs of flexgen", (MODEL["move"], MODEL["program"]))
VARIANT = Format(
    "changes",
    (
        MODEL["description"],
        Key(
            "set",
            any_table(),
            'new values by dotted path, such as "element.arm1.dof.q1.gear.damping" = 0.0',
            default=None,
        ),
        Key("remove", words(), "dotted paths of keys that are removed before", default=()),
    ),
)

# --- overlays on URDF files -------------------------------------------------------------------------------------------


def _read_lock(table: Table, key: Key, here: Context) -> dict[str, float]:
    """Positions of joints: a table of positions, or a list of joints fixed at zero."""
    if isinstance(table.entries[key.name].value, dict):
        inner = table.table(key.name)
        return {joint: inner.number(joint) for joint in inner.entries} if inner is not None else {}
    return dict.fromkeys(table.words(key.name), 0.0)


NOTHING: dict[str, float] = {}
_FIXED = "joints fixed at a position [rad or m]"
_POSITION = number().schema | {"description": "position [rad or m]"}
_LOCK = {"anyOf": [words().schema, {"type": "object", "additionalProperties": _POSITION}]}
_LIMITS = Key("limits", flag(), "use the limits of the URDF file", default=True)
URDF = Format(
    "the chain is in a URDF file",
    (
        Key("file", text(), "path of the URDF file, relative to the folder of this file, or package://NAME/PATH"),
        Key("base", text(), "the link that is the ground"),
        Key("tip", text(), "the link that carries the tool"),
        Key("branches", words(), "links at the ends of other branches", default=()),
        Key("lock", Type(_read_lock, _LOCK), f"{_FIXED}, or a list of joints fixed at zero", default=NOTHING),
        Key("drop", words(), "joints outside the chain, left out with all links behind them", default=()),
        _LIMITS,
        replace(_LIMITS, name="dynamics", doc="use the friction of the URDF file"),
    ),
)
_EXTRA = "degrees of freedom {} the joint, at the same point"
JOINT = Format(
    "joint of the URDF file",
    (
        Key("rename", name(), robot.DOF.shared[0].doc, default=None),
        Key("gear", sub(robot.GEAR), "gear of the joint; default: rigid", default=None),
        Key("spring", sub(robot.JOINT_SPRING), "spring instead of a gear: no motor", default=None),
        robot.DAMPING,
        replace(robot.FRICTION, doc="instead of <dynamics>"),
        replace(robot.BALANCE, doc="torque by the angle, of a rotation"),
        _LIMITS,
        Key("motor", sub(MOTOR.without("drives").optional()), "motor of the joint", default=None),
        Key("before", listed(robot.DOF, least=0), _EXTRA.format("before"), default=()),
        Key("after", listed(robot.DOF, least=0), _EXTRA.format("after"), default=()),
        *robot.limits(number(), "m"),
        *robot.limits(angle(), "rad"),
        *robot.RATES,
    ),
)
LINK = Format(
    "link of the URDF file",
    (
        Key("rename", name(), robot.ELEMENT["name"].doc, default=None),
        Key("body", sub(robot.BODY.without("rotational_drag")), "instead of <inertial>", default=None),
        Key("inertia_reduced", flag(), robot.REDUCED, default=False),
    ),
)


# --- JSON schema ------------------------------------------------------------------------------------------------------


def model_schema() -> Schema:
    """The JSON schema of model files and overlays."""

    def describe(doc: str, form: Format) -> Schema:
        return {"type": "object", "description": doc, "additionalProperties": table_schema(form)}

    root = table_schema(MODEL)
    root["properties"] |= {
        "urdf": table_schema(URDF),
        "joint": describe("what a URDF file cannot contain, for each moving joint by its name there", JOINT),
        "link": describe("changes of links, by their name in the URDF file", LINK),
        "variant": describe("named sets of changes, selected with MODEL@variant", VARIANT)
        | {"propertyNames": {"pattern": IDENTIFIER}},
    }
    needed = root.pop("required")
    root["oneOf"] = [
        {"required": needed, "not": {"required": ["urdf"]}},
        {"required": ["urdf"], "not": {"required": ["element"]}},
    ]
    forms = [form for form in (*vars(robot).values(), robot.friction()) if getattr(form, "definition", "")]
    return root | {"definitions": {form.definition: table_schema(form) for form in forms}}
