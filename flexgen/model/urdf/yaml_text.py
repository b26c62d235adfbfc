"""Parser of the part of YAML in which files of closed loops are written: mappings, lists, numbers
and texts, in block or flow style.

Anchors, aliases, tags, block scalars and several documents are refused. Values keep their lines.
"""

from __future__ import annotations

import re

from flexgen.base.spec.tables import show
from flexgen.base.spec.toml_lines import Entry, TextError

DEPTH = 16  # levels of nesting; those of a file of loops are four

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_WORDS = {"true": True, "false": False}
# A key of a mapping in block style, and what follows it.
_KEY = re.compile(
    r"""("[^"\\]*"|'[^']*'|[^\s"'\[\]{},#&*!|>%@`-][^"'\[\]{},#]*?)\s*:(?:\s+(.*))?$"""
)
_EXPECTED = "YAML with mappings, lists, numbers and texts alone"
# A scalar in flow style, or a mark.
_TOKEN = re.compile(
    r"""\s*("[^"\\]*"|'[^']*'|[\[\]{},]|:(?=\s)|(?:[^\s\[\]{},:"']|:(?!\s)|\s(?!\s*[,\]}:]))+)"""
)


def parse(text: str, file: str) -> Entry:
    """Parse YAML text into a tree of Entries with lines and file.

    Raises
    ------
    TextError
        The text is not YAML, or has parts of it that no file of loops needs.
    """
    return _Parser(text, file).document()


class _Parser:
    """A text, as lines (number, indentation, text) without comments and empty ones."""

    def __init__(self, text: str, file: str) -> None:
        self.file = file
        self.lines: list[tuple[int, int, str]] = []
        self.at = 0
        opened = 0  # brackets of a flow style that the line before has left open
        for number, raw in enumerate(text.splitlines(), 1):
            line = _without_comment(raw)
            body = line.strip()
            if not body or (body == "---" and not self.lines):
                continue
            indent = len(line) - len(line.lstrip(" "))
            if line[indent] == "\t":
                raise TextError(number, "a tab as indentation", "spaces")
            if opened:
                first, before, begun = self.lines.pop()
                self.lines.append((first, before, f"{begun} {body}"))
            else:
                self.lines.append((number, indent, body))
            opened += _count_open(body)
        if opened > 0:
            raise TextError(self.lines[-1][0], "a bracket that is not closed", "] or }")

    def document(self) -> Entry:
        """The whole text."""
        if not self.lines:
            return Entry({}, 1, self.file)
        found = self.block(self.lines[0][1], 0)
        if self.at < len(self.lines):
            number, _, body = self.lines[self.at]
            raise TextError(number, show(body), "an entry at the indentation of those before")
        return found

    def block(self, indent: int, depth: int) -> Entry:
        """A mapping or a list in block style at this indentation, or a value on its own line."""
        number, _, body = self.lines[self.at]
        if depth > DEPTH:
            raise TextError(number, "a value nested too deeply", f"at most {DEPTH} levels")
        if body == "-" or body.startswith("- "):
            return self.sequence(indent, depth)
        if _KEY.match(body):
            return self.mapping(indent, depth)
        self.at += 1
        return self.value(body, number)

    def sequence(self, indent: int, depth: int) -> Entry:
        """A list in block style."""
        first = self.lines[self.at][0]
        out: list[Entry] = []
        while self.at < len(self.lines):
            number, here, body = self.lines[self.at]
            if here != indent or not (body == "-" or body.startswith("- ")):
                break
            rest = body[1:].lstrip()
            if not rest:
                self.at += 1
                out.append(self.inner(indent, number, depth))
                continue
            # what follows the dash is the first line of an entry with its own indentation
            self.lines[self.at] = number, indent + len(body) - len(rest), rest
            out.append(self.block(self.lines[self.at][1], depth + 1))
        return Entry(out, first, self.file)

    def mapping(self, indent: int, depth: int) -> Entry:
        """A mapping in block style."""
        first = self.lines[self.at][0]
        out: dict[str, Entry] = {}
        while self.at < len(self.lines):
            number, here, body = self.lines[self.at]
            if here != indent:
                break
            match = _KEY.match(body)
            if match is None:
                raise TextError(number, show(body), "KEY: VALUE")
            key = match[1].strip("\"'")
            if key in out:
                given = f"a second key {show(key)}, the first one is in line {out[key].line}"
                raise TextError(number, given, "each key once")
            self.at += 1
            rest = (match[2] or "").strip()
            out[key] = self.value(rest, number) if rest else self.inner(indent, number, depth)
            out[key].line = number
        return Entry(out, first, self.file)

    def inner(self, indent: int, number: int, depth: int) -> Entry:
        """The value below a key or a dash; a list may stand at the indentation of its key."""
        if self.at < len(self.lines):
            _, here, body = self.lines[self.at]
            if here > indent or (here == indent and body.startswith("- ")):
                return self.block(here, depth + 1)
        return Entry([], number, self.file)

    def value(self, text: str, number: int) -> Entry:
        """A value in flow style, or a scalar."""
        if text[0] in "&*!|>%@`?":
            raise TextError(number, show(text), _EXPECTED)
        if text[0] not in "[{":
            return Entry(_scalar(text), number, self.file)
        tokens = _tokens(text, number)
        found = self.flow(tokens, number, 0)
        if tokens:
            raise TextError(number, show(tokens[-1]), "nothing after the closing bracket")
        return found

    def flow(self, tokens: list[str], number: int, depth: int) -> Entry:
        """The next value of the tokens, which are in reverse order and used up."""
        token = tokens.pop() if tokens else ""
        if depth > DEPTH:
            raise TextError(number, "a value nested too deeply", f"at most {DEPTH} levels")
        if token == "[":
            return Entry(self.flow_list(tokens, number, depth), number, self.file)
        if token == "{":
            return Entry(self.flow_mapping(tokens, number, depth), number, self.file)
        if token in ("", "]", "}", ",", ":"):
            raise TextError(number, show(token), "a value")
        return Entry(_scalar(token), number, self.file)

    def flow_list(self, tokens: list[str], number: int, depth: int) -> list[Entry]:
        """The entries up to the closing bracket."""
        out: list[Entry] = []
        while tokens and tokens[-1] != "]":
            out.append(self.flow(tokens, number, depth + 1))
            _separator(tokens, "]", number)
        _close(tokens, "]", number)
        return out

    def flow_mapping(self, tokens: list[str], number: int, depth: int) -> dict[str, Entry]:
        """The entries up to the closing brace."""
        out: dict[str, Entry] = {}
        while tokens and tokens[-1] != "}":
            key = tokens.pop().strip("\"'")
            if key in out:
                raise TextError(number, f"a second key {show(key)}", "each key once")
            _close(tokens, ":", number)
            out[key] = self.flow(tokens, number, depth + 1)
            _separator(tokens, "}", number)
        _close(tokens, "}", number)
        return out


def _separator(tokens: list[str], end: str, number: int) -> None:
    """Take the comma between two entries; before the end it may be missing."""
    if tokens and tokens[-1] == end:
        return
    _close(tokens, ",", number)


def _close(tokens: list[str], mark: str, number: int) -> None:
    """Take the mark that has to follow."""
    token = tokens.pop() if tokens else ""
    if token != mark:
        raise TextError(number, show(token), show(mark))


def _tokens(text: str, number: int) -> list[str]:
    """The scalars and marks of a value in flow style, the last one first."""
    out: list[str] = []
    at = 0
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise TextError(number, show(text[at:]), _EXPECTED)
        out.append(match[1])
        at = match.end()
        at += len(text[at:]) - len(text[at:].lstrip())
    return out[::-1]


def _without_comment(line: str) -> str:
    """The line without its comment: a ``#`` at the start or after a space, outside of quotes."""
    quote = ""
    for k, char in enumerate(line):
        if quote:
            quote = "" if char == quote else quote
        elif char in "\"'":
            quote = char
        elif char == "#" and (k == 0 or line[k - 1] in " \t"):
            return line[:k].rstrip()
    return line.rstrip()


def _count_open(text: str) -> int:
    """Number of brackets of flow style that the text opens and does not close."""
    plain = re.sub(r""""[^"]*"|'[^']*'""", "", text)
    return sum(plain.count(mark) for mark in "[{") - sum(plain.count(mark) for mark in "]}")


def _scalar(text: str) -> str | float | int | bool:
    """A number, a truth value or a text; quotes make a text of it."""
    if text[0] in "\"'":
        return text[1:-1]
    if _NUMBER.fullmatch(text):
        return int(text) if re.fullmatch(r"[+-]?\d{1,15}", text) else float(text)
    return _WORDS.get(text.lower(), text)
