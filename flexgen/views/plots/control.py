"""Plots of closed loops: errors and torques of all robots, Bode and Nyquist plots, scores of
benchmarks.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from flexgen.base.registry import provides
from flexgen.dynamics.mechanics.output_columns import output_units
from flexgen.feedback.loop.result import ControlRun
from flexgen.paths.force.tool_force import LABELS
from flexgen.planning.learning.learn import LearningResult
from flexgen.studies.scenarios.draws import draws_of
from flexgen.studies.scenarios.score import Score
from flexgen.studies.scenarios.tune import TuningResult
from flexgen.views.plots import canvas as cv

COLORS = (cv.BLUE, cv.RED, cv.GREEN, cv.ORANGE, cv.PURPLE, cv.SKY, cv.GREY)


@provides("ControlRun.plot")
@cv.apply_style
def plot_control(run: ControlRun) -> Figure:
    """Distance of the output from its reference in time, all robots; below it the motor torques of
    the model.

    Below them the force of a process, and that of a wall.
    """
    title = f"{run.model.title}: move {run.solution.move.name} under controller {run.controller}"
    touched = any(r.contact is not None for r in run.runs)
    more = [_plot_force] * (run.force is not None) + [_plot_contact] * touched
    figure = cv.new_figure(cv.WIDTH, 5.4 + 1.8 * len(more), title)
    ratios = (1.2, 1.0, *[0.7] * len(more))
    top, bottom, *last = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    time = run.reference.time
    good = [r for r in run.runs if not r.failure]
    largest = max((float(run.distance(r).max()) for r in good), default=1.0)
    factor, unit = cv.choose_prefix(largest, run.unit)
    for k, r in enumerate(run.runs):
        color = COLORS[k % len(COLORS)]
        if r.failure:
            top.plot([], [], color=color, label=f"{r.name}: {r.failure}")
            continue
        top.plot(
            time, factor * run.distance(r), color=color, lw=1.8 if k == 0 else 1.1, label=r.name
        )
    if len(good) > 1:
        stack = np.array([factor * run.distance(r) for r in good])
        top.fill_between(
            time, stack.min(axis=0), stack.max(axis=0), color=cv.SKY, alpha=0.15, lw=0
        )
    top.set_ylabel(f"output error, {unit}")
    top.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    for ax in (top, bottom, *last):
        ax.axvspan(0.0, run.reference.path_end, color=cv.GREY, alpha=0.08, lw=0)
        ax.set_xlim(max(time[0], run.reference.begin - 0.2), time[-1])
    for j, motor in enumerate(run.model.motors):
        color = COLORS[j % len(COLORS)]
        bottom.plot(time, run.nominal.tau_m[:, j], color=color, lw=1.0, label=motor.name)
    bottom.set_ylabel("torque of the model, N m")
    (bottom, *last)[-1].set_xlabel("time, s (grey: path)")
    bottom.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    for ax, draw in zip(last, more, strict=True):
        draw(ax, run)
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _plot_force(ax: Any, run: ControlRun) -> None:
    """The force of the process on the tool, and dashed that of the feedforward."""
    assert run.force is not None
    for k, label in enumerate(LABELS):
        for values, dashes in (
            (run.force[:, k], cv.DASHES[0]),
            (run.assumed_force[:, k], cv.DASHES[1]),
        ):
            if values.any():
                word = label if dashes == cv.DASHES[0] else f"{label}, assumed"
                ax.plot(run.reference.time, values, color=COLORS[k], ls=dashes, lw=1.0, label=word)
    ax.set_ylabel("force, N" if not run.force[:, 3:].any() else "force, N; moment, N m")


def _plot_contact(ax: Any, run: ControlRun) -> None:
    """The size of the force of the wall on the tool of each robot."""
    for k, r in enumerate(run.runs):
        if r.contact is not None and not r.failure:
            size = np.linalg.norm(r.contact, axis=1)
            ax.plot(run.reference.time, size, color=COLORS[k % len(COLORS)], lw=1.0, label=r.name)
    ax.set_ylabel("force of the wall, N")


@cv.apply_style
def plot_loops(run: ControlRun) -> Figure | None:
    """Largest and smallest loop gain over frequency, and the Nyquist plot; None for a controller
    that is not linear.
    """
    loops = run.loops()
    if not loops:
        return None
    title = f"{run.model.title}: linear loops under {run.controller}"
    figure = cv.new_figure(cv.WIDTH, 3.8, title)
    bode, nyquist = figure.subplots(1, 2)
    for k, (name, loop) in enumerate(loops.items()):
        found = loop.response(0.1)
        color = COLORS[k % len(COLORS)]
        bode.plot(found.hz, found.gains[:, 0], color=color, label=name)
        if found.gains.shape[1] > 1:
            bode.plot(found.hz, found.gains[:, -1], color=color, ls=cv.DASHES[1], lw=1.0)
        # A logarithmic radius shows both the surroundings of the origin and the low frequencies.
        z = found.nyquist
        z = z / np.abs(z) * np.log1p(np.abs(z))
        nyquist.plot(z.real, z.imag, color=color, lw=1.0)
    bode.axhline(1.0, color=cv.INK, lw=0.7)
    bode.set_xscale("log")
    bode.set_yscale("log")
    for axis in (bode.xaxis, bode.yaxis):
        cv.log_axis(axis)
    bode.set_xlabel("frequency, Hz")
    bode.set_ylabel("singular values of the loop gain\n(largest; dashed: smallest)")
    bode.legend()
    nyquist.plot([0.0], [0.0], "+", color=cv.INK, ms=9)
    nyquist.set_aspect("equal", adjustable="datalim")
    nyquist.set_title("det(1 + L), radius log(1 + r)")
    return figure


@provides("Score.plot")
@cv.apply_style
def plot_score(score: Score) -> Figure:
    """The nominal run, measures over those of the reference controller, and the scores of all
    robots.
    """
    s = score.scenario
    figure = cv.new_figure(
        cv.WIDTH, 7.4, f"{s.name} version {s.version}: controller {score.controller}"
    )
    run, bars, robots = figure.subplots(3, 1, height_ratios=(1.2, 1.6, 0.9))
    z = score.traces["z"]
    time = s.sample_s * np.arange(len(z))
    for k, output in enumerate(s.outputs):
        run.plot(time, z[:, k], color=COLORS[k], lw=0.8, label=output.name)
    for k, d in enumerate(draws_of(s, score.seed)[0].disturbances):
        end = min(d.end_s, s.duration_s) if np.isfinite(d.end_s) else d.start_s + 0.05
        run.axvspan(
            d.start_s,
            max(end, d.start_s + 0.05),
            color=COLORS[(k + 2) % len(COLORS)],
            alpha=0.15,
            lw=0,
        )
    run.set_xlabel("time, s (colored: disturbances)")
    run.set_ylabel(", ".join(dict.fromkeys(f"{o.name}, {o.unit}" for o in s.outputs)))
    run.set_title("nominal robot" if s.plan is None else "nominal robot, first draw")
    if len(s.outputs) > 1:
        run.legend()
    _bars(bars, score)
    names = [name.replace(", ", " ") for name in s.plants.names]
    at = np.arange(len(names))
    robots.bar(at, score.each if score.accepted else np.zeros(len(names)), color=cv.BLUE)
    if len(score.totals) > 1:
        own = score.per_draw
        robots.errorbar(
            at, own.mean(axis=0), yerr=own.std(axis=0, ddof=1), fmt="none", ecolor=cv.INK, lw=0.8
        )
    robots.axhline(1.0, color=cv.INK, lw=0.7)
    robots.set_xticks(at, names, rotation=60, ha="right", fontsize=7)
    robots.set_title(
        "score of each robot, bars: spread over the draws"
        if len(score.totals) > 1
        else "score of each robot"
        if score.accepted
        else "refused: no score"
    )
    return figure


@provides("TuningResult.plot")
def plot_tuning(tuned: TuningResult) -> Figure:
    """The score of the tuned controller."""
    return plot_score(tuned.score)


def _bars(ax: Any, score: Score) -> None:
    """Measures of the nominal robot, and the largest of all robots, over those of the
    reference.
    """
    ratios = (score.values / score.reference[:, None]).mean(axis=0)
    at = np.arange(len(score.measures))
    ax.barh(at, ratios.max(axis=0), color=cv.SKY, alpha=0.6, label="worst robot")
    ax.barh(at, ratios[0], color=cv.BLUE, height=0.5, label="nominal")
    ax.axvline(1.0, color=cv.INK, lw=0.7)
    ax.set_yticks(at, [measure.name for measure in score.measures], fontsize=6.5)
    ax.invert_yaxis()
    ax.set_xlabel("measure over that of the reference controller")
    ax.legend(loc="lower right")


@provides("LearningResult.plot")
@cv.apply_style
def plot_learned(learned: LearningResult) -> Figure:
    """Largest error of every iteration, errors in time without correction and in the best one, and
    the correction.
    """
    first = learned.runs[0]
    best = learned.runs[learned.best]
    figure = cv.new_figure(
        cv.WIDTH, 6.0, f"{first.model.title}: learning of move {first.solution.move.name}"
    )
    top, middle, bottom = figure.subplots(3, 1, height_ratios=(1.0, 1.2, 1.0))
    errors = 1e3 * np.array(learned.errors)
    unit = f"m{learned.unit}"
    top.semilogy(np.arange(len(errors)), errors, "o-", color=cv.BLUE)
    top.plot([learned.best], [errors[learned.best]], "o", color=cv.RED, label="best")
    top.set_xlabel("iteration")
    top.set_ylabel(f"largest error, {unit}")
    top.xaxis.get_major_locator().set_params(integer=True)
    cv.log_axis(top.yaxis)
    top.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    for run, color, label in (
        (first, cv.GREY, "before learning"),
        (best, cv.BLUE, f"iteration {learned.best}"),
    ):
        middle.plot(
            run.reference.time, 1e3 * run.distance(run[learned.plant]), color=color, label=label
        )
    middle.set_ylabel(f"error, {unit}")
    middle.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    correction = learned.corrections[learned.best]
    columns = correction[:, : min(3, correction.shape[1])]
    for k, (x, own) in enumerate(zip(columns.T, output_units(first.model), strict=False)):
        bottom.plot(learned.time, 1e3 * x, color=COLORS[k], label=f"output {k + 1}, m{own}")
    bottom.set_ylabel("correction")
    bottom.set_xlabel("time, s (grey: path)")
    bottom.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    for ax in (middle, bottom):
        ax.axvspan(0.0, first.reference.path_end, color=cv.GREY, alpha=0.08, lw=0)
        ax.set_xlim(learned.time[0], learned.time[-1])
    return figure
