"""Texts of errors: printable, of bounded length, with the place in a file; pickled as they are."""

from __future__ import annotations

import pickle

import pytest

from flexgen.base.errors import (
    ArgumentError,
    ModelError,
    message_of,
    printable,
    suggestion,
)


@pytest.mark.parametrize(("most", "around"), [(4000, ""), (600, "x: given {}, expected y")])
def test_long_texts_have_their_beginning_and_their_end(most: int, around: str) -> None:
    """Three fifths of the bound from the beginning, a quarter from the end; what is given has a
    bound of its own.
    """
    frame = around or "{}"
    whole = "a" * (most // 2) + "b" * (most // 2)
    assert message_of(frame.format(whole)) == frame.format(whole)
    for more in (1, most):
        long = "a" * (most // 2 + more) + "b" * (most // 2)
        short = f"{long[: most * 3 // 5]} ... ({more} characters) ... {long[-most // 4 :]}"
        assert message_of(frame.format(long)) == frame.format(short)


def test_control_characters_are_escaped() -> None:
    """Lines and tabs stay; other arguments of an error too."""
    assert str(ArgumentError("a\x1b[1mb\n\tc")) == "a\\x1b[1mb\n\tc"
    assert printable("é\x00") == "é\\x00" and printable("plain") == "plain"
    assert ArgumentError(3, "x").args == (3, "x")


@pytest.mark.parametrize(("line", "place"), [(7, "a.toml:7:motor"), (0, "a.toml: motor")])
def test_errors_of_files_have_their_place_and_are_pickled(line: int, place: str) -> None:
    error = ModelError("a.toml", line, "motor", "0", "a number")
    assert str(error) == f"{place}: given 0, expected a number"
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), vars(again)) == (ModelError, str(error), vars(error))
    assert vars(again) == {
        "file": "a.toml",
        "line": line,
        "key": "motor",
        "given": "0",
        "expected": "a number",
    }


def test_similar_words_are_suggested() -> None:
    assert suggestion("slove", ["solve", "sweep"]) == "; did you mean 'solve'?"
    assert suggestion("xyz", ["solve"]) == ""
