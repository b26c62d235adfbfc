"""The verb ``new``: a model file with plausible numbers, to be changed."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from flexgen.atomic_files import check_writable, write_text
from flexgen.cli.result import Progress, VerbResult
from flexgen.errors import ArgumentError


def new(args: Namespace, log: Progress) -> VerbResult:
    """Write a model file with plausible numbers and comments, from a template or for a URDF file."""
    from flexgen.templates.new_model import new_model

    path = args.out or Path(f"{args.name}.toml")
    check_writable(path)
    if path.exists() and not args.force:
        raise ArgumentError(
            f"--out: given {str(path)!r}, which exists, expected a new file; --force replaces it"
        )
    text = new_model(args.name, args.template or "planar", args.urdf, path.parent)
    write_text(path, text)
    next_steps = "\n".join(f"next: flexgen {verb} {path}" for verb in ("check", "analyze", "solve"))
    return VerbResult({"name": args.name, "out": str(path)}, f"wrote {path}\n{next_steps}")
