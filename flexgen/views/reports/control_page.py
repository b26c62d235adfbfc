"""Reports of closed loops and of benchmarks: self-contained HTML pages with tables and plots."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np

from flexgen.base.registry import provides
from flexgen.dynamics.mechanics.output_columns import columns_in
from flexgen.feedback.loop.result import ControlRun
from flexgen.planning.learning.learn import LearningResult
from flexgen.studies.scenarios.score import Score
from flexgen.views.plots import control as plots
from flexgen.views.reports.html import (
    head,
    html_table,
    length,
    number,
    scales_of_page,
)
from flexgen.views.reports.pictures import Picture
from flexgen.views.reports.result_page import write_page
from flexgen.views.reports.row_views import html_of_rows


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
    parts = [
        head(title),
        (
            f"<h1>{html.escape(title)}</h1>\n"
            f'<p class="sub">{html.escape(run.model.description)}.</p>\n'
        ),
        html_of_rows(run.content(), run.status == "done", is_page=True),
    ]
    return write_page(Path(directory), parts, drawn)


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
    parts = [
        head(title),
        f'<h1>{html.escape(title)}</h1>\n<p class="sub">{html.escape(s.title_line)}</p>\n',
        (
            f"<p>Published: {html.escape(s.published)}</p>\n"
            f"<p>Of this project: {html.escape(s.ours)}</p>\n"
        ),
        f"<p>Rule: {html.escape(s.rule)}</p>\n" if s.rule else "",
        html_of_rows(score.content(), score.accepted, is_page=True),
    ]
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
