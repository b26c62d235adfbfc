"""Inverse dynamics as one sparse optimization over the whole horizon: the DAE on a uniform grid,
smoothest torque.

Nothing is reduced or differentiated by hand. The coordinates y = (q_a, q_me) stand at the nodes of
a grid, their speeds and accelerations are central differences, the torques stand at the nodes.
Among all motions that satisfy the equations of motion at every node and track the path, the one
with the smallest change of torque is selected:

    min  sum |tau_(k+1) - tau_k|^2 / tau_0^2 + sum |e(y_k)|^2 / delta       s.t.
    r(y_k, D y_k, D^2 y_k, tau_k) = 0

The differences are symmetric in time. So the unstable part of the zero dynamics is as harmless as
the stable one, and so are the oscillations from node to node that such differences allow: both
cost torque, and the robot starts before the path, in equilibrium. ``delta`` is tiny: it keeps the
linear systems regular where the path hardly determines a motion. The error of the torque decreases
with h^order (2, 4 or 6, that of the differences) if the path is smooth enough; with springs with a
break it is h^2.

Each step of the sequential quadratic program has equality constraints only, so it is one sparse
linear system. It is too ill-conditioned for first-order methods for quadratic programs (OSQP 1.1
was tried).

Source: S. Moberg, S. Hanssen, in Proc. IEEE/RSJ IROS 2007 (inverse dynamics of flexible
manipulators as a DAE); B. Fornberg, Math. Comp. 51, 1988 (differences).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.linearization import second_order_matrices
from flexgen.dynamics.mechanics.outputs import output_map
from flexgen.inversion.methods.baselines import quasistatic_motion, simply_coupled
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.problem.motor_side import MotorMotion, gear_torques, motor_motion
from flexgen.inversion.problem.problem import ACCELERATION, INTERVALS, InversionProblem

ORDER = 4
REFINEMENT = 2.5  # nodes for each interval of the default mesh
# delta for a path of one interval; on a finer grid the torque changes less from node to node
DELTA = 1.6e-18
# weight of the equilibrium at the start: nearly a constraint, the unstable part must be free to
# begin
START = 1e14
END = 1e4  # weight of the equilibrium at the end: enough to select the bounded motion
STEPS = 40
CLOSE = 1e-9  # rad or m: step of the coordinates that ends the iteration, arm side
CLOSE_TORQUE = 1e-5  # the same of the torques, relative to tau_0
REFINEMENTS = 30
REFINED = 1e-12  # change of the scaled unknowns that ends the refinement
SHRINK = 0.7  # largest ratio of two steps that is a decrease
WORSE = 1e-4  # scaled residual that a step may have without being halved

# central differences: weights of y_(k-m) ... y_(k+m) for h D and h^2 D^2
DIFFERENCES = {
    2: ((-1 / 2, 0, 1 / 2), (1, -2, 1)),
    4: ((1 / 12, -2 / 3, 0, 2 / 3, -1 / 12), (-1 / 12, 4 / 3, -5 / 2, 4 / 3, -1 / 12)),
    6: (
        (-1 / 60, 3 / 20, -3 / 4, 0, 3 / 4, -3 / 20, 1 / 60),
        (1 / 90, -3 / 20, 3 / 2, -49 / 18, 3 / 2, -3 / 20, 1 / 90),
    ),
}


@dataclass(frozen=True)
class Discretized:
    """Solution at the nodes.

    ``t`` (N,) [s]; ``arm``, ``motor``: coordinates, speeds, accelerations, each (N, n_a) and (N,
    n_m); ``tau_m`` (N, n_m). ``iterations``; ``path_error``: largest error of the output, in its
    own unit.
    """

    t: np.ndarray
    arm: tuple[np.ndarray, np.ndarray, np.ndarray]
    motor: tuple[np.ndarray, np.ndarray, np.ndarray]
    tau_m: np.ndarray
    iterations: int
    path_error: float


def solve(problem: InversionProblem, h: float) -> MethodResult:
    """Solve on a uniform grid of ``h`` [s], or of `REFINEMENT` nodes for each ``h`` where no mesh
    is given. Option ``order``: 2, 4 or 6, of the differences.
    """
    problem.check_options("discretized", "order")
    order = problem.options.get("order", ORDER)
    if isinstance(order, bool) or order not in DIFFERENCES:
        raise ArgumentError(
            f"options: method discretized was given order {order!r}, expected 2, 4 or 6"
        )
    preactuation, settling = problem.windows
    preactuation = preactuation if problem.preview is None else float(problem.preview)
    spacing = h if problem.mesh is not None else h / REFINEMENT
    found = discretize(problem, spacing, order, preactuation, settling)
    motors = MotorMotion(*found.motor, found.tau_m)
    return MethodResult(
        found.t,
        *found.arm,
        gear_torques(problem.equations, *found.arm, motors),
        motors,
        preactuation=-float(found.t[0]),
        iterations=found.iterations,
        intervals=len(found.t) - 1,
        details={
            "order": order,
            "spacing_s": float(found.t[1] - found.t[0]),
            "path_error": found.path_error,
        },
    )


def discretize(
    problem: InversionProblem, h: float, order: int, preactuation: float, settling: float
) -> Discretized:
    """Solve on a uniform grid of about ``h`` [s] with differences of an ``order``, from
    ``preactuation`` [s] before the path to ``settling`` [s] after it, by Newton steps of a problem
    with constraints.

    Raises
    ------
    SolverError
        It does not converge; the message has the size of the last step.
    """
    system = _System(problem, h, order, preactuation, settling)
    y, tau = system.start()
    violation = system.violation(y, tau)
    before = np.inf
    damping = 1.0
    for count in range(1, STEPS + 1):
        check_time(f"method discretized, step {count}")
        dy, dtau = system.step(y, tau)
        moved = float(np.abs(dy / system.scale_y).max())
        pushed = float(np.abs(dtau / system.tau_0).max())
        # steps that do not decrease oscillate about a kink of the equations: take half of them
        damping = damping / 2 if moved > SHRINK * before else min(1.0, 2 * damping)
        before = moved
        length = damping
        while True:
            trial = y + length * dy, tau + length * dtau
            new = system.violation(*trial)
            if new <= max(2 * violation, WORSE) or length < 1e-3:
                break
            length /= 2
        (y, tau) = trial
        violation = new
        problem.log(
            f"discretized, step {count}: coordinates {moved:9.2e}, torques {pushed:9.2e}, "
            f"residual {new:9.2e}"
        )
        if not np.isfinite(new):
            break
        if moved <= CLOSE and pushed <= CLOSE_TORQUE:
            return system.solution(y, tau, count)
    raise SolverError(
        f"method discretized: no convergence in {count} steps, the last one {moved:.1e} rad or "
        f"m and {pushed:.1e} of the torque, residual {violation:.1e}; try another --mesh, a "
        "smoother move or the method collocation"
    )


class _System:
    """The grid, the equations on it and the sparse linear system of a step.

    Nodes -m ... N-1+m, the output holds at all of them; the equations of motion at 0 ... N-1.
    """

    def __init__(
        self, problem: InversionProblem, h: float, order: int, preactuation: float, settling: float
    ) -> None:
        """``h``: length of an interval [s], shortened so that a whole number of them fits in the
        move; ``order``: of the central differences; ``preactuation``, ``settling``: rest before
        and after the move [s].
        """
        self.problem = problem
        self.equations = problem.equations
        self.path = problem.path
        self.m = m = order // 2
        duration = problem.path.duration
        count = max(1, int(np.ceil(duration / h - 1e-9)))
        self.h = duration / count
        before, after = (int(np.ceil(x / self.h - 1e-9)) for x in (preactuation, settling))
        self.N = before + count + after + 1
        if self.N > INTERVALS:
            raise ArgumentError(
                f"mesh: given {h:.3g} s, which makes {self.N} nodes, expected at most "
                f"{INTERVALS}; take a coarser --mesh, a shorter --preview or a shorter move"
            )
        self.t = self.h * np.arange(-before - m, count + after + m + 1)
        self.inside = slice(m, m + self.N)
        first, second = DIFFERENCES[order]
        self.D = [np.eye(2 * m + 1)[m], np.array(first) / self.h, np.array(second) / self.h**2]
        model = self.equations.model
        self.n = model.dof
        self.n_a = model.n_a
        self.n_m = model.n_m
        self.n_y = model.output.size
        self.i_m = list(model.i_m)
        self.i_g = list(model.i_g)
        ratio = np.abs(model.eta).max(axis=1)
        self.scale_y = np.r_[np.ones(self.n_a), ratio[self.i_m]]
        turned = ratio * np.array([motor.inertia for motor in model.motors])
        self.tau_0 = np.maximum(
            np.abs(problem.equilibrium.tau_m), np.maximum(0.1 * ACCELERATION * turned, 1e-3)
        )
        self.delta = DELTA * (duration / self.h) ** 2

    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """Initial coordinates (K, n) and torques (N, n_m): the quasi-static motion."""
        reduction = simply_coupled(self.equations)
        motion = quasistatic_motion(reduction, self.path, self.t)
        motors = motor_motion(
            reduction.equations, self.t, motion.q, motion.v, motion.a, motion.tau_g
        )
        y = np.hstack([motion.q, motors.q_m[:, self.i_m]])
        equilibrium = self.problem.equilibrium
        ends = 2 * self.m
        self.aim = np.zeros_like(y)
        self.aim[:ends] = np.r_[equilibrium.q_a, equilibrium.q_m[self.i_m]]
        self.aim[-ends:] = y[-1]
        return y, motors.tau_m[self.inside]

    def levels(self, y: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Arm (N, n_a) and motors (N, n_m) at the nodes: coordinates, speeds, accelerations."""
        out = []
        for weights in self.D:
            level = sum(w * y[j : j + self.N] for j, w in enumerate(weights))
            motor = level[:, self.i_g] @ self.equations.model.eta.T
            motor[:, self.i_m] = level[:, self.n_a :]
            out.append((level[:, : self.n_a], motor))
        return out

    def arguments(self, y: np.ndarray, tau: np.ndarray) -> list[np.ndarray]:
        levels = self.levels(y)
        return [*(arm for arm, _ in levels), *(motor for _, motor in levels), tau]

    @cached_property
    def targets(self) -> np.ndarray:
        return simply_coupled(self.equations).targets(self.path.sample(self.t))

    @cached_property
    def output_error(self) -> ca.Function:
        """The output error and its Jacobian, (q_a, target) -> (n_y), (n_y, n_a)."""
        output = output_map(self.equations)
        q = self.equations.lagrangian.chain.q_a
        jacobian = ca.densify(ca.jacobian(output.error, q))
        return ca.Function("output_error", [q, output.target], [output.error, jacobian])

    def residual(self, y: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Residual of the equations of motion (N, n) [N m or N]."""
        r_a, r_m = evaluate(self.equations.function("residual"), *self.arguments(y, tau))
        return np.hstack([r_a.reshape(self.N, -1), r_m.reshape(self.N, -1)[:, self.i_m]])

    def errors(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Error of the output at all nodes (K, n_y), and its Jacobian (K, n_y, n_a)."""
        error, jacobian = evaluate(self.output_error, y[:, : self.n_a], self.targets)
        return error.reshape(len(y), self.n_y), jacobian.reshape(len(y), self.n_y, self.n_a)

    def violation(self, y: np.ndarray, tau: np.ndarray) -> float:
        """Largest scaled residual of the equations of motion."""
        with np.errstate(all="ignore"):
            return float(np.abs(self.residual(y, tau) * self.row_scale).max())

    @cached_property
    def row_scale(self) -> np.ndarray:
        """Factors of the equations of motion (n): a force that moves a coordinate by its scale
        within a step is one.
        """
        equilibrium = self.problem.equilibrium
        still = np.zeros(self.n_a), np.zeros(self.n_m)
        M = evaluate(
            self.equations.function("residual_jacobians"),
            *(
                equilibrium.q_a,
                still[0],
                still[0],
                equilibrium.q_m,
                still[1],
                still[1],
                equilibrium.tau_m,
            ),
        )[0].reshape(self.n, self.n)
        return self.h**2 / np.maximum(np.abs(M * self.scale_y).max(axis=1), 1e-300)

    @cached_property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the entries of `jacobian`, in its order. Unknowns: y of all nodes,
        one node after the other, then the torques; rows: equations of motion, then the output.

        The equations at a node have blocks for the y of its 2 m + 1 neighbors, from which
        differences are taken, and for its own torques; the output has one for its own arm
        coordinates.
        """
        m = self.m
        n = self.n
        N = self.N
        K = N + 2 * m
        y_at = np.arange(K * n).reshape(K, n)
        tau_at = K * n + np.arange(N * self.n_m).reshape(N, self.n_m)
        dynamic = np.arange(N * n).reshape(N, n)
        output = N * n + np.arange(K * self.n_y).reshape(K, self.n_y)
        blocks = [(dynamic, y_at[j : j + N]) for j in range(2 * m + 1)]
        blocks += [(dynamic, tau_at), (output, y_at[:, : self.n_a])]
        pairs = [
            np.broadcast_arrays(rows[:, :, None], columns[:, None, :]) for rows, columns in blocks
        ]
        return (
            np.concatenate([rows.ravel() for rows, _ in pairs]),
            np.concatenate([c.ravel() for _, c in pairs]),
        )

    def jacobian(self, y: np.ndarray, tau: np.ndarray, output: np.ndarray) -> sp.csc_matrix:
        """Sparse Jacobian of the scaled constraints in the scaled unknowns: equations of motion,
        then the output.

        ``y`` (nodes, n), ``tau`` (N, n_m); ``output`` (nodes, n_y, n_a): derivative of the output
        in the arm coordinates.
        """
        N = self.N
        n = self.n
        found = evaluate(self.equations.function("residual_jacobians"), *self.arguments(y, tau))
        M, D, K, B = second_order_matrices(*found)
        left = self.row_scale[None, :, None]
        inner = self.scale_y[None, None, :]
        M, D, K = (left * x * inner for x in (M, D, K))
        blocks = [
            K * self.D[0][j] + D * self.D[1][j] + M * self.D[2][j] for j in range(2 * self.m + 1)
        ]
        blocks += [-left * B * self.tau_0, output * self.scale_y[: self.n_a]]
        rows, columns = self.pattern
        values = np.concatenate([block.ravel() for block in blocks])
        kept = values != 0
        nodes = N + 2 * self.m
        shape = (N * n + nodes * self.n_y, nodes * n + N * self.n_m)
        return sp.csc_matrix((values[kept], (rows[kept], columns[kept])), shape=shape)

    @cached_property
    def hessian(self) -> sp.csc_matrix:
        """Of the cost in the scaled unknowns."""
        changes = sp.diags(
            [np.ones(self.N - 1), -np.ones(self.N - 1)], [1, 0], shape=(self.N - 1, self.N)
        )
        ends = np.zeros((self.N + 2 * self.m, self.n))
        ends[: 2 * self.m] = START
        ends[-2 * self.m :] = END
        return sp.block_diag(
            [sp.diags(ends.ravel()), sp.kron(changes.T @ changes, sp.eye(self.n_m))]
        ).tocsc()

    def step(self, y: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Newton step of the coordinates (nodes, n) and the torques (N, n_m).

        The linear system of a problem with constraints is ill-conditioned, since cost and softness
        of the output have a small weight; its solution is refined with residuals in extended
        precision.
        """
        error, output = self.errors(y)
        A = self.jacobian(y, tau, output)
        c = np.concatenate([(self.residual(y, tau) * self.row_scale).ravel(), error.ravel()])
        offset = np.concatenate(
            [((y - self.aim) / self.scale_y).ravel(), (tau / self.tau_0).ravel()]
        )
        n_x = A.shape[1]
        n_r = self.N * self.n
        root = np.sqrt(self.delta)
        size = 1 / np.maximum(np.abs(A).max(axis=1).toarray().ravel(), 1e-300)
        A = sp.diags(size) @ A
        c = size * c
        # cost and softness of the output times sqrt(delta): both have the same small weight in the
        # system
        soft = sp.diags(-root * np.r_[np.zeros(n_r), size[n_r:] ** 2])
        system = sp.bmat([[root * self.hessian, A.T], [A, soft]]).tocsc()
        right = -np.r_[root * (self.hessian @ offset), c]
        try:
            factors = splu(system)
        except RuntimeError:
            raise SolverError(
                "method discretized: the linear system of a step is singular: the path passes a "
                "singular pose, or the output does not determine the motion; choose another path"
            ) from None
        # the system is ill-conditioned: iterative refinement with a residual in extended precision
        matrix = system.tocsr().astype(np.longdouble)
        x = np.zeros(len(right), dtype=np.longdouble)
        change = np.inf
        for _ in range(REFINEMENTS):
            more = factors.solve((right - matrix @ x).astype(float))
            x += more
            last = change
            change = float(np.abs(more[:n_x]).max())
            if change <= REFINED or not change < 2 * last:
                break
        x = x.astype(float)
        cut = y.size
        return x[:cut].reshape(y.shape) * self.scale_y, x[cut:n_x].reshape(tau.shape) * self.tau_0

    def solution(self, y: np.ndarray, tau: np.ndarray, count: int) -> Discretized:
        (q, q_m), (v, v_m), (a, a_m) = self.levels(y)
        left = float(np.abs(self.errors(y)[0]).max())
        return Discretized(self.t[self.inside], (q, v, a), (q_m, v_m, a_m), tau, count, left)
