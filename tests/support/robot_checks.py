"""Checks of the results of flexgen for a robot against MuJoCo and Pinocchio, with their
tolerances.

A check raises AssertionError where a result of `Found` is wrong. An error is relative to the terms
of a sum, not to the sum.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mujoco_referee import MujocoMachine, MujocoReferee
from random_robots import Case
from referee import State

from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.linearization import second_order_matrices
from flexgen.model.elements import RobotModel

try:
    from pinocchio_referee import PinocchioReferee
except ModuleNotFoundError:
    PinocchioReferee = None
try:
    # also where it is wrong
    from flexgen.codegen.recursion.functions import recursive_function as fast_function
except ModuleNotFoundError:
    fast_function = None

MASS = 1e-12  # of sqrt(M_ii M_kk): rounding along a chain of some twenty joints
MOTION = 1e-12  # of one plus the largest entry: poses and Jacobians
TORQUE = 1e-11  # of the terms of the row: |M| |a|, centripetal and gravity forces
SLOPE = 1e-11  # of the largest slope of the torques
# of the largest acceleration, and of |M| |a| in each row: condition numbers up to 1e6
ACCELERATION = 1e-9


# --- flexgen's results ---------------------------------------------------------------------------


class Found:
    """Results of flexgen: ``found("mass_matrix", q_a)`` is the list of a function's results as
    CasADi shapes them.

    ``route``: source of the functions; those it does not have are from Lagrange's equations.
    ``planted``: results by name, changed by a planted bug.
    """

    def __init__(
        self,
        equations: Equations,
        route: str = "lagrange",
        planted: dict[str, Callable] | None = None,
    ):
        self.equations = equations
        self._route = route
        self._planted = planted or {}
        self._functions: dict = {}

    def __call__(self, name: str, *arguments) -> list[np.ndarray]:
        if name not in self._functions:
            function = fast_function(self.equations, name) if self._route == "fast" else None
            self._functions[name] = function or self.equations.function(name)
        function = self._functions[name]
        results = [
            np.array(x.full())
            for x in function.call([np.asarray(x, dtype=float) for x in arguments])
        ]
        if name in self._planted:
            results = self._planted[name](self, results, *arguments)
        return results


def close(what: str, found: np.ndarray, expected, tolerance: float, scale=None) -> None:
    """Every entry within the tolerance of its scale, by default the largest expected entry."""
    expected = np.reshape(expected, found.shape)
    scale = np.abs(expected).max(initial=0.0) if scale is None else scale
    scale = np.reshape(scale, found.shape) if np.ndim(scale) else scale
    excess = np.abs(found - expected) - tolerance * scale
    assert np.all(excess <= 0), (
        f"{what}: found\n{found}\nexpected\n{expected}\nallowed {tolerance} of\n{scale}"
    )


def rows_of(M: np.ndarray, a: np.ndarray, *forces: np.ndarray) -> np.ndarray:
    """Size of the terms in each row of the equations of motion."""
    return np.abs(M) @ np.abs(a) + sum(np.abs(f) for f in forces)


def motors_of(model: RobotModel, s: State) -> np.ndarray:
    """Accelerations of the motors; those behind rigid gears follow their joints."""
    geared = model.eta @ s.a_a[list(model.i_g)]
    elastic = np.isin(np.arange(model.n_m), model.i_m)
    return np.where(elastic, 1.3 * geared + 1.0, geared)


def check_accelerations(
    found: Found, s: State, M: np.ndarray, a_a: np.ndarray, a_m: np.ndarray
) -> None:
    """Accelerations of the whole robot against expected ones, M its mass matrix."""
    model = found.equations.model
    y = np.concatenate([a_a, a_m[list(model.i_m)]])
    got_a, got_m = (x.ravel() for x in found("forward_dynamics", *s.x, s.tau_m))
    got = np.concatenate([got_a, got_m[list(model.i_m)]])
    close("accelerations of the arm", got_a, a_a, ACCELERATION)
    close("accelerations of the motors", got_m, a_m, ACCELERATION)
    close("balance of the accelerations", M @ (got - y), 0 * y, ACCELERATION, rows_of(M, y))
    x = np.concatenate([s.q_a, s.q_m[list(model.i_m)], s.v_a, s.v_m[list(model.i_m)]])
    rate = np.concatenate([x[model.dof :], y])
    close("rate of the state", found("state_rate", x, s.tau_m)[0], rate, ACCELERATION)


def check_arm_accelerations(
    found: Found, s: State, M: np.ndarray, tau_a: np.ndarray, a_a: np.ndarray
) -> None:
    """Accelerations of the bodies alone under forces ``tau_a`` against expected ones."""
    got = found("arm_forward_dynamics", s.q_a, s.v_a, tau_a)[0].ravel()
    close("accelerations of the bodies", got, a_a, ACCELERATION)
    close("balance of the bodies", M @ (got - a_a), 0 * a_a, ACCELERATION, rows_of(M, a_a))


def check_mujoco(found: Found, case: Case) -> None:
    """All quantities of MuJoCo, with rotors and elastic gears where all laws are linear."""
    model = case.model
    arm = MujocoReferee(model, rotors=False)
    machine = MujocoMachine(model) if case.linear else None
    for s in case.states:
        M = arm.mass_matrix(s.q_a)
        size = np.sqrt(np.diag(M))
        close("mass matrix", found("mass_matrix", s.q_a)[0], M, MASS, np.outer(size, size))
        for got, pose in zip(found("forward_kinematics", s.q_a), arm.tool(s.q_a), strict=True):
            close("tool", got, pose, MOTION, 1 + np.abs(pose).max())
        gravity = arm.bias(s.q_a, 0 * s.v_a)
        bias = arm.bias(s.q_a, s.v_a)
        rows = rows_of(M, s.a_a, bias - gravity, gravity)
        torque = arm.inverse_dynamics(s.q_a, s.v_a, s.a_a)
        close(
            "inverse dynamics",
            found("inverse_dynamics", s.q_a, s.v_a, s.a_a)[0],
            torque,
            TORQUE,
            rows,
        )
        close("bias", found("bias", s.q_a, s.v_a)[0], bias, TORQUE, rows)
        close("gravity", found("gravity", s.q_a)[0], gravity, TORQUE, rows)
        check_arm_accelerations(
            found, s, M, torque + gravity, np.linalg.solve(M, torque + gravity - bias)
        )
        if machine is not None:
            a_a, a_m = machine.forward_dynamics(*s.x, s.tau_m)
            check_accelerations(found, s, machine.minimal_mass(s.q_a), a_a, a_m)


def check_pinocchio(found: Found, case: Case) -> None:
    """All quantities of Pinocchio, with springs and frictions added by hand."""
    model = case.model
    reference = PinocchioReferee(case.model)
    for s in case.states:
        M = reference.mass_matrix(s.q_a)
        size = np.sqrt(np.diag(M))
        close("mass matrix", found("mass_matrix", s.q_a)[0], M, MASS, np.outer(size, size))
        for got, pose in zip(
            found("forward_kinematics", s.q_a), reference.forward_kinematics(s.q_a), strict=True
        ):
            close("tool", got, pose, MOTION, 1 + np.abs(pose).max())
        J = reference.jacobian(s.q_a)
        dJ = reference.jacobian_dot(s.q_a, s.v_a)
        close("jacobian", found("jacobian", s.q_a)[0], J, MOTION, 1 + np.abs(J).max())
        close(
            "rate of the jacobian",
            found("jacobian_dot", s.q_a, s.v_a)[0],
            dJ,
            MOTION,
            1 + np.abs(dJ).max(),
        )
        gravity = reference.gravity(s.q_a)
        bias = reference.bias(s.q_a, s.v_a)
        rows = rows_of(M, s.a_a, bias - gravity, gravity)
        torque = reference.inverse_dynamics(s.q_a, s.v_a, s.a_a)
        close(
            "inverse dynamics",
            found("inverse_dynamics", s.q_a, s.v_a, s.a_a)[0],
            torque,
            TORQUE,
            rows,
        )
        close("bias", found("bias", s.q_a, s.v_a)[0], bias, TORQUE, rows)
        close("gravity", found("gravity", s.q_a)[0], gravity, TORQUE, rows)
        by_arm = reference.arm.accelerations(s.q_a, s.v_a, torque + gravity)
        check_arm_accelerations(found, s, M, torque + gravity, by_arm)
        turning = reference.rotor_torque(s.q_a, s.v_a, s.a_a, s.v_m, motors_of(model, s))
        close(
            "rotors",
            found("rotor_torque", s.q_a, s.v_a, s.a_a, s.v_m, motors_of(model, s))[0],
            turning,
            TORQUE,
        )
        check_accelerations(
            found, s, reference.machine_mass(s.q_a), *reference.forward_dynamics(*s.x, s.tau_m)
        )
        check_arm_slopes(found, reference, s)
        if case.linear:
            check_slopes(found, reference, s)


def torques(reference: PinocchioReferee, s: State) -> float:
    """The largest term of the arm's inverse dynamics: slopes round with it, where they vanish as
    well.
    """
    bias = reference.bias(s.q_a, s.v_a), reference.gravity(s.q_a)
    return rows_of(reference.mass_matrix(s.q_a), s.a_a, *bias).max()


def check_arm_slopes(found: Found, reference: PinocchioReferee, s: State) -> None:
    """Derivatives of the bodies' inverse dynamics: no stiff spring hides them."""
    by_q, by_v = reference.inverse_derivatives(s.q_a, s.v_a, s.a_a)
    M = reference.mass_matrix(s.q_a)
    size = torques(reference, s)
    for x, y in zip(
        found("inverse_dynamics_derivatives", s.q_a, s.v_a, s.a_a), (by_q, by_v, M), strict=True
    ):
        close("slopes of the bodies", x, y, SLOPE, np.abs(y).max() + size)
    for x, y in zip(
        found("arm_residual_jacobians", s.q_a, s.v_a, s.a_a),
        (M, np.hstack([by_q, by_v])),
        strict=True,
    ):
        close("slopes of the arm", x, y, SLOPE, np.abs(y).max() + size)


def check_slopes(found: Found, reference: PinocchioReferee, s: State) -> None:
    """Derivatives of the whole machine's equations and accelerations, its energies, where all laws
    are linear.
    """
    a_m = motors_of(reference.model, s)
    size = torques(reference, s)
    expected = reference.second_order(s.q_a, s.v_a, s.a_a, s.q_m, s.v_m, a_m)
    M, R = found("residual_jacobians", s.q_a, s.v_a, s.a_a, s.q_m, s.v_m, a_m, s.tau_m)
    for name, x, y in zip("MDKB", second_order_matrices(M, R), expected, strict=True):
        close(
            f"second order {name}", x, y, SLOPE, np.abs(y).max() + (size if name in "DK" else 0.0)
        )
    energies = found("energy", *s.x)
    for x, y in zip(energies, reference.energies(*s.x), strict=True):
        close("energies", x, y, TORQUE, sum(np.abs(e).item() for e in energies))
    linear = reference.linearize(*s.x, s.tau_m)
    if linear is not None:
        for name, x, y in zip("AB", found("linearize", *s.x, s.tau_m), linear, strict=True):
            close(f"linearized {name}", x, y, ACCELERATION)


def check_robot(case: Case) -> None:
    """Check a robot against all reference programs, on every route."""
    equations = derive(case.model)
    routes = ["lagrange"]
    # the shortest of them
    if fast_function is not None and fast_function(equations, "gravity") is not None:
        routes.append("fast")
    for route in routes:
        found = Found(equations, route)
        check_mujoco(found, case)
        if PinocchioReferee is not None:
            check_pinocchio(found, case)
