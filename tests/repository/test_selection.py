"""The selection of the quick tests: its tables name what is there, and every room of flexgen has a
quick test.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import pytest
from selection import (
    ANY_MODEL,
    OPTIMIZED,
    OTHER_MODELS,
    QUICK_MODELS,
    ROOT,
    SLOW,
    SLOW_CASES,
    UNOPTIMIZED,
    slow,
)

from flexgen.model.reader import model_names

TESTS = ROOT / "tests"


def rooms() -> set[str]:
    """The folders of flexgen that hold modules, by their paths below it."""
    source = ROOT / "flexgen"
    found = {path.parent.relative_to(source) for path in source.rglob("[a-z]*.py")}
    return {path.as_posix() for path in found} - {"."}


def quick_files() -> list[Path]:
    """Test files with a test that no table and no mark of the file makes slow."""
    out = []
    for path in sorted(TESTS.glob("*/test_*.py")):
        tests = [node for node in tree(path).body if isinstance(node, ast.FunctionDef)]
        marks = [
            [ast.unparse(mark) for mark in node.decorator_list]
            for node in tests
            if node.name.startswith("test_")
        ]
        quick = any(
            "pytest.mark.slow" not in mark and "pytest.mark.full" not in mark for mark in marks
        )
        if quick and not slow(path.relative_to(TESTS).as_posix(), ""):
            out.append(path)
    return out


@cache
def tree(path: Path) -> ast.Module:
    """The syntax tree of a file, not to be changed."""
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imported_names(path: Path) -> frozenset[str]:
    """All dotted names that a file imports."""
    out: set[str] = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            out |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom) and node.module:
            out |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return frozenset(out)


def imported_rooms(path: Path) -> set[str]:
    """The rooms that a test file imports from, itself and through the helpers in tests/support."""
    out: set[str] = set()
    helpers = {file.stem: file for file in (TESTS / "support").glob("*.py")}
    seen = set()
    todo = [path]
    while todo:
        file = todo.pop()
        seen.add(file)
        names = imported_names(file)
        inside = [name.split(".")[1:] for name in names if name.startswith("flexgen.")]
        out |= {"/".join(parts[:k]) for parts in inside for k in range(1, len(parts) + 1)}
        todo += [helpers[name] for name in names if name in helpers and helpers[name] not in seen]
    return out & rooms()


def untouched(files: Iterable[Path]) -> list[str]:
    """The rooms that none of these files imports."""
    return sorted(rooms() - set().union(*map(imported_rooms, files)))


@pytest.mark.slow
def test_every_room_has_a_quick_test():
    assert {"dynamics/mechanics", "inversion", "cli", "codegen/build"} <= rooms()
    assert untouched(quick_files()) == []


@pytest.mark.slow
def test_a_room_without_a_quick_test_is_seen():
    assert untouched(
        path for path in quick_files() if "views/plots" not in imported_rooms(path)
    ) == ["views/plots"]


def test_the_tables_name_existing_folders_and_files():
    for entry in (*SLOW, *ANY_MODEL, *UNOPTIMIZED, *OPTIMIZED, *SLOW_CASES):
        file, _, name = entry.partition("::")
        assert (TESTS / file).exists() and (
            not name or f"def {name}(" in (TESTS / file).read_text("utf-8")
        ), entry
    assert set(model_names()) >= QUICK_MODELS
    assert set(model_names()) == QUICK_MODELS | OTHER_MODELS


@pytest.mark.parametrize(
    ("path", "words", "expected"),
    [
        ("dynamics/test_laws.py", "planar5_nmp@undamped-potential", False),
        ("dynamics/test_laws.py", "manutec_r3_30-potential", True),
        ("dynamics/test_laws.py", "kr300@backlash-potential", True),
        ("order/test_bdf.py", "", True),
        ("model/test_reader.py", "manutec_r3_30", False),
        ("cross/test_symbolic.py", "skew", True),
        ("cross/test_bvp.py", "zeros change", True),
        ("paths/test_paths.py", "", False),
    ],
)
def test_folder_and_model_decide(path, words, expected):
    assert slow(path, words) is expected


def test_no_module_of_tests_imports_another():
    """Helpers live in tests/support."""
    names = {path.stem for path in TESTS.glob("*/test_*.py")}
    for path in TESTS.glob("*/*.py"):
        for found in re.findall(
            r"^\s*from (\w+) import ", path.read_text(encoding="utf-8"), re.MULTILINE
        ):
            assert found not in names, (
                f"{path.name} imports {found}; move the helper to tests/support"
            )
