"""Text and HTML of a result from its rows, see `flexgen.base.rows`."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

from flexgen.base.display import SPEED, Scales, cell_and_unit, choose_scales, figure_rows
from flexgen.base.registry import provides
from flexgen.base.rows import Column, Data, Heading, Part, Prose, Row, Shown, Table, flat
from flexgen.views.reports.html_tables import html_table
from flexgen.views.reports.html_tables import number as html_number
from flexgen.views.reports.text_tables import figures, paragraph, table
from flexgen.views.reports.text_tables import number as text_number

if TYPE_CHECKING:
    from flexgen.base.results import Result


@provides("Result.content_as_text")
def text_of_result(result: Result) -> str:
    """The rows of a result as the command line prints them."""
    return text_of_rows(result.content())


def text_of_rows(rows: Iterable[Part]) -> str:
    """Rows, tables and sentences as text, with an empty line between groups of them."""
    parts = flat(rows)
    scales = scales_of(parts)
    texts = []
    for kind, group in _groups(parts):
        if kind is Row:
            cells = [cell for cell in row_cells(group, scales) if cell[1] is not None]
            texts.append(figures(cells) if cells else "")
        elif kind is Table:
            texts += [_text_table(each, scales) for each in group]
        else:
            texts.append("\n".join(paragraph(each.text) for each in group))
    return "\n\n".join(text for text in texts if text)


@provides("Result.content_as_html")
def html_of_result(result: Result) -> str:
    """The rows of a result as HTML, for notebooks: a table of quantities, tables, sentences."""
    parts = result.content()
    if not any(isinstance(part, Prose) and part.is_title for part in parts):
        parts = (Prose(result.short_title(), is_title=True), *parts)
    warnings = [str(each) for each in getattr(result, "warnings", ())]
    return html_of_rows(parts).rstrip() + "".join(
        f"<p>warning: {html.escape(each)}</p>" for each in warnings
    )


def html_of_rows(
    rows: Iterable[Part], good: bool = True, is_page: bool = False, scales: Scales | None = None
) -> str:
    """Rows, tables and sentences as HTML.

    ``is_page``: without the title, which the page has, with the headings of tables and the status
    in color, of a result that can be used where it is ``good``. ``scales``: units of lengths and
    angles of a page with more of them.
    """
    parts = flat(rows)
    scales = scales_of(parts) if scales is None else scales
    caption = ""
    texts = []
    for kind, group in _groups(parts):
        if kind is Row:
            badge = f'<span class="status{"" if good else " bad"}">' * is_page
            texts.append(_html_figures(caption, group, scales, badge))
            caption = ""
        elif kind is Table:
            texts.append(_heading(caption))
            caption = ""
            for each in group:
                heading = f"<h2>{html.escape(each.heading)}</h2>\n" if each.heading else ""
                texts.append(heading * is_page + _html_table(each, scales))
        elif kind is Heading:
            texts.append(_heading(caption))
            caption = ""
            size = "h2" if is_page else "h4"
            texts += [f"<{size}>{html.escape(each.text)}</{size}>\n" for each in group]
        else:
            texts.append(_heading(caption))
            caption = "".join(each.text for each in group if each.is_title and not is_page)
            words = [each.text for each in group if not each.is_title]
            texts += [_heading(caption)] if words else []
            caption = "" if words else caption
            texts += [f"<p>{html.escape(line)}</p>\n" for line in words]
    return "".join([*texts, _heading(caption)])


def scales_of(parts: Sequence[Part]) -> Scales:
    """The units of all lengths and angles of rows and tables together."""
    return choose_scales([part for part in parts if isinstance(part, Row)], *lengths_of(parts))


def lengths_of(parts: Sequence[Part]) -> list[tuple[float | None, str]]:
    """The numbers in columns of tables, with their SI units."""
    return [
        (float(cell), column.unit)
        for part in parts
        if isinstance(part, Table)
        for line in part.cells
        for column, cell in zip(part.columns, line, strict=True)
        if isinstance(cell, float) and not column.is_data
    ]


def row_cells(rows: Iterable[Row], scales: Scales) -> list[tuple[str, Any, str]]:
    """Label, number or text, and unit of each row; None where there is no value."""
    found: list[tuple[str, Any, str]] = []
    for row in rows:
        if row.value in (None, ""):
            found.append((row.label, None, ""))
        elif row.text or row.sd is not None or row.note or row.key.startswith(SPEED):
            found.append((row.label, *cell_and_unit(row, scales)))
        elif row.unit in scales and isinstance(row.value, float):
            found.append((row.label, scales[row.unit].cell(row.value), scales[row.unit].unit))
        else:
            found.append((row.label, row.value, row.unit))
    return found


def _groups(parts: Sequence[Part]) -> list[tuple[type, list[Any]]]:
    """Parts that are printed, in groups of one kind; sentences in groups of their own."""
    printed = [part for part in parts if not isinstance(part, Data)]

    def kind(part: Part) -> tuple[type, str]:
        return type(part), part.group if isinstance(part, Prose) else ""

    return [(key[0], list(group)) for key, group in groupby(printed, kind)]


def _columns(each: Table, is_text: bool) -> list[int]:
    """Indices of the columns that are printed, in a text without the long ones."""
    return [
        k
        for k, column in enumerate(each.columns)
        if not column.is_data and not (is_text and column.is_long)
    ]


def _head(column: Column, scales: Scales) -> str:
    """Title and unit of a column."""
    unit = scales[column.unit].unit if column.unit in scales else column.unit
    return ", ".join(filter(None, (column.title, unit)))


def _cell(column: Column, cell: Any, scales: Scales) -> Any:
    """A cell in the unit of its column, or its text."""
    if isinstance(cell, Shown):
        return cell.text
    is_length = column.unit in scales and isinstance(cell, float)
    return scales[column.unit].cell(cell) if is_length else cell


def _text_table(each: Table, scales: Scales) -> str:
    shown = _columns(each, is_text=True)
    columns = [each.columns[k] for k in shown]
    rows = [[_cell(each.columns[k], line[k], scales) for k in shown] for line in each.cells]
    return table(rows, [_head(column, scales) for column in columns]) if rows else ""


def _html_table(each: Table, scales: Scales) -> str:
    """A table of a result as HTML, in the units of the ``scales``; empty without rows. Columns of
    numbers are right-aligned.
    """
    if not each.cells:
        return ""
    shown = _columns(each, is_text=False)
    rows = [[_cell(each.columns[k], line[k], scales) for k in shown] for line in each.cells]
    numeric = [
        k for k in range(len(shown)) if all(isinstance(row[k], int | float) for row in rows)
    ]
    head = [html.escape(_head(each.columns[k], scales)) for k in shown]
    return html_table(head, [[_html_cell(cell) for cell in row] for row in rows], numeric)


def _html_cell(cell: Any) -> str:
    """A number, or a text, as HTML."""
    if cell is None or (isinstance(cell, float) and not isinstance(cell, bool)):
        return html_number(cell)
    return html.escape(text_number(cell))


def _html_figures(caption: str, rows: Iterable[Row], scales: Scales, badge: str) -> str:
    """A table of quantities; the status is in a colored element, where there is one."""
    title = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    status = {row.label for row in rows if row.key == "status"}
    body = ""
    for label, text in figure_rows(rows, scales):
        cell = html.escape(text)
        cell = f"{badge}{cell}</span>" if badge and label in status else cell
        body += f"<tr><td>{html.escape(label)}</td><td>{cell}</td></tr>"
    return f"<table>{title}{body}</table>\n" if body else ""


def _heading(text: str) -> str:
    return f"<h3>{html.escape(text)}</h3>\n" if text else ""
