"""Identification of robots with a fault: what it states, and whether that is true.

    python benchmarks/identification_faults/identification_faults.py RESULTS.json [NAME ...]

simulates an experiment for each fault in faults.py, fits the model to it, and writes the table
benchmarks/identification_faults/identification_faults.md. Rows in the file are not computed again.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from faults import FAULTS, LINES, NOISE, PERIOD_S, POSES, SPEED, Fault, another, plain

import flexgen
from flexgen.base.errors import FlexgenError
from flexgen.dynamics.mechanics.parameters import select
from flexgen.identification.experiments.experiment import Experiment
from flexgen.identification.records.experiment_file import read_experiment
from flexgen.identification.records.recording_writer import RecordingWriter

FOLDER = Path(__file__).resolve().parent
HEAD = (
    "fault",
    "status",
    "largest error, %",
    "the same in formal sd",
    "inside 95 % of those stated",
    "first cause named",
)


def robots(fault: Fault) -> tuple[Any, Any]:
    """The model that is fitted, and the true robot."""
    robot = plain(fault.robot)
    if not fault.gravity:  # gravity holds a gear on one side of its backlash
        robot = replace(robot, gravity=(0.0, 0.0, 0.0))
    return fault.model(robot), fault.truth(another(robot, 1))


def experiment(fault: Fault, model: Any, truth: Any) -> Experiment:
    """The simulated experiment, with its fault; samples are changed in recordings, which are
    read.
    """
    settings = {
        "poses": POSES,
        "lines": LINES,
        "period_s": PERIOD_S,
        "speed_rms": SPEED,
        "hardware": NOISE,
    } | dict(fault.plan)
    plan = flexgen.excite(model, progress=False, **settings)
    change = fault.samples
    if change is None:
        return fault.spectra(flexgen.measure(plan, truth, seed=3, progress=False))
    with tempfile.TemporaryDirectory() as folder:
        writer = RecordingWriter(Path(folder), plan, model)

        def keep(
            k: int, r: int, e: int, q_m: np.ndarray, tau_m: np.ndarray, signals: np.ndarray
        ) -> None:
            writer(k, r, e, *change(q_m, tau_m), signals)

        flexgen.measure(plan, truth, seed=3, raw=keep, progress=False)
        return read_experiment(writer.finish())


def measure_fault(fault: Fault) -> dict[str, Any]:
    """A row of the table."""
    model, truth = robots(fault)
    began = time.perf_counter()
    found = flexgen.identify(model, flexgen.frf(experiment(fault, model, truth)), progress=False)
    known = {
        p.name: p.value
        for p in select(
            truth,
            ["stiffness", "damping", *(n for n in found.vector.names if n.endswith(".viscous"))],
        )
    }
    names = [name for name in found.vector.names if known.get(name)]
    away = {name: float(np.log(found.values[name] / known[name])) for name in names}
    formal = dict(zip(found.vector.names, np.sqrt(np.diag(found.formal_covariance)), strict=True))
    inside = [abs(away[name]) < 1.96 * sd for name in names if (sd := found.sd[name]) is not None]
    return {
        "status": str(found.status),
        "largest_error": max(map(abs, away.values())),
        "largest_in_sd": float(max(abs(away[name]) / formal[name] for name in names)),
        "stated": len(inside),
        "inside": sum(inside),
        "causes": [str(x) for x in found.causes],
        "wall_s": time.perf_counter() - began,
    }


def table(rows: dict[str, dict[str, Any]]) -> str:
    """The page."""
    lines = ["| " + " | ".join(HEAD) + " |", "|" + " --- |" * len(HEAD)]
    named = wrong = faults = 0
    for fault in FAULTS:
        row = rows[fault.name]
        first = row["causes"][0] if row["causes"] else "-"
        if fault.cause:
            faults += 1
            named += fault.cause in first
            wrong += row["status"] == "fitted" and row["inside"] < 0.9 * row["stated"]
        cells = [fault.name, row["status"], *["-"] * 3, first]
        if row["status"] != "refused":
            cells[2:4] = f"{100 * row['largest_error']:.2g}", f"{row['largest_in_sd']:.2g}"
            cells[4] = f"{row['inside']} of {row['stated']}" if row["stated"] else "none stated"
        lines.append("| " + " | ".join(cells) + " |")
    return f"""# Identification of robots with a fault

`python benchmarks/identification_faults/identification_faults.py RESULTS.json` makes this table. \
Simulated experiments
at {POSES} poses, {LINES} lines, noise of encoders {NOISE.encoder_noise_rad:g} rad, of torques \
{NOISE.torque_noise_Nm:g}
N m on the motor side; springs and dampers of the robot differ from the model by up to 20 %, and \
one thing is wrong. Of
{faults} faults {named} are named by the first cause, and {wrong} end as `fitted` with fewer than \
90 % of the true
values inside the stated 95 % intervals.

{chr(10).join(lines)}
"""


def main(arguments: list[str]) -> None:
    """Compute the rows that are missing, and write the page."""
    file = Path(arguments[0])
    names = arguments[1:]
    rows = json.loads(file.read_text()) if file.is_file() else {}
    for fault in FAULTS:
        if fault.name in rows or (names and not any(name in fault.name for name in names)):
            continue
        try:
            rows[fault.name] = measure_fault(fault)
        except FlexgenError as error:  # the words without the name of the file
            rows[fault.name] = {
                "status": "refused",
                "causes": [str(error).partition(".npz: ")[2] or str(error)],
            }
        file.write_text(json.dumps(rows, indent=1))
        print(fault.name, rows[fault.name], flush=True)
    if all(fault.name in rows for fault in FAULTS):
        (FOLDER / "identification_faults.md").write_text(table(rows))


if __name__ == "__main__":
    main(sys.argv[1:])
