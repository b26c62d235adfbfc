"""Collocation of second-order equations on a mesh: where the unknowns stand, and the sparse
matrices that follow.

Unknowns, in this order: the states (y, y') at all nodes; then for each interval the accelerations
y'' at its Gauss points and, for each of its instants, ``n_w`` further unknowns w. Within an
interval y follows by integrating the polynomial through the accelerations twice:

    y(t_k + c_i h) = y_k + c_i h y'_k + h^2 sum_j AA_ij y''_j,
    y'(t_k + c_i h) = y'_k + h sum_j A_ij y''_j
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import scipy.sparse as sp

from flexgen.base.calls.deadline import check_time
from flexgen.base.numerics.nlp import BUILDING
from flexgen.base.numerics.tableaus import Tableau


@dataclass(frozen=True)
class Transcription:
    """A mesh with its unknowns: ``nodes`` (N + 1,) [s], the method, ``n`` coordinates y, ``n_w``
    more an instant.
    """

    nodes: np.ndarray
    table: Tableau
    n: int
    n_w: int

    @property
    def N(self) -> int:
        """Number of intervals."""
        return len(self.nodes) - 1

    @property
    def s(self) -> int:
        """Number of Gauss points an interval."""
        return len(self.table.c)

    @cached_property
    def h(self) -> np.ndarray:
        """Lengths of the intervals [s]."""
        return np.diff(self.nodes)

    @cached_property
    def times(self) -> np.ndarray:
        """All Gauss points [s], (N s,)."""
        return (self.nodes[:-1, None] + self.h[:, None] * self.table.c).ravel()

    @property
    def n_nodes(self) -> int:
        """Number of unknowns at the nodes; the others come after them."""
        return 2 * self.n * (self.N + 1)

    @property
    def n_inner(self) -> int:
        """Number of unknowns within an interval."""
        return self.s * (self.n + self.n_w)

    @property
    def size(self) -> int:
        """Number of all unknowns."""
        return self.n_nodes + self.n_inner * self.N

    def pack(self, states: np.ndarray, accelerations: np.ndarray, w: np.ndarray) -> np.ndarray:
        """The vector of unknowns from states (N + 1, 2 n), accelerations (N s, n) and w (N s,
        n_w).
        """
        inner = np.hstack([accelerations.reshape(self.N, -1), w.reshape(self.N, -1)])
        return np.concatenate([states.ravel(), inner.ravel()])

    def unpack(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """y, y' (N + 1, n), accelerations (N, s, n) and w (N, s, n_w) from the vector of
        unknowns.
        """
        states = x[: self.n_nodes].reshape(self.N + 1, 2, self.n)
        inner = x[self.n_nodes :].reshape(self.N, self.n_inner)
        cut = self.s * self.n
        return (
            states[:, 0],
            states[:, 1],
            inner[:, :cut].reshape(self.N, self.s, self.n),
            inner[:, cut:].reshape(self.N, self.s, self.n_w),
        )

    def instant(self) -> tuple[ca.SX, ca.SX, ca.SX, tuple[ca.SX, ca.SX, ca.SX], ca.SX]:
        """Symbols of one instant: unknowns z, parameters (tableau row, selector) and h; then (y,
        y', y'') there, and w.

        ``z`` = (y, y' at the node before, accelerations of the interval, w of the instant).
        """
        n = self.n
        s = self.s
        z = ca.SX.sym("z", (2 + s) * n + self.n_w)
        row = ca.SX.sym("row", 1 + 3 * s)
        h = ca.SX.sym("h")
        return z, row, h, motion_at(z, row, h, n, s), z[(2 + s) * n :]

    @cached_property
    def parameters(self) -> list[np.ndarray]:
        """Values of the parameters (row, h) at all instants, one column each."""
        table = self.table
        rows = np.hstack([table.c[:, None], table.A, table.AA, np.eye(self.s)])
        return [np.tile(rows, (self.N, 1)).T, np.repeat(self.h, self.s)[None]]

    @cached_property
    def where(self) -> np.ndarray:
        """Where the unknowns z of each instant stand in x, shape (N s, size of z)."""
        k, i = np.divmod(np.arange(self.N * self.s), self.s)
        start = self.n_nodes + self.n_inner * k
        parts = [
            2 * self.n * k[:, None] + np.arange(2 * self.n),
            start[:, None] + np.arange(self.s * self.n),
            (start + self.s * self.n + self.n_w * i)[:, None] + np.arange(self.n_w),
        ]
        return np.hstack(parts)

    @property
    def own(self) -> tuple[np.ndarray, np.ndarray]:
        """Where each instant's own accelerations (N s, n) and w (N s, n_w) stand in x."""
        k, i = np.divmod(np.arange(self.N * self.s), self.s)
        start = (self.n_nodes + self.n_inner * k)[:, None]
        accelerations = start + self.n * i[:, None] + np.arange(self.n)
        return accelerations, start + self.s * self.n + self.n_w * i[:, None] + np.arange(self.n_w)

    @cached_property
    def continuity(self) -> sp.csc_matrix:
        """From node to node: linear in the unknowns, so written once as a sparse matrix (2 n N
        rows).
        """
        n = self.n
        k = np.repeat(np.arange(self.N), n)
        e = np.tile(np.arange(n), self.N)
        h = self.h[k]
        at = 2 * n * k + e
        here = 2 * n * k + e
        after = 2 * n * (k + 1) + e
        inner = self.n_nodes + self.n_inner * k + e
        one = np.ones(len(k))
        entries = [(at, after, one), (at, here, -one), (at, here + n, -h)]
        entries += [(at + n, after + n, one), (at + n, here + n, -one)]
        for j in range(self.s):
            entries += [
                (at, inner + n * j, -(h**2) * self.table.bb[j]),
                (at + n, inner + n * j, -h * self.table.b[j]),
            ]
        rows, cols, values = (np.concatenate(x) for x in zip(*entries, strict=True))
        return sp.csc_matrix((values, (rows, cols)), shape=(2 * n * self.N, self.size))

    def constraints(
        self,
        x: ca.MX,
        rows: ca.SX,
        symbols: list[ca.SX],
        values: list[np.ndarray],
        scale_x: np.ndarray,
        x0: np.ndarray,
    ) -> tuple[ca.MX, ca.MX, np.ndarray]:
        """Scaled constraints of all instants, then of all nodes, with their Jacobian, put together
        block by block.

        Parameters
        ----------
        x : MX (size)
            Scaled unknowns; the true ones are ``scale_x x``.
        rows : SX (m)
            Constraint values at one instant, in ``symbols`` = [z, parameters ...].
        values : arrays, one column an instant
            Values of the parameters.
        scale_x, x0 : arrays (size)
            Scales of the unknowns, and a true point at which the rows are scaled.

        Returns
        -------
        g, jacobian : MX
        scale : array (m)
            Factors that the rows of an instant were multiplied with.
        """
        slope = ca.jacobian(rows, symbols[0])
        block = slope.sparsity()
        local = ca.Function("instant", symbols, [rows, ca.vertcat(*slope.nonzeros())])
        count = self.N * self.s
        m = rows.shape[0]
        row, col = (np.array(i) for i in block.get_triplet())
        # rows scaled so that an error of the size of the unknowns' scales weighs one; several
        # instants, for a pose may hide what matters
        size = np.full(m, 1e-300)
        for k in np.unique(np.linspace(0, count - 1, 5).astype(int)):
            first = np.zeros(block.shape)
            first[row, col] = np.array(
                local(x0[self.where[k]], *[p[:, k] for p in values])[1]
            ).ravel()
            size = np.maximum(size, np.abs(first * scale_x[self.where[k]]).max(axis=1))
        scale = 1 / size
        check_time(BUILDING)
        gathered = ca.reshape(
            (x * ca.DM(scale_x))[self.where.ravel().tolist()], self.where.shape[1], count
        )
        found, slopes = local.map(count)(gathered, *[ca.DM(p) for p in values])
        check_time(BUILDING)
        between = self.continuity
        scale_g = np.r_[np.tile(scale, count), np.tile(1 / scale_x[: 2 * self.n], self.N)]
        g = ca.vertcat(ca.vec(found), ca.mtimes(ca.DM(between), x * ca.DM(scale_x))) * ca.DM(
            scale_g
        )
        check_time(BUILDING)
        fixed = between.tocoo()
        all_rows = np.concatenate(
            [(np.arange(count)[:, None] * m + row).ravel(), m * count + fixed.row]
        )
        all_cols = np.concatenate([self.where[:, col].ravel(), fixed.col])
        order = np.lexsort((all_rows, all_cols))  # column by column, as CasADi stores it
        entries = ca.vertcat(ca.vec(slopes), ca.DM(fixed.data)) * ca.DM(
            scale_g[all_rows] * scale_x[all_cols]
        )
        check_time(BUILDING)
        pattern = ca.Sparsity.triplet(
            m * count + between.shape[0], self.size, all_rows.tolist(), all_cols.tolist()
        )
        return g, ca.MX(pattern, entries[order.tolist()]), scale


def motion_at(z: ca.SX, row: ca.SX, h: ca.SX, n: int, s: int) -> tuple[ca.SX, ca.SX, ca.SX]:
    """(y, y', y'') at an instant of an interval of length h: ``z`` begins with (y, y' at its
    start, s accelerations).

    ``row`` (1 + 3 s,): the instant in the interval, then the weights of the accelerations for y',
    y and y''.
    """
    y = z[:n] + h * row[0] * z[n : 2 * n]
    dy = z[n : 2 * n]
    ddy = ca.SX.zeros(n)
    for j in range(s):
        a = z[(2 + j) * n : (3 + j) * n]
        dy = dy + h * row[1 + j] * a
        y = y + h**2 * row[1 + s + j] * a
        ddy = ddy + row[1 + 2 * s + j] * a
    return y, dy, ddy
