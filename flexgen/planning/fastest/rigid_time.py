"""Minimum time of a rigid robot along a path with discontinuous torques: a lower bound of the
duration.

With s the path parameter, x its squared speed and u its acceleration, the motor torques are linear
in both,

    tau_m = a(s) u + b(s) x + g(s),        |tau_m| <= tau_max,   |v_m| = |q_m'| sqrt(x) <= v_max

On a grid of s, the largest squared speed from which the path can be finished is found from the end
backwards, then the fastest motion forwards. Frictions are left out, so that the time is a lower
bound where they oppose the motion.

Source: H. Pham, Q.-C. Pham, IEEE Trans. Robotics 34(3), 2018.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np

from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.paths.force.process_force import ProcessForce
from flexgen.paths.path import Path
from flexgen.paths.timing.joint_limits import InverseKinematics
from flexgen.paths.timing.time_laws import Clock

INTERVALS = 400


def rigid_time(
    path: Path, torque: np.ndarray, speed: np.ndarray, force: ProcessForce | None = None
) -> float:
    """The shortest time [s] within torques and speeds of the motors (n_m,); NaN where one cannot
    hold the robot.

    ``force``: on the tool over the place on the path.
    """
    model = path.equations.model
    equations = path.equations
    segment = path.segments[0]
    length = float(segment.law(np.array([1e9]), 0)[0, 0])
    by_length = copy.copy(path)
    by_length.segments = (replace(segment, law=Clock(length, 5)),)
    by_length.duration = length
    s = length * np.linspace(0.0, 1.0, INTERVALS + 1)
    inside = np.clip(s, 1e-9 * length, (1 - 1e-9) * length)
    q, dq, ddq = joint_motion(by_length, inside)
    i_g = list(model.i_g)
    arm = [np.zeros((len(s), model.n_a)) for _ in range(3)]
    for full, own in zip(arm, (q, dq, ddq), strict=True):
        full[:, i_g] = own
    function = equations.function("inverse_dynamics")

    def torques(v: np.ndarray, a: np.ndarray) -> np.ndarray:
        return np.asarray(evaluate(function, arm[0], v, a)[0].reshape(len(s), -1)[:, i_g])

    none = np.zeros_like(arm[0])
    g = torques(none, none)
    a = torques(none, arm[1]) - g
    b = torques(arm[1], arm[2]) - g
    if force is not None:
        J = evaluate(equations.function("jacobian"), arm[0])[0].reshape(len(s), 6, model.n_a)
        g = g - np.einsum("kij,ki->kj", J, force.at(s / length))[:, i_g]
    inertia = np.array([m.inertia for m in model.motors])
    to_motor = np.linalg.inv(model.eta)  # tau_m = eta^-T tau_g + J_m a_m
    a, b, g = (x @ to_motor for x in (a, b, g))
    a = a + dq @ model.eta.T * inertia
    b = b + ddq @ model.eta.T * inertia
    with np.errstate(divide="ignore"):
        top = np.min(
            np.where(np.isfinite(speed), (speed / np.abs(dq @ model.eta.T)) ** 2, np.inf), axis=1
        )
    return shortest_time(s, a, b, g, torque, top)


def joint_motion(path: Path, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Actuated coordinates of the undeflected arm at the path parameters ``s`` (k,) and their
    first two derivatives in it, (k, n_g) each.

    Of a joint move they are known; else by inverse kinematics and ``W dq = y'``, ``W ddq = y'' -
    W' dq``.
    """
    sample = path.sample(s)
    if sample.q_g is not None:
        return sample.q_g[:, :, 0], sample.q_g[:, :, 1], sample.q_g[:, :, 2]
    q = InverseKinematics(path.equations).follow(
        sample, path.q_start[list(path.equations.model.i_g)]
    )
    equations = path.equations
    model = path.equations.model
    i_g = list(path.equations.model.i_g)
    constraint = equations.function("output_constraint")
    full = np.zeros((len(s), model.n_a))
    full[:, i_g] = q
    target = np.zeros((len(s), constraint.size_in(2)[0]))
    W = evaluate(constraint, full, np.zeros_like(full), target)[1].reshape(len(s), -1, model.n_a)[
        :, :, i_g
    ]
    dq = np.linalg.solve(W, sample.derivative(1)[:, :, None])[:, :, 0]
    moving = np.zeros_like(full)
    moving[:, i_g] = dq
    bias = evaluate(constraint, full, moving, target)[2].reshape(len(s), -1)
    return q, dq, np.linalg.solve(W, (sample.derivative(2) - bias)[:, :, None])[:, :, 0]


def shortest_time(
    s: np.ndarray, a: np.ndarray, b: np.ndarray, g: np.ndarray, torque: np.ndarray, top: np.ndarray
) -> float:
    """The shortest time [s] from rest to rest on the grid ``s`` (k,); NaN where a point cannot be
    passed.

    Torques are ``a u + b x + g`` (k, n_m) with the squared speed x = ds^2 and u = dds; ``torque``
    (n_m,): their limits, ``top`` (k,): largest x. A pass back finds the x from which the end can
    be reached, a pass forward takes the largest.
    """
    h = np.diff(s)
    n = len(s)
    ceiling = np.empty(n)
    ceiling[-1] = 0.0
    for k in range(n - 2, -1, -1):  # the largest speed from which the next set can be reached
        found = largest_squared_speed(a[k], b[k], g[k], torque, top[k], h[k], ceiling[k + 1])
        if found is None:
            return float("nan")
        ceiling[k] = found
    x = np.zeros(n)
    for k in range(n - 1):
        x[k + 1] = min(next_squared_speed(a[k], b[k], g[k], torque, x[k], h[k]), ceiling[k + 1])
    speeds = np.sqrt(np.maximum(x, 0.0))
    total = speeds[:-1] + speeds[1:]
    if np.any(total <= 0):
        raise SolverError(
            "fastest: the rigid robot cannot leave a point of the path within the limits"
        )
    return float((2 * h / total).sum())


def largest_squared_speed(
    a: np.ndarray,
    b: np.ndarray,
    g: np.ndarray,
    torque: np.ndarray,
    top: float,
    h: float,
    after: float,
) -> float | None:
    """Largest x >= 0 with some u: |a u + b x + g| <= torque, 0 <= x + 2 h u <= after; None where
    there is none.

    ``top``: a bound of x; ``h``: to the next point of the grid; ``after``: largest squared speed
    there.
    """
    # Rows p u + q x <= r; the largest x is at a corner of two of them, or bounded by `top`.
    p = np.concatenate([a, -a, [2 * h, -2 * h, 0.0]])
    q = np.concatenate([b, -b, [1.0, -1.0, 1.0]])
    r = np.concatenate([torque - g, torque + g, [after, 0.0, min(top, 1e12)]])
    keep = np.isfinite(r)
    p = p[keep]
    q = q[keep]
    r = r[keep]
    best: float | None = None
    for i in range(len(p)):
        det = p[i] * q - q[i] * p
        with np.errstate(divide="ignore", invalid="ignore"):
            x = (p[i] * r - r[i] * p) / det
            u = (r[i] * q - q[i] * r) / det
        good = np.isfinite(x) & np.isfinite(u) & (x >= -1e-12)
        if not good.any():
            continue
        slack = r[None] - np.outer(u[good], p) - np.outer(x[good], q)
        scale = np.abs(r)[None] + np.abs(np.outer(u[good], p)) + np.abs(np.outer(x[good], q))
        feasible = x[good][(slack >= -1e-9 * scale).all(axis=1)]
        if len(feasible):
            best = max(float(feasible.max()), 0.0 if best is None else best)
    return best


def next_squared_speed(
    a: np.ndarray, b: np.ndarray, g: np.ndarray, torque: np.ndarray, x: float, h: float
) -> float:
    """Largest squared speed at the next point, ``h`` away, from the squared speed x within |a u +
    b x + g| <= torque; 0 at least.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        high = np.where(
            a > 0, (torque - g - b * x) / a, np.where(a < 0, (-torque - g - b * x) / a, np.inf)
        )
    return max(x + 2 * h * float(high.min()), 0.0)
