"""The selection of the quick tests: its tables name what is there, and every room of flexgen has a
quick test.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import pytest
from durations import Recorded, parts_of, read, updated, write
from selection import OPTIMIZED, RECORDED, ROOT, SLOW, UNOPTIMIZED, full, slow

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
        if quick and not slow(path.relative_to(TESTS).as_posix(), "", ""):
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
    for entry in (*SLOW, *UNOPTIMIZED, *OPTIMIZED):
        file, _, name = entry.partition("::")
        assert (TESTS / file).exists() and (
            not name or f"def {name}(" in (TESTS / file).read_text("utf-8")
        ), entry


def test_the_durations_are_those_of_existing_tests():
    """A name that no test has was renamed: its cases would be quick without a word."""
    files = {path.name: path for path in TESTS.glob("*/test_*.py")}
    assert set(RECORDED.laws) <= set(files)
    for table in (RECORDED.full, RECORDED.slow):
        for file, functions in table.items():
            text = files[file].read_text(encoding="utf-8")
            assert [name for name in functions if f"def {name}(" not in text] == [], file


def paths_in(table: Mapping[str, Mapping[str, Iterable[str]]]) -> list[str]:
    """Ids of cases with the path of a clone: no test has them in another folder."""
    ids = [words for tests in table.values() for cases in tests.values() for words in cases]
    return [words for words in ids if words.startswith("/")]


def test_no_record_has_the_path_of_a_clone():
    assert paths_in(RECORDED.full) + paths_in(RECORDED.slow) == []
    planted = f"{TESTS}/support/robots/ur5_elastic.toml-line"
    assert paths_in({"test_a.py": {"test_b": ["elbow", planted]}}) == [planted]


def test_file_and_duration_decide():
    """A folder of slow tests, a recorded case, a test without a record."""
    file, functions = next(iter(RECORDED.slow.items()))
    name, cases = next(iter(functions.items()))
    words = next(iter(cases))
    assert slow("order/test_bdf.py", "test_new", "")
    assert slow(f"anywhere/{file}", name, words)
    assert not slow(f"anywhere/{file}", name, "a case without a record")
    assert not slow(f"anywhere/{file}", "test_new", words)
    assert not slow("unit/test_new.py", name, words)
    assert not full("unit/test_new.py", name, words)


BEFORE = Recorded(
    ["test_laws.py"],
    {"test_b.py": {"test_two": ["big"]}},
    {"test_a.py": {"test_one": {"x": None, "y": 5.0, "z": 4.0}}},
)


@pytest.mark.parametrize(
    ("test", "seconds", "expected"),
    [
        ("unit/test_a.py::test_one[x]", 0.5, {"x": 0.5, "y": 5.0, "z": 4.0}),
        ("unit/test_a.py::test_one[x]", 0.3, {"y": 5.0, "z": 4.0}),
        ("unit/test_a.py::test_one[w]", 0.55, {"x": None, "y": 5.0, "z": 4.0}),
        ("unit/test_a.py::test_one[w-[1]]", 3.14, {"x": None, "y": 5.0, "z": 4.0, "w-[1]": 3.1}),
    ],
)
def test_a_run_changes_what_it_measured(test, seconds, expected):
    """A slow case becomes quick below 0.4 s, a quick one slow above 0.6 s."""
    after = updated(BEFORE, {test: seconds}, [])
    assert after == Recorded(BEFORE.laws, BEFORE.full, {"test_a.py": {"test_one": expected}})


def test_the_shortest_case_of_a_law_stays_quick():
    tests = {
        "dynamics/test_laws.py::test_energy[a]": 0.9,
        "dynamics/test_laws.py::test_energy[b]": 0.9,
    }
    shortest = ["dynamics/test_laws.py::test_energy[a]"]
    assert updated(BEFORE, tests, shortest).slow["test_laws.py"] == {"test_energy": {"b": 0.9}}
    tests[shortest[0]] = 1.2
    assert updated(BEFORE, tests, shortest).slow["test_laws.py"]["test_energy"] == {
        "a": 1.2,
        "b": 0.9,
    }


def test_durations_are_read_as_they_were_written(tmp_path):
    write(BEFORE, tmp_path / "durations.json")
    assert read(tmp_path / "durations.json") == BEFORE
    assert parts_of("unit/test_a.py::test_one[w-[1]]") == ("test_a.py", "test_one", "w-[1]")
    assert parts_of("test_a.py::test_one") == ("test_a.py", "test_one", "")


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
