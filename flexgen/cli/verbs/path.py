"""The verb that plans a path: its segments, and the table that the path sampler of the emitted C
reads.
"""

from __future__ import annotations

from argparse import Namespace
from functools import partial
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

from flexgen.base.files.atomic_files import write_text
from flexgen.cli.result import Progress, VerbResult, Writer, check_own, read_model, with_files

if TYPE_CHECKING:
    from flexgen.paths.path import Path


def path(args: Namespace, log: Progress) -> VerbResult:
    """Plan a path without solving: duration, segments, and a table of it for C."""
    check_own(args.out, b"Written by flexgen")
    from flexgen.paths.move_files import find_move_in
    from flexgen.paths.path import plan

    robot = read_model(args)
    planned = plan(
        robot, find_move_in(args.moves, args.move, robot), ignore_limits=args.ignore_limits
    )
    files: dict[str, Writer] = (
        {} if args.out is None else {"table": partial(_write, planned, args)}
    )
    notes = [f"move {planned.move.name}: {line}" for line in planned.warnings]
    return with_files(planned.to_text(), planned.to_dict(), files, warnings=notes)


def _write(planned: Path, args: Namespace) -> FilePath:
    """Write the table of a path as a C header."""
    from flexgen.codegen.emission.path_header import path_header

    model = planned.equations.model
    header = path_header(model, planned.move.name, planned.table(), planned.duration)
    return write_text(args.out, header)
