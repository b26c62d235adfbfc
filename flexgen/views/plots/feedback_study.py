"""Plot of the study of feedback linearization: worst error over torque noise."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from flexgen.base.registry import provides
from flexgen.feedback.laws.study import FAMILIES, FeedbackStudy
from flexgen.views.plots import canvas as cv

# what is shown
LARGEST_M = 0.03
LOUDEST_NM = 1e3
COLORS = dict(zip(FAMILIES, (cv.GREY, cv.ORANGE, cv.RED, cv.PURPLE, cv.BLUE), strict=True))


@provides("FeedbackStudy.plot")
@cv.apply_style
def plot_feedback_study(study: FeedbackStudy) -> Figure:
    """Worst error of the six robots over torque noise of all tunings, a panel for each setting
    with measured angles.
    """
    settings = [s for s in study.settings if not s.exact] or list(study.settings)
    title = (
        f"{study.model.title}: worst error of {len(study.plants)} robots, every tuning of each "
        "feedback"
    )
    figure = cv.new_figure(cv.WIDTH, 3.8, title)
    panels = figure.subplots(1, len(settings), sharey=True, squeeze=False)[0]
    for ax, setting in zip(panels, settings, strict=True):
        for family in FAMILIES:
            good = [
                t
                for t in study.of(setting, family)
                if t.worst_m < LARGEST_M and 0 < t.torque_noise_Nm < LOUDEST_NM
            ]
            if not good:
                continue
            order = sorted(good, key=lambda t: t.torque_noise_Nm)
            x = [t.torque_noise_Nm for t in order]
            y = [1e3 * t.worst_m for t in order]
            ax.plot(x, y, "o", color=COLORS[family], ms=4.5, label=family)
            ax.step(x, np.minimum.accumulate(y), where="post", color=COLORS[family], lw=1.2)
        ax.axvline(study.torque_noise_Nm, color=cv.INK, lw=0.8, ls=cv.DASHES[1])
        ax.set_xscale("log")
        ax.set_yscale("log")
        for axis in (ax.xaxis, ax.yaxis):
            cv.log_axis(axis)
        ax.set_xlabel("torque noise at rest, peak to peak, N m")
        ax.set_title(str(setting))
    panels[0].set_ylabel("worst error, mm")
    if panels[-1].get_legend_handles_labels()[0]:
        panels[-1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure
