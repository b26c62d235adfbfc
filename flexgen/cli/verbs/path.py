"""The verb that plans a path: its segments, and the table that the path sampler of the emitted C reads."""

from __future__ import annotations

from argparse import Namespace

from flexgen.atomic_files import write_text
from flexgen.cli.result import Progress, VerbResult, check_own, read_model, with_files


def path(args: Namespace, log: Progress) -> VerbResult:
    """Plan a path without solving: duration, segments, and a table of it for C."""
    check_own(args.out, b"Written by flexgen")
    from flexgen.paths.move_files import find_move_in
    from flexgen.paths.path import plan

    robot = read_model(args)
    planned = plan(
        robot, find_move_in(args.moves, args.move, robot), ignore_limits=args.ignore_limits
    )
    if args.out is not None:
        from flexgen.codegen.path_header import path_header

        write_text(
            args.out, path_header(robot, planned.move.name, planned.table(), planned.duration)
        )
    files = {} if args.out is None else {"table": args.out}
    return with_files(planned.to_text(), planned.to_dict(), files)
