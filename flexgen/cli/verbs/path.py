"""The verb that plans a path: its segments, and the table that the path sampler of the emitted C reads."""

from __future__ import annotations

from argparse import Namespace

from flexgen.atomic_files import write_text
from flexgen.cli.printing import number, table
from flexgen.cli.result import Progress, VerbResult, check_own, read_model
from flexgen.cli.verbs.solve import choose_move


def path(args: Namespace, log: Progress) -> VerbResult:
    """Plan a path without solving: duration, segments, and a table of it for C."""
    check_own(args.out, b"Written by flexgen")
    from flexgen.paths.path import plan

    robot = read_model(args)
    planned = plan(robot, choose_move(args.moves, args.move, robot), ignore_limits=args.ignore_limits)
    data = planned.to_dict()
    rows = [[k, s["space"], s["start_s"], s["duration_s"], s["smoothness"]] for k, s in enumerate(data["segments"], 1)]
    head = ("segment", "space", "start, s", "duration, s", "continuous derivatives")
    text = f"{robot.name}, {planned.move.name}: {number(planned.duration)} s\n\n" + table(rows, head)
    if args.out is not None:
        from flexgen.codegen.path_header import path_header

        write_text(args.out, path_header(robot, planned.move.name, planned.table(), planned.duration))
        data["table"] = str(args.out)
        text += f"\n\nwrote {args.out}"
    return VerbResult(data, text)
