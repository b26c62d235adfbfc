"""Arms with elastic joints: acceleration and jerk from the state, and the torque for a fourth
derivative.

    T1(q, v, a) = M a + c + g - f_a = T = spring(d),    d = eta^-1 q_m - q,
    without damping of the gears
    a = M^-1 (T - T1(q, v, 0)),    j = M^-1 (T' - T1_q v - T1_v a)
    tau = J_m eta (a + d'') + f(v_m) + eta^-T T,    d'' = (T1'' - k' d'^2) / k,    k = dT/dd

T1'' is the second derivative of T1 along (v, a, j, s), by automatic differentiation; s is the
fourth derivative of q. The damping of the gears is left out: with it the torque of a motor appears
in the third derivative, the law divides by the damping, and its internal poles -k/D are too fast
for a sampled controller.

Source: M. W. Spong, Modeling and control of elastic joint robots, ASME J. Dyn. Syst. Meas. Control
109, 1987.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.force_laws import friction_torque, spring_torque
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.dynamics.mechanics.system import Builder, Built, System, solve_symmetric
from flexgen.model.abilities import obstacle

MOTION = "flexible_joint_motion"
TORQUE = "flexible_joint_torque"


def _arm_torque(system: System) -> ca.SX:
    """T1 (n_a,): what the springs have to give, frictions and drags of the arm included."""
    return system.arm_left - system.lagrangian.arm_forces


def _springs(system: System) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """``T``, ``k``, ``k'`` and ``d'``, (n_a,) each, in the symbols of angles and speeds."""
    lag = system.lagrangian
    model = system.with_symbols
    reason = obstacle(system.model, "elastic joints")
    if reason is not None:
        raise ArgumentError(f"functions of elastic joints: {reason}")
    inverse = ca.SX(ca.DM(np.linalg.inv(model.eta)))
    deflection = ca.mtimes(inverse, lag.q_m) - lag.chain.q_a
    rate = ca.mtimes(inverse, lag.v_m) - lag.chain.v_a
    columns: list[list[ca.SX]] = []
    for k, (gear, ratio) in enumerate(gears(model)):
        assert gear.spring is not None
        d = ca.SX.sym("d")
        torque = ratio * spring_torque(gear.spring, ratio * d)
        stiffness = ca.gradient(torque, d)
        values = torque, stiffness, ca.gradient(stiffness, d)
        columns.append([ca.substitute(x, d, deflection[k]) for x in values])
    T, k, dk = (ca.vertcat(*x) for x in zip(*columns, strict=True))
    return T, k, dk, rate


def flexible_joint_motion(system: System) -> Built:
    """Acceleration and jerk of the arm from the state."""
    lag = system.lagrangian
    chain = system.lagrangian.chain
    T, k, _, rate = _springs(system)
    T1 = _arm_torque(system)
    M = ca.hessian(lag.kinetic_arm, chain.v_a)[0]
    bias = ca.substitute(T1, lag.a_a, ca.SX.zeros(system.model.n_a))
    a = solve_symmetric(M, T - bias)
    along = ca.jtimes(T1, ca.vertcat(chain.q_a, chain.v_a), ca.vertcat(chain.v_a, lag.a_a))
    j = solve_symmetric(M, k * rate - ca.substitute(along, lag.a_a, a))
    inputs = [chain.q_a, chain.v_a, lag.q_m, lag.v_m]
    return inputs, ["q_a", "v_a", "q_m", "v_m"], [a, j], ["a_a", "j_a"]


def flexible_joint_torque(system: System) -> Built:
    """Torques of the motors for a fourth derivative s of the arm coordinates.

    The arm's equations, differentiated twice, give the acceleration of the gear's deflection,
    ``(T'' - k' d'^2)/k``, and with it that of the motor: ``tau = J_m eta (a + ...) + friction +
    eta^-T T``.
    """
    lag = system.lagrangian
    chain = system.lagrangian.chain
    model = system.with_symbols
    j, s = (ca.SX.sym(name, system.model.n_a) for name in ("j_a", "s_a"))
    T, k, dk, rate = _springs(system)
    moving = ca.vertcat(chain.q_a, chain.v_a, lag.a_a)
    rates = ca.vertcat(chain.v_a, lag.a_a, j)
    first = ca.jtimes(_arm_torque(system), moving, rates)
    second = ca.jtimes(first, ca.vertcat(moving, j), ca.vertcat(rates, s))
    turning = ca.mtimes(ca.SX(ca.DM(model.eta)), lag.a_a + (second - dk * rate * rate) / k)
    carried = ca.mtimes(ca.SX(ca.DM(np.linalg.inv(model.eta).T)), T)
    tau = [
        motor.inertia * turning[i]
        + friction_torque(motor.friction, lag.v_m[i], carried[i], model.temperature)
        + carried[i]
        for i, motor in enumerate(model.motors)
    ]
    inputs = [chain.q_a, chain.v_a, lag.a_a, j, s, lag.q_m, lag.v_m]
    return inputs, ["q_a", "v_a", "a_a", "j_a", "s_a", "q_m", "v_m"], [ca.vertcat(*tau)], ["tau_m"]


BUILDERS: dict[str, Builder] = {MOTION: flexible_joint_motion, TORQUE: flexible_joint_torque}
