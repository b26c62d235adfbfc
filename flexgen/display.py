"""Short texts of objects for the terminal, and tables for notebooks."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from html import escape
from reprlib import Repr
from typing import Any

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
        text = type(x).__name__ if type(x).__repr__ is object.__repr__ else " ".join(repr(x).split())
        return text if len(text) <= self.maxother else f"{text[: self.maxother - 3]}..."


_SHORT = _Short()


def short_repr(instance: Any) -> str:
    """One line for an instance of a data class: the fields that differ from their defaults, long values shortened."""
    given = ((field, getattr(instance, field.name)) for field in dataclasses.fields(instance) if field.repr)
    parts = [f"{field.name}={_SHORT.repr(value)}" for field, value in given if repr(value) != repr(field.default)]
    return f"{type(instance).__name__}({', '.join(parts)})"


def table_html(title: str, rows: Iterable[tuple[str, str]]) -> str:
    """An HTML table of labels and texts for notebooks; all texts are escaped."""
    body = "".join(f"<tr><td>{escape(label)}</td><td>{escape(text)}</td></tr>" for label, text in rows)
    return f"<table><caption>{escape(title)}</caption>{body}</table>"
