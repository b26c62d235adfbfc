"""Plots of position commands and of identified servos."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from flexgen.base.registry import provides
from flexgen.feedback.loop.result import ControlRun
from flexgen.feedback.positions.result import PositionCommands
from flexgen.identification.servo.fit_result import ServoFit
from flexgen.views.plots import canvas as cv

SMALLEST = 1e-12  # m or rad: smaller errors are drawn as this


@provides("PositionCommands.plot")
@cv.apply_style
def plot_commands(found: PositionCommands) -> Figure:
    """Commanded joints, what they add to the joints of the arm, and the errors with and without
    the inverse.
    """
    model = found.run.model
    move = found.run.solution.move.name
    figure = cv.new_figure(
        cv.WIDTH, 6.6, f"{model.title}, move {move}: positions to send, {found.status}"
    )
    top, middle, below = figure.subplots(3, 1)
    unit = " or ".join(dict.fromkeys("mm" if unit == "m" else "deg" for unit in found.units))
    factor = np.array([1e3 if own == "m" else 180 / np.pi for own in found.units])
    planned = found.run.solution.trajectory
    at = (
        planned.at(np.clip(found.time, planned.time[0], planned.time[-1]))["q_m"]
        @ np.linalg.inv(model.eta).T
    )
    for ax, values, label in (
        (top, found.joint, f"commanded, {unit}"),
        (middle, found.joint - at, f"minus planned, {unit}"),
    ):
        lines = ax.plot(found.time, factor * values, lw=1.2)
        ax.set_ylabel(label)
        ax.legend(lines, found.joints, loc="center left", bbox_to_anchor=(1.0, 0.5))
    for run, color, label in (
        (found.today, cv.RED, "planned motor angles"),
        (found.run, cv.BLUE, "these positions"),
    ):
        _plot_error(below, run, color, label)
    below.set(xlabel="time, s", ylabel=f"tool error, {found.run.unit}", yscale="log")
    cv.log_axis(below.yaxis)
    below.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    for ax in (top, middle, below):
        ax.set_xlim(found.time[0], found.time[-1])
    return figure


def _plot_error(ax: Any, run: ControlRun, color: str, label: str) -> None:
    """Draw the tool error of the model over time, at least `SMALLEST`, for a logarithmic axis."""
    ax.plot(
        run.reference.time,
        np.maximum(run.distance(run.nominal), SMALLEST),
        color=color,
        lw=1.2,
        label=label,
    )


@provides("ServoFit.plot")
@cv.apply_style
def plot_fit(found: ServoFit) -> Figure:
    """Lag of the joints behind their commands, and the gains with their standard deviations."""
    record = found.record
    figure = cv.new_figure(cv.WIDTH, 5.0, f"{found.model}: {found.sentence()}")
    top, below = figure.subplots(2, 1)
    top.plot(record.time, record.command - record.angle, lw=1.0)
    top.set(xlabel="time, s", ylabel="command minus angle, rad or m")
    x = np.arange(len(found.motors))
    for k, (name, color) in enumerate(
        zip(("position", "speed", "integral"), cv.COLORS, strict=False)
    ):
        below.errorbar(
            x + 0.15 * (k - 1),
            np.zeros(len(x)),
            196 * found.gain_sd[k],
            fmt="o",
            ms=3,
            color=color,
            label=f"{name} gain",
        )
    below.set_xticks(x, found.motors)
    below.set(ylabel="95 % interval, %")
    below.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
