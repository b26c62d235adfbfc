"""Files that a command writes: those of others are not replaced."""

from __future__ import annotations

from pathlib import Path

import pytest

from flexgen.base.errors import ArgumentError
from flexgen.cli.result import check_own


@pytest.mark.parametrize("given", [None, "new.html", ".", "own.html", "other.html"])
def test_files_of_others_are_not_replaced(given: str | None, tmp_path: Path) -> None:
    """The mark of flexgen is in the first 4096 bytes."""
    (tmp_path / "own.html").write_bytes(b"x" * 4091 + b"marks" + b"y")
    (tmp_path / "other.html").write_bytes(b"x" * 4092 + b"marks")
    path = None if given is None else tmp_path / given
    if given != "other.html":
        check_own(path, b"marks")
        return
    with pytest.raises(ArgumentError) as refused:
        check_own(path, b"marks")
    assert str(refused.value) == (
        f"output: given {str(path)!r}, a file that flexgen did not write, expected a new one "
        "or one of its own; choose another name, or move that file away"
    )
