"""Checked access to the tables of a model file: each value is read with its required type and
range.
"""

from __future__ import annotations

import codecs
import difflib
import errno
import math
import os
import re
import stat
import unicodedata
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from flexgen.base.errors import ArgumentError, FileError, ModelError
from flexgen.base.spec.ports import identifier_problem
from flexgen.base.spec.toml_lines import WIDTH, Entry, TextError, leaves, parse, unwrap

IDENTIFIER = "^(?!.*__)[A-Za-z][A-Za-z0-9_]{0,30}$"  # as identifier_problem
UNITS = ("_rad", "_deg")
# range of numbers in SI units; their powers stay in the range of double precision
SMALLEST = 1e-18
LARGEST = 1e12
MAGNITUDE = "of magnitude 1e-18 to 1e12 (or 0)"


def as_number(value: Any) -> float | None:
    """The value as a finite float, or None if it is not a finite number (true and false are not
    numbers).
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def show(value: Any, limit: int = 80) -> str:
    """Format a value as in a model file, shortened to ``limit`` characters."""
    text = _show(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."


def _show(value: Any) -> str:
    """A value as TOML, for messages."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + value.encode("unicode_escape").decode("ascii").replace('"', '\\"') + '"'
    if isinstance(value, list):
        return "[" + ", ".join(_show(item) for item in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{bare(key)} = {_show(item)}" for key, item in value.items()) + "}"
    try:
        return str(value)
    except ValueError:  # an integer of thousands of digits
        return "a huge number"


def bare(key: str) -> str:
    """Format a key or name as in a dotted path: quoted if it is not a bare key."""
    return key if re.fullmatch(r"[A-Za-z0-9_\[\]-]+", key) else _show(key)


def closest(word: str, known: Iterable[str]) -> str:
    """Text for a message: the most similar known name, if any, and the list of known names."""
    names = sorted(known)
    if not names:
        return "no key"
    near = difflib.get_close_matches(word, names, 1)
    listed = ", ".join(map(bare, names))
    return f"{bare(near[0])} (there are: {listed})" if near else f"one of {listed}"


@dataclass(frozen=True)
class Where:
    """Position of a table: the file as the user named it, its line and dotted path, and the lines
    of its keys.
    """

    file: str
    line: int
    key: str
    lines: tuple[tuple[str, int], ...] = ()

    def find(self, key: str) -> tuple[str, int]:
        """Dotted path and line of a key, with its unit suffix; those of the table if the key is
        missing.
        """
        lines = dict(self.lines)
        for name in (key, f"{key}_rad", f"{key}_deg"):
            if name in lines:
                return f"{self.key}.{name}", lines[name]
        return f"{self.key}.{key}", self.line


class Table:
    """A table of a model file; its methods return checked values or raise ModelError.

    Parameters
    ----------
    file : str
        The file as the user named it; used for entries without a file of their own.
    entry : Entry
        The table.
    key : str
        Dotted path of the table; empty for the whole file.
    """

    error: type[ModelError] = ModelError
    range: tuple[float, float] = SMALLEST, LARGEST
    size_max = 1_000_000  # bytes of a file
    width = float(WIDTH)  # characters of a line

    def __init__(self, file: str, entry: Entry, key: str) -> None:
        """``key``: dotted path of the table, for messages; ModelError where the entry is another
        kind of value.
        """
        self.file = entry.file or file
        self.key = key
        self.line = entry.line
        if not isinstance(entry.value, dict):
            raise self.error(self.file, entry.line, key, show(unwrap(entry)), "a table")
        self.entries: dict[str, Entry] = entry.value

    def __contains__(self, key: str) -> bool:
        return key in self.entries

    @property
    def data(self) -> dict[str, Any]:
        """The table as plain data."""
        return {key: unwrap(entry) for key, entry in self.entries.items()}

    def path(self, key: str | None) -> str:
        """Dotted path of a key of this table; of the table itself for None."""
        if key is None:
            return self.key
        return f"{self.key}.{bare(key)}" if self.key else bare(key)

    def fail(self, key: str | None, expected: str, given: str | None = None) -> ModelError:
        """The error for a key of this table (None: for the table); ``given`` defaults to the value
        in the file.
        """
        entry = None if key is None else self.entries.get(key)
        if given is None:
            given = "nothing" if entry is None else show(unwrap(entry))
        file, line = (
            (self.file, self.line) if entry is None else (entry.file or self.file, entry.line)
        )
        return self.error(file, line, self.path(key), given, expected)

    def where(self) -> Where:
        """Position of the table in its file, for later messages."""
        return Where(
            self.file, self.line, self.key, tuple((key, e.line) for key, e in self.entries.items())
        )

    def only(self, *known: str) -> None:
        """Raise an error for a key that is not among the known ones."""
        for key in self.entries:
            if key in known:
                continue
            if key + "_rad" in known:
                raise self.fail(key, f"{key}_rad or {key}_deg", "a key without a unit")
            raise self.fail(key, closest(key, known), "an unknown key")

    def _get(self, key: str, expected: str) -> Any:
        if key not in self.entries:
            raise self.fail(key, expected)
        return self.entries[key].value

    def plain(self, key: str, expected: str) -> Any:
        """Any value, as plain data."""
        self._get(key, expected)
        return unwrap(self.entries[key])

    def _in_range(self, numbers: Sequence[float]) -> bool:
        """Whether each number is 0 or has a magnitude that it can have."""
        return all(x == 0.0 or self.range[0] <= abs(x) <= self.range[1] for x in numbers)

    def number(
        self,
        key: str,
        default: float | None = None,
        *,
        above: float | None = None,
        least: float | None = None,
        most: float = math.inf,
    ) -> float:
        """A finite number, ``> above`` or ``>= least``, and ``<= most``; required if there is no
        default.
        """
        if default is not None and key not in self.entries:
            return default
        expected = "a number"
        if above is not None:
            expected += f" > {above:g}"
        if least is not None:
            expected += f" >= {least:g}"
        if most < math.inf:
            expected += f", at most {most:g}"
        number = as_number(self._get(key, expected))
        low = above is not None and number is not None and number <= above
        if number is None or low or (least is not None and number < least) or number > most:
            raise self.fail(key, expected)
        if not self._in_range([number]):
            raise self.fail(key, f"a number {MAGNITUDE}")
        return number

    def whole(self, key: str, low: int, high: int) -> int:
        """An integer from ``low`` to ``high``."""
        expected = f"a whole number from {low} to {high}"
        value = self._get(key, expected)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self.fail(key, expected)
        return value

    def vector(
        self,
        key: str,
        lengths: int | Sequence[int],
        default: Sequence[float] | None = None,
        what: str = "",
    ) -> tuple[float, ...]:
        """A list of finite numbers whose length is one of ``lengths``; ``default`` where the key
        is missing; ``what``: words for the error.
        """
        if default is not None and key not in self.entries:
            return tuple(default)
        lengths = (lengths,) if isinstance(lengths, int) else lengths
        sizes = (
            f"{lengths[0]} to {lengths[-1]}"
            if len(lengths) > 2
            else " or ".join(map(str, lengths))
        )
        expected = f"a list of {sizes} number{'s' if tuple(lengths) != (1,) else ''}"
        expected += f" ({what})" if what else ""
        value = self._get(key, expected)
        if not isinstance(value, list) or len(value) not in lengths:
            raise self.fail(key, expected)
        out = []
        for item in value:
            number = as_number(item.value)
            if number is None:
                given = show(unwrap(self.entries[key]))
                raise self.error(
                    item.file or self.file, item.line, self.path(key), given, expected
                )
            out.append(number)
        if not self._in_range(out):
            raise self.fail(key, f"numbers {MAGNITUDE}; write 0 for a rounding error")
        return tuple(out)

    def axis(self, key: str) -> tuple[float, ...]:
        """A direction, normalized to length 1."""
        vector = self.vector(key, 3, what="a direction")
        largest = max(abs(x) for x in vector)
        if largest == 0.0:
            raise self.fail(key, "a direction that is not zero")
        scaled = [x / largest for x in vector]
        length = math.hypot(*scaled)
        return tuple(x / length for x in scaled)

    def unit_key(self, stem: str, required: bool = True) -> str | None:
        """Which of ``stem_rad`` and ``stem_deg`` is given; both are refused."""
        given = [stem + unit for unit in UNITS if stem + unit in self.entries]
        if len(given) == 2:
            raise self.fail(given[1], "one of the two", f"both {given[0]} and {given[1]}")
        if not given and required:
            raise self.fail(stem + "_rad", f"{stem}_rad or {stem}_deg")
        return given[0] if given else None

    def angles(self, stem: str, rotary: Sequence[bool], what: str = "") -> tuple[float, ...]:
        """A list under ``stem_rad`` or ``stem_deg``, converted to rad; entries that are not rotary
        stay unchanged.
        """
        key = self.unit_key(stem) or ""
        values = self.vector(key, len(rotary), what=what)
        if key.endswith("_rad"):
            return values
        return tuple(
            math.radians(x) if turns else x for x, turns in zip(values, rotary, strict=True)
        )

    def angle(self, stem: str) -> float | None:
        """A number under ``stem_rad`` or ``stem_deg``, in rad; None if both keys are missing."""
        key = self.unit_key(stem, required=False)
        if key is None:
            return None
        return math.radians(self.number(key)) if key.endswith("_deg") else self.number(key)

    def text(self, key: str) -> str:
        """A string without control characters; line ends and tabs are allowed."""
        value = self._get(key, "a string")
        if not isinstance(value, str):
            raise self.fail(key, "a string")
        for c in value:
            if unicodedata.category(c) in ("Cc", "Cs") and c not in "\n\t":
                raise self.fail(
                    key, "text without control characters", f"the control character {show(c)}"
                )
        return value

    def flag(self, key: str) -> bool:
        """True or false."""
        value = self._get(key, "true or false")
        if not isinstance(value, bool):
            raise self.fail(key, "true or false")
        return value

    def choice(self, key: str, known: Sequence[str], default: str | None = None) -> str:
        """One of the known words."""
        if default is not None and key not in self.entries:
            return default
        value = self._get(key, "one of " + ", ".join(known))
        if not isinstance(value, str) or value not in known:
            raise self.fail(key, closest(value if isinstance(value, str) else "", known))
        return value

    def name(
        self,
        key: str = "name",
        taken: Iterable[str] = (),
        problem_of: Callable[[str], str | None] = identifier_problem,
    ) -> str:
        """An identifier that is not in ``taken``."""
        name = self.text(key)
        problem = problem_of(name)
        if problem is not None:
            raise self.fail(key, problem)
        if name in taken:
            raise self.fail(key, "a name that is not taken yet")
        return name

    def words(self, key: str, least: int = 1) -> list[str]:
        """A list of at least so many different strings; a single one is read as a list of one."""
        expected = "a name or a list of different names"
        value = self._get(key, expected)
        words = [item.value for item in value] if isinstance(value, list) else [value]
        if (
            len(words) < least
            or not all(isinstance(word, str) for word in words)
            or len(set(words)) < len(words)
        ):
            raise self.fail(key, expected)
        return words

    def table(self, key: str) -> Table | None:
        """A table, or None if the key is missing."""
        return (
            type(self)(self.file, self.entries[key], self.path(key))
            if key in self.entries
            else None
        )

    def tables(self, key: str, required: bool = True) -> list[Table]:
        """A list of tables; the key path of each contains its name if that is valid, else its
        index.
        """
        if key not in self.entries and not required:
            return []
        value = self._get(key, "a list of tables, not empty")
        if not isinstance(value, list) or not (value or not required):
            raise self.fail(key, "a list of tables, not empty")
        out = []
        for index, entry in enumerate(value):
            name = entry_name(entry)
            path = f"{self.path(key)}[{index}]" if name is None else f"{self.path(key)}.{name}"
            out.append(type(self)(self.file, entry, path))
        return out


def part_of(entry: Entry, word: str) -> tuple[str | int | None, list[str]]:
    """Key or index of the part of a table or list that has a name, None where it has none; and all
    names.
    """
    names: list[str | None] = []
    if isinstance(entry.value, dict):
        return (word if word in entry.value else None), list(entry.value)
    if isinstance(entry.value, list):
        names = [entry_name(item) for item in entry.value]
    return (names.index(word) if word in names else None), [name for name in names if name]


class FileTable(Table):
    """A table of a file that is not of a model: numbers have any magnitude, files may be
    larger.
    """

    error = FileError
    range = 0.0, math.inf
    size_max = 2**24
    width = math.inf


def entry_name(entry: Entry) -> str | None:
    """The name of a list entry if it is an identifier, else None."""
    name = entry.value.get("name") if isinstance(entry.value, dict) else None
    good = (
        name is not None and isinstance(name.value, str) and identifier_problem(name.value) is None
    )
    return name.value if good and name is not None else None


def open_file(path: Path, mode: str = "r", **options: Any) -> IO[Any]:
    """Open a file to read it, as `open`; OSError where it is a pipe or a device, without waiting.

    Opening a pipe waits for a writer, and a device may have no end.
    """
    return open(path, mode, opener=_open_regular, **options)


def _open_regular(name: str, flags: int) -> int:
    """The descriptor of a regular file; what was opened is checked, not what had the name."""
    descriptor = os.open(name, flags | getattr(os, "O_NONBLOCK", 0))
    kind = os.fstat(descriptor).st_mode
    # a folder is refused by what opens it
    if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "a pipe or a device, expected a file", name)
    return descriptor


def file_bytes(path: Path, what: str, shown: str = "") -> bytes:
    """The content of a file, at most a byte more than any table may have; ArgumentError where it
    cannot be read.
    """
    try:
        with open_file(path, "rb") as stream:
            return stream.read(FileTable.size_max + 1)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = getattr(error, "strerror", None) or error
        given = shown or str(path)
        text = (
            f"{what}: given {given!r}, which cannot be read ({reason}), expected a readable file"
        )
        raise ArgumentError(text) from None


def parse_bytes(raw: bytes, shown: str, kind: type[Table] = Table) -> Entry:
    """Parse the content of a TOML file into a tree of entries with their line numbers."""
    if len(raw) > kind.size_max:
        raise kind.error(
            shown, 0, "file", f"more than {kind.size_max} bytes", f"at most {kind.size_max} bytes"
        )
    raw = raw.removeprefix(codecs.BOM_UTF8)
    try:
        return parse(raw.decode("utf-8"), shown, kind.width)
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise kind.error(
            shown, line, "file", f"the byte 0x{raw[error.start]:02x}", "text in UTF-8"
        ) from None
    except TextError as error:
        raise kind.error(shown, error.line, "file", error.given, error.expected) from None


def parse_file(path: Path, shown: str) -> Entry:
    """Parse a model file, or one of moves or recordings."""
    return parse_bytes(file_bytes(path, "model", shown), shown)


def file_table(raw: bytes, path: Path) -> FileTable:
    """The table of a file that is not of a model; its whole numbers have at most 64 bits, as TOML
    1.0 says.
    """
    root = parse_bytes(raw, str(path), FileTable)
    for entry in leaves(root):
        if isinstance(entry.value, int) and not -(2**63) <= entry.value < 2**63:
            given = f"a whole number of {entry.value.bit_length()} bits"
            raise FileError(
                str(path),
                entry.line,
                "file",
                given,
                "at most 64 bits; write 1e30 for a large number",
            )
    return FileTable(str(path), root, "")
