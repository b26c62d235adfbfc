"""Stiction of motors: the friction torque is unknown at standstill and is eliminated by
projection.

Where a motor stands still, the torque s of its friction is not known. Unknown are the values of
piecewise linear functions of time over each standstill; B is what they are in the samples y = X
theta + B s + e behind the filter. With

    R = 1 - B (B' B + r)^-1 B',      R y = R X theta + R e

the numbers theta are found without s: the ridge r is small, and R is the same for all terms.
Leaving out the samples at standstill is not sufficient: the filter spreads the jump of the
friction over samples that move.

Where a motor reverses, its friction turns from -F to F within a distance d (pre-sliding): after a
travel x,
2 F exp(-x/d) is missing, which is an impulse 2 F (pi d / (2 |a|))^(1/2) for the acceleration a.
One unknown more has those of all reversals.

Source: R. Frisch and F. Waugh, Econometrica 1(4), 1933 (least squares with some of the unknowns
eliminated); C. Canudas de Wit et al., IEEE TAC 40(3), 1995 (pre-sliding).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from flexgen.model.elements import RobotModel

MOVING = 0.01  # of the largest speed: slower motors stand still, and are not judged
SHORTEST = 0.25  # standstill times the limit of the filter: what is shorter is a reversal
CELLS = 8.0  # of the piecewise linear functions, in 1 / limit
FAINT = 1e-3  # of the largest torque at standstill, which may remain
TOGETHER = 32  # functions that are filtered at a time

Filter = Callable[[np.ndarray], np.ndarray]


def largest_of_unit(model: RobotModel, speed: np.ndarray) -> np.ndarray:
    """Largest speed (n_m,) of motors whose joint has the same unit; ``speed`` (n, n_m) [rad/s or
    m/s, of joints].
    """
    units = np.array(
        [model.coordinates[model.i_g[i]].unit for i in np.abs(model.eta).argmax(axis=1)]
    )
    top = np.abs(speed).max(axis=0)
    return np.array([top[units == unit].max() for unit in units])


class Rests:
    """Filtered stiction regressors of one motor, and a regressor of the delayed friction where the
    motor reverses.

    Parameters
    ----------
    speed : array (n,)
    least : float
        Speed below which it stands still.
    limit : float
        Of the filter, times the step of the samples.
    slow : callable
        The filter: samples (n, ...) -> those that are kept. A cut of the samples that begins at a
        multiple of ``every`` has the same ones.
    every, reach : int
        Samples of one that is kept, and samples on both sides that act on it.
    spoiled : int
        Kept samples at each end that are not used, nor given to `project`.
    """

    def __init__(
        self,
        speed: np.ndarray,
        least: float,
        limit: float,
        slow: Filter,
        every: int,
        reach: int,
        spoiled: int = 0,
    ) -> None:
        rows = []
        columns = []
        values = []
        count = 0
        late = np.zeros((len(speed), 1))
        still = np.abs(speed) <= least
        edges = np.flatnonzero(np.diff(still.astype(int), prepend=0, append=0)).reshape(-1, 2)
        for first, last in edges:
            if (last - first) * limit <= SHORTEST:
                if first > 0 and last < len(speed) and speed[first - 1] * speed[last] < 0:
                    change = (speed[last] - speed[first - 1]) / (last - first + 1)
                    late[first:last] = np.sign(change) / np.sqrt(np.abs(change)) / (last - first)
                continue
            cells = round(CELLS * (last - first) * limit)
            nodes = np.linspace(first, last - 1, cells + 1)
            for some in np.split(nodes, range(TOGETHER, len(nodes), TOGETHER)):
                cell = nodes[1] - nodes[0]
                begin = max(0, int(some[0] - cell) - reach) // every * every
                at = np.arange(begin, min(len(speed), int(some[-1] + cell) + reach + 2))
                inside = (at >= first) & (at < last)
                out = slow(
                    inside[:, None] * np.maximum(0.0, 1.0 - np.abs(at[:, None] - some) / cell)
                )
                row, column = np.nonzero(out)
                rows.append(row + begin // every - spoiled)
                columns.append(column + count)
                values.append(out[row, column])
                count += len(some)
        if late.any():
            out = slow(late / np.abs(late).max())[:, 0]
            rows.append(np.arange(len(out)) - spoiled)
            columns.append(np.full(len(out), count))
            values.append(out)
            count += 1
        self._rests = None
        if count:
            row, column, value = (np.concatenate(x) for x in (rows, columns, values))
            kept = len(slow(np.zeros(len(speed)))) - 2 * spoiled
            used = (row >= 0) & (row < kept) & (value != 0.0)
            self._rests = sparse.csc_matrix(
                (value[used], (row[used], column[used])), (kept, count)
            )
            square = (self._rests.T @ self._rests).tocsc()
            ridge = max(FAINT**2 * float(square.diagonal().max()), 1e-300)
            self._solve = splu(square + ridge * sparse.identity(count, format="csc")).solve

    def project(self, x: np.ndarray) -> np.ndarray:
        """Samples (n, ...) behind the filter after elimination of the friction at standstill."""
        if self._rests is None:
            return x
        out = x.reshape(len(x), -1)
        return (out - self._rests @ self._solve(self._rests.T @ out)).reshape(x.shape)
