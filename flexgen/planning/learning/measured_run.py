"""Measurements of one run of a move: motor angles, positions of the tool, or both.

Columns of the file, with their units as for all records:

    time_s                        the clock of the record; its zero does not matter
    x_mm, y_mm, z_mm              position of the tool in the frame of the tracker; or tool_x_mm
    q_m[m1] rad                   angle of a motor, on its own side of the gear
    q1 deg                        the same as an angle of the joint, on the arm side of its gear

Other columns are ignored. Steps that are not equal are made equal, see
`flexgen.base.numerics.sampling`. Records with gaps, repeated samples and jumps are refused: a
correction would learn them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.files.record_columns import Column, column_of, find_time
from flexgen.base.files.record_tables import read_arrays
from flexgen.base.numerics.records import lost_samples
from flexgen.base.numerics.sampling import drop_repeats, resample
from flexgen.model.elements import RobotModel

SIZE_MAX = 500_000_000  # bytes of a file
FEWEST = 50  # samples of a record
AXES = "xyz"
# Largest change of an acceleration between two samples [m/s^2] without a jump: impacts
# cannot be corrected by the path.
SUDDEN = 20.0
# Third differences this many times the ordinary ones are those of a jump, and the percentile of
# the ordinary ones: a jump changes three of them.
OUTSTANDING = 6.0
ORDINARY = 97.0
DIGEST = 16  # characters of the digest of a record, which tell it from another


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """Measurements of one run at equal steps.

    ``time`` (n,) [s], own clock; ``axes``: of the tracker, such as ``"xyz"``, empty without one;
    ``position`` (n, len(axes)) [m] in its own frame; ``motors`` (n, n_m) [rad], or None;
    ``source``: name of the file; ``digest``: of its content; ``notes``: what was done to it.
    """

    time: np.ndarray
    axes: str
    position: np.ndarray
    motors: np.ndarray | None
    source: str
    digest: str
    notes: tuple[str, ...] = ()

    @property
    def step(self) -> float:
        """Time between two samples [s]."""
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)


def read_run(path: str | Path, model: RobotModel) -> MeasuredRun:
    """Read a record of one run; see the head of this module.

    Raises
    ------
    ArgumentError
        The file cannot be read; columns are missing, or their units not known; samples are
        missing, repeated or not finite, or the tracker jumps.
    """
    file = Path(path)
    if file.suffix not in (".csv", ".npz", ".mat") or not file.is_file():
        raise ArgumentError(
            f"{file}: cannot be read: expected a record of one run, .csv, .npz or .mat"
        )
    arrays = read_arrays(file, SIZE_MAX)
    header = list(arrays)
    at, second = find_time(f"{file}:1", header)
    columns = [column_of(text) for text in header]
    axes, positions = _position_columns(file, columns)
    motors = _motor_columns(file, columns, model)
    if not positions and not motors:
        raise ArgumentError(
            f"{file}:1: given the columns {', '.join(header)[:200]}, expected those of a tracker, "
            f"{_examples(model)}"
        )
    clock = np.ma.asanyarray(arrays[header[at]]) * second
    _check_finite(file, header[at], clock)
    times = []
    values = []
    for k, factor in [*positions, *motors]:
        x = np.ma.asanyarray(arrays[header[k]]) * factor
        _check_finite(file, header[k], x)
        kept = ~(np.ma.getmaskarray(x) | np.ma.getmaskarray(clock))
        if kept.sum() < FEWEST:
            raise ArgumentError(
                f"{file}: given {kept.sum()} samples of {header[k]!r}, expected {FEWEST} or more"
            )
        t, own = drop_repeats(np.asarray(clock[kept]), np.asarray(x[kept]))
        times.append(t)
        values.append(own)
    for (k, _), t, x in zip([*positions, *motors], times, values, strict=True):
        lost = lost_samples(x)
        if len(lost):
            raise ArgumentError(
                f"{file}: column {header[k]!r}: samples are missing at {t[lost[0]]:.6g} s of the "
                "record: one repeats the one before, and the next makes up for it; expected a "
                "record without lost samples"
            )
    found = resample(str(file), times, values, [True] * len(values))
    if found.gaps:
        raise ArgumentError(
            f"{file}: samples are missing, {found.gaps[0]}; expected a record of the whole run "
            "without gaps: measure the run again"
        )
    piece = found.pieces[0]
    position = piece.values[:, : len(axes)]
    if len(piece.time) < FEWEST:
        raise ArgumentError(f"{file}: given {len(piece.time)} samples, expected {FEWEST} or more")
    _check_jumps(file, piece.time, position)
    angles = piece.values[:, len(axes) :] if motors else None
    digest = hashlib.sha256(file.read_bytes()).hexdigest()[:DIGEST]
    return MeasuredRun(piece.time, axes, position, angles, file.name, digest, found.notes)


def _examples(model: RobotModel) -> str:
    """Names of columns for a message."""
    motor = model.motors[0].name
    return f"such as x_mm, y_mm, z_mm, or angles of all motors, such as 'q_m[{motor}] rad'"


def _position_columns(
    file: Path, columns: Sequence[Column]
) -> tuple[str, list[tuple[int, float]]]:
    """Axes of the tracker; index and factor to meters of its columns, in the order of the axes."""
    found: dict[str, list[int]] = {}
    for k, column in enumerate(columns):
        axis = column.name.lower().rpartition("_")[2]
        if column.label is None and axis in AXES and len(axis) == 1:
            found.setdefault(axis, []).append(k)
    for axis, places in found.items():
        if len(places) > 1:
            names = " and ".join(repr(columns[k].text.strip()) for k in places[:2])
            raise ArgumentError(
                f"{file}:1: given {names}, expected one position {axis} of the tool: leave the "
                "others out"
            )
    axes = "".join(axis for axis in AXES if axis in found)
    if len(axes) == 1:
        raise ArgumentError(
            f"{file}:1: given the position {axes} alone, expected two or three axes of the tracker"
        )
    return axes, [(found[a][0], columns[found[a][0]].factor(f"{file}:1", "m")) for a in axes]


def _motor_columns(
    file: Path, columns: Sequence[Column], model: RobotModel
) -> list[tuple[int, float]]:
    """Index of the column of each motor, and factor to its angle [rad]; empty: none is there."""
    motors = {motor.name: j for j, motor in enumerate(model.motors)}
    places: dict[int, tuple[int, float]] = {}
    for k, column in enumerate(columns):
        if column.name == "q_m" and column.label is not None:
            if column.label not in motors:
                raise ArgumentError(
                    f"{file}:1: column {column.text.strip()!r}: given the motor {column.label!r}, "
                    f"expected one of {', '.join(motors)}"
                )
            places[motors[column.label]] = k, column.factor(f"{file}:1", "rad")
    for k, column in enumerate(columns):
        if column.label is None and (j := _motor_of_joint(column.name, model)) is not None:
            joint = model.i_g.index(_coordinate(column.name, model))
            si = model.coordinates[model.i_g[joint]].unit
            ratio = float(model.eta[j, joint])
            places.setdefault(j, (k, ratio * column.factor(f"{file}:1", si)))
    if places and len(places) < model.n_m:
        missing = next(name for name, j in motors.items() if j not in places)
        raise ArgumentError(
            f"{file}:1: given angles of some motors, expected those of all: "
            f"'q_m[{missing}] rad' is missing"
        )
    return [places[j] for j in range(model.n_m)] if places else []


def _coordinate(name: str, model: RobotModel) -> int:
    """Index of the arm coordinate of a name; -1: there is none."""
    names = [coordinate.name for coordinate in model.coordinates]
    return names.index(name) if name in names else -1


def _motor_of_joint(name: str, model: RobotModel) -> int | None:
    """Index of the motor that alone turns a joint; None: no joint, or one of a coupled gear."""
    at = _coordinate(name, model)
    if at not in model.i_g:
        return None
    column = model.i_g.index(at)
    turned = np.flatnonzero(model.eta[:, column])
    if len(turned) != 1 or np.count_nonzero(model.eta[turned[0]]) != 1:
        return None
    return int(turned[0])


def _check_finite(file: Path, name: str, x: np.ndarray) -> None:
    """ArgumentError with the line where a column has NaN or infinity."""
    bad = np.flatnonzero(~np.isfinite(np.ma.asanyarray(x).filled(0.0)))
    if len(bad):
        raise ArgumentError(
            f"{file}:{bad[0] + 2}: column {name!r}: given a value that is not finite, expected "
            "numbers; leave the cell empty where nothing was measured"
        )


def _check_jumps(file: Path, time: np.ndarray, position: np.ndarray) -> None:
    """ArgumentError where the position of a tracker jumps.

    A jump J changes third differences by up to 2 J, a change of the acceleration by a: by a h^2.
    """
    if not position.size:
        return
    step = float(time[1] - time[0])
    bends = np.linalg.norm(np.diff(position, n=3, axis=0), axis=1)
    most = OUTSTANDING * float(np.percentile(bends, ORDINARY)) + 2.0 * SUDDEN * step**2
    at = int(np.argmax(bends))
    if bends[at] > most:
        size = 1e3 * bends[at] / 2.0
        raise ArgumentError(
            f"{file}: the tracker jumps by about {size:.2g} mm at {time[at + 1]:.6g} s of the "
            "record, expected a steady target: it was lost or reflected; measure the run again"
        )


@dataclass(frozen=True)
class SharedAxes:
    """Columns of the ``tracker`` and rows of the ``output`` that are the same axes of the tool;
    ``axes``: all of the tracker.
    """

    axes: str
    tracker: list[int]
    output: list[int]


def axes_in_output(axes: str, model: RobotModel) -> SharedAxes:
    """The axes of a tracker that the output has.

    Raises
    ------
    ArgumentError
        The output has no positions of the tool, or the tracker lacks one of its axes.
    """
    rows = AXES if model.output.type == "tool_pose" else model.output.axes
    if model.output.type == "combination" or not rows:
        raise ArgumentError(
            f"measured: given positions of the tool, expected angles of the motors: the output of "
            f"model {model.name} has no position of the tool"
        )
    missing = [axis for axis in rows if axis not in axes]
    if missing:
        raise ArgumentError(
            f"measured: given the axes {', '.join(axes)} of a tracker, expected also "
            f"{missing[0]}, an axis of the output of model {model.name}"
        )
    return SharedAxes(axes, [axes.index(axis) for axis in rows], list(range(len(rows))))
