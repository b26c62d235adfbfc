"""Laws of springs and frictions in printed equations, by their integrals, and functions on a card
without one.
"""

from __future__ import annotations

import ctypes
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose
from scipy.integrate import quad

from flexgen.analysis.printing.elements import Symbols, friction_law, spring_law
from flexgen.backends.cuda import functions
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.model.elements import (
    BacklashSpring,
    CubicSpring,
    LinearSpring,
    PiecewiseSpring,
    SmoothSpring,
)
from flexgen.model.friction import Friction

DEFLECTIONS = np.array([-0.9, -0.3, -0.2, -0.05, 0.0, 0.1, 0.2, 0.25, 0.8])


def values_of(expression: sp.Expr, symbols: Symbols, x: sp.Symbol, at: np.ndarray) -> np.ndarray:
    """A law with the values of its symbols."""
    known = expression.subs({entry.symbol: entry.value for entry in symbols.entries})
    return np.array([float(known.subs(x, value)) for value in at])


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
            ["low stiffness of q1", "high stiffness of q1", "break of the stiffness of q1"],
        ),
        (
            PiecewiseSpring(20.0, 80.0, 0.2),
            lambda d: 20.0 if d <= 0.2 else 80.0,
            ["low stiffness of q1", "high stiffness of q1", "break of the stiffness of q1"],
        ),
        (
            BacklashSpring(50.0, 0.1, 0.02),
            lambda d: (
                50.0
                * (
                    1
                    - 0.5
                    * ((d + 0.1) / np.hypot(d + 0.1, 0.02) - (d - 0.1) / np.hypot(d - 0.1, 0.02))
                )
            ),
            ["half backlash of q1", "rounding of the backlash of q1", "stiffness of q1"],
        ),
    ],
)
def test_printed_torques_of_springs_are_integrals_of_their_stiffness(
    spring: Any, stiffness: Any, told: Any
) -> None:
    """Odd in the deflection, without a jump where the stiffness changes."""
    symbols = Symbols()
    d = sp.Symbol("d", real=True)
    found = values_of(
        spring_law(symbols, spring, d, "q1", ("N m", "rad")), symbols, d, DEFLECTIONS
    )
    expected = [
        np.sign(x) * quad(stiffness, 0.0, abs(x), points=[0.1, 0.2])[0] for x in DEFLECTIONS
    ]
    assert_allclose(found, expected, rtol=1e-7, atol=1e-9)
    assert [entry.meaning for entry in symbols.entries] == told
    units = {
        "stiffness": "N m/rad",
        "cubic": "N m/rad^3",
        "half": "rad",
        "rounding": "rad",
        "break": "rad",
    }
    for entry in symbols.entries:
        first = entry.meaning.split()[0]
        assert entry.unit == units.get(first, "N m/rad"), entry.meaning


def test_printed_frictions_have_the_parts_that_are_not_zero() -> None:
    """Viscous, an offset, and a level with and without the rise at small speeds."""
    w = sp.Symbol("w", real=True)
    at = np.array([-3.0, -0.1, 0.0, 0.2, 5.0])
    for given, count in (
        ({"viscous": 2.0}, 1),
        ({"viscous": 2.0, "offset": 0.5}, 2),
        ({"viscous": 2.0, "coulomb": 3.0, "beta": 4.0}, 3),
        ({"coulomb": 3.0, "stribeck": 1.5, "alpha": 0.7, "beta": 4.0}, 4),
        ({"stribeck": 1.5, "alpha": 0.7, "beta": 4.0}, 3),
    ):
        law = Friction(**given)
        symbols = Symbols()
        found = values_of(friction_law(symbols, law, w, "m1", ("N m", "rad")), symbols, w, at)
        level = law.coulomb + law.stribeck / np.cosh(law.alpha * at)
        assert_allclose(
            found, law.viscous * at + law.offset + level * np.tanh(law.beta * at), atol=1e-12
        )
        assert len(symbols.entries) == count


class Port:
    """A port of a function."""

    def __init__(self, name: str, *shape: int) -> None:
        self.name = name
        self.shape = shape
        self.size = int(np.prod(shape))


class Card:
    """A card that keeps what it is asked, and reports a number of its kernel."""

    def __init__(self, reported: int | None = None) -> None:
        self.reported = reported
        self.asked = list[Any]()

    def allocate(self, size: int, stream: int) -> int:
        self.asked.append(("allocate", size, stream))
        return 77

    def fill(self, at: int, byte: int, size: int, stream: int) -> None:
        self.asked.append(("fill", at, byte, size, stream))

    def launch(self, kernel: Any, points: int, arguments: Any, stream: int) -> None:
        self.asked.append(("launch", kernel, points, [x.value for x in arguments], stream))

    def read(self, at: int, to: int, size: int, stream: int) -> None:
        self.asked.append(("read", at, size, stream))
        if self.reported is not None:
            ctypes.c_uint64.from_address(to).value = self.reported

    def free(self, at: int, stream: int) -> None:
        self.asked.append(("free", at, stream))


def function(card: Card, per_point: bool = False) -> Any:
    ports = Made(
        inputs=(Port("q_a", 2), Port("parameters", 3)), outputs=(Port("M", 2, 2), Port("g", 2))
    )
    cpu: Any = Made(
        name="f",
        summary="",
        equation="",
        _failures={-5: (SolverError, "no answer")},
        _parameters=None,
    )
    cpu.inputs = ports.inputs
    cpu.outputs = ports.outputs
    return functions.CudaFunction(
        cpu, card, np.dtype(np.float64), lambda name: f"kernel {name}", per_point
    )  # type: ignore[arg-type]


def test_a_kernel_runs_on_its_points_and_reports_the_first_that_failed() -> None:
    """Sixteen bits or fewer of what it reports are the status; nothing runs without points."""
    card = Card()
    function(card)._launch(0, [1, 2], 9, True)
    assert card.asked == []
    function(card)._launch(6, [1, 2], 9, False)
    assert card.asked == [
        ("allocate", 8, 9),
        ("fill", 77, 255, 8, 9),
        ("launch", "kernel f", 6, [6, 1, 2, 77], 9),
        ("free", 77, 9),
    ]
    card = Card(2**64 - 1)
    function(card)._launch(6, [1, 2], 9, True)
    assert card.asked[3:] == [("read", 77, 8, 9), ("free", 77, 9)]
    for status, text in ((5, "f, point 3: no answer"), (6, "f, point 3: unknown status -6;")):
        card = Card((3 << functions.STATUS_BITS) + status)
        with pytest.raises((SolverError, Exception), match=text):
            function(card)._launch(6, [1, 2], 9, True)
        assert card.asked[-1] == ("free", 77, 9)


def test_results_on_a_card_have_memory_of_their_own() -> None:
    """Parameters are one vector for all points, or one for each."""
    made = function(Card())
    # 5 points: 80, 24, 160 and 80 bytes
    q = 1000
    p = 2000
    M = 3000
    g = 4000
    for addresses, name in (
        ((q, p, M, g), None),
        ((q, M - 24, M, M + 160), None),
        ((q, M - 23, M, g), "M"),
        ((M - 79, p, M, g), "M"),
        ((q, p, M, M + 159), "M"),
        ((g + 79, p, M, g), "g"),
        ((g + 80, p, M, g), None),
    ):
        if name is None:
            made._refuse_overlap(5, addresses)
            continue
        with pytest.raises(
            ArgumentError,
            match=f"f, out, {name}: given memory of another array, expected memory of it",
        ):
            made._refuse_overlap(5, addresses)
    with pytest.raises(ArgumentError, match="f, out, M"):
        function(Card(), True)._refuse_overlap(5, (q, M - 24, M, g))  # 120 bytes of parameters
    function(Card(), True)._refuse_overlap(5, (q, M - 120, M, g))


def test_points_of_arrays_on_a_card_are_counted() -> None:
    """By the first input that has them; the others must have as many."""
    asked: list[Any] = []

    def array(*shape: int) -> Any:
        return Made(shape=shape, demand=lambda *given: asked.append(given))

    double = np.dtype(np.float64)
    assert function(Card())._count([array(7, 2), array(3)]) == 7
    assert asked == [((None, 2), double, "F"), ((3,), double, "C")]
    asked.clear()
    assert function(Card(), True)._count([array(7, 2), array(7, 3)]) == 7
    assert asked == [((None, 2), double, "F"), ((7, 3), double, "F")]
    made = function(Card())
    assert made._outs(None) == [None, None] and made._outs(("a", "b")) == ("a", "b")
    for out, count in ((("a",), 1), ("a", 1), (("a", "b", "c"), 3)):
        with pytest.raises(
            ArgumentError, match=f"f, out: given {count} arrays, expected one for each of M, g"
        ):
            made._outs(out)
    assert repr(made) == "f(q_a, parameters)"
