"""Plot of a record and of what a model predicts for it."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from flexgen.base.registry import provides
from flexgen.identification.motions.record_result import SMALL, RecordComparison
from flexgen.views.plots import canvas as cv

MOST = 4000  # points of a curve, at most


@provides("RecordComparison.plot")
@cv.apply_style
def plot_record_comparison(found: RecordComparison) -> Figure:
    """Each channel over the time: the record, and the model with the lag, both without means."""
    rows = len(found.scores)
    title = f"{found.model.title}: {found.source}"
    figure = cv.new_figure(cv.WIDTH, 1.0 + 1.6 * rows, title)
    axes = np.atleast_1d(figure.subplots(rows, sharex=True))
    every = -(-len(found.time) // MOST)
    for k, (score, ax) in enumerate(zip(found.scores, axes, strict=True)):
        measured, predicted = (
            (x[:, k] - x[:, k].mean())[::every] for x in (found.measured, found.predicted)
        )
        time = found.time[::every]
        ax.plot(time, measured, lw=2.0, color=cv.GREY, label="record")
        ax.plot(time, predicted, lw=0.8, color=cv.BLUE, label="model")
        best = score.r2 if score.r2_lag is None else score.r2_lag
        words = SMALL if best is None else f"R2 {best:.3g}"
        ax.set(title=f"{score.channel.name}: {words}", ylabel=score.channel.unit)
    axes[-1].set_xlabel("time, s")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure
