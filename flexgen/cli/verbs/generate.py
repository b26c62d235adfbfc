"""The verb generate."""

from __future__ import annotations

from argparse import Namespace

from flexgen.cli.result import Progress, VerbResult, keywords, read_model


def generate(args: Namespace, log: Progress) -> VerbResult:
    """Write and compile the C library."""
    from flexgen.codegen.build.generate import generate as generate_library
    from flexgen.views.reports.texts import library_text

    given = keywords(args)
    robot = read_model(args)
    library = generate_library(robot, args.out, **given, progress=log)
    files = "\n".join(f"{path.stat().st_size:>9} bytes  {path}" for path in library.files)
    data = {"model": robot.name, "variant": robot.variant, **library.to_dict()}
    return VerbResult(data, library_text(robot, library), details=files)
