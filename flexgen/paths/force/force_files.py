"""CSV files of a force on the tool, over time or over the place on a path: a row of names, then
numbers.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.files.trajectory_files import common_unit
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.base.spec.tables import open_file
from flexgen.paths.force.tool_force import CHANNEL, LABELS, UNITS

LINE_MAX = 1000  # characters
ROWS_MAX = 200_000  # rows of a file


def is_table(file: Path) -> bool:
    """Whether a file is a CSV file without the meta data of a trajectory."""
    try:
        with open_file(file, "rb") as stream:
            return file.suffix.lower() == ".csv" and not stream.read(4).removeprefix(
                b"\xef\xbb\xbf"
            ).startswith(b"#")
    except OSError:
        return False


def read_force(file: Path, first: str, expected: str) -> Trajectory:
    """The columns ``first``, fx, fy, fz (, mx, my, mz) of a CSV file as a trajectory, the first
    one in place of the time. ``expected``: for the error.

    Raises
    ------
    ArgumentError
        The file cannot be read, or has other columns, numbers that are not finite, or a first
        column that does not increase.
    """
    try:
        with open_file(file, encoding="utf-8-sig") as stream:
            names = [name.strip() for name in stream.readline(LINE_MAX).split(",")]
            rows = np.loadtxt(stream, delimiter=",", ndmin=2, max_rows=ROWS_MAX)
    except OSError as error:
        raise ArgumentError(
            f"force: file {file} cannot be read ({error}), expected {expected}"
        ) from None
    except ValueError as error:
        why = str(error).partition("; use")[0]
        raise ArgumentError(
            f"force: file {file} cannot be read ({why}), expected names in line 1, then numbers "
            "with a decimal point, and commas between the columns"
        ) from None
    labels = LABELS[: len(names) - 1]
    if names != [first, *labels] or len(labels) not in (3, 6):
        columns = (
            f"the columns {first}, fx, fy, fz [N], or these and mx, my, mz [N m], with commas "
            "between them"
        )
        raise ArgumentError(
            f"force: given the columns {', '.join(names)} in {file}, expected {columns}"
        )
    if rows.shape[1] != len(names) or len(rows) < 2:
        raise ArgumentError(
            f"force: given {len(rows)} rows in {file}, expected two or more of {len(names)} "
            "numbers"
        )
    bad = ~np.isfinite(rows).all(axis=1) | (np.diff(rows[:, 0], prepend=-np.inf) <= 0)
    if bad.any():
        row = int(np.argmax(bad))
        given = ", ".join(f"{x:g}" for x in rows[row])
        expected = f"finite numbers, {first} increasing"
        raise ArgumentError(
            f"force: given {given} in row {row + 1} of {file}, expected {expected}"
        )
    units = UNITS[: len(labels)]
    port = Port(CHANNEL, (len(labels),), common_unit(units), "force on the tool")
    return Trajectory(
        rows[:, 0],
        {CHANNEL: rows[:, 1:]},
        {CHANNEL: port},
        {CHANNEL: labels},
        {},
        {CHANNEL: units},
    )
