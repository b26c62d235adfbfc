"""Solution of regular linear systems as CasADi graphs, with the zeros of their structure.

    A X = B

The matrix is permuted to block triangular form. Blocks of one to three rows are solved by their
determinants, larger ones by orthogonalization of their columns, so no pivot can vanish where the
matrix is regular: elimination with pivots that are chosen at one position would fail at others.

Source: block triangular form: A. Pothen, C.-J. Fan, ACM Trans. Math. Softw. 16(4), 1990;
modified Gram-Schmidt with the right side as a further column: N. Higham, Accuracy and Stability of
Numerical Algorithms, 2002, ch. 20.
"""

from __future__ import annotations

import casadi as ca

# Rows of a block up to which determinants take fewer operations than orthogonal columns.
BY_DETERMINANT = 3

Column = list[ca.SX]


def solve_square(A: ca.SX, B: ca.SX) -> ca.SX:
    """``X`` (n, m) with ``A X = B``, A (n, n) regular; structural zeros make no operations."""
    A = ca.sparsify(A)
    count, rows, columns, first_row, _, _, _ = A.sparsity().btf()
    found: dict[int, Column] = {}
    right = [[B[i, k] for k in range(B.shape[1])] for i in range(B.shape[0])]
    for block in range(count):
        own = range(first_row[block], first_row[block + 1])
        at = [columns[k] for k in own]
        lines = [rows[k] for k in own]
        sides = []
        for i in lines:
            line = right[i]
            for j in found:
                if A.sparsity().has_nz(i, j):
                    line = [x - _times(A[i, j], y) for x, y in zip(line, found[j], strict=True)]
            sides.append(line)
        solve = _by_determinant if len(at) <= BY_DETERMINANT else _by_orthogonal_columns
        matrix = [[A[i, j] for j in at] for i in lines]
        solved = zip(
            *(solve(matrix, list(side)) for side in zip(*sides, strict=True)), strict=True
        )
        found |= dict(zip(at, (list(line) for line in solved), strict=True))
    return ca.sparsify(ca.vertcat(*[ca.horzcat(*found[j]) for j in range(A.shape[1])]))


def _times(x: ca.SX, y: ca.SX) -> ca.SX:
    return ca.SX(0) if x.is_zero() or y.is_zero() else x * y


def _dot(x: Column, y: Column) -> ca.SX:
    return sum((_times(a, b) for a, b in zip(x, y, strict=True)), ca.SX(0))


def _by_determinant(A: list[Column], b: Column) -> Column:
    """Solution of up to three equations."""
    n = len(b)
    if all(x.is_zero() for x in b):
        return [ca.SX(0)] * n
    if n == 1:
        return [b[0] / A[0][0]]
    if n == 2:
        cofactors = [[A[1][1], -A[0][1]], [-A[1][0], A[0][0]]]
    else:
        cofactors = [
            [
                _times(A[(j + 1) % 3][(i + 1) % 3], A[(j + 2) % 3][(i + 2) % 3])
                - _times(A[(j + 1) % 3][(i + 2) % 3], A[(j + 2) % 3][(i + 1) % 3])
                for j in range(3)
            ]
            for i in range(3)
        ]
    inverse = 1 / _dot(A[0], [row[0] for row in cofactors])
    return [_times(_dot(row, b), inverse) for row in cofactors]


def _by_orthogonal_columns(A: list[Column], b: Column) -> Column:
    """Solution by modified Gram-Schmidt, without square roots: columns with few entries first."""
    n = len(b)
    if all(x.is_zero() for x in b):
        return [ca.SX(0)] * n
    columns = {j: [row[j] for row in A] for j in range(n)}
    order = sorted(range(n), key=lambda j: sum(not x.is_zero() for x in columns[j]))
    shares: dict[tuple[int, int], ca.SX] = {}
    of_b: dict[int, ca.SX] = {}
    for k, j in enumerate(order):
        direction = columns[j]
        inverse = 1 / _dot(direction, direction)
        for i in order[k + 1 :]:
            share = _times(_dot(direction, columns[i]), inverse)
            if not share.is_zero():
                shares[j, i] = share
                columns[i] = subtract_share(columns[i], share, direction)
        of_b[j] = _times(_dot(direction, b), inverse)
        if not of_b[j].is_zero():
            b = subtract_share(b, of_b[j], direction)
    x: dict[int, ca.SX] = {}
    for k, j in reversed(list(enumerate(order))):
        x[j] = of_b[j]
        for i in order[k + 1 :]:
            if (j, i) in shares:
                x[j] = x[j] - _times(shares[j, i], x[i])
    return [x[j] for j in range(n)]


def subtract_share(x: Column, factor: ca.SX, y: Column) -> Column:
    """``x - factor y``."""
    return [a - _times(factor, b) for a, b in zip(x, y, strict=True)]
