"""The tables of a sweep: one row for each case, typed columns with units, saved as npz or parquet
without loss.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.files.atomic_files import atomic_file
from flexgen.base.files.npz_files import NpzError, read_npz

LARGEST = 2**34  # bytes of a table that is read
# Bytes of a table that is read, for each byte of its file: numbers of 130 bytes a row are hardly
# packed, and texts have at most 13000, so that no sweep reaches it. A smaller table may be packed
# more.
PACKED = 200
SMALL = 2**28
LONGEST = 400  # characters of a text in a table
ESCAPED = 6  # characters of one that is not text in UTF-8, as backslash, u and four digits
HEAD = 100_000  # characters of the text that says what the columns are, at most


@dataclass(frozen=True)
class Column:
    """``kind``: "int", "float" or "text"; an integer that is missing is -1, a number NaN, a text
    empty.
    """

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
    Column(
        "tool_error_max", "float", "m", "largest distance of the simulated output from the path"
    ),
    Column(
        "turn_error_max", "float", "rad", "largest angle between the simulated output and the path"
    ),
    Column(
        "plan_error_max",
        "float",
        "m",
        "simulated distance from the modified path, where limits are active",
    ),
    Column(
        "plan_turn_error_max",
        "float",
        "rad",
        "simulated angle from the modified path, where limits are active",
    ),
    Column("torque_max", "float", "N m", "largest motor torque, motor side"),
    Column("torque_rms", "float", "N m", "largest root mean square torque of a motor"),
    Column("speed_max", "float", "rad/s", "largest motor speed, motor side"),
    Column("energy", "float", "J", "work done by all motors"),
    Column(
        "residual_max",
        "float",
        "N m",
        "largest residual of the equations of motion between the samples",
    ),
    Column(
        "residual_relative", "float", "1", "residual relative to the largest torque in its row"
    ),
    Column("energy_error", "float", "1", "relative error of the energy balance in the simulation"),
    Column("iterations", "int", "1", "of the solver"),
    Column("samples", "int", "1", "of the trajectory"),
    Column(
        "preactuation", "float", "s", "pre-actuation: how long before the path the motion begins"
    ),
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
            out.update(
                json.dumps(values.tolist()).encode() if column.kind == "text" else values.tobytes()
            )
        return out.hexdigest()

    def save(self, path: str | Path) -> Path:
        """Write to ``path``, ``.npz`` or ``.parquet`` (needs pyarrow); equal tables give equal npz
        files.
        """
        path = Path(path)
        if path.suffix not in (".npz", ".parquet"):
            raise ArgumentError(
                f"table: given {path.name!r}, expected a name that ends in .npz or .parquet"
            )
        with atomic_file(path) as stream:
            if path.suffix == ".npz":
                head = json.dumps([[c.name, c.kind, c.unit, c.doc] for c in self.columns])
                arrays: dict[str, Any] = {c.name: self.values[c.name] for c in self.columns}
                np.savez_compressed(stream, columns=np.array(head), **arrays)
            else:
                _save_parquet(self, stream)
        return path

    @staticmethod
    def load(path: str | Path) -> Table:
        """Read an npz file that `save` wrote; ArgumentError for one that is damaged or of another
        program.
        """
        try:
            most = max(SMALL, PACKED * Path(path).stat().st_size)
            arrays = read_npz(Path(path), min(LARGEST, most), _check_array)
        except FileNotFoundError:
            raise ArgumentError(f"table: given {str(path)!r}, which does not exist") from None
        except OSError as error:
            raise ArgumentError(
                f"table: given {str(path)!r}, which cannot be read ({error.strerror})"
            ) from None
        except NpzError as error:
            raise ArgumentError(f"table: given {str(path)!r}, {error}") from None
        problem, columns = _columns(arrays)
        if problem:
            raise ArgumentError(
                f"{path}: given a file that is not a table of flexgen ({problem}), expected a "
                "table that a sweep wrote"
            )
        return Table(columns, {c.name: arrays[c.name] for c in columns})


def _check_array(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """NpzError for texts longer than in any table, before they are read: zeros are packed to a
    thousandth.
    """
    characters = dtype.itemsize // np.dtype("U1").itemsize if dtype.kind == "U" else 0
    most = HEAD if name == "columns" else ESCAPED * LONGEST
    if characters > most:
        raise NpzError(
            f"the array {name[:80]!r} with texts of {characters} characters", f"at most {most}"
        )


def are_rows(rows: Any, columns: Sequence[Column], cases: Sequence[int]) -> bool:
    """Whether a value read from a JSON file is a valid list of rows, one for each case.

    Each row is a dict with the number of its case, in the order of ``cases``, and its entries have
    the kinds of their columns. A row may lack columns, which `table_of` fills with the value for
    missing ones, and may have entries of other names, which it ignores.
    """
    if not isinstance(rows, list):
        return False
    found = [row.get("case") if isinstance(row, dict) else None for row in rows]
    if found != [*cases]:
        return False
    kinds = {column.name: column.kind for column in columns}
    return all(_is_entry(kinds.get(name), value) for row in rows for name, value in row.items())


def _is_entry(kind: str | None, value: Any) -> bool:
    """Whether a column of this kind can hold a value; ``kind`` None: no column, any value."""
    if value is None or kind is None or kind == "text":
        return True
    if isinstance(value, int):
        return -(2**63) <= value < 2**63
    return kind == "float" and isinstance(value, float)


def _columns(arrays: Mapping[str, np.ndarray]) -> tuple[str, tuple[Column, ...]]:
    """Why the arrays of a table are refused, empty where they are valid, and its columns."""
    try:
        rows = json.loads(str(arrays["columns"]))
    except (KeyError, ValueError, RecursionError):
        return "no readable array 'columns'", ()
    if not (isinstance(rows, list) and rows and all(_is_column(row) for row in rows)):
        return "columns without name, kind, unit and meaning", ()
    columns = tuple(Column(*row) for row in rows)
    first = arrays.get(rows[0][0])
    length = () if first is None else first.shape
    for column in columns:
        values = arrays.get(column.name)
        if values is None or values.dtype.kind != np.dtype(_TYPES[column.kind]).kind:
            return f"no array {column.name[:80]!r} of the kind {column.kind}", ()
        if values.ndim != 1 or values.shape != length:
            return f"an array {column.name[:80]!r} of shape {values.shape}, expected {length}", ()
    return "", columns


def _is_column(row: Any) -> bool:
    texts = isinstance(row, list) and len(row) == 4 and all(isinstance(text, str) for text in row)
    return texts and row[1] in _TYPES


def table_of(columns: Sequence[Column], rows: Iterable[Mapping[str, Any]]) -> Table:
    """Rows as a table; entries that are absent or None are missing values."""
    lists: dict[str, list[Any]] = {column.name: [] for column in columns}
    for row in rows:
        for column in columns:
            lists[column.name].append(_entry(column.kind, row.get(column.name)))
    return Table(
        tuple(columns),
        {column.name: np.array(lists[column.name], _TYPES[column.kind]) for column in columns},
    )


def _entry(kind: str, value: Any) -> Any:
    """A value that is the same in memory and in every file: one NaN, texts in UTF-8 of limited
    length.
    """
    if value is None or value != value:
        return _MISSING[kind]
    if kind != "text":
        return value
    return str(value)[:LONGEST].encode("utf-8", "backslashreplace").decode("utf-8")


def _save_parquet(table: Table, stream: BinaryIO) -> None:
    """Write a table as Parquet, with unit and meaning of each column; ArgumentError without
    pyarrow.
    """
    try:
        pa = import_module("pyarrow")
        parquet = import_module("pyarrow.parquet")
    except ImportError as error:
        raise ArgumentError(
            f"table: given .parquet, which needs the package pyarrow ({error}); run: pip "
            "install pyarrow, or take .npz"
        ) from None
    kinds = {"int": pa.int64(), "float": pa.float64(), "text": pa.string()}
    fields = [
        pa.field(c.name, kinds[c.kind], metadata={"unit": c.unit, "doc": c.doc})
        for c in table.columns
    ]
    arrays = [pa.array(table.values[c.name].tolist(), kinds[c.kind]) for c in table.columns]
    parquet.write_table(pa.table(arrays, schema=pa.schema(fields)), stream)
