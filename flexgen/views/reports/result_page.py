"""Pages of results: tables, then plots; one without a page of its own gets the text of its
command, and its picture.
"""

from __future__ import annotations

import html
from pathlib import Path

from flexgen.base.errors import ArgumentError
from flexgen.base.files.atomic_files import write_text
from flexgen.base.registry import provides
from flexgen.base.results import Result
from flexgen.views.plots import canvas
from flexgen.views.reports.folder import PAGE, check_folder, foot
from flexgen.views.reports.html import figure_element, head
from flexgen.views.reports.pictures import Picture
from flexgen.views.reports.row_views import html_of_rows
from flexgen.views.reports.text_tables import fit_tables


@provides("Result.report")
def write_result(result: Result, directory: str | Path) -> Path:
    """The page of a result: its text with tables, and its picture where it has one."""
    title = type(result).__name__
    try:
        drawn = [Picture("picture", result.plot(), repr(result).strip("<>"))]
    except ArgumentError:  # no picture
        drawn = []
    parts = [head(title), f"<h1>{html.escape(title)}</h1>\n", _tables(result)]
    return write_page(Path(directory), parts, drawn)


def _tables(result: Result) -> str:
    """The content of the result; of one that has none of its own, its text with tables, of any
    width, or, where that is one line, the table of notebooks.
    """
    warnings = [html.escape(str(each)) for each in getattr(result, "warnings", ())]
    items = "".join(f"<li>{each}</li>" for each in warnings)
    warned = f'<div class="warn"><ul>{items}</ul></div>' if items else ""
    if result.has_content():
        return html_of_rows(result.content(), not result.problem, is_page=True) + warned
    with fit_tables(None):
        text = result.to_text()
    if text == str(result):
        return result._repr_html_()
    return f'<pre class="wide">{html.escape(text)}</pre>{warned}'


def write_page(directory: Path, parts: list[str], drawn: list[Picture]) -> Path:
    """Write ``index.html`` of the parts and the plots, and each plot as svg and png file; return
    the page.
    """
    check_folder(
        directory,
        [PAGE, *(f"{picture.name}.{end}" for picture in drawn for end in ("svg", "png"))],
    )
    figures = "".join(figure_element(picture, directory) for picture in drawn)
    for picture in drawn:
        canvas.save(picture.figure, directory / f"{picture.name}.png")
    plots = f"<h2>Plots</h2>\n{figures}" if drawn else ""
    return write_text(directory / PAGE, "".join([*parts, plots, foot()]))
