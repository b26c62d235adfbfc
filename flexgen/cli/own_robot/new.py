"""The verb ``new``: a model file with plausible numbers, to be changed."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from flexgen.atomic_files import write_text
from flexgen.cli.argument_parser import Parser
from flexgen.cli.argument_types import file_path
from flexgen.cli.verbs import Progress, VerbResult, check_writable, writing
from flexgen.errors import ArgumentError

TEMPLATES = ("planar", "gantry", "scara", "six-axis")


def add_arguments(parser: Parser) -> None:
    """Add the arguments of the verb to its parser."""
    parser.add_argument("name", metavar="NAME", help="of the robot, an identifier")
    content, out = parser.section("content"), parser.section("files")
    kind = content.add_mutually_exclusive_group()
    names = f"{', '.join(TEMPLATES)}; default: planar"
    kind.add_argument("--template", metavar="NAME", choices=TEMPLATES, default="planar", help=names)
    help_urdf = "with elastic gears for a URDF file: FILE.urdf#BASE:TIP; default: its root and its farthest link"
    kind.add_argument("--urdf", metavar="FILE", help=help_urdf)
    out.add_argument("--out", metavar="FILE", type=file_path, help="write to this file (.toml); default: NAME.toml")
    out.add_argument("--force", action="store_true", help="replace the file")


def new(args: Namespace, log: Progress) -> VerbResult:
    """Write a model file with plausible numbers and comments, from a template or for a URDF file."""
    from flexgen.model.templates.new_model import new_model

    path = args.out or Path(f"{args.name}.toml")
    check_writable(path)
    if path.suffix != ".toml":
        raise ArgumentError(f"--out: given {str(path)!r}, expected a file name ending in .toml")
    if path.exists() and not args.force:
        raise ArgumentError(f"--out: given {str(path)!r}, which exists, expected a new file; --force replaces it")
    text = new_model(args.name, args.template, args.urdf, path.parent)
    with writing(path):
        write_text(path, text)
    next_steps = "\n".join(f"next: flexgen {verb} {path}" for verb in ("check", "analyze", "solve"))
    return VerbResult({"name": args.name, "out": str(path)}, f"wrote {path}\n{next_steps}")
