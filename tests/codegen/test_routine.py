"""Steps of emitted functions: operations are counted by doing them, entry by entry."""

from __future__ import annotations

import casadi as ca
import pytest

from flexgen.codegen.statements import routine

X = ca.SX.sym("x")


def eliminated(n: int, columns: int, unit: bool, profile: tuple[int, ...]) -> tuple[int, int]:
    """Operations of a factorization of a band, and of the solutions of its columns."""
    pairs = [(i, j) for i in range(n) for j in range(profile[i], i)]
    factor = sum(1 + 2 * (n - i) for i, _ in pairs) + sum(range(n))
    ahead = 2 * len(pairs)
    back = 2 * sum(range(n)) + n
    return factor, (ahead + back) * (columns + (n if unit else 0))


@pytest.mark.parametrize(
    ("n", "columns", "unit", "profile"),
    [(4, 3, False, (0, 0, 0, 0)), (5, 2, True, (0, 0, 1, 1, 3))],
)
def test_linear_systems_have_the_operations_of_elimination(
    n: int, columns: int, unit: bool, profile: tuple[int, ...]
) -> None:
    """Entries outside of the band are skipped; a matrix that is factored is only solved."""
    factor, solution = eliminated(n, columns, unit, profile)
    for factored in (False, True):
        made = routine.Solve("A", "R", n, columns, unit, profile, (), factored=factored)
        assert made.operations == solution + (0 if factored else factor)
        assert made.width == columns + (n if unit else 0) and made.depth == 40 * n
        # rows are as long as whole lines of a cache, and one more
        assert made.stride % 64 == 16 and made.stride >= made.width
        assert made.matrix_stride % 64 == 16 and made.matrix_stride >= n + factored


def test_a_factorization_solves_for_one_vector() -> None:
    made = routine.Factor("A", "b", "x", 3, (0, 0, 0))
    assert made.operations == (7 + 5 + 5) + 6 + 6 and made.depth == 90
    assert made.matrix_stride == 80


@pytest.mark.parametrize(("columns", "stride"), [(1, 80), (64, 80), (65, 144), (128, 144)])
def test_rows_begin_in_other_lines_of_a_cache(columns: int, stride: int) -> None:
    assert routine.Solve("A", "R", 2, columns, False, (0, 0), ()).stride == stride


def test_products_have_the_operations_of_scalar_products() -> None:
    above = (routine.Rows("a", 0, 2), routine.Rows("b", 0, 2))
    below = (routine.Rows("c", 0, 5), routine.Rows("d", 0, 5))
    made = routine.Products(above, below, 8, "M")
    assert (made.operations, made.depth, made.symmetric) == (9 * 36 + 3 * 28, 40, False)
    assert routine.Products(above, above[::-1], 8, "M").operations == 3 * 36
    with pytest.raises(ValueError, match="products: given 7 columns, expected at least 8"):
        routine.Products(above, below, 7, "M")


def test_columns_need_zeros_for_zeros() -> None:
    f = ca.Function("f", [X], [1 + X], ["x"], ["y"])
    with pytest.raises(ValueError, match="columns: given f, which does not give zeros for zeros"):
        routine.Columns(f, 3)


def test_the_profile_is_the_first_entry_of_each_row() -> None:
    A = ca.SX.zeros(3, 3)
    A[0, 0] = A[1, 1] = A[2, 2] = A[2, 1] = A[1, 2] = X
    f = ca.Function("A", [X], [ca.densify(A)], ["x"], ["A"])
    assert routine.profile(f, "A") == (0, 1, 1)
