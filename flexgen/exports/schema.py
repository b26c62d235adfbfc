"""JSON schema of model files, for completion, hover and checks in an editor.

The names of keys, types, units and friction laws are those of the tables of the reader (`flexgen.model`), so that a new
one without a text is an error here. A schema cannot express everything that the reader checks: relations between
numbers, names that refer to each other, key paths of variants. The reader has the last word.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

from flexgen.errors import ArgumentError
from flexgen.exports import schema_robot, schema_tasks
from flexgen.exports.schema_types import IDENTIFIER, Schema, choice, name, picked, ref, string, table, vector, words
from flexgen.model import reader
from flexgen.type_checks import checked_types
from flexgen.version import __version__

Kind = Literal["model", "program"]
KINDS: tuple[Kind, ...] = get_args(Kind)


@checked_types
def schema(kind: Kind = "model") -> dict[str, Any]:
    """The JSON schema (draft 7) of model files.

    The editor extension Even Better TOML completes and explains keys in a file whose first line is
    ``#:schema ./flexgen.schema.json``.

    Parameters
    ----------
    kind : str
        ``"model"``: model files and overlays of URDF files. ``"program"``: files of moves and programs, as
        `flexgen.read_moves` reads them.

    Returns
    -------
    dict
        JSON types only.

    Raises
    ------
    ArgumentError
        There is no such kind.
    """
    if kind not in KINDS:
        raise ArgumentError(f"schema: given {kind!r}, expected one of {', '.join(KINDS)}")
    head = {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": f"flexgen {kind} file, version {__version__}",
    }
    if kind == "program":
        return head | table("moves and programs of flexgen", picked(("move", "program"), _root()))
    overlay = schema_robot.overlay_tables()
    keys = picked(reader._KEYS, _root()) | overlay | {"variant": _variants()}
    root = table("robot model of flexgen", keys)
    root["oneOf"] = [
        {"required": ["name", "gravity", "element", "motor", "output"], "not": {"required": ["urdf"]}},
        {"required": ["urdf"], "not": {"required": ["element"]}},
    ]
    return head | root | {"definitions": schema_robot.definitions()}


def _root() -> dict[str, Schema]:
    """Keys of an ordinary model file."""
    return {
        "name": name("name of the robot, the prefix of every C symbol"),
        "description": string("one line"),
        "source": string("where the numbers come from"),
        "gravity": vector("gravity, world axes [m/s^2]", 3),
        "motor_coupling": choice(
            "complete: rotors also turn with the bodies that carry them", ("simplified", "complete"), "simplified"
        ),
        **schema_tasks.joint_positions("home", "home position"),
        "base": ref("placement", "pose of the base in the world"),
        "element": {
            "type": "array",
            "description": "the chain, from the base to the tool",
            "items": schema_robot.element(),
            "minItems": 1,
        },
        "motor": schema_robot.motors(),
        "tool": ref("placement", "pose of the tool frame, from the tip of the last element"),
        "payload": ref("body", "load, in the frame of the tip of the last element; com: by default at the tool"),
        "output": schema_tasks.output(),
        "move": schema_tasks.moves(),
        "program": schema_tasks.programs(),
        "sensor": schema_tasks.sensor_list(),
    }


def _variants() -> Schema:
    keys = {
        "description": string("one line"),
        "set": {
            "type": "object",
            "description": 'new values by dotted path, such as "element.arm1.dof.q1.gear.damping" = 0.0',
        },
        "remove": words("dotted paths of keys that are removed before"),
    }
    return {
        "type": "object",
        "description": "named sets of changes, selected with MODEL@variant",
        "propertyNames": {"pattern": IDENTIFIER},
        "additionalProperties": table("changes", keys),
    }
