"""Records of a robot that takes positions: its commands and its angles, from a plain CSV file.

Names of the columns: ``time_s`` or ``time_ms``; of each joint ``JOINT_command_deg`` and ``JOINT_deg`` (or ``_rad``;
``_mm`` or ``_m`` of a joint that slides). Other columns are ignored. The rows are one period of the interface apart.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexgen.display import short_repr
from flexgen.errors import ArgumentError
from flexgen.model.elements import RobotModel
from flexgen.type_checks import checked_class

UNITS = {"rad": {"rad": 1.0, "deg": math.pi / 180.0}, "m": {"m": 1.0, "mm": 1e-3}}
TIMES = {"time_s": 1.0, "time_ms": 1e-3}
MOST, FEWEST = 1_000_000, 100  # rows
LONGEST_S = 1.0  # between two rows
EVEN = 0.02  # largest difference of a step in time from the others, relative


@checked_class
@dataclass(frozen=True)
class ServoRecord:
    """What a robot was commanded, and where its motors were, in the joints that rigid gears would turn.

    Parameters
    ----------
    time : array (n,) [s]
        At equal steps, the period of the interface.
    command, angle : array (n, n_g) [rad or m]
        Positions that were sent, and measured ones, in the order of the actuated coordinates of the model.
    source : str
        Where they come from.

    Examples
    --------
    >>> import numpy as np
    >>> record = flexgen.ServoRecord(np.arange(200) * 0.004, np.zeros((200, 2)), np.zeros((200, 2)))
    >>> record.period
    0.004
    """

    time: np.ndarray
    command: np.ndarray
    angle: np.ndarray
    source: str = ""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        n, where = len(np.atleast_1d(self.time)), self.source or "record"
        if np.ndim(self.time) != 1 or not FEWEST <= n <= MOST:
            raise ArgumentError(f"{where}: given {n} rows, expected {FEWEST} to {MOST}")
        shapes = [np.shape(x) for x in (self.command, self.angle)]
        if shapes[0] != shapes[1] or len(shapes[0]) != 2 or shapes[0][0] != n:
            raise ArgumentError(
                f"{where}: given commands {shapes[0]}, angles {shapes[1]}, expected ({n}, joints) of both"
            )
        if not all(np.isfinite(x).all() for x in (self.time, self.command, self.angle)):
            raise ArgumentError(f"{where}: given NaN or infinity, expected finite numbers")
        steps = np.diff(self.time)
        if steps.mean() > LONGEST_S:
            raise ArgumentError(
                f"{where}: given {steps.mean():g} s between two rows, expected at most {LONGEST_S:g} s; times in "
                "milliseconds are in a column time_ms"
            )
        if not (np.abs(steps - steps.mean()) <= EVEN * steps.mean()).all() or steps.mean() <= 0.0:
            row = int(np.argmax(np.abs(steps - np.median(steps)))) + 2
            raise ArgumentError(
                f"{where}: given unequal steps in time at row {row}, {steps[row - 2]:.6g} s after the row before, "
                f"expected one period between all rows, {np.median(steps):.6g} s"
            )

    @property
    def period(self) -> float:
        """Between two rows [s]."""
        return float(np.round((self.time[-1] - self.time[0]) / (len(self.time) - 1), 9))

    @classmethod
    def read(cls, path: str | Path, model: RobotModel) -> ServoRecord:
        """Read a CSV file, see `flexgen.servo.record`; ArgumentError with file, line and column where it is wrong."""
        file, rows = Path(path), []
        try:
            with file.open(newline="", encoding="utf-8-sig") as text:
                lines = csv.reader(text)
                head = [word.strip() for word in next(lines, [])]
                clock, columns = _columns(file, head, model)
                for number, cells in enumerate(lines, 2):
                    if cells:
                        if len(cells) < len(head) or any(map(str.strip, cells[len(head) :])):
                            raise ArgumentError(
                                f"{file}:{number}: given {len(cells)} cells, expected {len(head)}, one for each name "
                                "in the first line; decimals have a point"
                            )
                        rows.append(
                            [_number(file, number, head, cells, k) for k, _ in (clock, *columns)]
                        )
                    if len(rows) > MOST:
                        raise ArgumentError(f"{file}: given more than {MOST} rows, expected fewer")
        except (OSError, UnicodeError, csv.Error) as error:
            raise ArgumentError(f"{file}: cannot be read: {error}") from error
        values = np.array(rows).reshape(len(rows), 1 + len(columns)) * [
            factor for _, factor in (clock, *columns)
        ]
        n = len(columns) // 2
        return cls(values[:, 0], values[:, 1 : n + 1], values[:, n + 1 :], str(file))


def _columns(
    file: Path, head: list[str], model: RobotModel
) -> tuple[tuple[int, float], list[tuple[int, float]]]:
    """Number and factor of the column of the time, and of those of commands, then angles."""
    clock = next(
        ((head.index(name), factor) for name, factor in TIMES.items() if name in head), None
    )
    if clock is None:
        one = len(head) == 1 and (";" in head[0] or "\t" in head[0])
        more = " and commas between the columns, points in the numbers" if one else ""
        raise ArgumentError(
            f"{file}:1: given the columns {', '.join(head)[:200]}, expected time_s or time_ms{more}"
        )
    out = []
    for middle in ("_command", ""):
        for coordinate in (model.coordinates[i] for i in model.i_g):
            names = {
                f"{coordinate.name}{middle}_{unit}": x for unit, x in UNITS[coordinate.unit].items()
            }
            found = next(
                ((head.index(name), factor) for name, factor in names.items() if name in head), None
            )
            if found is None:
                raise ArgumentError(
                    f"{file}:1: given no column {' or '.join(names)}, expected one for each joint"
                )
            out.append(found)
    return clock, out


def _number(file: Path, line: int, head: list[str], cells: list[str], column: int) -> float:
    """The number of a cell."""
    try:
        value = float(cells[column])
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ArgumentError(
            f"{file}:{line}: {head[column]}: given {cells[column][:40]!r}, expected a finite number"
        )
    return value
