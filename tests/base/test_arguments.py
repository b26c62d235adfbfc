"""Arguments at the edges of their ranges: numbers, seeds, tables, instants, and an inversion's."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.errors import ArgumentError
from flexgen.base.motion import interpolation
from flexgen.base.spec import arguments


def test_numbers_are_real_and_finite() -> None:
    for value in (
        0,
        1.5,
        -2,
        np.float64(3.0),
        np.int32(4),
        np.array(5.0),
        Fraction(1, 2),
        10**300,
    ):
        assert arguments.is_number(value)
    for value in (
        True,
        np.bool_(True),
        "1",
        None,
        np.nan,
        np.inf,
        np.array([1.0]),
        1j,
        Decimal(1),
        10**400,
    ):
        assert not arguments.is_number(value)
    assert (
        arguments.is_whole(1) and arguments.is_whole(np.int64(7)) and arguments.is_whole(2**31 - 1)
    )
    for value in (0, True, 1.0, "1", 2**31, np.float64(2.0)):
        assert not arguments.is_whole(value)
    assert (
        arguments.is_whole(0, 0)
        and arguments.is_whole(3, 3, 3)
        and not arguments.is_whole(4, 3, 3)
    )


def test_bounds_of_numbers_are_named() -> None:
    arguments.check_positive("x", 1e-300)
    arguments.check_not_negative("x", 0)
    for value in (0, -1.0, "a", True, np.nan):
        with pytest.raises(ArgumentError) as caught:
            arguments.check_positive("x", value)
        assert str(caught.value) == f"x: given {value!r}, expected a number > 0"
    for value in (-1e-300, None, np.inf):
        with pytest.raises(ArgumentError) as caught:
            arguments.check_not_negative("x", value, "a size")
        assert str(caught.value) == f"x: given {value!r}, expected a size"
    assert (
        arguments.seed_of(0) == 0
        and arguments.seed_of(np.int64(5)) == 5
        and arguments.seed_of(2**63 - 1) == 2**63 - 1
    )
    for value in (-1, 1.0, True, 2**63):
        with pytest.raises(ArgumentError, match=r"^seed: given .*, expected a whole number >= 0$"):
            arguments.seed_of(value)
    given = {"a": 1}
    assert (
        arguments.mapping_of("m", given, "x") == given
        and arguments.mapping_of("m", given, "x") is not given
    )
    with pytest.raises(ArgumentError, match=r"^m: given \[1\], expected a table$"):
        arguments.mapping_of("m", [1], "a table")


def test_instants_outside_of_a_trajectory_are_refused() -> None:
    t = np.array([0.25, 0.5, 1.0])
    channels = {"x": np.array([[1.0], [2.0], [5.0]])}
    expected = "expected one or more instants from 0.25 to 1 s"
    for at, given in (
        (0.2, "0.2"),
        (1.1, "1.1"),
        (float("nan"), "nan"),
        ("x", "'x'"),
        ([0.5, 1.5], "an instant that is outside"),
        ([[0.5]], "shape (1, 1)"),
    ):
        with pytest.raises(ArgumentError) as refused:
            interpolation.interpolate(t, channels, {}, at)
        assert str(refused.value) == f"t: given {given}, {expected}"
    assert_allclose(interpolation.interpolate(t, channels, {}, 0.25)["x"], [1.0])
    # through three samples
    parabola = interpolation.interpolate(t, channels, {}, [0.375, 1.0])["x"]
    assert_allclose(parabola[:, 0], [1.0 + 4.0 * 0.125 + 8 / 3 * 0.125 * -0.125, 5.0])
