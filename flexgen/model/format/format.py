"""Rows of a model file: its root, variants, and the tables of an overlay on a URDF file."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from flexgen.base.registry import import_object
from flexgen.base.spec.keys import (
    Check,
    Context,
    Form,
    Format,
    Key,
    Kinds,
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
    whole,
    words,
)
from flexgen.base.spec.parts import KINDS, BeamTip, Stretch, Tolerances, Torsion
from flexgen.base.spec.ports import c_name_problem, identifier_problem
from flexgen.base.spec.schema import table_schema
from flexgen.base.spec.tables import IDENTIFIER, Table, closest, show
from flexgen.model.elements import (
    ZERO,
    Beam,
    Bending,
    Body,
    Element,
    Loop,
    LoopFrame,
    Matrix,
    Placement,
    Tool,
    Vector,
)
from flexgen.model.format import format_robot as robot
from flexgen.model.format.format_devices import MOST, MOTOR, SENSOR, check_motors
from flexgen.model.format.format_programs import PROGRAM
from flexgen.model.format.format_tasks import FRAME, MOVE, OUTPUT, joint_position


def _tool(position: Vector, rotation: Matrix, rpy: Matrix | None, **more: Any) -> Placement:
    pose = position, rotation if rpy is None else rpy
    return Tool(*pose, **more) if any(more.values()) else Placement(*pose)


_CARRIER = "the element that carries tool and payload; default: the last one"
TOOL = Format(
    "tool frame, from the tip of the element that carries it",
    (
        *robot.PLACEMENT.keys,
        Key("element", known(lambda here: [*here.names["element"]]), _CARRIER, default=""),
        Key("speed_max", number(above=0.0), "limit of the speed of its origin", "m/s", None),
        Key(
            "acceleration_max",
            number(above=0.0),
            "limit of the acceleration of its origin",
            "m/s^2",
            None,
        ),
    ),
    make=_tool,
)


# --- elements ------------------------------------------------------------------------------------


def _check_direction(table: Table, here: Context) -> None:
    if any(other.direction == here.values["direction"] for other in here.before):
        raise table.fail("direction", "each direction at most once")


def _name_modes(kind: Callable[[Context], str]) -> Check:
    """Check that adds the names of the modal coordinates of a group of modes, such as those that
    bend in one direction; ModelError where one cannot be a name.
    """

    def check(table: Table, here: Context) -> None:
        """Name the modes of the table."""
        taken = here.names["coordinate"]
        element = list(here.names["element"])[-1]
        for k in range(here.values["modes"]):
            name = f"{element}_{kind(here)}{k + 1}"
            problem = "a name that is not taken yet" if name in taken else identifier_problem(name)
            if problem is not None:
                raise table.fail("modes", problem, f"a modal coordinate {name}")
            taken[name] = table

    return check


def _check_ratio(table: Table, here: Context) -> None:
    if here.values["damping_ratio"] >= 1.0:
        raise table.fail("damping_ratio", "a number >= 0 and below 1")


def _modes(kind: Callable[[Context], str]) -> tuple[Key, Key]:
    """Number of modes of a group, and their damping ratio."""
    return (
        Key("modes", whole(1, 8), "number of modes", check=_name_modes(kind)),
        Key(
            "damping_ratio",
            number(least=0.0),
            "damping ratio of each mode, below 1",
            "",
            0.0,
            check=_check_ratio,
        ),
    )


def _check_tip(table: Table, here: Context) -> None:
    if min(here.values["inertia"]) < 0.0:
        raise table.fail("inertia", "three moments of inertia >= 0 [kg m^2]")


def _check_load(table: Table, here: Context) -> None:
    """Refuse a compression at which the straight beam is not stable: Euler's load of a column that
    is clamped at one end, ``pi^2 E I / (2 L)^2``.
    """
    softest = min(bending.stiffness for bending in here.values["bending"])
    critical = math.pi**2 * softest / (2.0 * here.values["length"]) ** 2
    if here.values["axial_load"] <= -critical:
        raise table.fail(
            "axial_load", f"more than {-critical:.4g} N, the load at which the beam buckles"
        )


BENDING = Format(
    "bending",
    (
        Key(
            "direction",
            choice("y", "z"),
            "axis of the deflection, across the beam",
            check=_check_direction,
        ),
        *_modes(lambda here: here.values["direction"]),
        Key("stiffness", number(above=0.0), "flexural stiffness EI", "N m^2"),
    ),
    make=Bending,
)
TORSION = Format(
    "torsion about the axis of the beam; the coordinates are rotations of the tip [rad]",
    (
        *_modes(lambda here: "twist"),
        Key("stiffness", number(above=0.0), "torsional stiffness GJ", "N m^2"),
        Key("inertia_per_length", number(above=0.0), "polar moment of inertia per length", "kg m"),
    ),
    make=Torsion,
)
STRETCH = Format(
    "elongation along the beam",
    (
        *_modes(lambda here: "x"),
        Key("stiffness", number(above=0.0), "axial stiffness EA", "N"),
    ),
    make=Stretch,
)
BEAM_TIP = Format(
    "rigid body at the end for which the modes are computed; only their shapes depend on it",
    (
        Key("mass", number(least=0.0), "mass", "kg", 0.0),
        Key(
            "inertia",
            vector(3),
            "moments of inertia about x, y and z",
            "kg m^2",
            ZERO,
            check=_check_tip,
        ),
    ),
    make=BeamTip,
)
BEAM = Format(
    "slender elastic link, clamped at the body frame",
    (
        Key("length", number(above=0.0), "length along the x axis of the body", "m"),
        Key("mass_per_length", number(above=0.0), "mass per length", "kg/m"),
        Key("bending", listed(BENDING), "bending in one direction"),
        Key("torsion", sub(TORSION), TORSION.doc, default=None),
        Key("stretch", sub(STRETCH), STRETCH.doc, default=None),
        Key("tip", sub(BEAM_TIP), BEAM_TIP.doc, default=None),
        Key(
            "axial_load",
            number(),
            "constant force along the beam, tension > 0: it makes bending stiffer",
            "N",
            0.0,
            check=_check_load,
        ),
    ),
    make=Beam,
)


_BASE = "base"
LOOPS = 16  # closed loops of a robot
# Keys with which a closed loop would be elastic.
SPRING_KEYS = ("stiffness", "damping", "spring", "preload", "length")


def _check_name(table: Table, here: Context) -> None:
    if here.values["name"] == _BASE:
        raise table.fail("name", "another name (base is the ground)")


def _check_parent(table: Table, here: Context) -> None:
    if "parent" in table and isinstance(table.entries["parent"].value, list):
        raise table.fail("parent", "the name of one element; a table [[loop]] closes a loop")


ELEMENT = Format(
    "a link; parents before their children",
    (
        Key("name", name("element"), "name of the element", check=_check_name),
        Key(
            "parent",
            known(lambda here: [_BASE, *list(here.names["element"])[:-1]]),
            f'element that carries it, or "{_BASE}"; default: the one before',
            default=None,
        ),
        Key("dof", listed(robot.DOF, least=0), "degrees of freedom, in their order", default=()),
        Key("origin", sub(robot.PLACEMENT), "from the tip of the parent", default=Placement()),
        Key(
            "link",
            sub(robot.PLACEMENT),
            "from the last degree of freedom to the body frame",
            default=Placement(),
        ),
        Key("body", sub(robot.BODY), "rigid body, in the body frame", default=Body()),
        Key("beam", sub(BEAM), BEAM.doc, default=None),
    ),
    make=Element,
    before=_check_parent,
)


def _check_elements(table: Table, here: Context) -> None:
    """Raise an error for too many coordinates, and for mechanisms without coordinates."""
    known = here.names["coordinate"]
    free = [name for name, own in known.items() if "mimic" not in own and "passive" not in own]
    for own in known.values():
        factors = own.table("mimic")
        if factors is not None:
            factors.only(*free)
    count = len(here.names["coordinate"])
    if count > robot.COORDINATES_MAX:
        raise table.fail(
            "element", f"at most {robot.COORDINATES_MAX} coordinates", f"{count} coordinates"
        )


# --- closed loops --------------------------------------------------------------------------------


def _loop_frame(element: str, position: Vector, rotation: Matrix, rpy: Matrix | None) -> LoopFrame:
    return LoopFrame(position, rotation if rpy is None else rpy, element)


def _take_frame(frame: LoopFrame) -> dict[str, Any]:
    """Values of the keys of an end of a loop."""
    return vars(frame) | {"rpy": None}


LOOP_FRAME = Format(
    "end of a closed loop: a frame that is fixed to a body",
    (
        Key(
            "element",
            known(lambda here: [_BASE, *here.names["element"]]),
            f'element whose body it is fixed to, or "{_BASE}"',
        ),
        *robot.PLACEMENT.keys,
    ),
    make=_loop_frame,
    take=_take_frame,
    definition="loop_frame",
)


def _check_loop(table: Table, here: Context) -> None:
    if here.values["from"].element == here.values["to"].element:
        raise table.fail("to", "a frame of another body than that of from")


_RIGID = (
    "a loop that is rigid; for a spring between two points a table [[line]], for an elastic "
    "bearing or rod in the loop a dof with a spring"
)


def _check_rigid(table: Table, here: Context) -> None:
    """Refuse a closed loop with the keys of a spring, or of another type."""
    for key in SPRING_KEYS:
        if key in table:
            raise table.fail(key, _RIGID, "a key of a spring")
    if "type" in table and table.entries["type"].value not in LOOP.kinds:
        kind = table.entries["type"].value
        known = closest(kind if isinstance(kind, str) else "", LOOP.kinds)
        raise table.fail("type", f"{known}: {_RIGID}")


_ENDS = (
    Key("from", sub(LOOP_FRAME), "one frame", attribute="start"),
    Key("to", sub(LOOP_FRAME), "the other frame", attribute="end", check=_check_loop),
)
LOOP = Kinds(
    "closed loop: two frames coincide",
    {
        "point": Format("the origins coincide", _ENDS, make=Loop),
        "axis": Format("origins and z axes coincide, as of a pin", _ENDS, make=Loop),
        "pose": Format("origins and all axes coincide", _ENDS, make=Loop),
    },
    shared=(Key("name", name("loop"), "name of the loop", check=_check_rigid),),
    default="point",
    strict=False,
    typed=True,
)


# --- the file ------------------------------------------------------------------------------------


def _check_not_measured(table: Table, here: Context) -> None:
    """Raise an error for a name that is of no element, coordinate, sensor, or the payload."""
    sensors = (sensor.name for sensor in here.values.get("sensor", ()))
    lines = here.names["line"]
    owners = {*here.names["element"], *here.names["coordinate"], *sensors, *lines, "payload"}
    for one in here.values["not_measured"]:
        owner, dot, number_name = one.partition(".")
        if owner not in owners or not dot or not number_name:
            raise table.fail(
                "not_measured",
                "names such as q1.stiffness: that of an element, a coordinate, a sensor, a line "
                "or payload, a dot, and the number",
                show(one),
            )


ROUNDING = 1e-9  # relative to the largest eigenvalue of a correlation matrix
_SD = number(least=0.0, most=5.0)
_SPREAD = "standard deviation of {}, relative"


def _each(power: int) -> Type:
    return vector(size=lambda here: len(here.values["parameters"]) ** power)


def _check_uncertainty(table: Table, here: Context) -> None:
    """Refuse standard deviations and correlations that do not fit the parameters, or are not those
    of random numbers: symmetric, ones on the diagonal, no negative eigenvalue.
    """
    n, sd, rows = (here.values[x] for x in ("parameters", "sd", "correlation"))
    if len(sd) != len(n) or any(not 0.0 <= x <= 5.0 for x in sd):
        raise table.fail("sd", "a number from 0 to 5 for each of the parameters")
    if not {*here.values["common"]} <= {*KINDS}:
        raise table.fail("common", f"some of {', '.join(KINDS)}")
    entries = {
        (i, j): x for (i, j), x in zip(product(range(len(n)), repeat=2), rows, strict=False)
    }
    if any(x != entries[j, i] or (i == j and x != 1.0) for (i, j), x in entries.items()):
        raise table.fail("correlation", "a symmetric matrix with ones on its diagonal, row by row")
    values = np.linalg.eigvalsh(np.reshape(rows, (len(n), -1))) if rows else np.ones(1)
    if values[0] < -ROUNDING * values[-1]:
        raise table.fail(
            "correlation",
            "a matrix without negative eigenvalues",
            f"the eigenvalue {values[0]:.3g}",
        )


UNCERTAINTY = Format(
    "what is known about the accuracy of the numbers",
    (
        *(
            Key(
                kind,
                _SD,
                _SPREAD.format(f"each {kind.replace('_', ' ').removesuffix('es')}"),
                default=0.0,
            )
            for kind in KINDS
        ),
        Key(
            "payload",
            number(least=0.0),
            "standard deviation of the mass of the payload",
            "kg",
            0.0,
        ),
        Key(
            "delay",
            number(least=0.0),
            "standard deviation of what the torques are late in addition",
            "s",
            0.0,
        ),
        Key(
            "misfit",
            _SD,
            "errors of positions that no number explains, rms over the elastic displacement",
            default=0.0,
        ),
        Key(
            "common", words(0), "kinds whose numbers all have the same relative error", default=()
        ),
        Key(
            "parameters", words(0), "numbers by name, in place of those of their kinds", default=()
        ),
        Key("sd", _each(1), _SPREAD.format("each of the parameters"), default=()),
        Key(
            "correlation",
            _each(2),
            "of the parameters, row by row",
            default=(),
            check=_check_uncertainty,
        ),
    ),
    make=Tolerances,
)
_FLANGE = "pose of the tool frame, from the tip of the element that carries it"
_COMPLETE = "complete: rotors also turn with the bodies that carry them"
_LOAD = (
    "load, in the frame of the tip of the element that carries the tool; com: by default at the "
    "tool"
)
_WARM = 'temperature of motors and gears, on which friction of type = "gear" depends'
_FROM_FILE = "numbers that a calibration did not determine, such as q1.stiffness"
_SENSORS = "sensors in addition to the motor encoders"
LINES = 64  # of a robot


def _line() -> Form:
    """The table of a line, which few robots have."""
    form: Form = import_object("flexgen.model.format.format_lines:LINE")
    return form


MODEL = Format(
    "robot model of flexgen",  # keys in the order of reading
    (
        Key("motor_coupling", choice("simplified", "complete"), _COMPLETE, default="simplified"),
        Key(
            "element",
            listed(ELEMENT),
            "the links, parents before their children",
            check=_check_elements,
        ),
        Key("tool", sub(TOOL), _FLANGE, default=Placement()),
        Key(
            "name",
            name(problem_of=c_name_problem),
            "name of the robot, the prefix of every C symbol",
        ),
        Key("description", text(), "one line", default=""),
        Key("source", text(), "where the numbers come from", default=""),
        Key("gravity", vector(3), "gravity, world axes", "m/s^2", note="m/s^2, world axes"),
        Key("base", sub(robot.PLACEMENT), "pose of the base in the world", default=Placement()),
        Key("temperature", number(least=-100.0, most=300.0), _WARM, "deg C", 20.0),
        Key("motor", listed(MOTOR), "motors, as many as actuated coordinates", check=check_motors),
        Key(
            "payload",
            sub(robot.BODY),
            _LOAD,
            default=lambda table, here: Body(com=here.values["tool"].position),
        ),
        Key("output", sub(OUTPUT), OUTPUT.doc, note="the output that a reference prescribes"),
        Key("frame", listed(FRAME, least=0), "frames in which moves are stated", default=()),
        Key(
            "move", listed(MOVE, least=0), "reference moves that start and end at rest", default=()
        ),
        joint_position("home", "home position"),
        Key("loop", listed(LOOP, least=0, most=LOOPS), "closed loops", default=(), note="loops"),
        Key("sensor", listed(SENSOR, most=MOST), _SENSORS, default=(), note="sensors"),
        Key(
            "line",
            listed(_line, least=0, most=LINES),
            "springs, gas springs, rods and cables between two points",
            default=(),
            note="lines",
        ),
        Key("program", listed(PROGRAM, least=0), "sequences of steps", default=()),
        Key("uncertainty", sub(UNCERTAINTY), UNCERTAINTY.doc, default=None),
        Key("not_measured", words(0), _FROM_FILE, default=(), check=_check_not_measured),
        Key(
            "servo",
            sub(lambda: import_object("flexgen.model.position_servo.keys:SERVO_TABLE")),
            "its servo",
            default=None,
        ),
    ),
)
PROGRAMS = Format(
    "moves and programs of flexgen", (MODEL["frame"], MODEL["move"], MODEL["program"])
)
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
        Key("remove", words(0), "dotted paths of keys that are removed before", default=()),
    ),
)

# --- overlays on URDF files ----------------------------------------------------------------------


def _read_lock(table: Table, key: Key, here: Context) -> dict[str, float]:
    """Positions of joints: a table of positions, or a list of joints fixed at zero."""
    if isinstance(table.entries[key.name].value, dict):
        inner = table.table(key.name)
        return {joint: inner.number(joint) for joint in inner.entries} if inner is not None else {}
    return dict.fromkeys(table.words(key.name, 0), 0.0)


_FIXED = "joints fixed at a position [rad or m]"
_POSITION = number().schema | {"description": "position [rad or m]"}
_LOCK = {"anyOf": [words(0).schema, {"type": "object", "additionalProperties": _POSITION}]}
_LIMITS = Key("limits", flag(), "use the limits of the URDF file", default=True)
URDF = Format(
    "the chain is in a URDF file",
    (
        Key(
            "file",
            text(),
            "path of the URDF file, relative to the folder of this file, or package://NAME/PATH",
        ),
        Key("base", text(), "the link that is the ground"),
        Key("tip", text(), "the link that carries the tool"),
        Key("branches", words(0), "links at the ends of other branches", default=()),
        Key(
            "lock",
            Type(_read_lock, _LOCK),
            f"{_FIXED}, or a list of joints fixed at zero",
            default={},
        ),
        Key(
            "drop",
            words(0),
            "joints outside the chain, left out with all links behind them",
            default=(),
        ),
        _LIMITS,
        replace(_LIMITS, name="dynamics", doc="use the friction of the URDF file"),
        replace(_LIMITS, name="loops", doc="use <constraint> and the YAML file of closed loops"),
        Key(
            "unfinished",
            words(0),
            "links whose bodies are to be filled in: the file is refused while one has no mass",
            default=(),
        ),
    ),
)
_EXTRA = "degrees of freedom {} the joint, at the same point"
JOINT = Format(
    "joint of the URDF file",
    (
        Key("rename", name(), robot.DOF.shared[0].doc, default=None),
        Key("gear", sub(robot.GEAR), "gear of the joint; default: rigid", default=None),
        Key("spring", sub(robot.JOINT_SPRING), "spring instead of a gear: no motor", default=None),
        Key(
            "mimic",
            any_table(),
            "factors of the coordinates that move it by a mechanism",
            default=None,
        ),
        Key(
            "passive",
            any_table(),
            "moved by closed loops, no motor: its position at home, roughly, near_rad or near_deg",
            default=None,
        ),
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
        Key("rename", name(), ELEMENT["name"].doc, default=None),
        Key(
            "body",
            sub(robot.BODY.without("rotational_drag")),
            "instead of <inertial>",
            default=None,
        ),
        Key("inertia_reduced", flag(), robot.REDUCED, default=False),
    ),
)


# --- JSON schema ---------------------------------------------------------------------------------


def model_schema() -> Schema:
    """The JSON schema of model files and overlays."""

    def describe(doc: str, form: Format) -> Schema:
        return {"type": "object", "description": doc, "additionalProperties": table_schema(form)}

    root = table_schema(MODEL)
    root["properties"] |= {
        "urdf": table_schema(URDF),
        "joint": describe(
            "what a URDF file cannot contain, for each moving joint by its name there", JOINT
        ),
        "link": describe("changes of links, by their name in the URDF file", LINK),
        "variant": describe("named sets of changes, selected with MODEL@variant", VARIANT)
        | {"propertyNames": {"pattern": IDENTIFIER}},
    }
    needed = root.pop("required")
    root["oneOf"] = [
        {"required": needed, "not": {"required": ["urdf"]}},
        {"required": ["urdf"]},
    ]
    from flexgen.model.format import format_lines

    every = (
        LOOP_FRAME,
        *vars(robot).values(),
        *vars(format_lines).values(),
        robot.friction(),
        robot.hysteresis(),
        robot.lugre(),
    )
    forms = [form for form in every if getattr(form, "definition", "")]
    return root | {"definitions": {form.definition: table_schema(form) for form in forms}}
