"""Torques of a chain of rigid bodies along recorded motions, linear in the numbers of its bodies.

    tau = Y(q, v, a) pi,
    pi: mass, mass x center of mass, inertia about the origin of each body (10 numbers)

Source: M. Gautier and W. Khalil, IEEE TRA 6(3), 1990 (regressor, base parameters).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.numerics.polynomial_filter import WINDOW, derivatives, smooth_forces
from flexgen.dynamics.hysteresis.hysteresis import without_hysteresis
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.force_laws import friction_torque
from flexgen.identification.rigid.feasible_bodies import body_of, numbers_of
from flexgen.model.abilities import check_ability
from flexgen.model.elements import Body, RobotModel

RANK = 1e-9  # of singular values of base parameters
BODY = (
    "mass",
    *(f"com_{axis}" for axis in "xyz"),
    *(f"inertia_{axes}" for axes in "xx yy zz xy yz xz".split()),
)


@dataclass(frozen=True, eq=False)
class Motion:
    """A recorded motion: ``t`` (n,) [s], ``q`` (n, n_g) [rad or m, joints], ``tau_m`` (n, n_m) [N
    m, motor side].
    """

    t: np.ndarray
    q: np.ndarray
    tau_m: np.ndarray

    def __post_init__(self) -> None:
        n = len(self.t)
        if (
            self.q.ndim != 2
            or self.tau_m.ndim != 2
            or len(self.q) != n
            or len(self.tau_m) != n
            or n <= WINDOW
        ):
            raise ArgumentError(
                f"motion: given t {self.t.shape}, q {self.q.shape}, tau_m {self.tau_m.shape}, "
                f"expected (n,), (n, n_g), (n, n_m) with n > {WINDOW}"
            )
        for name in ("t", "q", "tau_m"):
            bad = np.argwhere(~np.isfinite(getattr(self, name)))
            if len(bad):
                raise ArgumentError(f"motion: {name} is not finite at sample {bad[0][0]}")
        steps = np.diff(self.t)
        if not np.all(np.abs(steps - np.median(steps)) < 0.05 * np.median(steps)):
            k = int(np.argmax(np.abs(steps - np.median(steps))))
            raise ArgumentError(
                f"motion: the time goes from {self.t[k]:.6g} to {self.t[k + 1]:.6g} s, expected "
                "equal steps"
            )

    @cached_property
    def step(self) -> float:
        """Sample time [s], of all: a clock in whole microseconds can change the median of the
        steps by a thousandth.
        """
        return float((self.t[-1] - self.t[0]) / (len(self.t) - 1))

    @cached_property
    def derivatives(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Joints, speeds and accelerations (n, n_g), from polynomials over `WINDOW` samples."""
        return derivatives(self.q, self.step)

    @cached_property
    def torques(self) -> np.ndarray:
        """Torques (n, n_m) through the filter of the accelerations: faster torques are not those
        of a rigid body.
        """
        return smooth_forces(self.tau_m)


class Regressor:
    """``Y(q, v, a)`` of a chain of rigid bodies: torques of the arm for each of the 10 numbers of
    each body.

    Parameters
    ----------
    model : RobotModel
        Its gears are taken as rigid; springs without motor are refused.
    """

    def __init__(self, model: RobotModel) -> None:
        check_ability(model, "identify_rigid")
        self.model = model
        names = [f"{element.name}.{name}" for element in model.elements for name in BODY]
        empty = replace(without_hysteresis(model), payload=Body())
        equations = Equations(empty, names)
        lag = equations.lagrangian
        # The torques are linear in mass, mass x center and inertia about the origin: their
        # derivatives in these at a body of mass 1 at its origin are those in mass, center and
        # inertia about the center.
        at = [1.0 if p.name.endswith(".mass") else 0.0 for p in equations.parameters]
        Y = ca.substitute(
            ca.jacobian(equations.arm_left, equations.symbols), equations.symbols, ca.DM(at)
        )
        state = [lag.chain.q_a, lag.chain.v_a, lag.a_a]
        self._function = ca.Function("regressor", state, [ca.densify(Y)])
        self.equations = equations
        self.names = tuple(p.name for p in equations.parameters)
        pi = ca.SX.sym("pi", len(names))
        arm = ca.substitute(equations.arm_left, equations.symbols, _in_model(pi))
        bend = [ca.SX.sym(f"bend_{k}", model.n_a) for k in range(3)]
        columns = []
        for i in range(model.n_a):
            step = ca.vertcat(*[one * (ca.DM.eye(model.n_a)[:, i]) for one in bend])
            columns.append(ca.jtimes(arm, ca.vertcat(*state), step))
        self._change = ca.Function(
            "change", [*state, pi, *bend], [ca.densify(ca.horzcat(*columns))]
        )

    def __call__(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """The regressor at n states, (n, n_a, 10 bodies)."""
        return evaluate(self._function, q, v, a)[0].reshape(-1, self.model.n_a, len(self.names))

    def changes(
        self, state: Sequence[np.ndarray], pi: np.ndarray, steps: Sequence[np.ndarray]
    ) -> np.ndarray:
        """Changes of the torques (n, n_a, n_a) with the steps of q, v and a of each joint alone,
        to first order.
        """
        numbers = np.broadcast_to(pi, (len(state[0]), len(pi)))
        n_a = self.model.n_a
        return evaluate(self._change, *state, numbers, *steps)[0].reshape(-1, n_a, n_a)

    def joint_friction(self, v: np.ndarray) -> np.ndarray:
        """Friction of the joints in the model file (n, n_a) [N m or N] at speeds (n, n_a)."""
        speed = ca.SX.sym("speed", self.model.n_a)
        laws = [None if c.dof is None else c.dof.friction for c in self.model.coordinates]
        torque = [
            ca.SX(0) if law is None else friction_torque(law, speed[i])
            for i, law in enumerate(laws)
        ]
        return evaluate(ca.Function("friction", [speed], [ca.densify(ca.vertcat(*torque))]), v)[0]

    def bodies(self, pi: np.ndarray) -> tuple[Body, ...]:
        """Bodies with these numbers (10 bodies,)."""
        return tuple(body_of(row) for row in pi.reshape(-1, 10))

    def of_model(self) -> np.ndarray:
        """The numbers of the bodies of the model, payload in the last one, (10 bodies,)."""
        rows = [numbers_of(element.body) for element in self.model.elements]
        return np.concatenate(rows) + payload_in(self.model)

    def base_parameters(self, states: int = 500, seed: int = 0) -> int:
        """Number of combinations that any motion can determine: the rank at random states."""
        rng = np.random.default_rng(seed)
        Y = self(*(rng.uniform(-2, 2, (states, self.model.n_a)) for _ in range(3))).reshape(
            -1, len(self.names)
        )
        values = np.linalg.svd(Y / np.maximum(np.linalg.norm(Y, axis=0), 1e-300), compute_uv=False)
        return int((values > RANK * values[0]).sum())


def payload_in(model: RobotModel) -> np.ndarray:
    """Numbers that the payload of a model adds to those of its bodies, (10 bodies,)."""
    rows = np.zeros((len(model.elements), 10))
    rows[-1] = numbers_of(model.payload)
    return rows.ravel()


def _in_model(pi: ca.SX) -> ca.SX:
    """The numbers of a model file in the order of `BODY` from those of the bodies, see
    `feasible_bodies.body_of`.
    """
    out = []
    for k in range(0, pi.numel(), 10):
        m = pi[k]
        h = pi[k + 1 : k + 4]
        x, y, z = ca.vertsplit(h / m)
        xx, yy, zz, xy, yz, xz = ca.vertsplit(pi[k + 4 : k + 10])
        moments = [xx - m * (y * y + z * z), yy - m * (x * x + z * z), zz - m * (x * x + y * y)]
        out += [m, x, y, z, *moments, xy + m * x * y, yz + m * y * z, xz + m * x * z]
    return ca.vertcat(*out)
