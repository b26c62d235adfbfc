"""Values as short texts for the terminal, as JSON types, and as tables for notebooks."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Iterable, Mapping
from html import escape
from reprlib import Repr
from typing import Any, NamedTuple

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
        """Data classes get their own short text; what has none is named by its class, without an address."""
        text = (
            type(x).__name__ if type(x).__repr__ is object.__repr__ else " ".join(repr(x).split())
        )
        return text if len(text) <= self.maxother else f"{text[: self.maxother - 3]}..."


_SHORT = _Short()


def duration(seconds: float) -> str:
    """A time as text: ``4 s``, ``3 min``."""
    return f"{max(seconds, 1.0):.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


# m or rad: smaller errors are those of the computation; no robot and no sensor shows them
NOISE = 1e-7

# First part of the keys of speeds [m/s, rad/s] and of their relative errors. They have the same
# bound: in motions of about a second such speeds are errors of the computation, too.
SPEED = "speed_"


class Figure(NamedTuple):
    """A figure of a result: its name, its value (None where there is none), its unit, and its key in JSON."""

    label: str
    value: str | float | None
    unit: str
    key: str


def figure_rows(figures: Iterable[Figure]) -> list[tuple[str, str]]:
    """Labels and texts of the figures that have a value."""
    return [
        (f.label, _figure_text(f.value, f.unit, f.key).strip())
        for f in figures
        if f.value not in (None, "")
    ]


def _figure_text(value: str | float | None, unit: str, key: str) -> str:
    if isinstance(value, float) and key.startswith(SPEED) and 0.0 < abs(value) < NOISE:
        return f"< {NOISE:.0e} {unit}"
    if isinstance(value, float) and unit in ("m", "rad"):
        return format_size(value, unit)
    return f"{value:.4g} {unit}" if isinstance(value, float) else f"{value} {unit}"


def format_size(value: float | None, unit: str) -> str:
    """A length [m] or angle [rad] with a prefix: ``< 0.1 um``, ``4.2 mm``; a dash for None."""
    if value is None or not math.isfinite(value):
        return "-"
    if 0.0 < abs(value) < NOISE:
        return f"< {1e6 * NOISE:.1g} u{unit}"
    factor, prefix = (
        (1.0, "") if value >= 0.9995 else (1e3, "m") if value >= 0.9995e-3 else (1e6, "u")
    )
    return f"{factor * value:.3g} {prefix}{unit}"


def thousandths(value: float) -> float | str:
    """A length [m] or angle [rad] in mm or mrad; ``< 0.0001`` below the errors of computation."""
    return f"< {1e3 * NOISE:.1g}" if 0.0 < abs(value) < NOISE else 1e3 * value


def both_measured(in_m: float | None, in_rad: float | None) -> str:
    """A length and an angle: ``4.2 mm and 3 urad``; empty where there is neither."""
    return " and ".join(
        format_size(value, unit)
        for value, unit in ((in_m, "m"), (in_rad, "rad"))
        if value is not None
    )


def plain(value: Any) -> Any:
    """Convert to JSON types: a number that is not finite becomes None, a complex one ``[re, im]``, a path its text.

    A result becomes what its `to_dict` returns, a model or another object with a title its title, another data class
    its fields.
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
    """A value in few words: the beginning of a sequence, the size of a long array; empty for None."""
    if isinstance(value, tuple | list):
        return ", ".join([short_text(item) for item in value[:4]] + ["..."] * (len(value) > 4))
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {short_text(item)}" for key, item in value.items())
    if value is None or isinstance(value, int | float | str | os.PathLike):
        return "" if value is None else str(value)
    return _SHORT.repr(value)


def short_repr(instance: Any) -> str:
    """One line for an instance of a data class: the fields that differ from their defaults, long values shortened."""
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
