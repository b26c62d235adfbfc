"""A model file with one more variant."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.toml_text import toml

LONGEST = 300  # characters of a description


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
    rows = [f"{toml(key)} = {toml(value)}" for key, value in sets.items()]
    return "\n".join([text.rstrip(), "", *lines, "", f"[variant.{name}.set]", *rows, ""])


def _refusal(given: str) -> ArgumentError:
    return ArgumentError(
        f"write: given a model of {given}, expected one of a .toml file without that variant; the "
        "numbers are in the result and in --json"
    )
