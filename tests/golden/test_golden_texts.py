"""All golden texts are those that flexgen renders today; `registry.py` has them.

A net, not a proof: ``make golden`` writes them again; read the difference before you commit it.
"""

from __future__ import annotations

import sys
from importlib.metadata import version
from pathlib import Path

import export_hashes
import pytest
from emitted_hashes import GOLDEN_CASADI
from golden_texts import Files, Golden, Rows, Sections
from registry import GOLDEN

# argparse of this Python and later ones wraps some helps otherwise.
OTHER_HELPS = (3, 13)
PARTS = [(name, part) for name, golden in GOLDEN.items() for part in golden.parts()]


@pytest.mark.parametrize(("name", "part"), PARTS)
def test_a_text_is_that_of_the_repository(name: str, part: str) -> None:
    if GOLDEN[name].casadi and not version("casadi").startswith(f"{GOLDEN_CASADI}."):
        pytest.skip(
            f"recorded with CasADi {GOLDEN_CASADI}, another one orders operations otherwise"
        )
    if part == "helps.txt" and sys.version_info >= OTHER_HELPS:
        pytest.skip("helps are compared with Python 3.11 and 3.12")
    difference = GOLDEN[name].difference(part)
    assert not difference, f"run: python tests/golden/update.py {name}\n{difference}"


@pytest.mark.parametrize("name", GOLDEN)
def test_the_files_have_all_parts(name: str) -> None:
    assert GOLDEN[name].unknown() == []


@pytest.mark.parametrize("kind", [Files, Sections, Rows])
def test_what_is_written_is_kept_and_a_change_is_a_difference(
    kind: type[Golden], tmp_path: Path
) -> None:
    texts = {"one": "one a\none b\n", "two": "two c\n"}
    place = tmp_path if kind is Files else tmp_path / "texts.txt"
    golden = kind(place, lambda: texts, lambda part: texts[part])
    files = golden.write()
    before = [file.read_bytes() for file in files]
    assert [text.splitlines() for text in golden.kept().values()] == [
        text.splitlines() for text in texts.values()
    ]
    assert [golden.difference(part) for part in texts] == ["", ""]
    texts["one"] = "one a\none d\n"
    assert golden.difference("one").splitlines()[-3:] == [" one a", "-one b", "+one d"]
    golden.write()
    assert [file.read_bytes() for file in files] != before
    texts["three"] = "three\n"
    assert golden.unknown() == ["three"]


def test_a_digit_of_a_number_changes_the_hash_of_an_export_and_rounding_does_not() -> None:
    digest = export_hashes.digest
    assert digest("a 0.123456789 b") == digest("a 0.1234567890001 b") != digest("a 0.123456788 b")
    assert digest("2 steps") != digest("3 steps")
