"""Numbers, roots and tables as plain text, at most as wide as the terminal."""

from __future__ import annotations

import math
from typing import Any

import pytest

from flexgen.base.display import number, roots
from flexgen.views.reports.text_tables import (
    figures,
    fit_tables,
    paragraph,
    table,
    terminal_width,
)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"),
        (True, "yes"),
        (False, "no"),
        (math.nan, "-"),
        (math.inf, "-"),
        (12345, "12345"),
        ("x", "x"),
        (0.123456, "0.1235"),
        (999.94, "999.9"),
        (999.96, "1000"),
        (-1234.5678, "-1235"),  # no digits behind the point from 1000 to 1e7
        (9999999.0, "9999999"),
        (-1e7, "-1e+07"),
    ],
)
def test_numbers_have_four_digits(value: Any, text: str) -> None:
    assert number(value) == text
    assert number(0.123456, 2) == "0.12"


def test_a_pair_of_roots_is_one_text_and_equal_roots_are_counted() -> None:
    found = roots([[1.0, 2.0], [1.0, -2.0], [-3.0, 0.0], [-3.0, 0.0], [None, None], [0.5, 0]])
    assert found == ["1 +/- 2i", "-3 (2 times)", "-", "0.5"]


ROWS = [["first", 1.5, None, "a b"], ["second name", 22.25, 3, "c"]]
HEAD = ("what", "x", "n", "text")


def test_columns_of_numbers_end_and_those_of_words_begin_at_one_character() -> None:
    lines = table(ROWS, HEAD).splitlines()
    assert lines == [
        "what             x  n  text",
        "-----------  -----  -  ----",
        "first          1.5  -  a b",
        "second name  22.25  3  c",
    ]
    assert table(ROWS).splitlines() == lines[2:]
    assert table([]) == "" and table([], ("a", "bc")).splitlines() == ["a  bc", "-  --"]
    assert figures([("a", 1.5, "m"), ("b", None, "s"), ("c", True, "")]).splitlines() == [
        "quantity  value  unit",
        "--------  -----  ----",
        "a         1.5    m",
        "c         yes",
    ]


LONG = [["a sentence of seven words in all", 1.0, "short", 2.0]]
NAMES = ("what", "x", "y", "z")


@pytest.mark.parametrize(
    ("width", "head", "columns", "left_out"),
    [
        (41, NAMES, 4, ""),
        (22, NAMES, 2, "y, z"),
        (22, (), 2, "2 columns"),
        (8, NAMES, 1, "x, y, z"),
        (8, (), 1, "3 columns"),
    ],
)
def test_a_table_fits_its_terminal(
    width: int, head: tuple[str, ...], columns: int, left_out: str
) -> None:
    """Texts are wrapped to 16 characters, then the last columns are left out, and named."""
    with fit_tables(width):
        text = table(LONG, head)
    body, _, note = text.partition("(left")
    assert max(map(len, text.splitlines())) <= width
    kept = [*NAMES[:columns]] * bool(head)
    assert body.split()[: len(kept)] == kept
    words = body.replace("-", "").split()[len(kept) :]
    sentence = [word for word in words if word.islower() and word != "short"]
    assert " ".join(sentence) == LONG[0][0]
    told = f"out:{left_out};awiderterminal,apipeor--jsonshowsall)" if left_out else ""
    assert "".join(note.split()) == told.replace(" ", "")


def test_paragraphs_are_wrapped_to_the_terminal() -> None:
    with fit_tables(12):
        assert paragraph("one two three") == "one two\nthree"
    assert paragraph("one two three") == "one two three" and terminal_width() is None
