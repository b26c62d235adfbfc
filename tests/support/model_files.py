"""Model files with every kind of table, their mutations by key and value, and what reading a file
gives as one line.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from flexgen.base.errors import FlexgenError
from flexgen.base.spec.tables import bare

ROOT = Path(__file__).resolve().parents[2]

# Kinds of tables that no file in models/ has, so that every table of the schema is compared with
# the reader.
EVERYTHING = """
name = "everything"
gravity = [0, 0, -9.81]
temperature = 40
not_measured = ["q0.stiffness"]
motor_coupling = "complete"
home_rad = [0.1, 0.2, 0.3, 0.4, 0.5, 0.0]
[base]
position = [0, 0, 0]
rotation = [1, 0, 0, 0, 1, 0, 0, 0, 1]
{elements}
[tool]
position = [0.1, 0, 0]
rpy_deg = [0, 0, 90]
speed_max = 1
acceleration_max = 9
[payload]
mass = 1
com = [0, 0, 0.1]
inertia = [0.1, 0.1, 0.1, 0, 0, 0]
[output]
type = "tool_pose"
[[frame]]
name = "table"
position = [0.1, 0, 0]
rpy_deg = [0, 0, 90]
[[move]]
name = "arc"
type = "tool_circle"
frame = "table"
carried = {{ displacement = [0.1, 0, 0], rotation_deg = [0, 0, 5] }}
start_rad = [0.1, 0.2, 0.3, 0.4, 0.5, 0.0]
center = [0.1, 0, 0]
axis = [0, 0, 1]
angle_deg = 30
rotation_deg = [0, 0, 5]
duration = 1
smoothness = 5
[[move]]
name = "seam"
type = "tool_line"
frame = "table"
carried = {{ displacement = [0.1, 0, 0] }}
start_rad = [0.1, 0.2, 0.3, 0.4, 0.5, 0.0]
displacement = [0.1, 0, 0]
duration = 1
smoothness = 5
[[move]]
name = "weld"
type = "tool_polyline"
frame = "table"
carried = {{ rotation_deg = [0, 0, 5] }}
start_rad = [0.1, 0.2, 0.3, 0.4, 0.5, 0.0]
legs = [{{ displacement = [0.1, 0, 0] }}]
duration = 1
smoothness = 5
[[frame]]
name = "hand"
element = "e0"
position = [0.1, 0, 0]
[[move]]
name = "grind"
type = "tool_line"
fixed_tool = "hand"
start_rad = [0.1, 0.2, 0.3, 0.4, 0.5, 0.0]
displacement = [0.1, 0, 0]
duration = 1
smoothness = 5
[[move]]
name = "round"
type = "tool_circle"
fixed_tool = "hand"
start_rad = [0.1, 0.2, 0.3, 0.4, 0.5, 0.0]
center = [0.1, 0, 0]
axis = [0, 0, 1]
angle_deg = 30
duration = 1
smoothness = 5
[[move]]
name = "edge"
type = "tool_polyline"
fixed_tool = "hand"
start_rad = [0.1, 0.2, 0.3, 0.4, 0.5, 0.0]
legs = [{{ displacement = [0.1, 0, 0] }}]
duration = 1
smoothness = 5
[[move]]
name = "corner"
type = "tool_polyline"
start_rad = [0.1, 0.2, 0.3, 0.4, 0.5, 0.0]
legs = [{{ displacement = [0.1, 0, 0], zone = 0.01, speed = 0.1 }}, {{ displacement = [0, 0.1, \
0], via = [0.1, 0, 0] }}]
profile = [0.5, 5, 50]
[[move]]
name = "track"
type = "sampled"
file = "track.csv"
degree = 7
[[sensor]]
name = "acc"
type = "accelerometer"
element = "e0"
unit = "g"
[[sensor]]
name = "rate"
type = "gyro"
element = "tool"
axes = ["x", [0, 1, 1]]
unit = "deg/s"
[[sensor]]
name = "enc"
type = "link_encoder"
coordinate = "q0"
unit = "mrad"
[[sensor]]
name = "laser"
type = "tracker"
unit = "mm"
[[sensor]]
name = "gear0"
type = "joint_torque"
coordinate = "q0"
unit = "N m"
[[sensor]]
name = "flange"
type = "wrench"
element = "tool"
unit = "kN"
moment_noise = 1e-3
[[sensor]]
name = "gauge"
type = "strain"
coordinate = "p0"
unit = "um/m"
gauge = 2e3
offset = -5
[servo]
type = "cascade"
position_gain = [20, 20, 20, 20, 20, 20]
speed_gain = [1, 1, 1, 1, 1, 1]
integral_gain = [1, 1, 1, 1, 1, 0]
speed_feedforward = 0.9
reference_filter_s = 2e-3
low_pass = [{{ frequency_hz = 300 }}]
notch = [{{ frequency_hz = 60, zero_damping = 0.2 }}]
[uncertainty]
stiffness = 0.1
damping = 0.3
friction = 0.2
masses = 0.03
motor_inertia = 0.05
payload = 0.5
delay = 1e-4
misfit = 0.05
common = ["masses"]
parameters = ["q0.stiffness", "m0.inertia"]
sd = [0.02, 0.04]
correlation = [1, 0.3, 0.3, 1]
[[loop]]
name = "pin"
type = "point"
from = {{ element = "left", position = [0.5, 0, 0.5] }}
to = {{ element = "right", position = [-0.5, 0, 0.5] }}
[[loop]]
name = "level"
type = "axis"
from = {{ element = "base" }}
to = {{ element = "hinge" }}
[[loop]]
name = "stop"
type = "pose"
from = {{ element = "base" }}
to = {{ element = "slider" }}
{lines}[[program]]
name = "tour"
start_rad = [0.1, 0.2, 0.3, 0.4, 0.5, 0.0]
profile = [0.5, 5, 50]
joint_profile_rad = [2, 9, 150]
step = [
  {{ type = "MoveJ", end_rad = [0, 0.2, 0.3, 0.4, 0.5, 0.0], speed_rad = 1 }},
  {{ type = "MoveL", displacement = [0.1, 0, 0], rpy_deg = [0, 0, 0] }},
  {{ type = "MoveC", position = [0.1, 0, 0], via = [0.1, 0.1, 0.0], pause = 0.1 }},
]
[variant.other]
description = "x"
set = {{ "payload.mass" = 2 }}
remove = ["base"]
"""
LINES = [
    'type = "spring"\nstiffness = 1e3\nlength = 0\npreload = 5',
    'type = "rod"\nstiffness = 1e6\nlength = 1.01',
    'type = "cable"\nstiffness = 1e4\nlength = 1\nsmoothing = 1e-3\npreload = 5',
    'type = "gas_spring"\narea = 1e-3\npressure = 1e7\nvolume = 1e-3\nexponent = 1.4\n'
    'length = 1.1\nstroke = 0.4\nambient_pressure = 1e5\nacts = "push"',
]
SPRINGS = [
    '{ type = "linear", stiffness = 1e5 }',
    '{ type = "cubic", stiffness = 1e5, cubic = 0.0 }',
    '{ type = "smooth", low = 1e5, high = 2e5, break_at = 1e-3 }',
    '{ type = "piecewise", low = 1e5, high = 2e5, break_at = 1e-3 }',
    '{ type = "backlash", stiffness = 1e5, gap = 0, smoothing = 1e-4 }',
]


def everything(folder: Path) -> Path:
    """A file with every kind of table, but one kind of an output."""
    (folder / "track.csv").write_text(
        "t,x,y,z,rx,ry,rz\n" + "".join(f"{k},{k},0,0,0,0,0\n" for k in range(20))
    )
    text = ""
    for k in range(6):
        lossy = ", hysteresis = { lost_motion = 1e-4, stiffness = 1e5 }" if k == 0 else ""
        lossy += (
            ", transmission_error = { harmonics = [1, 2], cos = [1e-5, 2e-5] }" if k == 1 else ""
        )
        gear = (
            (
                f'{{ type = "elastic", side = "arm", spring = {SPRINGS[k]}, damping = 1{lossy}, '
                "torque_max = 9 }"
            )
            if k < 5
            else '{ type = "rigid", torque_rms_max = 9 }'
        )
        kind = "rotation" if k < 5 else "translation"
        text += f'[[element]]\nname = "e{k}"\nbody = {{ mass = 2, inertia = [1, 1, 1] }}\n'
        text += (
            f'[[element.dof]]\nname = "q{k}"\ntype = "{kind}"\naxis = [0, 0, 1]\ngear = {gear}\n'
        )
        text += "friction = { viscous = 1, coulomb = 1, beta = 10 }\n"
        text += (
            "counterbalance = { sin = [1.0, 2.0], cos = [0.5] }\n" if kind == "rotation" else ""
        )
    for k, spring in enumerate(SPRINGS):
        kind = "translation" if k == 0 else "rotation"
        text += (
            f'[[element]]\nname = "s{k}"\nbody = {{ mass = 2 }}\n[[element.dof]]\nname = "p{k}"\n'
        )
        text += (
            f'type = "{kind}"\n'
            "axis = [1, 0, 0]\n"
            f"spring = {spring}\n"
            "damping = 1\n"
            "deflection_max = 1\n"
        )
    # two bars between base and a common pin, and two bodies that loops fix to the base
    for name, x in (("left", -0.5), ("right", 0.5), ("hinge", 0), ("slider", 0)):
        kind = "translation" if name == "slider" else "rotation"
        near = "near = 0.1" if name == "slider" else "near_rad = 0.1"
        text += f'[[element]]\nname = "{name}"\nparent = "base"\n'
        text += f"origin = {{ position = [{x}, 0, 0] }}\nbody = {{ mass = 1 }}\n"
        text += f'[[element.dof]]\nname = "p_{name}"\ntype = "{kind}"\naxis = [0, 1, 0]\n'
        text += f"passive = {{ {near} }}\n"
    text += (
        '[[element]]\nname = "b"\nparent = "s4"\n[element.beam]\nlength = 1\nmass_per_length = 2\n'
    )
    text += '[[element.beam.bending]]\ndirection = "y"\nstiffness = 100\nmodes = 1\n'
    text += "[element.beam.torsion]\nstiffness = 9\ninertia_per_length = 1e-4\nmodes = 1\n"
    text += "[element.beam.stretch]\nstiffness = 1e5\nmodes = 1\n"
    text += "[element.beam.tip]\nmass = 1\ninertia = [0, 0, 0]\n"
    for k in range(6):
        text += f'[[motor]]\nname = "m{k}"\ndrives = "q{k}"\nratio = 100\ninertia = 1e-3\n'
        text += 'axis = [0, 0, 1]\ncarrier = "base"\n'
        loads = "load_coulomb = 0.1, load_smoothing = 1"
        text += f'friction = {{ type = "gear", coulomb = 1, beta = 10, {loads} }}\n' * (k == 1)
        text += (
            "torque_rate_max = 9e3\n"
            "torque_rms_max = 9\n"
            "thermal_time = 60\n"
            "torque_speed = [[0, 9], [300, 5]]\n"
        )
        text += (
            "cogging = { harmonics = [6], sin = [0.1] }\n"
            "torque_ripple = { harmonics = [6], cos = [0.01] }\n"
        )
        text += "encoder_error = { harmonics = [2], cos = [1e-4] }\n"
        text += (
            "lugre = { coulomb = 0.1, static = 0.2, stribeck_speed = 5, stiffness = 100, "
            "damping = 0.01 }\n"
        )
    path = folder / "everything.toml"
    lines = "".join(
        f'[[line]]\nname = "line{k}"\nfrom = {{ element = "base", position = [0, 0, 2] }}\n'
        f'to = {{ element = "e0", position = [0, 0, 1] }}\n{kind}\nmass = 1\ndamping = 2\n'
        "length_min = 0.5\nlength_max = 2\n"
        for k, kind in enumerate(LINES)
    )
    path.write_text(EVERYTHING.format(elements=text, lines=lines))
    return path


def overlay(folder: Path) -> Path:
    """An overlay with a link of its own."""
    text = (ROOT / "models" / "urdf_arm.toml").read_text()
    text = text.replace('"urdf_arm.urdf"', f'"{ROOT / "models" / "urdf_arm.urdf"}"')
    text += (
        "\n"
        "[link.boom]\n"
        'rename = "jib"\n'
        "body = { mass = 20, com = [0.4, 0, 0], inertia = [0.1, 2, 2] }\n"
    )
    text += '[servo]\ntype = "ppi"\nposition_hz = 5\n'
    text += "low_pass = [{ frequency_hz = 300 }]\nnotch = [{ frequency_hz = 60 }]\n"
    path = folder / "overlay.toml"
    path.write_text(text)
    return path


# --- mutations by key and value ------------------------------------------------------------------

VALUES: tuple[Any, ...] = (
    *(
        -1,
        0,
        1,
        2,
        1.5,
        -0.3,
        100,
        1e-19,
        2.5e13,
        True,
        False,
        "",
        "x",
        "q1",
        "base",
        "rotation",
        "rigid",
        "tool",
    ),
    *(
        [],
        [1],
        [0, 0, 0],
        [1, 2, 3],
        [0.1, "a", 1],
        ["q1"],
        ["q1", "q1"],
        [1, 2, 3, 4, 5, 6],
        [0.0] * 9,
        [-1, 1, 1],
    ),
    *(
        [{}],
        {},
        {"type": "rigid"},
        {"type": "linear", "stiffness": 0.0},
        {"mass": 1},
        {"x": 1},
        "m",
        "deg",
        [[1, 0, 0]],
    ),
)


def tables_of(data: Any) -> list[Any]:
    """Every table and list of tables in plain data, outermost first."""
    inner = (
        list(data.values()) if isinstance(data, dict) else data if isinstance(data, list) else []
    )
    own = [data] if isinstance(data, dict) or (data and isinstance(data[0], dict)) else []
    return own + [
        found for item in inner if isinstance(item, dict | list) for found in tables_of(item)
    ]


def mutate_data(rng: random.Random, data: dict[str, Any]) -> None:
    """One key or entry of a random table: removed, renamed, copied from elsewhere, or with another
    value.
    """
    tables = tables_of(data)
    table = rng.choice(tables)
    if isinstance(table, list):
        k = rng.randrange(len(table))
        kind = rng.randrange(3)
        if kind == 0:
            table.append(json.loads(json.dumps(table[k])))
        elif kind == 1 and len(table) > 1:
            del table[k]
        else:
            table.reverse()
        return
    keys = list(table)
    kind = rng.randrange(10)
    other = rng.choice([one for one in tables if isinstance(one, dict)])
    if kind == 9 and other:
        key = rng.choice(list(other))
        table[key] = json.loads(json.dumps(other[key]))
    elif keys and kind == 0:
        del table[rng.choice(keys)]
    elif keys and kind == 1:
        key = rng.choice(keys)
        swapped = key.replace("_deg", "_RAD").replace("_rad", "_deg").replace("_RAD", "_rad")
        value = table[key] if rng.random() < 0.3 else table.pop(key)
        table[rng.choice([key + "s", key[:-1], key.partition("_")[0], swapped, swapped])] = value
    elif keys:
        key = rng.choice(keys)
        value = rng.choice(VALUES)
        if isinstance(table[key], list) and table[key] and rng.random() < 0.4:
            table[key] = [*table[key][:-1], value]
        else:
            table[key] = json.loads(json.dumps(value))


def toml_text(data: dict[str, Any]) -> str:
    """Plain data in TOML, an entry of a list of tables in a line of its own."""

    def show(value: Any) -> str:
        if isinstance(value, dict):
            return (
                "{ "
                + ", ".join(f"{bare(key)} = {show(item)}" for key, item in value.items())
                + " }"
            )
        if isinstance(value, list):
            line = "\n" if value and isinstance(value[0], dict) else ""
            return f"[{line}" + ", ".join(show(item) + line for item in value) + "]"
        return repr(value) if isinstance(value, float) else json.dumps(value)

    return "".join(f"{bare(key)} = {show(value)}\n" for key, value in data.items())


def mutated(name: str, number: int, valid: dict[str, Any]) -> str:
    """Mutation of a model file; the same name and number give the same text."""
    rng = random.Random(f"{name} {number}")
    data = json.loads(json.dumps(valid))
    for _ in range(rng.choice([1, 1, 1, 1, 2, 3])):
        mutate_data(rng, data)
    return toml_text(data)


# --- what reading gives --------------------------------------------------------------------------


def dump(value: Any) -> Any:
    """Plain data with every field, class and bit of a number."""
    if dataclasses.is_dataclass(value):
        fields = {
            field.name: dump(getattr(value, field.name))
            for field in dataclasses.fields(value)
            if field.name not in ("urdf_joints", "overrides")  # no data of the robot
        }
        return [type(value).__name__, fields]
    if isinstance(value, list | tuple):
        return [dump(item) for item in value]
    return value


def outcome(read: Callable[[Path], Any], path: Path) -> str:
    """The message of an error, or a hash of all that is read; without the folder of the file."""
    try:
        found = json.dumps(dump(read(path)))
    except FlexgenError as error:
        text = " ".join(str(error).replace(str(path.parent), "FOLDER").split())
        # words of a parser
        return re.sub(r"(text that is not (?:TOML|XML)) \(.*?\), expected", r"\1, expected", text)
    return (
        "read "
        + hashlib.sha256(found.replace(str(path.parent), "FOLDER").encode()).hexdigest()[:16]
    )
