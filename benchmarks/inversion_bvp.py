"""The reduced problem of inverse dynamics for `scipy.integrate.solve_bvp`, with the fastest setup
known to us.

    y = (q_e, v_e),   y' = (v_e, a_e) with R(q_e, v_e, a_e, t) = 0,
    P_s (y - y_rest) = 0 (start), P_u (...) = 0 (end)

The right-hand side and its Jacobian are evaluated for all mesh points at once by the generated C;
only the solver is scipy's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_bvp
from scipy.interpolate import CubicSpline
from scipy.linalg import schur

from flexgen.analysis.linear import linearize
from flexgen.analysis.zero_dynamics.zeros import inner_pencil
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.statics import equilibrium_at
from flexgen.inversion.methods.method_result import MethodResult, with_motors
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.paths.path import Path
from flexgen.runtime.library import Library

NEWTON = 20  # steps of the inverse kinematics, at most
NEAR = 1e-12  # m and rad: what they leave


@dataclass(frozen=True)
class Setting:
    """Tolerance and first mesh of `solve_bvp`, and whether it is given the Jacobian."""

    tolerance: float
    nodes: int
    jacobian: bool


class ReducedProblem:
    """Right-hand side, Jacobians and boundary rows; all that does not depend on the setting is
    made here.
    """

    def __init__(self, equations: Equations, move: str, library: Library) -> None:
        self.equations = equations
        self.library = library
        self.path = Path(equations, equations.model.move(move))
        self.problem = InversionProblem(equations, self.path)
        self.reduction = Reduction(equations)
        self.g = list(equations.model.i_g)
        self.e = list(equations.model.i_e)
        n_pre, settle = self.problem.windows
        self.begin = -n_pre
        self.end = self.path.duration + settle
        t = np.linspace(self.begin, self.end, 401)
        slow = self.reduction.follow(self.path, t, self.reduction.start(self.path).q_a)
        self.slow = CubicSpline(t, slow)
        self.rest = [np.r_[q[self.e], np.zeros(len(self.e))] for q in (slow[0], slow[-1])]
        self.rows = [self._subspace(q, grows) for q, grows in ((slow[0], False), (slow[-1], True))]

    def _subspace(self, q: np.ndarray, grows: bool) -> np.ndarray:
        """Rows that vanish on all but what grows, or fades: left invariant subspace at rest."""
        rest = equilibrium_at(self.equations, q)
        A, D, K = inner_pencil(self.equations, linearize(self.equations, rest))
        n = len(A)
        lower = -np.linalg.solve(A, np.hstack([K, D]))
        first_order = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower])
        dy = np.abs(np.linalg.eigvals(first_order)).max()
        scale = np.r_[np.ones(n), np.full(n, dy)]
        balanced = first_order * scale / scale[:, None]
        _, vectors, count = schur(balanced.T, output="real", sort="rhp" if grows else "lhp")
        return vectors[:, :count].T / scale

    def arm(
        self, t: np.ndarray, y: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Coordinates and speeds (m, n_a) on the path, the output's maps W_g, W_e, and its bias W'
        v.
        """
        sample = self.path.sample(t)
        n_e = len(self.e)
        target = self.reduction.targets(sample)
        dy = sample.derivative(1)
        q = self.slow(t)
        v = np.zeros((len(t), self.equations.model.n_a))
        q[:, self.e] = y[:n_e].T
        v[:, self.e] = y[n_e:].T
        for _ in range(NEWTON):
            error, W, _ = self.library.output_constraint(q, v, target)
            step = np.linalg.solve(W[:, :, self.g], error[:, :, None])[:, :, 0]
            q[:, self.g] -= step
            if np.abs(step).max() < NEAR:
                break
        W = self.library.output_constraint(q, v, target)[1]
        W_g = W[:, :, self.g]
        W_e = W[:, :, self.e]
        moved = dy - (W_e @ v[:, self.e, None])[:, :, 0]
        v[:, self.g] = np.linalg.solve(W_g, moved[:, :, None])[:, :, 0]
        return q, v, W_g, W_e, self.library.output_constraint(q, v, target)[2]

    def slopes(
        self, t: np.ndarray, y: np.ndarray, derivatives: bool
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Accelerations a_e (m, n_e), and their derivatives in y (m, n_e, 2 n_e)."""
        q, v, W_g, W_e, bias = self.arm(t, y)
        n = len(t)
        n_e = len(self.e)
        a = np.zeros_like(q)
        wanted = self.path.sample(t).derivative(2) - bias
        a[:, self.g] = np.linalg.solve(W_g, wanted[:, :, None])[:, :, 0]
        S = np.zeros((n, q.shape[1], n_e))
        S[:, self.e] = np.eye(n_e)
        S[:, self.g] = -np.linalg.solve(W_g, W_e)
        *_, row, _, _, row_a = self.library.inversion_jacobians(q, v, a)
        A = row_a @ S
        found = -np.linalg.solve(A, row.reshape(n, n_e, 1))[:, :, 0]
        if not derivatives:
            return found, None
        a += (S @ found[:, :, None])[:, :, 0]
        dy1, dy2, dy2_v, _, row_q, row_v, row_a = self.library.inversion_jacobians(q, v, a)
        by_q = row_q @ S
        by_v = row_v @ S
        V, B, C = (np.zeros_like(S) for _ in range(3))
        V[:, self.g] = -np.linalg.solve(W_g, dy1 @ S)
        B[:, self.g] = -np.linalg.solve(W_g, dy2 @ S + dy2_v @ V)
        C[:, self.g] = -np.linalg.solve(W_g, dy2_v @ S)
        by_q = by_q + row_v @ V + row_a @ B
        by_v = by_v + row_a @ C
        return found, -np.linalg.solve(A, np.concatenate([by_q, by_v], axis=2))

    def call(self, setting: Setting) -> Callable[[], object]:
        """The call of `solve_bvp`."""
        n_e = len(self.e)

        def dy(t: np.ndarray, y: np.ndarray) -> np.ndarray:
            return np.vstack([y[n_e:], self.slopes(t, y, False)[0].T])

        def rate_slope(t: np.ndarray, y: np.ndarray) -> np.ndarray:
            out = np.zeros((2 * n_e, 2 * n_e, len(t)))
            out[:n_e, n_e:] = np.eye(n_e)[:, :, None]
            derivative = self.slopes(t, y, True)[1]
            assert derivative is not None
            out[n_e:] = derivative.transpose(1, 2, 0)
            return out

        def ends(ya: np.ndarray, yb: np.ndarray) -> np.ndarray:
            return np.r_[self.rows[0] @ (ya - self.rest[0]), self.rows[1] @ (yb - self.rest[1])]

        def ends_slope(ya: np.ndarray, yb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            zero = [np.zeros_like(x) for x in self.rows]
            return np.vstack([self.rows[0], zero[1]]), np.vstack([zero[0], self.rows[1]])

        mesh = np.linspace(self.begin, self.end, setting.nodes)
        guess = np.vstack([self.slow(mesh)[:, self.e].T, self.slow(mesh, 1)[:, self.e].T])
        more = {"fun_jac": rate_slope, "bc_jac": ends_slope} if setting.jacobian else {}
        return lambda: solve_bvp(
            dy, ends, mesh, guess, tol=setting.tolerance, max_nodes=20_000, **more
        )

    def answer(self, found: object) -> MethodResult | None:
        """Motion and torques from the solution's own interpolant; None where there is no
        solution.
        """
        if not found.success:  # type: ignore[attr-defined]
            return None
        t = (
            np.arange(int(np.floor((self.end - self.begin) / self.problem.step)) + 1)
            * self.problem.step
            + self.begin
        )
        y = found.sol(t)  # type: ignore[attr-defined]
        q, _, *_ = self.arm(t, y)
        sample = self.path.sample(t)
        motion, _ = self.reduction.motion(
            sample, self.reduction.close(q, self.reduction.targets(sample)), y[len(self.e) :].T
        )
        return (
            None
            if motion is None
            else with_motors(self.equations, t, motion, preactuation=-self.begin)
        )
