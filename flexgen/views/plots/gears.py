"""Plots of the hysteresis of gears and of springs that were identified."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from flexgen.base.errors import ArgumentError
from flexgen.base.registry import provides
from flexgen.identification.gears.result import GearFit
from flexgen.identification.gears.spring_result import SpringFit
from flexgen.views.plots import canvas as cv

MOST = 6000  # points of a loop, at most


@provides("GearFit.plot")
@cv.apply_style
def plot_loops(found: GearFit) -> Figure:
    """Torque of the hysteresis of each gear over its deflection: of the model, and of the
    record.
    """
    count = len(found.joints)
    if not count:
        raise ArgumentError(
            "plot: given gears without hysteresis, expected a fit of at least one loop; identify "
            "them with hysteresis=True"
        )
    columns = min(count, 3)
    rows = -(-count // columns)
    figure = cv.new_figure(cv.WIDTH, 1.0 + 2.6 * rows, f"{found.robot.title}: {found.sentence()}")
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    units = {c.name: c.unit for c in found.robot.coordinates}
    every = -(-len(found.loops) // MOST)
    for k, (name, ax) in enumerate(zip(found.joints, axes, strict=False)):
        d, z, measured = found.loops[::every, k].T
        unit = "mrad" if units[name] == "rad" else "mm"
        ax.plot(1e3 * d, measured, ".", ms=1.5, color=cv.GREY, label="record")
        ax.plot(1e3 * d, z, lw=0.8, color=cv.BLUE, label="model")
        ax.set(
            title=name,
            xlabel=f"deflection, {unit}",
            ylabel="z, N m" if units[name] == "rad" else "z, N",
        )
    for ax in axes[count:]:
        ax.set_visible(False)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


@provides("SpringFit.plot")
@cv.apply_style
def plot_spring(found: SpringFit) -> Figure:
    """Torque of a gear over its deflection in each record: measured, and by the law."""
    count = len(found.records)
    columns = min(count, 3)
    rows = -(-count // columns)
    figure = cv.new_figure(cv.WIDTH, 1.0 + 2.6 * rows, f"{found.robot.title}: {found.sentence()}")
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    turns = next(c.unit for c in found.robot.coordinates if c.name == found.joint) == "rad"
    for one, ax in zip(found.records, axes, strict=False):
        d, measured, computed = one.points[:: -(-len(one.points) // MOST)].T
        ax.plot(1e3 * d, measured, ".", ms=1.5, color=cv.GREY, label="record")
        ax.plot(1e3 * d, computed, lw=0.8, color=cv.BLUE, label="model")
        ax.set(
            title=f"{one.name}, {'fitted' if one.is_fitted else 'held out'}",
            xlabel=f"deflection, {'mrad' if turns else 'mm'}",
            ylabel=f"torque, {'N m' if turns else 'N'}",
        )
    for ax in axes[count:]:
        ax.set_visible(False)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure
