"""Plots along a path: zeros at its poses, tool errors of several methods."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from flexgen.analysis.zero_dynamics.zeros import ON_AXIS
from flexgen.analysis.zero_dynamics.zeros_along_path import ZeroPath
from flexgen.base.errors import ArgumentError
from flexgen.base.registry import provides
from flexgen.feedback.loop.comparison import Comparison
from flexgen.inversion.comparison.comparison import error_sizes
from flexgen.inversion.solution import Solution
from flexgen.model.elements import RobotModel
from flexgen.views.plots import canvas as cv


@cv.apply_style
def zeros_along(model: RobotModel, path: ZeroPath) -> Figure:
    """Real parts of the zeros over time on logarithmic axes; unstable zeros above, stable zeros
    below.
    """
    finite = np.isfinite(path.zeros)
    size = np.abs(path.zeros)
    real = np.where(finite, path.zeros.real, np.nan)
    oscillatory = finite & (np.abs(path.zeros.imag) > 1e-7 * size)
    halves = [
        ("unstable zeros", "real part, 1/s", real > ON_AXIS * size),
        ("stable zeros", "\N{MINUS SIGN}real part, 1/s", real < -ON_AXIS * size),
    ]
    drawn = [half for half in halves if half[2].any()]
    if not drawn:
        raise ArgumentError(
            "zeros along the path: given only zeros on the imaginary axis, expected at least "
            "one off it"
        )
    title = f"{model.title}: zeros along the path"
    figure = cv.new_figure(cv.WIDTH, 0.6 + 2.3 * len(drawn), title)
    times = np.broadcast_to(path.t[:, None], path.zeros.shape)
    for ax, (name, label, here) in zip(
        figure.subplots(len(drawn), 1, squeeze=False)[:, 0], drawn, strict=True
    ):
        unstable = name == "unstable zeros"
        color = cv.COLORS[1 if unstable else 0]
        for mask, marker, kind in (
            (here & ~oscillatory, "o", "real zero"),
            (here & oscillatory, "D", "complex pair"),
        ):
            if mask.any():
                ax.semilogy(
                    times[mask],
                    np.abs(real[mask]),
                    marker,
                    ms=3,
                    mfc="none",
                    color=color,
                    label=kind,
                )
        sizes = np.abs(real[here])
        ax.set_ylim(sizes.min() / 1.3, 1.3 * sizes.max())
        cv.log_axis(ax.yaxis)
        ax.set_ylabel(label)
        margin = 0.015 * (path.t[-1] - path.t[0])
        ax.set(xlim=(path.t[0] - margin, path.t[-1] + margin), xlabel="time, s")
        counts = path.unstable if unstable else finite.sum(axis=1) - path.unstable
        few = int(counts.min())
        many = int(counts.max())
        number = f"{few}" if few == many else f"{few} to {many}"
        ax.set_title(f"{name}: {number} of {path.zeros.shape[1]}")
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        if not unstable:
            ax.invert_yaxis()
    return figure


@cv.apply_style
def errors_of_methods(model: RobotModel, solutions: tuple[Solution, ...]) -> Figure:
    """Simulated tool error over time on a logarithmic axis, one line per method."""
    found = {
        solution.method: (solution.trajectory.time, error_sizes(solution))
        for solution in solutions
    }
    units = [u for u in ("m", "rad") if any(u in errors for _, errors in found.values())]
    if not units:
        raise ArgumentError(
            "errors of methods: given only solutions without verification, expected at least "
            "one with it"
        )
    one = solutions[0]
    first = min(float(t[0]) for t, _ in found.values())
    window = (
        max(first, -0.06 * one.move.duration),
        one.move.duration,
        max(float(t[-1]) for t, _ in found.values()),
    )
    title = f"{model.title}, move {one.move.name}: tool error by method, start on the path"
    figure = cv.new_figure(cv.WIDTH, 0.6 + 2.5 * len(units), title)
    for ax, unit in zip(figure.subplots(len(units), 1, squeeze=False)[:, 0], units, strict=True):
        top = max(float(errors[unit].max()) for _, errors in found.values() if unit in errors)
        factor, shown = cv.choose_prefix(top, unit)
        least = min(float(errors[unit].max()) for _, errors in found.values() if unit in errors)
        floor = max(1e-3 * least, 1e-15)
        for k, (name, (t, errors)) in enumerate(found.items()):
            if unit in errors:
                values = factor * np.maximum(errors[unit], 0.5 * floor)
                largest = " ".join(cv.measure(float(errors[unit].max()), unit))
                ax.semilogy(t, values, color=cv.COLORS[k % 7], lw=1.2, label=f"{name}: {largest}")
        ax.set_ylim(factor * floor, 4 * factor * top)
        cv.log_axis(ax.yaxis)
        ax.set_ylabel(("distance, " if unit == "m" else "angle, ") + shown)
        cv.time_axis(ax, *window)
        ax.legend(
            loc="center left",
            bbox_to_anchor=(1.0, 0.5),
            title=f"largest {'distance' if unit == 'm' else 'angle'}",
        )
    return figure


@provides("Comparison.plot")
def plot_comparison(comparison: Comparison) -> Figure:
    """Tool errors over time, see `flexgen.compare`."""
    return errors_of_methods(comparison.solution.model, comparison.solutions)
