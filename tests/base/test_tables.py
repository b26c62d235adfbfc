"""Values of tables in TOML: how they are shown, read, and refused with line and expectation."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from flexgen.base.errors import ModelError
from flexgen.base.spec import keys, tables, toml_lines


def table(text: str) -> tables.Table:
    return tables.Table("x.toml", toml_lines.parse(text), "")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ({"a b": [1, 2.5, True]}, '{"a b" = [1, 2.5, true]}'),
        ({"c": 'say "é"\n', "d": {"e": False}}, '{c = "say \\"\\xe9\\"\\n", d = {e = false}}'),
        ("x" * 78, '"' + "x" * 78 + '"'),
        ("x" * 79, '"' + "x" * 76 + "..."),
        pytest.param(10**5000, "a huge number", id="huge"),
    ],
)
def test_values_are_shown_as_in_a_model_file(value: Any, text: str) -> None:
    assert tables.show(value) == text


@pytest.mark.parametrize(
    ("word", "known", "text"),
    [
        ("mas", ["mass", "com"], "mass (there are: com, mass)"),
        ("zzz", ["mass", "com"], "one of com, mass"),
        ("a", [], "no key"),
    ],
)
def test_similar_keys_are_suggested(word: str, known: list[str], text: str) -> None:
    assert tables.closest(word, known) == text
    assert tables.bare("a-b_1[0]") == "a-b_1[0]" and tables.bare("a b") == '"a b"'


Read = Callable[[tables.Table], Any]
TEXT = 'v = [3, 4, 0]\na_deg = 180\nb_rad = 2\nc = "line"\nq_deg = [90, 5]'
GOOD: list[tuple[Read, Any]] = [
    (lambda t: t.vector("v", 3), (3.0, 4.0, 0.0)),
    (lambda t: t.vector("v", 3, default=(1,)), (3.0, 4.0, 0.0)),
    (lambda t: t.vector("w", 3, default=(1,)), (1,)),
    (lambda t: t.axis("v"), (0.6, 0.8, 0.0)),
    (lambda t: t.angle("a"), math.pi),
    (lambda t: t.angle("b"), 2.0),
    (lambda t: t.angle("none"), None),
    (lambda t: t.angles("q", [True, False]), (math.pi / 2, 5.0)),
    (lambda t: t.choice("c", ("line", "arc"), default="arc"), "line"),
    (lambda t: t.choice("d", ("line", "arc"), default="arc"), "arc"),
    (lambda t: t.unit_key("none", required=False), None),
    (lambda t: ("v" in t, "w" in t), (True, False)),
    (lambda t: t.path(None), ""),
]


@pytest.mark.parametrize(("read", "value"), GOOD)
def test_values_of_tables_and_their_defaults(read: Read, value: Any) -> None:
    assert read(table(TEXT)) == value


BAD: list[tuple[str, Read, str]] = [
    (
        "v = [1, 2]",
        lambda t: t.vector("v", 3),
        r"x.toml:1:v: given \[1, 2\], expected a list of 3",
    ),
    ("v = [1, 2]", lambda t: t.vector("v", [1, 3]), "expected a list of 1 or 3 numbers"),
    (
        "v = [1, 2]",
        lambda t: t.vector("v", range(3, 6), what="each"),
        r"expected a list of 3 to 5 numbers \(each\)",
    ),
    ("v = 5", lambda t: t.vector("v", 1), "given 5, expected a list of 1 number$"),
    ('v = [1,\n"a"]', lambda t: t.vector("v", 2), r"x.toml:2:v: given \[1, \"a\"\], expected a l"),
    ("v = [0, 0, 0]", lambda t: t.axis("v"), "expected a direction that is not zero"),
    (
        "a_rad = 1\na_deg = 2",
        lambda t: t.angle("a"),
        "x.toml:2:a_deg: given both a_rad and a_deg, expected one of",
    ),
    ("", lambda t: t.angles("a", [True]), "a_rad or a_deg"),
    (
        'c = "lin"',
        lambda t: t.choice("c", ("line", "arc")),
        r"given \"lin\", expected line \(there are: arc, line\)",
    ),
    ("c = 3", lambda t: t.choice("c", ("line", "arc")), "given 3, expected one of arc, line"),
    ('c = "a\\u0007"', lambda t: t.text("c"), "expected text without control characters"),
    ("f = 1", lambda t: t.flag("f"), "given 1, expected true or false"),
]


@pytest.mark.parametrize(("text", "read", "told"), BAD)
def test_wrong_values_are_named_with_line_and_expectation(
    text: str, read: Read, told: str
) -> None:
    with pytest.raises(ModelError, match=told):
        read(table(text))


@pytest.mark.parametrize(
    ("key", "place"),
    [
        ("lower", ("joint[0].lower_deg", 9)),
        ("axis", ("joint[0].axis", 8)),
        ("upper", ("joint[0].upper", 7)),
    ],
)
def test_the_line_of_a_key_is_found_with_its_unit(key: str, place: tuple[str, int]) -> None:
    where = tables.Where("f", 7, "joint[0]", (("lower_deg", 9), ("axis", 8)))
    assert where.find(key) == place


def test_entries_have_the_line_in_which_they_begin() -> None:
    text = "a = 1\n[x.y]\nb = [1,\n2]\n[[m]]\nc = 1\n[[m]]\nd = 2\n[m.n]\ne = 3\n"
    root = toml_lines.parse(text)
    y = root.value["x"].value["y"]
    m = root.value["m"].value
    assert (y.line, y.value["b"].line, y.value["b"].value[1].line) == (2, 3, 4)
    assert [entry.line for entry in m] == [5, 7] and m[1].value["n"].value["e"].line == 10


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a = 1\na = 12345", "line 2: given a line of 9 characters, expected at most 8"),
        ("a = 1\nb = = 2", r"line 2: given text that is not TOML \("),
        ("a = 1234", ""),
    ],
)
def test_long_lines_and_other_texts_are_refused(text: str, told: str) -> None:
    if not told:
        assert toml_lines.parse(text, width=8).value["a"].value == 1234
        return
    with pytest.raises(toml_lines.TextError, match=told):
        toml_lines.parse(text, width=8)


NUMBER = {"type": "number"}


@pytest.mark.parametrize(
    ("lengths", "more"),
    [
        ((), {}),
        ((3,), {"minItems": 3, "maxItems": 3}),
        ((range(2, 6),), {"minItems": 2, "maxItems": 5}),
        ((3, 6), {"anyOf": [{"minItems": n, "maxItems": n} for n in (3, 6)]}),
    ],
)
def test_schemas_of_lists_have_the_lengths_that_are_read(lengths: Any, more: Any) -> None:
    assert keys.list_of(NUMBER, *lengths) == {"type": "array", "items": NUMBER} | more
    schema = keys.direction().schema
    assert (schema["minItems"], schema["maxItems"]) == (3, 3)
    assert keys.whole(2, 5).schema == {"type": "integer", "minimum": 2, "maximum": 5}
