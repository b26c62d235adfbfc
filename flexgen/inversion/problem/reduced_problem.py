"""The reduced problem of inverse dynamics: n_e second-order equations along a prescribed output.

With the output prescribed, ``Gamma(q_a) = Z(t)`` and its derivatives give the actuated coordinates
from the others, and the non-actuated rows ``[M a + c + g]_e - tau_e = 0`` remain. From coordinates
and speeds on that manifold all higher derivatives follow from linear systems with one matrix,

    [ W   ]  a = [ Z''   - W' v          ]        [ W   ]  a' = [ Z'''  - ... ]
    W: output rates = W(q_a) v_a
    [ M_e ]      [ -(c + g - tau_e)_e    ]        [ M_e ]       [ ...         ]

Gears, motors and friction follow as a separate stable stage
(`flexgen.inversion.problem.motor_side`).

Source: cf. S. Devasia, D. Chen, B. Paden, IEEE TAC 41(7), 1996 (zero dynamics along a reference).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from flexgen.base.calls.deadline import check_time
from flexgen.base.calls.progress import Progress, silent
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import Evaluator, evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.inversion_functions import rotor_rows
from flexgen.dynamics.mechanics.outputs import OutputMap, output_map
from flexgen.dynamics.mechanics.statics import Equilibrium, balance, hold_output
from flexgen.model.abilities import obstacle
from flexgen.model.elements import RobotModel
from flexgen.paths.path import Path, PathSample

# Samples at which the equations are evaluated between two looks at the time limit: some 0.5 s.
BLOCK = 4096
# relative size of the smallest singular value below which rows no longer determine accelerations
SINGULAR = 1e-9
DOUBTFUL = 1e-5  # and below which they may amplify errors, so that `motion_through` is tried too


@dataclass(frozen=True)
class Motion:
    """Arm motion at n instants: ``q v a j s`` (n, n_a), derivatives 0 to 4; ``tau_g`` (n, n_g, 3):
    0 to 2.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    j: np.ndarray
    s: np.ndarray
    tau_g: np.ndarray


def advise_full(model: RobotModel) -> str:
    """End of a message about a model without a reduced problem: method full, if that solves it."""
    parts = ("full problem", "limits without force")
    refused = any(obstacle(model, part) is not None for part in parts)
    return "" if refused else "; use --method full"


class Reduction:
    """The reduced problem of a model whose outputs are as many as its motors."""

    def __init__(self, equations: Equations, force: np.ndarray | None = None) -> None:
        """``force`` (n, 18): on the tool of ``equations.pushed``, with two derivatives, at n
        instants.
        """
        model = equations.model
        self._force = [] if force is None else np.split(force, 3, axis=1)
        reason = obstacle(model, "reduced problem")
        if reason is not None:
            raise ArgumentError(f"reduced problem: {reason}{advise_full(model)}")
        self.equations = equations
        self.model = model
        self.n_y = model.output.size
        self.i_g = list(model.i_g)
        self.i_e = list(model.i_e)

    @cached_property
    def _graph(self) -> dict[str, ca.SX]:
        """Expressions of the reduced problem by name, as functions of q, v, a, j, s of the arm:
        ``W`` (output rate over v), ``rateK`` (K-th derivative of the output), ``rowK`` and
        ``tauK`` (K-th derivative of the non-actuated rows and of the gear torques), and ``G``
        (matrix of the accelerations in output and rows).

        A force on the tool that changes enters with its two derivatives.
        """
        lag = self.equations.lagrangian
        q = lag.chain.q_a
        v = lag.chain.v_a
        a = lag.a_a
        j = ca.SX.sym("j_a", self.model.n_a)
        s = ca.SX.sym("s_a", self.model.n_a)

        pushed = self.equations.force is not None and not self.equations.force.is_constant()
        f = [self.equations.force, ca.SX.sym("df", 6), ca.SX.sym("ddf", 6)] if pushed else []

        def rate(x: ca.SX) -> ca.SX:
            return ca.jtimes(x, ca.vertcat(q, v, a, j, *f[:2]), ca.vertcat(v, a, j, s, *f[1:]))

        W = self._output.rate
        arm = self.equations.function("inverse_dynamics")(q, v, a) - lag.arm_forces
        row = ca.vertcat(ca.SX(0, 1), *[arm[i] for i in self.i_e]) - lag.tau_e
        row = row + rotor_rows(self.equations)
        tau = arm[self.i_g]
        graph = {
            "q": q,
            "v": v,
            "a": a,
            "j": j,
            "s": s,
            "W": W,
            "row0": row,
            "tau0": tau,
            "rate1": ca.mtimes(W, v),
        }
        for k in (1, 2):
            graph[f"row{k}"] = rate(graph[f"row{k - 1}"])
            graph[f"tau{k}"] = rate(graph[f"tau{k - 1}"])
        for k in (2, 3, 4):
            graph[f"rate{k}"] = rate(graph[f"rate{k - 1}"])
        graph |= {f"f{k}": each for k, each in enumerate(f)}
        graph["G"] = ca.vertcat(W, ca.densify(ca.jacobian(row, a))) if self.i_e else W
        return graph

    @cached_property
    def output_error(self) -> tuple[ca.SX, ca.SX]:
        """Residual (n_y) of the output in the symbol q_a, and the target symbol (n_y, or 3 + 9 for
        a pose).
        """
        return self._output.error, self._output.target

    @cached_property
    def _output(self) -> OutputMap:
        return output_map(self.equations)

    def targets(self, sample: PathSample) -> np.ndarray:
        """Target values, (n, n_y) or (n, 12), for the symbol of `output_error`."""
        if sample.R is None:
            return sample.y[:, :, 0]
        return np.hstack([sample.y[:, :, 0], sample.R.transpose(0, 2, 1).reshape(-1, 9)])

    @cached_property
    def stage(self) -> ca.Function:
        """The equations of one instant.

        (X = (q, v, a), target, Z', Z'') -> residual (3 n_y + n_e): output, its two derivatives,
        non-actuated rows.
        """
        g = self._graph
        error, target = self.output_error
        y1 = ca.SX.sym("y1", self.n_y)
        y2 = ca.SX.sym("y2", self.n_y)
        rows = ca.vertcat(error, g["rate1"] - y1, g["rate2"] - y2, g["row0"])
        X = ca.vertcat(g["q"], g["v"], g["a"])
        return ca.Function("stage", [X, target, y1, y2], [rows])

    def start(self, path: Path) -> Equilibrium:
        """Equilibrium at the start of the path, of tool, springs and gravity.

        SolverError where the output does not determine the actuated coordinates there.
        """
        jacobian = evaluate(
            self._output_error, path.q_start, self.targets(path.sample(np.zeros(1)))[0]
        )[1][0]
        sizes = np.linalg.svd(jacobian.reshape(self.n_y, -1), compute_uv=False)
        if sizes[-1] < SINGULAR * max(sizes[0], 1e-300):
            raise SolverError(
                "the output does not determine the actuated coordinates at the start of the "
                "path: a singular pose, or an output that a motor cannot move; choose another "
                "start or output"
            )
        return self.equilibrium(path, 0.0, path.q_start)

    def equilibrium(self, path: Path, t: float, guess: np.ndarray) -> Equilibrium:
        """Equilibrium with the output on the path at the instant ``t`` [s]."""
        error, target = self.output_error
        value = ca.DM(self.targets(path.sample(np.array([t])))[0])
        return hold_output(self.equations, ca.substitute(error, target, value), guess)

    @cached_property
    def _output_error(self) -> ca.Function:
        error, target = self.output_error
        q = self._graph["q"]
        return ca.Function(
            "output_error", [q, target], [error, ca.densify(ca.jacobian(error, q[self.i_g]))]
        )

    def close(self, q: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """Inverse kinematics: change the actuated coordinates of ``q`` (n, n_a) to reach
        ``targets`` (n, n_target) of the output, by Newton's method; SolverError where it does not
        converge or passes a singular pose.
        """
        q = q.copy()
        for _ in range(25):
            error, jacobian = evaluate(self._output_error, q, targets)
            error = error.reshape(len(q), -1)
            jacobian = jacobian.reshape(len(q), self.n_y, -1)
            try:
                step = np.linalg.solve(jacobian, error[:, :, None])[:, :, 0]
            except np.linalg.LinAlgError:
                raise SolverError(
                    "inverse kinematics: the path passes a singular pose; choose another path"
                ) from None
            q[:, self.i_g] -= step
            if np.abs(step).max() < 1e-14 * (1 + np.abs(q).max()):
                break
        if not np.abs(error).max() < 1e-9 * (1 + np.abs(targets).max()):
            worst = int(np.argmax(np.abs(error).max(axis=1)))
            raise SolverError(
                f"inverse kinematics: no solution at sample {worst} of {len(q)}, error "
                f"{np.abs(error).max():.2e}; the path leaves the workspace or passes a singular "
                "pose"
            )
        return q

    def follow(self, path: Path, times: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Quasi-static motion (n, n_a) along the path: equilibrium at each of the ``times`` [s],
        one after the other from ``start`` (n_a,), by Newton's method.

        Raises
        ------
        SolverError
            A pose is singular, or has no equilibrium.
        """
        error, target = self.output_error
        symbol = self._graph["q"]
        rows = ca.vertcat(error, balance(self.equations)) if self.i_e else error
        outputs = [ca.densify(rows), ca.densify(ca.jacobian(rows, symbol))]
        newton = Evaluator(ca.Function("follow", [symbol, target], outputs))
        targets = self.targets(path.sample(times))
        out = np.zeros((len(times), self.model.n_a))
        q = start
        for k, value in enumerate(targets):
            check_time(f"quasi-static motion along the path, at t = {times[k]:.4g} s")
            for _ in range(30):
                residual, jacobian = newton(q, value)
                try:
                    step = np.linalg.solve(jacobian, -residual[:, 0])
                except np.linalg.LinAlgError:
                    raise SolverError(
                        f"path: singular pose at t = {times[k]:.4g} s; choose another path"
                    ) from None
                q = q + step
                if np.abs(step).max() < 1e-12 * (1 + np.abs(value).max() + np.abs(q).max()):
                    break
            else:
                raise SolverError(
                    f"path: no equilibrium at t = {times[k]:.4g} s; "
                    "the path leaves the workspace or passes a singular pose"
                    f"{self._open_loops}"
                )
            out[k] = q
        return out

    @property
    def _open_loops(self) -> str:
        """End of a message about a pose that is not found: closed loops may come apart there."""
        names = ", ".join(loop.name for loop in self.model.loops)
        return f", or the loop {names} cannot close there" if names else ""

    @cached_property
    def _levels(self) -> ca.Function:
        """The expressions of `_graph` that a motion needs, as one function of q, v, a, j, s and
        the force.
        """
        g = self._graph
        names = [
            "rate1",
            "rate2",
            "rate3",
            "rate4",
            "row0",
            "row1",
            "row2",
            "tau0",
            "tau1",
            "tau2",
            "G",
            "W",
        ]
        outputs = [ca.densify(g[name]) for name in names]
        given = [*"qvajs", *(name for name in ("f0", "f1", "f2") if name in g)]
        return ca.Function("levels", [g[name] for name in given], outputs, given, names)

    def motion(
        self, sample: PathSample, q: np.ndarray, v_e: np.ndarray, tell: Progress = silent
    ) -> tuple[Motion | None, bool]:
        """All derivatives of the motion on the manifold, from coordinates ``q`` (n, n_a) and
        speeds ``v_e`` (n, n_e).

        The equations hold exactly at each instant by construction. None where their matrix is
        singular: there the rows do not determine the accelerations, see `motion_through`. The
        second result is True where the matrix is nearly singular, or is singular between two
        instants, as when a zero passes through infinity.
        ``tell`` gets a line for each derivative.
        """
        n = len(q)
        n_a = self.model.n_a
        zero = np.zeros((n, n_a))
        at = self._at([q, zero, zero, zero, zero])
        G = at["G"].reshape(n, n_a, n_a)
        rows = G / np.abs(G).max(axis=2)[:, :, None]
        singular = np.linalg.svd(rows, compute_uv=False)
        ratio = float((singular[:, -1] / singular[:, 0]).min())
        if ratio < SINGULAR:
            return None, True
        doubtful = ratio < DOUBTFUL or len(np.unique(np.linalg.slogdet(rows)[0])) > 1
        v = np.linalg.solve(
            self._picking(at["W"]), np.hstack([sample.derivative(1), v_e])[:, :, None]
        )[:, :, 0]
        chain = [q, v, zero, zero, zero]
        scale = np.abs(G).max(axis=2)
        for k in (2, 3, 4):
            tell(f"derivative {k} of 4 of the joints, {n} samples")
            at = self._at(chain)
            output = sample.derivative(k) - at[f"rate{k}"].reshape(n, self.n_y)
            rhs = np.hstack([output, -at[f"row{k - 2}"].reshape(n, len(self.i_e))])
            chain[k] = np.linalg.solve(rows, (rhs / scale)[:, :, None])[:, :, 0]
        return self._motion(chain), doubtful

    def motion_through(
        self, sample: PathSample, q: np.ndarray, deflection: list[np.ndarray]
    ) -> Motion:
        """The motion with given coordinates ``q`` (n, n_a) and derivatives 1 to 4 of the
        non-actuated ones, each (n, n_e); those of the actuated coordinates follow from the output.
        The equations of motion need not hold.
        """
        n = len(q)
        zero = np.zeros_like(q)
        chain = [q, zero, zero, zero, zero]
        at = self._at(chain)
        picking = self._picking(at["W"])
        for k in (1, 2, 3, 4):
            output = sample.derivative(k) - (
                0.0 if k == 1 else self._at(chain)[f"rate{k}"].reshape(n, self.n_y)
            )
            chain[k] = np.linalg.solve(
                picking, np.hstack([output, deflection[k - 1]])[:, :, None]
            )[:, :, 0]
        return self._motion(chain)

    def _at(self, chain: list[np.ndarray]) -> dict[str, np.ndarray]:
        """Values of `_levels` by name along a chain ``q v a j s`` of arrays (n, n_a), computed in
        blocks of samples, between which the time limit is checked.
        """
        n = len(chain[0])
        blocks = []
        for first in range(0, n, BLOCK):
            check_time(f"equations along the path, sample {first} of {n}")
            part = slice(first, first + BLOCK)
            forces = (x[part] if len(x) == n else x for x in self._force)
            blocks.append(evaluate(self._levels, *(x[part] for x in chain), *forces))
        values = (x[0] if len(x) == 1 else np.concatenate(x) for x in zip(*blocks, strict=True))
        return dict(zip(self._levels.name_out(), values, strict=True))

    def _picking(self, W: np.ndarray) -> np.ndarray:
        """The matrix (n, n_a, n_a) whose upper rows are W and whose lower rows pick the
        non-actuated coordinates.
        """
        n_a = self.model.n_a
        W = W.reshape(-1, self.n_y, n_a)
        out = np.zeros((len(W), n_a, n_a))
        out[:, : self.n_y] = W
        out[:, self.n_y + np.arange(len(self.i_e)), self.i_e] = 1.0
        return out

    def _motion(self, chain: list[np.ndarray]) -> Motion:
        """The motion of a chain ``q v a j s`` of arrays (n, n_a), with its gear torques and two
        derivatives (n, n_g, 3).
        """
        at = self._at(chain)
        tau_g = np.stack([at[f"tau{k}"].reshape(len(chain[0]), -1) for k in range(3)], axis=-1)
        q, v, a, j, s = chain
        return Motion(q, v, a, j, s, tau_g)

    def joint_motion(self, q_g: np.ndarray) -> Motion:
        """Motion and gear torques from actuated coordinates and derivatives (n, n_g, 6);
        flexible-joint models.
        """
        return self._motion([np.ascontiguousarray(q_g[:, :, k]) for k in range(5)])
