"""Reads tables of Denavit-Hartenberg parameters: CSV files with units in the header."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path

import numpy as np

from flexgen.base.errors import ArgumentError, FileError
from flexgen.base.spec.ports import identifier_problem
from flexgen.base.spec.tables import LARGEST, SMALLEST, closest
from flexgen.studies.templates.dh_columns import (
    COLUMNS,
    PREVIOUS,
    Column,
    column_name,
    find_unit,
    known_name,
    known_names,
)

CONVENTIONS = ("standard", "modified")
KINDS = {
    "rotation": ("r", "rot", "revolute", "rotational", "continuous"),
    "translation": ("p", "t", "trans", "prismatic", "linear"),
    "fixed": ("f", "fix", "constant"),
}
PLACES = ("tool", "payload")
REQUIRED = ("a", "alpha", "d")
CENTER = ("com_x", "com_y", "com_z")
MOMENTS = ("ixx", "iyy", "izz")
PRODUCTS = ("ixy", "iyz", "ixz")
# columns that the rows "tool" and "payload" use
USED = {"tool": (*REQUIRED, "theta"), "payload": ("mass", *CENTER, *MOMENTS, *PRODUCTS)}
BODY = USED["payload"]
LARGEST_FILE = 1_000_000  # bytes
MOST_JOINTS = 32
PHYSICAL = 1e-6  # of the largest moment: rounding of the moments of a datasheet


@dataclass(frozen=True)
class Cell:
    """A number of the table in SI units, and the text and unit that were given."""

    value: float
    text: str
    unit: str


@dataclass(frozen=True)
class Row:
    """A joint, a fixed part, the tool or the payload; ``cells`` by the name of the column."""

    line: int
    name: str
    kind: str
    cells: dict[str, Cell] = field(default_factory=dict)

    def __contains__(self, name: str) -> bool:
        return name in self.cells

    def get(self, name: str, default: float = 0.0) -> float:
        """The number in SI units, or the default."""
        return self.cells[name].value if name in self.cells else default

    @property
    def rotary(self) -> bool:
        """Whether it is a rotation."""
        return self.kind == "rotation"


@dataclass(frozen=True)
class DhTable:
    """A table of Denavit-Hartenberg parameters.

    ``convention``: "standard", ``Rz(theta) Tz(d) Tx(a) Rx(alpha)``, or "modified" (Craig),
    ``Rx(alpha) Tx(a) Rz(theta) Tz(d)``. ``rows``: joints and fixed parts from base to flange.
    """

    file: str
    convention: str
    rows: tuple[Row, ...]
    tool: Row | None = None
    payload: Row | None = None

    @property
    def joints(self) -> tuple[Row, ...]:
        """The rows that move."""
        return tuple(row for row in self.rows if row.kind != "fixed")


def read_dh(path: str | Path, convention: str | None = None) -> DhTable:
    """Read a table of Denavit-Hartenberg parameters.

    Parameters
    ----------
    path : path
        CSV file in UTF-8: commas, semicolons or tabs between cells; with semicolons or tabs also
        decimal commas.
    convention : str, optional
        "standard" or "modified"; not needed where the header has ``a_prev`` and ``alpha_prev``,
        which are modified.

    Returns
    -------
    DhTable

    Raises
    ------
    ArgumentError
        The file cannot be read; the convention is missing.
    FileError
        The table has an error; the message names file, line and column.
    """
    shown = str(path)
    if convention is not None and convention not in CONVENTIONS:
        raise ArgumentError(
            f"convention: given {convention!r}, expected {' or '.join(map(repr, CONVENTIONS))}"
        )
    reader = _Reader(shown, _text(Path(path), shown))
    rows = list(reader.rows())
    joints = tuple(row for row in rows if row.kind not in PLACES)
    table = DhTable(
        shown,
        reader.convention(convention, joints),
        joints,
        next((row for row in rows if row.kind == "tool"), None),
        next((row for row in rows if row.kind == "payload"), None),
    )
    reader.check_rows(table)
    return table


def _text(path: Path, shown: str) -> str:
    """The text of a file; ArgumentError where it cannot be read, FileError where it is too large
    or not UTF-8. ``shown``: its name in errors.
    """
    try:
        with path.open("rb") as stream:
            raw = stream.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ArgumentError(
            f"dh: given {shown!r}, which cannot be read ({reason}), expected a CSV file"
        ) from None
    if len(raw) > LARGEST_FILE:
        raise FileError(
            shown, 0, "file", f"more than {LARGEST_FILE} bytes", f"at most {LARGEST_FILE} bytes"
        )
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise FileError(
            shown, line, "file", f"the byte 0x{raw[error.start]:02x}", "text in UTF-8"
        ) from None


class _Reader:
    """The lines of one table."""

    def __init__(self, shown: str, text: str) -> None:
        """``shown``: name of the file in errors. The delimiter is the first of ``;``, tab and
        comma that the header has; empty lines and comments are left out.
        """
        self.shown = shown
        lines = [
            (number, line)
            for number, line in enumerate(text.splitlines(), start=1)
            if line.strip(" \t,;") and not line.lstrip().startswith("#")
        ]
        if not lines:
            raise FileError(shown, 0, "file", "no line", "a header and a line for each joint")
        header = lines[0][1]
        self.delimiter = next((mark for mark in (";", "\t") if mark in header), ",")
        self.lines = [(number, self._cells(number, line)) for number, line in lines]
        self.previous = False  # whether the header names a and alpha of the frame before
        self.columns = list(self._header())

    def fail(self, line: int, column: str, given: str, expected: str) -> FileError:
        """The error to raise."""
        return FileError(self.shown, line, column, given, expected)

    def _cells(self, number: int, line: str) -> list[str]:
        """The cells of a line; FileError at its ``number`` where it is not CSV."""
        try:
            return next(csv.reader(io.StringIO(line), delimiter=self.delimiter))
        except csv.Error as error:
            raise self.fail(
                number,
                "file",
                f"a line that is not CSV ({error})",
                "cells with commas between them",
            ) from None

    def _header(self) -> Iterator[tuple[str, str]]:
        """Name and unit of each column; a name is "" for an empty cell.

        Sets `previous` where a title names parameters of the frame before. FileError for an
        unknown, double or missing column.
        """
        line, cells = self.lines[0]
        seen: dict[tuple[str, str], str] = {}
        for cell in cells:
            text = cell.strip()
            if not text:
                yield "", ""
                continue
            found = re.fullmatch(r"([^\[(]*?)\s*(?:[\[(](.*)[\])])?", text)
            title, unit = (found[1], found[2] or "") if found else (text, "")
            name = known_name(title)
            if name is None:
                expected = f"{closest(column_name(title), known_names())}, then its unit: a [mm]"
                raise self.fail(line, title or text, "an unknown column", expected)
            self.previous |= column_name(title) in PREVIOUS
            if name in COLUMNS:
                unit = self._unit(line, title, COLUMNS[name], unit)
            if (name, unit) in seen:
                raise self.fail(
                    line, text, f"a second column {name}, after {seen[name, unit]!r}", "one"
                )
            seen[name, unit] = text
            yield name, unit
        for name in REQUIRED:
            if not any(known == name for known, _ in seen):
                unit = next(iter(COLUMNS[name].units))
                raise self.fail(line, name, "no column", f"a column such as {name} [{unit}]")

    def _unit(self, line: int, title: str, column: Column, given: str) -> str:
        """The unit of a column."""
        known = column.all_units()
        found = find_unit(given, known)
        if found is None:
            shown = f"the unit {given!r}" if given else "no unit"
            units = ", ".join(f"[{unit}]" if unit else "none" for unit in known)
            raise self.fail(line, title, shown, f"{column.text} in one of: {units}")
        return found

    def rows(self) -> Iterator[Row]:
        """The rows below the header."""
        names: dict[str, int] = {}
        count = 0
        for line, cells in self.lines[1:]:
            texts = [cell.strip() for cell in cells]
            if len(texts) > len(self.columns) and any(texts[len(self.columns) :]):
                expected = f"at most {len(self.columns)} cells, as the header has"
                if self.delimiter == ",":
                    expected += "; numbers with decimal commas need semicolons between cells"
                raise self.fail(line, "file", f"{len(texts)} cells", expected)
            row = self._row(line, texts, count)
            count += row.kind not in PLACES
            if row.name in names:
                raise self.fail(
                    line,
                    "name",
                    f"{row.name!r} again, after line {names[row.name]}",
                    "another name",
                )
            names[row.name] = line
            yield row

    def _row(self, line: int, texts: list[str], count: int) -> Row:
        """The row of a line from its cells ``texts``; ``count``: joints before it, for a name that
        the table lacks.

        A base, tool or payload has no joint: it may have numbers in its own columns only.
        """
        pairs = list(zip(self.columns, texts, strict=False))
        words = {name: text for (name, _), text in pairs if name in ("name", "type") and text}
        given = words.get("name", "")
        place = given.lower() if given.lower() in PLACES else ""
        kind = place or self._kind(line, words.get("type", ""))
        name = given or f"q{count + 1}"
        problem = None if place else identifier_problem(name)
        if problem is not None:
            raise self.fail(line, "name", repr(name), problem)
        cells: dict[str, Cell] = {}
        for (column, unit), text in pairs:
            if not column or column not in COLUMNS or text in ("", "-"):
                continue
            if place and column not in USED[place]:
                if _number(text) == 0.0:
                    continue
                used = ", ".join(USED[place])
                raise self.fail(line, column, text, f"nothing: the row {place!r} has {used} only")
            cell = self._cell(line, COLUMNS[column], unit, text, kind)
            if column in cells:
                expected = f"one of the columns {column}, that with the unit of a {kind}"
                raise self.fail(line, column, f"{text} [{unit}] too", expected)
            cells[column] = cell
        return Row(line, place or name, kind, cells)

    def _kind(self, line: int, text: str) -> str:
        """Rotation, translation or fixed, from a word of the column type; without one a
        rotation.
        """
        if not text:
            return "rotation"
        for kind, other in KINDS.items():
            if text.lower() in (kind, *other):
                return kind
        raise self.fail(line, "type", repr(text), "rotation, translation or fixed")

    def _cell(self, line: int, column: Column, unit: str, text: str, kind: str) -> Cell:
        """A number of the table in SI units, checked; ``kind``: rotation or translation, on which
        the units of a column depend. With another delimiter than the comma, a comma may be the
        decimal mark.
        """
        if self.delimiter != "," and re.fullmatch(r"[-+\d]*,\d+([eE][-+]?\d+)?", text, re.ASCII):
            text = text.replace(",", ".")
        units = column.units_of(kind)
        if unit not in units:
            expected = (
                f"a number in a column {column.name} in {', '.join(f'[{u}]' for u in units)}"
            )
            raise self.fail(line, column.name, f"{text} [{unit}] of a {kind}", expected)
        value = _number(text)
        if value is None:
            expected = "a number" + (
                ": the constant part of the angle, 0 where it is the joint angle alone"
                if column.name == "theta"
                else ""
            )
            raise self.fail(line, column.name, repr(text), expected)
        value = scale(text, units[unit])
        problem = _problem(column, value)
        if problem:
            raise self.fail(line, column.name, f"{text} {unit}".strip(), problem)
        return Cell(value, text, unit)

    def convention(self, given: str | None, joints: tuple[Row, ...]) -> str:
        """The convention of the table, of the option or of the header."""
        line = self.lines[0][0]
        if self.previous and given == "standard":
            expected = "a and alpha for the convention 'standard', or the convention 'modified'"
            raise self.fail(line, "a_prev, alpha_prev", "parameters of the frame before", expected)
        if self.previous or given is not None:
            return given or "modified"
        likely = likely_convention(joints)
        looks = f"; this table looks {likely}" if likely else ""
        raise ArgumentError(
            "convention: given nothing, expected 'standard' (a and alpha lead to the next axis: "
            "Rz(theta) Tz(d) Tx(a) Rx(alpha)) or 'modified' (Craig; a and alpha come before the "
            f"axis: Rx(alpha) Tx(a) Rz(theta) Tz(d)){looks}; on the command line --convention"
        )

    def check_rows(self, table: DhTable) -> None:
        """Check whole rows and the whole table."""
        for row in table.rows:
            for name in REQUIRED:
                if name not in row:
                    raise self.fail(row.line, name, "nothing", "a number, 0 where there is none")
            if abs(row.get("direction", 1.0)) != 1.0:
                raise self.fail(row.line, "direction", row.cells["direction"].text, "1 or -1")
            if row.kind == "fixed":
                self._check_fixed(row)
            self._check_joint(row)
        for row in (*table.rows, *([table.payload] if table.payload else [])):
            self._check_body(row)
        number = len(table.joints)
        if not 1 <= number <= MOST_JOINTS:
            raise self.fail(0, "file", f"{number} joints", f"1 to {MOST_JOINTS} lines with joints")

    def _check_fixed(self, row: Row) -> None:
        allowed = (*REQUIRED, "theta", *BODY)
        other = next((name for name in row.cells if name not in allowed), None)
        if other is not None:
            raise self.fail(row.line, other, row.cells[other].text, "nothing: the row is fixed")

    def _check_joint(self, row: Row) -> None:
        """FileError where numbers of one joint contradict each other: limits, home, ratio and
        lead, damping and friction.
        """
        if "lower" in row and "upper" in row and not row.get("lower") < row.get("upper"):
            low = row.cells["lower"].text
            raise self.fail(
                row.line, "upper", row.cells["upper"].text, f"more than lower, which is {low}"
            )
        home = row.cells.get("home")
        if home is not None and not (
            row.get("lower", -math.inf) <= home.value <= row.get("upper", math.inf)
        ):
            raise self.fail(row.line, "home", home.text, "a number between lower and upper")
        if "lead" in row and row.kind != "translation":
            raise self.fail(row.line, "lead", row.cells["lead"].text, "a ratio: it is a rotation")
        for one, other in (("ratio", "lead"), ("gear_damping", "damping_ratio")):
            if one in row and other in row:
                raise self.fail(
                    row.line, other, row.cells[other].text, f"nothing, because of {one}"
                )
        if "beta" in row and "coulomb" not in row:
            raise self.fail(
                row.line, "beta", row.cells["beta"].text, "a number in coulomb too, or nothing"
            )

    def _check_body(self, row: Row) -> None:
        """Center and inertia of one body: complete or missing, and physical."""
        for names in (CENTER, MOMENTS):
            missing = [name for name in names if name not in row]
            if missing and len(missing) < len(names):
                expected = f"a number: {', '.join(names)} belong together, 0 where there is none"
                raise self.fail(row.line, missing[0], "nothing", expected)
        given = [name for name in (*CENTER, *MOMENTS, *PRODUCTS) if name in row]
        if given and "mass" not in row:
            expected = "a mass, because the row has a center of mass or inertia"
            raise self.fail(row.line, "mass", "nothing", expected)
        if MOMENTS[0] not in row:
            stray = next((name for name in PRODUCTS if name in row), None)
            if stray:
                raise self.fail(row.line, MOMENTS[0], "nothing", f"a number, because of {stray}")
            return
        problem = _inertia_problem(inertia_of(row))
        if problem:
            raise self.fail(row.line, ", ".join(MOMENTS), problem[0], problem[1])


def _number(text: str) -> float | None:
    """A finite number in ASCII, or None."""
    if not re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,3})?", text, re.ASCII):
        return None
    value = float(text)
    return value if math.isfinite(value) else None


def scale(text: str, factor: float) -> float:
    """A number times the factor of its unit, rounded once: 93.4 mm are 0.0934 m."""
    return float(Decimal(text) * Decimal(repr(factor)))


def _problem(column: Column, value: float) -> str:
    """Numbers that the column allows, where it does not allow this one; else empty."""
    if value and not SMALLEST <= abs(value) <= LARGEST:
        return "a number of magnitude 1e-18 to 1e12 in SI units, or 0"
    if column.not_zero and value == 0.0:
        return "a number other than 0"
    if column.above is not None and not value > column.above:
        return "a number > 0"
    if column.least is not None and not value >= column.least:
        return "a number >= 0"
    return ""


def inertia_of(row: Row) -> np.ndarray:
    """The inertia (3, 3) of a row [kg m^2]."""
    xx, yy, zz = (row.get(name) for name in MOMENTS)
    xy, yz, xz = (row.get(name) for name in PRODUCTS)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _inertia_problem(inertia: np.ndarray) -> tuple[str, str] | None:
    """Given and expected, where no body has this inertia."""
    values = np.linalg.eigvalsh(inertia)
    slack = PHYSICAL * float(np.abs(values).max())
    shown = ", ".join(f"{value:.4g}" for value in values)
    if values[0] < -slack:
        return f"principal moments {shown} kg m^2", "none below 0 (signs of ixy, iyz, ixz)"
    if values[2] > values[0] + values[1] + slack:
        expected = "none that exceeds the sum of the other two: about the center of mass, one unit"
        return f"principal moments {shown} kg m^2", expected
    return None


def likely_convention(joints: tuple[Row, ...]) -> str:
    """The convention that the zeros of a table suggest; empty: they suggest none.

    A table of the convention "modified" begins with a and alpha 0, since frame 0 can be put on the
    first axis; one of the convention "standard" ends with them, since the last frame can be put on
    the last axis.
    """
    moving = [row for row in joints if row.kind != "fixed"]
    if len(moving) < 2:
        return ""
    zero = [not (row.get("a") or row.get("alpha")) for row in (moving[0], moving[-1])]
    if zero == [True, False]:
        return "modified"
    return "standard" if zero == [False, True] else ""
