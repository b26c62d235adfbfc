"""Each key of a file is stated once: in its row. The page of keys is that of the rows."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from key_page import OTHERS, TABLES

import flexgen
from flexgen.base.spec import units
from flexgen.base.spec.keys import Form, Key, Kinds
from flexgen.identification.records import experiment_file
from flexgen.identification.records import keys as records
from flexgen.model.elements import Motor
from flexgen.model.format.format_robot import BODY, SPRING
from flexgen.model.reader import read

ROOT = Path(__file__).resolve().parents[2]
READERS = {
    "number",
    "optional",
    "whole",
    "vector",
    "axis",
    "angle",
    "angles",
    "text",
    "flag",
    "choice",
    "words",
    "name",
}
# Files that may read keys by name: what a row cannot say in data.
ROWS = tuple(
    f"flexgen/{path}"
    for path in ("model/format", "loop/controller_f", "sweeps/grid_f", "benchmarks/scenario_f")
)
SHORT = 20  # characters of a text that may occur twice by chance


def keys_of(form: Form) -> Iterator[Key]:
    """All rows of a table."""
    if isinstance(form, Kinds):
        yield from form.shared
        for own in form.kinds.values():
            yield from own.keys
    else:
        yield from form.keys


def stated_twice(tables: Mapping[str, Form], sources: Mapping[str, str]) -> list[str]:
    """Rows that are written twice, texts of keys that are, and keys that are read outside of the
    rows.
    """
    rows = [key for form in tables.values() for key in keys_of(form)]
    names = {name for key in rows for name in (*key.names, key.name)}
    docs = {key.doc for key in rows if len(key.doc) >= SHORT}
    found: Counter[str] = Counter()
    out = []
    for path, text in sources.items():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Constant) and node.value in docs:
                found[f"text of a key: {node.value}"] += 1
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Name)
                and node.func.id == "Key"
            ):
                found[f"row: {ast.unparse(node)}"] += 1
            if not path.startswith(ROWS):
                out += [
                    f"{path}:{line} reads the key {key}"
                    for line, key in read_by_name(node)
                    if key in names
                ]
    return out + [f"{count} times a {what}" for what, count in found.items() if count > 1]


def read_by_name(node: ast.AST) -> Iterable[tuple[int, str]]:
    """Keys that a call reads with their type or bounds."""
    if (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in READERS
        and node.args
    ):
        first = node.args[0]
        if isinstance(first, ast.Constant) and isinstance(first.value, str):
            yield node.lineno, first.value


@pytest.fixture(scope="module")
def sources() -> dict[str, str]:
    """The sources of the readers and writers of model files."""
    paths = [
        path
        for room in (
            "model",
            "exports",
            "base/spec",
            "feedback/loop",
            "studies/sweeps",
            "studies/scenarios",
        )
        for path in (ROOT / "flexgen" / room).rglob("*.py")
    ]
    return {
        path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
        for path in sorted(paths)
    }


def test_each_key_is_stated_once(sources: dict[str, str]) -> None:
    assert stated_twice(TABLES | OTHERS, sources) == []


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('Key("to", number())\nKey("to", number())', "2 times a row: Key('to', number())"),
        (
            'mass = table.number("mass", least=0.0)',
            "flexgen/model/planted.py:1 reads the key mass",
        ),
        (repr(BODY["com"].doc), "2 times a text of a key: center of mass in the body frame"),
    ],
)
def test_planted_second_statement_is_found(
    sources: dict[str, str], text: str, expected: str
) -> None:
    few = {
        path: sources[path]
        for path in ("flexgen/model/format/format_robot.py", "flexgen/model/urdf/overlay.py")
    }
    assert stated_twice(TABLES, few | {"flexgen/model/planted.py": text}) == [expected]


def test_units_of_recordings_on_the_pages_are_those_that_are_read() -> None:
    """Each kind in its row; `docs/records.md` has all of them."""
    text = (ROOT / "docs" / "records.md").read_text(encoding="utf-8")
    for si in ("s", "rad", "m", "rad/s", "m/s", "N m", "N"):
        assert all(f"`{unit}`" in text for unit in units.FACTORS[si])
    rows = {table.title: {r.key: r.value for r in table.rows} for table in records.TABLES}
    named = {
        "`[time]`": {"s"},
        "`[[torque]]`": {"N m", "N"},
        "`[[angle]]`, `[[reference]]`": {"rad", "m"},
    }
    for title, kinds in named.items():
        found = set(re.findall(r"`([^`]*)`", rows[title]["unit"].replace('`side = "arm"`', "")))
        expected = {unit for si in kinds for unit in units.FACTORS[si]}
        assert found == expected | (set(units.ELECTRIC) if "N m" in kinds else set())
    drive = set(rows["`[drive]`"])
    assert drive == {*experiment_file.GAINS, *experiment_file.NOISES, "low_pass", "notch"}


def springs_of(text: str) -> dict[str, tuple[str, ...]]:
    """Keys of each type of spring in the table of the page on model files."""
    rows = re.findall(r"^\| `(\w+)` \| ([a-z_, ]+) \| ", text, re.MULTILINE)
    return {kind: tuple(keys.split(", ")) for kind, keys in rows}


def test_table_of_springs_in_the_readme_is_that_of_the_rows() -> None:
    text = (ROOT / "models" / "README.md").read_text(encoding="utf-8")
    assert springs_of(text) == {kind: form.names for kind, form in SPRING.kinds.items()}
    assert springs_of(text.replace("stiffness, gap, smoothing", "stiffness, gap")) != springs_of(
        text
    )


@dataclass(frozen=True)
class _StrongMotor(Motor):
    power_max: float | None = None  # as a new key would add it


def test_a_new_attribute_of_a_motor_is_in_its_description() -> None:
    model = read("elbow")
    motors = tuple(_StrongMotor(**vars(motor), power_max=90.0) for motor in model.motors)
    before, after = (
        flexgen.describe(m)["motors"][0] for m in (model, replace(model, motors=motors))
    )
    assert after == before | {"power_max": 90.0}
