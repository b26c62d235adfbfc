"""Options given twice, arrays that do not fit, long paths, usual ranges, and residuals between
samples.
"""

from __future__ import annotations

import argparse
import os
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.backends.cuda.arrays import Given, steps_of
from flexgen.base.errors import ArgumentError
from flexgen.base.files import atomic_files
from flexgen.cli.argument_parser import OldName, Once
from flexgen.simulation.verification import residual
from flexgen.studies.check import numbers
from flexgen.studies.check.finding import Usual

RANGES = {
    "RATIO": (0.9, 500.0, 1e-2, 1e4),
    "RATIO_TRANSLATION": (5.0, 2e4, 1e-2, 1e6),
    "ROTOR": (1e-7, 0.1, 1e-10, 10.0),
    "ROTOR_TO_ARM": (0.02, 500.0, 1e-4, 1e5),
    "FREQUENCY": (3.0, 300.0, 0.05, 2e4),
    "DAMPING": (1e-3, 0.4, 0.0, 30.0),
    "SAG": (0.0, 0.01, 0.0, 0.5),
    "SAG_TRANSLATION": (0.0, 0.005, 0.0, 0.2),
    "MOTOR_SPEED": (10.0, 1100.0, 0.1, 2e4),
    "JOINT_SPEED": (0.05, 20.0, 1e-3, 1e3),
    "JOINT_SPEED_TRANSLATION": (0.01, 10.0, 1e-4, 100.0),
    "MOVE_SPEED": (0.0, 50.0, 0.0, 1e3),
    "MOVE_SPEED_TRANSLATION": (0.0, 10.0, 0.0, 100.0),
    "HOLD": (0.0, 1e6, 0.0, 1e9),
    "REVERSAL": (0.0, 5.0, 0.0, np.inf),
    "TORQUE": (1.0, np.inf, 0.0, np.inf),
    "DENSITY": (1.0, np.inf, 0.1, np.inf),
    "SIZE": (0.0, 1.0, 0.0, 1e3),
    "SHARE": (0.0, 5.0, 0.0, 200.0),
    "GRAVITY": (0.0, 30.0, 0.0, 300.0),
    "LENGTH": (1e-3, 100.0, 1e-5, 1e4),
}


def test_ranges_of_usual_numbers_are_those_that_were_chosen() -> None:
    """A model that passes is not refused later: a change of a range is a decision."""
    found = {name: value for name, value in vars(numbers).items() if isinstance(value, Usual)}
    assert {name: (x.low, x.high, x.least, x.most) for name, x in found.items()} == RANGES


def test_an_option_is_given_once() -> None:
    """Its old name is taken with a note."""

    def parser() -> argparse.ArgumentParser:
        made = argparse.ArgumentParser(exit_on_error=False)
        made.add_argument("--move", action=Once)
        made.add_argument("--mesh", action=Once)
        made.add_argument("--grid", action=OldName, dest="mesh", metavar="--mesh")
        made.add_argument(
            "--coarse", action=OldName, dest="mesh", metavar="--mesh", nargs=0, const="coarse"
        )
        return made

    assert parser().parse_args(["--mesh", "3"]).mesh == "3" and not hasattr(
        parser().parse_args([]), "notes"
    )
    old = parser().parse_args(["--grid", "3"])
    assert old.mesh == "3" and old.notes == [
        "--grid is the old name of --mesh, please use the new one"
    ]
    assert parser().parse_args(["--coarse"]).mesh == "coarse"
    for words, text in (
        (["--mesh", "3", "--mesh", "4"], "given twice (3 and 4), expected one"),
        (["--mesh", "3", "--coarse"], "given twice (3 and coarse), expected one"),
        (
            ["--move", "a", "--move", "b"],
            (
                "given twice (a and b), expected one; 'flexgen solve' takes several moves, the "
                "other verbs one at a time"
            ),
        ),
    ):
        with pytest.raises(argparse.ArgumentError) as refused:
            parser().parse_args(words)
        assert refused.value.message == text


@pytest.mark.skipif(os.name != "posix", reason="paths of POSIX")
def test_paths_have_a_largest_number_of_parts() -> None:
    assert len(atomic_files.follow_links("/" + "/".join(["no_such"] * 255)).parts) == 256
    with pytest.raises(
        ArgumentError, match="given a path of 257 parts, expected at most 256: '/no_such/no_such/"
    ):
        atomic_files.follow_links("/" + "/".join(["no_such"] * 256))


def array(
    shape: tuple[int, ...], dtype: str = "<f8", strides: tuple[int, ...] | None = None
) -> Any:
    made = object.__new__(Given)
    fields = {"_where": "f, q", "shape": shape, "dtype": dtype, "strides": strides, "address": 0}
    for name, value in fields.items():
        setattr(made, name, value)
    return made


def test_arrays_on_a_card_fit_or_are_refused() -> None:
    """By extents, type of numbers and strides; axes of one entry and arrays without any have no
    stride.
    """
    double = np.dtype("<f8")
    assert steps_of((4, 3, 2), 8, "C") == (48, 16, 8) and steps_of((4, 3, 2), 8, "F") == (
        8,
        32,
        96,
    )
    array((4, 3)).demand((None, 3), double, "C")
    array((4, 3), strides=(8, 32)).demand((4, 3), double, "F")
    array((1, 3)).demand((None, 3), double, "F")  # as well in the order of C
    array((0, 3)).demand((None, 3), double, "F")
    for given, shape, text in (
        (array((4, 2)), (None, 3), r"f, q: given shape \(4, 2\), expected \(N, 3\)"),
        (array((4,)), (4, 1), r"given shape \(4,\), expected \(4, 1\)"),
        (
            array((4, 3), "<f4"),
            (None, 3),
            "given numbers of type <f4, expected float64; a library has the precision",
        ),
        (
            array((4, 3)),
            (None, 3),
            r"given strides \(24, 8\) of bytes, expected \(8, 32\): the order of Fortran, with",
        ),
    ):
        with pytest.raises(ArgumentError, match=text):
            given.demand(shape, double, "F")
    with pytest.raises(
        ArgumentError,
        match=r"given strides \(8, 32\) of bytes, expected \(24, 8\): rows without gaps",
    ):
        array((4, 3), strides=(8, 32)).demand((4, 3), double, "C")


def test_states_between_samples_are_those_of_a_polynomial() -> None:
    """Of order five: exact at the middle, with two derivatives."""
    rng = np.random.default_rng(1)
    t = np.array([0.0, 0.3, 0.7, 1.2])
    h = np.diff(t)[:, None]
    middle = (t[1:] + t[:-1]) / 2
    curves = [np.polynomial.Polynomial(rng.normal(size=6)) for _ in range(2)]

    def at(instants: np.ndarray, order: int) -> np.ndarray:
        return np.stack(
            [curve.deriv(order)(instants) if order else curve(instants) for curve in curves],
            axis=1,
        )

    found = residual._half_way(h, *(at(t, order) for order in range(3)))
    for order, values in enumerate(found):
        assert_allclose(values, at(middle, order), rtol=1e-10)
