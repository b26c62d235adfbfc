"""The hash of a scenario's content: of every number and word that enters a score, wherever it was
read from.

Numbers count with twelve digits, so that the last bits of another processor do not matter. Fields
with their default value are left out, so that a new option of a model does not change the hashes
of those that do not use it.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.parameters import Parameter
from flexgen.feedback.loop.plants import Plants
from flexgen.model.elements import RobotModel

DIGITS = 12
# What enters a score, where not all fields do: of a model the data of the equations of motion, no
# texts.
KEPT = {
    RobotModel: (
        "name",
        "gravity",
        "base",
        "elements",
        "motors",
        "tool",
        "payload",
        "motor_coupling",
    ),
    Plants: ("names", "parameters", "values"),
    Parameter: ("name",),
}


def content_hash(value: Any, what: str) -> str:
    """SHA-256 of nested data: dataclasses, mappings, sequences, arrays, numbers and texts.

    Raises
    ------
    ArgumentError
        A number is not finite, or something else is in it; the place is named.
    """
    text = json.dumps(
        _to_plain(value, what), sort_keys=True, ensure_ascii=True, separators=(",", ":")
    )
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def _to_plain(value: Any, where: str) -> Any:
    """``value`` as texts, whole numbers, lists and dicts, equal for equal content: floats as
    `DIGITS` digits, arrays with their shape, dataclasses with their name. ``where`` names it in
    errors.
    """
    if value is None or isinstance(value, (str, bool)):
        return value
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ArgumentError(f"{where}: given {value!r}, expected a finite number")
        return f"{value + 0.0:.{DIGITS}g}" if value else "0"
    if isinstance(value, np.ndarray):
        return [list(value.shape), *(_to_plain(float(x), where) for x in value.ravel())]
    if isinstance(value, Mapping):
        return {str(key): _to_plain(value[key], f"{where}, {key}") for key in value}
    if isinstance(value, (tuple, list)):
        return [_to_plain(x, f"{where}[{k}]") for k, x in enumerate(value)]
    if is_dataclass(value) and not isinstance(value, type):
        return [type(value).__name__, _of_fields(value, where)]
    raise ArgumentError(
        f"{where}: given {value!r}, expected data: numbers, texts and what is made of them"
    )


def _of_fields(value: Any, where: str) -> dict[str, Any]:
    """The fields of a dataclass that are compared, not at their default and (where `KEPT` has the
    class) listed there; so that a new field leaves old content as it is.
    """
    out = {}
    every = tuple(field.name for field in fields(value))
    kept = KEPT.get(type(value), every)
    for field in fields(value):
        if not field.compare or field.name not in kept:
            continue
        own = getattr(value, field.name)
        default = (
            field.default_factory() if field.default_factory is not MISSING else field.default
        )
        plain = _to_plain(own, f"{where}, {field.name}")
        if default is MISSING or plain != _to_plain(default, where):
            out[field.name] = plain
    return out
