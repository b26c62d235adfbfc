"""A model file with one more variant."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.toml_text import toml, toml_key

LONGEST = 300  # characters of a description
LONG_LINE = 1000  # characters of a list from which on it has several lines
IN_LINE = 8  # entries of such a list in a line


def add_variant(
    file: str | Path, name: str, changes: Mapping[str, Any], description: str, base: str = ""
) -> str:
    """The text of a model file with a further variant.

    Parameters
    ----------
    file : str or Path
    name : str
        Of the variant.
    changes : mapping
        Dotted keys and their values.
    description : str
        One line.
    base : str
        A variant of the file whose changes come first.

    Raises
    ------
    ArgumentError
        There is no such ``.toml`` file, or it has the variant.
    """
    path = Path(file or "")
    if not path.is_file() or path.suffix != ".toml":
        raise _refusal(f"{str(file)!r}, which is no .toml file")
    return with_variant(
        path.read_text(encoding="utf-8"), path.name, name, changes, description, base
    )


def with_variant(
    text: str, file: str, name: str, changes: Mapping[str, Any], description: str, base: str = ""
) -> str:
    """The text of a model file with a further variant.

    ``file``: its name for messages; else as `add_variant`.
    """
    variants = tomllib.loads(text).get("variant", {})
    if not text or name in variants:
        raise _refusal(f"{file}, which has a variant {name!r}")
    old = variants.get(base, {})
    own = {key: value for key, value in old.get("set", {}).items() if key not in changes}
    sets = own | dict(changes)
    lines = [f"[variant.{name}]", f"description = {toml(' '.join(description.split())[:LONGEST])}"]
    lines += [f"remove = {toml(old['remove'])}"] if "remove" in old else []
    rows = [f"{toml(key)} = {_in_lines(value)}" for key, value in sets.items()]
    return "\n".join([text.rstrip(), "", *lines, "", f"[variant.{name}.set]", *rows, ""])


def _in_lines(value: Any) -> str:
    """TOML of a value; of a long list in several lines, since lines of a file have a limit."""
    text = toml(value)
    if len(text) < LONG_LINE:
        return text
    if isinstance(value, Mapping):
        # a line may end within a list in an inline table, not between its keys
        entries = (f"{toml_key(key)} = {_in_lines(entry)}" for key, entry in value.items())
        return "{ " + ", ".join(entries) + " }"
    if not isinstance(value, list):
        return text
    if any(isinstance(entry, Mapping) for entry in value):
        lines = [_table_in_lines(entry) for entry in value]
    else:
        starts = range(0, len(value), IN_LINE)
        lines = [", ".join(toml(x) for x in value[k : k + IN_LINE]) for k in starts]
    return "[\n" + "".join(f"  {line},\n" for line in lines) + "]"


def _table_in_lines(table: Any) -> str:
    """TOML of a table in a list, such as an element; its lists of tables have a line for each."""
    if not isinstance(table, Mapping):
        return toml(table)
    entries = []
    for key, entry in table.items():
        text = toml(entry)
        if isinstance(entry, list) and any(isinstance(x, Mapping) for x in entry):
            text = "[\n" + "".join(f"    {_table_in_lines(x)},\n" for x in entry) + "  ]"
        entries.append(f"{toml_key(key)} = {text}")
    return "{ " + ", ".join(entries) + " }"


def _refusal(given: str) -> ArgumentError:
    return ArgumentError(
        f"write: given a model of {given}, expected one of a .toml file without that variant; the "
        "numbers are in the result and in --json"
    )
