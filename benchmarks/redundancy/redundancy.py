"""Arms with more motors than the tool has outputs: times and tool errors of paths and streams.

    python benchmarks/redundancy/redundancy.py [--write] [--quick]

One core, processor time of the thread. ``--write`` writes ``redundancy.md``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from inversion_paths import path_row  # noqa: E402
from inversion_stream import StreamCase, stream_rows  # noqa: E402
from inversion_table import machine  # noqa: E402
from peers_builds import Builds  # noqa: E402

ROBOTS = ("track_arm", "seven_axis")
MOVES = {"track_arm": ("line", "carried"), "seven_axis": ("line", "elbow")}
# The periods of an update and the intervals ahead: each looks 100 ms ahead.
HORIZONS = ((5e-3, 20, 5), (10e-3, 10, 10), (20e-3, 5, 20))
FASTER = 100.0  # times real time: the target
HEAD = """# Redundant arms

Written by `python benchmarks/redundancy/redundancy.py --write`: arms whose model names a joint as
a further output, see [redundant arms](../../docs/methods.md#redundant-arms). One thread, processor
time, the least of several runs.

{machine}

## Whole paths

As in [inverse dynamics along paths](../inversion.md): the coarsest mesh whose torques move the
tool within 1 um and 1 urad.

"""
PATHS = (
    "robot",
    "move",
    "degrees of freedom",
    "mesh ms",
    "motion, s",
    "native, ms per s of path",
    "default build",
    "times real time",
    "tool error",
)
BETWEEN = """
## Streams

The move in both directions, repeated, 100 ms ahead. Time of an update in C, and the period over
it; a longer period needs fewer updates. The tool error is that of a simulation of the full model,
with motor feedback where the arm falls over without.

"""
STREAMS = (
    "robot",
    "move",
    "period ms",
    "intervals ahead",
    "samples in each",
    "native, median us",
    "99.9 %",
    "times real time",
    "default build, median us",
    "times real time",
    "tool error",
)


def head_of(titles: tuple[str, ...]) -> str:
    """The first two lines of a table."""
    return f"| {' | '.join(titles)} |\n|{'---|' * len(titles)}\n"


def say(line: str) -> None:
    """A line of progress."""
    print(line, file=sys.stderr, flush=True)


def error_text(error_m: float, error_rad: float | None) -> str:
    """A tool error in um and urad."""
    return f"{1e6 * error_m:.2g} um, {1e6 * (error_rad or 0.0):.2g} urad"


def of_paths(robot: str, move: str) -> str:
    """A row of the whole paths."""
    row = path_row(robot, move, "lq", 1e3 / FASTER)
    assert not row.refused, row.refused
    cells = [
        f"`{robot}`",
        move,
        str(row.dof),
        f"{row.mesh_ms:g}",
        f"{row.motion_s:.2f}",
        f"{row.native_ms:.2f}",
        f"{row.default_ms:.2f}",
        f"{1e3 / row.native_ms:.0f}",
        error_text(row.error_m, row.error_rad),
    ]
    return f"| {' | '.join(cells)} |\n"


def of_streams(builds: Builds, case: StreamCase) -> str:
    """A row of the streams."""
    native, default = stream_rows(builds, True, say, case)
    assert native.inexact == default.inexact == 0
    period_us = 1e6 * case.period
    cells = [
        f"`{case.robot}`",
        case.move,
        f"{1e3 * case.period:g}",
        str(case.intervals),
        str(case.samples_per_interval),
        f"{native.median_us:.0f}",
        f"{native.p999_us:.0f}",
        f"{period_us / native.median_us:.0f}",
        f"{default.median_us:.0f}",
        f"{period_us / default.median_us:.0f}",
        error_text(native.error_m, native.error_rad),
    ]
    return f"| {' | '.join(cells)} |\n"


def main() -> None:
    """Print the tables, and write them where it is wanted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--quick", action="store_true", help="one robot; nothing written")
    given = parser.parse_args()
    robots = ROBOTS[:1] if given.quick else ROBOTS
    builds = Builds(HERE.parents[1] / "build" / "bench")
    lines = "\n".join(f"- {line}" for line in machine(builds)[:-1])
    text = HEAD.format(machine=lines) + head_of(PATHS)
    for robot in robots:
        for move in MOVES[robot]:
            text += of_paths(robot, move)
    text += BETWEEN + head_of(STREAMS)
    for robot in robots:
        for horizon in HORIZONS:
            text += of_streams(builds, StreamCase(robot, MOVES[robot][-1], *horizon))
    print(text)
    if given.write and not given.quick:
        HERE.joinpath("redundancy.md").write_text(text)


if __name__ == "__main__":
    main()
