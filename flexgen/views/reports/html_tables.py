"""Numbers and tables as HTML."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np


def number(x: float | None, digits: int = 4) -> str:
    """A number as HTML, ``5.065·10<sup>-4</sup>``; a dash for None."""
    if x is None or not np.isfinite(x):
        return "\N{EN DASH}"
    text = f"{x:.{digits}g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        text = f"{mantissa}·10<sup>{int(exponent)}</sup>"
    return text.replace("-", "\N{MINUS SIGN}")


def html_table(
    head: Iterable[str], rows: Iterable[Iterable[str]], numeric: Iterable[int] = ()
) -> str:
    """A table of HTML cells; the columns ``numeric`` are right-aligned."""
    right = set(numeric)

    def row(cells: Iterable[str], tag: str) -> str:
        out = (
            f"<{tag}{' class=n' if k in right else ''}>{cell}</{tag}>"
            for k, cell in enumerate(cells)
        )
        return f"<tr>{''.join(out)}</tr>".replace("class=n", 'class="n"')

    body = "\n".join(row(cells, "td") for cells in rows)
    return (
        f'<div class="wide"><table><thead>{row(head, "th")}</thead><tbody>\n'
        f"{body}\n"
        "</tbody></table></div>\n"
    )
