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
from flexgen.model.friction import bristled_motors, hysteretic_joints, loaded_motors
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
    if hysteretic_joints(model):
        more["tau_h"] = _hysteresis(equations, motion)
    if bristled_motors(model):
        more["tau_b"] = _bristles(equations, motion)
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
    z = motion.tau_h
    if z is not None and hysteretic_joints(model):
        r_a[:, list(model.i_g)] -= z
        more = carried_along(model, between[3], z)
        r_m += more
        if loaded_motors(model):
            q_a, v_a, _, q_m, v_m, _ = between
            springs = evaluate(equations.function("gear_torque"), q_a, v_a, q_m, v_m)[0].reshape(
                n, -1
            )
            carried = carried_along(model, q_m, springs)
            law = equations.function
            r_m += friction_along(law, model, v_m, carried + more) - friction_along(
                law, model, v_m, carried
            )
    braking = motion.tau_b
    if braking is not None and bristled_motors(model):
        r_m += braking
        rigid = [j for j in range(model.n_m) if j not in model.i_m]
        r_a[:, list(model.i_g)] += braking[:, rigid] @ model.eta[rigid]
    return np.hstack([r_a, r_m[:, list(model.i_m)]])


def _hysteresis(equations: Equations, motion: Motion) -> np.ndarray:
    """Torques of the gears' hysteresis (n, n_g): those of the motion, or what its deflections make
    of it.
    """
    from flexgen.dynamics.hysteresis.hysteresis import gear_layers, torque_along

    model = equations.model
    deflection = gear_angles_along(model, motion.q_m) - motion.q_a[:, list(model.i_g)]
    return torque_along(gear_layers(model), deflection) if motion.tau_h is None else motion.tau_h


def _bristles(equations: Equations, motion: Motion) -> np.ndarray:
    """Torques of the bristles of the motors (n, n_m): those of the motion, or what its speeds make
    of it.
    """
    from flexgen.dynamics.hysteresis.lugre import bristle_torques, motor_bristles

    if motion.tau_b is not None:
        return motion.tau_b
    return bristle_torques(motor_bristles(equations.model), motion.t, motion.v_m, motion.a_m)


def _half_way(
    h: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Quintic Hermite interpolant of samples and its two derivatives at the midpoints, (n - 1,
    n_q) each.
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
