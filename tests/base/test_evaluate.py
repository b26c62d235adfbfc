"""CasADi functions over many points, by way of memory that CasADi and NumPy share."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from flexgen.base.numerics.evaluate import Evaluator, evaluate
from flexgen.dynamics.mechanics.equations import derive

RNG = np.random.default_rng(28)
x = ca.SX.sym("x", 3)
A = ca.SX.sym("A", 2, 3)
empty = ca.SX.sym("none", 0)
DENSE = ca.Function("dense", [x, A, empty], [ca.sin(A @ x), A * ca.repmat(x.T, 2, 1), ca.SX(0, 1)])
SPARSE = ca.Function("sparse", [x], [ca.diag(x), x[0] * x])


@pytest.mark.parametrize("n", [1, 2, 40])
def test_dense_functions_have_the_bits_of_a_call_at_each_point(n: int) -> None:
    points = RNG.normal(size=(n, 3))
    matrix = RNG.normal(size=(2, 3))
    found = evaluate(DENSE, points, matrix, np.zeros(0))
    assert [y.shape for y in found] == [(n, 2), (n, 2, 3), (n, 0)]
    for k, point in enumerate(points):
        for y, one in zip(found[:2], DENSE(point, matrix, np.zeros(0)), strict=False):
            assert (y[k].reshape(one.shape) == np.array(one)).all()


@pytest.mark.parametrize("n", [1, 5])
def test_sparse_results_are_full_arrays(n: int) -> None:
    points = RNG.normal(size=(n, 3))
    diagonal, product = evaluate(SPARSE, points)
    assert (diagonal == points[:, :, None] * np.eye(3)).all() and (
        product == points[:, :1] * points
    ).all()


def test_repeated_calls_do_not_depend_on_the_last_call() -> None:
    function = derive("elbow").function("mass_matrix")
    again = Evaluator(function)
    first = again(np.array([0.3, -1.1, *[0.0] * (function.nnz_in(0) - 2)]))[0]
    kept = first.copy()
    second = again(np.ones(function.nnz_in(0)))[0]
    assert (first == kept).all() and (first != second).any()
    assert (second == np.array(function(np.ones(function.nnz_in(0))))).all()


def test_a_function_that_fails_raises() -> None:
    y = ca.SX.sym("y")
    root = ca.rootfinder("root", "newton", {"x": y, "g": y**2 + 1}, {"error_on_fail": True})
    function = ca.Function("f", [z := ca.MX.sym("z")], [root(z, ca.DM(0, 1))])
    with pytest.raises(RuntimeError, match="rootfinder"):
        evaluate(function, np.array([0.3]))


def test_functions_are_evaluated_at_many_points_as_one_by_one() -> None:
    """Outputs: a matrix, a column and a scalar; inputs with and without points, a matrix, one
    without elements.
    """
    x = ca.SX.sym("x", 3)
    A = ca.SX.sym("A", 2, 3)
    s = ca.SX.sym("s")
    none = ca.SX.sym("e", 0)
    function = ca.Function("f", [x, A, s, none], [s * A + 1, A @ x, ca.sumsqr(x)])
    chance = np.random.default_rng(1)
    X = chance.normal(size=(4, 3))
    B = chance.normal(size=(2, 3))
    found = evaluate(function, X, B, 2.5 * np.ones(4)[:, None], np.zeros((4, 0)))
    assert [y.shape for y in found] == [(4, 2, 3), (4, 2), (4, 1)]
    assert_allclose(found[0], np.repeat(2.5 * B[None] + 1, 4, axis=0), rtol=1e-14)
    assert_allclose(found[1], X @ B.T, rtol=1e-13)
    assert_allclose(found[2][:, 0], (X**2).sum(axis=1), rtol=1e-13)
    many = evaluate(function, X[0], np.stack([B, 2 * B]), np.array([[1.0], [3.0]]), np.zeros(0))
    assert_allclose(many[0], [B + 1, 6 * B + 1], rtol=1e-14)
    one = evaluate(function, X[1], B, [1.5], [])
    assert [y.shape for y in one] == [(1, 2, 3), (1, 2), (1, 1)]
    assert_allclose(one[1][0], B @ X[1], rtol=1e-14)


def test_outputs_with_structural_zeros_have_zeros_there() -> None:
    x = ca.SX.sym("x", 2)
    outputs = ca.Function("f", [x], [ca.diag(x), x * 3])
    X = np.array([[1.0, 2.0], [3.0, 4.0]])
    found = evaluate(outputs, X)
    assert_array_equal(found[0], [np.diag(row) for row in X])
    assert_array_equal(found[1], 3 * X)
    single = ca.Function("single", [x], [ca.diag(x)])
    assert_array_equal(evaluate(single, X[0])[0], [np.diag(X[0])])


def test_an_evaluator_keeps_no_result_of_an_earlier_call() -> None:
    A = ca.SX.sym("A", 2, 3)
    none = ca.SX.sym("e", 0)
    call = Evaluator(ca.Function("f", [A, none], [A.T, ca.SX(0, 1)]))
    B = np.arange(6.0).reshape(2, 3)
    first = call(B, np.zeros(0))
    second = call(-B, np.zeros(0))
    assert_array_equal(first[0], B.T)
    assert_array_equal(second[0], -B.T)
    with pytest.raises(ValueError, match="zip"):
        call(B)
