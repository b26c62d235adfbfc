"""What the command line prints: aligned tables, numbers, and JSON without NaN."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from typing import Any


def number(value: Any, digits: int = 4) -> str:
    """A figure for people; a dash where there is none."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        if not math.isfinite(value):
            return "-"
        return f"{value:.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.{digits}g}"
    return str(value)


def complex_number(pair: Sequence[float]) -> str:
    """A root ``[re, im]`` for people; of a conjugate pair both at once."""
    re, im = pair
    return number(float(re)) if im == 0 else f"{number(float(re))} +/- {number(abs(float(im)))}i"


def roots(pairs: Iterable[Sequence[float]]) -> list[str]:
    """Roots for people: a conjugate pair is one text, equal ones are counted."""
    texts = [complex_number(pair) for pair in pairs if pair[1] >= 0]
    counted: dict[str, int] = {}
    for text in texts:
        counted[text] = counted.get(text, 0) + 1
    return [text if n == 1 else f"{text} ({n} times)" for text, n in counted.items()]


def table(rows: Sequence[Sequence[Any]], head: Sequence[str] = ()) -> str:
    """Aligned columns; a column of nothing but numbers (and dashes) is set flush right."""
    width = len(head) if head else max((len(row) for row in rows), default=0)
    right = [bool(rows) and all(_is_figure(row[k]) for row in rows) for k in range(width)]
    lines = [[number(cell) for cell in row] for row in rows]
    if head:
        lines.insert(0, list(head))
    widths = [max((len(line[k]) for line in lines), default=0) for k in range(width)]
    if head:
        lines.insert(1, ["-" * w for w in widths])
    padded = [
        [cell.rjust(w) if r else cell.ljust(w) for cell, w, r in zip(line, widths, right, strict=True)]
        for line in lines
    ]
    return "\n".join("  ".join(line).rstrip() for line in padded)


def _is_figure(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def figures(rows: Iterable[tuple[str, Any, str]]) -> str:
    """A table of what, value, unit; rows without a value are left out."""
    kept = [(what, number(value), unit) for what, value, unit in rows if value is not None]
    return table(kept, ("what", "value", "unit"))


def plain(value: Any) -> Any:
    """The same as JSON types: numbers that are not finite become None, paths texts."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if value is None or isinstance(value, bool | int | str):
        return value
    if hasattr(value, "tolist"):  # numpy
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value)


def as_json(data: dict[str, Any]) -> str:
    """One JSON object, valid for every parser."""
    return json.dumps(plain(data), indent=2, allow_nan=False)
