"""Rows of the files of grids, and their reader."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from flexgen.base.checks.counts import RANDOM_MOVES, SECONDS
from flexgen.base.spec.keys import Context, Format, Key, any_table, each, number, read, sub, whole
from flexgen.base.spec.tables import Table, file_bytes, file_table
from flexgen.base.spec.toml_lines import unwrap
from flexgen.studies.sweeps.cases import Grid, MoveChoice, RandomMove, combinations, random_moves


def _check_changes(table: Table, here: Context) -> None:
    if "parameters" in table and "set" in table:
        raise table.fail("set", "either [parameters] or [[set]]", "both")


def _grid(models: Any, moves: Any, random: tuple[MoveChoice, ...], **values: Any) -> Grid:
    """The grid; ``random`` moves come after those that are named."""
    named = [*moves, *random]
    listed = values["parameters"]
    options = values["options"]
    changes = values["set"] if listed is None else combinations(_flat(listed))
    return Grid(
        models,
        named or (None,),
        values["methods"],
        changes,
        {} if options is None else options.data,
    )


def _flat(table: Table, prefix: str = "") -> dict[str, Any]:
    """A table with flat dotted keys: ``a.b = 1`` and ``"a.b" = 1`` mean the same."""
    out: dict[str, Any] = {}
    for key, entry in table.entries.items():
        inner = table.table(key) if isinstance(entry.value, dict) else None
        out |= {prefix + key: unwrap(entry)} if inner is None else _flat(inner, f"{prefix}{key}.")
    return out


RANDOM = Format(
    "joint moves that are drawn at random within the limits of each model",
    (
        Key("count", whole(0, RANDOM_MOVES), "how many"),
        Key("seed", whole(0, 2**63 - 1), "seed of the draws", default=RandomMove.seed),
        Key("duration", number(above=0.0, most=SECONDS), "duration", "s", RandomMove.duration),
        Key(
            "smoothness",
            whole(0, 100),
            "number of continuous derivatives",
            default=RandomMove.smoothness,
        ),
    ),
    make=random_moves,
)
_NAMES = each(str, what="names", schema={"type": "string"})
_SETS = each(dict, what="tables", schema={"type": "object"})
_PATHS = (
    "dotted paths of the model file to lists of values: all combinations, the last path fastest"
)
GRID = Format(
    "grid of a sweep: all combinations of models, changes, moves and methods",
    (
        Key(
            "models",
            _NAMES,
            "names, or paths relative to the current folder",
            check=_check_changes,
        ),
        Key("methods", _NAMES, "methods of inverse dynamics", default=Grid.methods),
        Key("moves", _NAMES, "names of moves; none: the first move of each model", default=[]),
        Key("random", sub(RANDOM), RANDOM.doc, default=(), note="a table with count"),
        Key("parameters", any_table(), _PATHS, default=None),
        Key(
            "set",
            _SETS,
            "instead of parameters: one set of changes after the other, the paths in quotes",
            default=({},),
        ),
        Key("options", any_table(), "options of all cases, as in `flexgen.Grid`", default=None),
    ),
    make=_grid,
)


def read_grid(path: str | Path) -> Grid:
    """Read a grid; its keys are on the page of keys (`docs/model_keys.md`).

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
    file = Path(path)
    found: Grid = read(file_table(file_bytes(file, "grid"), file), GRID, Context())
    return found
