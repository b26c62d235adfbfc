"""Deflection and torque of one gear or spring, recorded in a locked or slow test.

A table of a logger with a column of the time, one of the deflection, such as ``deflection deg``,
and one of the torque, such as ``torque N m``; other names are stated. Values keep their order:
hysteresis depends on the path, and unequal steps in time do not matter to it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.files.record_columns import find_column, find_time
from flexgen.base.files.record_tables import read_arrays
from flexgen.base.files.trajectory_files import LARGEST

FEWEST = 20  # samples of a record
TABLES = (".csv", ".mat", ".npz", ".hebilog")
NAMES = ("deflection", "torque")


@dataclass(frozen=True, eq=False)
class DeflectionRecord:
    """``time`` [s], ``deflection`` [rad or m] and ``torque`` [N m or N], (n,) each, of a record
    with a ``name``.
    """

    name: str
    time: np.ndarray
    deflection: np.ndarray
    torque: np.ndarray


def read_deflection_record(
    record: Mapping[str, np.ndarray] | str | Path,
    unit: str,
    names: tuple[str, str] = NAMES,
    columns: Sequence[str] | None = None,
) -> DeflectionRecord:
    """The record of a gear.

    Parameters
    ----------
    record : name of a .csv, .mat, .npz or .hebilog file, or mapping
        A mapping has arrays ``time`` and those with these names, in SI units.
    unit : str
        Of the deflection, ``rad`` or ``m``; the torque is in N m or N.
    names : tuple of str
        Of deflection and torque; a ``-`` before a name turns the sign.
    columns : sequence of str, optional
        Names of the columns of a CSV file, in place of those that it has or lacks.

    Raises
    ------
    ArgumentError
        A column is missing or has a wrong unit; a value is not finite, the time goes back, or
        there are fewer than 20 samples.
    """
    signs = [1.0, *(-1.0 if name.startswith("-") else 1.0 for name in names)]
    names = (names[0].removeprefix("-"), names[1].removeprefix("-"))
    if isinstance(record, Mapping):
        where = "record"
        factors = [1.0, 1.0, 1.0]
        shown = ["time", *names]
        raw = [_array(record, name) for name in shown]
    else:
        where = str(record)
        raw, factors, shown = _of_table(Path(record), unit, names, columns)
    values = [
        sign * scale * _numbers(where, name, x)
        for name, sign, scale, x in zip(shown, signs, factors, raw, strict=True)
    ]
    lengths = {len(x) for x in values}
    if len(lengths) > 1 or min(lengths) < FEWEST:
        counts = ", ".join(str(len(x)) for x in values)
        raise ArgumentError(
            f"{where}: given {counts} values of {', '.join(shown)}, expected equally many, "
            f"{FEWEST} or more"
        )
    back = np.flatnonzero(np.diff(values[0]) < 0.0)
    if len(back):
        raise ArgumentError(
            f"{where}: column {shown[0]!r}: the time goes back after row {back[0] + 1}, expected "
            "rising times"
        )
    for name, x in zip(shown[1:], values[1:], strict=True):
        if not np.ptp(x) > 0.0:
            raise ArgumentError(
                f"{where}: column {name!r}: given a constant, expected a test that moves the gear"
            )
    return DeflectionRecord(Path(where).name, *values)


def _array(record: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """An array of a mapping."""
    if name not in record:
        raise ArgumentError(
            f"record: given the arrays {', '.join(map(str, record))}, expected also {name}"
        )
    return record[name]


def _of_table(
    path: Path, unit: str, names: tuple[str, str], columns: Sequence[str] | None
) -> tuple[list[Any], list[float], list[str]]:
    """Arrays of time, deflection and torque of a file, factors to SI units, names of columns."""
    where = str(path)
    if path.suffix not in TABLES:
        raise ArgumentError(
            f"{where}: given the ending {path.suffix!r}, expected one of {', '.join(TABLES)}"
        )
    if columns is not None and path.suffix != ".csv":
        raise ArgumentError(f"columns: given with {where!r}, expected a .csv file of a logger")
    if not path.is_file():
        raise ArgumentError(f"{where}: no such file, expected a record of deflection and torque")
    arrays = read_arrays(path, LARGEST, columns)
    header = list(arrays)
    plain = columns is not None
    force = "N m" if unit == "rad" else "N"
    places = [
        find_time(where, header, plain=plain),
        find_column(where, header, names[0], unit, plain=plain),
        find_column(where, header, names[1], force, plain=plain),
    ]
    shown = [header[at] for at, _ in places]
    return [arrays[name] for name in shown], [factor for _, factor in places], shown


def _numbers(where: str, name: str, x: Any) -> np.ndarray:
    """The finite numbers (n,) of a column."""
    values = np.ma.asanyarray(x)
    if values.size != max(values.shape, default=0) or not np.issubdtype(values.dtype, np.number):
        raise ArgumentError(
            f"{where}: column {name!r}: given shape {values.shape}, expected numbers (n,)"
        )
    flat = np.ma.filled(values.ravel().astype(float), np.nan)
    bad = np.flatnonzero(~np.isfinite(flat))
    if len(bad):
        raise ArgumentError(f"{where}: column {name!r}: row {bad[0] + 1} is not a finite number")
    return np.asarray(flat)
