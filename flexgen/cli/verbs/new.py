"""The verb ``new``: a model file with plausible numbers, to be changed."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from flexgen.atomic_files import check_writable, write_text
from flexgen.cli.result import Progress, VerbResult
from flexgen.errors import ArgumentError
from flexgen.spec.tables import show


def new(args: Namespace, log: Progress) -> VerbResult:
    """Write a model file with plausible numbers and comments, from a template or for a URDF file."""
    from flexgen.templates.new_model import new_overlay

    path = args.out or Path(f"{args.name}.toml")
    check_writable(path)
    if path.exists() and not args.force:
        raise ArgumentError(
            f"--out: given {str(path)!r}, which exists, expected a new file; --force replaces it"
        )
    made = new_overlay(args.name, args.template or "planar", args.urdf, path.parent)
    write_text(path, made.text)
    lines = [f"wrote {path}", *(f"repaired: {note}" for note in made.repairs)]
    if made.unfinished:
        names = ", ".join(map(show, made.unfinished))
        lines += [f"unfinished: fill in the bodies of {names} in {path}; until then it is refused"]
    lines += [f"next: flexgen {verb} {path}" for verb in ("check", "analyze", "solve")]
    data = {"name": args.name, "out": str(path)}
    if args.urdf is not None:
        data |= {"repairs": list(made.repairs), "unfinished": list(made.unfinished)}
    return VerbResult(data, "\n".join(lines))
