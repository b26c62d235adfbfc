"""Values as text of a TOML file, in one line, which are read back without loss."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np


def toml(value: Any) -> str:
    """A value in TOML, tables and lists in one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return "".join(map(_visible, json.dumps(value, ensure_ascii=False)))
    if isinstance(value, Mapping):
        return (
            "{ " + ", ".join(f"{toml_key(k)} = {toml(item)}" for k, item in value.items()) + " }"
        )
    if isinstance(value, (list, tuple, np.ndarray)):
        return "[" + ", ".join(map(toml, value)) + "]"
    return exact(float(value))


def toml_key(key: str) -> str:
    """A key in TOML, in quotes unless it consists of letters, digits, underscores and dashes."""
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key, re.ASCII) else toml(key)


def _visible(character: str) -> str:
    """A character of a text, escaped if an editor does not show it or turns others around it."""
    if character.isprintable():
        return character
    code = ord(character)
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def exact(value: float) -> str:
    """A number that is read back without loss; a whole one without a decimal point."""
    whole = math.isfinite(value) and value == int(value) and abs(value) < 1e15
    return str(int(value)) if whole else repr(value)
