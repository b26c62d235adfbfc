"""Inverse dynamics as collocation optimal control on the reduced problem, solved by IPOPT.

Unknown are the non-actuated coordinates (q_e, v_e) at the nodes of a mesh and the arm's (q, v, a) at the Gauss points of
each interval. Everything that physics and the path demand is a hard constraint; what is left free is the initial state of
the zero dynamics, and the cost asks that the motion comes from rest and goes to rest:

    min  |y(0) - rest|^2 + |y(T) - rest|^2      s.t.   Gamma(q) = Z,  W v = Z',  W a + W' v = Z'',
                                                       [M a + c + g]_e = tau_e   at the Gauss points

With an unstable zero dynamics the second term picks the one motion that does not blow up, and the first one says how
long before the path it has to begin. Reducing first keeps the order: the reference enters by its exact derivatives
instead of being differentiated by the discretisation.

Source: L. Biegler, Nonlinear Programming, 2010, ch. 10 (collocation); A. Waechter, L. Biegler, Math. Prog. 106, 2006.
"""

from __future__ import annotations

import time

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp

from flexgen.errors import SolverError
from flexgen.problems.path import Path
from flexgen.solvers.nlp import NlpResult, Progress, solve_nlp
from flexgen.solvers.reduction import Reduction
from flexgen.solvers.tableaus import Tableau, gauss

DEFLECTION = 1e-2  # rad or m: the size of a deflection that matters, scales the unknowns
RATE = 1.0  # rad/s or m/s


@dataclass(frozen=True)
class Collocated:
    """Solution on the mesh.

    ``nodes`` (N + 1,) [s]; ``q_e``, ``v_e`` (N + 1, n_e); ``a_e`` (N, s, n_e) and ``q`` (N, s, n_a) at the Gauss points;
    ``nlp``: IPOPT's verdict.
    """

    nodes: np.ndarray
    q_e: np.ndarray
    v_e: np.ndarray
    a_e: np.ndarray
    q: np.ndarray
    nlp: NlpResult

    def dense(self, table: Tableau, parts: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Times, q_e, v_e and guessed q_a on a grid ``parts`` times finer, from the collocation polynomials."""
        h = np.diff(self.nodes)[:, None, None]
        theta = np.arange(parts) / parts
        once, twice = table.weights(theta)
        q_k, v_k = self.q_e[:-1, None, :], self.v_e[:-1, None, :]
        q = q_k + h * theta[None, :, None] * v_k + h**2 * np.einsum("ps,nse->npe", twice, self.a_e)
        v = v_k + h * np.einsum("ps,nse->npe", once, self.a_e)
        t = (self.nodes[:-1, None] + np.diff(self.nodes)[:, None] * theta).ravel()
        near = np.minimum((theta * self.q.shape[1]).astype(int), self.q.shape[1] - 1)
        guess = self.q[:, near, :].reshape(len(t), -1)
        n_e = self.q_e.shape[1]
        return (
            np.append(t, self.nodes[-1]),
            np.vstack([q.reshape(-1, n_e), self.q_e[-1:]]),
            np.vstack([v.reshape(-1, n_e), self.v_e[-1:]]),
            np.vstack([guess, self.q[-1, -1:]]),
        )


def collocate(
    reduction: Reduction,
    path: Path,
    nodes: np.ndarray,
    *,
    stages: int = 3,
    progress: Progress | None = None,
    max_iterations: int = 100,
) -> Collocated:
    """Solve the reduced inverse dynamics on the mesh ``nodes`` [s], which starts before the path and ends after it.

    SolverError where IPOPT does not converge; its verdict is in the text.
    """
    model = reduction.model
    n_a, n_e, N, table = model.n_a, model.n_e, len(nodes) - 1, gauss(stages)
    h = np.diff(nodes)
    times = (nodes[:-1, None] + h[:, None] * table.c).ravel()
    sample = path.sample(times)

    began = time.perf_counter()
    guess, rest = _guess(reduction, path, nodes, times)
    n_nodes, n_stage = 2 * n_e * (N + 1), 3 * n_a
    scale_x = np.concatenate(
        [np.tile(np.r_[np.full(n_e, DEFLECTION), np.full(n_e, RATE)], N + 1), np.tile(np.repeat([1.0, 1.0, 100.0], n_a), N * stages)]
    )
    linear, linear_rhs = _linear_rows(reduction, nodes, table)

    # one instant: residual and its Jacobian; rows scaled so that an error in q, v or a of size one weighs one
    stage = reduction.stage
    X, target, y1, y2 = (ca.SX.sym(stage.name_in(i), stage.size_in(i)[0]) for i in range(4))
    rows = stage(X, target, y1, y2)
    slope = ca.jacobian(rows, X)
    local = ca.Function("local", [X, target, y1, y2], [rows, slope])
    parameters = [reduction.targets(sample).T, sample.rates(1).T, sample.rates(2).T]
    n_rows = rows.shape[0]
    first = np.array(local(guess[n_nodes : n_nodes + n_stage], *[p[:, 0] for p in parameters])[1])
    size = np.abs(first * np.tile(np.repeat([1.0, 1.0, 100.0], n_a), (n_rows, 1))).max(axis=1)
    scale_g = np.concatenate([np.tile(1 / np.maximum(size, 1e-9), N * stages), np.ones(linear.shape[0])])

    x = ca.MX.sym("x", n_nodes + n_stage * N * stages)
    shown = x * ca.DM(scale_x)
    values, slopes = local.map(N * stages)(ca.reshape(shown[n_nodes:], n_stage, -1), *[ca.DM(p) for p in parameters])
    constant = sp.csc_matrix(linear)
    g = ca.vertcat(ca.vec(values), ca.mtimes(_dm(constant), shown) - ca.DM(linear_rhs)) * ca.DM(scale_g)
    jac = _jacobian(slope.sparsity(), slopes, constant, n_nodes, n_rows, N * stages, scale_x, scale_g)

    # the cost is quadratic and the constraints leave few freedoms: its own Hessian is all the curvature that is needed
    weight = np.zeros(len(scale_x))
    weight[: 2 * n_e] = 1.0
    weight[n_nodes - 2 * n_e : n_nodes] = 1.0
    deviation = x - ca.DM(np.concatenate([rest[0], np.zeros(n_nodes - 4 * n_e), rest[1], np.zeros(n_stage * N * stages)]) / scale_x)
    cost = ca.dot(ca.DM(weight), deviation**2) / 2
    curvature = ca.DM(sp.diags(weight).tocsc())
    result = solve_nlp(
        x,
        cost,
        g,
        jac,
        ca.MX(curvature),
        guess / scale_x,
        progress=progress,
        max_iterations=max_iterations,
        setup_s=time.perf_counter() - began,
    )
    if not result.success:
        raise SolverError(
            f"collocation: IPOPT ended with {result.status!r} after {result.iterations} iterations, "
            f"largest violation {result.violation:.2e}; try a longer --preview, a finer --mesh or --method full"
        )
    solution = result.x * scale_x
    states = solution[:n_nodes].reshape(N + 1, 2, n_e)
    instants = solution[n_nodes:].reshape(N, stages, 3, n_a)
    return Collocated(
        nodes, states[:, 0], states[:, 1], instants[:, :, 2, reduction.i_e], instants[:, :, 0], result
    )


def _dm(matrix: sp.spmatrix) -> ca.DM:
    return ca.DM(sp.csc_matrix(matrix))


def _guess(
    reduction: Reduction, path: Path, nodes: np.ndarray, times: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Quasi-static motion as a first guess, and the states of rest before and after the path."""
    from scipy.interpolate import CubicSpline

    n_e = len(reduction.i_e)
    start = reduction.start(path).q_a
    both = np.unique(np.concatenate([nodes, times]))
    slow = CubicSpline(both, reduction.follow(path, both, start))
    states = np.hstack([slow(nodes)[:, reduction.i_e], slow(nodes, 1)[:, reduction.i_e]])
    instants = np.hstack([slow(times), slow(times, 1), slow(times, 2)])
    rest = (
        np.concatenate([slow(nodes[0])[reduction.i_e], np.zeros(n_e)]),
        np.concatenate([slow(nodes[-1])[reduction.i_e], np.zeros(n_e)]),
    )
    return np.concatenate([states.ravel(), instants.ravel()]), rest


def _linear_rows(reduction: Reduction, nodes: np.ndarray, table: Tableau) -> tuple[sp.csr_matrix, np.ndarray]:
    """Collocation equations between nodes and Gauss points: linear, so written once as a sparse matrix."""
    n_a, i_e = reduction.model.n_a, np.array(reduction.i_e, dtype=int)
    n_e, N, s = len(i_e), len(nodes) - 1, len(table.c)
    n_nodes, n_stage = 2 * n_e * (N + 1), 3 * n_a
    rows: list[np.ndarray] = []
    cols: list[np.ndarray] = []
    vals: list[np.ndarray] = []
    e = np.arange(n_e)
    per = 2 * n_e * s + 2 * n_e  # equations an interval

    def put(row: np.ndarray, col: np.ndarray, value: float) -> None:
        rows.append(row)
        cols.append(col)
        vals.append(np.full(len(row), value))

    for k in range(N):
        h = nodes[k + 1] - nodes[k]
        q_k, q_next = 2 * n_e * k + e, 2 * n_e * (k + 1) + e
        stage = [n_nodes + n_stage * (k * s + i) for i in range(s)]
        for i in range(s):
            at = per * k + 2 * n_e * i + e
            put(at, stage[i] + i_e, 1.0)
            put(at, q_k, -1.0)
            put(at, q_k + n_e, -h * table.c[i])
            put(at + n_e, stage[i] + n_a + i_e, 1.0)
            put(at + n_e, q_k + n_e, -1.0)
            for j in range(s):
                put(at, stage[j] + 2 * n_a + i_e, -(h**2) * table.AA[i, j])
                put(at + n_e, stage[j] + 2 * n_a + i_e, -h * table.A[i, j])
        at = per * k + 2 * n_e * s + e
        put(at, q_next, 1.0)
        put(at, q_k, -1.0)
        put(at, q_k + n_e, -h)
        put(at + n_e, q_next + n_e, 1.0)
        put(at + n_e, q_k + n_e, -1.0)
        for j in range(s):
            put(at, stage[j] + 2 * n_a + i_e, -(h**2) * table.bb[j])
            put(at + n_e, stage[j] + 2 * n_a + i_e, -h * table.b[j])
    shape = (per * N, n_nodes + n_stage * N * s)
    matrix = sp.csr_matrix((np.concatenate(vals), (np.concatenate(rows), np.concatenate(cols))), shape=shape)
    return matrix, np.zeros(shape[0])


def _jacobian(
    block: ca.Sparsity,
    slopes: ca.MX,
    linear: sp.csc_matrix,
    n_nodes: int,
    n_rows: int,
    count: int,
    scale_x: np.ndarray,
    scale_g: np.ndarray,
) -> ca.MX:
    """The constraint Jacobian put together from the blocks of each instant and the constant rows."""
    row, col = (np.array(x) for x in block.get_triplet())
    n_stage, nnz = block.size2(), len(row)
    at = np.arange(count)[:, None]
    rows = (at * n_rows + row).ravel()
    cols = (n_nodes + at * n_stage + col).ravel()
    fixed = linear.tocoo()
    rows = np.concatenate([rows, n_rows * count + fixed.row])
    cols = np.concatenate([cols, fixed.col])
    order = np.lexsort((rows, cols))  # column by column, as CasADi stores it
    factor = scale_g[rows] * scale_x[cols]
    values = ca.vertcat(slopes.nz[:] if slopes.nnz() == nnz * count else ca.vec(slopes), ca.DM(fixed.data))
    values = values * ca.DM(factor)
    pattern = ca.Sparsity.triplet(n_rows * count + linear.shape[0], linear.shape[1], rows.tolist(), cols.tolist())
    return ca.MX(pattern, values[order.tolist()])


