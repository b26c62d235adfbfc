"""The verb generate."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexgen.cli.printing import paragraph
from flexgen.cli.result import Progress, VerbResult, keywords, read_model

if TYPE_CHECKING:
    from flexgen.library.generate import GeneratedLibrary
    from flexgen.model.elements import RobotModel


def generate(args: Namespace, log: Progress) -> VerbResult:
    """Write and compile the C library."""
    from flexgen.codegen.c_functions import inversion_reason
    from flexgen.library.generate import generate as generate_library

    robot = read_model(args)
    library = generate_library(
        robot,
        args.out,
        **keywords(args),
        progress=log,
    )
    done = f"built in {library.seconds:.1f} s" if not library.cached else "written, not compiled"
    lines = [f"{robot.title}: {done if library.written else 'nothing has changed'} in {library.directory}"]
    lines += ["", paragraph("functions: " + ", ".join(library.functions))]
    reason = inversion_reason(robot, library.functions)
    if reason is not None:
        lines += ["", paragraph(f"not in this library: invert and stream, because {reason}")]
    if library.written:
        lines += ["", *_name_files(library.files)]
    files = "\n".join(f"{path.stat().st_size:>9} bytes  {path}" for path in library.files)
    return VerbResult(library_dict(robot, library), "\n".join(lines), details=files)


def library_dict(robot: RobotModel, library: GeneratedLibrary) -> dict[str, Any]:
    """The data of a generated library for ``--json``."""
    return {
        "model": robot.name,
        "variant": robot.variant,
        "directory": str(library.directory),
        "files": [str(path) for path in library.files],
        "functions": list(library.functions),
        "digest": library.digest,
        "seconds": library.seconds,
        "cached": library.cached,
    }


def _name_files(files: tuple[Path, ...]) -> list[str]:
    """The written files a user needs by name, and the number of sources."""
    sources = [path for path in files if path.suffix == ".c" or path.parent.name == "src"]
    shown = [f"wrote {path}" for path in files if path not in sources]
    return [*shown, f"wrote {sources[0].parent} ({len(sources)} sources)"] if sources else shown
