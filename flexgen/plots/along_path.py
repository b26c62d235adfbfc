"""Pictures along a path: the zeros of its poses, and the tool errors of several methods side by side."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from flexgen.analysis.zeros import ON_AXIS
from flexgen.analysis.zeros_along_path import ZeroPath
from flexgen.errors import ArgumentError
from flexgen.inversion.comparison import error_sizes
from flexgen.inversion.solution import Solution
from flexgen.model.elements import RobotModel
from flexgen.plots import canvas as cv


@cv.styled
def zeros_along(model: RobotModel, path: ZeroPath) -> Figure:
    """Real parts of the zeros over time, unstable ones above, stable ones below, each logarithmic."""
    finite = np.isfinite(path.zeros)
    size = np.abs(path.zeros)
    real = np.where(finite, path.zeros.real, np.nan)
    swings = finite & (np.abs(path.zeros.imag) > 1e-7 * size)
    halves = [
        ("unstable zeros, real part, 1/s", real > ON_AXIS * size),
        ("stable zeros, minus real part, 1/s", real < -ON_AXIS * size),
    ]
    drawn = [(label, here) for label, here in halves if here.any()]
    if not drawn:
        raise ArgumentError("zeros along the path: given a machine without zeros off the axis, expected some to draw")
    title = f"{cv.title_of(model)}: zeros along the path"
    figure = cv.new_figure(cv.WIDTH, 0.6 + 2.3 * len(drawn), title)
    times = np.broadcast_to(path.t[:, None], path.zeros.shape)
    for ax, (label, here) in zip(figure.subplots(len(drawn), 1, squeeze=False)[:, 0], drawn, strict=True):
        unstable = label.startswith("unstable")
        colour = cv.COLOURS[1 if unstable else 0]
        for mask, marker, name in ((here & ~swings, "o", "real"), (here & swings, "D", "pair")):
            if mask.any():
                ax.semilogy(times[mask], np.abs(real[mask]), marker, ms=3, mfc="none", color=colour, label=name)
        cv.log_axis(ax.yaxis)
        ax.set_ylabel(label)
        ax.set_xlabel("time on the path, s")
        ax.set_xlim(path.t[0], path.t[-1])
        counts = path.unstable if unstable else finite.sum(axis=1) - path.unstable
        few, many = int(counts.min()), int(counts.max())
        number = f"{few}" if few == many else f"{few} to {many}"
        ax.set_title(f"{number} of {path.zeros.shape[1]}", loc="right", fontsize=8.5)
        ax.legend(loc="best", ncols=2)
        if not unstable:
            ax.invert_yaxis()
    return figure


@cv.styled
def errors_of_methods(model: RobotModel, solutions: tuple[Solution, ...]) -> Figure:
    """Size of the simulated tool error over time, logarithmic, one line a method."""
    found = {solution.method: (solution.trajectory.time, error_sizes(solution)) for solution in solutions}
    units = [u for u in ("m", "rad") if any(u in errors for _, errors in found.values())]
    if not units:
        raise ArgumentError("errors of methods: given solutions that were not verified, expected some with simulation")
    title = f"{cv.title_of(model)}: tool error by method"
    figure = cv.new_figure(cv.WIDTH, 0.6 + 2.5 * len(units), title)
    for ax, unit in zip(figure.subplots(len(units), 1, squeeze=False)[:, 0], units, strict=True):
        top = max(float(errors[unit].max()) for _, errors in found.values() if unit in errors)
        factor, shown = cv.prefixed(top, unit)
        least = min(float(errors[unit].max()) for _, errors in found.values() if unit in errors)
        floor = max(1e-3 * least, 1e-15)
        for k, (name, (t, errors)) in enumerate(found.items()):
            if unit in errors:
                values = factor * np.maximum(errors[unit], 0.5 * floor)
                largest = " ".join(cv.measure(float(errors[unit].max()), unit))
                ax.semilogy(t, values, color=cv.COLOURS[k % 7], lw=1.2, label=f"{name}: {largest}")
        ax.set_ylim(factor * floor, 4 * factor * top)
        cv.log_axis(ax.yaxis)
        ax.set_ylabel(("distance from the path, " if unit == "m" else "angle to the reference, ") + shown)
        ax.set_xlabel("time, s")
        ax.legend(loc="lower center", ncols=2, fontsize=8)
    return figure
