"""Reports of closed loops and of benchmarks: self-contained HTML pages with tables and plots."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np

from flexgen.base.display import Scales
from flexgen.base.registry import provides
from flexgen.dynamics.mechanics.output_columns import columns_in
from flexgen.feedback.loop.plants import NOMINAL
from flexgen.feedback.loop.result import UNITS, ControlRun
from flexgen.planning.learning.learn import LearningResult
from flexgen.studies.scenarios.score import Score
from flexgen.views.plots import control as plots
from flexgen.views.reports.control_texts import has_accuracy
from flexgen.views.reports.html import (
    accuracy_tables,
    head,
    html_table,
    length,
    number,
    scales_of_page,
)
from flexgen.views.reports.pictures import Picture
from flexgen.views.reports.result_page import write_page

KEYS = ("error_max", "dynamic_error_max", "static_error_start", "error_end")


@provides("ControlRun.report")
def write_control(run: ControlRun, directory: str | Path) -> Path:
    """Write ``index.html`` with errors, torques and margins of a closed loop; each plot also as
    svg and png file.

    Raises
    ------
    ArgumentError
        The folder has files of another program under these names, or cannot be written.
    """
    drawn = [
        Picture(
            "errors",
            plots.plot_control(run),
            "Above: distance of the output from its reference, with the band of all robots. "
            "Below: torques of the motors of the model, feedforward and feedback.",
        )
    ]
    loops = plots.plot_loops(run)
    if loops is not None:
        drawn.append(
            Picture(
                "loops",
                loops,
                "The sampled loop linearized at the start, middle and end of the motion. Left: "
                "singular values of the loop gain from motor torques to motor torques. Right: "
                "Nyquist plot of det(1 + L); the distance from the cross is that from "
                "instability.",
            )
        )
    title = f"{run.model.title}: closed loop"
    bad = "" if run.status == "done" else " bad"
    facts = [
        ("status", f'<span class="status{bad}">{html.escape(run.status)}</span>', ""),
        ("controller", html.escape(run.controller), ""),
        ("move", html.escape(run.solution.move.name), ""),
        ("sample time", number(1e3 * run.hardware.sample_s), "ms"),
        ("delay from the measurement to the torque", number(1e3 * run.delay_s), "ms"),
        ("noise of the motor angles", number(run.hardware.encoder_noise_rad), "rad"),
        *((word, number(x), unit.replace("Nm", "N m")) for word, x, unit in _forces(run)),
        ("integration steps in a sample", f"{run.steps}", ""),
        ("simulated time", number(len(run.runs) * float(np.ptp(run.reference.time))), "s"),
        ("time of the simulation", number(run.wall_s), "s"),
    ]
    lengths = [
        (run.figures(r)[f"{key}_{u}"], u)
        for r in run.runs
        if not r.failure
        for u in UNITS
        for key in KEYS
    ]
    accuracy = run.accuracy() if has_accuracy(run) else None
    lengths += accuracy.lengths() if accuracy is not None else []
    scales = scales_of_page((), *lengths)
    parts = [
        head(title),
        (
            f"<h1>{html.escape(title)}</h1>\n"
            f'<p class="sub">{html.escape(run.model.description)}.</p>\n'
        ),
        "<h2>Loop</h2>\n",
        html_table(("quantity", "value", "unit"), facts, (1,)),
        "<h2>Errors</h2>\n",
        _errors(run, scales),
        accuracy_tables(accuracy, scales) if accuracy is not None else "",
        _margins(run),
    ]
    return write_page(Path(directory), parts, drawn)


def _forces(run: ControlRun) -> list[tuple[str, float, str]]:
    """Rows of the table of facts for the force of a process: words, value, unit."""
    words = {
        "force": "of the process on the tool",
        "assumed_force": "that the feedforward assumes",
        "force_error": "of the feedforward less that of the process",
    }
    rows = []
    for key, x in run.force_figures().items():
        name, unit = key.split("_max_")
        rows.append((f"{'moment' if unit == 'Nm' else 'force'} {words[name]}, largest", x, unit))
    return rows


def _errors(run: ControlRun, scales: Scales) -> str:
    rows = []
    units = [u for u in UNITS if columns_in(run.model, u)]
    for r in run.runs:
        f = run.figures(r)
        values = [
            "-" if r.failure else length(scales[u], f[f"{key}_{u}"], 4)
            for u in units
            for key in KEYS
        ]
        torque = "-" if r.failure else number(f["torque_max_Nm"])
        rows.append(
            (html.escape(r.name), *values, torque, str(r.saturated), html.escape(r.failure))
        )
    names = ("largest", "largest dynamic", "at rest before", "at rest after")
    errors = [f"{name}, {scales[u].unit}" for u in units for name in names]
    columns = ("robot", *errors, "torque, N m", "samples at the limit", "failure")
    words = (
        "<p>Static errors are those at rest before and after the motion, of a robot with other "
        "springs or load; the dynamic error is what remains when they are taken off along the "
        "path.</p>\n"
    )
    loads = "".join(
        f"<p>{html.escape(r.name)}: load {html.escape(r.load)}.</p>\n" for r in run.runs if r.load
    )
    return html_table(columns, rows, range(1, len(columns) - 1)) + words + loads


def _margins(run: ControlRun) -> str:
    found = run.margins()
    if not found:
        return "<p>The controller is not linear: no margins.</p>\n"

    def show(x: float) -> str:
        return number(x) if np.isfinite(x) else "none found"

    rows = []
    for name, m in found.items():
        margins = (m.gain, m.gain_db, m.gain_hz, m.phase_deg, m.phase_hz, 1e3 * m.delay_s)
        stable = "yes" if m.stable else "no"
        rows.append((name, stable, number(m.largest_eigenvalue, 5), *map(show, margins)))
    columns = (
        "pose",
        "stable",
        "largest eigenvalue",
        "gain margin, factor",
        "dB",
        "at Hz",
        "phase margin, deg",
        "at Hz",
        "delay margin, ms",
    )
    return "<h2>Margins of the linear loop</h2>\n" + html_table(columns, rows, range(2, 9))


@provides("Score.report")
def write_score(score: Score, directory: str | Path) -> Path:
    """Write ``index.html`` with the score of a controller in a benchmark; each plot also as svg
    and png file.

    Raises
    ------
    ArgumentError
        The folder has files of another program under these names, or cannot be written.
    """
    s = score.scenario
    title = f"{s.title}: {score.controller}"
    told = (
        f"<p><b>V = {score.total:.4f}</b> ("
        + ", ".join(f"{html.escape(name)} {value:.4f}" for name, value in score.parts.items())
        + (f"; {score.spread_words}" if score.spread_words else "")
        + "); the reference controller has about 1, smaller is better.</p>\n"
        if score.accepted
        else '<p><span class="status bad">refused, no score</span></p>\n<ul>'
        + "".join(f"<li>{html.escape(reason)}</li>" for reason in score.refused)
        + "</ul>\n"
    )
    parts = [
        head(title),
        f'<h1>{html.escape(title)}</h1>\n<p class="sub">{html.escape(s.title_line)}</p>\n',
        (
            f"<p>Published: {html.escape(s.published)}</p>\n"
            f"<p>Of this project: {html.escape(s.ours)}</p>\n"
        ),
        f"<p>Rule: {html.escape(s.rule)}</p>\n" if s.rule else "",
        told,
        f"<p><b>{html.escape(score.rule)}</b></p>\n" if score.rule else "",
    ]
    if score.accepted:
        sets = list(s.sets)
        rows = [
            (
                html.escape(row["measure"]),
                row["unit"],
                f"{row['weight']:.3f}",
                *(number(row[key]) for key in ("reference", NOMINAL, *sets)),
            )
            for row in score.table
        ]
        columns = (
            "measure",
            "unit",
            "weight",
            "reference",
            NOMINAL,
            *(f"worst of {name}" for name in sets),
        )
        parts += ["<h2>Measures</h2>\n", html_table(columns, rows, range(2, len(columns)))]
    drawn = [
        Picture(
            "score",
            plots.plot_score(score),
            "Above: the outputs of the nominal robot. Middle: measures over those of the "
            "reference controller. Below: score of every robot.",
        )
    ]
    return write_page(Path(directory), parts, drawn)


@provides("LearningResult.report")
def write_learned(learned: LearningResult, directory: str | Path) -> Path:
    """Write ``index.html`` with the iterations of a learned path; each plot also as svg and png
    file.

    Raises
    ------
    ArgumentError
        The folder has files of another program under these names, or cannot be written.
    """
    run = learned.runs[0]
    unit = learned.unit
    title = f"{run.model.title}: learning of move {run.solution.move.name}"
    rows = []
    own = columns_in(run.model, unit)
    sizes = [float(np.abs(x[:, own]).max()) for x in learned.corrections]
    found = [r.figures(r[learned.plant]) for r in learned.runs if not r[learned.plant].failure]
    keys = tuple(f"{key}_{unit}" for key in ("error_max", "dynamic_error_max"))
    lengths = [*sizes, *(f[key] for f in found for key in keys)]
    scale = scales_of_page((), *((x, unit) for x in lengths))[unit]
    for k, (r, size) in enumerate(zip(learned.runs, sizes, strict=True)):
        f = r.figures(r[learned.plant])
        failed = r[learned.plant].failure
        shown = [*(length(scale, f[key], 4) for key in keys), number(f["torque_max_Nm"])]
        values = ["-" if failed else x for x in shown]
        largest = length(scale, size, 4)
        rows.append(
            (f"{k}{', best' if k == learned.best else ''}", *values, largest, html.escape(failed))
        )
    told = [f"{what}, {scale.unit}" for what in ("error", "dynamic error", "largest correction")]
    columns = ("iteration", *told[:2], "torque, N m", told[2], "failure")
    load = run[learned.plant].load
    words = (
        f"<p>Low pass of the correction {number(learned.frequency_hz)} Hz, forwards and "
        f"backwards, gain {number(learned.gain)}. "
        f"{html.escape(learned.stopped)}{f' Load {html.escape(load)}.' if load else ''}</p>\n"
    )
    parts = [
        head(title),
        f"<h1>{html.escape(title)}</h1>\n",
        words,
        html_table(columns, rows, range(1, 5)),
    ]
    drawn = [
        Picture(
            "learning",
            plots.plot_learned(learned),
            "Above: largest error of every iteration. Middle: error in time. Below: correction "
            "of the commanded path in the best iteration.",
        )
    ]
    return write_page(Path(directory), parts, drawn)
