"""The elastic arm behind motors with known angles: torques, positions and rest, with the numbers
of a joint fit as arguments.

One set of equations for motions and for static poses, so that a number means the same in both.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.sensors import TOOL, Sensor
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.kinematics import place
from flexgen.identification.commissioning.unknowns import Unknowns
from flexgen.identification.gears.driven_arm import DrivenArm
from flexgen.model.elements import Placement
from flexgen.simulation.integration.segments import Segments

NEWTON_STEPS = 50
AT_REST = 1e-11  # rad or m: largest last step of Newton's method
FAST = 1e9  # 1/s: no element of hysteresis is slowed down


class ElasticArm:
    """Equations of the arm behind its motors with the numbers of a fit.

    Arguments of all functions: state x (n_x,), motor angles, speeds and accelerations u (3 n_m,),
    numbers p (n_p,) of the model, then the places of the trackers (3 k,) [m].

    Parameters
    ----------
    unknowns : Unknowns
    sensors : sequence of Sensor
        Trackers; empty: torques only.
    """

    def __init__(self, unknowns: Unknowns, sensors: Sequence[Sensor]) -> None:
        self.unknowns = unknowns
        self.robot = unknowns.robot
        self.sensors = tuple(sensors)
        equations = derive(self.robot, unknowns.vector.of_model)
        self.driven = driven = DrivenArm(equations, ())
        self.names = [p.name for p in equations.parameters]
        chain = equations.lagrangian.chain
        x = ca.SX.sym("x", driven.n_x)
        u = ca.SX.sym("u", 3 * self.robot.n_m)
        p = ca.SX.sym("p", len(self.names))
        offsets = ca.SX.sym("offsets", 3 * len(sensors))
        whole = ca.vertcat(p, ca.SX(FAST))
        points = ca.SX(0, 1)
        for k, sensor in enumerate(sensors):
            frame = chain.tool if sensor.place == TOOL else chain.frames[sensor.place]
            start = place(frame, Placement((0.0, 0.0, 0.0)))
            points = ca.vertcat(points, start.p + ca.mtimes(start.R, offsets[3 * k : 3 * k + 3]))
        (points,) = ca.substitute(
            [ca.densify(points)], [chain.q_a], [driven.coordinates(x, u, whole)]
        )
        given = [x, u, ca.vertcat(p, offsets)]
        self.n_p = len(self.names) + 3 * len(sensors)
        self.rate = ca.Function("joint_fit_rate", given, [driven.rate(x, u, whole)])
        outputs = ca.vertcat(driven.torque(x, u, whole), points)
        self.outputs = ca.Function("joint_fit_outputs", given, [ca.densify(outputs)])
        self.n_free = len(driven.free)
        self._static = self._functions_at_rest(given, points)

    def _functions_at_rest(self, given: list[ca.SX], points: ca.SX) -> tuple[ca.Function, ...]:
        """Balance with its Jacobian in the free coordinates; positions; derivatives of both in
        all arguments.
        """
        free = ca.SX.sym("free", self.n_free)
        motors = ca.SX.sym("motors", self.robot.n_m)
        numbers = ca.SX.sym("numbers", self.n_p)
        still = [
            ca.vertcat(free, ca.SX.zeros(self.n_free)),
            ca.vertcat(motors, ca.SX.zeros(2 * self.robot.n_m)),
            numbers,
        ]
        p = ca.vertcat(numbers[: len(self.names)], ca.SX(FAST))
        balance = self.driven.balance(still[0], still[1], p)
        (shown,) = ca.substitute([points], [ca.vertcat(*given)], [ca.vertcat(*still)])
        args = [free, motors, numbers]
        newton = ca.Function(
            "joint_fit_rest", args, [ca.densify(balance), ca.densify(ca.jacobian(balance, free))]
        )
        changes = [ca.densify(ca.jacobian(balance, y)) for y in args]
        moves = [ca.densify(ca.jacobian(shown, y)) for y in args]
        slopes = ca.Function("joint_fit_slopes", args, [*changes, *moves])
        return newton, ca.Function("joint_fit_points", args, [ca.densify(shown)]), slopes

    def numbers(self, x: np.ndarray) -> np.ndarray:
        """Numbers of the model, then places of the trackers, at unknowns x (n_p,)."""
        named = self.unknowns.vector.named(x[self.unknowns.parts.model])
        return np.append([named[name] for name in self.names], self._places(x))

    def _places(self, x: np.ndarray) -> np.ndarray:
        """Places of the trackers (3 k,) [m]."""
        if not self.sensors:
            return np.zeros(0)
        found = x[self.unknowns.parts.trackers]
        return found if len(found) else np.ravel([sensor.position for sensor in self.sensors])

    def rest(self, q_m: np.ndarray, p: np.ndarray, near: np.ndarray | None = None) -> np.ndarray:
        """Free coordinates (N, n_free) at rest at motor angles (N, n_m) for numbers (n_p,) or (N,
        n_p).

        Raises
        ------
        SolverError
            A pose has no equilibrium.
        """
        if near is None:
            joints = np.zeros((len(q_m), self.robot.dof))
            joints[:, list(self.robot.i_g)] = q_m @ np.linalg.inv(self.robot.eta).T
            near = joints[:, self.driven.free]
        free = near.copy()
        if not self.n_free:
            return free
        for _ in range(NEWTON_STEPS):
            balance, slope = evaluate(self._static[0], free, q_m, p)
            rows = balance.reshape(len(free), self.n_free)
            matrix = slope.reshape(len(free), self.n_free, self.n_free)
            step = np.linalg.solve(matrix, rows[..., None])[..., 0]
            free = free - step
            if not np.isfinite(free).all():
                break
            if np.abs(step).max() < AT_REST:
                return free
        raise SolverError("commission: the springs do not carry the arm at a pose of the records")

    def points(self, free: np.ndarray, q_m: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Trackers (N, 3 k) [m] in the world at rest."""
        return evaluate(self._static[1], free, q_m, p)[0].reshape(len(free), -1)

    def point_slopes(
        self, free: np.ndarray, q_m: np.ndarray, p: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the trackers at rest in the motor angles (N, 3 k, n_m) and in the numbers
        (N, 3 k, n_p), by the implicit function theorem.
        """
        n = len(free)
        found = evaluate(self._static[2], free, q_m, p)
        b_free, b_motors, b_numbers = (
            x.reshape(n, self.n_free, -1) if self.n_free else np.zeros((n, 0, k))
            for x, k in zip(found[:3], (0, self.robot.n_m, self.n_p), strict=True)
        )
        rows = 3 * len(self.sensors)
        y_free, y_motors, y_numbers = (x.reshape(n, rows, -1) for x in found[3:])
        if not self.n_free:
            return y_motors, y_numbers
        carried = -y_free @ np.linalg.inv(b_free)
        return y_motors + carried @ b_motors, y_numbers + carried @ b_numbers

    def segments(self, sample_s: float, steps: int) -> Segments:
        """The simulation with so many steps from sample to sample: torques, then trackers."""
        return Segments(self.rate, self.outputs, sample_s, steps)

    def fastest(self, poses: np.ndarray, p: np.ndarray) -> float:
        """Largest size of an eigenvalue [1/s] at rest at motor angles (k, n_m)."""
        return self.driven.fastest(poses, np.append(p[: len(self.names)], FAST))

    def state(self, q_m: np.ndarray, v_m: np.ndarray, p: np.ndarray) -> np.ndarray:
        """States (N, n_x) at static deflections for motor angles and speeds (N, n_m)."""
        free = self.rest(q_m, p)
        speeds = np.array([self.driven.joint_speeds(v) for v in v_m])
        return np.hstack([free, speeds.reshape(len(free), -1)])
