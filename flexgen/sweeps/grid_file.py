"""Grids from TOML files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flexgen.counts import RANDOM_MOVES, count_of, seconds_of
from flexgen.errors import ArgumentError
from flexgen.spec.toml_lines import TextError, plain_table
from flexgen.sweeps.cases import Grid, MoveChoice, combinations, random_moves

KEYS = ("models", "methods", "moves", "random", "parameters", "set", "options")
RANDOM = {"count": RANDOM_MOVES, "seed": 2**63 - 1, "duration": 0, "smoothness": 100}  # keys, largest whole numbers


def read_grid(path: str | Path) -> Grid:
    """Read a grid.

    ``models``, ``methods``, ``moves``: lists of names. ``[random]``: joint moves within the limits of each model,
    ``count`` moves, with ``seed``, ``duration`` [s] and ``smoothness``. ``[parameters]``: dotted paths of the model
    file to lists of values, all combinations; or ``[[set]]``: one parameter set after the other, the paths in
    quotes. ``[options]``: of all cases. Paths of models are relative to the current folder.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Grid

    Raises
    ------
    ArgumentError
        The file cannot be read, or is not a grid.
    """
    try:
        data = plain_table(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ArgumentError(f"grid: given {str(path)!r}, which cannot be read ({error.strerror or error})") from None
    except UnicodeError as error:
        raise ArgumentError(f"{path}: given a file that is not TOML ({error})") from None
    except TextError as error:
        where = f"{path}, line {error.line}" if error.line else f"{path}"
        raise ArgumentError(f"{where}: given {error.given}, expected {error.expected}") from None
    try:
        return _grid(data)
    except ArgumentError as error:
        raise ArgumentError(f"{path}: {error}") from None


def _grid(data: Mapping[str, Any]) -> Grid:
    for key in data:
        if key not in KEYS:
            raise ArgumentError(f"given the key {key!r}, expected some of {', '.join(KEYS)}")
    moves: Any = data.get("moves", [])
    if "random" in data and isinstance(moves, list):
        moves = [*moves, *_random(data["random"])]
    if "parameters" in data and "set" in data:
        raise ArgumentError("given [parameters] and [[set]], expected one of them")
    changes: Any = data.get("set", [{}])
    if "parameters" in data:
        changes = combinations(_table(data, "parameters"))
    return Grid(
        data.get("models", ()),
        (None,) if moves == [] else moves,
        data.get("methods", ("auto",)),
        changes,
        _table(data, "options") if "options" in data else {},
    )


def _random(table: Any) -> list[MoveChoice]:
    if not isinstance(table, dict) or "count" not in table:
        raise ArgumentError(f"random: given {table!r}, expected a table with count")
    for key, value in table.items():
        if key not in RANDOM:
            raise ArgumentError(f"random: given the key {key!r}, expected some of {', '.join(RANDOM)}")
        if key == "duration":
            seconds_of(f"random.{key}", value)
        else:
            count_of(f"random.{key}", value, RANDOM[key], 0)
    return list(random_moves(**table))


def _table(data: Mapping[str, Any], key: str) -> dict[str, Any]:
    """A table with flat dotted keys: ``a.b = 1`` and ``"a.b" = 1`` mean the same."""
    value = data[key]
    if not isinstance(value, dict):
        raise ArgumentError(f"{key}: given {value!r}, expected a table")
    if key == "options":
        return value
    out: dict[str, Any] = {}

    def flatten(prefix: str, table: dict[str, Any]) -> None:
        for name, item in table.items():
            if isinstance(item, dict):
                flatten(f"{prefix}{name}.", item)
            else:
                out[prefix + name] = item

    flatten("", value)
    return out
