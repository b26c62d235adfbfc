"""Files of path samples: read and check rows of tool poses, outputs or joint coordinates."""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any, NoReturn

import numpy as np

from flexgen.base.checks.counts import number_in
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.files.npz_files import NpzError, read_npz
from flexgen.base.spec.tables import closest, open_file
from flexgen.model.elements import OF_ROTATION, RobotModel
from flexgen.paths.geometry.jets import axis_angle, quaternion_product

ROWS_MAX = 200_000
SIZE_MAX = 200_000_000  # bytes
LINE_MAX = 20_000  # characters
LINES_MAX = 2 * ROWS_MAX  # including comments and empty lines
UNIT = 1e-3  # largest deviation of a quaternion's norm from 1
ROTATION_MAX = np.pi / 2  # rad from one sample to the next
LARGEST = 1e9
# Shortest step of t or u over the median of the steps: below it, the spline through both rows
# swings.
SHORTEST = 1e-4

POSITION = ("x", "y", "z")
QUATERNION = ("qw", "qx", "qy", "qz")
VECTOR = ("rx", "ry", "rz")
ANGLE = ("angle",)  # of an output with the rotation about one axis
# Rotations about the fixed x, y and z axes, in this order, as `rpy` in model files.
EULER = ("roll", "pitch", "yaw")
# Factors of the units that a column may state, to those of a path.
UNITS_OF_LENGTH = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
UNITS_OF_ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": np.pi / 180.0}
UNITS_OF_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_WITH_UNIT = re.compile(r"(?P<name>\w+?)(?:_|\s*\[\s*|\s+)(?P<unit>[a-z]+)\s*\]?\Z")
PACKED = {
    "p": POSITION,
    "quaternion": QUATERNION,
    "rotation_vector": VECTOR,
    "angle": ANGLE,
    "rpy": EULER,
    "t": ("t",),
    "u": ("u",),
}


@dataclass(frozen=True)
class Samples:
    """The samples of a file.

    ``space``: ``"tool"``, ``"output"`` or ``"joint"``; ``values`` (n, d): tool positions [m],
    outputs or actuated coordinates; ``quaternions`` (n, 4) (w, x, y, z) of the tool's orientation
    in the world, or None; ``knots`` (n): time [s] where ``timed``, else a parameter, or None.
    ``angles`` (n,) [rad]: of the tool about the axis of an output of type ``tool_position_angle``,
    or None. ``lines`` (n,): of the rows in the file, or None; ``names`` (d,): of the columns of
    ``values``.
    """

    space: str
    values: np.ndarray
    quaternions: np.ndarray | None
    knots: np.ndarray | None
    timed: bool
    angles: np.ndarray | None = None
    lines: np.ndarray | None = None
    names: tuple[str, ...] = ()

    def part(self, first: int, last: int) -> Samples:
        """The samples from one to another, both included."""
        chosen = slice(first, last + 1)
        arrays: dict[str, Any] = {
            name: None if getattr(self, name) is None else getattr(self, name)[chosen]
            for name in ("values", "quaternions", "knots", "angles", "lines")
        }
        return replace(self, **arrays)

    def line(self, k: int) -> str:
        """The line of a sample in its file, for a message; empty where it is not known."""
        return "" if self.lines is None else f" (line {self.lines[k]})"


class _File:
    """Columns of a file by name, with the line of each row for error messages."""

    def __init__(self, path: str, model: RobotModel) -> None:
        self.name = path
        self.joints = tuple(model.coordinates[i].name for i in model.i_g)
        self.outputs = tuple(f"y{k + 1}" for k in range(model.output.size))
        of_joint = {"rad": UNITS_OF_ANGLE, "m": UNITS_OF_LENGTH}
        self.units = {name: UNITS_OF_LENGTH for name in POSITION}
        self.units |= dict.fromkeys((*VECTOR, *EULER), UNITS_OF_ANGLE)
        self.units |= dict.fromkeys(self.outputs, of_joint.get(model.output.unit, {}))
        self.units |= {
            model.coordinates[i].name: of_joint[model.coordinates[i].unit] for i in model.i_g
        }
        if "t" not in self.joints:
            self.units["t"] = UNITS_OF_TIME
        file = FilePath(path)
        try:
            if not file.is_file():
                raise ArgumentError(
                    f"samples: given {path!r}, which is not a file, expected a .csv or .npz file"
                )
            if file.stat().st_size > SIZE_MAX:
                self.fail(0, "file", f"more than {SIZE_MAX} bytes", "a shorter file")
            self.columns, self.lines = (
                self._read_packed(file) if file.suffix == ".npz" else self._text(file)
            )
        except ArgumentError:
            raise
        except NpzError as error:
            self.fail(0, "file", error.given, error.expected)
        except (OSError, ValueError, csv.Error) as error:
            self.fail(0, "file", f"a file that cannot be read ({error})", "a .csv or .npz file")

    def fail(self, line: int, key: str, given: str, expected: str) -> NoReturn:
        raise ModelError(self.name, line, key, given, expected) from None

    def _rows(self, file: FilePath) -> Iterator[tuple[int, list[str]]]:
        """Number and cells of each line that is not empty, one at a time."""
        with open_file(file, encoding="utf-8-sig") as stream:
            for n in range(1, LINES_MAX + 2):
                try:
                    row = stream.readline(LINE_MAX + 1)
                except UnicodeDecodeError:
                    self.fail(
                        0,
                        "file",
                        "text that is not UTF-8",
                        "a .csv file with a header row, or a .npz file",
                    )
                if not row:
                    return
                if len(row) > LINE_MAX:
                    self.fail(n, "row", f"more than {LINE_MAX} characters", "a row of numbers")
                cells = row.split("#")[0].strip()
                if cells:
                    yield n, next(csv.reader([cells]))
        self.fail(
            LINES_MAX,
            "file",
            f"more than {LINES_MAX} lines",
            f"at most {ROWS_MAX} rows of numbers",
        )

    def _text(self, file: FilePath) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Columns by name in SI units, and the line of each row, of a CSV file whose first row has
        names and units; errors name the line and the column.
        """
        rows = self._rows(file)
        line, head = next(rows, (1, []))
        if not head:
            self.fail(1, "file", "an empty file", "a header row and rows of numbers")
        names = [name.strip().strip('"') for name in head]
        known = {*POSITION, *QUATERNION, *VECTOR, *EULER, *self.joints, *self.outputs, "t", "u"}
        most = len(known)
        units = [self._unit(line, name) for name in names]
        names = [name for name, _ in units]
        for k, name in enumerate(names[: most + 1]):
            if not name or name in names[:k]:
                self.fail(
                    line,
                    name or f"column {k + 1}",
                    "an empty or repeated column name",
                    "a different name for each column",
                )
        if len(names) > most:
            self.fail(line, "file", f"{len(names)} columns", f"at most {most}")
        values = array("d")
        lines = array("q")
        for line, cells in rows:
            if len(lines) == ROWS_MAX:
                self.fail(line, "file", f"more than {ROWS_MAX} rows", f"at most {ROWS_MAX}")
            if len(cells) != len(names):
                self.fail(
                    line, "row", f"{len(cells)} values", f"{len(names)}, one for each column"
                )
            lines.append(line)
            values.extend(
                self._number(line, name, cell) for name, cell in zip(names, cells, strict=True)
            )
        table = np.array(values).reshape(len(lines), len(names))
        table *= [factor for _, factor in units]
        return dict(zip(names, table.T, strict=True)), np.array(lines, dtype=int)

    def _unit(self, line: int, label: str) -> tuple[str, float]:
        """The name of a column and the factor of its unit: ``x_mm``, ``q1_deg``, ``t [ms]``.

        The factor is 1 without a unit.
        """
        units = self.units
        found = _WITH_UNIT.match(label)
        if label in units or found is None or found["name"] not in units:
            return label, 1.0
        factors = units[found["name"]]
        if found["unit"] not in factors:
            self.fail(
                line, label, f'the unit "{found["unit"]}"', f"one of {', '.join(factors)}, or none"
            )
        return found["name"], factors[found["unit"]]

    def _number(self, line: int, name: str, cell: str) -> float:
        """The number of a cell; the error for another text, or a larger size than `LARGEST`, has
        line and column ``name``.
        """
        try:
            number = number_in(cell)
        except ValueError:
            number = np.nan
        if not abs(number) <= LARGEST:
            self.fail(
                line, name, f'"{cell.strip()[:40]}"', f"a number of size at most {LARGEST:g}"
            )
        return number

    def _read_packed(self, file: FilePath) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Columns by name, and the number of each row, of the arrays of an .npz file, which are in
        SI units.
        """
        known = PACKED | {"q_g": self.joints, "y": self.outputs}
        out: dict[str, np.ndarray] = {}

        def check(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
            """Refuse an array by its header, before it is read: name, type of numbers, shape."""
            if name not in known:
                self.fail(0, name[:80], "an unknown array", closest(name[:80], known))
            if dtype.kind not in "fiu":
                self.fail(0, name, f"an array of {dtype}", "numbers")
            width = len(known[name])
            if not ((len(shape) == 1 and width == 1) or (len(shape) == 2 and shape[1] == width)):
                self.fail(0, name, f"an array of shape {shape}", f"shape (n, {width})")
            if shape[0] > ROWS_MAX:
                self.fail(0, name, f"{shape[0]} rows", f"at most {ROWS_MAX}")

        for name, values in read_npz(file, SIZE_MAX, check).items():
            columns = known[name]
            numbers = values.reshape(len(values), len(columns)).astype(float)
            if not (np.abs(numbers) <= LARGEST).all():
                bad = int(np.flatnonzero(~(np.abs(numbers) <= LARGEST).all(axis=1))[0])
                self.fail(
                    bad + 1,
                    name,
                    "a number that is not finite or too large",
                    f"numbers of size at most {LARGEST:g}",
                )
            out |= dict(zip(columns, numbers.T, strict=True))
        sizes = {len(column) for column in out.values()}
        if len(sizes) > 1:
            self.fail(
                0, "file", f"arrays of {sorted(sizes)} rows", "the same number of rows in each"
            )
        n = sizes.pop() if sizes else 0
        return out, np.arange(1, n + 1)

    def take(self, names: tuple[str, ...]) -> np.ndarray:
        """The columns (n, k), removed from the file; all of them must exist."""
        for name in names:
            if name not in self.columns:
                self.fail(1, name, "a file without this column", f"the columns {', '.join(names)}")
        return np.stack([self.columns.pop(name) for name in names], axis=1)


def read_samples(path: str, model: RobotModel, least: int) -> Samples:
    """Read a file of samples of a path.

    A ``.csv`` file has a header row of column names; a ``.npz`` file has the arrays in brackets.
    Optional: ``t`` (time [s], increasing) or ``u`` (an increasing parameter). Then either
    ``x, y, z`` [m, world axes] (``p``), or the names of the actuated coordinates [rad or m]
    (``q_g``), or ``y1, y2, ...`` (``y``), the outputs. With positions optionally the orientation
    as ``qw, qx, qy, qz`` (``quaternion``), ``rx, ry, rz`` [rad] (``rotation_vector``) or
    ``roll, pitch, yaw`` [rad] (``rpy``: about the fixed x, y and z axes, in this order), or
    ``angle`` [rad] of an output with it. A column of a ``.csv`` file may state its unit: ``x_mm``,
    ``q1_deg``, ``yaw_deg``, ``t [ms]``.

    Parameters
    ----------
    path : str
    model : RobotModel
    least : int
        Smallest allowed number of samples.

    Raises
    ------
    ModelError
        The file is wrong; the error names line and column.
    ArgumentError
        The file does not exist.
    """
    file = _File(path, model)
    n = len(file.lines)
    if n < least:
        file.fail(int(file.lines[-1]) if n else 1, "file", f"{n} samples", f"at least {least}")
    joints = file.joints
    outputs = file.outputs
    knots, timed = _knots(file, joints)
    q = None
    angles = None
    tool = model.output.type != "combination"
    both = [name for name in joints if name in outputs and name in file.columns]
    if both and not tool:
        file.fail(
            1,
            both[0],
            "a column that is a joint and an output",
            "another name of the joint in the model",
        )
    if _has_joints(file, tool):
        space = "joint"
        values = file.take(joints)
    elif any(name in file.columns for name in outputs):
        if tool:
            file.fail(
                1,
                outputs[0],
                "outputs",
                "tool positions x, y, z or joint coordinates, because the output is the tool",
            )
        space = "output"
        values = file.take(outputs)
    else:
        if not tool:
            expected = f"outputs {', '.join(outputs)} or joint coordinates {', '.join(joints)}"
            file.fail(1, "file", f"the columns {', '.join(file.columns) or 'none'}", expected)
        space = "tool"
        values = file.take(POSITION)
        q = _orientation(file)
        if q is not None and model.output.type == "tool_position":
            file.fail(1, "file", "an orientation", f"none, or {OF_ROTATION}")
        angles = _angles(file, model, q is not None)
    if file.columns:
        name = next(iter(file.columns))
        known = (*POSITION, *QUATERNION, *VECTOR, *EULER, *ANGLE, *joints, *outputs, "t", "u")
        file.fail(1, name, "an unknown column", closest(name, known))
    if knots is None and n > 1:
        same = np.abs(np.diff(values, axis=0)).max(axis=1) == 0
        same &= True if q is None else np.abs(np.diff(q, axis=0)).max(axis=1) == 0
        same &= True if angles is None else np.diff(angles) == 0
        if same.any():
            line = int(file.lines[int(np.flatnonzero(same)[0]) + 1])
            file.fail(
                line,
                "row",
                "the same values as in the row before",
                "different rows, or a column t or u",
            )
    names = {"joint": joints, "output": outputs, "tool": POSITION}[space]
    return Samples(space, values, q, knots, timed, angles, file.lines, names)


def _has_joints(file: _File, tool: bool) -> bool:
    """Whether the columns are joints: some, which are not those of a tool position of their names.

    The quill of a SCARA is often called z: then x, y, z without the other joints are the tool.
    """
    named = {name for name in file.joints if name in file.columns}
    if not named or named == set(file.joints):
        return bool(named)
    return not (tool and named <= set(POSITION) <= set(file.columns))


def _angles(file: _File, model: RobotModel, oriented: bool) -> np.ndarray | None:
    """The angles (n,) [rad] of a file of tool positions, or None if it has none."""
    if "angle" not in file.columns:
        return None
    if not model.output.has_angle:
        file.fail(1, "angle", "an angle", 'none, or an output of type "tool_position_angle"')
    if oriented:
        file.fail(1, "angle", "both an angle and an orientation", "only one of the two")
    return file.take(ANGLE)[:, 0]


def _knots(file: _File, joints: tuple[str, ...]) -> tuple[np.ndarray | None, bool]:
    """The parameter of the samples, times ``t`` [s] or ``u``, and whether it is the time; None
    without one. The file is refused where it does not increase, or has steps much shorter than the
    others. A joint of that name is not meant.
    """
    given = [name for name in ("t", "u") if name in file.columns and name not in joints]
    if len(given) == 2:
        file.fail(1, "u", "both t and u", "only one of the two")
    if not given:
        return None, False
    knots = file.take((given[0],))[:, 0]
    falling = np.flatnonzero(np.diff(knots) <= 0)
    if len(falling):
        i = int(falling[0]) + 1
        file.fail(
            int(file.lines[i]),
            given[0],
            f"{knots[i]:g} after {knots[i - 1]:g}",
            "increasing values",
        )
    steps = np.diff(knots)
    short = np.flatnonzero(steps < SHORTEST * np.median(steps)) if len(steps) else steps
    if len(short):
        i = int(short[0]) + 1
        file.fail(
            int(file.lines[i]),
            given[0],
            f"a step of {steps[i - 1]:.3g} from the row before, where the others are about "
            f"{np.median(steps):.3g}",
            f"steps of at least {SHORTEST:g} of the others: a spline through rows that are nearly "
            f"at the same {given[0]} swings without bound; remove one of the two rows",
        )
    return knots, given[0] == "t"


def _quaternions_of(angles: np.ndarray) -> np.ndarray:
    """Quaternions (n, 4) of rotations about the fixed x, y and z axes by angles (n, 3) [rad]."""
    half = angles[:, :, None] / 2
    turns = [
        np.concatenate([np.cos(half[:, k]), np.sin(half[:, k]) * np.eye(3)[k]], axis=1)[:, :, None]
        for k in range(3)
    ]
    x, y, z = turns
    return quaternion_product(z, quaternion_product(y, x))[:, :, 0]


def _orientation(file: _File) -> np.ndarray | None:
    """Unit quaternions (n, 4) with continuous sign from quaternions, rotation vectors or Euler
    angles of the file; None if it has no orientation. A rotation of more than 90 deg from row to
    row is refused.
    """
    if any(name in file.columns for name in QUATERNION):
        q = file.take(QUATERNION)
        norm = np.linalg.norm(q, axis=1)
        bad = np.flatnonzero(np.abs(norm - 1) > UNIT)
        if len(bad):
            line = int(file.lines[bad[0]])
            file.fail(
                line,
                "qw",
                f"a quaternion of length {norm[bad[0]]:.6g}",
                f"length 1 within {UNIT:g}",
            )
        q = q / norm[:, None]
    elif any(name in file.columns for name in VECTOR):
        q = np.zeros((len(file.lines), 4))
        for i, vector in enumerate(file.take(VECTOR)):
            axis, angle = axis_angle(vector)
            q[i] = np.cos(angle / 2), *(np.sin(angle / 2) * axis)
    elif any(name in file.columns for name in EULER):
        q = _quaternions_of(file.take(EULER))
    else:
        return None
    for i in range(1, len(q)):
        if q[i] @ q[i - 1] < 0:
            q[i] = -q[i]
        angle = 4 * np.arcsin(min(1.0, float(np.linalg.norm(q[i] - q[i - 1])) / 2))
        if angle > ROTATION_MAX:
            expected = "at most 90 deg from row to row"
            file.fail(
                int(file.lines[i]), "row", f"a rotation by {np.degrees(angle):.3g} deg", expected
            )
    return q
