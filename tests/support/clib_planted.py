"""Planted errors in the hand-written C."""

from __future__ import annotations

import pytest

from flexgen.codegen.emission import clib_files


def plant_in_c(monkeypatch: pytest.MonkeyPatch, file: str, old: str, new: str) -> None:
    """Replace a text that a file of clib/ has once, in all libraries of this test."""
    texts = dict(clib_files.read_clib())
    assert texts[file].count(old) == 1
    texts[file] = texts[file].replace(old, new)
    monkeypatch.setattr(clib_files, "read_clib", lambda: texts)
