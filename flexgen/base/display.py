"""Values as short texts for the terminal, as JSON types, and as tables for notebooks."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from reprlib import Repr
from typing import Any, NamedTuple

from flexgen.base.rows import Part, Prose, Row

SHOWN = 12  # entries of an array that is written out


class _Short(Repr):
    """Texts of values: at most 4 entries of a sequence, sizes in place of long arrays."""

    def __init__(self) -> None:
        super().__init__()
        self.maxtuple = self.maxlist = self.maxdict = 4
        self.maxstring = self.maxother = 100

    def repr_ndarray(self, value: Any, level: int) -> str:
        """Numbers of a small array, else its shape."""
        if value.size > SHOWN:
            return f"<array {' x '.join(map(str, value.shape))}>"
        return " ".join(repr(value).split())

    def repr_instance(self, x: Any, level: int) -> str:
        """Data classes get their own short text; what has none is named by its class, without an
        address.
        """
        text = (
            type(x).__name__ if type(x).__repr__ is object.__repr__ else " ".join(repr(x).split())
        )
        return text if len(text) <= self.maxother else f"{text[: self.maxother - 3]}..."


_SHORT = _Short()


def number(value: Any, digits: int = 4) -> str:
    """A value as text; a dash for None and for numbers that are not finite."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        if not math.isfinite(value):
            return "-"
        return f"{value:.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.{digits}g}"
    return str(value)


def complex_number(pair: Sequence[float | None]) -> str:
    """A root ``[re, im]`` as text; a complex root includes its conjugate."""
    re, im = pair
    if re is None or im is None:
        return "-"
    return number(float(re)) if im == 0 else f"{number(float(re))} +/- {number(abs(float(im)))}i"


def roots(pairs: Iterable[Sequence[float | None]]) -> list[str]:
    """Roots as texts: one text per conjugate pair, equal roots counted."""
    texts = [complex_number(pair) for pair in pairs if pair[1] is None or pair[1] >= 0]
    counted: dict[str, int] = {}
    for text in texts:
        counted[text] = counted.get(text, 0) + 1
    return [text if n == 1 else f"{text} ({n} times)" for text, n in counted.items()]


def duration(seconds: float) -> str:
    """A time as text: ``4 s``, ``3 min``."""
    return f"{max(seconds, 1.0):.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


# m or rad: smaller errors are those of the computation; no robot and no sensor shows them
NOISE = 1e-7

# First part of the keys of speeds [m/s, rad/s] and of their relative errors. They have the same
# bound: in motions of about a second such speeds are errors of the computation, too.
SPEED = "speed_"


class UnitScale(NamedTuple):
    """The one unit in which a report prints a quantity: its factor to the SI unit, and its name.

    Examples
    --------
    >>> from flexgen.base.display import choose_scale
    >>> scale = choose_scale([4.2e-3, 3e-6, 1e-12], "m")
    >>> scale.unit, scale.text(4.2e-3), scale.text(3e-6), scale.text(1e-12)
    ('mm', '4.2 mm', '0.003 mm', '< 0.0001 mm')
    """

    factor: float
    unit: str

    def cell(self, value: float | None) -> float | str:
        """A value [SI] in this unit for a column; a dash for None, the bound for noise."""
        if value is None or not math.isfinite(value):
            return "-"
        if 0.0 < abs(value) < NOISE:
            return f"< {self.factor * NOISE:.1g}"
        return self.factor * value

    def text(self, value: float | None) -> str:
        """A value [SI] with the unit, three digits."""
        cell = self.cell(value)
        if cell == "-":
            return "-"
        return f"{cell} {self.unit}" if isinstance(cell, str) else f"{cell:.3g} {self.unit}"


# Prefixes of the units of lengths [m] and angles [rad] with their factors, and the smallest size
# that is printed with them: what would round to 1000 of the smaller unit is 1 of this one.
PREFIXES = (("", 1.0, 0.9995), ("m", 1e3, 0.9995e-3), ("u", 1e6, 0.0))


def choose_scale(values: Iterable[float | None], unit: str) -> UnitScale:
    """The unit for all values [m or rad] of a quantity: that of the largest finite one."""
    sizes = (abs(value) for value in values if value is not None and math.isfinite(value))
    largest = max(sizes, default=0.0)
    prefix, factor = next((p, f) for p, f, least in PREFIXES if largest >= least)
    return UnitScale(factor, prefix + unit)


Scales = Mapping[str, UnitScale]  # by the SI units m and rad


def choose_scales(figures: Iterable[Row], *more: tuple[float | None, str]) -> Scales:
    """The units for all lengths and angles of figures, and of more values with their SI units."""
    each = [(f.value, f.unit) for f in figures if isinstance(f.value, float)]
    each += [(value, unit) for value, unit in more if value is not None]
    return {
        unit: choose_scale([value for value, of in each if of == unit], unit)
        for unit in ("m", "rad")
    }


def figure_rows(figures: Iterable[Row], scales: Scales | None = None) -> list[tuple[str, str]]:
    """Labels and texts of the figures that have a value; lengths and angles have one unit each.

    ``scales``: units of a report with more lengths than these.
    """
    shown = tuple(figures)
    scales = choose_scales(shown) if scales is None else scales
    return [
        (f.label, " ".join(filter(None, cell_and_unit(f, scales))))
        for f in shown
        if f.value not in (None, "")
    ]


def lines_of(content: Iterable[Part]) -> str:
    """Title and figures of a result as lines, for ``print``."""
    parts = tuple(content)
    titles = [part.text for part in parts if isinstance(part, Prose) and part.is_title]
    rows = figure_rows(part for part in parts if isinstance(part, Row))
    notes = [f"  {part.text}" for part in parts if isinstance(part, Prose) and not part.is_title]
    return "\n".join([*titles, *(f"  {label}: {text}" for label, text in rows), *notes])


def cell_and_unit(row: Row, scales: Scales) -> tuple[str, str]:
    """The number of a row as text, and its unit with what is to be known with it."""
    value = row.value
    unit = row.unit
    cell = str(value)
    if row.text:
        cell = row.text
    elif isinstance(value, float) and row.key.startswith(SPEED) and 0.0 < abs(value) < NOISE:
        cell = f"< {NOISE:.0e}"
    elif isinstance(value, float) and unit in scales:
        cell, unit = _scale_number(value, row.sd, scales[unit])
    elif isinstance(value, float):
        cell = f"{value:.4g}" + ("" if row.sd is None else f" +- {row.sd:.2g}")
    return cell, unit + (f" ({row.note})" if unit else f"({row.note})") * bool(row.note)


def _scale_number(value: float, sd: float | None, scale: UnitScale) -> tuple[str, str]:
    """A length or angle with its deviation, and their unit; a dash has none."""
    text = scale.text(value)
    if text == "-":
        return text, ""
    deviation = "" if sd is None else f" +- {scale.factor * sd:.2g}"
    return text.removesuffix(f" {scale.unit}") + deviation, scale.unit


def format_size(value: float | None, unit: str, scales: Scales | None = None) -> str:
    """A length [m] or angle [rad] with a prefix: ``< 0.1 um``, ``4.2 mm``; a dash for None.

    ``scales``: the units of a report with more than this value.
    """
    scale = choose_scale([value], unit) if scales is None else scales[unit]
    return scale.text(value)


def both_measured(in_m: float | None, in_rad: float | None, scales: Scales | None = None) -> str:
    """A length and an angle: ``4.2 mm and 3 urad``; empty where there is neither."""
    return " and ".join(
        format_size(value, unit, scales)
        for value, unit in ((in_m, "m"), (in_rad, "rad"))
        if value is not None
    )


def plain(value: Any) -> Any:
    """Convert to JSON types: a number that is not finite becomes None, a complex one ``[re, im]``,
    a path its text.

    A result becomes what its `to_dict` returns, a model or another object with a title its title,
    another data class its fields.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if value is None or isinstance(value, bool | int | str):
        return value
    if hasattr(value, "tolist"):  # numpy
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if hasattr(value, "to_dict"):
        return plain(value.to_dict())
    if isinstance(title := getattr(value, "title", None), str):
        return title
    if dataclasses.is_dataclass(value):
        return {
            field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)
        }
    return str(value)


def as_json(data: Mapping[str, Any]) -> str:
    """One JSON object as text, without NaN or Infinity."""
    return json.dumps(plain(data), indent=2, allow_nan=False)


def short_text(value: Any) -> str:
    """A value in few words: the beginning of a sequence, the size of a long array; empty for
    None.
    """
    if isinstance(value, tuple | list):
        return ", ".join([short_text(item) for item in value[:4]] + ["..."] * (len(value) > 4))
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {short_text(item)}" for key, item in value.items())
    if value is None or isinstance(value, int | float | str | os.PathLike):
        return "" if value is None else str(value)
    return _SHORT.repr(value)


def short_repr(instance: Any) -> str:
    """One line for an instance of a data class: the fields that differ from their defaults, long
    values shortened.
    """
    given = (
        (field, getattr(instance, field.name))
        for field in dataclasses.fields(instance)
        if field.repr
    )
    parts = [
        f"{field.name}={_SHORT.repr(value)}"
        for field, value in given
        if repr(value) != repr(field.default)
    ]
    return f"{type(instance).__name__}({', '.join(parts)})"


def table_html(title: str, rows: Iterable[tuple[str, str]]) -> str:
    """An HTML table of labels and texts for notebooks; all texts are escaped."""
    body = "".join(
        f"<tr><td>{escape(label)}</td><td>{escape(text)}</td></tr>" for label, text in rows
    )
    return f"<table><caption>{escape(title)}</caption>{body}</table>"
