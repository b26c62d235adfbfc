"""Derivatives of the equations of motion as builders of CasADi functions, from the Lagrangian.

r(y, dy, ddy, tau_m) = 0:     M = dr/dddy,   R = (dr/dy, dr/ddy, dr/dtau_m)
x = (y, dy):                  dx/dt = A x + B tau_m to first order,   lower rows: -M^-1 R
"""

from __future__ import annotations

import casadi as ca

from flexgen.mechanics.dynamics import MOTION, STATE, symbols_of
from flexgen.mechanics.system import Builder, Built, System, solve_symmetric


def inverse_dynamics_derivatives(system: System) -> Built:
    """First derivatives of the inverse dynamics of the arm."""
    names = ["q_a", "v_a", "a_a"]
    inputs = symbols_of(system, names)
    outputs = [ca.jacobian(system.arm_left, x) for x in inputs]
    return inputs, names, outputs, ["dtau_dq", "dtau_dv", "dtau_da"]


def arm_slopes(system: System) -> Built:
    """The same as one mass matrix and one block."""
    inputs, names, (by_q, by_v, M), _ = inverse_dynamics_derivatives(system)
    return inputs, names, [M, ca.horzcat(by_q, by_v)], ["M", "R"]


def state_rate(system: System) -> Built:
    """Right-hand side of the state-space equations."""
    y, dy, _ = system.y
    x = ca.SX.sym("x", 2 * system.model.dof)
    dx = ca.substitute(ca.vertcat(dy, system.acceleration), ca.vertcat(y, dy), x)
    return [x, system.lagrangian.tau_m], ["x", "tau_m"], [dx], ["dx"]


def second_order(system: System) -> Built:
    """Mass, damping, stiffness and input matrix of the equations linearized in y."""
    y, dy, _ = system.y
    r, tau_m = system.residual, system.lagrangian.tau_m
    outputs = [system.mass, ca.jacobian(r, dy), ca.jacobian(r, y), -ca.jacobian(r, tau_m)]
    return symbols_of(system, MOTION), MOTION, outputs, ["M", "D", "K", "B"]


def jacobians_of_residual(system: System) -> ca.SX:
    """Derivatives of the residual of the equations of motion in (y, dy, tau_m)."""
    y, dy, _ = system.y
    r, tau_m = system.residual, system.lagrangian.tau_m
    return ca.horzcat(ca.jacobian(r, y), ca.jacobian(r, dy), ca.jacobian(r, tau_m))


def slopes(system: System) -> Built:
    """Derivatives of the residual of the equations of motion."""
    names = ["q_a", "v_a", "a_a", "q_m", "v_m", "tau_m", "a_m"]
    return symbols_of(system, names), names, [system.mass, jacobians_of_residual(system)], ["M", "R"]


def linearize(system: System) -> Built:
    """State and input matrix of the forward dynamics in the state x."""
    n = system.model.dof
    R = ca.substitute(jacobians_of_residual(system), system.y[2], system.acceleration)
    lower = -solve_symmetric(system.mass, R)
    upper = ca.horzcat(ca.SX.zeros(n, n), ca.SX.eye(n))
    A = ca.vertcat(upper, lower[:, : 2 * n])
    B = ca.vertcat(ca.SX.zeros(n, system.model.n_m), lower[:, 2 * n :])
    return symbols_of(system, STATE), STATE, [A, B], ["A", "B"]


BUILDERS: dict[str, Builder] = {
    "inverse_dynamics_derivatives": inverse_dynamics_derivatives,
    "arm_slopes": arm_slopes,
    "state_rate": state_rate,
    "second_order": second_order,
    "slopes": slopes,
    "linearize": linearize,
}
