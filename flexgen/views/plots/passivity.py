"""Plot of the passivity of a loop: the damping that it has at the tool, over the frequency."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from flexgen.base.registry import provides
from flexgen.feedback.laws.passivity import Passivity
from flexgen.views.plots import canvas as cv

COLORS = (cv.BLUE, cv.ORANGE, cv.GREEN)


@provides("Passivity.plot")
@cv.apply_style
def plot_passivity(found: Passivity) -> Figure:
    """Smallest damping at the tool over the frequency, a line for each pose; below zero the loop
    is not passive.
    """
    words = "passive" if found.passive else f"not passive, first at {found.fails_hz:.3g} Hz"
    figure = cv.new_figure(cv.WIDTH, 3.2, f"{found.model}, {found.controller}: {words}")
    ax = figure.subplots()
    for k, (name, margins) in enumerate(zip(found.poses, found.margins, strict=True)):
        ax.plot(found.hz, margins, color=COLORS[k % len(COLORS)], label=name)
    size = max(10.0 ** np.floor(np.log10(np.abs(found.margins).min() + 1e-9)), 1.0)
    ax.axhline(0.0, color=cv.INK, lw=0.8)
    ax.set_xscale("log")
    cv.log_axis(ax.xaxis)
    ax.set_yscale("symlog", linthresh=size)
    ax.yaxis.set_major_formatter(FuncFormatter(cv.power))
    ax.set(xlabel="frequency, Hz", ylabel="damping at the tool, N s/m")
    ax.legend()
    return figure
