"""Plots of predictions: errors of robots, bands of torques and deflections, shares."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from flexgen.base.registry import provides
from flexgen.studies.tolerances.result import Band, Prediction
from flexgen.views.plots import canvas as cv

BARS = 10  # largest shares
LINES = 3  # motors, and springs, with the widest bands


@provides("Prediction.plot")
@cv.apply_style
def plot_prediction(found: Prediction) -> Figure:
    """Errors of the simulated robots, shares of their sources, and bands over time."""
    solution = found.solution
    title = f"{solution.model.title}, move {solution.move.name}: {found.sentence()}"
    figure = cv.new_figure(cv.WIDTH, 6.4, title)
    axes = figure.subplots(2, 2)
    _plot_errors(axes[0, 0], found)
    _plot_shares(axes[0, 1], found)
    _plot_band(
        axes[1, 0], found.time, found.torque, "motor torque: change, 95 % of the robots", "N m"
    )
    unit = "rad or m" if any(c.unit == "m" for c in solution.model.coordinates) else "rad"
    if not found.deflection.names:  # a rigid robot
        axes[1, 1].set_axis_off()
        return figure
    _plot_band(
        axes[1, 1], found.time, found.deflection, "deflection: change, 95 % of the robots", unit
    )
    return figure


def _plot_errors(ax: Any, found: Prediction) -> None:
    """Distribution of the largest errors."""
    errors, limit, unit = (found.errors_m, found.error_m, "m") if found.errors_m is not None else (
        found.errors_rad, found.error_rad, "rad"
    )  # fmt: skip
    assert errors is not None
    factor, shown = cv.choose_prefix(float(errors.max()), unit)
    x = np.sort(factor * errors)
    ax.step(x, 100 * np.arange(1, len(x) + 1) / len(x), where="post", color=cv.BLUE)
    if limit is not None:
        ax.axvline(factor * limit, color=cv.RED, lw=1.2, label="95 %")
        ax.legend(loc="lower right")
    ax.set(
        xlabel=f"largest error, {shown}", ylabel="robots below, %", ylim=(0, 102), xlim=(0, None)
    )
    ax.set_title(f"{found.robots} robots with motor feedback")


def _plot_shares(ax: Any, found: Prediction) -> None:
    """Shares of the sources in the variance of the error, the largest `BARS` of them."""
    shares = found.shares[:BARS][::-1]
    ax.barh(
        [share.name for share in shares],
        [100 * share.share for share in shares],
        color=cv.GREEN,
        height=0.65,
    )
    ax.set(xlabel="share of the variance, %")
    ax.set_title("what contributes to the error")


def _plot_band(ax: Any, t: np.ndarray, band: Band, title: str, unit: str) -> None:
    """The `LINES` widest bands of robots, less what is planned, over t (n,) [s]."""
    width = np.abs(np.stack([band.low, band.high]) - band.planned).max(axis=(0, 1))
    factor, shown = cv.choose_prefix(float(width.max()), unit)
    for color, j in zip(cv.COLORS, np.argsort(-width, kind="stable")[:LINES], strict=False):
        low, high = (factor * (x[:, j] - band.planned[:, j]) for x in (band.low, band.high))
        ax.fill_between(t, low, high, color=color, alpha=0.35, lw=0.8, label=band.names[j])
    ax.set(xlabel="time, s", ylabel=shown, xlim=(t[0], t[-1]))
    ax.set_title(title)
    ax.legend(loc="upper right")
