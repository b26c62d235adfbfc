"""Numbers on a tape: values and derivatives of CasADi, and operations that are left after folding
and sharing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.codegen.recursion.tape import Tape, Value


@pytest.mark.parametrize("seed", range(6))
def test_random_operations_have_the_values_and_derivatives_of_casadi(seed: int) -> None:
    """Every kind, with constants of all signs; gradients and tangents."""
    rng = np.random.default_rng(seed)
    tape = Tape()
    x = ca.SX.sym("x", 3)
    symbols = tape.vector(x)
    pool: list[tuple[Any, ca.SX]] = list(zip(symbols, ca.vertsplit(x), strict=True))
    for kind in rng.permutation([*range(11), *rng.choice(11, 4)]):
        (a, A), (b, B) = (pool[k] for k in rng.integers(0, len(pool), 2))
        c = float(rng.choice([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 3.0]))
        angle, by = [pair for pair in pool if isinstance(pair[0], Value)][-1]
        made = [
            (a + b, A + B),
            (a - b, A - B),
            (a * b, A * B),
            (-a, -A),
            (a + c, A + c),
            (c - a, c - A),
            (c * a, c * A),
            (a - c, A - c),
            (tape.sine(angle), ca.sin(by)),
            (tape.sine(angle, True), ca.cos(by)),
            (tape.inverse(a * a + 2.0), 1 / (A * A + 2)),
        ]
        pool.append(made[kind])
    results = [u for u, _ in pool[3:]]
    expected = ca.vertcat(*(ca.SX(U) for _, U in pool[3:]))
    at = rng.uniform(-1.0, 1.0, 3)

    def value(form: ca.SX) -> np.ndarray:
        return np.array(ca.Function("f", [x], [ca.densify(form)])(at))

    def same(found: np.ndarray, right: np.ndarray) -> None:
        assert_allclose(found, right, rtol=0, atol=1e-12 * max(1e-3, np.abs(right).max()))

    count = tape.count(results)
    same(value(ca.vertcat(*tape.build(results))), value(expected))
    assert count == tape.count(results)
    slope = value(ca.jacobian(expected, x))
    rows = [ca.vertcat(*tape.build(tape.gradient(u, symbols))) for u in results]
    same(value(ca.horzcat(*rows).T), slope)
    columns = [ca.vertcat(*tape.build(tape.tangents(results, u))) for u in symbols]
    same(value(ca.horzcat(*columns)), slope)


COUNTS: dict[str, tuple[Callable[[Tape, Any, Any], list[Any]], int]] = {
    "x, x + 0 and a constant": (lambda t, x, y: [x, 1.0 * x, x + 0.0, 0.0 + x, 5.0], 0),
    "-x": (lambda t, x, y: [-x], 1),
    "-1 x": (lambda t, x, y: [-1.0 * x], 1),
    "x + y twice": (lambda t, x, y: [x + y, y + x], 1),
    "-(x - y)": (lambda t, x, y: [-(x - y)], 1),
    "-(x + y)": (lambda t, x, y: [-(x + y)], 2),
    "x - y and y - x": (lambda t, x, y: [x - y, y - x], 2),
    "x + x and 2 x": (lambda t, x, y: [x + x, 2.0 * x], 1),
    "x - x": (lambda t, x, y: [x - x], 0),
    "2 x + 3 x": (lambda t, x, y: [2.0 * x + 3.0 * x], 1),
    "3 x - 2 x": (lambda t, x, y: [3.0 * x - 2.0 * x], 0),
    "2 (3 x)": (lambda t, x, y: [2.0 * (3.0 * x)], 1),
    "x/2 * 2": (lambda t, x, y: [0.5 * (2.0 * x)], 0),
    "x y twice": (lambda t, x, y: [x * y, y * x], 1),
    "-x y": (lambda t, x, y: [(-x) * y], 2),
    "(-x)(-y)": (lambda t, x, y: [(-x) * (-y)], 1),
    "x + 1": (lambda t, x, y: [x + 1.0], 1),
    "1 - x": (lambda t, x, y: [1.0 - x], 2),
    "1/x": (lambda t, x, y: [t.inverse(x)], 1),
    "sines": (lambda t, x, y: [t.sine(x), t.sine(x, cosine=True)], 0),
    "sine squared": (lambda t, x, y: [t.sine(x) * t.sine(x)], 1),
    "constants": (lambda t, x, y: [x * 0.0, 0.0 * y, t.inverse(4.0)], 0),
}


@pytest.mark.parametrize("name", COUNTS)
def test_a_tape_folds_constants_and_shares_operations(name: str) -> None:
    """Sums, products, inverses and signs are counted, sines are not."""
    make, count = COUNTS[name]
    tape = Tape()
    x, y = tape.vector(ca.SX.sym("x", 2))
    assert tape.count(make(tape, x, y)) == count


def test_constants_have_values_and_no_derivatives() -> None:
    tape = Tape()
    x, y = tape.vector(ca.SX.sym("x", 2))
    assert (x * 0.0, 0.0 * y, x - x, tape.inverse(4.0)) == (0.0, 0.0, 0.0, 0.25)
    assert tape.gradient(3.0, [x, y]) == [0.0, 0.0]
    assert tape.tangents([2.0, y], x) == [0.0, 0.0]
    assert tape.gradient(-x, [x, y, 7.0]) == [-1.0, 0.0, 0.0]
    assert tape.tangents([-x], x) == [-1.0]
    assert tape.sine(-x).negative and not tape.sine(-x, cosine=True).negative
    with pytest.raises(ZeroDivisionError):
        tape.inverse(np.float64(0.0))  # type: ignore[arg-type]


def test_operands_and_what_is_needed_come_before() -> None:
    tape = Tape()
    x, y = tape.vector(ca.SX.sym("x", 2))
    needed = tape.find_needed([x * y + 2.0 * y])
    assert tape.find_needed([x * y + 2.0 * y, 3.0]) == needed == sorted(needed)
    assert tape.operands(x.node) == () and tape.operands((2.0 * x).node) == (x.node,)
