"""The tables of a sweep: one row for each case, typed columns with units, saved as npz or parquet without loss."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.errors import ArgumentError

LONGEST = 400  # characters of a text in a table


@dataclass(frozen=True)
class Column:
    """``kind``: "int", "float" or "text"; an integer that is missing is -1, a number NaN, a text empty."""

    name: str
    kind: str
    unit: str
    doc: str


RESULTS = (
    Column("case", "int", "1", "number of the case in the grid"),
    Column("model", "text", "", "name in the grid"),
    Column("parameters", "text", "", "changes of the model, JSON"),
    Column("move", "text", "", "name of the move"),
    Column("method", "text", "", "requested method"),
    Column("method_used", "text", "", "method of the solution"),
    Column("status", "text", "", "of the solution; failed where there is none"),
    Column("verdict", "text", "", "message of the solver"),
    Column("tool_error_max", "float", "m", "largest distance of the simulated output from the path"),
    Column("turn_error_max", "float", "rad", "largest angle between the simulated output and the path"),
    Column("plan_error_max", "float", "m or rad", "simulated error from the modified path, where limits are active"),
    Column("torque_max", "float", "N m", "largest motor torque, motor side"),
    Column("torque_rms", "float", "N m", "largest root mean square torque of a motor"),
    Column("speed_max", "float", "rad/s", "largest motor speed, motor side"),
    Column("energy", "float", "J", "work done by all motors"),
    Column("residual_max", "float", "N m", "largest residual of the equations of motion between the samples"),
    Column("residual_relative", "float", "1", "residual relative to the largest torque in its row"),
    Column("energy_error", "float", "1", "relative error of the energy balance in the simulation"),
    Column("iterations", "int", "1", "of the solver"),
    Column("samples", "int", "1", "of the trajectory"),
    Column("preactuation", "float", "s", "pre-actuation: how long before the path the motion begins"),
    Column("warnings", "text", "", "separated by line breaks"),
    Column("error", "text", "", "reason where there is no solution"),
)
TIMES = (
    Column("case", "int", "1", "number of the case in the grid"),
    Column("wall", "float", "s", "wall time of the case"),
    Column("cpu", "float", "s", "processor time of the case"),
)

_TYPES: dict[str, Any] = {"int": np.int64, "float": np.float64, "text": np.str_}
_MISSING: dict[str, Any] = {"int": -1, "float": np.nan, "text": ""}


@dataclass(frozen=True)
class Table:
    """Columns of equal length, by name; ``table["torque_max"]`` is an array."""

    columns: tuple[Column, ...]
    values: Mapping[str, np.ndarray]

    def __getitem__(self, name: str) -> np.ndarray:
        return self.values[name]

    def __len__(self) -> int:
        return len(self.values[self.columns[0].name])

    @property
    def digest(self) -> str:
        """SHA-256 of names, types and every bit of the values."""
        out = hashlib.sha256()
        for column in self.columns:
            values = self.values[column.name]
            out.update(f"{column.name} {column.kind} {column.unit} {len(values)}\n".encode())
            out.update(json.dumps(values.tolist()).encode() if column.kind == "text" else values.tobytes())
        return out.hexdigest()

    def save(self, path: str | Path) -> Path:
        """Write to ``path``, ``.npz`` or ``.parquet`` (needs pyarrow); equal tables give equal npz files."""
        path = Path(path)
        if path.suffix not in (".npz", ".parquet"):
            raise ArgumentError(f"table: given {path.name!r}, expected a name that ends in .npz or .parquet")
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
        try:
            if path.suffix == ".npz":
                head = json.dumps([[c.name, c.kind, c.unit, c.doc] for c in self.columns])
                arrays: dict[str, Any] = {c.name: self.values[c.name] for c in self.columns}
                np.savez_compressed(part, columns=np.array(head), **arrays)
            else:
                _save_parquet(self, part)
            os.replace(part, path)
        finally:
            with suppress(OSError):
                part.unlink()
        return path

    @staticmethod
    def load(path: str | Path) -> Table:
        """Read an npz file that `save` wrote."""
        try:
            with np.load(path, allow_pickle=False) as data:
                columns = tuple(Column(*row) for row in json.loads(str(data["columns"])))
                return Table(columns, {c.name: data[c.name] for c in columns})
        except FileNotFoundError:
            raise ArgumentError(f"table: given {str(path)!r}, which does not exist") from None
        except Exception as error:  # numpy, zipfile and json raise different errors
            raise ArgumentError(
                f"{path}: given a file that is no table of flexgen ({type(error).__name__}), "
                "expected a table that a sweep wrote"
            ) from error


def table_of(columns: Sequence[Column], rows: Iterable[Mapping[str, Any]]) -> Table:
    """Rows as a table; entries that are absent or None are missing values."""
    lists: dict[str, list[Any]] = {column.name: [] for column in columns}
    for row in rows:
        for column in columns:
            lists[column.name].append(_entry(column.kind, row.get(column.name)))
    return Table(tuple(columns), {column.name: np.array(lists[column.name], _TYPES[column.kind]) for column in columns})


def _entry(kind: str, value: Any) -> Any:
    """A value that is the same in memory and in every file: one NaN, texts in UTF-8 of limited length."""
    if value is None or value != value:
        return _MISSING[kind]
    if kind != "text":
        return value
    return str(value)[:LONGEST].encode("utf-8", "backslashreplace").decode("utf-8")


def _save_parquet(table: Table, path: Path) -> None:
    try:
        pa, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError as error:
        raise ArgumentError(
            f"table: given {path.suffix}, which needs the package pyarrow ({error}); "
            "run: pip install pyarrow, or take .npz"
        ) from None
    kinds = {"int": pa.int64(), "float": pa.float64(), "text": pa.string()}
    fields = [pa.field(c.name, kinds[c.kind], metadata={"unit": c.unit, "doc": c.doc}) for c in table.columns]
    arrays = [pa.array(table.values[c.name].tolist(), kinds[c.kind]) for c in table.columns]
    parquet.write_table(pa.table(arrays, schema=pa.schema(fields)), path)
