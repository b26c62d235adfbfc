"""Files of texts by name, ``== NAME`` before each: what they kept, what differs today, and how
they are written.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

MARK = "== "
NUMBER = re.compile(r"-?\d+\.\d{3,}(?:e[-+]\d+)?|-?\d(?:\.\d+)?e[-+]\d+")


def nine_digits(text: str) -> str:
    """A text with nine digits of each number: the last ones depend on how BLAS sums on a
    processor.
    """

    def short(found: re.Match[str]) -> str:
        value = float(found.group())
        return f"{0.0 if abs(value) < 1e-12 else value:.9g}"

    return NUMBER.sub(short, text)


def kept(golden: Path) -> dict[str, list[str]]:
    """The lines of each text in a file."""
    parts = ("\n" + golden.read_text(encoding="utf-8")).split(f"\n{MARK}")[1:]
    return {name: text.splitlines() for name, _, text in (part.partition("\n") for part in parts)}


def changes(golden: Path, names: Iterable[str], lines: Callable[[str], list[str]]) -> list[str]:
    """The first lines of each of these texts that are not as in the file."""
    before = kept(golden)
    out = []
    for name in names:
        found = lines(name)
        expected = before.get(name, [])
        pairs = [(a, b) for a, b in zip(expected, found, strict=False) if a != b]
        out += [f"{name}: was {a}\nnow {b}" for a, b in pairs[:3]]
        if len(found) != len(expected):
            out.append(f"{name}: {len(found)} lines, {len(expected)} in the file")
    return ["run: make golden", *out] if out else []


def write(golden: Path, names: Iterable[str], lines: Callable[[str], list[str]]) -> None:
    """Write a file anew."""
    golden.write_text(
        "".join("\n".join([MARK + name, *lines(name), ""]) for name in names), encoding="utf-8"
    )
