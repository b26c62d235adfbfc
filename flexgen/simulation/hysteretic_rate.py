"""Equations of motion of robots whose gears have hysteresis, with the torques of the gears as states."""

from __future__ import annotations

import casadi as ca
import numpy as np

from flexgen.mechanics.equations import Equations
from flexgen.mechanics.hysteresis import gear_hysteresis
from flexgen.mechanics.motor_harmonics import gear_rates
from flexgen.model.elements import RobotModel


def generalized_force(model: RobotModel, z: ca.SX, q_m: ca.SX) -> ca.SX:
    """Forces on y = (q_a, q_me) (n,) of additional gear torques ``z`` (n_g,) [N m]; ``q_m`` (n_m,): motor angles."""
    forces = ca.SX.zeros(model.dof)
    on_motors = ca.mtimes(gear_rates(model, q_m).T, z)
    for k, i in enumerate(model.i_g):
        forces[i] += z[k]
    for k, j in enumerate(model.i_m):
        forces[model.n_a + k] -= on_motors[j]
    return forces


def deflection_rates(equations: Equations) -> ca.SX:
    """Rates d' (n_g,) of the deflections of all gears, arm side [rad/s]."""
    model, lag = equations.model, equations.lagrangian
    i_g = list(model.i_g)
    geared = ca.mtimes(ca.SX(ca.DM(model.eta)), lag.chain.v_a[i_g])
    v_m = ca.vertcat(*[lag.v_m[j] if j in model.i_m else geared[j] for j in range(model.n_m)])
    return ca.mtimes(gear_rates(equations.with_symbols, lag.q_m), v_m) - lag.chain.v_a[i_g]


def hysteretic_rate(equations: Equations) -> tuple[list[ca.SX], list[ca.SX]]:
    """Rates of the motion and of the hysteresis, for the definition's equations of motion.

    Returns
    -------
    inputs : list
        State (q_a, q_me, v_a, v_me) (2 n), torques z of all gears (n_g), motor torques (n_m); then the force on the
        tool (6,) where the equations have one.
    outputs : list
        Rate of the state (2 n), of z (n_g), and the power that goes into the hysteresis [W].
    """
    model, lag, (y, dy, _) = equations.model, equations.lagrangian, equations.y
    law, z = gear_hysteresis(model), ca.SX.sym("z", model.n_g)
    acceleration = equations.acceleration_under(generalized_force(model, z, lag.q_m))
    rate = deflection_rates(equations)
    slip = np.where(law.present, law.slip, 1.0)
    dz = ca.DM(law.stiffness) * (rate - ca.fabs(rate) * z / ca.DM(slip))
    x = ca.SX.sym("x", 2 * model.dof)
    outputs = ca.substitute([ca.vertcat(dy, acceleration), dz, ca.dot(z, rate)], [ca.vertcat(y, dy)], [x])
    return [x, z, lag.tau_m, *([] if equations.force is None else [equations.force])], outputs
