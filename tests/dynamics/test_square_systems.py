"""Linear systems as graphs: solutions equal those of numbers, for every structure of zeros."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from flexgen.dynamics.mechanics import square_systems
from flexgen.dynamics.mechanics.square_systems import solve_square


def drawn_matrix(rng: np.random.Generator, n: int, share: float) -> np.ndarray:
    """A regular matrix (n, n) with about this share of entries, one in each row and column."""
    while True:
        A = rng.standard_normal((n, n)) * (rng.random((n, n)) < share)
        A[range(n), rng.permutation(n)] += rng.choice([-1.0, 1.0], n)
        if np.linalg.cond(A) < 1e3:
            return A


def worst_error(n: int, share: float) -> float:
    """Largest error of the solutions of ten drawn systems with three right sides."""
    rng = np.random.default_rng(n)
    worst = 0.0
    for _ in range(10):
        A = drawn_matrix(rng, n, share)
        B = rng.standard_normal((n, 3)) * (rng.random((n, 3)) < 0.7)
        given = ca.sparsify(ca.DM(A))
        symbols = ca.SX.sym("A", given.sparsity())
        right = ca.SX.sym("B", n, 3)
        solve = ca.Function("solve", [symbols, right], [solve_square(symbols, right)])
        found = np.array(solve(given, B))
        worst = max(worst, float(np.abs(found - np.linalg.solve(A, B)).max()))
    return worst


@pytest.mark.parametrize("share", [0.3, 1.0])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 9])
def test_solutions_are_those_of_numbers(n: int, share: float) -> None:
    """Blocks of all sizes, full and nearly triangular."""
    assert worst_error(n, share) < 1e-11


def test_a_lost_share_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns that are not made orthogonal."""
    monkeypatch.setattr(square_systems, "subtract_share", lambda x, factor, y: x)
    assert worst_error(4, 1.0) > 1e-3


def test_a_pivot_may_vanish() -> None:
    """A regular matrix whose first entry is zero at the point of evaluation alone."""
    A = ca.SX.sym("A", 2, 2)
    solve = ca.Function("solve", [A], [solve_square(A, ca.SX.eye(2))])
    given = np.array([[0.0, 2.0], [-1.0, 0.0]])
    assert np.abs(np.array(solve(given)) - np.linalg.inv(given)).max() < 1e-15


def test_blocks_without_connection_make_no_operations() -> None:
    """Two by two blocks: nothing of the zeros between them."""
    one = ca.SX.sym("one", 2, 2)
    two = ca.SX.sym("two", 2, 2)
    A = ca.diagcat(one, two)
    b = ca.SX.sym("b", 4)
    together = ca.Function("f", [one, two, b], [solve_square(A, b)])
    alone = ca.Function("f", [one, b], [solve_square(one, b[:2])])
    count = sum(1 for k in range(alone.n_instructions()) if alone.instruction_id(k) == ca.OP_MUL)
    found = sum(
        1 for k in range(together.n_instructions()) if together.instruction_id(k) == ca.OP_MUL
    )
    assert found == 2 * count


def test_constant_coefficients_are_eliminated_first() -> None:
    """Three unknowns that move three pairs of equations alike, as a platform that translates:
    their columns would make all others dense.
    """
    rng = np.random.default_rng(0)
    lines = []
    for k in range(3):
        own = [ca.SX(3, 2)] * 3
        own[k] = ca.SX.sym(f"arm_{k}", 3, 2)
        lines.append((own[k], ca.horzcat(*own, ca.SX.eye(3))))
    A = ca.vertcat(*[row for _, row in lines])
    arms = [arm for arm, _ in lines]
    b = ca.SX.sym("b", 9)
    solve = ca.Function("solve", [*arms, b], [A, solve_square(A, b)])
    given = [rng.standard_normal((3, 2)) for _ in arms]
    right = rng.standard_normal(9)
    matrix, found = (np.array(x) for x in solve(*given, right))
    assert np.abs(matrix @ found.ravel() - right).max() < 1e-13
    # all entries symbols: 937 operations
    assert solve.n_instructions() < 600
