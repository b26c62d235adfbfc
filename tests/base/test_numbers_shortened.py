"""Messages of errors and short texts of values: where they are cut, and what stands in place of
the rest.
"""

from __future__ import annotations

import json
import pickle
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest

from flexgen.base.checks.counts import show_value
from flexgen.base.display import (
    Figure,
    as_json,
    both_measured,
    duration,
    figure_rows,
    format_size,
    plain,
    short_repr,
    short_text,
    table_html,
)
from flexgen.base.errors import ArgumentError, ModelError, message_of, printable, suggestion


# --- errors --------------------------------------------------------------------------------------
def test_long_messages_have_their_begin_and_their_end() -> None:
    """Of 4000 characters three fifths from the begin and a quarter from the end; the same of 600
    that are given.
    """
    assert message_of("x" * 4000) == "x" * 4000
    text = "a" * 3000 + "b" * 3000
    assert message_of(text) == f"{'a' * 2400} ... (2000 characters) ... {'b' * 1000}"
    for count, cut in ((600, None), (601, 1), (1000, 400)):
        given = "c" * (count - 200) + "d" * 200
        short = (
            given if cut is None else f"{given[:360]} ... ({cut} characters) ... {given[-150:]}"
        )
        assert message_of(f"x: given {given}, expected y") == f"x: given {short}, expected y"
    assert str(ArgumentError("a\x1b[1mb\n\tc")) == "a\\x1b[1mb\n\tc"
    assert printable("é\x00") == "é\\x00" and printable("plain") == "plain"
    assert ArgumentError(3, "x").args == (3, "x")


def test_errors_of_files_have_their_place_and_are_pickled() -> None:
    error = ModelError("a.toml", 7, "motor.m1.ratio", "0", "a number")
    assert str(error) == "a.toml:7:motor.m1.ratio: given 0, expected a number"
    assert str(ModelError("a.toml", 0, "motor", "1", "2")) == "a.toml: motor: given 1, expected 2"
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), vars(again)) == (ModelError, str(error), vars(error))
    assert (again.file, again.line, again.key, again.given, again.expected) == (
        "a.toml",
        7,
        "motor.m1.ratio",
        "0",
        "a number",
    )
    assert (
        suggestion("slove", ["solve", "sweep"]) == "; did you mean 'solve'?"
        and suggestion("xyz", ["solve"]) == ""
    )


# --- values --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.0, "1 m"),
        (0.9995, "1 m"),
        (0.9994, "999 mm"),
        (0.0042, "4.2 mm"),
        (0.99951e-3, "1 mm"),
        (0.9994e-3, "999 um"),
        (9.18e-11, "< 0.1 um"),
        (0.0, "0 um"),
        (None, "-"),
        (float("nan"), "-"),
        (float("inf"), "-"),
        (1234.5, "1.23e+03 m"),
    ],
)
def test_sizes_have_a_prefix(value: float | None, text: str) -> None:
    assert format_size(value, "m") == text


def test_times_and_figures_as_texts() -> None:
    times = ((0.2, "1 s"), (1.4, "1 s"), (99.4, "99 s"), (100.0, "2 min"), (150.1, "3 min"))
    assert all(duration(seconds) == text for seconds, text in times)
    assert (
        both_measured(4.2e-3, 3e-6) == "4.2 mm and 3 urad"
        and both_measured(None, 0.5) == "500 mrad"
    )
    assert both_measured(None, None) == ""
    rows = [
        ("a", 2e-3, "m"),
        ("b", 12.34567, "N m"),
        ("c", 3, "samples"),
        ("d", None, "s"),
        ("e", "", ""),
        ("f", "x", ""),
    ]
    shown = figure_rows(Figure(label, value, unit, label) for label, value, unit in rows)
    assert shown == [("a", "2 mm"), ("b", "12.35 N m"), ("c", "3 samples"), ("f", "x")]
    html = table_html("a<b", [("x", "1 & 2")])
    assert html == "<table><caption>a&lt;b</caption><tr><td>x</td><td>1 &amp; 2</td></tr></table>"


@dataclass
class Point:
    """With a default, and a field that is not shown."""

    x: Any
    name: str = "p"
    kept: Any = field(default=None, repr=False)

    __repr__ = short_repr


def test_values_become_types_of_json() -> None:
    given: dict[Any, Any] = {
        1: np.array([1.5, np.nan]),
        "c": 1 - 2j,
        "p": Path("a/b"),
        "t": (True, None),
        "n": np.float64(2.0),
        "i": np.int64(3),
        "d": Point(np.inf),
        "r": Made(to_dict=lambda: {"x": 1.0}),
        "m": Made(title="robot@soft"),
        "o": {3},
    }
    expected = {
        "1": [1.5, None],
        "c": [1.0, -2.0],
        "p": "a/b",
        "t": [True, None],
        "n": 2.0,
        "i": 3,
        "d": {"x": None, "name": "p", "kept": None},
        "r": {"x": 1.0},
        "m": "robot@soft",
        "o": "{3}",
    }
    assert plain(given) == expected and json.loads(as_json(given)) == expected


def test_short_texts_of_values() -> None:
    assert repr(Point(1)) == "Point(x=1)"
    assert repr(Point([1, 2, 3, 4, 5], "q")) == "Point(x=[1, 2, 3, 4, ...], name='q')"
    assert repr(Point(np.arange(12))) == "Point(x=array([ 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]))"
    assert repr(Point(np.zeros((13, 1)))) == "Point(x=<array 13 x 1>)"
    assert repr(Point((1, 2, 3, 4))) == "Point(x=(1, 2, 3, 4))"
    assert repr(Point(object())) == "Point(x=object)"
    long = repr(Point("y" * 200))
    assert len(long) == len("Point(x=)") + 100 and "..." in long
    named = Made(a="z" * 200)
    assert short_text(named) == f"{repr(named)[:97]}..."
    assert (
        short_text([1, "a", None, 2.5, 6]) == "1, a, , 2.5, ..."
        and short_text((1, 2, 3, 4)) == "1, 2, 3, 4"
    )
    assert (
        short_text({"k": [1, 2]}) == "k: 1, 2"
        and short_text(None) == ""
        and short_text(Path("a")) == "a"
    )


def test_values_in_messages_have_80_characters() -> None:
    assert show_value("x" * 78) == repr("x" * 78)
    assert show_value("x" * 79) == f"'{'x' * 59} ... (81 characters)"
    assert show_value(10**5000) == f"an integer of {(10**5000).bit_length()} bits"
