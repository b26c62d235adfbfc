"""A folder of records of one robot: which file is of which kind, read in SI units.

``records.toml`` in the folder has a table for each file, in the order in which they are used:

    [[record]]
    file = "circle.csv"
    kind = "tracked"          # motion, tracked, poses or responses
    columns = ["t", "q1 deg"] # of a CSV file without a header

Without it all files of the folder are read, and their columns show the kind: a time and positions
of a tracker are a tracked motion, a time alone is a motion, positions alone are poses; a
description with the period of an excitation is a set of responses.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from flexgen.base.errors import ArgumentError, FlexgenError
from flexgen.base.files.record_columns import TIMES, column_of, find_column, find_time
from flexgen.base.files.record_tables import read_arrays
from flexgen.base.files.trajectory_files import LARGEST
from flexgen.base.spec.sensors import Sensor
from flexgen.base.spec.tables import closest, open_file
from flexgen.identification.commissioning.motion_block import Motion
from flexgen.identification.experiments.experiment import Experiment
from flexgen.identification.poses.poses import StaticPoses
from flexgen.identification.records.description import read_description
from flexgen.identification.records.experiment_file import read_experiment
from flexgen.identification.records.motor_record import read_motor_record
from flexgen.identification.responses.frequency_response import Frf, frf
from flexgen.model.elements import RobotModel

DESCRIPTION = "records.toml"
KINDS = ("motion", "tracked", "poses", "responses")
SUFFIXES = (".csv", ".npz", ".mat", ".toml")
FRAMES = ("period_s", "segment_s")  # keys of a description of an excitation
OF_FRF = {"G", "UU", "w"}  # arrays of a file of `flexgen.frf`
OF_EXPERIMENT = {"lines", "amplitudes", "phases"}
AXES = "xyz"
LENGTHS = ("m", "cm", "mm", "um")  # units of positions
FEWEST = 10  # positions of a tracked motion
FEWEST_POSES = 8  # different ones: the frame and the place of a tracker alone are nine numbers


@dataclass(frozen=True)
class RecordFile:
    """A file of the folder, its kind, and the names of its columns where it has none."""

    path: Path
    kind: str
    columns: tuple[str, ...] | None = None


@dataclass(frozen=True, eq=False)
class Records:
    """Records of a folder, in SI units: motions with torques, some of them tracked; static poses;
    responses by level; ``notes``: what was done to the files.
    """

    motions: tuple[Motion, ...] = ()
    poses: tuple[tuple[str, StaticPoses], ...] = ()
    responses: tuple[tuple[str, Frf], ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def has_positions(self) -> bool:
        """Whether a tracker saw anything."""
        return bool(self.poses) or any(m.positions is not None for m in self.motions)

    @property
    def kinds(self) -> dict[str, list[str]]:
        """Kind -> names of the records."""
        out: dict[str, list[str]] = {kind: [] for kind in KINDS}
        for motion in self.motions:
            out["motion" if motion.positions is None else "tracked"].append(motion.name)
        out["poses"] = [name for name, _ in self.poses]
        out["responses"] = [name for name, _ in self.responses]
        return out


def list_records(folder: str | Path, robot: RobotModel) -> list[RecordFile]:
    """The files of a folder with their kinds; without files that have no column of the robot.

    Raises
    ------
    ArgumentError
        The folder does not exist, has no record, or its description is wrong.
    """
    place = Path(folder)
    if not place.is_dir():
        raise ArgumentError(
            f"records: given {str(place)!r}, expected a folder with records of the robot"
        )
    described = place / DESCRIPTION
    if described.is_file():
        return _read_description(described, robot)
    files = [p for p in sorted(place.iterdir()) if p.suffix in SUFFIXES and p.is_file()]
    files = [p for p in files if p.suffix != ".toml" or _is_description(p)]
    # files that a description names are read by it
    named = {name for p in files if p.suffix == ".toml" for name in _named_files(p)}
    kinds = {p: _kind_of(p, robot) for p in files if p.resolve() not in named}
    found = [RecordFile(p, kind) for p, kind in kinds.items() if kind]
    if not found:
        raise ArgumentError(
            f"{place}: given a folder without records of {robot.title}, expected "
            f"{', '.join(SUFFIXES)} files with its motors, joints or trackers, or a "
            f"{DESCRIPTION} that names them"
        )
    return found


def _toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file."""
    try:
        with open_file(path, "rb") as stream:
            return tomllib.load(stream)
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise ArgumentError(f"{path}: given a file that is not TOML: {error}") from None


def _read_description(path: Path, robot: RobotModel) -> list[RecordFile]:
    """The records of a description of a folder."""
    found = _toml(path)
    other = [key for key in found if key != "record"]
    if other:
        raise ArgumentError(f"{path}: given the key {other[0]!r}, expected only [[record]]")
    rows = found.get("record", [])
    if not isinstance(rows, list) or not rows:
        raise ArgumentError(f"{path}: given no [[record]], expected one for each file")
    out = []
    for number, row in enumerate(rows, 1):
        where = f"{path}: record {number}"
        known = ("file", "kind", "columns")
        for key in row:
            if key not in known:
                raise ArgumentError(
                    f"{where}: given the key {key!r}, expected {closest(key, known)}"
                )
        name = row.get("file")
        if not isinstance(name, str) or not (path.parent / name).is_file():
            raise ArgumentError(f"{where}: given file = {name!r}, expected a file of the folder")
        file = path.parent / name
        kind = row.get("kind", None)
        kind = (_kind_of(file, robot) or KINDS[0]) if kind is None else kind
        if kind not in KINDS:
            raise ArgumentError(
                f"{where}: given kind = {kind!r}, expected one of {', '.join(KINDS)}"
            )
        columns = row.get("columns")
        names = isinstance(columns, list) and all(isinstance(x, str) for x in columns)
        if columns is not None and not names:
            raise ArgumentError(f"{where}: given columns = {columns!r}, expected a list of names")
        out.append(RecordFile(file, kind, None if columns is None else tuple(columns)))
    return out


def _is_description(path: Path) -> bool:
    """Whether a TOML file describes recordings; a model file does not."""
    return "recording" in _toml(path)


def _named_files(path: Path) -> list[Path]:
    """Files that a description of recordings names."""
    out = []
    for row in _toml(path).get("recording", []):
        names = [row.get("file"), *row.get("files", [])] if isinstance(row, dict) else []
        out += [(path.parent / name).resolve() for name in names if isinstance(name, str)]
    return out


def _kind_of(path: Path, robot: RobotModel) -> str:
    """Kind of a file, by its columns; empty: it has no column of the robot."""
    if path.suffix == ".toml":
        return "responses" if any(key in _toml(path) for key in FRAMES) else "motion"
    names = list(read_arrays(path, LARGEST))
    if path.suffix == ".npz" and (set(names) >= OF_FRF or set(names) >= OF_EXPERIMENT):
        return "responses"
    columns = [column_of(name) for name in names]
    timed = any(c.name.lower() in TIMES for c in columns)
    own = {motor.name for motor in robot.motors}
    own |= {robot.coordinates[i].name for i in robot.i_g}
    of_robot = any(c.name in own or c.label in own or c.name in ("q_m", "tau_m") for c in columns)
    trackers = {s.name for s in robot.sensors if s.type == "tracker"}
    seen = any(f"{name}_x" in (c.name, c.text.strip()) for name in trackers for c in columns)
    if not of_robot:
        return ""
    if timed:
        return "tracked" if seen else "motion"
    return "poses"


def read_records(
    robot: RobotModel,
    files: Sequence[RecordFile],
    sensors: Sequence[Sensor],
    tell: Callable[[str], None],
) -> Records:
    """Read the files for a robot.

    Raises
    ------
    ArgumentError
        A file does not fit the robot; the error names it.
    """
    motions: list[Motion] = []
    poses: list[tuple[str, StaticPoses]] = []
    responses: list[tuple[str, Frf]] = []
    notes: list[str] = []
    for file in files:
        tell(f"reading {file.path.name}")
        name = file.path.name
        columns = None if file.columns is None else list(file.columns)
        try:
            if file.kind == "poses":
                _need_tracker(file, sensors)
                found_poses = StaticPoses.read(file.path, robot, columns)
                _check_count(file, found_poses)
                poses.append((name, found_poses))
            elif file.kind == "responses":
                responses.append((name, _responses(file.path)))
            else:
                found, done = _motions(robot, file, sensors, columns)
                motions += found
                if columns is None and file.path.suffix != ".toml":
                    notes += _unknown_trackers(file.path, sensors)
                notes += [f"{name}: {note}" for note in done]
        except FlexgenError as error:
            text = str(error)
            known = str(file.path) in text or name in text
            raise ArgumentError(text if known else f"{file.path}: {text}") from None
    return Records(tuple(motions), tuple(poses), tuple(responses), tuple(notes))


def _need_tracker(file: RecordFile, sensors: Sequence[Sensor]) -> None:
    if not sensors:
        raise ArgumentError(
            f'{file.path}: given positions, expected a [[sensor]] with type = "tracker" in the '
            "model file for each point that is measured"
        )


def _check_count(file: RecordFile, poses: StaticPoses) -> None:
    """ArgumentError where so few poses say nothing about the robot."""
    different = len(np.unique(np.round(poses.commands, 4), axis=0))
    if different < FEWEST_POSES:
        raise ArgumentError(
            f"{file.path}: given {different} different poses, expected {FEWEST_POSES} or more, "
            "over the whole range of all joints: the frame of the tracker is found from them too"
        )


def _unknown_trackers(path: Path, sensors: Sequence[Sensor]) -> list[str]:
    """Note on columns x, y and z of positions that belong to no tracker of the model; a controller
    may log such columns of its own.
    """
    columns = [column_of(name) for name in read_arrays(path, LARGEST)]
    names = {column.name for column in columns if column.unit in LENGTHS}
    found = {name[:-2] for name in names if name.endswith("_x")}
    found = {name for name in found if {f"{name}_y", f"{name}_z"} <= names}
    unknown = sorted(found - {sensor.name for sensor in sensors})
    if not unknown:
        return []
    known = ", ".join(sensor.name for sensor in sensors) or "none"
    return [
        f"{path.name}: not read: {', '.join(f'{name}_x' for name in unknown)}, and y and z: no "
        f"tracker of the model has this name ({known})"
    ]


def _responses(path: Path) -> Frf:
    """Responses of a file of `flexgen.frf`, of `flexgen.measure`, or of described recordings."""
    if path.suffix == ".toml":
        return frf(read_experiment(path))
    arrays = read_arrays(path, LARGEST)
    return Frf.load(path) if "G" in arrays else frf(Experiment.load(path))


def _motions(
    robot: RobotModel, file: RecordFile, sensors: Sequence[Sensor], columns: list[str] | None
) -> tuple[list[Motion], tuple[str, ...]]:
    """The motions of a file, and what was done to it."""
    name = file.path.name
    if file.path.suffix == ".toml":
        found = read_description(file.path)
        single = len(found.recordings) == 1
        if not single:
            parts = [
                read_motor_record(robot, _trajectory_of(robot, recording))
                for _, recording in found.recordings
            ]
            return [
                Motion(f"{name} {k}", part.trajectory) for k, part in enumerate(parts, 1)
            ], found.notes
    record = read_motor_record(robot, file.path, columns)
    positions = None
    if file.kind == "tracked":
        _need_tracker(file, sensors)
        positions = _positions(file, sensors, record.trajectory.time, columns)
    return [Motion(name, record.trajectory, positions)], record.notes


def _trajectory_of(robot: RobotModel, recording: Any) -> Any:
    """A recording of a description as a trajectory of its motors."""
    from flexgen.base.motion.trajectory import Trajectory
    from flexgen.base.spec.ports import Port

    labels = tuple(motor.name for motor in robot.motors)
    channels = {"q_m": recording.q_m, "tau_m": recording.tau_m}
    units = {"q_m": "rad", "tau_m": "N m"}
    ports = {key: Port(key, (len(labels),), units[key], "read") for key in channels}
    return Trajectory(recording.t, channels, ports, dict.fromkeys(channels, labels))


def _positions(
    file: RecordFile, sensors: Sequence[Sensor], time: np.ndarray, columns: list[str] | None
) -> np.ndarray:
    """Positions (n, 3 k) [m] of the trackers at the instants of the record; nan: not seen."""
    where = str(file.path)
    arrays = read_arrays(file.path, LARGEST, columns)
    header = list(arrays)
    plain = columns is not None
    at, factor = find_time(where, header, plain=plain)
    clock = np.asarray(np.ma.filled(arrays[header[at]], np.nan), float).ravel() * factor
    out = []
    for sensor in sensors:
        for axis in AXES:
            k, unit = find_column(where, header, f"{sensor.name}_{axis}", "m", plain=plain)
            values = np.ma.filled(np.ma.asanyarray(arrays[header[k]]).astype(float), np.nan)
            values = np.ravel(values) * unit
            seen = np.isfinite(values) & np.isfinite(clock)
            if seen.sum() < FEWEST:
                raise ArgumentError(
                    f"{where}: column {header[k].strip()!r}: given {seen.sum()} numbers, "
                    f"expected at least {FEWEST}"
                )
            inside = np.clip(time, clock[seen][0], clock[seen][-1])
            found = CubicSpline(clock[seen], values[seen])(inside)
            # between two instants that were seen with a gap the tracker saw nothing
            step = np.median(np.diff(clock[seen]))
            after = np.searchsorted(clock[seen], time).clip(1, seen.sum() - 1)
            wide = clock[seen][after] - clock[seen][after - 1] > 2.5 * step
            out.append(np.where(wide | (inside != time), np.nan, found))
    return np.column_stack(out)
