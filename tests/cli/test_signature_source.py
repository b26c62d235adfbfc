"""Signatures read from the text of modules are those that Python has."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path
from typing import Any

import pytest

import flexgen
from flexgen.cli.verb_tables.signature_source import constant, definition, signature_of
from flexgen.cli.verb_tables.verbs import VERBS

FUNCTIONS = sorted({verb.function for verb in VERBS.values() if verb.function})
MODULES = {
    "__init__": "",
    "drawn_a": "from flexgen.drawn_b import C as D, E\nfrom flexgen import drawn_b\n"
    "from json import loads\nif True:\n    from flexgen.drawn_b import Late\n"
    "F = 2.5\nG, H = 1, 2\nK: int = 4\n",
    "drawn_b": "C = 3\nE = [1, 'x']\nI = f(2)\nLate = Literal['a', 'b']\n",
}


@pytest.fixture
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, text in MODULES.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.setattr(flexgen, "__file__", str(tmp_path / "__init__.py"))


def parsed(word: str) -> ast.expr:
    return ast.parse(word, mode="eval").body


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("D", 3),
        ("E", [1, "x"]),
        ("F", 2.5),
        ("H", 2),
        ("K", 4),
        ("-4.5", -4.5),
        ("'text'", "text"),
        ("C", None),
        ("loads", None),
        ("f(1)", None),
        ("None", None),
    ],
)
def test_defaults_are_literals_or_constants_of_modules(
    written: None, word: str, value: Any
) -> None:
    assert constant("flexgen.drawn_a", parsed(word)) == value
    assert constant("flexgen.drawn_b", parsed("I")) is None


def test_types_are_found_in_the_module_that_defines_them(written: None) -> None:
    for word in ("Late", "drawn_b.Late"):
        found = definition("flexgen.drawn_a", parsed(word))
        assert found is not None
        assert found[0] == "flexgen.drawn_b" and ast.unparse(found[1]) == "Literal['a', 'b']"


@pytest.mark.parametrize("function", FUNCTIONS)
def test_parameters_are_those_of_the_function(function: str) -> None:
    read = signature_of(function)
    called = inspect.signature(getattr(flexgen, function))
    assert list(read.parameters) == list(called.parameters)
    for name, parameter in called.parameters.items():
        annotation = read.parameters[name].annotation
        assert annotation is not None
        assert ast.unparse(annotation) == ast.unparse(parsed(parameter.annotation)), name
        assert (read.parameters[name].default is None) == (parameter.default is parameter.empty)
    assert read.summary == " ".join(
        str(inspect.getdoc(getattr(flexgen, function))).partition("\n\n")[0].split()
    )
