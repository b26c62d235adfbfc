"""Motor angles and torques of one record, for `identify_load` and `identify_gears`.

From a trajectory, a table of a logger, or a described recording: in SI units, in the order of the
motors, at equal steps, and of a record with gaps the longest piece.

Columns of a table: the time (``time``, ``t`` or ``timestamp``), of each motor an angle and a
torque, ``q_m[m1] rad`` and ``tau_m[m1] N m``, or the names of joints and motors alone: ``q1 deg``
is the joint, on the arm side of its gear, ``m1 A (0.12 N m/A)`` the torque of the motor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.files.record_columns import ALIKE, Column, column_of, find_time
from flexgen.base.files.record_tables import read_arrays
from flexgen.base.files.trajectory_files import LARGEST
from flexgen.base.motion.trajectory import Trajectory, channel_values
from flexgen.base.numerics.sampling import Gap, drop_repeats, resample
from flexgen.base.spec.ports import Port
from flexgen.base.spec.tables import open_file
from flexgen.identification.records.description import check_skipped, read_description
from flexgen.model.elements import RobotModel

CHANNELS = {"q_m": "rad", "tau_m": "N m"}
TABLES = (".csv", ".mat")
FEWEST = 2  # samples of a channel


@dataclass(frozen=True, eq=False)
class MotorRecord:
    """Motor angles ``q_m`` [rad] and torques ``tau_m`` [N m], motor side, at equal steps.

    ``trajectory``: these channels, in the order of the motors; ``notes``: what was done to the
    record, as sentences.
    """

    trajectory: Trajectory
    notes: tuple[str, ...] = ()


def read_motor_record(
    robot: RobotModel,
    record: Trajectory | str | Path,
    columns: Sequence[str] | None = None,
) -> MotorRecord:
    """The record of the motors of a robot.

    Parameters
    ----------
    robot : RobotModel
    record : Trajectory, or the name of a file
        ``.npz`` or ``.csv`` of a trajectory, ``.csv`` or ``.mat`` of a logger, ``.toml`` that
        describes a recording.
    columns : sequence of str, optional
        Names of the columns of a CSV file, in place of those that it has or lacks. Those without
        unit are in SI units.

    Raises
    ------
    ArgumentError
        A column is missing, has an unknown label or unit, or one of another kind; the times cannot
        be used.
    """
    if columns is not None and Path(str(record)).suffix != ".csv":
        shown = repr(str(record)) if isinstance(record, str | Path) else "a trajectory"
        raise ArgumentError(f"columns: given with {shown}, expected a .csv file of a logger")
    if isinstance(record, Trajectory):
        return _of_trajectory(robot, record, "record")
    path = Path(record)
    if path.suffix == ".toml":
        return _of_description(robot, path)
    if path.suffix not in TABLES or not path.is_file() or (columns is None and _is_whole(path)):
        return _of_trajectory(robot, Trajectory.load(path), str(path))
    return _of_table(robot, path, columns)


def _is_whole(path: Path) -> bool:
    """Whether a file is a trajectory with its meta data and the number of its rows."""
    with open_file(path, "rb") as stream:
        return path.suffix == ".csv" and stream.read(4).removeprefix(b"\xef\xbb\xbf")[:1] == b"#"


def _of_trajectory(robot: RobotModel, data: Trajectory, where: str) -> MotorRecord:
    labels = [motor.name for motor in robot.motors]
    units = {name: dict.fromkeys(labels, unit) for name, unit in CHANNELS.items()}
    parts = [channel_values(where, data, name, units[name]) for name in CHANNELS]
    times = [data.time] * (2 * len(labels))
    return _at_equal_steps(robot, where, times, list(np.hstack(parts).T))


def _of_description(robot: RobotModel, path: Path) -> MotorRecord:
    found = read_description(path)
    names, own = ([motor.name for motor in x.motors] for x in (robot, found.model))
    if sorted(names) != sorted(own):
        raise ArgumentError(
            f"{path}: given a model with the motors {', '.join(own)}, expected {', '.join(names)}"
        )
    files = {recording.file for _, recording in found.recordings}
    if len(files) > 1:
        raise ArgumentError(f"{path}: given {len(files)} recordings, expected one")
    recording = max((one for _, one in found.recordings), key=lambda one: len(one.t))
    notes = list(found.notes)
    if len(found.recordings) > 1:
        notes.append(_note_of_span(recording.t))
    order = [own.index(name) for name in names]
    values = recording.q_m[:, order], recording.tau_m[:, order]
    return MotorRecord(_trajectory(robot, recording.t, *values), tuple(notes))


def _of_table(robot: RobotModel, path: Path, columns: Sequence[str] | None) -> MotorRecord:
    where = str(path)
    plain = columns is not None
    arrays = read_arrays(path, LARGEST, columns)
    header = list(arrays)
    at, factor = find_time(where, header, plain=plain)
    clock = _numbers(where, header[at], arrays[header[at]]) * factor
    places = _places(robot, where, [column_of(text) for text in header], plain)
    times = []
    values = []
    for text, scale in places.values():
        x = _numbers(where, text, arrays[text]) * scale
        empty = np.ma.getmaskarray(x) | np.ma.getmaskarray(clock)
        if len(x) != len(clock) or (~empty).sum() < FEWEST:
            raise ArgumentError(
                f"{where}: column {text!r}: given {(~empty).sum()} numbers at {len(clock)} "
                f"instants, expected {FEWEST} or more"
            )
        times.append(np.asarray(clock[~empty]))
        values.append(np.asarray(x[~empty]))
    kinds = {name for name, _ in places}
    turns = robot.eta if "q" in kinds else None
    return _at_equal_steps(robot, where, times, values, turns)


def _numbers(where: str, name: str, x: Any) -> np.ma.MaskedArray[Any, Any]:
    """The numbers of a column, masked where cells are empty; they are finite."""
    values = np.ma.asanyarray(x)
    if values.size != max(values.shape, default=0) or not np.issubdtype(values.dtype, np.number):
        raise ArgumentError(
            f"{where}: column {name!r}: given shape {values.shape}, expected numbers (n,)"
        )
    values = values.ravel().astype(float)
    bad = np.flatnonzero(~np.isfinite(values.filled(0.0)))
    if len(bad):
        raise ArgumentError(f"{where}: column {name!r}: row {bad[0] + 1} is not a finite number")
    return values


def _places(
    robot: RobotModel, where: str, columns: Sequence[Column], plain: bool
) -> dict[tuple[str, str], tuple[str, float]]:
    """Name and factor of the column of each angle, of a motor or of a joint, then of each torque
    of a motor.

    ``plain``: columns without unit are in SI units.
    """
    motors = [motor.name for motor in robot.motors]
    joints = {robot.coordinates[i].name: robot.coordinates[i].unit for i in robot.i_g}
    wanted = {
        "q_m": dict.fromkeys(motors, "rad"),
        "tau_m": dict.fromkeys(motors, "N m"),
        "q": joints,
    }
    found: dict[tuple[str, str], Column] = {}
    for column in columns:
        key = _key(column, wanted)
        if key is None:
            continue
        if key[1] not in wanted[key[0]]:
            raise ArgumentError(
                f"{where}: column {column.text!r}: given the label {key[1]!r}, expected one of "
                f"{', '.join(wanted[key[0]])}"
            )
        if key in found:
            raise ArgumentError(
                f"{where}: given the columns {found[key].text!r} and {column.text!r}, expected "
                f"one of {key[0]}[{key[1]}]"
            )
        found[key] = column
    angles = "q" if any(name == "q" for name, _ in found) else "q_m"
    if angles == "q" and any(name == "q_m" for name, _ in found):
        raise ArgumentError(f"{where}: given angles of motors and of joints, expected one of both")
    out = {}
    for name in (angles, "tau_m"):
        for label, si in wanted[name].items():
            if (name, label) not in found:
                shown = ", ".join(column.text for column in columns[:ALIKE])
                raise ArgumentError(
                    f"{where}: given the columns {shown}, expected also {name}[{label}] {si}, or "
                    f"'{label} {si}'; name them by --columns NAME,NAME,..."
                )
            column = found[name, label]
            out[name, label] = column.text, column.factor(where, si, plain=plain)
    return out


def _key(column: Column, wanted: dict[str, dict[str, str]]) -> tuple[str, str] | None:
    """Quantity and label of a column; None: one that is not read."""
    if column.label is not None:
        return (column.name, column.label) if column.name in ("q_m", "tau_m") else None
    for name in ("tau_m", "q"):
        if column.name in wanted[name] or column.text in wanted[name]:
            return name, column.name
    return None


def _at_equal_steps(
    robot: RobotModel,
    where: str,
    times: Sequence[np.ndarray],
    values: Sequence[np.ndarray],
    turns: np.ndarray | None = None,
) -> MotorRecord:
    """Angles, then torques, at equal steps; ``turns``: gear ratios, of angles of joints."""
    n = len(values) // 2
    smooth = [True] * n + [False] * n
    kept = [drop_repeats(*pair) for pair in zip(times[:n], values[:n], strict=True)]
    times = [*(t for t, _ in kept), *times[n:]]
    values = [*(x for _, x in kept), *values[n:]]
    check_skipped(where, times[:n], values[:n])
    found = resample(where, times, values, smooth)
    piece = max(found.pieces, key=lambda one: len(one.time))
    notes = list(found.notes)
    if len(found.pieces) > 1:
        notes.append(_note_of_span(piece.time))
    angles = piece.values[:, :n]
    torques = piece.values[:, n:]
    if turns is not None:
        angles = angles @ turns.T
    return MotorRecord(_trajectory(robot, piece.time, angles, torques), tuple(notes))


def _note_of_span(time: np.ndarray) -> str:
    return f"used: {Gap(float(time[0]), float(time[-1]))}, the longest piece"


def _trajectory(
    robot: RobotModel, time: np.ndarray, q_m: np.ndarray, tau_m: np.ndarray
) -> Trajectory:
    labels = tuple(motor.name for motor in robot.motors)
    ports = {name: Port(name, (len(labels),), unit, "read") for name, unit in CHANNELS.items()}
    channels = {"q_m": q_m, "tau_m": tau_m}
    return Trajectory(time, channels, ports, dict.fromkeys(CHANNELS, labels))
