"""The table of the benchmark of arrays: a row for each robot and device."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from array_parts.problems import (
    AFTER,
    BEFORE,
    EACH,
    ROUNDS,
    SAMPLES,
    SECONDS,
    Problems,
    call_many,
    call_one_by_one,
    problems_of,
    shortest,
)
from peers_table import _cpu

from flexgen.runtime.inversion.many_inversion import count_cores

MODELS = ("planar5_nmp", "manutec_r3_18", "manutec_r3_24")
HEADER = (
    "robot",
    "device",
    "single calls, problems/s",
    "`invert_many`, 1 thread",
    "`invert_many`, all threads",
    "all threads / (threads x single calls) (target: at least 0.9)",
    "processor time: single calls / all threads",
)


@dataclass(frozen=True)
class Row:
    """Problems per second of the single calls, and of ways to solve many, on one device; ratios of
    both.
    """

    robot: str
    device: str
    single: float
    one: float
    many: float
    share: float
    processor: float

    def cells(self) -> list[str]:
        """Of the table."""
        speeds = (
            f"{x:.3g}" if x < 1000 else f"{x:.0f}" for x in (self.single, self.one, self.many)
        )
        return [
            f"`{self.robot}`",
            self.device,
            *speeds,
            f"{self.share:.2f}",
            f"{self.processor:.2f}",
        ]


def cpu_row(p: Problems) -> Row:
    """Single calls, one thread and all of them."""
    few = p.first(10)
    began = time.perf_counter()
    call_one_by_one(few)
    count = int(np.clip(10 * SECONDS / (time.perf_counter() - began), 16, len(p.parameters)))
    part = p.first(count)
    threads = count_cores()
    best = shortest(
        [lambda: call_one_by_one(part), lambda: call_many(part, 1), lambda: call_many(part)]
    )
    single, one, many = (float(x) for x in count / best[:, 0])
    device = f"CPU, {threads} threads"
    return Row(
        p.robot,
        device,
        single,
        one,
        many,
        many / (threads * single),
        float(best[0, 1] / best[2, 1]),
    )


def table(rows: list[Row]) -> str:
    """The page: all rows, and how they were measured."""
    lines = [HEADER, ["---"] * len(HEADER), *(row.cells() for row in rows)]
    load = ", ".join(f"{x:.1f}" for x in os.getloadavg())
    notes = (
        f"Problems per second: the line of each robot, {SAMPLES} samples, {BEFORE} before and "
        f"{AFTER} after them, {EACH} for each interval of the mesh; stiffness and payload of "
        f"each problem differ. The shortest of {ROUNDS} rounds, in which all ways solve the "
        "same problems one after the other, with the same bits. Default build; from Python, "
        "the reduction of the torques to their largest values included.\n"
        "\n"
        "The processor time of all threads together is that of the single calls where the "
        "ratio is 1: on idle cores that do not slow each other down, the throughput is then "
        "the number of threads times that of single calls. The ratio of throughputs next to it "
        "was measured while other programs used the cores too.\n"
        "\n"
        f"{_cpu().get('model name', 'processor unknown')}, {os.cpu_count()} cores; load {load}."
    )
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + f"\n\n{notes}\n"


def measure(models: Sequence[str]) -> str:
    """The page for these models."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for robot in models:
            print(robot)
            # rows of other devices follow here
            rows.append(cpu_row(problems_of(robot, Path(folder))))
    return table(rows)
