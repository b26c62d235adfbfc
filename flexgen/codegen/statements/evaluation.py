"""The values of a routine without C: the steps of the emitted functions in NumPy."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexgen.codegen.statements.routine import (
    Columns,
    Expressions,
    Factor,
    Products,
    Routine,
    Rows,
    Selected,
    Solve,
    Sums,
    Zeros,
)


def evaluate_routine(  # noqa: C901
    program: Routine, inputs: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Ports and intermediate arrays of a routine.

    Parameters
    ----------
    program : Routine
    inputs : mapping of str to numpy.ndarray
        The value of each input, (rows, columns) or (rows,).

    Returns
    -------
    dict of str to numpy.ndarray
        All arrays by name, (rows, columns).
    """
    known = {name: np.asarray(x, dtype=float) for name, x in inputs.items()}

    def rows(part: Rows) -> np.ndarray:
        return known[part.array][part.first : part.first + part.count]

    for step in program.steps:
        match step:
            case Expressions():
                results = step.function.call([known[name] for name in step.function.name_in()])
                for name, x in zip(step.function.name_out(), results, strict=True):
                    known[name] = (known[name] if step.added else 0.0) + x.full()
            case Columns():
                names = step.function.name_in()
                given = {
                    name: step.tables[name] if name in step.tables else known[name]
                    for name in names
                }
                columns = [
                    step.function.call([given[name][:, k] for name in names])
                    for k in range(step.n)
                ]
                for i, name in enumerate(step.function.name_out()):
                    known[name] = np.hstack([column[i].full() for column in columns])
            case Sums():
                gained = np.zeros((step.rows, step.n))
                gained[:, list(step.at)] = known[step.source]
                order = slice(None, None, -1 if step.backward else 1)
                total = np.cumsum(gained[:, order], axis=1)[:, order]
                known[step.target] = total + np.reshape(step.start or (0.0,) * step.rows, (-1, 1))
            case Selected():
                known[step.target] = known[step.source][: step.rows, list(step.at)]
            case Products():
                above, below = (
                    rows(left).T @ rows(right) for left, right in (step.above, step.below)
                )
                whole = known.setdefault(step.target, np.zeros((step.n, 0)))
                more = max(step.first + step.n - whole.shape[1], 0)
                known[step.target] = np.hstack([whole, np.zeros((len(whole), more))])
                known[step.target][: step.n, step.first : step.first + step.n] = np.triu(
                    above, 1
                ) + np.tril(below)
            case Zeros():
                known[step.array] = np.zeros((step.rows, step.columns))
            case Factor():
                known[step.solution] = np.linalg.solve(
                    _symmetric(known[step.matrix]), known[step.right].T
                ).T
            case Solve():
                right = known[step.right]
                right = np.hstack([right, -np.eye(step.n)]) if step.unit else right
                known |= _evaluate_solve(
                    step, -np.linalg.solve(_symmetric(known[step.matrix]), right)
                )
    return known


def _symmetric(A: np.ndarray) -> np.ndarray:
    """The matrix of an upper half."""
    return np.triu(A) + np.triu(A, 1).T


def _evaluate_solve(step: Solve, X: np.ndarray) -> dict[str, np.ndarray]:
    """The ports of a solution X (n, width): its blocks of columns at their rows, and the ones of
    ``step``; other entries are zero.
    """
    out: dict[str, np.ndarray] = {}
    for port in step.ports:
        blocks = [block for block in step.blocks if block.port == port]
        rows = max(
            [
                *(block.row + step.n for block in blocks),
                *(1 + row for name, row, _ in step.ones if name == port),
            ]
        )
        out[port] = np.zeros((rows, sum(block.count for block in blocks)))
        at = 0
        for block in blocks:
            here = X[:, block.first : block.first + block.count]
            out[port][block.row : block.row + step.n, at : at + block.count] = here
            at += block.count
        for name, row, column in step.ones:
            if name == port:
                out[port][row, column] = 1.0
    return out
