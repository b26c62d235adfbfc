"""Files of path samples: read and check rows of tool poses, outputs or joint coordinates."""

from __future__ import annotations

import csv
import zipfile
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import NoReturn

import numpy as np

from flexgen.errors import ArgumentError, ModelError
from flexgen.model.checked_table import closest
from flexgen.model.elements import RobotModel
from flexgen.paths.jets import axis_angle

ROWS_MAX = 200_000
SIZE_MAX = 200_000_000  # bytes
UNIT = 1e-3  # largest deviation of a quaternion's norm from 1
ROTATION_MAX = np.pi / 2  # rad from one sample to the next
LARGEST = 1e9

POSITION = ("x", "y", "z")
QUATERNION = ("qw", "qx", "qy", "qz")
VECTOR = ("rx", "ry", "rz")
PACKED = {"p": POSITION, "quaternion": QUATERNION, "rotation_vector": VECTOR, "t": ("t",), "u": ("u",)}


@dataclass(frozen=True)
class Samples:
    """The samples of a file.

    ``space``: ``"tool"``, ``"output"`` or ``"joint"``; ``values`` (n, d): tool positions [m], outputs or actuated
    coordinates; ``quaternions`` (n, 4) (w, x, y, z) of the tool's orientation in the world, or None; ``knots`` (n):
    time [s] where ``timed``, else a parameter, or None.
    """

    space: str
    values: np.ndarray
    quaternions: np.ndarray | None
    knots: np.ndarray | None
    timed: bool


class _File:
    """Columns of a file by name, with the line of each row for error messages."""

    def __init__(self, path: str, model: RobotModel) -> None:
        self.name, self.model = path, model
        file = FilePath(path)
        try:
            if not file.is_file():
                raise ArgumentError(f"samples: given {path!r}, which is not a file, expected a .csv or .npz file")
            if file.stat().st_size > SIZE_MAX:
                self.fail(0, "file", f"more than {SIZE_MAX} bytes", "a shorter file")
            self.columns, self.lines = self._packed(file) if file.suffix == ".npz" else self._text(file)
        except (OSError, ValueError) as error:
            if isinstance(error, ArgumentError):
                raise
            self.fail(0, "file", f"a file that cannot be read ({error})", "a .csv or .npz file")

    def fail(self, line: int, key: str, given: str, expected: str) -> NoReturn:
        raise ModelError(self.name, line, key, given, expected) from None

    def _text(self, file: FilePath) -> tuple[dict[str, np.ndarray], np.ndarray]:
        try:
            text = file.read_text(encoding="utf-8-sig")
        except UnicodeDecodeError:
            self.fail(0, "file", "text that is not UTF-8", "a .csv file with a header row, or a .npz file")
        rows = [(n, row.split("#")[0]) for n, row in enumerate(text.splitlines(), 1)]
        rows = [(n, row) for n, row in rows if row.strip()]
        if not rows:
            self.fail(1, "file", "an empty file", "a header row and rows of numbers")
        line, head = rows[0]
        names = [name.strip().strip('"') for name in next(csv.reader([head]))]
        for k, name in enumerate(names):
            if not name or name in names[:k]:
                self.fail(
                    line,
                    name or f"column {k + 1}",
                    "an empty or repeated column name",
                    "a different name for each column",
                )
        if len(rows) - 1 > ROWS_MAX:
            self.fail(rows[ROWS_MAX + 1][0], "file", f"{len(rows) - 1} rows", f"at most {ROWS_MAX}")
        values = np.zeros((len(rows) - 1, len(names)))
        for i, (line, row) in enumerate(rows[1:]):
            cells = next(csv.reader([row]))
            if len(cells) != len(names):
                self.fail(line, "row", f"{len(cells)} values", f"{len(names)}, one for each column")
            for k, cell in enumerate(cells):
                values[i, k] = self._number(line, names[k], cell)
        return dict(zip(names, values.T, strict=True)), np.array([line for line, _ in rows[1:]], dtype=int)

    def _number(self, line: int, name: str, cell: str) -> float:
        try:
            number = float(cell)
        except ValueError:
            number = np.nan
        if not abs(number) <= LARGEST:
            self.fail(line, name, f'"{cell.strip()[:40]}"', f"a number of size at most {LARGEST:g}")
        return number

    def _packed(self, file: FilePath) -> tuple[dict[str, np.ndarray], np.ndarray]:
        model = self.model
        joints = tuple(model.coordinates[i].name for i in model.i_g)
        known = PACKED | {"q_g": joints, "y": tuple(f"y{k + 1}" for k in range(model.output.size))}
        out: dict[str, np.ndarray] = {}
        try:
            with np.load(file, allow_pickle=False) as data:
                arrays = {name: data[name] for name in data.files}
        except (zipfile.BadZipFile, EOFError, KeyError) as error:
            self.fail(0, "file", f"a file that is not .npz ({error})", "a file written by numpy.savez")
        for name, array in arrays.items():
            if name not in known:
                self.fail(0, name, "an unknown array", closest(name, known))
            if array.dtype.kind not in "fiu":
                self.fail(0, name, f"an array of {array.dtype}", "numbers")
            columns = known[name]
            if array.shape not in ([(len(array),)] if array.ndim == 1 and len(columns) == 1 else []) and (
                array.ndim != 2 or array.shape[1] != len(columns)
            ):
                self.fail(0, name, f"an array of shape {array.shape}", f"shape (n, {len(columns)})")
            array = array.reshape(len(array), -1).astype(float)
            if not (np.abs(array) <= LARGEST).all():
                bad = int(np.flatnonzero(~(np.abs(array) <= LARGEST).all(axis=1))[0])
                self.fail(
                    bad + 1, name, "a number that is not finite or too large", f"numbers of size at most {LARGEST:g}"
                )
            out |= dict(zip(columns, array.T, strict=True))
        sizes = {len(column) for column in out.values()}
        if len(sizes) > 1:
            self.fail(0, "file", f"arrays of {sorted(sizes)} rows", "the same number of rows in each")
        n = sizes.pop() if sizes else 0
        if n > ROWS_MAX:
            self.fail(0, "file", f"{n} rows", f"at most {ROWS_MAX}")
        return out, np.arange(1, n + 1)

    def take(self, names: tuple[str, ...]) -> np.ndarray:
        """The columns (n, k), removed from the file; all of them must exist."""
        for name in names:
            if name not in self.columns:
                self.fail(1, name, "a file without this column", f"the columns {', '.join(names)}")
        return np.stack([self.columns.pop(name) for name in names], axis=1)


def read_samples(path: str, model: RobotModel, least: int) -> Samples:
    """Read a file of samples of a path.

    A ``.csv`` file has a header row of column names; a ``.npz`` file has the arrays in brackets. Optional: ``t`` (time
    [s], increasing) or ``u`` (an increasing parameter). Then either ``x, y, z`` [m, world axes] (``p``), optionally the
    orientation as ``qw, qx, qy, qz`` (``quaternion``) or ``rx, ry, rz`` [rad] (``rotation_vector``), or the names of
    the actuated coordinates [rad or m] (``q_g``), or ``y1, y2, ...`` (``y``), the outputs.

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
    joints = tuple(model.coordinates[i].name for i in model.i_g)
    outputs = tuple(f"y{k + 1}" for k in range(model.output.size))
    knots, timed = _knots(file, joints)
    q = None
    tool = model.output.type in ("tool_position", "tool_pose")
    if any(name in file.columns for name in joints):
        space, values = "joint", file.take(joints)
    elif any(name in file.columns for name in outputs):
        if tool:
            file.fail(
                1, outputs[0], "outputs", "tool positions x, y, z or joint coordinates, because the output is the tool"
            )
        space, values = "output", file.take(outputs)
    else:
        if not tool:
            expected = f"outputs {', '.join(outputs)} or joint coordinates {', '.join(joints)}"
            file.fail(1, "file", f"the columns {', '.join(file.columns) or 'none'}", expected)
        space, values = "tool", file.take(POSITION)
        q = _orientation(file)
        if q is not None and model.output.type != "tool_pose":
            file.fail(1, "file", "an orientation", 'none, or an output of type "tool_pose"')
    if file.columns:
        name = next(iter(file.columns))
        known = (*POSITION, *QUATERNION, *VECTOR, *joints, *outputs, "t", "u")
        file.fail(1, name, "an unknown column", closest(name, known))
    if knots is None and n > 1:
        same = np.abs(np.diff(values, axis=0)).max(axis=1) == 0
        same &= True if q is None else np.abs(np.diff(q, axis=0)).max(axis=1) == 0
        if same.any():
            line = int(file.lines[int(np.flatnonzero(same)[0]) + 1])
            file.fail(line, "row", "the same values as in the row before", "different rows, or a column t or u")
    return Samples(space, values, q, knots, timed)


def _knots(file: _File, joints: tuple[str, ...]) -> tuple[np.ndarray | None, bool]:
    given = [name for name in ("t", "u") if name in file.columns and name not in joints]
    if len(given) == 2:
        file.fail(1, "u", "both t and u", "only one of the two")
    if not given:
        return None, False
    knots = file.take((given[0],))[:, 0]
    falling = np.flatnonzero(np.diff(knots) <= 0)
    if len(falling):
        i = int(falling[0]) + 1
        file.fail(int(file.lines[i]), given[0], f"{knots[i]:g} after {knots[i - 1]:g}", "increasing values")
    return knots, given[0] == "t"


def _orientation(file: _File) -> np.ndarray | None:
    """Unit quaternions with continuous sign, or None if the file has no orientation."""
    if any(name in file.columns for name in QUATERNION):
        q = file.take(QUATERNION)
        norm = np.linalg.norm(q, axis=1)
        bad = np.flatnonzero(np.abs(norm - 1) > UNIT)
        if len(bad):
            line = int(file.lines[bad[0]])
            file.fail(line, "qw", f"a quaternion of length {norm[bad[0]]:.6g}", f"length 1 within {UNIT:g}")
        q = q / norm[:, None]
    elif any(name in file.columns for name in VECTOR):
        q = np.zeros((len(file.lines), 4))
        for i, vector in enumerate(file.take(VECTOR)):
            axis, angle = axis_angle(vector)
            q[i] = np.cos(angle / 2), *(np.sin(angle / 2) * axis)
    else:
        return None
    for i in range(1, len(q)):
        if q[i] @ q[i - 1] < 0:
            q[i] = -q[i]
        angle = 4 * np.arcsin(min(1.0, float(np.linalg.norm(q[i] - q[i - 1])) / 2))
        if angle > ROTATION_MAX:
            expected = "at most 90 deg from row to row"
            file.fail(int(file.lines[i]), "row", f"a rotation by {np.degrees(angle):.3g} deg", expected)
    return q
