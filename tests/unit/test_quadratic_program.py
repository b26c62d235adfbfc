"""Quadratic programs of the limits against OSQP and against the conditions of optimality."""

from __future__ import annotations

import numpy as np
import osqp
import pytest
import scipy.sparse as sp

from flexgen.numerics.quadratic_program import solve_program

CLOSE = 1e-6  # of OSQP with tolerances of 1e-9, relative


def program(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A random program with condition 1e4 or so, whose bounds a known point keeps."""
    rng = np.random.default_rng(seed)
    n, rows = int(rng.integers(3, 40)), int(rng.integers(5, 120))
    B = rng.normal(size=(n, n)) * np.logspace(0, -1, n)
    A = rng.normal(size=(rows, n))
    A[0] = 0.0  # a bound that does not depend on the unknowns
    return B @ B.T + 1e-2 * np.eye(n), 3 * rng.normal(size=n), A, A @ rng.normal(size=n) + rng.uniform(0, 0.5, rows)


def solved(H: np.ndarray, gradient: np.ndarray, A: np.ndarray, bound: np.ndarray) -> np.ndarray | None:
    return solve_program(sp.csc_matrix(H), gradient, sp.csr_matrix(A), bound)


def is_optimal(x: np.ndarray, H: np.ndarray, gradient: np.ndarray, A: np.ndarray, bound: np.ndarray) -> bool:
    """Whether x keeps the bounds and the gradient there is a sum of active rows with negative factors."""
    active = A[A @ x > bound - 1e-7]
    factors, *_ = np.linalg.lstsq(active.T, -(H @ x + gradient), rcond=None)
    left = np.abs(active.T @ factors + H @ x + gradient).max()
    kept = (A @ x - bound).max() < 1e-9 * (1 + np.abs(bound).max())
    return bool(kept and left < 1e-7 * (1 + np.abs(gradient).max()) and (factors > -1e-7).all())


@pytest.mark.parametrize("seed", range(12))
def test_the_solution_is_that_of_osqp_and_optimal(seed: int) -> None:
    H, gradient, A, bound = program(seed)
    x = solved(H, gradient, A, bound)
    assert x is not None
    solver = osqp.OSQP()
    solver.setup(
        sp.csc_matrix(np.triu(H)), gradient, sp.csc_matrix(A), np.full(len(bound), -np.inf), bound,
        verbose=False, eps_abs=1e-9, eps_rel=1e-9, max_iter=200_000,
    )  # fmt: skip
    expected = solver.solve(raise_error=True).x
    assert np.abs(x - expected).max() < CLOSE * (1 + np.abs(expected).max())
    assert is_optimal(x, H, gradient, A, bound)
    assert not is_optimal(x + 1e-3, H, gradient, A, bound)  # a planted error


def test_free_and_infeasible_programs() -> None:
    H, gradient = np.diag([2.0, 8.0]), np.array([-2.0, 8.0])
    assert np.allclose(solved(H, gradient, np.eye(2), np.array([9.0, 9.0])), [1.0, -1.0], atol=1e-12)
    contradiction = np.array([[1.0, 0.0], [-1.0, 0.0]])
    assert solved(H, gradient, contradiction, np.array([-1.0, -1.0])) is None
    assert solved(H, gradient, np.zeros((1, 2)), np.array([-1.0])) is None
