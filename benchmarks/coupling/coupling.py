"""Motors that turn with their links: times and tool errors of paths and streams, and those of
the same robots in simplified motor coupling.

    python benchmarks/coupling/coupling.py [--write] [--quick]

One core, processor time of the thread. ``--write`` writes ``coupling.md``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE.parent / "redundancy")]

from inversion_stream import StreamCase  # noqa: E402
from inversion_table import machine  # noqa: E402
from peers_builds import Builds  # noqa: E402
from redundancy import PATHS, STREAMS, head_of, of_paths, of_streams  # noqa: E402

ROBOTS = ("planar5_nmp", "manutec_r3_18")
VARIANTS = ("", "@coupled")
# The period of an update [s], the intervals ahead, and samples in each.
HORIZONS = {"planar5_nmp": (5e-3, 20, 5), "manutec_r3_18": (20e-3, 8, 20)}
HEAD = """# Motors that turn with their links

Written by `python benchmarks/coupling/coupling.py --write`: robots in simplified motor coupling,
and their variant `coupled`, see [theory](../../docs/theory.md#motors-that-turn-with-their-links).
One thread, processor time, the least of several runs.

{machine}

## Whole paths

The coarsest mesh whose torques move the tool within 1 um and 1 urad.

"""
BETWEEN = """
## Streams

The move in both directions, repeated. Time of an update in C, and the period over it.

"""


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
        for variant in VARIANTS:
            text += of_paths(f"{robot}{variant}", "line")
    text += BETWEEN + head_of(STREAMS)
    for robot in robots:
        for variant in VARIANTS:
            text += of_streams(builds, StreamCase(f"{robot}{variant}", "line", *HORIZONS[robot]))
    print(text)
    if given.write and not given.quick:
        HERE.joinpath("coupling.md").write_text(text)


if __name__ == "__main__":
    main()
