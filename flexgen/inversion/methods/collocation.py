"""Inverse dynamics as collocation optimal control on the reduced problem, solved by IPOPT.

Unknown are the non-actuated coordinates (q_e, v_e) at the nodes of a mesh and the arm's (q, v, a)
at the Gauss points of each interval. The equations of motion and the path are constraints. The
initial state of the zero dynamics is free, and the cost is the distance from equilibrium at both
ends:

    min  |y(0) - y_eq|^2 + |y(T) - y_eq|^2      s.t.   Gamma(q) = Z,  W v = Z',  W a + W' v = Z'',
                                                       [M a + c + g]_e = tau_e
                                                       at the Gauss points

With an unstable zero dynamics the second term selects the bounded motion, and the first term
determines the pre-actuation. The reference enters by its exact derivatives, which keeps the order
of the Gauss points.

Source: L. Biegler, Nonlinear Programming, 2010, ch. 10 (collocation); A. Waechter, L. Biegler,
Math. Prog. 106, 2006.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp
from scipy.interpolate import CubicSpline, make_interp_spline

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import SolverError
from flexgen.base.numerics.nlp import BUILDING, NlpResult, NonlinearProgram, Progress, solve_nlp
from flexgen.base.numerics.tableaus import Tableau, gauss
from flexgen.base.numerics.transcription import Transcription
from flexgen.inversion.methods import full_model
from flexgen.inversion.methods.method_result import MethodResult, with_motors
from flexgen.inversion.problem.problem import ACCELERATION, InversionProblem
from flexgen.inversion.problem.reduced_problem import Motion, Reduction
from flexgen.inversion.solution import motion_residual
from flexgen.paths.path import Path, PathSample

STAGES = 3
ITERATIONS = 100  # of IPOPT, at most
DEFLECTION = 1e-2  # rad or m: the size of a deflection that matters, scales the unknowns
RATE = 1.0  # rad/s or m/s
BEFORE = 8  # samples at rest before the mesh, for the derivatives of a spline at its start


@dataclass(frozen=True)
class Collocated:
    """Solution on the mesh.

    ``nodes`` (N + 1,) [s]; ``q_e``, ``v_e`` (N + 1, n_e); ``a_e`` (N, s, n_e) and ``q`` (N, s,
    n_a) at the Gauss points; ``nlp``: result of IPOPT.
    """

    nodes: np.ndarray
    q_e: np.ndarray
    v_e: np.ndarray
    a_e: np.ndarray
    q: np.ndarray
    nlp: NlpResult

    def dense(
        self, table: Tableau, count: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Times, q_e, v_e and approximate q_a on a grid ``count`` times finer, from the
        collocation polynomials.
        """
        h = np.diff(self.nodes)[:, None, None]
        theta = np.arange(count) / count
        once, twice = table.weights(theta)
        q_k = self.q_e[:-1, None, :]
        v_k = self.v_e[:-1, None, :]
        q = q_k + h * theta[None, :, None] * v_k + h**2 * np.einsum("ps,nse->npe", twice, self.a_e)
        v = v_k + h * np.einsum("ps,nse->npe", once, self.a_e)
        t = (self.nodes[:-1, None] + np.diff(self.nodes)[:, None] * theta).ravel()
        near = np.minimum((theta * self.q.shape[1]).astype(int), self.q.shape[1] - 1)
        guess = self.q[:, near, :].reshape(len(t), -1)
        n_e = self.q_e.shape[1]
        return (
            np.append(t, self.nodes[-1]),
            np.vstack([q.reshape(len(t), n_e), self.q_e[-1:]]),
            np.vstack([v.reshape(len(t), n_e), self.v_e[-1:]]),
            np.vstack([guess, self.q[-1, -1:]]),
        )


def solve(problem: InversionProblem, h: float) -> MethodResult:
    """Solve the reduced problem on intervals of ``h`` [s]; with limits the full model, see
    `full_model`. No options.
    """
    problem.check_options("collocation")
    if problem.limits is not None:
        return full_model.solve(problem, h)
    reduction = Reduction(problem.equations)
    path = problem.path
    preactuation, nodes = problem.nodes(h)
    found = collocate(reduction, path, nodes, stages=STAGES, progress=problem.progress)
    count = max(1, int(np.ceil(np.diff(nodes).max() / problem.step - 1e-9)))
    t, q_e, v_e, guess = found.dense(gauss(STAGES), count)
    sample = path.sample(t)
    guess[:, list(problem.equations.model.i_e)] = q_e
    q = reduction.close(guess, reduction.targets(sample))
    motion, doubtful = reduction.motion(sample, q, v_e)
    candidates = [motion] if motion is not None else []
    if doubtful:
        candidates.append(_smooth_by_spline(reduction, sample, t, q, nodes, found.q_e))
    results = [
        with_motors(
            problem.equations,
            t,
            candidate,
            preactuation=preactuation,
            verdict=found.nlp.status,
            iterations=found.nlp.iterations,
            intervals=len(nodes) - 1,
        )
        for candidate in candidates
    ]
    if len(results) == 1:
        return results[0]
    return min(results, key=lambda result: float(motion_residual(problem.equations, result).max()))


def _smooth_by_spline(
    reduction: Reduction,
    sample: PathSample,
    t: np.ndarray,
    q: np.ndarray,
    nodes: np.ndarray,
    q_e: np.ndarray,
) -> Motion:
    """The motion whose non-actuated coordinates and derivatives are those of a spline of degree 7
    through the solution.

    ``t`` (n,) [s], ``q`` (n, n_a): instants and a guess of the coordinates there; ``nodes``,
    ``q_e``: the mesh and the non-actuated coordinates at its nodes.
    """
    # at rest before: without samples from then the derivatives of a spline are poor at its start
    before = nodes[0] - (nodes[1] - nodes[0]) * np.arange(BEFORE, 0, -1)
    smooth = make_interp_spline(
        np.r_[before, nodes], np.vstack([np.tile(q_e[0], (len(before), 1)), q_e]), k=7
    )
    q = q.copy()
    q[:, reduction.i_e] = smooth(t)
    return reduction.motion_through(
        sample, reduction.close(q, reduction.targets(sample)), [smooth(t, k) for k in (1, 2, 3, 4)]
    )


def collocate(
    reduction: Reduction,
    path: Path,
    nodes: np.ndarray,
    *,
    stages: int = 3,
    progress: Progress | None = None,
) -> Collocated:
    """Solve the reduced problem on a mesh.

    Parameters
    ----------
    reduction : Reduction
    path : Path
    nodes : array (N + 1,) [s]
        From before the path to after it.
    stages : int
        Gauss points of an interval.
    progress : callable, optional
        Called with one line of text now and then.

    Raises
    ------
    SolverError
        IPOPT does not converge; its status is in the text.
    """
    n_e = len(reduction.i_e)
    i_e = reduction.i_e
    i_g = reduction.i_g
    n_a = reduction.model.n_a
    n_g = reduction.model.n_g
    mesh = Transcription(nodes, gauss(stages), n_e, 3 * n_g)
    sample = path.sample(mesh.times)
    guess, ends = _guess(reduction, path, mesh)
    check_time(BUILDING)

    z, row, h, deflection, w = mesh.instant()
    X = ca.SX.zeros(3 * n_a)
    for level, part in enumerate(deflection):
        X[[level * n_a + i for i in i_e]] = part
        X[[level * n_a + i for i in i_g]] = w[level * n_g : (level + 1) * n_g]
    target, y1, y2 = (ca.SX.sym(f"target{i}", reduction.stage.size_in(i)[0]) for i in (1, 2, 3))
    rows = reduction.stage(X, target, y1, y2)
    values = [
        *mesh.parameters,
        reduction.targets(sample).T,
        sample.derivative(1).T,
        sample.derivative(2).T,
    ]

    scale_state = np.r_[np.full(n_e, DEFLECTION), np.full(n_e, RATE)]
    scale_w = np.repeat([1.0, 1.0, ACCELERATION], n_g)
    scale_inner = np.r_[np.full(stages * n_e, ACCELERATION), np.tile(scale_w, stages)]
    scale_x = np.r_[np.tile(scale_state, mesh.N + 1), np.tile(scale_inner, mesh.N)]
    x = ca.MX.sym("x", mesh.size)
    g, jacobian, _ = mesh.constraints(x, rows, [z, row, h, target, y1, y2], values, scale_x, guess)

    check_time(BUILDING)
    # the cost is quadratic and the constraints leave few freedoms: the Hessian of the cost is
    # curvature enough
    first_and_last = np.r_[0 : 2 * n_e, mesh.n_nodes - 2 * n_e : mesh.n_nodes]
    weight = np.zeros(mesh.size)
    aim = np.zeros(mesh.size)
    weight[first_and_last] = 1.0
    aim[first_and_last] = np.concatenate(ends)
    cost = ca.dot(ca.DM(weight), (x - ca.DM(aim / scale_x)) ** 2) / 2
    hessian = ca.MX(ca.DM(sp.diags(weight).tocsc()))
    result = solve_nlp(
        NonlinearProgram(x=x, cost=cost, g=g, jacobian=jacobian, hessian=hessian),
        guess / scale_x,
        progress=progress,
        max_iterations=ITERATIONS,
    )
    if not result.success:
        raise SolverError(
            f"method collocation: IPOPT ended with {result.status!r} after {result.iterations} "
            f"iterations, largest violation {result.violation:.2e}; try a longer --preview, a "
            "finer --mesh or --method full"
        )
    q_e, v_e, a_e, found = mesh.unpack(result.x * scale_x)
    q = np.zeros((mesh.N, stages, n_a))
    q[:, :, i_g] = found[:, :, :n_g]
    return Collocated(nodes, q_e, v_e, a_e, q, result)


def _guess(
    reduction: Reduction, path: Path, mesh: Transcription
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """The quasi-static motion as unknowns of the mesh, a first guess, and the states (2 n_e,) at
    rest before and after the path.
    """
    i_e = reduction.i_e
    i_g = reduction.i_g
    nodes = mesh.nodes
    times = mesh.times
    both = np.unique(np.concatenate([nodes, times]))
    slow = CubicSpline(both, reduction.follow(path, both, reduction.start(path).q_a))
    states = np.hstack([slow(nodes)[:, i_e], slow(nodes, 1)[:, i_e]])
    w = np.hstack([slow(times, k)[:, i_g] for k in range(3)])
    still = np.zeros(len(i_e))
    ends = np.r_[slow(nodes[0])[i_e], still], np.r_[slow(nodes[-1])[i_e], still]
    return mesh.pack(states, slow(times, 2)[:, i_e], w), ends
