"""Solution of regular linear systems as CasADi graphs, with the zeros of their structure.

    A X = B

Unknowns with a constant coefficient are eliminated by it, as those of a platform that translates.
The rest of the matrix is permuted to block triangular form. Blocks of one to three rows are solved
by their determinants, larger ones by orthogonalization of their columns, so no pivot can vanish
where the matrix is regular: elimination with pivots that are chosen at one position would fail at
others.

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
    n = A.shape[0]
    left = {i: [A[i, j] for j in range(n)] for i in range(n)}
    right = {i: [B[i, k] for k in range(B.shape[1])] for i in range(n)}
    gone = _eliminate_constants(left, right)
    columns = [j for j in range(n) if j not in [pivot for _, pivot in gone]]
    used = [row for row, _ in gone]
    rest = {i: line for i, line in left.items() if i not in used}
    found = _solve_blocks(rest, right, columns)
    for i, j in reversed(gone):
        line = right[i]
        for k, solved in found.items():
            line = subtract_share(line, left[i][k], solved)
        found[j] = [_times(x, 1 / left[i][j]) for x in line]
    return ca.sparsify(ca.vertcat(*[ca.horzcat(*found[j]) for j in range(n)]))


def _eliminate_constants(
    left: dict[int, Column], right: dict[int, Column]
) -> list[tuple[int, int]]:
    """Eliminate unknowns by equations in which they have a constant coefficient: pairs (equation,
    unknown) in order. Changes the other equations in place.
    """
    gone: list[tuple[int, int]] = []
    while True:
        open_rows = [i for i in left if i not in [row for row, _ in gone]]
        pivots = [
            (sum(not x.is_zero() for x in left[i]), i, j)
            for i in open_rows
            for j, x in enumerate(left[i])
            if _is_pivot(x, [left[k][j] for k in open_rows])
        ]
        if not pivots:
            return gone
        _, i, j = min(pivots)
        gone.append((i, j))
        for k in open_rows:
            if k != i and not left[k][j].is_zero():
                share = left[k][j] / left[i][j]
                right[k] = subtract_share(right[k], share, right[i])
                left[k] = subtract_share(left[k], share, left[i])
                left[k][j] = ca.SX(0)


def _is_pivot(x: ca.SX, column: Column) -> bool:
    """Whether a coefficient is a constant, and no other one of its unknown is larger."""
    if not x.is_constant() or not all(y.is_constant() for y in column):
        return False
    return 0.0 < abs(float(x)) == max(abs(float(y)) for y in column)


def _solve_blocks(
    left: dict[int, Column], right: dict[int, Column], columns: list[int]
) -> dict[int, Column]:
    """The unknowns of ``columns`` from as many equations."""
    lines = list(left)
    found: dict[int, Column] = {}
    if not columns:
        return found
    A = ca.sparsify(ca.vertcat(*[ca.horzcat(*[left[i][j] for j in columns]) for i in lines]))
    count, rows, order, first_row, _, _, _ = A.sparsity().btf()
    for block in range(count):
        own = range(first_row[block], first_row[block + 1])
        at = [columns[order[k]] for k in own]
        here = [lines[rows[k]] for k in own]
        sides = []
        for i in here:
            line = right[i]
            for j, solved in found.items():
                line = subtract_share(line, left[i][j], solved)
            sides.append(line)
        solve = _by_determinant if len(at) <= BY_DETERMINANT else _by_orthogonal_columns
        matrix = [[left[i][j] for j in at] for i in here]
        solved_lines = zip(
            *(solve(matrix, list(side)) for side in zip(*sides, strict=True)), strict=True
        )
        found |= dict(zip(at, (list(line) for line in solved_lines), strict=True))
    return found


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
    return [a if b.is_zero() else a - _times(factor, b) for a, b in zip(x, y, strict=True)]
