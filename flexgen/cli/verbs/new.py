"""The verb ``new``: a model file with plausible numbers, to be changed."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from flexgen.base.errors import ArgumentError
from flexgen.base.files.atomic_files import check_writable, write_text
from flexgen.base.spec.tables import show
from flexgen.cli.result import Progress, VerbResult

if TYPE_CHECKING:
    from flexgen.studies.templates.dh_model import DhModel


def new(args: Namespace, log: Progress) -> VerbResult:
    """Write a model file with plausible numbers, from a template, a URDF file or a DH table."""
    from flexgen.studies.templates.dh_model import model_from_dh

    path = args.out or Path(f"{args.name}.toml")
    check_writable(path)
    if path.exists() and not args.force:
        raise ArgumentError(
            f"--out: given {str(path)!r}, which exists, expected a new file; --force replaces it"
        )
    if args.convention and args.dh is None:
        raise ArgumentError("--convention: given without --dh, expected --dh FILE.csv")
    if args.payload and args.urdf is None:
        raise ArgumentError("--payload: given without --urdf, expected --urdf FILE")
    if args.link and (args.urdf is not None or args.dh is not None):
        raise ArgumentError("--link: given for another robot, expected --template flexible-link")
    found = {"name": args.name, "out": str(path)}
    if args.dh is None:
        return _from_template(args, path)
    made = model_from_dh(args.name, args.dh, args.convention)
    write_text(path, made.text)
    about = asdict(made)
    del about["text"]
    next_steps = _next_steps(path, has_moves=bool(made.moves))
    return VerbResult({**found, **about}, f"wrote {path}\n{_about(made)}\n{next_steps}")


def _next_steps(path: Path, *, has_moves: bool = True) -> str:
    """Commands for the new file, a line each; without moves there is nothing to solve."""
    verbs = ("check", "analyze", "solve") if has_moves else ("check", "analyze")
    return "\n".join(f"next: flexgen {verb} {path}" for verb in verbs)


def _from_template(args: Namespace, path: Path) -> VerbResult:
    """Write a template, or the overlay of a URDF file with its repairs."""
    from flexgen.studies.templates.new_model import new_overlay
    from flexgen.studies.templates.template_names import FLEXIBLE_LINK

    template = args.template or (FLEXIBLE_LINK if args.link else "planar")
    given = template, args.urdf, path.parent, args.payload, args.link
    made = new_overlay(args.name, *given)
    write_text(path, made.text)
    lines = [f"wrote {path}", *(f"repaired: {note}" for note in made.repairs)]
    if made.unfinished:
        names = ", ".join(map(show, made.unfinished))
        lines.append(
            f"unfinished: fill in the bodies of {names} in {path}; until then it is refused"
        )
    data = {"name": args.name, "out": str(path)}
    if args.urdf is not None:
        data |= {"repairs": list(made.repairs), "unfinished": list(made.unfinished)}
    return VerbResult(data, "\n".join([*lines, _next_steps(path)]))


def _about(made: DhModel) -> str:
    """Text to compare with the datasheet."""

    def point(values: tuple[float, ...]) -> str:
        return ", ".join(f"{value:.6g}" for value in values) + " m"

    moves = ", ".join(f"{name} ({duration:g} s)" for name, duration in made.moves) or "none"
    lines = [
        f"convention: {made.convention}",
        f"tool with all joints at 0: {point(made.zero)}; at home: {point(made.tool)}",
        f"moves: {moves}",
        f"assumed: {len(made.assumed)} numbers, marked ASSUMED in the file; rules at its top",
    ]
    if made.missing:
        lines.append(f"not in the table, and not in the file: {'; '.join(made.missing)}")
    return "\n".join([*lines, *(f"warning: {text}" for text in made.warnings)])
