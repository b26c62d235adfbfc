"""CasADi functions over many points, by way of memory that CasADi and NumPy share."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

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
