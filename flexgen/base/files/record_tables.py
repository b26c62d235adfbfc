"""Tables of other programs: arrays by name from .csv, .npz and .mat files.

A CSV file has names in line 1, or none where the names of its columns are stated. An empty cell is
an instant at which its channel was not sampled; such arrays are masked there.
"""

from __future__ import annotations

import csv
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.checks.counts import number_in
from flexgen.base.errors import ArgumentError
from flexgen.base.files.hebi_log import read_hebi_log
from flexgen.base.files.npz_files import NpzError, read_npz
from flexgen.base.spec.tables import open_file

EXPECTED = "names in line 1, then numbers with a decimal point, and commas between the columns"
SKIPPED = "-"  # name of a column that is not read
LINES = 50  # comments above the names, at most


def read_arrays(file: Path, size_max: int, columns: Sequence[str] | None = None) -> dict[str, Any]:
    """The arrays of a file of another program by their names: .npz, .mat (version 5), .csv,
    .hebilog.

    Parameters
    ----------
    file : Path
    size_max : int
        Bytes.
    columns : sequence of str, optional
        Names of the columns of a CSV file, in place of those in its first line, if it has any;
        ``"-"``: left out.

    Raises
    ------
    ArgumentError
        The file is larger than ``size_max`` bytes, cannot be read, or ends otherwise.
    """
    if file.stat().st_size > size_max:
        raise ArgumentError(
            f"{file}: given {file.stat().st_size} bytes, expected at most {size_max}"
        )
    if file.suffix == ".npz":
        try:
            return dict(read_npz(file, size_max))
        except NpzError as error:
            raise ArgumentError(f"{file}: {error}") from None
    if file.suffix == ".csv":
        return _csv(file, columns)
    if file.suffix == ".mat":
        from scipy.io import loadmat

        try:
            with open_file(file, "rb") as stream:
                found = loadmat(stream)
        except Exception as error:  # the reader raises many kinds for a damaged file
            raise ArgumentError(
                f"{file}: cannot be read as a MAT file of version 5 ({error})"
            ) from None
        return {
            name: x
            for name, x in found.items()
            if isinstance(x, np.ndarray) and not name.startswith("_")
        }
    if file.suffix == ".hebilog":
        return read_hebi_log(file)
    raise ArgumentError(
        f"{file}: given the ending {file.suffix!r}, expected .mat, .npz, .csv or .hebilog"
    )


def _csv(file: Path, columns: Sequence[str] | None) -> dict[str, Any]:
    """Columns by the names in the first line, or by those that are stated."""
    try:
        names, top = _names(file)
    except (OSError, UnicodeError, csv.Error) as error:
        raise ArgumentError(f"{file}: cannot be read: {error}; expected {EXPECTED}") from None
    pairs = zip(columns or names, names, strict=False)
    numbers = bool(names) and all(is_number(cell) for name, cell in pairs if name != SKIPPED)
    if numbers and columns is None:
        raise ArgumentError(
            f"{file}:{top + 1}: given numbers in the first line, expected the names of the "
            "columns; state them by --columns NAME,NAME,... or as columns = [...] in a description"
        )
    if columns is not None:
        names = [name.strip() for name in columns]
    if len(names) == 1 and (";" in names[0] or "\t" in names[0]):
        raise ArgumentError(
            f"{file}:{top + 1}: given {names[0][:60]!r}, expected commas between the columns, and "
            "points in the numbers"
        )
    try:
        values = _numbers(file, names, top if numbers else top + 1)
    except ArgumentError:
        raise
    except (OSError, UnicodeError, ValueError, csv.Error) as error:
        raise ArgumentError(f"{file}: cannot be read: {error}; expected {EXPECTED}") from None
    kept = [name for name in names if name != SKIPPED]
    if len(set(kept)) != len(kept):
        raise ArgumentError(f"{file}: given the names {names}, expected different names")
    return {name: column for name, column in zip(names, values.T, strict=True) if name != SKIPPED}


def read_cells(
    file: Path,
    most: int,
    columns: Sequence[str] | None = None,
    texts: Callable[[str], bool] = lambda name: False,
) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """The names of the columns of a CSV file, and its lines as texts with their numbers.

    Parameters
    ----------
    file : Path
    most : int
        Lines with values.
    columns : sequence of str, optional
        Names in place of those in the first line, if it has any; ``"-"``: left out.
    texts : callable
        Whether a column of this name has texts: the first line is one of values where all of its
        other cells are numbers.

    Raises
    ------
    ArgumentError
        The file cannot be read, has too many lines or other cells than names, or no names.
    """
    try:
        with open_file(file, encoding="utf-8-sig", newline="") as stream:
            rows = list(_filled_rows(file, csv.reader(stream), most))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ArgumentError(f"{file}: cannot be read as CSV: {error}") from None
    if not rows:
        raise ArgumentError(
            f"{file}: given an empty file, expected a line of names and a line for each pose"
        )
    top, first = rows[0]
    names = [name.strip() for name in columns or first]
    pairs = [pair for pair in zip(names, first, strict=False) if pair[0] != SKIPPED]
    if columns is not None:
        pairs = [(name, cell) for name, cell in pairs if not texts(name)]
    numbers = all(is_number(cell.strip()) for _, cell in pairs)
    if numbers and columns is None:
        raise ArgumentError(
            f"{file}:{top}: given numbers in the first line, expected the names of the columns; "
            "state them by --columns NAME,NAME,..."
        )
    if columns is None or not numbers:
        rows = rows[1:]
    for line, cells in rows:
        if len(cells) != len(names):
            source = "line 1" if columns is None else "the names"
            raise ArgumentError(
                f"{file}:{line}: given {len(cells)} cells, expected {len(names)}, as {source}"
            )
    kept = [k for k, name in enumerate(names) if name != SKIPPED]
    lines = [(line, [cells[k].strip() for k in kept]) for line, cells in rows]
    return [names[k] for k in kept], lines


def _filled_rows(
    file: Path, reader: Iterable[list[str]], most: int
) -> Iterator[tuple[int, list[str]]]:
    """Lines that are neither empty nor comments, with their numbers."""
    for line, row in enumerate(reader, start=1):
        if line > most + 1:
            raise ArgumentError(
                f"{file}: given more than {most} lines, expected at most {most} poses"
            )
        if any(cell.strip() for cell in row) and not row[0].startswith("#"):
            yield line, row


def _names(file: Path) -> tuple[list[str], int]:
    """Cells of the first line that is not a comment, and the number of lines above it."""
    with open_file(file, encoding="utf-8-sig", newline="") as stream:
        top = 0
        line = stream.readline()
        while line.startswith("#") and top < LINES:
            top = top + 1
            line = stream.readline()
    return [name.strip() for name in next(csv.reader([line]), [])], top


def is_number(cell: str) -> bool:
    """Whether a cell has a number, or nothing."""
    try:
        number_in(cell or "0")
    except ValueError:
        return False
    return True


def _numbers(file: Path, names: Sequence[str], top: int) -> np.ndarray:
    """The numbers below the first lines; a masked array where cells are empty."""
    with open_file(file, encoding="utf-8-sig") as stream:
        for _ in range(top):
            stream.readline()
        try:
            with warnings.catch_warnings(action="ignore"):  # of a file without numbers
                values = np.asarray(np.loadtxt(stream, delimiter=",", ndmin=2))
        except ValueError:
            values = np.zeros((0, 0))
    if values.size and values.shape[1] == len(names):
        return values
    rows: list[list[float]] = []
    empty: list[list[bool]] = []
    with open_file(file, encoding="utf-8-sig", newline="") as stream:
        for line, cells in enumerate(csv.reader(stream), 1):
            if line <= top or not "".join(cells).strip() or cells[0].startswith("#"):
                continue
            if len(cells) < len(names) or any(map(str.strip, cells[len(names) :])):
                raise ArgumentError(
                    f"{file}:{line}: given {len(cells)} cells, expected {len(names)}, one for "
                    "each name in the first line; decimals have a point"
                )
            pairs = list(zip(names, cells, strict=False))
            rows.append([_number(f"{file}:{line}", *pair) for pair in pairs])
            empty.append([not cell.strip() for _, cell in pairs])
    if not rows:
        raise ValueError("no numbers")
    mask = np.array(empty)
    return np.ma.masked_array(np.array(rows), mask) if mask.any() else np.array(rows)


def _number(where: str, name: str, cell: str) -> float:
    """The number in a cell; 0 in an empty one, which is masked."""
    if name == SKIPPED or not cell.strip():
        return 0.0
    try:
        return number_in(cell)
    except ValueError:
        given = cell.strip()[:40]
        raise ArgumentError(f"{where}: {name}: given {given!r}, expected a number") from None
