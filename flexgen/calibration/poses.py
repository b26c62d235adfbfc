"""Measured static poses: commands of the joints, and positions of the trackers, from a CSV file.

Names of the columns: those of the actuated coordinates with their unit, ``q1_rad``, ``q1_deg``,
``z_m`` or ``z mm``; those of the trackers with axis and unit, ``m0_x_m`` or ``m0_x_mm``; units as
of `flexgen.units`. Other columns are ignored. An empty cell is a tracker that was not seen in this
pose.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexgen.calibration.parameters import AXES, trackers_of
from flexgen.display import short_repr
from flexgen.errors import ArgumentError
from flexgen.model.elements import RobotModel
from flexgen.records.columns import find_column
from flexgen.records.tables import is_number
from flexgen.spec.tables import open_file
from flexgen.type_checks import checked_result

LARGEST = 100_000  # poses
FAR = 1e6  # rad or m: no number of a robot


@checked_result  # positions may be nan
@dataclass(frozen=True, eq=False)
class StaticPoses:
    """Measured poses at rest.

    Parameters
    ----------
    commands : array (N, n_g) [rad or m]
        Actuated coordinates that were commanded, in the order of the model: what the motors reach.
    positions : array (N, k, 3) [m]
        Of the trackers of the model, in the frame of the measurement; nan where one was not seen.
    source : str
        Where they come from.

    Examples
    --------
    >>> import numpy as np
    >>> poses = flexgen.StaticPoses(np.zeros((5, 2)), np.full((5, 1, 3), 0.5), "by hand")
    >>> len(poses)
    5
    """

    commands: np.ndarray
    positions: np.ndarray
    source: str = "arrays"

    __repr__ = short_repr

    def __post_init__(self) -> None:
        try:
            commands, positions = (
                np.array(x, dtype=float) for x in (self.commands, self.positions)
            )
        except (TypeError, ValueError) as error:
            raise ArgumentError(
                f"poses: {error}; expected arrays of numbers (N, n_g) and (N, k, 3)"
            ) from None
        object.__setattr__(self, "commands", commands)
        object.__setattr__(self, "positions", positions)
        if (
            commands.ndim != 2
            or positions.ndim != 3
            or positions.shape[2] != 3
            or len(commands) != len(positions)
        ):
            raise ArgumentError(
                f"poses: given arrays of shapes {commands.shape} and {positions.shape}, expected (N, n_g) and (N, k, 3)"
            )
        if not np.isfinite(commands).all() or np.isinf(positions).any():
            raise ArgumentError(
                "poses: given commands or positions that are not finite; nan marks a position not seen"
            )

    def __len__(self) -> int:
        return len(self.commands)

    @classmethod
    def read(cls, path: str | Path, model: RobotModel) -> StaticPoses:
        """The poses of a CSV file, see the head of this module.

        Returns
        -------
        StaticPoses

        Raises
        ------
        ArgumentError
            The file cannot be read, a column is missing or given twice, a cell is not a number.
        """
        source = Path(path)
        try:
            with open_file(source, encoding="utf-8-sig", newline="") as stream:
                rows = list(_rows(source, csv.reader(stream)))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise ArgumentError(f"{source}: cannot be read as CSV: {error}") from None
        if not rows:
            raise ArgumentError(
                f"{source}: given an empty file, expected a line of names and a line for each pose"
            )
        header, where = [name.strip() for name in rows[0][1]], f"{source}:1"
        if all(is_number(name) for name in header):
            raise ArgumentError(
                f"{where}: given numbers in the first line, expected the names of the columns"
            )
        actuated = [c for c in model.coordinates if c.actuated]
        places = [find_column(where, header, c.name, c.unit) for c in actuated]
        points = [
            find_column(where, header, f"{s.name}_{axis}", "m")
            for s in trackers_of(model)
            for axis in AXES
        ]
        table = np.array(
            [_numbers(source, line, row, header, places, points) for line, row in rows[1:]]
        )
        if not len(table):
            raise ArgumentError(
                f"{source}: given a line of names only, expected a line for each pose"
            )
        n = len(places)
        return cls(table[:, :n], table[:, n:].reshape(len(table), -1, 3), str(source))


def _rows(source: Path, reader: Iterator[list[str]]) -> Iterator[tuple[int, list[str]]]:
    """Lines that are not empty, with their numbers."""
    for line, row in enumerate(reader, start=1):
        if line > LARGEST + 1:
            raise ArgumentError(
                f"{source}: given more than {LARGEST} lines, expected at most {LARGEST} poses"
            )
        if any(cell.strip() for cell in row):
            yield line, row


def _numbers(
    source: Path,
    line: int,
    row: list[str],
    header: list[str],
    places: list[tuple[int, float]],
    points: list[tuple[int, float]],
) -> list[float]:
    """The commands and positions of a line in SI units."""
    if len(row) != len(header):
        raise ArgumentError(
            f"{source}:{line}: given {len(row)} cells, expected {len(header)}, as line 1"
        )
    out = []
    for k, (column, factor) in enumerate([*places, *points]):
        cell = row[column].strip()
        try:
            value = math.nan if not cell and k >= len(places) else float(cell)
        except ValueError:
            value = math.inf
        if not (math.isnan(value) and k >= len(places)) and not abs(value) < FAR:
            raise ArgumentError(
                f"{source}:{line}: {header[column]}: given {cell[:40]!r}, expected a number"
            )
        out.append(factor * value)
    return out
