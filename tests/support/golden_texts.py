"""Golden texts: what the repository keeps of texts that flexgen renders, and what differs today.

A `Golden` has parts, each with a name and a text that is rendered on its own. They are kept in
one file each (`Files`), in one file with ``== NAME`` before each (`Sections`), or as rows that
begin with the name (`Rows`). `tests/golden/registry.py` has all of them.
"""

from __future__ import annotations

import difflib
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

MARK = "== "
# Lines of a difference that a failed test prints.
LINES = 60
NUMBER = re.compile(r"-?\d+\.\d{3,}(?:e[-+]\d+)?|-?\d(?:\.\d+)?e[-+]\d+")


def nine_digits(text: str) -> str:
    """A text with nine digits of each number: the last ones depend on how BLAS sums on a
    processor.
    """

    def short(found: re.Match[str]) -> str:
        value = float(found.group())
        return f"{0.0 if abs(value) < 1e-12 else value:.9g}"

    return NUMBER.sub(short, text)


@dataclass(frozen=True)
class Golden(ABC):
    """Texts of one kind, and where they are kept.

    Attributes
    ----------
    path : Path
        The file, or the folder of `Files`.
    parts : Callable[[], Iterable[str]]
        Names of the texts, in the order of the file.
    render : Callable[[str], str]
        The text of a name, as flexgen writes it today.
    casadi : bool
        Whether the text depends on how CasADi orders operations.
    """

    path: Path
    parts: Callable[[], Iterable[str]]
    render: Callable[[str], str]
    casadi: bool = False

    @abstractmethod
    def kept(self) -> dict[str, str]:
        """The text of each part in the repository."""

    @abstractmethod
    def write(self) -> list[Path]:
        """Write all parts anew; returns the files."""

    def difference(self, part: str) -> str:
        """Lines of a part that differ, as a unified diff; empty where none does."""
        before = self.kept().get(part, "").splitlines()
        now = self.render(part).splitlines()
        lines = list(difflib.unified_diff(before, now, "kept", "today", lineterm="", n=1))
        if len(lines) > LINES:
            lines[LINES:] = [f"... and {len(lines) - LINES} more lines"]
        return "\n".join(lines)

    def unknown(self) -> list[str]:
        """Names that only the repository or only today's texts have."""
        return sorted(set(self.kept()) ^ set(self.parts()))


@dataclass(frozen=True)
class Files(Golden):
    """One file for each part, in the folder ``path``; the name of a part is that of its file."""

    def kept(self) -> dict[str, str]:
        """The texts of the files that are there."""
        files = {part: self.path / part for part in self.parts()}
        return {
            part: file.read_text(encoding="utf-8") for part, file in files.items() if file.exists()
        }

    def write(self) -> list[Path]:
        """Write each file."""
        for part in self.parts():
            (self.path / part).write_text(self.render(part), encoding="utf-8")
        return [self.path / part for part in self.parts()]


@dataclass(frozen=True)
class Sections(Golden):
    """One file; a line ``== NAME`` before the text of each part."""

    def kept(self) -> dict[str, str]:
        """The sections of the file."""
        sections = ("\n" + self.path.read_text(encoding="utf-8")).split(f"\n{MARK}")[1:]
        pairs = (section.partition("\n") for section in sections)
        return {name: text.removesuffix("\n") for name, _, text in pairs}

    def write(self) -> list[Path]:
        """Write the file."""
        texts = [f"{MARK}{part}\n{self.render(part)}\n" for part in self.parts()]
        self.path.write_text("".join(texts), encoding="utf-8")
        return [self.path]


@dataclass(frozen=True)
class Rows(Golden):
    """One file of rows; each begins with the name of its part."""

    def kept(self) -> dict[str, str]:
        """The rows of each part."""
        found: dict[str, str] = {}
        for row in self.path.read_text(encoding="utf-8").splitlines(keepends=True):
            part = row.split(" ", 1)[0]
            found[part] = found.get(part, "") + row
        return found

    def write(self) -> list[Path]:
        """Write the file."""
        self.path.write_text("".join(map(self.render, self.parts())), encoding="utf-8")
        return [self.path]
