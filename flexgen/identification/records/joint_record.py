"""Measured joints of a robot: angles, and torques of sensors on the link side of the gears.

Columns of a CSV file: the time, ``time_s`` or ``t ms``; of each joint ``JOINT_deg`` and
``JOINT_torque_Nm``, with its unit (`flexgen.base.spec.units`) behind ``_`` or a space. Other
columns are ignored. Logs of libfranka are read as they are
(`flexgen.identification.records.libfranka`). Rows with an empty cell are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.base.checks.bounds import Positive
from flexgen.base.checks.type_checks import checked_class
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError
from flexgen.base.files.atomic_files import atomic_file
from flexgen.base.files.record_columns import find_column, find_time
from flexgen.base.files.record_tables import read_arrays
from flexgen.base.motion.joint_motion import JointMotion
from flexgen.base.numerics.low_pass import LowPass
from flexgen.identification.records.libfranka import columns_of_log, is_log
from flexgen.model.elements import RobotModel
from flexgen.model.moves import Move

LIMIT_HZ = 25.0  # of the low pass of joint angles: above modes of payloads, below encoder noise
HIGHEST = 0.4  # limit of a low pass over the sample rate, at most
# Part of the period of the limit that a gap may have: a spline bridges it.
BRIDGED = 0.25
DEGREE = 5  # of the spline: its second derivative is that of a cubic
SIZE_MAX = 1_000_000_000  # bytes of a file
FEWEST = 100  # rows
MOST = 1_000_000


@checked_class
@dataclass(frozen=True, eq=False)
class JointRecord:
    """Record of joint angles and joint torques, in the order of the actuated coordinates.

    Parameters
    ----------
    time : array (n,) [s]
        Increasing; steps may be unequal.
    angle : array (n, n_g) [rad or m]
        Measured on the link side of the gears.
    torque : array (n, n_g) [N m or N]
        Of the gears on the links, measured on the link side.
    joints : tuple of str
        Names of the joints.
    source : str
        Where they come from.

    Examples
    --------
    >>> import numpy as np
    >>> time = 0.001 * np.arange(500)
    >>> angle = np.column_stack([0.1 * np.sin(3.0 * time), 0.0 * time])
    >>> record = flexgen.JointRecord(time, angle, np.zeros((500, 2)), ("q1", "q2"))
    >>> speed = record.motion(limit_hz=25.0).at(time)[1]
    >>> f"{speed[250, 0]:.3f} rad/s"
    '0.220 rad/s'
    """

    time: np.ndarray
    angle: np.ndarray
    torque: np.ndarray
    joints: tuple[str, ...]
    source: str = "record"

    __repr__ = short_repr

    def __post_init__(self) -> None:
        n = np.size(self.time)
        if np.ndim(self.time) != 1 or not FEWEST <= n <= MOST:
            raise ArgumentError(f"{self.source}: given {n} rows, expected {FEWEST} to {MOST}")
        shapes = [np.shape(x) for x in (self.angle, self.torque)]
        if shapes != [(n, len(self.joints))] * 2:
            raise ArgumentError(
                f"{self.source}: given angles {shapes[0]}, torques {shapes[1]}, expected "
                f"({n}, {len(self.joints)}) of both, a column for each joint"
            )
        if not all(np.isfinite(x).all() for x in (self.time, self.angle, self.torque)):
            raise ArgumentError(f"{self.source}: given NaN or infinity, expected finite numbers")
        late = np.flatnonzero(np.diff(self.time) <= 0.0)
        if len(late):
            raise ArgumentError(
                f"{self.source}: row {late[0] + 2}: given the time {self.time[late[0] + 1]:.6g} s "
                f"after {self.time[late[0]]:.6g} s, expected times that increase"
            )

    @classmethod
    def read(
        cls, path: str | Path, model: RobotModel, columns: Sequence[str] | None = None
    ) -> JointRecord:
        """Read a CSV file, see `flexgen.identification.records.joint_record`.

        Parameters
        ----------
        path : str or Path
        model : RobotModel
        columns : sequence of str, optional
            Names of the columns of a file without a header; those without unit are in SI units.

        Returns
        -------
        JointRecord

        Raises
        ------
        ArgumentError
            The file cannot be read, a column is missing, or its unit cannot be used.
        """
        file = Path(path)
        if file.suffix != ".csv" or not file.is_file():
            raise ArgumentError(f"record: given {str(path)!r}, expected a .csv file that exists")
        where = str(file)
        arrays = read_arrays(file, SIZE_MAX, columns)
        if is_log(arrays):
            arrays = columns_of_log(where, arrays, model)
        plain = columns is not None
        header = list(arrays)
        joints = [model.coordinates[i] for i in model.i_g]
        found = [find_time(where, header, plain=plain)]
        found += [find_column(where, header, c.name, c.unit, plain=plain) for c in joints]
        for c in joints:
            unit = "N m" if c.unit == "rad" else "N"
            found.append(find_column(where, header, f"{c.name}_torque", unit, plain=plain))
        values = np.ma.stack([np.ma.asanyarray(arrays[header[k]]) * x for k, x in found], axis=1)
        kept = ~np.ma.getmaskarray(values).any(axis=1)
        rows = np.asarray(values.data[kept], dtype=float)
        n = len(joints)
        names = tuple(c.name for c in joints)
        return cls(rows[:, 0], rows[:, 1 : n + 1], rows[:, n + 1 :], names, where)

    @cached_property
    def step(self) -> float:
        """The usual time between two rows [s]."""
        return float(np.median(np.diff(self.time)))

    def motion(self, limit_hz: Positive = LIMIT_HZ) -> JointMotion:
        """The joint angles through a low pass without phase, over the whole record at once.

        A window of the record is cut out of the result, never before the filter: a filter that
        ends at the edge of a window changes the motion there.

        Parameters
        ----------
        limit_hz : float [Hz]
            Where the amplitude is half.

        Returns
        -------
        JointMotion

        Raises
        ------
        ArgumentError
            The limit is too high for the sample rate, the record is shorter than the filter, or
            it has a gap that a spline cannot bridge.
        """
        if limit_hz > HIGHEST / self.step:
            raise ArgumentError(
                f"limit_hz: given {limit_hz:g}, expected at most {HIGHEST / self.step:.4g} Hz, "
                f"{HIGHEST:g} of the sample rate of {self.source}"
            )
        gaps = np.diff(self.time)
        widest = int(np.argmax(gaps))
        if gaps[widest] > max(BRIDGED / limit_hz, 1.5 * self.step):
            raise ArgumentError(
                f"{self.source}: given a gap of {gaps[widest]:.4g} s at {self.time[widest]:.6g} s,"
                f" expected at most {BRIDGED / limit_hz:.4g} s; cut the record there"
            )
        low_pass = LowPass(self.step, limit_hz)
        count = int((self.time[-1] - self.time[0]) / self.step + 0.01) + 1
        if count < 4 * low_pass.half:
            raise ArgumentError(
                f"{self.source}: given a record of {count * self.step:.3g} s, expected at least "
                f"{4 * low_pass.half * self.step:.3g} s for a low pass of {limit_hz:g} Hz"
            )
        time = self.time[0] + self.step * np.arange(count)
        through = make_interp_spline(self.time, self.angle, 3)
        smooth = low_pass.whole(through(np.minimum(time, self.time[-1])))
        spline = make_interp_spline(time, smooth, DEGREE)
        edge = low_pass.half * self.step
        return JointMotion(spline, float(time[0]), float(time[-1]), self.step, edge)

    def save_move(
        self, path: str | Path, *, limit_hz: Positive = LIMIT_HZ, name: str = "recorded"
    ) -> Move:
        """Write the filtered joint angles as samples of a path, and return the move along them.

        Parameters
        ----------
        path : str or Path
            The samples, ``.npz``.
        limit_hz : float [Hz]
            Of the low pass, see `motion`.
        name : str
            Of the move.

        Returns
        -------
        Move
            Of type ``sampled``; its time begins at zero, and it begins and ends at rest.

        Raises
        ------
        ArgumentError
            As `motion`; the file has another ending or cannot be written.
        """
        target = Path(path)
        if target.suffix != ".npz":
            raise ArgumentError(f"path: given {target.name!r}, expected a name that ends in .npz")
        motion = self.motion(limit_hz)
        time = np.arange(motion.begin, motion.end + 1e-9, self.step)
        with atomic_file(target) as stream:
            np.savez(stream, t=time - time[0], q_g=motion.spline(time))
        return Move(name, "sampled", (), 0.0, 0, file=str(target))
