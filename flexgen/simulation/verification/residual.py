"""Residual of the equations of motion between the samples of a trajectory."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexgen.base.motion.torque_curve import spline, torque_curve
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.motor_harmonics import (
    carried_along,
    friction_along,
    gear_angles_along,
)
from flexgen.model.friction import memory_laws
from flexgen.simulation.verification.growth import Motion


def midpoint_residual(equations: Equations, motion: Motion, limited: bool = False) -> np.ndarray:
    """Residual of each equation of motion at the midpoints between the samples, (n - 1, dof) [N m
    or N].

    Motion by quintic Hermite interpolation of each channel with its speed and acceleration, torque
    as in `simulate`, independent of the solvers. Columns: arm coordinates, then the motors behind
    elastic gears.
    """
    t = motion.t
    model = equations.model
    middle = (t[:-1] + t[1:]) / 2
    h = np.diff(t)[:, None]
    parts = (motion.q_a, motion.v_a, motion.a_a), (motion.q_m, motion.v_m, motion.a_m)
    between = [x for part in parts for x in _half_way(h, *part)]
    more: dict[str, Any] = {"force": motion.force}
    for law in memory_laws(model):
        channel, torques = STATES[law.key]
        more[channel] = torques(equations, motion)
    more = {name: None if x is None else spline(t, x)(middle) for name, x in more.items()}
    tau = torque_curve(t, motion.tau_m, limited=limited)(middle)
    q_a, v_a, a_a, q_m, v_m, a_m = between
    return residual_at(equations, Motion(middle, q_a, v_a, a_a, q_m, v_m, a_m, tau, **more))


def residual_at(equations: Equations, motion: Motion) -> np.ndarray:
    """Residual of each equation of motion at the samples of a motion, (n, dof) [N m or N].

    Columns: arm coordinates, then the motors behind elastic gears.
    """
    between = [motion.q_a, motion.v_a, motion.a_a, motion.q_m, motion.v_m, motion.a_m]
    tau = motion.tau_m
    if motion.force is not None:
        r_a, r_m = evaluate(equations.pushed.function("residual"), *between, tau, motion.force)
    else:
        r_a, r_m = evaluate(equations.function("residual"), *between, tau)
    n = len(motion.t)
    model = equations.model
    r_a = r_a.reshape(n, -1)
    r_m = r_m.reshape(n, -1)
    for law in memory_laws(model):
        of_arm, of_motors = ACTING[law.key](equations, motion)
        r_a[:, list(model.i_g)] += of_arm
        r_m += of_motors
    return np.hstack([r_a, r_m[:, list(model.i_m)]])


def _hysteresis(equations: Equations, motion: Motion) -> np.ndarray:
    """Hysteresis torques of the gears along a motion (n, n_g) [N m or N].

    Those of the motion where it has them, else those that the hysteresis law gives along the gear
    deflections [rad or m].
    """
    from flexgen.dynamics.hysteresis.hysteresis import gear_layers, torque_along

    if motion.tau_h is not None:
        return motion.tau_h
    model = equations.model
    deflection = gear_angles_along(model, motion.q_m) - motion.q_a[:, list(model.i_g)]
    return torque_along(gear_layers(model), deflection)


def _bristles(equations: Equations, motion: Motion) -> np.ndarray:
    """LuGre friction torques of the motors along a motion (n, n_m) [N m].

    Those of the motion where it has them, else those that the law gives along the motor speeds.
    """
    from flexgen.dynamics.hysteresis.lugre import bristle_torques, motor_bristles

    if motion.tau_b is not None:
        return motion.tau_b
    return bristle_torques(motor_bristles(equations.model), motion.t, motion.v_m, motion.a_m)


def _acting_hysteresis(equations: Equations, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Contribution of hysteresis torques to the residuals of actuated coordinates (k, n_g) and
    motors (k, n_m) [N m]; friction that depends on the load changes with them. Zeros without
    hysteresis.
    """
    z = motion.tau_h
    model = equations.model
    if z is None:
        return np.zeros(model.n_g), np.zeros(model.n_m)
    more = carried_along(model, motion.q_m, z)
    springs = evaluate(
        equations.function("gear_torque"), motion.q_a, motion.v_a, motion.q_m, motion.v_m
    )[0].reshape(z.shape)
    # friction depends on these torques where it depends on the load; else the difference is zero
    carried = carried_along(model, motion.q_m, springs)
    law = equations.function
    friction = [friction_along(law, model, motion.v_m, x) for x in (carried + more, carried)]
    return -z, more + friction[0] - friction[1]


def _acting_bristles(equations: Equations, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Contribution of bristle torques to the residuals of actuated coordinates and motors."""
    braking = motion.tau_b
    model = equations.model
    if braking is None:
        return np.zeros(model.n_g), np.zeros(model.n_m)
    rigid = [j for j in range(model.n_m) if j not in model.i_m]
    return braking[:, rigid] @ model.eta[rigid], braking


def _half_way(
    h: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Quintic Hermite interpolant of samples q, v, a (n, n_q) and its two derivatives at the
    midpoints of intervals of length h (n - 1, 1) [s], (n - 1, n_q) each.
    """
    q0 = q[:-1]
    q1 = q[1:]
    v0 = v[:-1]
    v1 = v[1:]
    a0 = a[:-1]
    a1 = a[1:]
    return (
        (q0 + q1) / 2 + 5 * h / 32 * (v0 - v1) + h**2 / 64 * (a0 + a1),
        15 / 8 * (q1 - q0) / h - 7 / 16 * (v0 + v1) + h / 32 * (a1 - a0),
        3 / 2 * (v1 - v0) / h - (a0 + a1) / 4,
    )


# By the key of a law with a state: the channel of its torques, and their values along a motion.
STATES = {"hysteresis": ("tau_h", _hysteresis), "lugre": ("tau_b", _bristles)}
# What these torques add to the residual of the arm and of the motors.
ACTING = {"hysteresis": _acting_hysteresis, "lugre": _acting_bristles}
