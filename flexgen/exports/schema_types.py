"""Types of a JSON schema: numbers, lists and tables with a text for the editor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from flexgen.model.checked_table import LARGEST

Schema = dict[str, Any]
IDENTIFIER = "^(?!.*__)[A-Za-z][A-Za-z0-9_]{0,30}$"  # as flexgen.ports.identifier_problem


def number(
    text: str, *, above: float | None = None, least: float | None = None, default: float | None = None
) -> Schema:
    """A number in the range of the reader."""
    out: Schema = {"type": "number", "description": text, "maximum": LARGEST}
    if above is not None:
        out["exclusiveMinimum"] = above
    elif least is not None:
        out["minimum"] = least
    else:
        out["minimum"] = -LARGEST
    return out if default is None else out | {"default": default}


def whole(text: str, low: int, high: int) -> Schema:
    """An integer from ``low`` to ``high``."""
    return {"type": "integer", "description": text, "minimum": low, "maximum": high}


def vector(text: str, *lengths: int, above: float | None = None) -> Schema:
    """A list of numbers of one of these lengths; without lengths of any."""
    out: Schema = {"type": "array", "description": text, "items": number("", above=above)}
    del out["items"]["description"]
    if len(lengths) > 1 and set(lengths) != set(range(min(lengths), max(lengths) + 1)):
        out["anyOf"] = [{"minItems": n, "maxItems": n} for n in lengths]
    elif lengths:
        out |= {"minItems": min(lengths), "maxItems": max(lengths)}
    return out


def words(text: str) -> Schema:
    """A name or a list of different names."""
    several = {"type": "array", "items": {"type": "string"}, "minItems": 1, "uniqueItems": True}
    return {"description": text, "anyOf": [{"type": "string"}, several]}


def string(text: str, *, pattern: str = "") -> Schema:
    """A text."""
    return {"type": "string", "description": text} | ({"pattern": pattern} if pattern else {})


def name(text: str) -> Schema:
    """An identifier of a model file."""
    return string(text + ": a letter, then at most 30 letters, digits or underscores", pattern=IDENTIFIER)


def flag(text: str) -> Schema:
    """True or false."""
    return {"type": "boolean", "description": text, "default": False}


def choice(text: str, known: Sequence[str], default: str | None = None) -> Schema:
    """One of the known words."""
    out: Schema = {"type": "string", "description": text, "enum": list(known)}
    return out if default is None else out | {"default": default}


def const(value: str, text: str) -> Schema:
    """A word that is always the same: the key ``type`` of one kind of a table."""
    return {"const": value, "description": text}


def table(text: str, keys: Mapping[str, Schema], required: Sequence[str] = ()) -> Schema:
    """A table with these keys and no others."""
    out: Schema = {"type": "object", "description": text, "properties": dict(keys), "additionalProperties": False}
    return out | ({"required": list(required)} if required else {})


def tables(text: str, item: Schema, *, least: int = 1) -> Schema:
    """A list of tables."""
    return {"type": "array", "description": text, "items": item, "minItems": least}


def one_of(text: str, kinds: Sequence[Schema]) -> Schema:
    """A table of one of several kinds."""
    return {"description": text, "oneOf": list(kinds)}


def ref(which: str, text: str = "") -> Schema:
    """A reference to a definition; with a text of its own in front of it."""
    target: Schema = {"$ref": f"#/definitions/{which}"}
    return {"description": text, "allOf": [target]} if text else target


def angle(stem: str, text: str, make: Any = number, **options: Any) -> dict[str, Schema]:
    """The two keys of a quantity that is given in rad or in degrees."""
    return {f"{stem}_{unit}": make(f"{text} [{unit}]", **options) for unit in ("rad", "deg")}


def picked(known: Sequence[str], keys: Mapping[str, Schema]) -> dict[str, Schema]:
    """The keys of a table of the reader, in its order; KeyError where one has no schema."""
    return {key: keys[key] for key in known}
