"""Numbers, aligned tables and paragraphs as plain text, at most as wide as the terminal."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from flexgen.base.display import number

GAP = "  "  # between columns
NARROW = 16  # characters; columns of text are not wrapped to less

_width: ContextVar[int | None] = ContextVar("width", default=None)


def one_line(text: str) -> str:
    """The text with each run of white space replaced by one space."""
    return " ".join(text.split())


@contextmanager
def fit_tables(width: int | None) -> Iterator[None]:
    """Within: tables have at most this number of characters per line; None: any number."""
    token = _width.set(width)
    try:
        yield
    finally:
        _width.reset(token)


def terminal_width() -> int | None:
    """Characters per line of standard output; None if it is not a terminal."""
    try:
        return shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    except (AttributeError, ValueError, OSError):  # no stream, or a closed one
        return None


def paragraph(text: str) -> str:
    """The text, wrapped to the width of the terminal."""
    width = _width.get()
    return text if width is None else textwrap.fill(text, width, break_on_hyphens=False)


def table(rows: Sequence[Sequence[Any]], head: Sequence[str] = ()) -> str:
    """A table with aligned columns; columns of numbers (and dashes) are right-aligned.

    On a terminal it is never wider than the terminal: long texts are wrapped; if that is not
    enough, the last columns are left out and named below the table.
    """
    width = len(head) if head else max((len(row) for row in rows), default=0)
    right = [bool(rows) and all(_is_figure(row[k]) for row in rows) for k in range(width)]
    lines = [[number(cell) for cell in row] for row in rows]
    if head:
        lines.insert(0, list(head))
    widths = [max((len(line[k]) for line in lines), default=0) for k in range(width)]
    kept = _narrow(widths, right, _width.get())
    if head:
        lines.insert(1, ["-" * w for w in widths])
    text = "\n".join(_wrap_row(line, widths, right, kept) for line in lines)
    if kept == width:
        return text
    left_out = ", ".join(head[kept:]) or f"{width - kept} columns"
    return (
        f"{text}\n"
        f"{paragraph(f'(left out: {left_out}; a wider terminal, a pipe or --json shows all)')}"
    )


def _narrow(widths: list[int], right: Sequence[bool], limit: int | None) -> int:
    """Reduce the ``widths`` of texts in place, the widest first, until a line fits into ``limit``
    characters; returns the number of columns that do. ``right``: columns of numbers, which keep
    their width. None: no limit.
    """
    if limit is None:
        return len(widths)

    def excess(count: int) -> int:
        return sum(widths[:count]) + len(GAP) * (count - 1) - limit

    texts = [k for k in range(len(widths)) if not right[k]]
    while texts and excess(len(widths)) > 0:
        widest = max(texts, key=lambda k: widths[k])
        if widths[widest] <= NARROW:
            break
        widths[widest] -= 1
    kept = len(widths)
    while kept > 1 and excess(kept) > 0:
        kept -= 1
    if kept == 1 and excess(1) > 0:
        widths[0] = max(limit, 1)
    return kept


def _wrap_row(line: Sequence[str], widths: Sequence[int], right: Sequence[bool], kept: int) -> str:
    """The first ``kept`` cells of a row as text, of several lines where a cell is longer than its
    width; ``right``: which are right-aligned.
    """
    cells = [
        textwrap.wrap(cell, w, break_on_hyphens=False) if len(cell) > w else [cell]
        for cell, w in zip(line[:kept], widths, strict=False)
    ]
    out = []
    for k in range(max(map(len, cells), default=0)):
        parts = [cell[k] if k < len(cell) else "" for cell in cells]
        padded = [
            x.rjust(w) if r else x.ljust(w) for x, w, r in zip(parts, widths, right, strict=False)
        ]
        out.append(GAP.join(padded).rstrip())
    return "\n".join(out)


def _is_figure(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def figures(rows: Iterable[tuple[str, Any, str]]) -> str:
    """A table of quantities, values and units; rows without a value are left out."""
    kept = [(what, number(value), unit) for what, value, unit in rows if value is not None]
    return table(kept, ("quantity", "value", "unit"))
