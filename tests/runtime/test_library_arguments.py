"""Arguments of functions in C: bound, counted, stored, and refused with their place."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.ports import Port
from flexgen.runtime import arguments

Q = Port("q", (2,), "rad", "angles")
R = Port("R", (3, 3), "1", "rotation")
P = Port("parameters", (4,), "1", "of the model")
DOUBLE = np.dtype(float)
SINGLE = np.dtype(np.float32)


@pytest.mark.parametrize(
    ("args", "named", "default", "expected"),
    [
        ((1, 2), {}, 9, [1, 2, 9]),
        ((1,), {"parameters": 3, "R": 2}, 9, [1, 2, 3]),
        ((1,), {}, 9, "1 arguments"),
        ((1, 2), {}, None, "2 arguments"),
        ((1, 2, 3, 4), {}, None, "4 arguments"),
        ((1, 2), {"q": 1}, 9, "2 arguments and q"),
        ((1, 2), {"x": 1, "y": 2}, 9, "2 arguments and x, y"),
    ],
)
def test_arguments_are_bound_by_place_and_name(
    args: Any, named: Any, default: Any, expected: Any
) -> None:
    if isinstance(expected, list):
        assert arguments.bind("f", (Q, R, P), args, named, default) == expected
        return
    with pytest.raises(ArgumentError, match=f"^f: given {expected}, expected q, R, parameters$"):
        arguments.bind("f", (Q, R, P), args, named, default)


@pytest.mark.parametrize(
    ("shapes", "expected"),
    [
        (((2,), (3, 3), (4,)), None),
        (((9, 2), (3, 3), (4,)), 9),
        (((2,), (0, 3, 3), (4,)), 0),
        (((10, 2), (3, 3), (4,)), "^f: given 10 points, expected at most 9; call it for parts of"),
        (((5, 2), (4, 3, 3), (4,)), "^f, R: given 4 points, expected 5 as in the inputs before$"),
        (
            ((5, 2), (3, 3), (5, 4)),
            r"^f, parameters: given shape \(5, 4\), expected \(4,\): one vector for all points$",
        ),
        (
            ((5, 3), (3, 3), (4,)),
            r"^f, q: given shape \(5, 3\), expected \(2,\) or \(N, 2\) \[rad\]$",
        ),
        (
            ((2,), (1, 2, 3, 3), (4,)),
            r"^f, R: given shape \(1, 2, 3, 3\), expected \(3, 3\) or \(N, 3, 3\) \[1\]$",
        ),
    ],
)
def test_points_are_counted(shapes: Any, expected: Any) -> None:
    arrays = [np.zeros(shape) for shape in shapes]
    if isinstance(expected, str):
        with pytest.raises(ArgumentError, match=expected):
            arguments.count_of_points("f", (Q, R, P), arrays, 9, "parameters")
        return
    assert arguments.count_of_points("f", (Q, R, P), arrays, 9, "parameters") == expected


def test_arrays_are_stored_with_the_points_side_by_side() -> None:
    """Without a copy where they are; one point is repeated, shared numbers are one vector."""
    x = np.arange(10.0).reshape(5, 2)
    found = arguments.store(Q, x, 5, DOUBLE)
    assert found.flags.f_contiguous and found.dtype == DOUBLE
    assert_array_equal(found, x)
    ready = np.asfortranarray(x)
    assert arguments.store(Q, ready, 5, DOUBLE) is ready
    one = arguments.store(Q, np.array([1.0, 2.0]), 3, SINGLE)
    assert_array_equal(one, [[1, 2]] * 3)
    assert one.dtype == SINGLE
    assert arguments.store(P, np.arange(4.0), 3, DOUBLE, "parameters").shape == (4,)
    assert np.isinf(arguments.convert(np.array([1e39]), SINGLE)).all()
    assert arguments.convert(x, DOUBLE) is x and arguments.convert(x, DOUBLE, "F") is not x


@pytest.mark.parametrize("count", [None, 7])
def test_results_are_made_or_taken(count: int | None) -> None:
    lead = () if count is None else (count,)
    made = arguments.results("f", (Q, R), None, count, SINGLE)
    assert [x.shape for x in made] == [(*lead, 2), (*lead, 3, 3)]
    assert all(x.dtype == SINGLE and (count is None or x.flags.f_contiguous) for x in made)
    given = tuple(np.empty_like(x, dtype=float, order="F") for x in made)
    taken = arguments.results("f", (Q, R), given, count, DOUBLE)
    assert all(x is y for x, y in zip(taken, given, strict=True))


def locked() -> np.ndarray:
    x = np.empty((7, 2), order="F")
    x.flags.writeable = False
    return x


def fortran(*shape: int, kind: Any = float) -> np.ndarray:
    return np.empty(shape, kind, order="F")


@pytest.mark.parametrize(
    ("out", "text"),
    [
        ([fortran(7, 2)], "^f, out: given 1 arrays, expected 2: q, R$"),
        ([fortran(7, 2), [1.0]], "^f, out for R: given list, expected a numpy array$"),
        (
            [fortran(7, 2), fortran(7, 3, 2)],
            r"R: given shape \(7, 3, 2\) of float64, expected \(7, 3, 3\) of float64$",
        ),
        (
            [fortran(7, 2, kind=SINGLE), fortran(7, 3, 3)],
            r"q: given shape \(7, 2\) of float32, expected \(7, 2\) of float64$",
        ),
        ([locked(), fortran(7, 3, 3)], "q: given an array that is read-only, expected one to wr"),
        (
            [np.empty((7, 2)), fortran(7, 3, 3)],
            r"another order, expected points side by side: np\.empty\(\(7, 2\), order='F'\)$",
        ),
    ],
)
def test_arrays_for_results_that_do_not_fit(out: Any, text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        arguments.results("f", (Q, R), out, 7, DOUBLE)


@pytest.mark.parametrize(
    ("written", "read", "wrong"),
    [
        ([(0, 16), (16, 8)], (24, 8), ""),
        ([(0, 16), (15, 8)], (24, 8), "R"),
        ([(8, 16), (0, 9)], (24, 8), "R"),
        ([(0, 17), (32, 8)], (16, 8), "q"),
        ([(16, 8), (32, 8)], (0, 16), ""),
        ([(16, 8), (32, 8)], (0, 17), "q"),
        ([(16, 8), (32, 8)], (0, 99), "q"),
    ],
)
def test_results_may_not_share_memory(written: Any, read: Any, wrong: str) -> None:
    """Not one byte, neither with each other nor with an input."""
    if not wrong:
        arguments.refuse_overlap("f", (Q, R), written, [read])
        return
    with pytest.raises(ArgumentError, match=f"^f, out for {wrong}: "):
        arguments.refuse_overlap("f", (Q, R), written, [read])


def test_the_first_point_that_is_not_finite_is_named() -> None:
    """With its entry; in single precision also what is too large for it."""
    q = np.zeros((5, 2))
    turn = np.zeros((5, 3, 3))
    arguments.refuse_not_finite("f", (Q, R), [q, turn], DOUBLE)
    q[3, 1] = np.nan
    turn[2, 0, 1] = np.inf
    with pytest.raises(ArgumentError, match=r"^f, R\[2, 0, 1\]: given inf, expected finite numb"):
        arguments.refuse_not_finite("f", (Q, R), [q, turn], DOUBLE)
    turn[2] = 0.0
    with pytest.raises(ArgumentError, match=r"^f, q\[3, 1\]: given nan, expected finite numbers$"):
        arguments.refuse_not_finite("f", (Q, R), [q, turn], DOUBLE)
    q[3] = 0.0
    turn[0, 0, 0] = 1e39
    arguments.refuse_not_finite("f", (Q, R), [q, turn], DOUBLE)
    with pytest.raises(ArgumentError, match="expected finite numbers of single precision"):
        arguments.refuse_not_finite("f", (Q, R), [q, turn], SINGLE)
    shared = np.array([[0, np.nan, 0], [0, 0, 0], [0, 0, 0]])  # of all points
    q[3, 0] = np.nan
    with pytest.raises(ArgumentError, match=r"^f, R\[0, 1\]: given nan"):
        arguments.refuse_not_finite("f", (Q, R), [q, shared], DOUBLE)


def whole(x: Any) -> Any:
    return arguments.whole_of("f", "n", x)


def number(x: Any) -> Any:
    return arguments.number_of("f", "x", x)


def array(x: Any) -> Any:
    return arguments.numbers("f", Q, x)


MASKED = np.ma.masked_array([1, 2], [False, True])
NUMBERS: list[tuple[Callable[[Any], Any], Any, Any]] = [
    (whole, np.int64(2**31 - 1), 2**31 - 1),
    (whole, -(2**31), -(2**31)),
    (number, np.float32(0.5), 0.5),
    (number, 3, 3.0),
    *((whole, x, "^f, n: given .*, expected a whole number$") for x in (2**31, -(2**31) - 1)),
    *((whole, x, "^f, n: given .*, expected a whole number$") for x in (1.0, True, "1")),
    *((number, x, "^f, x: given .*, expected a number$") for x in (True, "1", None, 10**400)),
    (array, [[1], [1, 2]], "^f, q: given .*expected real"),
    (array, ["a", "b"], "^f, q: given .*entries of type"),
    (array, [1j, 0], "^f, q: given .*entries of type"),
    (array, MASKED, "^f, q: given an array with masked entries, expected real numbers$"),
]


@pytest.mark.parametrize("k", range(len(NUMBERS)))
def test_numbers_for_c_are_numbers(k: int) -> None:
    read, given, expected = NUMBERS[k]
    if not isinstance(expected, str):
        assert read(given) == expected
        return
    with pytest.raises(ArgumentError, match=expected):
        read(given)
    x = np.array([1, 2], SINGLE)
    assert arguments.numbers("f", Q, x) is x
