"""Plots of the compliance of the tool: where a force moves it, and at which frequencies."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from flexgen.analysis.analyze import Analysis
from flexgen.analysis.compliance import ToolCompliance
from flexgen.views.plots import canvas as cv

AXES = "xyz"
PLANES = ((0, 1), (0, 2), (1, 2))


@cv.apply_style
def compliance_plot(analysis: Analysis) -> Figure:
    """Displacement of the tool by 1 N in any direction, seen along each axis, and over the
    frequency [um/N].

    Parameters
    ----------
    analysis : Analysis
        From `flexgen.analyze`, with a compliance.
    """
    found = analysis.compliance
    assert found is not None  # the caller has looked
    figure = cv.new_figure(
        cv.WIDTH, 6.4, f"{analysis.model.title}: compliance of the tool with held motors"
    )
    upper, lower = figure.subfigures(2, 1, height_ratios=[2.6, 3.4])
    _draw_ellipses(upper, found)
    _draw_response(lower, found)
    return figure


def _draw_ellipses(figure: Any, found: ToolCompliance) -> None:
    """The ellipsoid of displacements by unit forces, projected onto the planes of the world."""
    C = 1e6 * found.matrix[:3, :3]
    top = 1.15 * np.linalg.norm(C, 2)
    angle = np.linspace(0.0, 2 * np.pi, 181)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    for ax, plane in zip(figure.subplots(1, 3), PLANES, strict=True):
        rows = C[list(plane)]
        values, directions = np.linalg.eigh(rows @ rows.T)
        x, y = directions @ (np.sqrt(np.maximum(values, 0.0))[:, None] * circle)
        ax.fill(x, y, color=cv.BLUE, alpha=0.2, lw=0)
        ax.plot(x, y, color=cv.BLUE, lw=1.3)
        ax.axhline(0.0, color=cv.GREY, lw=0.6)
        ax.axvline(0.0, color=cv.GREY, lw=0.6)
        ax.set(xlim=(-top, top), ylim=(-top, top), aspect="equal")
        ax.set(xlabel=f"{AXES[plane[0]]}, µm/N", ylabel=f"{AXES[plane[1]]}, µm/N")


def _draw_response(figure: Any, found: ToolCompliance) -> None:
    """Amplitude along each axis of the world by a sinusoidal force of 1 N along this axis."""
    f = found.frequencies
    response = np.abs(np.einsum("kii->ki", found.response(f)[:, :3, :3]))
    ax = figure.subplots()
    for k, name in enumerate(AXES):
        if response[:, k].max(initial=0.0) > 1e-9 * response.max(initial=0.0):
            ax.plot(
                f,
                1e6 * response[:, k],
                color=cv.COLORS[k],
                lw=1.3,
                label=f"{name} by a force along {name}",
            )
    if len(f):
        ax.set(xscale="log", yscale="log", xlim=(f[0], f[-1]))
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        figure.legend(loc="outside lower center", ncols=3)
    ax.set(xlabel="frequency, Hz", ylabel="µm/N")
