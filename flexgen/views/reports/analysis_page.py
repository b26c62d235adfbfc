"""The report of an analysis: one self-contained HTML page with tables and plots."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np

from flexgen.analysis.analyze import Analysis
from flexgen.base.registry import provides
from flexgen.views.plots import along_path
from flexgen.views.plots.compliance import compliance_plot
from flexgen.views.reports.html import head
from flexgen.views.reports.pictures import Picture, linear_pictures
from flexgen.views.reports.result_page import write_page
from flexgen.views.reports.row_views import html_of_rows

COMPLIANCE = (
    "What a force at the tool displaces while the motors stand still. Upper panels: "
    "displacements by 1 N in all directions, seen along z, y and x of the world. Lower panel: "
    "amplitude by a sinusoidal force. A feedforward reduces it only where the force is known or "
    "measured."
)


@provides("Analysis.report")
def write_analysis(analysis: Analysis, directory: str | Path) -> Path:
    """Write ``index.html`` with poles, zeros and frequency response; each plot also as svg and png
    file.

    Parameters
    ----------
    analysis : Analysis
        With a path, the zeros along it are drawn, too.
    directory : str or Path
        Created if it does not exist.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    ArgumentError
        The folder has files of another program under these names, or cannot be written.
    """
    model = analysis.model
    drawn = linear_pictures(analysis, "at this equilibrium")
    if analysis.compliance is not None and analysis.compliance.matrix.any():
        drawn.append(Picture("compliance", compliance_plot(analysis), COMPLIANCE))
    path = analysis.zero_path
    if path is not None and np.isfinite(path.zeros).any():
        caption = (
            "Zeros at the equilibrium poses along the path. "
            f"{path.verdict[:1].upper()}{path.verdict[1:]}."
        )
        drawn.append(Picture("zeros_along", along_path.zeros_along(model, path), caption))
    title = f"{model.title}: analysis of an equilibrium"
    parts = [
        head(title),
        f'<h1>{html.escape(title)}</h1>\n<p class="sub">{html.escape(model.description)}.</p>\n',
        html_of_rows(analysis.content(), is_page=True),
    ]
    return write_page(Path(directory), parts, drawn)
