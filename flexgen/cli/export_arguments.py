"""Arguments of ``flexgen export KIND MODEL``: each kind is a parser of its own, with its own options."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flexgen.cli import export_controllers, export_exchange
from flexgen.cli.argument_types import file_path
from flexgen.cli.exchange import added
from flexgen.cli.export_fmu import add_fmu
from flexgen.registry import added_names

# Functions that add the parser of one kind: (group of the kinds, function that adds a verb).
KINDS: list[Callable[[Any, Callable[..., Any]], None]] = [
    add_fmu,
    export_exchange.add_mujoco,
    export_exchange.add_urdf,
    *export_controllers.KINDS,
]


def add_verbs(group: Any, add_verb: Callable[..., Any]) -> None:
    """Add the verb export with its kinds."""
    summary = "Write the robot for another tool: a simulation program, a controller, a robot description."
    parser = group.add_parser("export", help=summary, description=summary)
    parser.add_argument("-h", "--help", action="help", help="show this help")
    kinds = parser.add_subparsers(dest="kind", metavar="KIND", required=True)
    for add in KINDS:
        add(kinds, add_verb)
    for name in added_names("exports"):
        add_verb(kinds, name, added).section("files").add_argument(
            "--out", metavar="PATH", type=file_path, required=True, help="write this file or folder"
        )
