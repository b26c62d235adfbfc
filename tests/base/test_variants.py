"""Model files with one more variant."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.variants import LONGEST, add_variant

FILE = """\
name = "arm"

[variant.stiff]
description = "stiffer"
remove = ["payload"]

[variant.stiff.set]
"q1.stiffness" = 2.0
"q2.stiffness" = 3.0
"""
LONG = "two\n  lines " + 400 * "x"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "arm.toml").write_text(FILE)
    (tmp_path / "arm.txt").write_text(FILE)
    return tmp_path / "arm.toml"


@pytest.mark.parametrize(
    ("base", "expected"),
    [
        ("", {"set": {"q1.stiffness": 5.0, "m.mass": [1, 2]}}),
        (
            "stiff",
            {
                "remove": ["payload"],
                "set": {"q2.stiffness": 3.0, "q1.stiffness": 5.0, "m.mass": [1, 2]},
            },
        ),
    ],
)
def test_a_variant_has_the_changes_of_its_base_first(
    file: Path, base: str, expected: dict[str, Any]
) -> None:
    """Which it may set otherwise; the description is one line that is not too long."""
    text = add_variant(file, "new", {"q1.stiffness": 5.0, "m.mass": [1, 2]}, LONG, base)
    found = tomllib.loads(text)["variant"]
    assert found.pop("new") == {"description": " ".join(LONG.split())[:LONGEST], **expected}
    assert found == tomllib.loads(FILE)["variant"]
    assert list(tomllib.loads(text)["variant"]["new"]["set"]) == list(expected["set"])
    assert text.startswith(FILE + "\n[variant.new]\n")
    assert text.endswith("\n") and not text.endswith("\n\n")


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("arm.toml", "arm.toml, which has a variant 'stiff'"),
        ("arm.txt", "{path!r}, which is no .toml file"),
        ("none.toml", "{path!r}, which is no .toml file"),
        (None, "'', which is no .toml file"),
    ],
)
def test_files_without_room_for_the_variant_are_refused(
    file: Path, name: str | None, given: str
) -> None:
    path = "" if name is None else str(file.parent / name)
    with pytest.raises(ArgumentError) as caught:
        add_variant(path, "stiff", {}, "x")
    assert str(caught.value) == (
        f"write: given a model of {given.format(path=path)}, expected one of a .toml file without "
        "that variant; the numbers are in the result and in --json"
    )
