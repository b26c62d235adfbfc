"""Laws of springs, frictions and placements in printed equations: integrals, sums, rotations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from flexgen.analysis.printing.elements import (
    Shift,
    Symbols,
    Turn,
    friction_law,
    placement_steps,
    spring_law,
)
from flexgen.model.elements import (
    BacklashSpring,
    CubicSpring,
    LinearSpring,
    PiecewiseSpring,
    Placement,
    SmoothSpring,
)
from flexgen.model.friction import Friction

DEFLECTIONS = np.array([-0.9, -0.3, -0.2, -0.05, 0.0, 0.1, 0.2, 0.25, 0.8])
SPEEDS = np.array([-3.0, -0.1, 0.0, 0.2, 5.0])
X = sp.Symbol("x", real=True)
STIFFNESSES = [f"{x} stiffness of q1" for x in ("low", "high")] + ["break of the stiffness of q1"]


def values_of(expression: sp.Expr, symbols: Symbols, at: np.ndarray) -> np.ndarray:
    """A law of X with the values of its symbols."""
    known = expression.subs({entry.symbol: entry.value for entry in symbols.entries})
    return np.array([float(known.subs(X, value)) for value in at])


def of_backlash(d: float) -> float:
    ends = [(d + s * 0.1) / np.hypot(d + s * 0.1, 0.02) for s in (1, -1)]
    return float(50.0 * (1 - 0.5 * (ends[0] - ends[1])))


@pytest.mark.parametrize(
    ("spring", "stiffness", "told"),
    [
        (LinearSpring(50.0), lambda d: 50.0, ["stiffness of q1"]),
        (
            CubicSpring(50.0, 30.0),
            lambda d: 50.0 + 90.0 * d**2,
            ["cubic stiffness of q1", "stiffness of q1"],
        ),
        (
            SmoothSpring(20.0, 80.0, 0.2),
            lambda d: 20.0 + 60.0 * min(d / 0.2, 1.0) ** 2,
            STIFFNESSES,
        ),
        (PiecewiseSpring(20.0, 80.0, 0.2), lambda d: 20.0 if d <= 0.2 else 80.0, STIFFNESSES),
        (
            BacklashSpring(50.0, 0.1, 0.02),
            of_backlash,
            ["half backlash of q1", "rounding of the backlash of q1", "stiffness of q1"],
        ),
    ],
)
def test_torques_of_springs_are_integrals_of_their_stiffness(
    spring: Any, stiffness: Any, told: list[str]
) -> None:
    """Odd in the deflection, without a jump where the stiffness changes; units by meaning."""
    symbols = Symbols()
    law = spring_law(symbols, spring, X, "q1", ("N m", "rad"))
    found = values_of(law, symbols, DEFLECTIONS)
    areas = [quad(stiffness, 0.0, abs(x), points=[0.1, 0.2])[0] for x in DEFLECTIONS]
    assert_allclose(found, np.sign(DEFLECTIONS) * areas, rtol=1e-7, atol=1e-9)
    assert [entry.meaning for entry in symbols.entries] == told
    units = {"cubic": "N m/rad^3", "half": "rad", "rounding": "rad", "break": "rad"}
    for entry in symbols.entries:
        assert entry.unit == units.get(entry.meaning.split()[0], "N m/rad"), entry.meaning


@pytest.mark.parametrize(
    ("given", "count"),
    [
        ({"viscous": 2.0}, 1),
        ({"viscous": 2.0, "offset": 0.5}, 2),
        ({"viscous": 2.0, "coulomb": 3.0, "beta": 4.0}, 3),
        ({"coulomb": 3.0, "stribeck": 1.5, "alpha": 0.7, "beta": 4.0}, 4),
        ({"stribeck": 1.5, "alpha": 0.7, "beta": 4.0}, 3),
    ],
)
def test_frictions_have_the_parts_that_are_not_zero(given: dict[str, float], count: int) -> None:
    law = Friction(**given)
    symbols = Symbols()
    found = values_of(friction_law(symbols, law, X, "m1", ("N m", "rad")), symbols, SPEEDS)
    level = law.coulomb + law.stribeck / np.cosh(law.alpha * SPEEDS)
    expected = law.viscous * SPEEDS + law.offset + level * np.tanh(law.beta * SPEEDS)
    assert_allclose(found, expected, atol=1e-12)
    assert len(symbols.entries) == count


@pytest.mark.parametrize(
    "angles", [(0.3, -0.4, 0.5), (np.pi / 2, 0.2, -np.pi / 2), (np.pi, 0.0, 0.7), (0.0, 0.0, 0.0)]
)
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (0.1, 0.0, -0.2)])
def test_steps_of_a_placement_are_its_rotation(angles: Any, shift: Any) -> None:
    """Turns about z, y, x in this order, quarters as whole numbers, others as symbols with their
    values; none that is zero.
    """
    R = Rotation.from_euler("ZYX", angles).as_matrix()
    symbols = Symbols()
    placement = Placement(shift, tuple(map(tuple, R.tolist())))
    steps = placement_steps(symbols, "r", "arm", placement, "place")
    assert any(isinstance(step, Shift) for step in steps) == any(shift)
    assert not any(shift) or isinstance(steps[0], Shift)
    turns = [step for step in steps if isinstance(step, Turn)]
    values = {entry.symbol: entry.value for entry in symbols.entries}
    found = np.eye(3)
    for turn in turns:
        whole = isinstance(turn.angle, int)
        angle: Any = turn.angle * np.pi / 2 if isinstance(turn.angle, int) else values[turn.angle]
        quarters = angle / (np.pi / 2)
        assert whole == (abs(quarters - round(quarters)) < 1e-9)
        found = found @ Rotation.from_euler("xyz"[turn.axis], angle).as_matrix()
    assert_allclose(found, R, atol=1e-12)
    axes = [turn.axis for turn in turns]
    assert axes == sorted(axes, reverse=True) and len(turns) == np.count_nonzero(angles)
