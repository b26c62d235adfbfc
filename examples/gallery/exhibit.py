"""Shared page of the gallery's scripts: question, table, literature and run time are printed, and
one picture is saved.
"""

from __future__ import annotations

import sys
import textwrap
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from flexgen.views.plots import canvas

FOLDER = "reports/gallery"


class Page:
    """The output of one script: a table and a figure."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.picture: Figure | None = None

    def table(self, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        """Print a table; numbers with four digits."""
        cells = [
            [f"{x:.4g}" if isinstance(x, float) else str(x) for x in row]
            for row in (header, *rows)
        ]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        for line in (cells[0], ["-" * width for width in widths], *cells[1:]):
            print(
                "  "
                + "  ".join(
                    cell.ljust(width) for cell, width in zip(line, widths, strict=True)
                ).rstrip()
            )
        print()

    def figure(self, height: float = 3.4) -> Figure:
        """The empty picture, of the width of a page; height in inches."""
        self.picture = canvas.new_figure(canvas.WIDTH, height, self.title)
        return self.picture


@canvas.apply_style
def draw(show: Callable[[Page], None], page: Page) -> None:
    """Run ``show`` in the style and the colors of the other plots of flexgen."""
    with matplotlib.rc_context({"axes.prop_cycle": matplotlib.cycler(color=canvas.COLORS)}):
        show(page)
        for axes in page.picture.axes if page.picture else ():
            for axis in (axes.xaxis, axes.yaxis):
                if axis.get_scale() == "log":
                    canvas.log_axis(axis)
                elif axis.get_scale() == "symlog":
                    axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))


def exhibit(
    file: str,
    question: str,
    literature: str,
    show: Callable[[Page], None],
    folder: str | None = None,
) -> Path:
    """Run a script of the gallery.

    Parameters
    ----------
    file : str
        The script; its name is that of the picture.
    question, literature : str
    show : callable
        Takes a `Page`, prints its table and draws its figure.
    folder : str, optional
        Of the picture; default: the first argument of the command line, else reports/gallery.
    """
    begin = time.perf_counter()
    name = Path(file).stem
    print(f"{name}: {question}\n")
    page = Page(question)
    draw(show, page)
    assert page.picture is not None
    target = Path(folder or (sys.argv[1] if len(sys.argv) > 1 else FOLDER))
    target.mkdir(parents=True, exist_ok=True)
    saved = canvas.save(page.picture, target / f"{name}.svg")
    print(f"{textwrap.fill(' '.join(literature.split()), 100)}\n")
    print(f"picture {saved}, {time.perf_counter() - begin:.1f} s")
    return saved
