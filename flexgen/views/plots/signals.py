"""Pictures of results that have none of their own kind: channels over time, references of paths,
rows of arrays.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.registry import provides
from flexgen.dynamics.mechanics.output_columns import output_labels, output_units
from flexgen.paths.path import Path
from flexgen.planning.fastest.minimum_time import FastestMove
from flexgen.simulation.result import Simulation
from flexgen.views.plots import canvas as cv
from flexgen.views.plots.solution import plot_solution

INSTANTS = 401


@provides("Trajectory.plot")
def plot_trajectory(trajectory: Trajectory) -> Figure:
    """All channels over time."""
    rows = [
        (f"{name}, {port.unit}", trajectory[name], trajectory.labels[name])
        for name, port in trajectory.ports.items()
    ]
    return _stacked(
        str(trajectory.meta.get("model", "trajectory")), "time, s", trajectory.time, rows
    )


@provides("Simulation.plot")
def plot_simulation(simulation: Simulation) -> Figure:
    """All channels of the simulated motion over time."""
    return plot_trajectory(simulation.trajectory)


@provides("FastestMove.plot")
def plot_fastest(fastest: FastestMove) -> Figure:
    """The solution of the fastest move."""
    return plot_solution(fastest.solution)


@provides("Path.plot")
def plot_path(path: Path) -> Figure:
    """The output y along a path and its first two derivatives dy, ddy in time; of a pose, its
    position.
    """
    t = np.linspace(0.0, path.duration, INSTANTS)
    y = path.sample(t).y
    model = path.equations.model
    units = output_units(model)
    labels = output_labels(model)["y_ref"]
    if len(set(units)) == 1:
        unit = f", {units[0]}"
    else:
        labels = tuple(f"{label}, {unit}" for label, unit in zip(labels, units, strict=True))
        unit = ""
    per = ("/s", "/s^2") if unit else ("", "")
    names = (f"y{unit}", f"dy{unit}{per[0]}", f"ddy{unit}{per[1]}")
    rows = [(name, y[:, :, k], labels) for k, name in enumerate(names)]
    return _stacked(f"{model.title}, move {path.move.name}", "time, s", t, rows)


@provides("Detection.plot", "Estimate.plot", "PathSample.plot", "PlantRun.plot")
def plot_arrays(result: Any) -> Figure:
    """The numbers of each array of a result over its rows; of derivatives the first."""
    arrays = [(field.name, getattr(result, field.name)) for field in fields(result)]
    found = [
        (name, np.asarray(x)) for name, x in arrays if isinstance(x, np.ndarray) and x.ndim > 0
    ]
    rows = [
        (name, x.reshape(len(x), -1, x.shape[-1])[:, :, 0] if x.ndim > 2 else x, ())
        for name, x in found
    ]
    longest = max(len(x) for _, x, _ in rows)
    return _stacked(
        type(result).__name__,
        "row",
        np.arange(longest),
        [row for row in rows if len(row[1]) == longest],
    )


@cv.apply_style
def _stacked(
    title: str, below: str, x: np.ndarray, rows: list[tuple[str, np.ndarray, Any]]
) -> Figure:
    """An axis for each quantity, one below the other; labels of its columns in a legend.

    ``below``: label of the common axis, on which ``x`` (n,) is; ``rows``: name, values (n, k) and
    labels of each quantity.
    """
    figure = cv.new_figure(cv.WIDTH, 1.3 * len(rows) + 0.8, title)
    axes = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for ax, (name, values, labels) in zip(axes, rows, strict=True):
        lines = ax.plot(x, values)
        ax.set_ylabel(name)
        if len(labels):
            ax.legend(
                lines,
                labels,
                loc="center left",
                bbox_to_anchor=(1.0, 0.5),
                frameon=False,
                fontsize=7,
            )
    axes[-1].set_xlabel(below)
    return figure
