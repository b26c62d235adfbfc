"""Checks of types at public entrances: what passes, what is refused, and what a decorated function
keeps.
"""

from __future__ import annotations

import importlib
import inspect
import os
import pickle
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
import pytest
from public_entrances import entrances

import flexgen
from flexgen.base.checks.type_checks import (
    checked_class,
    checked_methods,
    checked_result,
    checked_types,
    checks_of,
)
from flexgen.base.checks.types_of_values import LateClass, Names, check_of
from flexgen.base.errors import ArgumentError, SolverError

PASSES = {
    "number": (float, [1, 1.0, np.float32(1), np.int64(1), np.array(1.0), Fraction(1, 3)]),
    "whole number": (int, [0, -3, np.int64(2), np.uint8(2)]),
    "bool": (bool, [True, False, np.True_]),
    "text": (str, ["", "x", np.str_("x"), "\u00e4"]),
    "path": (str | Path, ["x", Path("x")]),
    "folder": (str | os.PathLike[str] | None, ["x", Path("x"), None]),
    "bounds": (
        Sequence[float],
        [
            (),
            [1, np.inf],
            (1.0,),
            np.ones(2),
            range(3),
            deque([1.0]),
            {"a": 1.0}.values(),
            np.array([1, 2]),
        ],
    ),
    "names": (Sequence[str], [["a"], ("a", "b"), {"a": 1}.keys(), np.array(["a"])]),
    "array": (np.ndarray, [1.0, [1, 2], np.eye(2), ((1.0,), (2.0,)), np.array([True])]),
    "vector": (tuple[float, float], [(1, 2), [1.0, 2.0], np.zeros(2)]),
    "iterable": (Iterable[float], [[1.0], (x for x in "ab"), iter([])]),
    "mapping": (Mapping[str, float], [{}, {"a": 1}, MappingProxyType({"a": 1.0})]),
    "function": (Callable[[str], None], [print, len, str]),
    "choice": (Literal["a", 2], ["a", 2, np.int64(2), np.str_("a")]),
    "choice_or_off": (Literal["a", False], ["a", False]),
}
REFUSED = {
    "number": (float, [True, np.True_, "1", None, np.nan, np.inf, 1j, np.ones(1), 10**400, b"1"]),
    "whole number": (int, [True, 1.0, "1", None, 2**63]),
    "bool": (bool, [0, 1, "yes", None, np.int64(1), 1.0]),
    "text": (str, [b"x", None, 1, "a\0b", "\ud800", Path("x")]),
    "path": (str | Path, [None, b"x", 1, Path("a\0")]),
    "bounds": (
        Sequence[float],
        ["12", b"12", 1.0, None, [np.nan], [None], {1.0}, {1.0: 2}, np.eye(2), [True]],
    ),
    "names": (Sequence[str], ["ab", [1], [b"a"]]),
    "array": (
        np.ndarray,
        ["x", None, [np.nan], [[1], [1, 2]], {"a": 1}, np.array([None]), np.ones(1) * 1j, b"x"],
    ),
    "vector": (tuple[float, float], [(1,), (1, 2, 3), "ab", None]),
    "iterable": (Iterable[float], ["ab", 1.0, ["a"], {}]),
    "mapping": (
        Mapping[str, float],
        [None, [("a", 1)], {1: 1}, {"a": "b"}, {"a": np.nan, "b": "x"}],
    ),
    "function": (Callable[[str], None], [None, "print"]),
    "choice": (Literal["a", 2], ["b", 3, True, None, ["a"], np.array(["a"])]),
    "choice_or_off": (Literal["a", False], ["b", 0, np.int64(0), 1, True, None, ["a"]]),
}


@pytest.mark.parametrize("name", PASSES)
def test_values_of_the_type_pass(name: str) -> None:
    annotation, values = PASSES[name]
    check = check_of(annotation)
    assert check is not None and [value for value in values if not check.passes(value)] == []


@pytest.mark.parametrize("name", REFUSED)
def test_values_of_other_types_are_refused(name: str) -> None:
    annotation, values = REFUSED[name]
    check = check_of(annotation)
    assert check is not None and [value for value in values if check.passes(value)] == []


def test_a_decorated_function_keeps_name_signature_documentation_and_pickles() -> None:
    def verb(x: float, *rest: int, flag: bool = False) -> str:
        """Text."""
        return f"{x} {rest} {flag}"

    call = checked_types(verb)
    assert (
        inspect.signature(call) == inspect.signature(verb)
        and call.__doc__ == "Text."
        and call.__name__ == "verb"
    )
    assert call(1, 2, 3, flag=np.True_) == "1 (2, 3) True"
    for wrong in (lambda: call("1"), lambda: call(1.0, 2.5), lambda: call(1.0, flag=1)):
        with pytest.raises(ArgumentError):
            wrong()
    with pytest.raises(TypeError):
        call()  # type: ignore[call-arg]
    assert pickle.loads(pickle.dumps(flexgen.plan)) is flexgen.plan
    assert list(inspect.signature(flexgen.Notch).parameters) == [
        "frequency_hz",
        "zero_damping",
        "pole_damping",
    ]
    assert list(inspect.signature(flexgen.Path.sample).parameters) == ["self", "t"]


def test_a_constructor_checks_itself_first_and_then_its_types() -> None:
    @checked_class
    @dataclass(frozen=True)
    class Filter:
        hz: float
        name: str = ""

        def __post_init__(self) -> None:
            if self.hz < 0:
                raise ArgumentError("hz: given a negative number")

    with pytest.raises(ArgumentError, match="hz: given a negative number"):
        Filter(-1.0, name=3)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="Filter, hz: given 'x', expected a finite number"):
        Filter("x")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="Filter, name: given 3, expected a text"):
        Filter(1.0, 3)  # type: ignore[arg-type]
    assert Filter(1.0, "a") == Filter(1, name="a")


def test_parameters_with_an_own_check_are_compared_only_after_another_error() -> None:
    @checked_types(own=("speed",))
    def drive(speed: float, fast: bool = False) -> float:
        if speed == 0:
            raise SolverError("speed: it stands")
        return speed + 1

    assert drive(1.0) == 2.0
    with pytest.raises(SolverError, match="it stands"):
        drive(False)
    with pytest.raises(ArgumentError, match="fast: given 1, expected True or False"):
        drive(0.0, 1)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="speed: given 'x', expected a finite number"):
        drive("x")  # type: ignore[arg-type]


def test_results_may_hold_nan_and_subclasses_may_have_other_arguments() -> None:
    @checked_result
    @dataclass(frozen=True)
    class Result:
        error: float
        path: np.ndarray

        def scaled(self, factor: float) -> float:
            return self.error * factor

        @staticmethod
        def load(path: str) -> str:
            return path

    class Named(Result):
        def __init__(self, name: str) -> None:
            super().__init__(float(len(name)), np.zeros(1))

    assert np.isnan(Result(np.nan, np.array([1j, np.nan])).error) and Named("abc").scaled(2) == 6.0
    for array in ([1], (), np.float64(1.0), {}.values()):
        assert Result(0.0, array).path is array  # type: ignore[arg-type]
    for other in (1.0, None, "text", {}, iter(())):
        with pytest.raises(ArgumentError, match=r"path.*expected an array"):
            Result(0.0, other)  # type: ignore[arg-type]
    for wrong in (
        lambda: Result("x", np.zeros(1)),  # type: ignore[arg-type]
        lambda: Named("abc").scaled(np.nan),
        lambda: Result.load(3),  # type: ignore[arg-type]
    ):
        with pytest.raises(ArgumentError):
            wrong()


def test_methods_with_nothing_to_check_are_not_wrapped() -> None:
    @checked_methods
    class Thing:
        def plain(self) -> int:
            return 1

        def sized(self, size: int) -> int:
            return size

    assert not hasattr(Thing.plain, "__wrapped__") and hasattr(Thing.sized, "__wrapped__")


def test_names_of_own_checks_are_parameters_and_late_names_are_classes(monkeypatch) -> None:
    late: set[str] = set()
    missing = Names.__missing__

    def noted(names: Names, name: str) -> object:
        found = missing(names, name)
        if isinstance(found, LateClass):
            late.add(name)
        return found

    monkeypatch.setattr(Names, "__missing__", noted)
    for each in entrances():
        call = each.call.__init__ if each.is_constructor else each.call  # type: ignore[misc]
        own = call.__checks__.own if hasattr(call, "__checks__") else ()
        assert set(own) <= set(checks_of(each.call)), each.name
    places = (flexgen, importlib.import_module("flexgen.base.spec.lines"))
    known = {name for name in late for at in places if inspect.isclass(getattr(at, name, None))}
    assert late == known != set()


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (Sequence[str], "a sequence with a text in each place"),
        (Sequence[Sequence[float]], "a sequence of sequences with a number in each place"),
        (
            Sequence[Sequence[Sequence[str]]],
            "a sequence of sequences of sequences with a text in each place",
        ),
        (np.ndarray, "an array of numbers without nan"),
    ],
)
def test_types_in_words(kind: object, words: str) -> None:
    found = check_of(kind)
    assert found is not None and found.words == words
