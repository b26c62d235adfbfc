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
ACCELERATION = 100.0  # rad/s^2 or m/s^2


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
    model, table = reduction.model, gauss(stages)
    n_a, n_e, n_g, N = model.n_a, model.n_e, model.n_g, len(nodes) - 1
    h = np.diff(nodes)
    times = (nodes[:-1, None] + h[:, None] * table.c).ravel()
    sample = path.sample(times)
    began = time.perf_counter()
    guess, rest = _guess(reduction, path, nodes, times)

    # the unknowns: states at the nodes; for each interval the accelerations a_e and then (q_g, v_g, a_g) of its instants
    n_w = 3 * n_g
    n_state, n_inner = 2 * n_e, stages * (n_e + n_w)
    n_nodes = n_state * (N + 1)
    scale_state = np.r_[np.full(n_e, DEFLECTION), np.full(n_e, RATE)]
    scale_w = np.repeat([1.0, 1.0, ACCELERATION], n_g)
    scale_inner = np.r_[np.full(stages * n_e, ACCELERATION), np.tile(scale_w, stages)]
    scale_x = np.r_[np.tile(scale_state, N + 1), np.tile(scale_inner, N)]

    local, block = _instant(reduction, stages)
    n_rows, count = local.size1_out(0), N * stages
    parameters = [
        np.tile(np.hstack([table.c[:, None], table.A, table.AA, np.eye(stages)]), (N, 1)).T,
        np.repeat(h, stages)[None],
        reduction.targets(sample).T,
        sample.rates(1).T,
        sample.rates(2).T,
    ]
    # rows scaled so that an error in q, v or a of the size of their scales weighs one
    where = _columns(N, stages, n_nodes, n_state, n_inner, n_e, n_w)  # (count, columns of the block)
    x0 = guess[where[0]]
    first = np.zeros(block.shape)
    first[tuple(np.array(i) for i in block.get_triplet())] = np.array(local(x0, *[p[:, 0] for p in parameters])[1]).ravel()
    local_scale = np.r_[scale_state, np.full(stages * n_e, ACCELERATION), scale_w]
    size = np.maximum(np.abs(first * local_scale).max(axis=1), 1e-9)

    x = ca.MX.sym("x", len(scale_x))
    shown = x * ca.DM(scale_x)
    gathered = ca.reshape(shown[where.ravel().tolist()], where.shape[1], count)
    values, slopes = local.map(count)(gathered, *[ca.DM(p) for p in parameters])
    linear = _continuity(nodes, table, n_e, n_nodes, n_inner)
    scale_g = np.r_[np.tile(1 / size, count), np.tile(1 / scale_state, N)]
    g = ca.vertcat(ca.vec(values), ca.mtimes(_dm(linear), shown)) * ca.DM(scale_g)
    jac = _jacobian(block, slopes, linear, where, n_rows, scale_x, scale_g)

    # the cost is quadratic and the constraints leave few freedoms: its own Hessian is all the curvature that is needed
    weight = np.zeros(len(scale_x))
    weight[:n_state] = 1.0
    weight[n_nodes - n_state : n_nodes] = 1.0
    aim = np.zeros(len(scale_x))
    aim[:n_state], aim[n_nodes - n_state : n_nodes] = rest
    deviation = x - ca.DM(aim / scale_x)
    cost = ca.dot(ca.DM(weight), deviation**2) / 2
    curvature = ca.DM(sp.diags(weight).tocsc())
    setup_s = time.perf_counter() - began
    result = solve_nlp(
        x,
        cost,
        g,
        jac,
        ca.MX(curvature),
        guess / scale_x,
        progress=progress,
        max_iterations=max_iterations,
        setup_s=setup_s,
    )
    if not result.success:
        raise SolverError(
            f"collocation: IPOPT ended with {result.status!r} after {result.iterations} iterations, "
            f"largest violation {result.violation:.2e}; try a longer --preview, a finer --mesh or --method full"
        )
    solution = result.x * scale_x
    states = solution[:n_nodes].reshape(N + 1, 2, n_e)
    inner = solution[n_nodes:].reshape(N, n_inner)
    a_e = inner[:, : stages * n_e].reshape(N, stages, n_e)
    q = np.zeros((N, stages, n_a))
    q[:, :, reduction.i_g] = inner[:, stages * n_e :].reshape(N, stages, n_w)[:, :, :n_g]
    return Collocated(nodes, states[:, 0], states[:, 1], a_e, q, result)


def _instant(reduction: Reduction, stages: int) -> tuple[ca.Function, ca.Sparsity]:
    """Residual at one Gauss point and the nonzeros of its Jacobian.

    Unknowns: (q_e, v_e at the node before, a_e at all Gauss points of the interval, (q_g, v_g, a_g) at this one);
    parameters: row (c, A, AA) of the tableau, h, target, Z', Z''. The deflections at the point follow by integration.
    """
    n_a, i_g, i_e = reduction.model.n_a, reduction.i_g, reduction.i_e
    n_e, n_g = len(i_e), len(i_g)
    z = ca.SX.sym("z", (2 + stages) * n_e + 3 * n_g)
    row, h = ca.SX.sym("row", 1 + 2 * stages), ca.SX.sym("h")
    stage = reduction.stage
    target, y1, y2 = (ca.SX.sym(stage.name_in(i), stage.size_in(i)[0]) for i in (1, 2, 3))
    q_k, v_k = z[:n_e], z[n_e : 2 * n_e]
    a = [z[(2 + j) * n_e : (3 + j) * n_e] for j in range(stages)]
    w = z[(2 + stages) * n_e :]
    q_e, v_e, a_e = q_k + h * row[0] * v_k, v_k, ca.SX.zeros(n_e)
    own = ca.SX.sym("own", stages)  # picks this instant's acceleration
    for j in range(stages):
        v_e = v_e + h * row[1 + j] * a[j]
        q_e = q_e + h**2 * row[1 + stages + j] * a[j]
        a_e = a_e + own[j] * a[j]
    place = ca.SX.zeros(3 * n_a)
    for level, part in enumerate((q_e, v_e, a_e)):
        place[[level * n_a + i for i in i_e]] = part
        place[[level * n_a + i for i in i_g]] = w[level * n_g : (level + 1) * n_g]
    X = ca.SX.sym("X", 3 * n_a)
    rows = stage(X, target, y1, y2)
    slope = ca.mtimes(ca.jacobian(rows, X), ca.jacobian(place, z))
    rows, slope = ca.substitute([rows, slope], [X], [place])
    block = slope.sparsity()
    function = ca.Function("instant", [z, ca.vertcat(row, own), h, target, y1, y2], [rows, ca.vertcat(*slope.nonzeros())])
    return function, block


def _columns(N: int, stages: int, n_nodes: int, n_state: int, n_inner: int, n_e: int, n_w: int) -> np.ndarray:
    """Where the unknowns of each instant stand in x, shape (N stages, columns of its block)."""
    k, i = np.divmod(np.arange(N * stages), stages)
    start = n_nodes + n_inner * k
    parts = [
        n_state * k[:, None] + np.arange(n_state),
        start[:, None] + np.arange(stages * n_e),
        (start + stages * n_e + n_w * i)[:, None] + np.arange(n_w),
    ]
    return np.hstack(parts)


def _dm(matrix: sp.spmatrix) -> ca.DM:
    return ca.DM(sp.csc_matrix(matrix))


def _guess(
    reduction: Reduction, path: Path, nodes: np.ndarray, times: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Quasi-static motion as a first guess, and the states of rest before and after the path."""
    from scipy.interpolate import CubicSpline

    n_e, i_e, i_g = len(reduction.i_e), reduction.i_e, reduction.i_g
    start = reduction.start(path).q_a
    both = np.unique(np.concatenate([nodes, times]))
    slow = CubicSpline(both, reduction.follow(path, both, start))
    N = len(nodes) - 1
    states = np.hstack([slow(nodes)[:, i_e], slow(nodes, 1)[:, i_e]])
    a_e = slow(times, 2)[:, i_e].reshape(N, -1)
    w = np.hstack([slow(times, k)[:, i_g] for k in range(3)]).reshape(N, -1)
    rest = (
        np.concatenate([slow(nodes[0])[i_e], np.zeros(n_e)]),
        np.concatenate([slow(nodes[-1])[i_e], np.zeros(n_e)]),
    )
    return np.concatenate([states.ravel(), np.hstack([a_e, w]).ravel()]), rest


def _continuity(nodes: np.ndarray, table: Tableau, n_e: int, n_nodes: int, n_inner: int) -> sp.csc_matrix:
    """From node to node: linear in the unknowns, so written once as a sparse matrix."""
    N, s = len(nodes) - 1, len(table.c)
    k = np.repeat(np.arange(N), n_e)
    e = np.tile(np.arange(n_e), N)
    h = np.diff(nodes)[k]
    at = 2 * n_e * k + e
    here, after, inner = 2 * n_e * k + e, 2 * n_e * (k + 1) + e, n_nodes + n_inner * k + e
    one = np.ones(len(k))
    entries = [(at, after, one), (at, here, -one), (at, here + n_e, -h)]
    entries += [(at + n_e, after + n_e, one), (at + n_e, here + n_e, -one)]
    for j in range(s):
        entries += [(at, inner + n_e * j, -(h**2) * table.bb[j]), (at + n_e, inner + n_e * j, -h * table.b[j])]
    rows, cols, values = (np.concatenate(x) for x in zip(*entries, strict=True))
    return sp.csc_matrix((values, (rows, cols)), shape=(2 * n_e * N, n_nodes + n_inner * N))


def _jacobian(
    block: ca.Sparsity,
    slopes: ca.MX,
    linear: sp.csc_matrix,
    where: np.ndarray,
    n_rows: int,
    scale_x: np.ndarray,
    scale_g: np.ndarray,
) -> ca.MX:
    """The constraint Jacobian put together from the blocks of each instant and the constant rows."""
    row, col = (np.array(x) for x in block.get_triplet())
    count = len(where)
    fixed = linear.tocoo()
    rows = np.concatenate([(np.arange(count)[:, None] * n_rows + row).ravel(), n_rows * count + fixed.row])
    cols = np.concatenate([where[:, col].ravel(), fixed.col])
    order = np.lexsort((rows, cols))  # column by column, as CasADi stores it
    values = ca.vertcat(ca.vec(slopes), ca.DM(fixed.data)) * ca.DM(scale_g[rows] * scale_x[cols])
    shape = (n_rows * count + linear.shape[0], linear.shape[1])
    pattern = ca.Sparsity.triplet(*shape, rows.tolist(), cols.tolist())
    return ca.MX(pattern, values[order.tolist()])
