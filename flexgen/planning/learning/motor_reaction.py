"""Motor torques that move the motors of an elastic robot by small deviations.

Along a motion the model is linear in deviations ``y = (q_a, motors behind elastic gears)``:

    M(t) y'' + D(t) y' + K(t) y = B(t) tau

Of ``y`` the part ``x`` follows the motors, ``q_m = T x``; the other part ``z`` moves with motors
that are given:

    M_zz z'' + D_zz z' + K_zz z = -(M_zx x'' + D_zx x' + K_zx x)

It is integrated by the trapezoidal rule (Newmark's with 1/4 and 1/2, which is stable with any
step), from rest. The rows of ``x`` then give the torques: what the motors, and the arm that they
swing, need in addition.

Source: N. Newmark, J. Engineering Mechanics Division ASCE 85(3), 1959.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexgen.analysis.second_order import motor_rows, with_motors_locked
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.feedback.loop.plants import LocalDynamics

POINTS = 60  # of the motion at which the model is linearised


class LinearisedArm:
    """The linear model along a motion.

    Parameters
    ----------
    equations : Equations
    motion : sequence of arrays (n, ...)
        ``q_a v_a a_a q_m v_m a_m tau_m`` at equal steps.
    step : float [s]
    """

    def __init__(self, equations: Equations, motion: Sequence[np.ndarray], step: float) -> None:
        model = equations.model
        self.model = model
        self.step = step
        self.count = len(motion[0])
        self.free = with_motors_locked(model)
        self.driven = [i for i in range(model.dof) if i not in self.free]
        self._x_of_motors = np.linalg.inv(motor_rows(model)[:, self.driven])
        at = np.unique(np.linspace(0, self.count - 1, POINTS).astype(int))
        local = LocalDynamics(equations)
        self._at = at
        self._matrices = local.matrices([x[at] for x in motion], np.zeros(0))

    def _between(self, which: int, rows: list[int], columns: list[int]) -> np.ndarray:
        """A part of M, D, K or B at all samples (n, rows, columns), linear between the points."""
        given = self._matrices[which][:, rows][:, :, columns]
        flat = given.reshape(len(given), -1)
        k = np.arange(self.count)
        found = [np.interp(k, self._at, x) for x in flat.T]
        shape = (self.count, len(rows), len(columns))
        return np.stack(found, axis=1).reshape(shape) if found else np.zeros(shape)

    def torque(self, dq: np.ndarray, dv: np.ndarray, da: np.ndarray) -> np.ndarray:
        """Torques (n, n_m) [N m] for deviations of the motor angles (n, n_m) [rad] and their
        rates [rad/s, rad/s^2].
        """
        x, v, a = (d @ self._x_of_motors.T for d in (dq, dv, da))
        free = self.free
        driven = self.driven
        z = self.free_motion(x, v, a)
        motors = list(range(self.model.n_m))
        total = np.zeros((self.count, len(driven)))
        for which, rate_x, rate_z in ((0, a, z[2]), (1, v, z[1]), (2, x, z[0])):
            total += np.einsum("nij,nj->ni", self._between(which, driven, driven), rate_x)
            total += np.einsum("nij,nj->ni", self._between(which, driven, free), rate_z)
        B = self._between(3, driven, motors)
        return np.asarray(np.linalg.solve(B, total[:, :, None])[:, :, 0])

    def free_motion(self, x: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, ...]:
        """Deviations ``z`` (n, n_z) of the springs' side, and two rates, with the motors given."""
        free = self.free
        driven = self.driven
        force = np.zeros((self.count, len(free)))
        for which, rate in ((0, a), (1, v), (2, x)):
            force -= np.einsum("nij,nj->ni", self._between(which, free, driven), rate)
        return self._integrate(force)

    def _integrate(self, force: np.ndarray) -> tuple[np.ndarray, ...]:
        """Deviations ``z`` (n, n_z) of the springs' side, and two rates, under a force (n, n_z),
        with the motors locked; at first in equilibrium.
        """
        free = self.free
        h = self.step
        M, D, K = (self._between(k, free, free) for k in range(3))
        z = np.zeros((3, self.count, len(free)))
        z[0, 0] = np.linalg.solve(K[0], force[0])
        for n in range(self.count - 1):
            guess = z[0, n] + h * z[1, n] + h * h / 4 * z[2, n]
            speed = z[1, n] + h / 2 * z[2, n]
            lhs = M[n + 1] + h / 2 * D[n + 1] + h * h / 4 * K[n + 1]
            rate = np.linalg.solve(lhs, force[n + 1] - D[n + 1] @ speed - K[n + 1] @ guess)
            z[2, n + 1] = rate
            z[1, n + 1] = speed + h / 2 * rate
            z[0, n + 1] = guess + h * h / 4 * rate
        return z[0], z[1], z[2]

    def under_torques(self, torque: np.ndarray) -> np.ndarray:
        """Deviations (n, n_a) [rad or m] of the arm under further torques (n, n_a) [N m or N] with
        locked motors.
        """
        n_a = self.model.n_a
        force = np.zeros((self.count, self.model.dof))
        force[:, :n_a] = torque
        moved = np.zeros((self.count, self.model.dof))
        moved[:, self.free] = self._integrate(force[:, self.free])[0]
        return moved[:, :n_a]

    def with_motors(self, dq: np.ndarray, dv: np.ndarray, da: np.ndarray) -> np.ndarray:
        """Deviations (n, n_a) [rad or m] of the arm with motors that deviate by dq (n, n_m) [rad]
        and their rates [rad/s, rad/s^2].
        """
        x, v, a = (d @ self._x_of_motors.T for d in (dq, dv, da))
        moved = np.zeros((self.count, self.model.dof))
        moved[:, self.driven] = x
        moved[:, self.free] = self.free_motion(x, v, a)[0]
        return moved[:, : self.model.n_a]

    def stiffness(self) -> np.ndarray:
        """Stiffness (n, n_a) [N m/rad or N/m] of each coordinate of the arm alone."""
        arm = list(range(self.model.n_a))
        return np.asarray(np.diagonal(self._between(2, arm, arm), axis1=1, axis2=2))
