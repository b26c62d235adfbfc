"""Fragments of CHANGELOG in docs/news, and its section of the last release."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NEWS = ROOT / "docs" / "news"
LONGEST_SECTION = 60
LONGEST_LINE = 200


def problem(name: str, text: str) -> str:
    """Why a file of docs/news is not a fragment; empty where it is one."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    kinds = [kind["directory"] for kind in settings["towncrier"]["type"]]
    if not re.fullmatch(rf"[a-z0-9_-]+\.({'|'.join(kinds)})\.md", name):
        return f"name: expected SUBJECT.TYPE.md, TYPE one of {', '.join(kinds)}"
    if len(text.strip().splitlines()) != 1 or len(text) > LONGEST_LINE:
        return f"expected one line of at most {LONGEST_LINE} characters"
    return ""


def test_fragments_are_one_line_each() -> None:
    found = {path.name: problem(path.name, path.read_text("utf-8")) for path in NEWS.glob("*.md")}
    assert {name: text for name, text in found.items() if text} == {}


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("loops.new.md", "A line.\n"),
        ("loops.added.md", "Two\nlines.\n"),
        ("loops.added.md", "x" * 201),
        ("Loops.md", "A line.\n"),
    ],
)
def test_planted_fragments_are_seen(name: str, text: str) -> None:
    assert problem(name, text)
    assert problem("loops.added.md", "A line.\n") == ""


def test_the_last_release_is_short() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    section = re.split(r"^## ", text, flags=re.MULTILINE)[1]
    assert len(section.splitlines()) <= LONGEST_SECTION
