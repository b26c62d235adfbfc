"""Linear models of a robot at a pose.

dx' = A dx + B u,    y = C dx + D u,    dx = (dy, dy'),  y = (q_a, motors behind elastic gears)

They are sampled with the hold and the delay of a controller, see `flexgen.feedback.sampled_plant`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexgen.analysis.second_order import motor_rows
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.tool_angle import tool_angle
from flexgen.feedback.loop.plants import LocalDynamics
from flexgen.model.elements import RobotModel


@dataclass(frozen=True)
class PoseModel:
    """The linear model at a pose.

    ``A`` (n, n), ``B`` (n, n_m), ``push`` (n, 3): force on the tool, ``arm`` (n, n_a + n_k):
    forces on the arm's coordinates, then torques of the n_k elastic gears on arm and motor; ``C``
    (n_m + n_s, n): motor angles and sensors, ``D`` (n_m + n_s, n_m), ``D_arm`` (n_m + n_s, n_a +
    n_k): what the torques and forces themselves do to accelerometers; ``W`` (n_y, n): output.
    """

    A: np.ndarray
    B: np.ndarray
    push: np.ndarray
    arm: np.ndarray
    C: np.ndarray
    D: np.ndarray
    D_arm: np.ndarray
    W: np.ndarray


class PoseModels:
    """Linear models of a robot at points of a motion.

    ``names``, ``values`` (n_p,): numbers in which the robot differs from the model.
    """

    def __init__(
        self, model: RobotModel, names: Sequence[str] = (), values: np.ndarray | None = None
    ) -> None:
        """``names``, ``values``: numbers that differ from those of the model; they change the
        dynamics, not output, tool and sensors.
        """
        self.model = model
        equations = derive(model)
        # The numbers that differ change the dynamics alone: output, tool and sensors are those of
        # the model.
        self._local = LocalDynamics(derive(model, tuple(names)) if names else equations)
        self._values = np.zeros(0) if values is None else values
        self._output = output_jacobian(equations)
        self._tool = equations.function("jacobian")
        self._sensors = equations.function("sensor_derivatives") if model.sensors else None

    def at(self, motion: Sequence[np.ndarray]) -> PoseModel:
        """The robot linearized at one point of a motion, ``q_a v_a a_a q_m v_m a_m tau_m``, (1,
        ...) each.

        The states are the coordinates and their speeds (2 n); see `PoseModel` for inputs and
        outputs.
        """
        model = self.model
        n = self.model.dof
        n_a = self.model.n_a
        M, D, K, F = (x[0] for x in self._local.matrices(motion, self._values))
        inverse = np.linalg.inv(M)
        A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ D]])
        B = np.vstack([np.zeros((n, model.n_m)), inverse @ F])
        J = np.zeros((3, n))
        J[:, :n_a] = evaluate(self._tool, motion[0])[0].reshape(6, n_a)[:3]
        push = np.vstack([np.zeros((n, 3)), inverse @ J.T])
        geared = elastic_gears(model)
        twist = np.linalg.inv(model.eta)[:, list(model.i_m)]
        which = [model.i_g.index(i) for i in geared]
        # deflection: eta^-1 q_m - q_a
        pairs = inverse[:, geared] - inverse[:, n_a:] @ twist[which].T
        arm = np.vstack([np.zeros((n, n_a + len(geared))), np.hstack([inverse[:, :n_a], pairs])])
        C = np.hstack([motor_rows(model), np.zeros((model.n_m, n))])
        D = np.zeros((model.n_m, model.n_m))
        D_arm = np.zeros((model.n_m, arm.shape[1]))
        if self._sensors is not None:
            by_q, by_v, by_a = (x.reshape(-1, n_a) for x in evaluate(self._sensors, *motion[:3]))
            rows = np.zeros((len(by_q), 2 * n))
            rows[:, :n_a] = by_q
            rows[:, n : n + n_a] = by_v
            C = np.vstack([C, rows + by_a @ A[n : n + n_a]])
            D = np.vstack([D, by_a @ B[n : n + n_a]])
            D_arm = np.vstack([D_arm, by_a @ arm[n : n + n_a]])
        W = np.zeros((model.output.size, n))
        W[:, :n_a] = evaluate(self._output, motion[0])[0].reshape(model.output.size, n_a)
        return PoseModel(A, B, push, arm, C, D, D_arm, W)


def elastic_gears(model: RobotModel) -> list[int]:
    """Arm coordinates that are driven through elastic gears."""
    twist = np.linalg.inv(model.eta)[:, list(model.i_m)]
    return [i for i, row in zip(model.i_g, twist, strict=True) if np.any(row)]


def output_jacobian(equations: Equations) -> ca.Function:
    """W(q_a) (n_y, n_a): from arm velocities to rates of the output, of a pose its spatial
    velocity.
    """
    model = equations.model
    q = ca.SX.sym("q_a", equations.model.n_a)
    if model.output.type == "combination":
        return ca.Function("W", [q], [ca.SX(ca.DM(model.output.weights))])
    J = equations.function("jacobian")(q)
    rows = list(range(6)) if model.output.type == "tool_pose" else list(model.output.tool_rows)
    W = J[rows, :]
    if model.output.has_angle:
        rate = tool_angle(equations).rate
        W = ca.vertcat(W, ca.substitute(rate, equations.lagrangian.chain.q_a, q))
    if model.output.weights:
        first = model.output.tool_size
        W = ca.vertcat(W[:first, :], ca.SX(ca.DM(model.output.weights)), W[first:, :])
    return ca.Function("W", [q], [ca.densify(W)])
