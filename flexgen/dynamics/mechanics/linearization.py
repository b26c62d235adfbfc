"""Derivatives of the equations of motion as builders of CasADi functions, from the Lagrangian.

r(y, dy, ddy, tau_m) = 0:     M = dr/dddy,   R = (dr/dy, dr/ddy, dr/dtau_m)
x = (y, dy):                  dx/dt = A x + B tau_m to first order,   lower rows: -M^-1 R
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from flexgen.base.errors import ModelError
from flexgen.dynamics.mechanics.dynamics import MOTION, STATE, symbols_of
from flexgen.dynamics.mechanics.system import Builder, Built, System, solve_symmetric
from flexgen.model.elements import RobotModel

SINGULAR = 1e-14  # least eigenvalue of a mass matrix whose diagonal is scaled to 1


def inverse_dynamics_derivatives(system: System) -> Built:
    """First derivatives of the inverse dynamics of the arm."""
    names = ["q_a", "v_a", "a_a"]
    inputs = symbols_of(system, names)
    outputs = [ca.jacobian(system.arm_left, x) for x in inputs]
    return inputs, names, outputs, ["dtau_dq", "dtau_dv", "dtau_da"]


def arm_residual_jacobians(system: System) -> Built:
    """The first derivatives of the inverse dynamics of the arm as its mass matrix and one
    block.
    """
    inputs, names, (by_q, by_v, M), _ = inverse_dynamics_derivatives(system)
    return inputs, names, [M, ca.horzcat(by_q, by_v)], ["M", "R_a"]


def state_rate(system: System) -> Built:
    """Right-hand side of the state-space equations."""
    y, dy, _ = system.y
    x = ca.SX.sym("x", 2 * system.model.dof)
    dx = ca.substitute(ca.vertcat(dy, system.acceleration), ca.vertcat(y, dy), x)
    return [x, system.lagrangian.tau_m], ["x", "tau_m"], [dx], ["dx"]


def residual_jacobians(system: System) -> Built:
    """Jacobians of the residual of the equations of motion: M in ddy, R in (y, dy, tau_m)."""
    y, dy, _ = system.y
    r = system.residual
    tau_m = system.lagrangian.tau_m
    R = ca.horzcat(ca.jacobian(r, y), ca.jacobian(r, dy), ca.jacobian(r, tau_m))
    return symbols_of(system, MOTION), MOTION, [system.mass, R], ["M_y", "R_y"]


def second_order_matrices(
    M: np.ndarray, R: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Matrices of the linearized equations of motion ``M ddy + D dy + K y = B tau_m``.

    Parameters
    ----------
    M : array (..., n, n)
        Of `residual_jacobians`; an axis of length one at its end may be missing.
    R : array (..., n, 2 n + n_m)
        Of `residual_jacobians`.

    Returns
    -------
    M, D, K : arrays (..., n, n)
    B : array (..., n, n_m)
    """
    n = R.shape[-2]
    # (no zeros with a sign)
    return M.reshape(*R.shape[:-1], n), R[..., n : 2 * n], R[..., :n], 0.0 - R[..., 2 * n :]


def check_inertia(model: RobotModel, M: np.ndarray) -> None:
    """ModelError where a mass matrix (..., n, n) is singular, which names a coordinate that moves
    no inertia.
    """
    size = np.sqrt(np.abs(np.einsum("...ii->...i", M)))
    size = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(M / size[..., :, None] / size[..., None, :])
    if values[..., 0].min() > SINGULAR:
        return
    worst = vectors[np.unravel_index(values[..., 0].argmin(), values.shape[:-1])][:, 0]
    element, name = [
        *((f"element.{c.element}", c.name) for c in model.coordinates),
        *((f"motor.{model.motors[j].name}", model.motors[j].name) for j in model.i_m),
    ][int(np.abs(worst).argmax())]
    raise ModelError(
        model.file,
        0,
        element,
        f"a robot whose inertia matrix is singular: {name} moves no inertia of its own",
        "mass or moments of inertia behind each coordinate, and no two coordinates about the "
        "same line at one place",
    )


def linearize(system: System) -> Built:
    """State and input matrix of the forward dynamics in the state x."""
    n = system.model.dof
    M, R = residual_jacobians(system)[2]
    lower = -solve_symmetric(M, ca.substitute(R, system.y[2], system.acceleration))
    upper = ca.horzcat(ca.SX.zeros(n, n), ca.SX.eye(n))
    A = ca.vertcat(upper, lower[:, : 2 * n])
    B = ca.vertcat(ca.SX.zeros(n, system.model.n_m), lower[:, 2 * n :])
    return symbols_of(system, STATE), STATE, [A, B], ["A", "B"]


BUILDERS: dict[str, Builder] = {
    "inverse_dynamics_derivatives": inverse_dynamics_derivatives,
    "arm_residual_jacobians": arm_residual_jacobians,
    "state_rate": state_rate,
    "residual_jacobians": residual_jacobians,
    "linearize": linearize,
}
