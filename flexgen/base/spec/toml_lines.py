"""TOML parser that keeps the line number of each value, which ``tomllib`` does not provide."""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

Path = tuple[str | int, ...]

DEPTH = 16  # levels of nesting in a model file; the deepest key of the format needs eight
WIDTH = 2000  # characters in a line

_SPACE = re.compile(r"(?:[ \t\n]|#[^\n]*)*")
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_STRING = re.compile(
    r'"""(?:\\.|[^\\])*?"""(?:"{0,2})|' r"'''.*?'''(?:'{0,2})|" r'"(?:\\.|[^"\\])*"|' r"'[^']*'",
    re.DOTALL,
)
_SCALAR = re.compile(r"[^,\]}#\n]*")
_LINE = re.compile(r"[^\n]*")


@dataclass
class Entry:
    """A value with its line (0: not from a file) and file; entries of tables and lists are Entries
    too.
    """

    value: Any
    line: int
    file: str = ""


class TextError(Exception):
    """The text is not valid TOML: what was given and expected, and the line (0: unknown)."""

    def __init__(self, line: int, given: str, expected: str) -> None:
        self.line = line
        self.given = given
        self.expected = expected
        super().__init__(f"line {line}: given {given}, expected {expected}")


def parse(text: str, file: str = "", width: float = WIDTH) -> Entry:
    """Parse TOML text, of lines of at most ``width`` characters, into a tree of Entries with lines
    and file.

    Raises
    ------
    TextError
        The text is not valid TOML, or is nested too deeply.
    """
    return copy(_parse(text, file, width))


@lru_cache(maxsize=8)  # the same few models are read again and again
def _parse(text: str, file: str, width: float) -> Entry:
    """The tree of a text, which is never changed."""
    text = text.replace("\r\n", "\n")
    for number, row in enumerate(text.split("\n"), 1):
        if len(row) > width:
            raise TextError(number, f"a line of {len(row)} characters", f"at most {width:g}")
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise TextError(0, "values nested too deeply", f"at most {DEPTH} levels") from None
    except ValueError as error:  # TOMLDecodeError is one
        message = str(error)
        found = re.search(r" \(at (?:line (\d+), column \d+|end of document)\)\Z", message)
        line = 0 if found is None else int(found[1] or text.count("\n") + 1)
        reason = message[: found.start()] if found else message
        given = f"text that is not TOML ({reason[:1].lower()}{reason[1:]})"
        raise TextError(line, given, "TOML 1.0") from None
    check_depth(data)
    return _attach(data, (), Scanner(text).lines, 1, file)


def check_depth(data: Any) -> None:
    """Raise TextError if tables and lists are nested more than DEPTH levels deep; makes recursion
    safe.
    """
    level = [data]
    for _ in range(DEPTH + 1):
        level = [
            child
            for item in level
            if isinstance(item, (dict, list, tuple))
            for child in (item.values() if isinstance(item, dict) else item)
        ]
        if not level:
            return
    raise TextError(0, "values nested too deeply", f"at most {DEPTH} levels")


def wrap(data: Any, line: int = 0, file: str = "") -> Entry:
    """Convert plain data to Entries with the same line and file."""
    return _attach(data, (), {}, line, file)


def leaves(entry: Entry) -> Iterator[Entry]:
    """The values other than tables and lists."""
    if not isinstance(entry.value, dict | list):
        yield entry
        return
    for child in entry.value.values() if isinstance(entry.value, dict) else entry.value:
        yield from leaves(child)


def unwrap(entry: Entry) -> Any:
    """Convert an Entry to plain data."""
    value = entry.value
    if isinstance(value, dict):
        return {key: unwrap(child) for key, child in value.items()}
    return [unwrap(child) for child in value] if isinstance(value, list) else value


def copy(entry: Entry) -> Entry:
    """Copy an Entry with all its tables and lists."""
    value = entry.value
    if isinstance(value, dict):
        value = {key: copy(child) for key, child in value.items()}
    elif isinstance(value, list):
        value = [copy(child) for child in value]
    return Entry(value, entry.line, entry.file)


def _attach(data: Any, path: Path, lines: dict[Path, int], line: int, file: str) -> Entry:
    """The tree of ``data`` at a ``path``, each value with its line; values without one have that
    of their table.
    """
    line = lines.get(path, line)
    if isinstance(data, dict):
        value = {
            str(key): _attach(child, (*path, key), lines, line, file)
            for key, child in data.items()
        }
        return Entry(value, line, file)
    if isinstance(data, (list, tuple)):
        return Entry(
            [_attach(child, (*path, i), lines, line, file) for i, child in enumerate(data)],
            line,
            file,
        )
    return Entry(data, line, file)


class Scanner:
    """Finds each key and list entry in text that is valid TOML.

    ``lines``: path -> line of its key; ``spans``: path of a number, text, date or truth value ->
    first character and the one after its last; ``braces``: path of an inline table -> place of its
    closing brace; ``headers``: path of a table -> place of the end of its header's line.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.pos = 0
        self.breaks = [match.start() for match in re.finditer("\n", text)]
        self.lines: dict[Path, int] = {}
        self.spans: dict[Path, tuple[int, int]] = {}
        self.braces: dict[Path, int] = {}
        self.headers: dict[Path, int] = {}
        self.counts: dict[Path, int] = {}  # entries of each array of tables so far
        here: Path = ()
        while self.skip():
            if self.text[self.pos] == "[":
                here = self.header()
            else:
                self.pair(here)

    def skip(self) -> bool:
        """Skip blanks, line ends and comments; return False at the end of the text."""
        self.pos = self.match(_SPACE, self.pos)
        return self.pos < len(self.text)

    def match(self, pattern: re.Pattern[str], pos: int) -> int:
        """The end of what matches at a place, or the place itself."""
        found = pattern.match(self.text, pos)
        return pos if found is None else found.end()

    def note(self, path: Path) -> None:
        """Store the current line for a path and for its parents that have none yet."""
        line = bisect_right(self.breaks, self.pos) + 1
        for n in range(1, len(path) + 1):
            self.lines.setdefault(path[:n], line)

    def header(self) -> Path:
        """Read the header of a table."""
        many = self.text.startswith("[[", self.pos)
        start = self.pos
        self.pos += 2 if many else 1
        keys = self.keys()
        end = self.pos + (2 if many else 1)
        self.pos = start
        path: Path = ()
        for key in keys[:-1] if many else keys:
            path = (*path, key)
            if path in self.counts:
                path = (*path, self.counts[path] - 1)
        if many:
            path = (*path, keys[-1])
            self.counts[path] = self.counts.get(path, 0) + 1
            path = (*path, self.counts[path] - 1)
        self.note(path)
        self.pos = end
        self.headers[path] = self.match(_LINE, end)
        return path

    def keys(self) -> list[str]:
        """Read a dotted key and the blanks around it."""
        out: list[str] = []
        while True:
            self.skip()
            start = self.pos
            if self.text[start] in "\"'":
                self.pos = self.match(_STRING, start)
                out.append(tomllib.loads(f"key = {self.text[start : self.pos]}")["key"])
            else:
                self.pos = self.match(_BARE, start)
                out.append(self.text[start : self.pos])
            self.skip()
            if self.text[self.pos] != ".":
                return out
            self.pos += 1

    def pair(self, here: Path) -> None:
        """Read a key and its value."""
        start = self.pos
        path = (*here, *self.keys())
        after = self.pos + 1
        self.pos = start
        self.note(path)
        self.pos = after
        self.value(path)

    def value(self, path: Path) -> None:
        """Skip over a value, and note where it is: spans of texts and scalars, lines of entries of
        lists, closing braces of inline tables.
        """
        self.skip()
        first = self.text[self.pos]
        start = self.pos
        if first in "\"'":
            self.pos = self.match(_STRING, self.pos)
            self.spans[path] = (start, self.pos)
        elif first in "[{":
            self.pos += 1
            index = 0
            while True:
                self.skip()
                if self.text[self.pos] in "]}":
                    break
                if self.text[self.pos] == ",":
                    self.pos += 1
                elif first == "{":
                    self.pair(path)
                else:
                    self.note((*path, index))
                    self.value((*path, index))
                    index += 1
            if first == "{":
                self.braces[path] = self.pos
            self.pos += 1
        else:
            self.pos = self.match(_SCALAR, self.pos)
            self.spans[path] = (start, start + len(self.text[start : self.pos].rstrip()))
