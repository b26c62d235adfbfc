"""The JSON schema of model files accepts what the reader accepts, key by key, and knows every key
of the reader.
"""

from __future__ import annotations

import copy
import json
import re
import tomllib
from pathlib import Path

import jsonschema
import pytest
from model_files import everything, overlay

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.spec.ports import identifier_problem
from flexgen.base.spec.tables import IDENTIFIER, Table
from flexgen.base.spec.toml_lines import Entry
from flexgen.cli.main import main
from flexgen.model import reader
from flexgen.model.format.format import MODEL
from flexgen.model.urdf import overlay as overlay_module
from flexgen.paths import move_files

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted(
    [*(ROOT / "models").glob("*.toml"), *(ROOT / "tests" / "support" / "robots").glob("*.toml")]
)
PROGRAM = ROOT / "examples" / "program.toml"

# --- a walk through a file and the schema at once ------------------------------------------------


def branches(schema: dict, root: dict) -> list[dict]:
    """The tables that a schema can be: references resolved, kinds spread out."""
    if "$ref" in schema:
        return branches(root["definitions"][schema["$ref"].rpartition("/")[2]], root)
    if "allOf" in schema:
        return branches(schema["allOf"][0], root)
    for word in ("oneOf", "anyOf"):
        if word in schema and "properties" not in schema:
            return [b for inner in schema[word] for b in branches(inner, root)]
    return [schema]


def compare(
    entry: Entry, schema: dict, root: dict, known: dict[int, tuple], seen: set[int]
) -> None:
    """Compare the keys that the reader accepts in each table with those of the schema."""
    options = branches(schema, root)
    if isinstance(entry.value, list):
        items = [option["items"] for option in options if "items" in option]
        for item in entry.value:
            if isinstance(item.value, dict):
                compare(item, items[0], root, known, seen)
        return
    if not isinstance(entry.value, dict):
        return
    tables = [option for option in options if option.get("type") == "object"]
    kind = entry.value.get("type")
    fitting = [
        t
        for t in tables
        if (kind is None and "type" not in t.get("required", ()))
        or (
            kind is not None
            and t.get("properties", {}).get("type", {}).get("const", kind.value) == kind.value
        )
    ]
    assert fitting, (kind, schema)
    # else its keys are names
    if id(entry.value) in known and any("properties" in t for t in tables):
        last, here, _ = known[id(entry.value)]
        # the reader refuses some combinations after it has accepted the key: both a spring and a
        # gear
        unions = [set().union(*(t["properties"] for t in group)) for group in (fitting, tables)]
        assert set(last) in unions, (
            f"{here}: the reader knows {sorted(last)}, the schema {sorted(unions[0])}"
        )
        seen.update(id(t) for t in fitting)
    for key, item in entry.value.items():
        inner = [t.get("properties", {}).get(key, t.get("additionalProperties")) for t in fitting]
        for one in inner:
            if isinstance(one, dict):
                compare(item, one, root, known, seen)
                break


@pytest.fixture
def recorded(monkeypatch):
    """Keys allowed by the calls of `Table.only`, by the identity of the table, and the trees of
    the files that were read.
    """
    known: dict[int, tuple] = {}
    trees: list[Entry] = []
    only = Table.only
    parse = reader.parse_file
    expand = overlay_module.expand

    def recording(self, *keys):
        before = known.get(id(self.entries), (keys,))[0]
        # what all calls allow; the table itself is kept, so that its id stays its own
        known[id(self.entries)] = ([key for key in keys if key in before], self.key, self.entries)
        only(self, *keys)

    def parsed(*args):
        root = parse(*args)
        # the reader takes the variants out
        trees.append(Entry(dict(root.value), root.line, root.file))
        return root

    def expanded(root, folder, shown):
        # before the URDF file takes its place
        trees.append(Entry(dict(root.value), root.line, root.file))
        return expand(root, folder, shown)

    monkeypatch.setattr(Table, "only", recording)
    monkeypatch.setattr(reader, "parse_file", parsed)
    monkeypatch.setattr(move_files, "parse_file", parsed)
    monkeypatch.setattr(overlay_module, "expand", expanded)
    return known, trees


def all_tables(schema: dict) -> dict[int, dict]:
    """Every table of the schema whose keys are those of the format, not names."""
    out = {}
    todo = [schema]
    while todo:
        here = todo.pop()
        if isinstance(here, dict):
            if here.get("type") == "object" and here.get("additionalProperties") is False:
                out[id(here)] = here
            todo += here.values()
        elif isinstance(here, list):
            todo += here
    return out


def test_every_key_of_the_reader_and_no_other(recorded, tmp_path):
    known, trees = recorded
    root = flexgen.schema()
    seen = {id(root)}
    for path in [*FILES, everything(tmp_path), overlay(tmp_path)]:
        trees.clear()
        flexgen.read(path)
        compare(trees[-1], root, root, known, seen)
        if len(trees) > 1:  # of an overlay the tree before it was expanded, and its variants
            compare(trees[0], root, root, known, seen)
    assert set(root["properties"]) == {*MODEL.names, "urdf", "joint", "link", "variant"}
    # the motor of a joint of a URDF file is read as one of the list, without the key drives
    motor = root["properties"]["joint"]["additionalProperties"]["properties"]["motor"]
    assert set(motor["properties"]) == set(root["properties"]["motor"]["items"]["properties"]) - {
        "drives"
    }
    unread = [
        table["description"]
        for key, table in all_tables(root).items()
        if key not in {*seen, id(motor)}
    ]
    assert unread == [], "add a table of this type to `everything` of tests/support/model_files.py"


def test_a_missing_key_is_seen(recorded, tmp_path):
    """Planted: a schema without one key, and one with a key more."""
    known, trees = recorded
    flexgen.read(everything(tmp_path))
    for change in (lambda keys: keys.pop("torque_max"), lambda keys: keys.update(brake={})):
        root = copy.deepcopy(flexgen.schema())
        change(root["properties"]["motor"]["items"]["properties"])
        with pytest.raises(AssertionError, match="the reader knows"):
            compare(trees[0], root, root, known, set())


# --- files ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def validator():
    schema = flexgen.schema()
    jsonschema.Draft7Validator.check_schema(schema)
    return jsonschema.Draft7Validator(schema)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_files_are_valid(path, validator):
    assert [
        error.message for error in validator.iter_errors(tomllib.loads(path.read_text()))
    ] == []


def test_all_kinds_of_tables_are_valid(tmp_path, validator):
    data = tomllib.loads(everything(tmp_path).read_text())
    assert [error.message[:200] for error in validator.iter_errors(data)] == []
    program = jsonschema.Draft7Validator(flexgen.schema("program"))
    assert not list(program.iter_errors(tomllib.loads(PROGRAM.read_text())))
    assert list(program.iter_errors(data))


def tables_in(data, path=()):
    """Every table of a document with its path, without those of free keys."""
    if isinstance(data, dict):
        if (
            path[-1:] != ("set",)
            and path not in (("joint",), ("link",), ("variant",))
            and "rows" not in path
        ):
            yield path, data
        for key, value in data.items():
            if key not in ("set", "lock", "rows"):
                yield from tables_in(value, (*path, key))
    elif isinstance(data, list):
        for k, value in enumerate(data):
            yield from tables_in(value, (*path, k))


def test_unknown_keys_are_invalid_in_every_table(tmp_path, validator):
    for path in (
        everything(tmp_path),
        ROOT / "models" / "urdf_arm.toml",
        ROOT / "models" / "four_mass.toml",
    ):
        data = tomllib.loads(path.read_text())
        for _, table in tables_in(data):
            table["nosuch"] = 1
            assert not validator.is_valid(data)
            del table["nosuch"]
        assert validator.is_valid(data)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("mass = 2", 'mass = "two"'),
        ("mass = 2", "mass = -2"),
        ('type = "elastic"', 'type = "soft"'),
        ("inertia = [1, 1, 1]", "inertia = [1, 1, 1, 1]"),
        ('name = "e0"', 'name = "0e"'),
        ('name = "e0"', 'name = "a__b"'),
        ("modes = 1", "modes = 9"),
        ("modes = 1", "modes = 1.5"),
        ("profile = [0.5, 5, 50]", "profile = [0.5]"),
        ("degree = 7", "degree = 8"),
        ('unit = "deg/s"', 'unit = "m"'),
        ("smoothness = 5", "smoothness = 2"),
        ("gravity = [0, 0, -9.81]\n", ""),
        ("ratio = 100", "ratio = true"),
    ],
)
def test_what_the_reader_refuses_is_invalid(old, new, tmp_path, validator):
    path = everything(tmp_path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    assert not validator.is_valid(tomllib.loads(path.read_text()))
    with pytest.raises(ModelError):
        flexgen.read(path)


@pytest.mark.parametrize(
    "name", ["a", "A1_b", "a" * 31, "a" * 32, "1a", "_a", "a__b", "a-b", "a b", ""]
)
def test_names(name):
    assert (re.search(IDENTIFIER, name) is not None) == (identifier_problem(name) is None)


def test_every_key_is_explained():
    """Hover shows a text at each key of each table."""
    for table in all_tables(flexgen.schema()).values():
        for key, schema in table["properties"].items():
            assert schema.get("description"), (table["description"], key)


def test_command_line(tmp_path, capsys):
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == flexgen.schema()
    out = tmp_path / "flexgen.schema.json"
    assert main(["schema", "program", "--out", str(out)]) == 0
    assert json.loads(out.read_text()) == flexgen.schema("program")
    with pytest.raises(ArgumentError, match="model, program"):
        flexgen.schema("robot")
