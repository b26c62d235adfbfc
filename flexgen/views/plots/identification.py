"""Plots of an identification: frequency responses with the model, residuals, parameters,
correlations.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from flexgen.base.registry import provides
from flexgen.identification.experiments.operating_points import FRICTIONS
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.residuals import Residuals
from flexgen.identification.responses.result import IdentificationResult
from flexgen.views.plots import canvas as cv

QUANTILE = 1.96
# Median and 95 % quantile of the size of a complex Gaussian number whose mean square is 1.
MEDIAN = np.sqrt(np.log(2.0))
HIGH = np.sqrt(-np.log(0.05))


@provides("Frf.plot")
@cv.apply_style
def response_grid(
    data: Frf, identified: IdentificationResult | None = None, pose: int = 0
) -> Figure:
    """Measured responses from each torque to each acceleration with their 95 % bands, and those of
    the model.

    Parameters
    ----------
    data : Frf
    identified : IdentificationResult, optional
        Draws the model at the start and with the identified parameters.
    pose : int
        From 0.
    """
    n = len(data.motors)
    rows = len(data.outputs)
    hz = data.w / (2 * np.pi)
    width = max(cv.WIDTH, 1.9 * n)
    title = f"{data.model}: frequency responses at pose {pose + 1} of {len(data.poses)}"
    figure = cv.new_figure(width, max(3.4, 1.45 * rows + 0.9), title)
    axes = figure.subplots(rows, n, sharex=True, sharey="row", squeeze=False)
    models: list[tuple[str, np.ndarray, dict[str, Any]]] = []
    if identified is not None:
        residuals = Residuals(identified.vector, data, deflection_sd=identified.deflection_sd)
        for label, x, style in (
            ("start", identified.vector.start, {"color": cv.GREY, "ls": cv.DASHES[1], "lw": 1.0}),
            ("identified", identified.x, {"color": cv.RED, "lw": 1.2}),
        ):
            models.append((label, np.abs(residuals.response(x).G[pose]), style))
    # of the amplitude: half of the complex variance
    size = np.abs(data.G[pose])
    sd = np.sqrt(data.variance[pose] / 2)
    for a in range(rows):
        for b in range(n):
            ax = axes[a, b]
            band = [
                np.maximum(size[:, a, b] + s * QUANTILE * sd[:, a, b], 1e-3 * size[:, a, b])
                for s in (-1, 1)
            ]
            ax.fill_between(hz, *band, color=cv.SKY, alpha=0.5, lw=0)
            ax.plot(hz, size[:, a, b], ".", ms=2.5, color=cv.BLUE, label="measured, 95 % band")
            for label, G, style in models:
                ax.plot(hz, G[:, a, b], label=label, **style)
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.grid(visible=True, which="major")
            if a == 0:
                ax.set_title(f"torque {data.motors[b]}")
            if b == 0:
                ax.set_ylabel(data.outputs[a])
            if a == rows - 1:
                cv.log_axis(ax.xaxis, 4)
    for a in range(rows):  # the scale of a row is that of its largest response
        top = size[:, a].max()
        low = np.percentile(size[:, a], 2)
        axes[a, 0].set_ylim(max(low / 3, top * 1e-5), 2 * top)
        cv.log_axis(axes[a, 0].yaxis, 5)
    figure.supxlabel("frequency, Hz", fontsize=9)
    of_motors = "acceleration over torque, rad/(s² N m)"
    of_sensors = "acceleration, torque or force over torque, SI units"
    figure.supylabel(of_motors if rows == n else of_sensors, fontsize=9)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower right", ncols=3)
    return figure


@cv.apply_style
def residual_plot(identified: IdentificationResult) -> Figure:
    """Differences between model and measurement over their standard deviations; noise alone gives
    the lines drawn.
    """
    data = identified.data
    residuals = Residuals(identified.vector, data, deflection_sd=identified.deflection_sd)
    difference = residuals.response(identified.x).G - data.G
    size = np.abs(difference) / np.sqrt(identified.variance)
    hz = data.w / (2 * np.pi)
    figure = cv.new_figure(
        cv.WIDTH, 4.0, f"{data.model}: residuals over their standard deviations"
    )
    ax = figure.add_subplot()
    n = len(data.motors)
    same = np.eye(len(data.outputs), len(data.motors), dtype=bool)
    sensors = np.zeros_like(same)
    sensors[n:] = True
    for chosen, label, color in (
        (sensors, "sensors", cv.GREY),
        (~same & ~sensors, "torque of another motor", cv.SKY),
        (same, "torque of the same motor", cv.BLUE),
    ):
        if chosen.any():
            points = size[:, :, chosen]
            x = np.broadcast_to(hz[None, :, None], points.shape)
            ax.plot(
                x.ravel(), points.ravel(), ".", ms=2, color=color, label=label, rasterized=True
            )
    ax.axhline(MEDIAN, color=cv.INK, lw=1.0, label="median of noise")
    ax.axhline(HIGH, color=cv.RED, lw=1.0, ls=cv.DASHES[1], label="95 % of noise")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_ylim(0.02, max(10.0, 1.5 * float(size.max())))
    ax.set(xlabel="frequency, Hz", ylabel="residual / standard deviation")
    cv.log_axis(ax.xaxis)
    cv.log_axis(ax.yaxis)
    figure.legend(loc="outside lower center", ncols=4 if n > 1 else 3, markerscale=3)
    return figure


@provides("Estimated.plot")
@cv.apply_style
def parameter_plot(identified: IdentificationResult) -> Figure:
    """Identified values over those of the model file, with two standard deviations where the
    result has them.
    """
    unknowns = [
        u for u in identified.vector.unknowns if u.scale == "log" and u.parameter.value > 0
    ]
    groups = [g for g in _split([u.name for u in unknowns]) if g]
    rows = [max(len(g), 3) for g in groups]
    height = 0.19 * sum(rows) + 0.7 * len(groups) + 0.5
    figure = cv.new_figure(
        cv.WIDTH, height, f"{identified.vector.model.title}: identified over the model file"
    )
    axes = figure.subplots(len(groups), 1, squeeze=False, gridspec_kw={"height_ratios": rows})[
        :, 0
    ]
    in_file = {u.name: u.parameter.value for u in unknowns}
    for ax, names in zip(axes, groups, strict=True):
        _draw_parameters(ax, identified, names, in_file)
    words = (
        "bars: two standard deviations"
        if identified.status.has_deviations
        else "no standard deviations"
    )
    axes[-1].set_xlabel(f"value / value of the model file   ({words}; grey: not determined)")
    return figure


def _split(names: list[str]) -> tuple[list[str], list[str]]:
    """Frictions apart from the others: they are known much less well."""
    frictions = [name for name in names if name.endswith(FRICTIONS)]
    return [name for name in names if name not in frictions], frictions


def _draw_parameters(
    ax: Any, identified: IdentificationResult, names: list[str], in_file: dict[str, float]
) -> None:
    """Draw the parameters ``names`` below each other: value over that ``in_file``, with a bar of
    two standard deviations; those that the data do not determine are grey and do not set the
    limits.
    """
    sd = identified.sd
    values = identified.values
    for k, name in enumerate(names):
        color = cv.GREY if identified.is_weak(name) else cv.BLUE
        ratio = values[name] / in_file[name]
        deviation = sd[name]
        if deviation is not None:
            spread = np.exp(2 * min(deviation, 3.0))
            ax.plot([ratio / spread, ratio * spread], [k, k], color=color, lw=2)
        ax.plot(ratio, k, "o", ms=4, color=color)
    ax.axvline(1.0, color=cv.INK, lw=0.8)
    ax.set_xscale("log")
    strong = [values[name] / in_file[name] for name in names if not identified.is_weak(name)]
    seen = strong or [values[name] / in_file[name] for name in names]
    ax.set_xlim(min(0.8, 0.8 * min(seen)), max(1.25, 1.25 * max(seen)))
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.4, -0.6)
    cv.log_axis(ax.xaxis)


@cv.apply_style
def correlation_plot(identified: IdentificationResult) -> Figure:
    """Correlations of the identified parameters."""
    names = identified.vector.names
    size = max(4.0, 0.19 * len(names) + 1.8)
    figure = cv.new_figure(
        size + 0.8, size, f"{identified.vector.model.title}: correlations of parameters"
    )
    ax = figure.add_subplot()
    image = ax.imshow(identified.correlation, cmap="RdBu_r", vmin=-1, vmax=1)
    ax.set_xticks(range(len(names)), names, rotation=90)
    ax.set_yticks(range(len(names)), names)
    ax.grid(visible=False)
    figure.colorbar(image, ax=ax, shrink=0.7)
    return figure
