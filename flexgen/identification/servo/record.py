"""Records of a robot that takes positions: its commands and its angles, from a plain CSV file.

Names of the columns: the time, ``time_s`` or ``t ms``; of each joint ``JOINT_command_deg`` and
``JOINT_deg``, with its unit (`flexgen.base.spec.units`) behind ``_`` or a space. Other columns are
ignored. Commands are one period of the interface apart: stamps that scatter about equal steps
become these, commands that were sent at unequal steps are refused. Angles with another rate than
the commands are taken at their instants. Before a gap in time the record ends. Logs of libfranka
are read as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexgen.base.checks.type_checks import checked_class
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError
from flexgen.base.files.record_columns import find_column, find_time
from flexgen.base.files.record_tables import read_arrays
from flexgen.base.numerics.sampling import drop_repeats, read_clock, resample
from flexgen.identification.records.libfranka import columns_of_log, is_log
from flexgen.model.elements import RobotModel

SIZE_MAX = 1_000_000_000  # bytes of a file
# rows
MOST = 1_000_000
FEWEST = 100
LONGEST_S = 1.0  # between two rows
EVEN = 0.02  # largest difference of a step in time from the others, relative


@checked_class
@dataclass(frozen=True)
class ServoRecord:
    """Record of commanded positions and of motor positions, in the joints that rigid gears would
    turn.

    Parameters
    ----------
    time : array (n,) [s]
        At equal steps, the period of the interface.
    command, angle : array (n, n_g) [rad or m]
        Positions that were sent, and measured ones, in the order of the actuated coordinates of
        the model.
    source : str
        Where they come from.
    notes : tuple of str
        What was done to the file, as sentences.

    Examples
    --------
    >>> import numpy as np
    >>> record = flexgen.ServoRecord(
    ...     np.arange(200) * 0.004, np.zeros((200, 2)), np.zeros((200, 2))
    ... )
    >>> record.period
    0.004
    """

    time: np.ndarray
    command: np.ndarray
    angle: np.ndarray
    source: str = ""
    notes: tuple[str, ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(self.time))
        where = self.source or "record"
        if np.ndim(self.time) != 1 or not FEWEST <= n <= MOST:
            raise ArgumentError(f"{where}: given {n} rows, expected {FEWEST} to {MOST}")
        shapes = [np.shape(x) for x in (self.command, self.angle)]
        if shapes[0] != shapes[1] or len(shapes[0]) != 2 or shapes[0][0] != n:
            raise ArgumentError(
                f"{where}: given commands {shapes[0]}, angles {shapes[1]}, expected ({n}, "
                "joints) of both"
            )
        if not all(np.isfinite(x).all() for x in (self.time, self.command, self.angle)):
            raise ArgumentError(f"{where}: given NaN or infinity, expected finite numbers")
        steps = np.diff(self.time)
        if steps.mean() > LONGEST_S:
            raise ArgumentError(
                f"{where}: given {steps.mean():g} s between two rows, expected at most "
                f"{LONGEST_S:g} s; times in milliseconds are in a column time_ms"
            )
        if not (np.abs(steps - steps.mean()) <= EVEN * steps.mean()).all() or steps.mean() <= 0.0:
            row = int(np.argmax(np.abs(steps - np.median(steps)))) + 2
            raise ArgumentError(
                f"{where}: given unequal steps in time at row {row}, {steps[row - 2]:.6g} s "
                "after the row before, expected one period between all rows, "
                f"{np.median(steps):.6g} s"
            )

    @property
    def period(self) -> float:
        """Between two rows [s]."""
        return float(np.round((self.time[-1] - self.time[0]) / (len(self.time) - 1), 9))

    @classmethod
    def read(
        cls, path: str | Path, model: RobotModel, columns: Sequence[str] | None = None
    ) -> ServoRecord:
        """Read a CSV file, see `flexgen.identification.servo.record`.

        Parameters
        ----------
        path : str or Path
        model : RobotModel
        columns : sequence of str, optional
            Names of the columns of a file without a header; those without unit are in SI units.

        Returns
        -------
        ServoRecord

        Raises
        ------
        ArgumentError
            A column is missing, or its unit cannot be used; the times are not those of an
            interface.
        """
        file = Path(path)
        plain = columns is not None
        if file.suffix != ".csv" or not file.is_file():
            raise ArgumentError(f"{file}: cannot be read: expected a CSV file")
        arrays = read_arrays(file, SIZE_MAX, columns)
        where = f"{file}:1"
        if is_log(arrays):
            arrays = columns_of_log(where, arrays, model)
        header = list(arrays)
        at, second = find_time(where, header, plain=plain)
        found = []
        for middle in ("_command", ""):
            for joint in (model.coordinates[i] for i in model.i_g):
                name = f"{joint.name}{middle}"
                found.append(find_column(where, header, name, joint.unit, plain=plain))
        clock = np.ma.asanyarray(arrays[header[at]]) * second
        if len(clock) > MOST:
            raise ArgumentError(f"{file}: given more than {MOST} rows, expected fewer")
        times = []
        values = []
        for column in (at, *(column for column, _ in found)):
            _check_finite(file, header[column], arrays[header[column]])
        for column, factor in found:
            x = np.ma.asanyarray(arrays[header[column]]) * factor
            kept = ~(np.ma.getmaskarray(x) | np.ma.getmaskarray(clock))
            if kept.sum() < FEWEST:
                raise ArgumentError(
                    f"{file}: given {kept.sum()} rows, expected {FEWEST} or more of "
                    f"{header[column]}"
                )
            t, own = drop_repeats(np.asarray(clock[kept]), np.asarray(x[kept]))
            times.append(t)
            values.append(own)
        return cls._of_channels(file, times, values)

    @classmethod
    def _of_channels(
        cls, file: Path, times: list[np.ndarray], values: list[np.ndarray]
    ) -> ServoRecord:
        """Commands, then angles, at the equal steps of the commands, up to the first gap."""
        n = len(values) // 2
        alike = [x for t, x in zip(times[:n], values[:n], strict=True) if len(t) == len(times[0])]
        commands = read_clock(str(file), times[0], np.stack(alike, axis=1))
        if commands.note.startswith("steps"):
            raise ArgumentError(
                f"{file}: given commands at unequal {commands.note}, expected the equal steps of "
                "an interface, stamped with jitter at most"
            )
        smooth = [True] * len(values)
        found = resample(str(file), times, values, smooth, instants=True)
        first = found.pieces[0]
        notes = list(found.notes)
        if len(found.pieces) > 1:
            notes.append(f"used: the record up to {first.time[-1]:.6g} s, before its first gap")
        time = first.time
        data = first.values
        return cls(time, data[:, :n], data[:, n:], str(file), tuple(notes))


def _check_finite(file: Path, name: str, x: np.ndarray) -> None:
    bad = np.flatnonzero(~np.isfinite(np.ma.asanyarray(x).filled(0.0)))
    if len(bad):
        given = "nan" if np.isnan(x[bad[0]]) else "inf"
        raise ArgumentError(
            f"{file}:{bad[0] + 2}: {name}: given {given!r}, expected a finite number"
        )
