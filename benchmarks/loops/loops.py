"""Robots with kinematic loops: time of `invert` and of updates of a stream.

    python benchmarks/loops/loops.py [--write]

The move of the file, sampled each 2 ms; the stream looks 100 ms ahead and is updated once in each
interval of its mesh. Processor time of the thread, least of several calls from Python. ``--write``
writes ``loops.md``.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import flexgen
from flexgen.studies.templates.new_model import new_model

ROUNDS = 10
UPDATES = 60
PERIOD = 2e-3
PRE = 0.1
AHEAD = 0.1
MESHES = (20e-3, 10e-3)
FILE = Path(__file__).with_name("loops.md")
HEAD = f"""# Robots with kinematic loops

Written by `python benchmarks/loops/loops.py --write`: the first move of the file, samples each \
2 ms, motion of {1e3 * PRE:.0f} ms
before and {2e3 * PRE:.0f} ms after it; a stream looks {1e3 * AHEAD:.0f} ms ahead, one update in \
each interval. Processor time of calls from
Python, least of {ROUNDS}. n_g, n_e, n_d: joints with a motor, with a spring alone, and passive. \
Times real time: duration of the
path, or of an interval, over its processor time.

| robot | n_g | n_e | n_d | mesh, ms | invert, ms | times real time | update, us | \
times real time |
|---|---|---|---|---|---|---|---|---|
"""


def least(rounds: int, call: Callable[[], object]) -> float:
    """Shortest processor time [s] of some calls."""
    times = []
    for _ in range(rounds):
        began = time.thread_time()
        call()
        times.append(time.thread_time() - began)
    return min(times)


def rows_of(robot: flexgen.RobotModel, folder: Path, rounds: int) -> list[str]:
    """Rows of the table of one robot."""
    made = flexgen.generate(robot, folder / robot.name, progress=False)
    library = flexgen.load(made.directory)
    path = flexgen.plan(robot)
    passive = [dof for e in robot.elements for dof in e.dofs if dof.passive is not None]
    rows = []

    def sampled(period: float) -> list[np.ndarray]:
        instants = period * np.arange(round(path.duration / period) + 1)
        sample = path.sample(instants)
        target = sample.y[:, :, 0]
        if sample.R is not None:  # columns of the rotation
            target = np.hstack([target, sample.R.transpose(0, 2, 1).reshape(-1, 9)])
        return [target, sample.derivative(1), sample.derivative(2)]

    for mesh in MESHES:
        y = sampled(PERIOD)
        per_interval = round(mesh / PERIOD)
        before = round(PRE / mesh)

        def invert(y: list[np.ndarray] = y, n: int = per_interval, pre: int = before) -> object:
            counts = {"n_pre": pre, "n_post": 2 * pre, "samples_per_interval": n}
            return library.invert(*y, period=PERIOD, q_start=path.q_start, **counts)

        ahead = sampled(mesh)
        intervals = round(AHEAD / mesh)

        def stream(y: list[np.ndarray] = ahead, n: int = intervals, step: float = mesh) -> float:
            options = {"period": step, "intervals": n, "samples_per_interval": 1}
            stream = library.stream(y[0][0], path.q_start, **options)
            began = time.thread_time()
            for k in range(UPDATES):
                stream.update(*(x[min(k, len(x) - 1)] for x in y))
            return (time.thread_time() - began) / UPDATES

        whole = least(rounds, invert)
        update = min(stream() for _ in range(rounds))
        cells = [robot.name, robot.n_g, robot.n_e, len(passive), f"{1e3 * mesh:.0f}"]
        cells += [f"{1e3 * whole:.2f}", f"{path.duration / whole:.0f}"]
        cells += [f"{1e6 * update:.0f}", f"{mesh / update:.0f}"]
        rows.append(f"| {' | '.join(map(str, cells))} |")
    return rows


def main() -> None:
    """Print the table, and write it where it is wanted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--quick", action="store_true", help="one robot; nothing written")
    given = parser.parse_args()
    rows: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file = folder / "four-bar.toml"
        file.write_text(new_model("four_bar", "four-bar"), encoding="utf-8")
        files: list[str | Path] = [file, "delta", "palletizer", "linkage_arm"]
        for model in files[: 1 if given.quick else None]:
            found = rows_of(flexgen.read(model), folder, 2 if given.quick else ROUNDS)
            print("\n".join(found), flush=True)
            rows += found
    if given.write and not given.quick:
        FILE.write_text(HEAD + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
