"""JSON schema of the tables of files, and objects as tables, rendered from their rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from flexgen.base.spec.keys import REQUIRED, Form, Format, Key, Kinds, Schema, Type


def type_schema(kind: Type) -> Schema:
    """The schema of the value of a key; of a table that has a definition a reference to it."""
    if kind.form is None:
        return kind.schema
    form = kind.form() if callable(kind.form) else kind.form
    target: Schema = (
        {"$ref": f"#/definitions/{form.definition}"} if form.definition else table_schema(form)
    )
    if kind.many:
        return kind.schema | {"items": target}
    if kind.most:
        return {
            "anyOf": [
                target,
                {"type": "array", "items": target, "minItems": 1, "maxItems": kind.most},
            ]
        }
    return {"allOf": [target]} if form.definition else target


def key_schemas(key: Key) -> dict[str, Schema]:
    """The schema of a key under each of its names."""
    out: dict[str, Schema] = {}
    for full in key.names:
        unit = key.unit.replace("rad", "deg") if full.endswith("_deg") else key.unit
        doc = (
            key.doc.replace("[]", f"[{unit}]")
            if "[]" in key.doc or not unit
            else f"{key.doc} [{unit}]"
        )
        out[full] = type_schema(key.type) | ({"description": doc + key.type.rule} if doc else {})
        if isinstance(key.default, bool | int | float | str) and key.default != "":
            out[full]["default"] = key.default
    return out


def table_schema(form: Form) -> Schema:
    """The JSON schema of a table with these keys and no others."""
    if isinstance(form, Format):
        return _object(form.doc, form.keys)
    kinds: list[Schema] = []
    for kind, own in form.kinds.items():
        for chosen in own.either or ("",):
            others = {
                x for other, more in own.either.items() if other != chosen for x in (other, *more)
            }
            keys = (*form.shared, *(key for key in own.keys if key.name not in others))
            needed = [chosen] * bool(chosen) + ["type"] * (kind != form.default)
            kinds.append(
                _object(own.doc, keys, {"type": {"const": kind, "description": own.doc}}, needed)
            )
    return kinds[0] if len(kinds) == 1 else {"description": form.doc, "oneOf": kinds}


def _object(
    doc: str, keys: Sequence[Key], more: Schema | None = None, needed: Sequence[str] = ()
) -> Schema:
    """JSON schema of a table with these keys, ``more`` properties and further ``needed`` ones, and
    no other.
    """
    own = {full: schema for key in keys for full, schema in key_schemas(key).items()}
    required = [
        *needed,
        *(key.name for key in keys if key.default is REQUIRED and not key.type.angle),
    ]
    out = {
        "type": "object",
        "description": doc,
        "properties": (more or {}) | own,
        "additionalProperties": False,
    }
    return out | ({"required": sorted(required)} if required else {})


def write(form: Form | Callable[[], Form], value: Any) -> dict[str, Any]:
    """An object as the keys of a table of this form, the inverse of reading it; those that have
    their default are left out.
    """
    form = form() if callable(form) else form
    out: dict[str, Any] = {}
    if isinstance(form, Kinds):
        kind = form.kind_of(value)
        out = {"type": kind} if kind != form.default else {}
        own = form.kinds[kind]
        form = replace(own, keys=(*form.shared, *own.keys))
    values = form.take(value)
    for key in form.keys:
        found = values.get(key.field)
        if found is None or found == key.default:
            continue
        inner = key.type.form
        if inner is not None:
            several = key.type.many or (key.type.most > 0 and isinstance(found, tuple))
            found = [write(inner, item) for item in found] if several else write(inner, found)
        out[key.names[0]] = key.type.write(found)
    return out
