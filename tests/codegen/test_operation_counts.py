"""Operations of a function: sums, products, divisions, roots and signs, as written."""

from __future__ import annotations

import casadi as ca
import pytest

from flexgen.codegen.recursion.functions import operations_of

X = ca.SX.sym("x")
Y = ca.SX.sym("y")


@pytest.mark.parametrize(
    ("expression", "count"),
    [
        (X + Y, 1),
        (ca.sin(X) * Y, 1),
        (ca.sqrt(X) / Y - X * X, 4),
        (-ca.cos(X), 1),
        (2 * X + 1 / Y, 3),
        (ca.exp(X), 0),
        (ca.tanh(X + 1), 1),
    ],
)
def test_calls_of_functions_are_not_counted(expression: ca.SX, count: int) -> None:
    assert operations_of(ca.Function("f", [X, Y], [expression])) == count
