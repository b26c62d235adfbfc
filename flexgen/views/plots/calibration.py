"""Plots of a calibration: distributions of the errors, and the compliances that the measurements
determine.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from flexgen.base.registry import provides
from flexgen.identification.poses.result import Calibration
from flexgen.views.plots import canvas as cv

MOST = 24  # compliances
QUANTILE = 1.96
ROOM = 50.0  # factor by which the axis of distances is extended to the left, for the legend


@provides("Calibration.plot")
@cv.apply_style
def plot_calibration(found: Calibration) -> Figure:
    """Left: part of the positions within a distance. Right: compliances with 95 % bars, the
    largest first.
    """
    names = [u.name for u in found.unknowns if u.kind == "compliance" and found.determined[u.name]]
    names = sorted(names, key=lambda name: -abs(found.values[name]))[:MOST]
    title = f"{found.nominal.title}: calibration with {len(found.poses)} poses"
    figure = cv.new_figure(cv.WIDTH, max(3.6, 0.17 * len(names) + 1.2), title)
    left, right = figure.subplots(1, 2) if names else (figure.subplots(1, 1), None)
    stages = (
        ("model file", found.errors_before, cv.GREY),
        ("sag under gravity", found.sag, cv.SKY),
        ("calibrated", found.errors, cv.BLUE),
        ("without the pose", found.errors_held_out, cv.RED),
        ("others seen", found.errors_seen, cv.GREEN),
    )
    for label, errors, color in stages:
        if errors is not None:
            sizes = np.sort(1e3 * errors[np.isfinite(errors)])
            share = 100.0 * (np.arange(len(sizes)) + 0.5) / len(sizes)
            left.plot(sizes, share, color=color, label=f"{label}, mean {sizes.mean():.3g} mm")
    left.set_xlabel("distance, mm")
    left.set_ylabel("positions within it, %")
    left.set_xscale("log")
    cv.log_axis(left.xaxis)
    left.set_ylim(0.0, 100.0)
    left.set_xlim(left=left.get_xlim()[0] / ROOM)
    left.legend(loc="upper left")
    if right is not None:
        place = np.arange(len(names))[::-1]
        values = np.array([found.values[name] for name in names])
        bars = QUANTILE * np.array([found.sd[name] for name in names])
        right.errorbar(
            1e6 * values, place, xerr=1e6 * bars, fmt="o", ms=3.5, color=cv.BLUE, lw=1.0
        )
        right.axvline(0.0, color=cv.INK, lw=0.7)
        right.set_yticks(place, [name.removesuffix(".compliance") for name in names])
        right.set_xlabel("compliance, urad/(N m), 95 %")
    return figure
