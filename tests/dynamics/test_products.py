"""Products of derivatives against written forms."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.testing import assert_allclose

from flexgen.dynamics.mechanics import products


def test_products_of_derivatives_of_a_written_function() -> None:
    """f = [[x_0^2, x_0 x_1], [0, x_0 y]], g = x y: both products by hand."""
    x = ca.SX.sym("x", 2)
    y = ca.SX.sym("y")
    f = ca.vertcat(ca.horzcat(x[0] ** 2, x[0] * x[1]), ca.horzcat(0, x[0] * y))
    g = x * y
    at = np.array([2.0, -3.0])
    to = np.array([0.5, 0.25])
    one = 1.5
    step = -2.0
    given, names, found, named = products.jvp([x, y], ["x", "y"], [f, g], ["f", "g"])
    assert (names, named) == (["x", "y", "x_tangent", "y_tangent"], ["f_tangent", "g_tangent"])
    df, dg = (np.array(v) for v in ca.Function("jvp", given, found)(at, one, to, step))
    assert_allclose(df, [[2 * 2 * 0.5, 0.5 * -3 + 2 * 0.25], [0, 0.5 * 1.5 + 2 * -2]], rtol=1e-15)
    assert_allclose(dg[:, 0], [0.5 * 1.5 + 2 * -2, 0.25 * 1.5 - 3 * -2], rtol=1e-15)
    given, names, found, named = products.vjp([x, y], ["x", "y"], [f, g], ["f", "g"])
    assert (names, named) == (
        ["x", "y", "f_cotangent", "g_cotangent"],
        ["x_cotangent", "y_cotangent"],
    )
    F = np.array([[1.0, 2.0], [3.0, 4.0]])
    G = np.array([5.0, 6.0])
    back, of_y = (np.array(v) for v in ca.Function("vjp", given, found)(at, one, F, G))
    assert_allclose(
        back[:, 0], [2 * 2 * 1 + -3 * 2 + 1.5 * 4 + 1.5 * 5, 2 * 2 + 1.5 * 6], rtol=1e-15
    )
    assert_allclose(of_y, 2 * 4 + 2 * 5 - 3 * 6, rtol=1e-15)
    assert [v.shape for v in found] == [(2, 1), (1, 1)]
