"""Products of the derivatives of expressions on a tape with vectors, against CasADi; signs that
cost nothing.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.testing import assert_allclose

from flexgen.codegen.recursion.tape import Tape

AT = np.array([0.4, -0.7, 1.1])


def test_products_with_the_derivatives_are_those_of_casadi() -> None:
    """Planted: a product with the derivatives of another order of the results."""
    tape = Tape()
    x = ca.SX.sym("x", 3)
    a, b, c = tape.vector(x)
    ours = [
        tape.sine(a) * b - 2.0 * c,
        tape.inverse(b * b + 2.0) * tape.sine(-c, cosine=True),
        -(a * b) * c + 3.0,
        5.0 - a,
    ]
    theirs = ca.vertcat(
        ca.sin(x[0]) * x[1] - 2 * x[2],
        ca.cos(x[2]) / (x[1] ** 2 + 2),
        -x[0] * x[1] * x[2] + 3,
        5 - x[0],
    )
    J = np.array(ca.Function("J", [x], [ca.densify(ca.jacobian(theirs, x))])(AT))
    forward = [1.5, -0.5, 2.0]
    backward = [0.3, -1.0, 2.5, 0.75]

    def values(results: list[Any]) -> np.ndarray:
        return np.array(ca.Function("f", [x], [ca.vertcat(*tape.build(results))])(AT)).ravel()

    along = values(tape.jvp(ours, list(zip((a, b, c), forward, strict=True))))
    assert_allclose(along, J @ forward, rtol=1e-13, atol=1e-15)
    for order, equal in ((ours, True), (ours[::-1], False)):
        back = values(tape.vjp(list(zip(order, backward, strict=True)), [a, b, c]))
        assert np.allclose(back, backward @ J, rtol=1e-13, atol=1e-15) == equal


def test_inner_signs_of_sines_and_products_with_zero_cost_nothing() -> None:
    tape = Tape()
    a, b = tape.vector(ca.SX.sym("x", 2))
    for results, count in (
        ([a + b, b + a, -(a + b)], 2),
        ([a * b + 0.0, 1.0 * (b * a)], 1),
        ([a * 0.0, 2.0 * a + 3.0 * a], 1),
        ([2.0 * (3.0 * a), 6.0 * a], 1),
        ([tape.sine(a), tape.sine(-a)], 1),
        ([tape.sine(a, cosine=True), tape.sine(-a, cosine=True)], 0),
        ([tape.inverse(a), tape.inverse(4.0)], 1),
    ):
        assert tape.count(results) == count, results
