"""Ten thousand joint moves of manutec_r3 in closed form on one core: time, accuracy and bits of
the results.

    python benchmarks/closed_form_sweep.py [COUNT]

prints the table and, for 10,000 moves, writes it to benchmarks/closed_form_sweep.md. The torques
are sampled at 1 kHz, as in a controller. The target is 10,000 moves in 20 s of processor time on
one core. Included: generating the moves, their motion, the inverse dynamics and its derivatives,
gears, motors, the results of every move and the table. Not included: writing and compiling the C
library, once.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import flexgen
from flexgen.paths.timing.time_laws import TimeLaw
from flexgen.studies.sweeps.cases import Grid, random_moves
from flexgen.studies.sweeps.closed_form_batch import JointMoves
from flexgen.studies.sweeps.sweep import sweep

MODEL = "manutec_r3"
COUNT = 10_000
LIMIT = 20.0  # s
COMPARED = 10  # moves that are solved one by one as well
SHARDS = (1, 2, 7)


def agreement(count: int) -> tuple[float, float, float]:
    """Largest relative difference of the torques from those of `flexgen.solve`; seconds a move of
    both.
    """
    equations = flexgen.derive(MODEL)
    moves = [move.of(equations.model) for move in random_moves(count)]
    starts = np.array([move.start for move in moves])
    ends = np.array([move.end for move in moves])
    with tempfile.TemporaryDirectory() as folder:
        made = flexgen.generate(MODEL, Path(folder) / "library", functions=["inverse_dynamics"])
        mover = JointMoves(
            equations, TimeLaw(1.0, 5), flexgen.load(made.directory).inverse_dynamics
        )
    found = mover.torques(starts, ends)
    worst = 0.0
    began = time.process_time()
    for move, torque in zip(moves, found, strict=True):
        one = flexgen.solve(equations, move, "closed-form", verify=False).trajectory["tau_m"]
        worst = max(
            worst, float((np.abs(torque - one).max(axis=0) / np.abs(one).max(axis=0)).max())
        )
    return worst, (time.process_time() - began) / count, float(mover.n)


def main() -> None:
    """Print the table; write it if it is complete."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else COUNT
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    options = {"verify": False, "batch": True}
    began = time.perf_counter()
    sweep(Grid([MODEL], random_moves(1), ["closed-form"], options=options), workers=0)
    prepared = time.perf_counter() - began
    worst, alone, samples = agreement(COMPARED)
    lines = [
        "| shards | moves | processor s (target: at most 20) | processor us a move | wall s "
        "(shared computer) | digest of the results |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    digests = set()
    times = []
    walls = []
    for shards in SHARDS:
        grid = Grid([MODEL], random_moves(count), ["closed-form"], options=options)
        wall = time.perf_counter()
        cpu = time.process_time()
        swept = sweep(grid, workers=0, shard_size=-(-count // shards))
        wall = time.perf_counter() - wall
        cpu = time.process_time() - cpu
        assert (swept.results["status"] == "solved").all(), swept.results["error"]
        digests.add(swept.results.digest)
        times.append(cpu)
        walls.append(wall)
        lines.append(
            f"| {shards} | {count} | {cpu:.2f} | {1e6 * cpu / count:.0f} | {wall:.2f} | "
            f"`{swept.results.digest[:16]}` |"
        )
    torque = swept.results["torque_max"]
    warned = int((swept.results["warnings"] != "").sum())
    lines += [
        "",
        f"The target is 10,000 moves in {LIMIT:.0f} s of processor time on one core; the "
        f"largest time is {max(times):.2f} s. The wall time of this run was {min(walls):.2f} to "
        f"{max(walls):.2f} s, as other programs used the computer: "
        f"{sum(wall > LIMIT for wall in walls)} of {len(walls)} rows above {LIMIT:.0f} s.",
        f"Each move takes one second and has {samples:.0f} samples. Preparation, not included: "
        f"equations and C library in {prepared:.1f} s.",
        f"The bits of the results are {'the same' if len(digests) == 1 else 'NOT the same'} for "
        f"all rows. Difference from `flexgen.solve` on {COMPARED} of the moves: {worst:.1e} of "
        f"the largest torque of the motor, at every sample; `flexgen.solve` takes {alone:.2f} s "
        "per move.",
        f"Largest motor torque of a move: {torque.min():.3g} to {torque.max():.3g} N m; "
        f"{warned} moves exceed a limit of the model.",
    ]
    text = "\n".join(lines) + "\n"
    print(text, end="")
    if len(digests) > 1 or worst > 1e-9 or (count == COUNT and max(times) > LIMIT):
        sys.exit("failed: other bits, other torques, or too slow")
    if count == COUNT:
        Path(__file__).with_suffix(".md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
