"""The content of closed loops: rows, tables and sentences, see `flexgen.base.rows`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from flexgen.base.rows import Column, Data, Inner, Part, Prose, Row, Shown, Table
from flexgen.dynamics.mechanics.output_columns import columns_in

UNITS = ("m", "rad")
SHOWN_ERRORS = {
    "error_max": "error",
    "dynamic_error_max": "dynamic",
    "static_error_start": "at rest before",
    "error_end": "at rest after",
}
"""Errors of a robot that are printed: keys of `ControlRun.figures` and titles of columns."""

WORDS_OF_FORCES = {
    "force": "of the process on the tool",
    "assumed_force": "that the feedforward assumes",
    "force_error": "of the feedforward less that of the process",
}
STATIC = (
    "Static errors are those at rest before and after the motion, of a robot with other springs "
    "or load; the dynamic error is what remains when they are taken off along the path."
)


def content_of_run(run: Any) -> tuple[Part, ...]:
    """The loop, the errors of its robots, figures of ISO 9283, and the stability margins."""
    margins = run.margins()
    loads = [f"{r.name}: load {r.load}" for r in run.runs if r.load]
    return (
        Prose(f"{run.model.title}: closed loop, move {run.solution.move.name}", is_title=True),
        Data("model", run.model.name),
        Data("variant", run.model.variant),
        Data("move", run.solution.move.name),
        Data("status", run.status),
        *([Row("status", run.status, "", "status")] if run.status == "done" else []),
        *_rows_of_loop(run),
        *([Prose(run.status, "status")] if run.status != "done" else []),
        *_instability(margins),
        robots_table(run),
        *(Prose(line, "loads") for line in loads),
        *([Prose(STATIC)] if len(run.runs) > 1 else []),
        *_accuracy(run),
        *margins_parts(margins),
    )


def _rows_of_loop(run: Any) -> tuple[Part, ...]:
    """Controller, times, forces of a process, and effort of the simulation."""
    sample_s = run.hardware.sample_s
    simulated = float(np.ptp(run.reference.time))
    return (
        Row("controller", run.controller, "", "controller"),
        Row("sample time", 1e3 * sample_s, "ms"),
        Data("sample_time_s", sample_s),
        Row("delay from the measurement to the torque", 1e3 * run.delay_s, "ms"),
        Data("delay_s", run.delay_s),
        Row("noise of the encoders", 1e6 * run.hardware.encoder_noise_rad or None, "urad"),
        Data("encoder_noise_rad", run.hardware.encoder_noise_rad),
        *(
            Row(_words_of_force(key), force, key.rpartition("_")[2].replace("Nm", "N m"), key)
            for key, force in run.force_figures().items()
        ),
        Row("integration steps in a sample", run.steps, "", "integration_steps"),
        Row("simulated time of each robot", simulated, "s", "simulated_s"),
        Row("time of the simulation", run.wall_s, "s", "wall_s"),
    )


def _words_of_force(key: str) -> str:
    """The label of a key of `ControlRun.force_figures`, such as ``force_error_max_N``."""
    name, unit = key.split("_max_")
    return f"{'moment' if unit == 'Nm' else 'force'} {WORDS_OF_FORCES[name]}, largest"


def _instability(margins: Mapping[str, Any]) -> tuple[Part, ...]:
    """A sentence on the poses at which the linear loop of the model is unstable."""
    unstable = ", ".join(pose for pose, margin in margins.items() if not margin.stable)
    if not unstable:
        return ()
    return (Prose(f"the loop is unstable ({unstable}): errors grow, also after this run", "loop"),)


def robots_table(run: Any) -> Table:
    """The errors, torques and limits of each robot; a dash where it failed."""
    errors = [
        Column(title, unit, f"{key}_{unit}", is_data=not columns_in(run.model, unit))
        for unit in UNITS
        for key, title in SHOWN_ERRORS.items()
    ]
    touched = any(robot.contact is not None for robot in run.runs)
    columns = (
        Column("robot", "", "plant"),
        *errors,
        Column("turn", "rad", "turn_max_rad", is_data=True),
        Column("torque", "N m", "torque_max_Nm"),
        *([Column("wall", "N", "contact_max_N")] * touched),
        Column("samples at the limit", "", "saturated_samples"),
        Column("failure", "", "failure"),
        Column("load", "", "load", is_data=True),
    )
    keys = [column.key for column in columns]
    cells = tuple(_cells_of_robot(run, robot, keys) for robot in run.runs)
    return Table(columns, cells, "Errors", "plants")


def _cells_of_robot(run: Any, robot: Any, keys: list[str]) -> tuple[object, ...]:
    """The figures of a robot; None for a number that is not finite."""
    figures = run.figures(robot)
    values = [figures.get(key) for key in keys]
    return tuple(
        None if isinstance(value, float) and not math.isfinite(value) else value
        for value in values
    )


def has_accuracy(run: Any) -> bool:
    """Whether the figures of ISO 9283 have a meaning: a robot came to rest, no loop is
    unstable.
    """
    return any(not robot.failure for robot in run.runs) and not run.unstable


def _accuracy(run: Any) -> tuple[Part, ...]:
    """The figures of ISO 9283; of an unstable loop in JSON only."""
    if has_accuracy(run):
        return (Inner("accuracy", run.accuracy().content()),)
    failed = all(robot.failure for robot in run.runs)
    return (Data("accuracy", None if failed else run.accuracy().to_dict()),)


def margins_parts(margins: Mapping[str, Any], what: str = "pose") -> tuple[Part, ...]:
    """A table of stability margins with their frequencies; in JSON an object for each."""
    columns = (
        Column(what),
        Column("stable"),
        Column("largest eigenvalue"),
        Column("gain margin"),
        Column("dB"),
        Column("at", "Hz"),
        Column("phase margin", "deg"),
        Column("at", "Hz"),
        Column("delay margin", "ms"),
    )
    cells = tuple(
        (
            name,
            "yes" if margin.stable else "no",
            Shown(margin.largest_eigenvalue, f"{margin.largest_eigenvalue:.5g}"),
            *map(
                _or_none,
                (
                    margin.gain,
                    margin.gain_db,
                    margin.gain_hz,
                    margin.phase_deg,
                    margin.phase_hz,
                    1e3 * margin.delay_s,
                ),
            ),
        )
        for name, margin in margins.items()
    )
    data = Data("margins", {name: margin.to_dict() for name, margin in margins.items()})
    title = "Margins of the linear loop"
    return (Table(columns, cells, title), data) if cells else (data,)


def _or_none(value: float) -> float | None:
    """A margin; None for one that was not found."""
    return value if math.isfinite(value) else None


def content_of_feedforwards(compared: Any) -> tuple[Part, ...]:
    """The errors of one move with no, rigid and elastic feedforward, and what is missing."""
    names = [*compared.runs]
    method = compared.elastic.solution.method
    title = "feedforward compared, the same feedback: none, of the rigid robot, and elastic"
    rows = compared.rows()
    unstable = [
        f"{name}: {run.status}" for name, run in compared.runs.items() if run.status != "done"
    ]
    missing = [f"{name}: not compared: {reason}" for name, reason in compared.missing.items()]
    return (
        Prose(f"{title} ({method})", is_title=True),
        Data("rows", rows),
        Data("status", {name: run.status for name, run in compared.runs.items()}),
        Data("missing", compared.missing),
        *(_errors_in(rows, names, unit) for unit in UNITS if any(r["unit"] == unit for r in rows)),
        *(Prose(line, "missing") for line in (*unstable, *missing)),
    )


def _errors_in(rows: list[dict[str, object]], names: list[str], unit: str) -> Table:
    """The largest errors of one unit, a column for each feedforward."""
    columns = (Column("robot"), Column("largest"), *(Column(name, unit) for name in names))
    cells = tuple(
        (
            row["robot"],
            row["what"],
            *("failed" if row[name] is None else row[name] for name in names),
        )
        for row in rows
        if row["unit"] == unit
    )
    return Table(columns, cells)
