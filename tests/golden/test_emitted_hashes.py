"""Every emitted file of six models, and each manifest, have the bytes that ``tests/golden/emitted.txt`` records."""

from __future__ import annotations

from importlib.metadata import version

import pytest
from emitted_hashes import CHOICES, GOLDEN_CASADI, hashes, read


def changes(golden: dict[str, str], today: dict[str, str]) -> list[str]:
    """Files that are in one of the two only, or differ."""
    return sorted(file for file in golden.keys() | today.keys() if golden.get(file) != today.get(file))


@pytest.mark.parametrize("model", CHOICES)
def test_emitted_files_have_the_recorded_hashes(model):
    """``make golden`` records them anew; the commit says which lines of which files change, and why."""
    if not version("casadi").startswith(f"{GOLDEN_CASADI}."):
        pytest.skip(f"recorded with CasADi {GOLDEN_CASADI}; run: pip install 'casadi~={GOLDEN_CASADI}.0'")
    assert changes(read()[model], hashes(model)) == [], "run: make golden"


def test_a_changed_a_new_and_a_missing_file_are_found():
    assert changes({"a.c": "1", "b.c": "2", "c.c": "3"}, {"a.c": "1", "b.c": "5", "d.c": "3"}) == ["b.c", "c.c", "d.c"]
