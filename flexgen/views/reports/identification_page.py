"""The report of an identification: one self-contained HTML page with tables and plots."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np

from flexgen.analysis.linear import linearize, modes, poles
from flexgen.base.registry import provides
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.result import IdentificationResult
from flexgen.model.elements import RobotModel
from flexgen.views.plots import identification as plots
from flexgen.views.reports.html import head
from flexgen.views.reports.html_tables import html_table, number
from flexgen.views.reports.pictures import Picture
from flexgen.views.reports.result_page import write_page
from flexgen.views.reports.row_views import html_of_rows

CORRELATED = 0.5  # correlations from here on are listed
MOST_POSES = 12  # response grids in a page


@provides("IdentificationResult.report")
def write_identification(identified: IdentificationResult, directory: str | Path) -> Path:
    """Write ``index.html`` with the fit, its parameters and pictures; each plot also as svg and
    png file.

    Raises
    ------
    ArgumentError
        The folder has files of another program under these names, or cannot be written.
    """
    model = identified.vector.model
    drawn = [
        Picture(
            f"responses_{k + 1}",
            plots.response_grid(identified.data, identified, k),
            "Amplitude from each motor's torque (column) to each motor's acceleration (row). "
            "Points: measured, with the 95 % band of their noise; grey: model at the start; "
            "red: identified model.",
        )
        for k in range(min(len(identified.data.poses), MOST_POSES))
    ]
    drawn[1:1] = [
        Picture(
            "parameters",
            plots.parameter_plot(identified),
            "Identified parameters over those of the model file"
            + (", with two standard deviations" if identified.status.has_deviations else "")
            + ". Grey: not determined by the data; the new model keeps the value of the file.",
        ),
        Picture(
            "residuals",
            plots.residual_plot(identified),
            "Differences between identified model and measurement over their standard "
            "deviations, all poses. Where noise is the only difference, half of the points are "
            "below the black line and 95 % below the red one. More in a band of frequencies: "
            "something is missing in the model there.",
        ),
        Picture(
            "correlations",
            plots.correlation_plot(identified),
            "Correlations of the identified parameters.",
        ),
    ]
    title = f"{model.title}: identification"
    parts = [
        head(title),
        f'<h1>{html.escape(title)}</h1>\n<p class="sub">{html.escape(model.description)}.</p>\n',
        "<h2>Fit</h2>\n",
        html_of_rows(identified.content(), identified.status.agrees, is_page=True),
        _correlations(identified),
        "<h2>Natural frequencies at home</h2>\n",
        _modes(model, identified.model),
    ]
    return write_page(Path(directory), parts, drawn)


@provides("Frf.report")
def write_responses(data: Frf, directory: str | Path) -> Path:
    """Write ``index.html`` with measured frequency responses; each plot also as svg and png
    file.
    """
    drawn = [
        Picture(
            f"responses_{k + 1}",
            plots.response_grid(data, None, k),
            "Amplitude from each motor's torque (column) to each motor's acceleration (row), "
            "with the 95 % band of the noise.",
        )
        for k in range(min(len(data.poses), MOST_POSES))
    ]
    title = f"{data.model}: frequency responses"
    parts = [
        head(title),
        f"<h1>{html.escape(title)}</h1>\n",
        html_of_rows(data.content(), is_page=True),
    ]
    return write_page(Path(directory), parts, drawn)


def _correlations(identified: IdentificationResult) -> str:
    """Large correlations, and what is hidden in the parameters, in words."""
    lines = []
    names = identified.vector.names
    correlation = identified.correlation
    pairs = [(abs(correlation[i, k]), i, k) for i in range(len(names)) for k in range(i)]
    for size, i, k in sorted(pairs, reverse=True)[:20]:
        if size > CORRELATED:
            lines.append(
                html.escape(f"{names[k]} and {names[i]}: correlation {correlation[i, k]:+.2f}.")
            )
    hidden = (
        "Masses, payload and lengths were taken from the model file: errors there are hidden in "
        "the parameters."
    )
    return f"<ul>{''.join(f'<li>{line}</li>' for line in [*lines, hidden])}</ul>\n"


def _modes(before: RobotModel, after: RobotModel) -> str:
    """Table of frequencies and damping ratios at home of the models before and after, as HTML; a
    sentence where their numbers differ.
    """
    tables = []
    for model in (before, after):
        equations = derive(model)
        tables.append(
            modes(poles(linearize(equations, hold_joints(equations, np.array(model.home)))))
        )
    if len(tables[0]) != len(tables[1]):
        return "<p>The numbers of oscillatory modes differ before and after.</p>\n"
    rows = [
        (f"{k}", number(a[0]), number(100 * a[1]), number(b[0]), number(100 * b[1]))
        for k, (a, b) in enumerate(zip(*tables, strict=True), 1)
    ]
    names = ("mode", "before, Hz", "damping, %", "after, Hz", "damping, %")
    return html_table(names, rows, (0, 1, 2, 3, 4))
