"""Measured static poses: commands of the joints, and positions of the trackers, from a CSV file.

Names of the columns: those of the actuated coordinates with their unit, ``q1_rad``, ``q1_deg``,
``z_m`` or ``z mm``; those of the trackers with axis and unit, ``m0_x_m`` or ``m0_x_mm``; units as
of `flexgen.base.spec.units`. Other columns are ignored. An empty cell is a tracker that was not
seen in this pose. ``m0_point``: name of the fixed point that the tracker touches in this pose, a
point whose place is not known, such as a cone that the tip of the tool is put into. ``m0_touch``:
what it touches otherwise, one of the forms below, with one number in ``m0_reading_mm``. With
either column those of the positions may be missing. ``m0_sd_mm``: standard deviation of an axis of
the position,
of the distance from the point, or of the reading.

| ``m0_touch`` | surface or gauge | ``m0_reading_mm`` |
|---|---|---|
| ``plane NAME`` | a plane whose place is not known | distance from it along its normal; empty: 0 |
| ``sphere NAME`` | a sphere whose place is not known | distance from its center, both radii |
| ``gauge NAME AXIS`` | a dial gauge, zeroed anywhere | displacement along the axis |
| ``level NAME AXIS`` | an inclinometer along an axis of the tracker | sine of the inclination |
| ``coordinate AXIS`` | a plane of the world across an axis | its coordinate |

``AXIS`` is ``x``, ``-y``, ..., of the world of the robot, or of a gauge also ``tool.x``, ...: an
axis of the tracker, along which the gauge measures its displacement from a point that is fixed in
the world.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexgen.base.checks.counts import number_in
from flexgen.base.checks.type_checks import checked_result
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError
from flexgen.base.files.record_columns import find_column
from flexgen.base.files.record_tables import read_cells
from flexgen.identification.poses.parameters import AXES, trackers_of
from flexgen.identification.poses.touches import Touches
from flexgen.model.elements import RobotModel

LARGEST = 100_000  # poses
FAR = 1e6  # rad or m: no number of a robot
FEWEST_TOUCHES = 2  # poses at a fixed point: its place takes three numbers of the first
ENDINGS = ("point", "touch", "reading", "sd")  # of the names of columns of a tracker
SIMILAR = 0.7  # part of the letters that agree, from which on a name is taken as misspelt
TEXTS = ("_point", "_touch")  # endings of the names of columns that have texts


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
        Names of the fixed points that the trackers touch; empty where they touch none. The place
        of a fixed point is not known, but one name is one place.
    touches : array (N, k) of str, optional
        What they touch otherwise, as in a file: ``"plane table"``; empty where nothing.
    readings : array (N, k) [m], optional
        Of the touches; nan of a plane: 0.
    sd : array (N, k) [m], optional
        Standard deviations; nan: that of the fit.

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
    touches: np.ndarray | None = None
    readings: np.ndarray | None = None
    sd: np.ndarray | None = None

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
                f"poses: given arrays of shapes {commands.shape} and {positions.shape}, "
                "expected (N, n_g) and (N, k, 3)"
            )
        if not np.isfinite(commands).all() or np.isinf(positions).any():
            raise ArgumentError(
                "poses: given commands or positions that are not finite; nan marks a position "
                "not seen"
            )
        self._set_points(positions)
        self._set_touches(positions)

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
                    f"poses: given {count} pose at the fixed point {str(name)[:40]!r}, expected "
                    f"at least {FEWEST_TOUCHES}: one alone tells nothing"
                )

    def _set_touches(self, positions: np.ndarray) -> None:
        shape = positions.shape[:2]
        touches = np.full(shape, "") if self.touches is None else np.array(self.touches, dtype=str)
        readings = np.full(shape, np.nan) if self.readings is None else self.readings
        readings = np.array(readings, dtype=float)
        sd = None if self.sd is None else np.array(self.sd, dtype=float)
        for name, array in (("touches", touches), ("readings", readings), ("sd", sd)):
            if array is not None and array.shape != shape:
                raise ArgumentError(
                    f"poses: given {name} of shape {array.shape}, expected {shape}, one for each "
                    "pose and tracker"
                )
        touched = touches != ""
        seen = ~np.isnan(positions).all(axis=2) | (np.asarray(self.points) != "")
        planes = np.char.startswith(touches, "plane")
        empty = np.isnan(readings)
        for rows, given, expected in (
            (touched & seen, "a touch, and a position or a fixed point, of", "one of them"),
            (touched & empty & ~planes, "no reading of the touch of", "a number"),
            (~touched & ~empty, "a reading without a touch of", "what is touched"),
            (np.isinf(readings), "an infinite reading of", "a number"),
        ):
            if rows.any():
                row = int(np.argwhere(rows)[0][0]) + 1
                raise ArgumentError(
                    f"poses: given {given} one tracker in row {row}, expected {expected}"
                )
        if sd is not None and not (np.isnan(sd) | ((sd > 0.0) & np.isfinite(sd))).all():
            row, k = np.argwhere(~(np.isnan(sd) | ((sd > 0.0) & np.isfinite(sd))))[0].tolist()
            raise ArgumentError(
                f"poses: given sd of {sd[row, k]:g} m in row {row + 1}, expected finite standard "
                "deviations > 0; nan where none is known"
            )
        object.__setattr__(self, "touches", touches)
        filled = np.where(touched & empty, 0.0, readings)
        object.__setattr__(self, "readings", filled if touched.any() else None)
        object.__setattr__(self, "sd", sd)
        found = surfaces_of(self)
        if found is not None:
            found.refuse_few()

    @property
    def weights(self) -> np.ndarray | None:
        """Factors (N, k) of readings: the median deviation over each; None: none is stated."""
        if self.sd is None or np.isnan(self.sd).all():
            return None
        return np.where(np.isnan(self.sd), 1.0, np.nanmedian(self.sd) / self.sd)

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
        """Measured positions (N, k, 3) [m]; zero where a point or surface is touched."""
        touched = ((self.groups >= 0) | (np.asarray(self.touches) != ""))[..., None]
        return np.where(touched, 0.0, self.positions)

    def __len__(self) -> int:
        return len(self.commands)

    @classmethod
    def read(
        cls, path: str | Path, model: RobotModel, columns: Sequence[str] | None = None
    ) -> StaticPoses:
        """The poses of a CSV file, see the head of this module.

        Parameters
        ----------
        path : str or Path
        model : RobotModel
        columns : sequence of str, optional
            Names of the columns of a file without a header; those without unit are in SI units.

        Returns
        -------
        StaticPoses

        Raises
        ------
        ArgumentError
            The file cannot be read, a column is missing or given twice, a cell is not a number.
        """
        source = Path(path)
        header, rows = read_cells(source, LARGEST, columns, _has_texts)
        table = _Table(source, header, rows, columns is not None)
        actuated = [c for c in model.coordinates if c.actuated]
        commands = np.column_stack([table.numbers(c.name, c.unit, False) for c in actuated])
        of = [table.of_tracker(sensor.name) for sensor in trackers_of(model)]
        positions, points, touches, readings, deviations = (
            np.stack([one[k] for one in of], axis=1) for k in range(5)
        )
        stated = None if np.isnan(deviations).all() else deviations
        if not rows:
            raise ArgumentError(
                f"{source}: given a line of names only, expected a line for each pose"
            )
        try:
            return cls(commands, positions, str(source), points, touches, readings, stated)
        except ArgumentError as error:
            raise ArgumentError(f"{source}: {error}") from None


def _has_texts(name: str) -> bool:
    return name.strip().endswith(TEXTS)


@dataclass(frozen=True)
class _Table:
    """Cells of a CSV file; ``plain``: columns without unit are in SI units."""

    source: Path
    header: list[str]
    rows: list[tuple[int, list[str]]]
    plain: bool

    def texts(self, title: str) -> np.ndarray:
        """The cells of a column; empty where there is none."""
        found = [k for k, name in enumerate(self.header) if name == title]
        if len(found) > 1:
            raise ArgumentError(f"{self.source}:1: given two columns of {title}, expected one")
        cells = [row[found[0]] if found else "" for _, row in self.rows]
        return np.array([" ".join(cell.split()) for cell in cells], dtype=object)

    def numbers(self, name: str, si: str, may_lack: bool, may_miss: bool = False) -> np.ndarray:
        """The numbers of a column in SI units.

        ``may_lack``: nan where a cell is empty; ``may_miss``: nan where there is no such column.
        """
        if may_miss and not any(title.startswith(name) for title in self.header):
            return np.full(len(self.rows), np.nan)
        where = f"{self.source}:1"
        k, factor = find_column(where, self.header, name, si, plain=self.plain)
        return np.array(
            [factor * self._number(line, row[k], k, may_lack) for line, row in self.rows]
        )

    def _number(self, line: int, cell: str, k: int, may_lack: bool) -> float:
        if not cell and may_lack:
            return math.nan
        try:
            value = number_in(cell)
        except ValueError:
            value = math.inf
        if math.isnan(value) and may_lack:
            return value
        if not abs(value) < FAR:
            raise ArgumentError(
                f"{self.source}:{line}: {self.header[k]}: given {cell[:40]!r}, expected a number"
            )
        return value

    def _refuse_similar(self, name: str) -> None:
        """Refuse misspelt columns of a tracker: others are ignored, and readings would be 0."""
        for title in self.header:
            word = re.split(r"[_ ]", title.removeprefix(f"{name}_"))[0]
            if not title.startswith(f"{name}_") or word in ENDINGS:
                continue
            near = difflib.get_close_matches(word, ENDINGS, 1, SIMILAR)
            if near:
                raise ArgumentError(
                    f"{self.source}:1: given the column {title[:40]!r}, expected "
                    f"{name}_{near[0]}, or another name for a column of something else"
                )

    def of_tracker(self, name: str) -> tuple[np.ndarray, ...]:
        """Positions (N, 3), names of points and surfaces, readings, deviations (N,)."""
        self._refuse_similar(name)
        points = self.texts(f"{name}_point")
        touches = self.texts(f"{name}_touch")
        touching = f"{name}_point" in self.header or f"{name}_touch" in self.header
        axes = [self.numbers(f"{name}_{axis}", "m", True, touching) for axis in AXES]
        readings = self.numbers(f"{name}_reading", "m", True, True)
        deviations = self.numbers(f"{name}_sd", "m", True, True)
        return np.column_stack(axes), points, touches, readings, deviations


def surfaces_of(poses: StaticPoses) -> Touches | None:
    """Surfaces and gauges that the trackers touch, other than fixed points; None: nothing."""
    if poses.readings is None:
        return None
    return Touches.of(np.asarray(poses.touches), poses.readings)
