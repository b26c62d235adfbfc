"""The inverse dynamics without strangeness: the regularized DAE of Kunkel and Mehrmann, from the
derivative array.

With M = dF_mu/d(x', ..., x^(mu+1)) and N = dF_mu/dx at a point,

    Z2' M = 0,  T2: Z2' N T2 = 0,  Z1: range of F_x' T2          a columns, d columns, d columns

the system ``Z1' F(x, x', u) = 0`` (d rows), ``Z2' F_mu = 0`` (a rows) has the same solutions and
no hidden constraints. The matrices are computed numerically, by QR factorizations of the scaled
array, and may be kept for a while: the system stays equivalent as long as the blocks they select
stay regular.

Source: P. Kunkel, V. Mehrmann, Differential-Algebraic Equations, 2006, ch. 4.3 and 6.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import qr, solve_triangular

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.dae.derivative_array import DerivativeArray
from flexgen.dynamics.dae.system import InverseDae

GAP = 1e-9  # relative size below which a pivot of the array counts as zero
CLEAR = 1e2  # least ratio of the pivots on both sides of a rank decision
ITERATIONS = 40
TOLERANCE = 1e-14  # of a correction of a consistent point, in units of the scales
CONSISTENT = 1e-10  # of the array's rows, in units of the scales
STALLED = 1e-7  # a correction that is smaller and shrinks no more is rounding


@dataclass(frozen=True)
class Split:
    """The regularized system at a point, in scaled unknowns and rows.

    ``Z1`` (n_x, d), ``Z2`` ((mu + 1) n_x, a), ``T2`` (n_x, d); ``N``: Jacobian of the array in x;
    ``A``, ``E``: of F in x, x'; ``gap``: ratio of the pivots of M on both sides of its rank.
    `solve` gives the step of the derivatives.
    """

    Z1: np.ndarray
    Z2: np.ndarray
    T2: np.ndarray
    N: np.ndarray
    A: np.ndarray
    E: np.ndarray
    gap: float
    factors: tuple[np.ndarray, np.ndarray, np.ndarray]

    def solve(self, rows: np.ndarray) -> np.ndarray:
        """A solution w of ``Q1' (rows + M w) = 0`` for the part of the array that M reaches, free
        entries zero.
        """
        Q1, R, order = self.factors
        w = np.zeros(len(order))
        w[order[: len(R)]] = -solve_triangular(R, Q1.T @ rows)
        return w


class StrangenessFree:
    """The regularized DAE of a model.

    Parameters
    ----------
    dae : InverseDae
    mu : int
        Strangeness index: the order of the derivative array; the structural index less one, where
        that is right.
    x_rest : array (n_x,)
        A static equilibrium, for the scales.

    ``a``, ``d``: numbers of algebraic and differential equations; SolverError where the ranks are
    not clear, or do not satisfy the hypothesis (``a + d = n_x``) for this mu.
    """

    def __init__(self, dae: InverseDae, mu: int, x_rest: np.ndarray) -> None:
        """``mu``: how often the whole system is differentiated; ``x_rest`` (n_x,): the robot at
        rest, where ranks are decided, as the path plays no role there.
        """
        if mu < 0:
            raise ArgumentError(f"mu: given {mu}, expected 0 or more")
        self.dae = dae
        self.mu = mu
        self.n = dae.n_x
        size, torque, self.rate = dae.scales(x_rest)
        self.unit = np.concatenate([size, size * self.rate, torque])
        self.units = np.outer(self.unit, self.rate ** np.arange(mu + 2))
        # ranks are decided at rest, with the target where the output is: there the path plays no
        # role
        X = np.zeros((self.n, mu + 2))
        U = np.zeros((dae.n_u, mu + 1))
        X[:, 0] = x_rest
        U[:, 0] = dae.target_at(x_rest)
        self._at_rest = X, U
        self.row = np.ones((mu + 1) * self.n)
        N, M = self._jacobians(X, U)
        first = np.hstack([N[: self.n], M[: self.n]])
        row = np.maximum(np.abs(first).max(axis=1), 1e-300)
        self.row = np.concatenate([row * self.rate**k for k in range(mu + 1)])

    @cached_property
    def _array(self) -> DerivativeArray:
        return DerivativeArray(self.dae, self.mu)

    def rows(self, X: np.ndarray, U: np.ndarray) -> np.ndarray:
        """The scaled derivative array at X (n_x, mu + 2), U (n_u, mu + 1)."""
        return self._array.rows(X, U).full()[:, 0] / self.row

    def motion(self, x: np.ndarray, dx: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The scaled rows F at x, x' (n_x,) and a target u (n_u,)."""
        return self.dae.rows(x, dx, u)[0].full()[:, 0] / self.row[: self.n]

    def _jacobians(self, X: np.ndarray, U: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives N and M of the derivative array in x and in its derivatives, with scaled
        rows and columns, at a point X (n_x, mu + 2) of the path U.
        """
        _, N, M = (z.full() for z in self._array.function(X, U))
        return N * self.unit / self.row[:, None], M * self.units[:, 1:].T.ravel() / self.row[
            :, None
        ]

    @property
    def a(self) -> int:
        """Number of algebraic equations."""
        return self._ranks[0]

    @property
    def d(self) -> int:
        """Number of differential equations."""
        return self._ranks[1]

    @property
    def gap(self) -> float:
        """Ratio of the pivots on both sides of the rank of M at rest."""
        return self._ranks[2]

    @cached_property
    def _ranks(self) -> tuple[int, int, float]:
        """Numbers of algebraic and differential equations a and d, and the gap: the ratio of the
        last pivot that counts for the rank of M to the next one, at rest.

        Raises
        ------
        SolverError
            The array does not make the DAE regular.
        """
        N, M = self._jacobians(*self._at_rest)
        Q, R, _ = qr(M, pivoting=True)
        pivots = np.abs(np.diag(R))
        rank = int(np.sum(pivots > GAP * pivots[0]))
        a = len(M) - rank
        gap = float(pivots[rank - 1] / max(pivots[rank], 1e-300)) if a else np.inf
        Z2 = Q[:, rank:]
        constraint = Z2.T @ N
        values = np.linalg.svd(constraint, compute_uv=False) if a else np.ones(1)
        d = self.n - a
        fine = gap > CLEAR and 0 <= a <= self.n and values[-1] > GAP * values[0]
        if fine and d:
            T2 = _null(constraint, d)
            moved = np.linalg.svd(M[: self.n, : self.n] @ T2, compute_uv=False)
            fine = moved[-1] > GAP * moved[0]
        if not fine:
            raise SolverError(
                f"the derivative array of order {self.mu} does not make the DAE regular: corank "
                f"{a} of {len(M)}, {self.n} unknowns; it never does at a singular pose or with "
                "a zero at infinity, use lq"
            )
        return a, d, gap

    def split(self, X: np.ndarray, U: np.ndarray) -> Split:
        """The regularized system at a point X (n_x, mu + 2) of the path U, by projections of the
        derivative array on its constraints and its dynamics; SolverError where the rank has
        changed.
        """
        N, M = self._jacobians(X, U)
        Q, R, order = qr(M, pivoting=True)
        rank = len(M) - self.a
        pivots = np.abs(np.diag(R))
        gap = float(pivots[rank - 1] / max(pivots[rank], 1e-300)) if self.a else np.inf
        if not gap > CLEAR:
            raise SolverError(
                "the rank of the derivative array changes on the path, at a singular pose; "
                "choose another path"
            )
        Z2 = Q[:, rank:]
        A = N[: self.n]
        E = M[: self.n, : self.n]
        T2 = _null(Z2.T @ N, self.d)
        Z1 = np.linalg.svd(E @ T2, full_matrices=False)[0] if self.d else np.zeros((self.n, 0))
        return Split(Z1, Z2, T2, N, A, E, gap, (Q[:, :rank], R[:rank, :rank], order))

    def consistent(self, X: np.ndarray, U: np.ndarray) -> np.ndarray:
        """A consistent point (n_x, mu + 2) near X (x and guesses of its derivatives), by
        Gauss-Newton on the array.

        First the derivatives alone: where x satisfies all constraints it stays; then all, by steps
        of least size. SolverError where it does not converge.
        """
        X = np.array(X, dtype=float)
        for free in (slice(self.n, None), slice(None)):
            before = np.inf
            for _ in range(ITERATIONS):
                jacobian = np.hstack(self._jacobians(X, U))[:, free]
                step = np.zeros((self.mu + 2) * self.n)
                step[free] = np.linalg.lstsq(jacobian, -self.rows(X, U), rcond=GAP)[0]
                X = X + self.units * step.reshape(self.mu + 2, self.n).T
                size = float(np.abs(step).max())
                done = size <= TOLERANCE or (size < STALLED and size > 0.3 * before)
                if done or not np.isfinite(size):
                    break
                before = size
            if done and np.abs(self.rows(X, U)).max() < CONSISTENT:
                return X
        raise SolverError(
            "no consistent values found: the path leaves the workspace or passes a singular "
            "pose; choose another path"
        )


def _null(matrix: np.ndarray, size: int) -> np.ndarray:
    """Orthonormal basis (n, size) of the null space of a matrix of full row rank."""
    Q, _ = np.linalg.qr(matrix.T, mode="complete")
    return Q[:, Q.shape[1] - size :]
