"""Inverse dynamics as one differential-algebraic equation (DAE) F(x, x', u(t)) = 0: unknowns, rows
and units.

    x = (y, v, tau_m),  y = (q_a, q_me):      y' - v                                 = 0
    kinematic rows
                                              equations of motion at (y, v, v', tau_m) = 0
                                              dynamic rows
                                              Gamma(q_a) - u                         = 0
                                              output rows

``q_me``: the motors behind elastic gears; ``u``: the target of the output, the only thing that
depends on time. The derivative array ``F_mu = (F, dF/dt, ..., d^mu F/dt^mu)`` has two evaluators
that check each other: CasADi functions of fixed order, which the solvers integrate
(`flexgen.dynamics.dae.derivative_array`), and Taylor series of any order at many points, for ranks
(`flexgen.dynamics.dae.taylor_array`).

Source: P. Kunkel, V. Mehrmann, Differential-Algebraic Equations, 2006, ch. 3 and 4.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from math import comb
from typing import Protocol

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.linearization import second_order_matrices
from flexgen.dynamics.mechanics.outputs import output_map
from flexgen.dynamics.mechanics.statics import Equilibrium
from flexgen.model.elements import Output


class Reference(Protocol):
    """A sample of a path, see `flexgen.paths.path.PathSample`."""

    @property
    def y(self) -> np.ndarray:
        """(n, n_y, k): rows of the output that are positions, and their derivatives."""

    @property
    def R(self) -> np.ndarray | None:
        """(n, 3, 3): orientation; None where the output has none."""

    @property
    def w(self) -> np.ndarray | None:
        """(n, 3, k - 1): angular velocity and its derivatives."""

    @property
    def q_g(self) -> np.ndarray | None:
        """(n, n_g, k): actuated coordinates and their derivatives, for a move of the joints."""


class InverseDae:
    """The DAE of the inverse dynamics of a model; functions are built when they are first used.

    Parameters
    ----------
    equations : Equations
        Of the model. Outputs and motors may differ in number; then the DAE has no unique solution.
    joints : bool
        The output is the actuated coordinates themselves, for moves of the joints: it has no
        singular poses.

    Attributes
    ----------
    n, n_x, m, n_u : int
        Degrees of freedom; unknowns ``2 n + n_m``; rows ``2 n + n_y``; numbers of a target: n_y,
        or 12 for a pose (position, rotation matrix by columns).
    y, rate, torque : arrays of int (n,), (n,), (n_m,)
        Indices of y, v and tau_m in x.
    kinematic, dynamic, output : arrays of int (n,), (n,), (n_y,)
        Indices of the rows in F.
    """

    def __init__(self, equations: Equations, joints: bool = False) -> None:
        if joints:
            model = equations.model
            picked = tuple(
                tuple(1.0 if i == k else 0.0 for i in range(model.n_a)) for k in model.i_g
            )
            equations = Equations(
                replace(model, output=Output("combination", "", picked, "mixed"))
            )
        model = equations.model
        self.equations = equations
        self.model = model
        self.joints = joints
        self.n = model.dof
        self.n_x = 2 * self.n + model.n_m
        self.m = 2 * self.n + model.output.size
        self.n_u = model.output.target_size
        self.y = np.arange(self.n)
        self.rate = self.n + np.arange(self.n)
        self.torque = 2 * self.n + np.arange(model.n_m)
        self.kinematic = self.y
        self.dynamic = self.rate
        self.output = np.arange(2 * self.n, self.m)

    @cached_property
    def output_error(self) -> ca.Function:
        """(q_a, u) -> error of the output (n_y), zero where it is at the target u."""
        q = self.equations.lagrangian.chain.q_a
        output = output_map(self.equations)
        return ca.Function("error", [q, output.target], [output.error])

    def motion_rows(self, y: ca.SX, v: ca.SX, a: ca.SX, tau_m: ca.SX) -> ca.SX:
        """Equations of motion (n,): arm rows, then the motors behind elastic gears, in the
        coordinates ``y`` (n,), their rates ``v``, ``a`` and the motor torques ``tau_m`` (n_m,).
        """
        model = self.model
        full = [ca.SX.zeros(model.n_m) for _ in range(3)]
        for whole, part in zip(full, (y, v, a), strict=True):
            for k, j in enumerate(model.i_m):
                whole[j] = part[model.n_a + k]
        n_a = model.n_a
        r_a, r_m = self.equations.function("residual")(y[:n_a], v[:n_a], a[:n_a], *full, tau_m)
        return ca.vertcat(r_a, *[r_m[j] for j in model.i_m])

    def output_rows(self, y: ca.SX, u: ca.SX) -> ca.SX:
        """Error of the output (n_y)."""
        return self.output_error(y[: self.model.n_a], u)

    @cached_property
    def graph(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Symbols x, x', u, and F (m) as a graph in them."""
        n = self.n
        x = ca.SX.sym("x", self.n_x)
        dx = ca.SX.sym("dx", self.n_x)
        u = ca.SX.sym("u", self.n_u)
        y = x[:n]
        v = x[n : 2 * n]
        tau = x[2 * n :]
        rows = ca.vertcat(
            dx[:n] - v, self.motion_rows(y, v, dx[n : 2 * n], tau), self.output_rows(y, u)
        )
        return x, dx, u, rows

    @cached_property
    def rows(self) -> ca.Function:
        """(x, dx, u) -> F (m), A = dF/dx, E = dF/dx' (m, n_x)."""
        x, dx, u, rows = self.graph
        jacobians = [ca.densify(ca.jacobian(rows, z)) for z in (x, dx)]
        return ca.Function(
            "rows", [x, dx, u], [ca.densify(rows), *jacobians], ["x", "dx", "u"], ["F", "A", "E"]
        )

    def target_at(self, x: np.ndarray) -> np.ndarray:
        """The target (n_u,) that the output has in a state x (n_x,)."""
        q = x[: self.model.n_a]
        if self.model.output.type != "tool_pose":
            return evaluate(self.equations.function("output"), q)[0][0]
        y = evaluate(self.equations.function("output"), q)[0][0]
        R = evaluate(self.equations.function("forward_kinematics"), q)[1]
        return np.concatenate([y, R[0].T.ravel()])

    def pack(self, rest: Equilibrium) -> np.ndarray:
        """x (n_x,) at an equilibrium."""
        i_m = list(self.model.i_m)
        return np.concatenate([rest.q_a, rest.q_m[i_m], np.zeros(self.n), rest.tau_m])

    def unpack(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Channels ``q_a v_a q_m v_m tau_m`` of states x (k, n_x), motors behind rigid gears
        filled in.
        """
        model = self.model
        n = self.n
        n_a = model.n_a
        i_g = list(model.i_g)
        i_m = list(model.i_m)
        out = {"q_a": x[:, :n_a], "v_a": x[:, n : n + n_a], "tau_m": x[:, 2 * n :]}
        for arm, motor, first in (("q_a", "q_m", n_a), ("v_a", "v_m", n + n_a)):
            out[motor] = out[arm][:, i_g] @ model.eta.T
            out[motor][:, i_m] = x[:, first : first + len(i_m)]
        return out

    def scales(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Sizes of y (n) and of the motor torques (n_m), and a typical rate [1/s], near the
        equilibrium x.

        They scale the unknowns of a solver. An arm coordinate has the size 1 rad or m, a motor its
        gear ratio. Torques [N m]: those at x, and at least those that accelerate the arm by 1 in
        its units. The rate is the root of stiffness over inertia, at least 1.
        """
        model = self.model
        size = np.r_[np.ones(model.n_a), np.abs(model.eta).max(axis=1)[list(model.i_m)]]
        state = self.unpack(x[None])
        M, R = evaluate(
            self.equations.function("residual_jacobians"),
            *(state[name][0] if name else np.zeros(k) for name, k in self._moving()),
        )
        M, _, K, B = (z * size[:, None] for z in second_order_matrices(M[0], R[0]))
        inertia = np.linalg.norm(M * size)
        stiffness = np.linalg.norm(K * size)
        rate = float(np.sqrt(stiffness / inertia)) if stiffness > 0 else 1.0
        rate = max(rate, 1.0)
        gain = np.maximum(np.linalg.norm(B, axis=0), 1e-300)
        load = np.abs(B).T @ np.abs(np.diag(M) * size) / gain**2
        return size, np.maximum(np.abs(x[2 * self.n :]), np.maximum(load, 1e-6)), rate

    def _moving(self) -> list[tuple[str, int]]:
        """Inputs of the residual in their order, with sizes; those without name are accelerations,
        which are rates of unknowns here.
        """
        n_a = self.model.n_a
        n_m = self.model.n_m
        return [
            ("q_a", n_a),
            ("v_a", n_a),
            ("", n_a),
            ("q_m", n_m),
            ("v_m", n_m),
            ("", n_m),
            ("tau_m", n_m),
        ]

    def targets(self, sample: Reference, orders: int) -> np.ndarray:
        """Targets and their derivatives up to ``orders``, (n, n_u, orders + 1), from a sample of a
        path.

        ``R' = hat(w) R``, and so on by Leibniz' rule. ArgumentError where the path does not have
        as many derivatives.
        """
        y = sample.q_g if self.joints else sample.y
        if y is None or y.shape[2] <= orders:
            known = "none of the joints" if y is None else f"up to order {y.shape[2] - 1}"
            raise ArgumentError(
                f"path: given derivatives {known}, expected up to order {orders} for this "
                "method and model"
            )
        if self.joints or sample.R is None or sample.w is None:
            return np.ascontiguousarray(y[:, :, : orders + 1])
        turned = [sample.R]
        for k in range(orders):
            hats = [_hat(sample.w[:, :, i]) for i in range(k + 1)]
            turned.append(
                sum(
                    (comb(k, i) * hats[i] @ turned[k - i] for i in range(k + 1)),
                    np.zeros_like(sample.R),
                )
            )
        columns = [R.transpose(0, 2, 1).reshape(-1, 9) for R in turned]
        return np.stack([np.hstack([y[:, :, k], columns[k]]) for k in range(orders + 1)], axis=-1)


def _hat(w: np.ndarray) -> np.ndarray:
    """Matrices of the cross products, (n, 3, 3) from (n, 3)."""
    out = np.zeros((len(w), 3, 3))
    out[:, 0, 1] = -w[:, 2]
    out[:, 0, 2] = w[:, 1]
    out[:, 1, 2] = -w[:, 0]
    return out - out.transpose(0, 2, 1)
