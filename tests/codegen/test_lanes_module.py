"""Functions in C for several points at once: values of CasADi, the same bits in every lane, and
what has no C.
"""

from __future__ import annotations

import ctypes

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from toolchain import needs_compiler

from flexgen.base.errors import BuildError
from flexgen.codegen.build.c_module import load_module
from flexgen.codegen.build.lanes_module import lanes_module, lanes_text

pytestmark = needs_compiler
BODY = """
__attribute__((visibility("default"))) int lanes_of(void)
{
    return LANES;
}
__attribute__((visibility("default")))
void both(const double *x, const double *p, double *y, double *A, double *z, double *w)
{
    FIRST(x, p, y, A, (lanes *)aligned_1(w));
    SECOND(x, z, (lanes *)aligned_1(w));
}
"""


def functions(long: int = 1) -> dict[str, ca.Function]:
    """Two functions, of vectors and with a matrix; ``long``: times as many operations, which are
    split then.
    """
    x = ca.SX.sym("x", 3)
    p = ca.SX.sym("p", 2)
    y = ca.vertcat(
        ca.sin(x[0]) * ca.cos(x[1]), ca.fmax(x[2], p[0]) ** 3, ca.tanh(p[1]) / (1 + x[0] ** 2)
    )
    for k in range(long - 1):
        y = 0.5 * ca.sin(y + k * x) * ca.sqrt(1 + y[1] ** 2)
    A = ca.vertcat(ca.horzcat(x[0] * p[0], 0, ca.exp(x[1])), ca.horzcat(p[1], ca.fabs(x[2]), 2))
    z = ca.if_else(x[0] > 0, ca.atan2(x[1], x[2]), p[0] * 0 + x[1] ** 1.5 * 0 - 1)
    return {
        "FIRST": ca.Function("first", [x, p], [y, ca.sparsify(A)]),
        "SECOND": ca.Function("second", [x], [ca.substitute(z, p, ca.DM.zeros(2))]),
    }


@pytest.mark.parametrize("long", [1, 400])
def test_all_lanes_have_the_values_of_casadi_and_the_same_bits(long: int) -> None:
    made = functions(long)
    library = load_module(lanes_module("lanes_test", made, BODY))
    n = library.lanes_of()
    rng = np.random.default_rng(1)
    x = rng.uniform(-1, 1, (3, n))
    p = rng.uniform(0.5, 1, (2, n))
    x[:, -1] = x[:, 0]
    p[:, -1] = p[:, 0]
    y = np.zeros((3, n))
    A = np.zeros((6, n))
    z = np.zeros((1, n))
    w = np.zeros(10_000 * n)
    library.both(*(ctypes.c_void_p(each.ctypes.data) for each in (x, p, y, A, z, w)))
    for k in range(n):
        expected = made["FIRST"](x[:, k], p[:, k])
        assert_allclose(y[:, k], np.array(expected[0]).ravel(), rtol=1e-12, atol=1e-14)
        assert_allclose(A[:, k].reshape(3, 2).T, ca.densify(expected[1]), rtol=1e-14)
        assert_allclose(z[:, k], np.array(made["SECOND"](x[:, k])).ravel(), rtol=1e-14)
    for found in (y, A, z):
        assert (found[:, -1] == found[:, 0]).all()


def test_a_long_function_has_a_workspace_and_a_short_one_has_none() -> None:
    assert "#define FIRST_WORK 0\n" in lanes_text(functions(), BODY)
    text = lanes_text(functions(400), BODY)
    assert "#define FIRST_WORK 0\n" not in text and "#define SECOND_WORK 0\n" in text


def test_what_has_no_c_is_refused() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(BuildError, match="OP_ERFINV"):
        lanes_text({"FIRST": ca.Function("first", [x], [ca.erfinv(x)])}, BODY)
