"""The content of a result, stated once: rows, tables, sentences and data.

`Result.content` returns them; `flexgen.views.reports.row_views` makes the text of the command
line, the table of notebooks and the page of a report from them, and `data_of` the entries of JSON.
Numbers are in SI units.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple


@dataclass(frozen=True)
class Row:
    """A quantity of a result. Label, value, unit and key can be unpacked.

    ``value``: a number [``unit``], a text, or None or an empty text where there is none: such a
    row is in JSON only. ``sd``: standard deviation [``unit``]. ``note``: what is to be known with
    the number, such as the expected one. ``text``: printed in place of the number, such as
    ``not determined``. ``key``: in JSON; empty: the number is in another entry.

    Examples
    --------
    >>> from flexgen.base.display import figure_rows
    >>> from flexgen.base.rows import Row, data_of
    >>> rows = [Row("cost", 1.25, "", "cost", note="1 expected"), Row("mass", 5.0, "kg", sd=0.25)]
    >>> figure_rows(rows)
    [('cost', '1.25 (1 expected)'), ('mass', '5 +- 0.25 kg')]
    >>> data_of(rows)
    {'cost': 1.25}
    """

    label: str
    value: str | float | None
    unit: str = ""
    key: str = ""
    sd: float | None = None
    note: str = ""
    text: str = ""

    def __iter__(self) -> Iterator[Any]:
        return iter((self.label, self.value, self.unit, self.key))


class Shown(NamedTuple):
    """A cell of a table: the value in JSON, and the text that is printed."""

    value: Any
    text: str


class Column(NamedTuple):
    """A column of a table.

    Lengths and angles, with the ``unit`` m or rad, have the unit of all of a result. ``key``: of
    the cells in JSON; empty: not there. ``is_data``: in JSON only. ``is_long``: texts for pages
    and JSON, for which a terminal has no place.
    """

    title: str
    unit: str = ""
    key: str = ""
    is_data: bool = False
    is_long: bool = False


@dataclass(frozen=True)
class Table:
    """A table of a result.

    ``cells``: numbers, texts, `Shown` or None, a row for each quantity; ``heading``: on pages;
    ``key``: of the list of its rows in JSON; empty: not there.
    """

    columns: tuple[Column, ...]
    cells: tuple[tuple[Any, ...], ...]
    heading: str = ""
    key: str = ""


class Prose(NamedTuple):
    """A line in words.

    ``group``: lines of the same group follow each other without a gap. ``is_title``: the line
    above all others.
    """

    text: str
    group: str = ""
    is_title: bool = False


class Data(NamedTuple):
    """An entry of JSON that is too large to be printed, or is printed as a part of others."""

    key: str
    value: Any


class Heading(NamedTuple):
    """The title of a part of a page."""

    text: str


class Inner(NamedTuple):
    """The content of a result that is a part of another: printed in its place, in JSON an object
    of its own with this key.

    Examples
    --------
    >>> from flexgen.base.rows import Inner, Row, data_of
    >>> data_of([Row("cost", 1.25, "", "cost"), Inner("arm", (Row("mass", 5.0, "kg", "mass"),))])
    {'cost': 1.25, 'arm': {'mass': 5.0}}
    """

    key: str
    parts: tuple[Any, ...]


Part = Row | Table | Prose | Data | Heading | Inner


def flat(parts: Iterable[Part]) -> tuple[Part, ...]:
    """The parts, those of inner results in their places, with their titles as headings."""
    found: list[Part] = []
    for part in parts:
        if isinstance(part, Inner):
            found += [
                Heading(each.text) if isinstance(each, Prose) and each.is_title else each
                for each in flat(part.parts)
            ]
        else:
            found.append(part)
    return tuple(found)


def data_of(rows: Iterable[Part]) -> dict[str, Any]:
    """The entries of JSON: of rows, tables and data with a key, and of inner results, in their
    order.
    """
    found: dict[str, Any] = {}
    for part in rows:
        if isinstance(part, Table) and part.key:
            found[part.key] = [_entry(part.columns, cells) for cells in part.cells]
        elif isinstance(part, Inner):
            found[part.key] = data_of(part.parts)
        elif isinstance(part, Row | Data) and part.key:
            found[part.key] = part.value
    return found


def _entry(columns: tuple[Column, ...], cells: tuple[Any, ...]) -> dict[str, Any]:
    """The object of a row of a table."""
    named = zip(columns, cells, strict=True)
    return {
        column.key: cell.value if isinstance(cell, Shown) else cell
        for column, cell in named
        if column.key
    }
