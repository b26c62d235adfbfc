"""Equations of motion of robots whose gears have hysteresis, or motors bristles, with their
torques as states.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexgen.dynamics.hysteresis.hysteresis import gear_layers
from flexgen.dynamics.hysteresis.lugre import bristle_rates, motor_bristles
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.force_laws import friction_torque
from flexgen.dynamics.mechanics.motor_harmonics import gear_rates
from flexgen.model.elements import RobotModel


def generalized_force(model: RobotModel, z: ca.SX, q_m: ca.SX) -> ca.SX:
    """Forces on y = (q_a, q_me) (n,) of additional gear torques ``z`` (n_g,) [N m]; ``q_m``
    (n_m,): motor angles.
    """
    forces = ca.SX.zeros(model.dof)
    on_motors = ca.mtimes(gear_rates(model, q_m).T, z)
    for k, i in enumerate(model.i_g):
        forces[i] += z[k]
    for k, j in enumerate(model.i_m):
        forces[model.n_a + k] -= on_motors[j]
    return forces


def friction_changes(equations: Equations, z: ca.SX) -> ca.SX:
    """Changes of the friction torques (n_m,) [N m] by additional gear torques ``z`` (n_g,), part
    of the load.
    """
    model = equations.with_symbols
    lag = equations.lagrangian
    changes = ca.SX.zeros(equations.model.n_m)
    on_motors = ca.mtimes(gear_rates(model, lag.q_m).T, z)
    for j, motor in enumerate(model.motors):
        if motor.friction.loaded:
            loads = lag.tau_gm[j] + on_motors[j], lag.tau_gm[j]
            more, less = (
                friction_torque(motor.friction, lag.v_m[j], load, model.temperature)
                for load in loads
            )
            changes[j] = more - less
    return changes


def deflection_rates(equations: Equations) -> ca.SX:
    """Rates d' (n_g,) of the deflections of all gears, arm side [rad/s]."""
    model = equations.model
    lag = equations.lagrangian
    rates = gear_rates(equations.with_symbols, lag.q_m)
    return ca.mtimes(rates, motor_speeds(equations)) - lag.chain.v_a[list(model.i_g)]


def motor_force(model: RobotModel, tau: ca.SX) -> ca.SX:
    """Forces on y = (q_a, q_me) (n,) of torques ``tau`` (n_m,) on the rotors [N m]."""
    forces = ca.SX.zeros(model.dof)
    for k, j in enumerate(model.i_m):
        forces[model.n_a + k] += tau[j]
    for j in set(range(model.n_m)) - set(model.i_m):
        for k, i in enumerate(model.i_g):
            forces[i] += float(model.eta[j, k]) * tau[j]
    return forces


def motor_speeds(equations: Equations) -> ca.SX:
    """Speeds (n_m) of all motors; those behind rigid gears follow their joints."""
    model = equations.model
    lag = equations.lagrangian
    geared = ca.mtimes(ca.SX(ca.DM(model.eta)), lag.chain.v_a[list(model.i_g)])
    return ca.vertcat(*[lag.v_m[j] if j in model.i_m else geared[j] for j in range(model.n_m)])


def slip_torques(model: RobotModel) -> np.ndarray:
    """Torques at which the states of `hysteretic_rate` slip [N m]."""
    slips = np.concatenate([layer.slip for layer in gear_layers(model)])
    return np.concatenate([x for x in (slips, motor_bristles(model).static) if x.any()])


@dataclass(frozen=True)
class Memory:
    """Torques with states in addition to the equations of motion, expressions in the symbols of
    the Lagrangian.

    ``z``: torques of the layers of all gears, n_g each, where one has hysteresis, then torques s0
    z of the bristles of all motors (n_m) where one has them; ``forces`` (n,) on y; ``rates`` of z;
    ``taken``: power that they take up [W].
    """

    z: ca.SX
    forces: ca.SX
    rates: ca.SX
    taken: ca.SX


def memory_of(equations: Equations) -> Memory:
    """The torques with states of a model, their rates, the forces that they exert, and the power
    that they take.

    The states z are the torques of the layers of all gears, then those of the bristles of motors.
    A gear pulls with the sum of its layers on arm and motor; friction that depends on the load
    changes with it.
    """
    model = equations.model
    lag = equations.lagrangian
    layers = gear_layers(model)
    motors = motor_bristles(model)
    rates = []
    taken = ca.SX(0)
    z = ca.SX.sym("z", len(slip_torques(model)))
    forces = ca.SX.zeros(model.dof)
    if any(layer.present.any() for layer in layers):
        parts = ca.vertsplit(z[: len(layers) * model.n_g], model.n_g)
        rate = deflection_rates(equations)
        z_g = sum(parts[1:], parts[0])
        braked = friction_changes(equations, z_g)
        forces += generalized_force(model, z_g, lag.q_m) - motor_force(model, braked)
        for layer, part in zip(layers, parts, strict=True):
            rates.append(ca.DM(layer.stiffness) * layer.rates(rate, part, layer.divisor))
        taken += ca.dot(z_g, rate) + ca.dot(braked, lag.v_m)
    if motors.present.any():
        v_m = motor_speeds(equations)
        dz, braking = bristle_rates(motors, v_m, z[z.numel() - model.n_m :])
        forces -= motor_force(model, braking)
        rates.append(dz)
        taken += ca.dot(braking, v_m)
    return Memory(z, forces, ca.vertcat(*rates), taken)


def hysteretic_rate(equations: Equations) -> tuple[list[ca.SX], list[ca.SX]]:
    """Rates of the motion, and of torques of hysteresis and bristles, for the definition's
    equations of motion.

    Returns
    -------
    inputs : list
        State (q_a, q_me, v_a, v_me) (2 n); ``z`` of `Memory`; motor torques (n_m); then the force
        on the tool (6,) where the equations have one.
    outputs : list
        Rate of the state (2 n), of the torques, and the power that goes into hysteresis and
        bristles [W].
    """
    lag = equations.lagrangian
    (y, dy, _) = equations.y
    made = memory_of(equations)
    acceleration = equations.acceleration_under(made.forces)
    x = ca.SX.sym("x", 2 * equations.model.dof)
    outputs = ca.substitute(
        [ca.vertcat(dy, acceleration), made.rates, made.taken], [ca.vertcat(y, dy)], [x]
    )
    return [x, made.z, lag.tau_m, *([] if equations.force is None else [equations.force])], outputs
