"""Bugs planted in the functions of a model, to show that a check sees them."""

from __future__ import annotations

import numpy as np
from referee import Answers

from flexgen.model.elements import RobotModel

# Factor of a Jacobian whose angular rows have the wrong sign.
ANGULAR = np.array([[1.0], [1], [1], [-1], [-1], [-1]])


def wrong_coriolis(a: Answers, model: RobotModel) -> Answers:
    """The sign of c flipped, in all the answers that it enters."""

    def twice_c(q_a, v_a):
        return 2 * (a.bias(q_a, v_a) - a.gravity(q_a))

    def forward_dynamics(q_a, v_a, q_m, v_m, tau_m):
        a_a, a_m = a.forward_dynamics(q_a, v_a, q_m, v_m, tau_m)

        def residual(a_a):
            return a.residual(q_a, v_a, a_a, q_m, v_m, a_m, tau_m)[0]

        # then the arm's rows are alone
        assert len(model.i_m) == model.n_m and model.motor_coupling == "simplified"
        M = np.array([residual(a_a + e) - residual(a_a) for e in np.eye(model.n_a)]).T
        return a_a + np.linalg.solve(M, np.sign(M[0, 0]) * twice_c(q_a, v_a)), a_m

    return a.but(
        bias=lambda q_a, v_a: a.bias(q_a, v_a) - twice_c(q_a, v_a),
        inverse_dynamics=lambda q_a, v_a, a_a: (
            a.inverse_dynamics(q_a, v_a, a_a) - twice_c(q_a, v_a)
        ),
        forward_dynamics=forward_dynamics,
    )


def asymmetric_mass(a: Answers, model: RobotModel) -> Answers:
    def mass_matrix(q_a):
        M = a.mass_matrix(q_a)
        M[0, 1] += 1e-6 * M[0, 0]
        return M

    return a.but(mass_matrix=mass_matrix)


def indefinite_mass(a: Answers, model: RobotModel) -> Answers:
    return a.but(
        mass_matrix=lambda q_a: a.mass_matrix(q_a) - 2 * np.diag(np.diag(a.mass_matrix(q_a)))
    )


def wrong_gravity(a: Answers, model: RobotModel) -> Answers:
    def falling(q_a):
        return 2 * a.gravity(q_a)

    return a.but(
        gravity=lambda q_a: -a.gravity(q_a),
        bias=lambda q_a, v_a: a.bias(q_a, v_a) - falling(q_a),
        inverse_dynamics=lambda q_a, v_a, a_a: a.inverse_dynamics(q_a, v_a, a_a) - falling(q_a),
    )


def light_mass(a: Answers, model: RobotModel) -> Answers:
    return a.but(mass_matrix=lambda q_a: (1 - 1e-6) * a.mass_matrix(q_a))


def slow_forward_dynamics(a: Answers, model: RobotModel) -> Answers:
    return a.but(forward_dynamics=lambda *x: tuple((1 - 1e-6) * y for y in a.forward_dynamics(*x)))


def scaled(name: str, factor):
    """A bug: the answer of that name times a factor, of one number or one for each of several
    results.
    """

    def bug(a: Answers, model: RobotModel) -> Answers:
        def answer(*x):
            y = getattr(a, name)(*x)
            return (
                tuple(f * z for f, z in zip(factor, y, strict=True))
                if isinstance(y, tuple)
                else factor * y
            )

        return a.but(**{name: answer})

    bug.__name__ = f"scaled_{name}"
    return bug


def trusting_motors(a: Answers, model: RobotModel) -> Answers:
    return a.but(forward_dynamics=lambda q_a, v_a, q_m, v_m, tau_m: (v_m * 1.0, q_m * 1.0))
