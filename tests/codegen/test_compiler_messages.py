"""The first errors of a program that fails, in the message of the error."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from flexgen.base.errors import BuildError
from flexgen.codegen.build.compiler import run_compiler

ERRORS = [f"{k}: Error of {k}" for k in range(7)]


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["note", "", *ERRORS], ERRORS[:5]),
        (["a", "", "b", "  ", *"cdef"], [*"abcde"]),
        ([" "], ["exit status 3, without a message"]),
    ],
    ids=["errors", "others", "none"],
)
def test_the_first_errors_of_a_program_are_told(
    lines: list[str], expected: list[str], tmp_path: Path
) -> None:
    """Five lines with that word, or the first five of any; without lines its status."""
    (tmp_path / "said").write_text("\n".join(lines))
    with pytest.raises(BuildError) as caught:
        run_compiler("linker", ["sh", "-c", "cat said >&2; exit 3"], tmp_path, "made")
    text = "the linker failed; the directory is as it was before:\n  "
    assert str(caught.value) == text + "\n  ".join(expected)


def test_a_program_that_writes_nothing_is_told(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match=re.escape("'true' reported success but wrote no made")):
        run_compiler("linker", ["true"], tmp_path, "made")
