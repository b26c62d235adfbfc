"""Tests use public names of flexgen: the list of the private ones may only shrink."""

from __future__ import annotations

import pytest
from private_names import grown, private_names, recorded, today


def test_no_file_of_tests_has_more_private_names_than_the_list() -> None:
    """Where it has fewer: ``python tests/support/private_names.py`` writes the list."""
    assert grown(recorded(), today()) == []


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("from flexgen.paths.path import _planned", {"_planned"}),
        ("from flexgen.paths import path\npath._planned(1)", {"_planned"}),
        ("import flexgen.paths.path as p\np._planned(1)", {"_planned"}),
        ("import flexgen\nflexgen.paths._planned.cache_clear()", {"_planned"}),
        ("monkeypatch.setattr(path, '_planned', None)", {"_planned"}),
        ("monkeypatch.setattr('flexgen.paths._planned', None)", {"_planned"}),
        ("from flexgen.paths import path\npath.planned(1)\npath.__name__", set()),
        ("made = search()\nmade._slow_down(1)", {"_slow_down"}),
        ("search(1)._slow_down(1)[0]._state", {"_slow_down", "_state"}),
        ("result._repr_html_()\nmade._of_this_test", set()),
        ("import ctypes as c\nc._slow_down(1)", set()),
        ("from numpy import _core\nclass A:\n    def f(self): return self._x", set()),
    ],
)
def test_private_names_are_found(text: str, expected: set[str]) -> None:
    assert private_names(text) == expected


def test_a_new_private_name_is_refused() -> None:
    assert grown({"test_a.py": 2}, {"test_a.py": 2}) == []
    assert grown({"test_a.py": 2}, {"test_a.py": 3, "test_b.py": 1}) == [
        "test_a.py: 3 private names, 2 in the list",
        "test_b.py: 1 private names, 0 in the list",
    ]
