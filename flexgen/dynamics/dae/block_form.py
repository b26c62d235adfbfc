"""Block triangular form of a pattern: what must be solved together, and in which order.

Coarse form (Dulmage, Mendelsohn): equations that are too many, those that are too few, and the
well-determined part. Fine form: the strongly connected components of the well-determined part,
each solvable after those before it.

Source: A. Pothen, C.-J. Fan, ACM TOMS 16(4), 1990.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, maximum_bipartite_matching


@dataclass(frozen=True)
class BlockForm:
    """Row and column places of the parts of a pattern.

    ``blocks``: (rows, columns) of each square block, in the order in which they can be solved;
    ``surplus``: rows and columns of the part with too many rows; ``deficit``: of the part with too
    many columns.
    """

    blocks: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]
    surplus: tuple[tuple[int, ...], tuple[int, ...]]
    deficit: tuple[tuple[int, ...], tuple[int, ...]]


def block_form(pattern: np.ndarray) -> BlockForm:
    """The `BlockForm` of a pattern (rows, columns) of true and false: Dulmage-Mendelsohn
    decomposition.

    A largest matching of rows and columns; what alternating paths reach from unmatched rows has
    too many equations, from unmatched columns too few; the rest falls into blocks in the order in
    which they can be solved.
    """
    n_rows, n_columns = pattern.shape
    row_of = (
        maximum_bipartite_matching(csr_matrix(pattern), perm_type="row")
        if pattern.any()
        else -np.ones(n_columns, int)
    )
    row_of = np.asarray(row_of, dtype=int)
    column_of = -np.ones(n_rows, dtype=int)
    for column, row in enumerate(row_of):
        if row >= 0:
            column_of[row] = column
    surplus = _find_reached(pattern, np.flatnonzero(column_of < 0), column_of, row_of)
    columns, rows = _find_reached(pattern.T, np.flatnonzero(row_of < 0), row_of, column_of)
    deficit = (rows, columns)
    inner = [r for r in range(n_rows) if r not in {*surplus[0], *deficit[0]}]
    matched = [int(column_of[r]) for r in inner]
    # i needs the unknown of j
    links = pattern[np.ix_(inner, matched)] if inner else np.zeros((0, 0), dtype=bool)
    blocks = []
    for members in _order_components(links):
        blocks.append(
            (tuple(inner[i] for i in members), tuple(sorted(matched[i] for i in members)))
        )
    return BlockForm(tuple(blocks), surplus, deficit)


def _find_reached(
    pattern: np.ndarray, free: np.ndarray, partner: np.ndarray, back: np.ndarray
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Rows and columns that alternating paths reach from the unmatched rows ``free``: from a row
    to each of its columns, from a column to its partner.

    ``partner`` of rows, ``back`` of columns: numbers of the matched column or row, -1 without one.
    """
    rows = set(map(int, free))
    columns = set()
    waiting = list(map(int, free))
    while waiting:
        for column in np.flatnonzero(pattern[waiting.pop()]):
            if column not in columns:
                columns.add(int(column))
                if back[column] >= 0 and back[column] not in rows:
                    rows.add(int(back[column]))
                    waiting.append(int(back[column]))
    return tuple(sorted(rows)), tuple(sorted(columns))


def _order_components(links: np.ndarray) -> list[list[int]]:
    """Strongly connected components of a graph, each after those that it needs (``links[i, j]``: i
    needs j).
    """
    if not len(links):
        return []
    count, label = connected_components(csr_matrix(links), directed=True, connection="strong")
    members = [np.flatnonzero(label == k) for k in range(count)]
    needs = [
        {int(label[j]) for i in part for j in np.flatnonzero(links[i])} - {k}
        for k, part in enumerate(members)
    ]
    done: list[int] = []
    while len(done) < count:
        # among those that are ready the one with the first row comes first: a form that does not
        # depend on chance
        ready = [k for k in range(count) if k not in done and needs[k] <= set(done)]
        done.append(min(ready, key=lambda k: int(members[k][0])))
    return [list(map(int, members[k])) for k in done]
