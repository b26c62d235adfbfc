"""Standstill of motors: friction is any torque there, up to that at which they move, and is taken out of equations.

Where a motor stands still, the torque s of its friction is not known. Unknown are the values of piecewise linear
functions of time over each standstill; B is what they are in the samples y = X theta + B s + e behind the filter. With

    R = 1 - B (B' B + r)^-1 B',      R y = R X theta + R e

the numbers theta are found without s: the ridge r is small, and R is the same for all terms. To leave out the samples
at standstill would not do: the filter carries the jump of the friction into samples that move.

Source: R. Frisch and F. Waugh, Econometrica 1(4), 1933 (least squares with some of the unknowns eliminated).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

SHORTEST = 0.25  # standstill times the limit of the filter: what is shorter is a reversal, and makes no difference
CELLS = 8.0  # of the piecewise linear functions, in 1 / limit
FAINT = 1e-3  # of the largest torque at standstill, which may remain
TOGETHER = 32  # functions that are filtered at a time

Filter = Callable[[np.ndarray], np.ndarray]


class Rests:
    """What one motor may do while it stands still.

    Parameters
    ----------
    still : array (n,)
        Whether it does, at each sample.
    limit : float
        Of the filter, times the step of the samples.
    slow : callable
        The filter: samples (n, ...) -> those that are kept. A cut of the samples that begins at a multiple of ``every``
        has the same ones.
    every, reach : int
        Samples of one that is kept, and samples on both sides that act on it.
    """

    def __init__(self, still: np.ndarray, limit: float, slow: Filter, every: int, reach: int) -> None:
        rows, columns, values, count = [], [], [], 0
        edges = np.flatnonzero(np.diff(still.astype(int), prepend=0, append=0)).reshape(-1, 2)
        for first, last in edges[(edges[:, 1] - edges[:, 0]) * limit > SHORTEST]:
            nodes = np.linspace(first, last - 1, 2 + round(CELLS * (last - first) * limit))
            cell = nodes[1] - nodes[0]
            for some in np.split(nodes, range(TOGETHER, len(nodes), TOGETHER)):
                begin = max(0, int(some[0] - cell) - reach) // every * every
                at = np.arange(begin, min(len(still), int(some[-1] + cell) + reach + 2))
                inside = (at >= first) & (at < last)
                hats = inside[:, None] * np.maximum(0.0, 1.0 - np.abs(at[:, None] - some) / cell)
                out = slow(hats)
                row, column = np.nonzero(out)
                rows.append(row + begin // every)
                columns.append(column + count)
                values.append(out[row, column])
                count += len(some)
        self._rests = None
        size = 1 + max((int(row.max(initial=-1)) for row in rows), default=-1)
        if size > 0:
            places = np.concatenate(rows), np.concatenate(columns)
            self._rests = sparse.csc_matrix((np.concatenate(values), places), (size, count))
            square = (self._rests.T @ self._rests).tocsc()
            ridge = FAINT**2 * float(square.diagonal().max())
            self._solve = splu(square + ridge * sparse.identity(count, format="csc")).solve

    def project(self, x: np.ndarray) -> np.ndarray:
        """Samples (n, ...) behind the filter without what standstill can do."""
        if self._rests is None:
            return x
        B, out = self._rests, x.reshape(len(x), -1).copy()
        out[: B.shape[0]] -= B @ self._solve(B.T @ out[: B.shape[0]])
        return out.reshape(x.shape)
