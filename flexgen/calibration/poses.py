"""Measured static poses: commands of the joints, and positions of the trackers, from a CSV file.

Names of the columns: those of the actuated coordinates with their unit, ``q1_rad``, ``q1_deg``,
``z_m`` or ``z mm``; those of the trackers with axis and unit, ``m0_x_m`` or ``m0_x_mm``; units as
of `flexgen.units`. Other columns are ignored. An empty cell is a tracker that was not seen in this
pose. ``m0_point``: name of the fixed point that the tracker touches in this pose, a point whose
place is not known, such as a cone that the tip of the tool is put into; with this column those of
the positions may be missing.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexgen.calibration.parameters import AXES, trackers_of
from flexgen.counts import number_in
from flexgen.display import short_repr
from flexgen.errors import ArgumentError
from flexgen.model.elements import RobotModel
from flexgen.records.columns import find_column
from flexgen.records.tables import is_number
from flexgen.spec.tables import open_file
from flexgen.type_checks import checked_result

LARGEST = 100_000  # poses
FAR = 1e6  # rad or m: no number of a robot
FEWEST_TOUCHES = 2  # poses at a fixed point: its place takes three numbers of the first


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
    points : array (N, k) of str, optional
        Names of the fixed points that the trackers touch; empty where they touch none. The place of
        a fixed point is not known, but one name is one place.

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
    points: np.ndarray | None = None

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
        self._set_points(positions)

    def _set_points(self, positions: np.ndarray) -> None:
        shape = positions.shape[:2]
        points = np.full(shape, "") if self.points is None else np.array(self.points, dtype=str)
        if points.shape != shape:
            raise ArgumentError(
                f"poses: given points of shape {points.shape}, expected {shape}, a name or '' for "
                "each pose and tracker"
            )
        object.__setattr__(self, "points", points)
        both = (points != "") & ~np.isnan(positions).all(axis=2)
        if both.any():
            row, k = np.argwhere(both)[0].tolist()
            raise ArgumentError(
                f"poses: given a position and the fixed point {str(points[row, k])[:40]!r} of one "
                f"tracker in row {row + 1}, expected one of both"
            )
        for name, count in zip(*np.unique(points[points != ""], return_counts=True), strict=True):
            if count < FEWEST_TOUCHES:
                raise ArgumentError(
                    f"poses: given {count} pose at the fixed point {str(name)[:40]!r}, expected at "
                    f"least {FEWEST_TOUCHES}: one alone tells nothing"
                )

    @property
    def point_names(self) -> tuple[str, ...]:
        """Names of the fixed points, sorted."""
        return tuple(str(name) for name in np.unique(np.asarray(self.points)) if name)

    @property
    def groups(self) -> np.ndarray:
        """Index (N, k) of the fixed point that is touched, in `point_names`; -1: none."""
        names = self.point_names
        groups = np.full(self.positions.shape[:2], -1)
        for k, name in enumerate(names):
            groups[self.points == name] = k
        return groups

    @property
    def is_measured(self) -> bool:
        """Whether any position was measured: else there is no frame of the measurement."""
        return bool(np.isfinite(self.positions).all(axis=2).any())

    @property
    def targets(self) -> np.ndarray:
        """Measured positions (N, k, 3) [m]; zero, from the fixed point, where one is touched."""
        touched = (self.groups >= 0)[..., None]
        return np.where(touched, 0.0, self.positions)

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
        header = [name.strip() for name in rows[0][1]]
        where = f"{source}:1"
        if all(is_number(name) for name in header):
            raise ArgumentError(
                f"{where}: given numbers in the first line, expected the names of the columns"
            )
        actuated = [c for c in model.coordinates if c.actuated]
        places = [find_column(where, header, c.name, c.unit) for c in actuated]
        trackers = trackers_of(model)
        touched = [(k, f"{s.name}_point") for k, s in enumerate(trackers)]
        touching = [(k, header.index(title)) for k, title in touched if title in header]
        without = {trackers[k].name for k, _ in touching}
        points = [
            _find_axis(where, header, f"{s.name}_{axis}", is_needed=s.name not in without)
            for s in trackers
            for axis in AXES
        ]
        table = np.array(
            [_numbers(source, line, row, header, places, points) for line, row in rows[1:]]
        )
        names = np.full((len(table), len(trackers)), "", dtype=object)
        for k, column in touching:
            names[:, k] = [row[column].strip() for _, row in rows[1:]]
        if not len(table):
            raise ArgumentError(
                f"{source}: given a line of names only, expected a line for each pose"
            )
        n = len(places)
        positions = table[:, n:].reshape(len(table), -1, 3)
        try:
            return cls(table[:, :n], positions, str(source), names)
        except ArgumentError as error:
            raise ArgumentError(f"{source}: {error}") from None


def _rows(source: Path, reader: Iterator[list[str]]) -> Iterator[tuple[int, list[str]]]:
    """Lines that are not empty, with their numbers."""
    for line, row in enumerate(reader, start=1):
        if line > LARGEST + 1:
            raise ArgumentError(
                f"{source}: given more than {LARGEST} lines, expected at most {LARGEST} poses"
            )
        if any(cell.strip() for cell in row):
            yield line, row


def _find_axis(where: str, header: list[str], name: str, is_needed: bool) -> tuple[int, float]:
    """Index of the column of an axis of a tracker, and the factor to m; index -1: there is none."""
    if not is_needed and not any(title.startswith(name) for title in header):
        return -1, 1.0
    return find_column(where, header, name, "m")


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
        cell = row[column].strip() if column >= 0 else ""
        try:
            value = math.nan if not cell and k >= len(places) else number_in(cell)
        except ValueError:
            value = math.inf
        if not (math.isnan(value) and k >= len(places)) and not abs(value) < FAR:
            raise ArgumentError(
                f"{source}:{line}: {header[column]}: given {cell[:40]!r}, expected a number"
            )
        out.append(factor * value)
    return out
