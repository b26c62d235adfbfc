"""Arguments of an inversion: parameters, samples of its path, and the hold of its torques."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flexgen.base.errors import ArgumentError
from flexgen.runtime.inversion import inversion_arguments as checked

MASS = {"name": "payload.mass", "unit": "kg", "bound": ">= 0"}
SPRING = {"name": "q1.stiffness", "unit": "N m/rad", "bound": "> 0"}
CENTER = {"name": "payload.com.x", "unit": "m"}
SIZES = {"n_t": 12, "n_y": 6}


def test_parameters_of_an_inversion_are_those_of_the_model_or_checked() -> None:
    own = np.array([1.0, 2.0, 3.0])
    rows = (MASS, SPRING, CENTER)
    assert checked.parameters_of("invert", None, own, rows) is own
    found = checked.parameters_of("invert", [0, 1, -5], own, rows)
    assert found.dtype == float and found.tolist() == [0.0, 1.0, -5.0]
    single = checked.parameters_of("invert", [0.5, 1, 2], own.astype(np.float32), rows)
    assert single.dtype == np.float32
    for values, text in (
        (
            [-1.0, 1.0, 0.0],
            "invert, parameters: given -1 kg as payload.mass, expected a number >= 0",
        ),
        (
            [1.0, 0.0, 0.0],
            "invert, parameters: given 0 N m/rad as q1.stiffness, expected a number > 0",
        ),
        (
            [1.0, -2.5, 0.0],
            "invert, parameters: given -2.5 N m/rad as q1.stiffness, expected a number > 0",
        ),
        ([1.0, 2.0], "invert, parameters: given shape (2,), expected (3)"),
        ([1.0, 2.0, "a"], "invert, parameters: given entries of type <U32, expected real numbers"),
        (
            [True, True, True],
            "invert, parameters: given entries of type bool, expected real numbers",
        ),
        ([1.0, [2.0], 3.0], "invert, parameters: given setting an array element with a sequence."),
    ):
        with pytest.raises(ArgumentError) as caught:
            checked.parameters_of("invert", values, own, rows)
        assert str(caught.value).startswith(text)
    with pytest.raises(ArgumentError) as caught:
        checked.parameters_of("invert", [1.0], np.zeros(0), ())
    assert str(caught.value).startswith(
        "invert, parameters: given to a library without run-time parameters, expected"
    )
    many = np.array([[1.0, 2.0, 0.0], [4.0, 3.0, 0.0], [0.0, 1e-9, -1.0]])
    checked.check_bounds("invert_many", many, rows)
    checked.check_bounds("invert_many", many[:0], rows)
    many[1, 1] = 0.0
    with pytest.raises(
        ArgumentError, match=r"^invert_many, parameters: given 0 N m/rad as q1\.stiffness"
    ):
        checked.check_bounds("invert_many", many, rows)


def test_samples_of_a_path_have_as_many_rows_each() -> None:
    """One path, or one for each of several problems; forces have three columns for each row of
    dy.
    """
    y = np.zeros((5, 12))
    dy = np.ones((5, 6))
    push = np.full((5, 18), 2.0)
    real = np.dtype(float)
    found = checked.samples_of("invert", (y.tolist(), dy, dy.astype(int)), push, SIZES, real, True)
    assert {name: x.shape for name, x in found.items()} == {
        "y": (5, 12),
        "dy": (5, 6),
        "ddy": (5, 6),
        "force": (5, 18),
    }
    assert all(x.dtype == float and x.flags.c_contiguous for x in found.values())
    assert sorted(checked.samples_of("invert", (y, dy, dy), None, SIZES, real, False)) == [
        "ddy",
        "dy",
        "y",
    ]
    several = tuple(np.tile(x, (3, 1, 1)) for x in (y, dy, dy))
    many = checked.samples_of("invert_many", several, None, SIZES, real, False, problems=True)
    assert many["y"].shape == (3, 5, 12) and many["ddy"].shape == (3, 5, 6)
    assert checked.samples_of("invert_many", (y, dy, dy), None, SIZES, real, False, problems=True)[
        "y"
    ].shape == (5, 12)
    for path, force, several_problems, text in (
        ((y, dy[:4], dy), None, False, "f, dy: given shape (4, 6), expected (5, 6)"),
        ((y, dy, dy[:, :5]), None, False, "f, ddy: given shape (5, 5), expected (5, 6)"),
        ((y[:, :3], dy, dy), None, False, "f, y: given shape (5, 3), expected (5, 12)"),
        ((y[0], dy, dy), None, False, "f, y: given shape (12,), expected (n, 12)"),
        (several, None, False, "f, y: given shape (3, 5, 12), expected (n, 12)"),
        (
            (y[0], dy, dy),
            None,
            True,
            "f, y: given shape (12,), expected (problems, n, 12) or (n, ...)",
        ),
        ((several[0], dy, dy), None, True, "f, dy: given shape (5, 6), expected (3, 5, 6)"),
        ((y, dy, dy), push[:, :6], False, "f, force: given shape (5, 6), expected (5, 18)"),
    ):
        with pytest.raises(ArgumentError) as caught:
            checked.samples_of("f", path, force, SIZES, real, True, several_problems)
        assert str(caught.value) == text
    with pytest.raises(
        ArgumentError,
        match=r'^f, force: given to a library without forces, expected .*parts=\["force"\]',
    ):
        checked.samples_of("f", (y, dy, dy), push, SIZES, real, False)
    huge = checked.array_of("f", "y", [1e300, -1e39], None, np.dtype(np.float32))
    assert huge.dtype == np.float32 and huge.tolist() == [np.inf, -np.inf]


def test_holds_of_an_inversion_have_a_number_and_a_delay() -> None:
    interface: Any = SimpleNamespace(
        enums={"hold": ("spline", "zoh", "linear")}, limits={"HOLD_DELAY_MAX": 64}
    )
    assert checked.hold_of(interface, "f", "spline", 0) == {"hold": 0, "delay": 0.0}
    assert checked.hold_of(interface, "f", "linear", 64) == {"hold": 2, "delay": 64.0}
    for hold, delay, text in (
        ("cubic", 0.0, "f, hold: given 'cubic', expected one of spline, zoh, linear"),
        (
            "zoh",
            -0.1,
            (
                "f, delay: given -0.1 samples, expected 0 to 64; for a longer delay give the "
                "path earlier"
            ),
        ),
        (
            "zoh",
            64.5,
            (
                "f, delay: given 64.5 samples, expected 0 to 64; for a longer delay give the "
                "path earlier"
            ),
        ),
        ("zoh", np.nan, "f, delay: given nan samples, expected 0 to 64"),
        ("zoh", "1", "f, delay: given '1', expected a number"),
    ):
        with pytest.raises(ArgumentError) as caught:
            checked.hold_of(interface, "f", hold, delay)
        assert str(caught.value).startswith(text)
