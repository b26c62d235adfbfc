"""Inverse dynamics along paths and on a moving horizon: times, tool errors, and other programs for
the same torques.

    python benchmarks/inversion.py [--quick] [--docs] [--robots NAME ...] [--opty PYTHON]

One core, processor time of the thread. The tables go to benchmarks/inversion.md (not with --quick
or --robots).
"""

from __future__ import annotations

import argparse
import sys
import time

import inversion_table
from inversion_generate import generate_rows
from inversion_paths import QUICK, ROBOTS, path_rows
from inversion_peers import MOVE, collocation_rows, opty_rows, scipy_row
from inversion_solve import solve_rows
from inversion_stream import stream_rows
from peers_builds import HERE, Builds


def say(line: str) -> None:
    """A line of progress."""
    print(line, file=sys.stderr, flush=True)


def main() -> None:
    """Verify, time, print; write the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="two robots, one move, fewer updates; nothing written"
    )
    parser.add_argument(
        "--docs",
        action="store_true",
        help="also put the short table between the markers in docs/benchmarks.md",
    )
    parser.add_argument(
        "--robots",
        nargs="+",
        choices=list(ROBOTS),
        help="whole paths of these only; nothing written",
    )
    parser.add_argument(
        "--opty", default=sys.executable, metavar="PYTHON", help="an interpreter that has opty"
    )
    args = parser.parse_args()
    began = time.perf_counter()
    builds = Builds(HERE.parent / "build" / "bench")
    say("whole paths")
    paths = path_rows(list(args.robots or (QUICK if args.quick else ROBOTS)), args.quick, say)
    ours = {
        row.robot: row
        for row in paths
        if row.move == MOVE and row.method == "lq" and not row.refused
    }
    say("other programs")
    peers = collocation_rows(ours, args.quick, say) + scipy_row(ours, args.quick, say)
    peers += opty_rows(args.opty, ours, args.quick, say)
    say("streaming")
    streams = [] if args.robots else stream_rows(builds, args.quick, say)
    say("generating")
    generated = [] if args.robots else generate_rows(args.quick, say)
    say("solving")
    solved = [] if args.robots else solve_rows(args.quick, say)
    machine = inversion_table.machine(builds)
    table = inversion_table.full(paths, streams, peers, generated, solved, machine)
    print(table)
    if not (args.quick or args.robots):
        (HERE / "inversion.md").write_text(table)
        if args.docs:
            inversion_table.into_page(
                HERE.parent / "docs" / "benchmarks.md",
                inversion_table.short(paths, streams, machine),
            )
    say(f"{time.perf_counter() - began:.0f} s in all")


if __name__ == "__main__":
    main()
