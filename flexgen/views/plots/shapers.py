"""Plot of input shapers: the vibration that remains over the duration of the commands."""

from __future__ import annotations

from matplotlib.figure import Figure

from flexgen.base.registry import provides
from flexgen.feedback.positions.shaper_comparison import ShaperComparison
from flexgen.feedback.positions.shapers import NAMES
from flexgen.views.plots import canvas as cv

# By the name of a shaper: grey for no shaper.
COLORS = dict(zip(NAMES, (cv.GREY, cv.ORANGE, cv.BLUE), strict=True))


@provides("ShaperComparison.plot")
@cv.apply_style
def plot_shapers(found: ShaperComparison) -> Figure:
    """A point for each run; numbers are the frequency of the shaper over that of the mode."""
    title = f"{found.model.title}, move {found.move.name}: vibration of {found.coordinate}"
    figure = cv.new_figure(cv.WIDTH, 4.0, title)
    ax = figure.subplots()
    for name in NAMES:
        runs = [run for run in found.runs if run.shaper == name]
        sizes = [1e3 * run.vibration for run in runs]
        ax.plot([run.duration_s for run in runs], sizes, "o", color=COLORS[name], label=name)
        for run, size in zip(runs, sizes, strict=True):
            if name != NAMES[0]:
                ax.annotate(f" {run.detuning:g}", (run.duration_s, size))
    unit = "mrad" if found.unit == "rad" else "mm"
    ax.set(xlabel="duration of the commands, s", ylabel=f"vibration after them, {unit}")
    ax.legend()
    return figure
