"""Samples of a motion around the reversals of motors with steep friction.

The torque of a motor with the friction ``coulomb tanh(beta v)`` steps by twice the Coulomb
friction while its speed passes from -1/beta to 1/beta: within 20 us for beta = 50 s/rad and an
acceleration of 1000 rad/s^2. A curve through samples 1 ms apart has the step at another instant
and swings around it. Here intervals are halved until

    |beta (v(t + h) - v(t))| <= TURN (1 + |beta v|)        wherever |beta v| < SATURATED,

and neighbors differ by at most a factor of two. The motion at the new samples is the quintic
Hermite interpolant that the verification uses, and the torque is the one with which the equations
of the motors hold there:

    tau_m = tau + r(tau),      r: residual of the motors, less that which the method leaves
                               between the samples

so that the samples, and the curve through them, contain the step at its instant. The samples of
the method are kept.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.base.motion.interpolation import interpolate
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.problem.motor_side import MotorMotion, gear_torques
from flexgen.model.elements import RobotModel
from flexgen.model.friction import Friction, steepness
from flexgen.simulation.verification.growth import Motion, motion_in
from flexgen.simulation.verification.residual import midpoint_residual, residual_at

if TYPE_CHECKING:
    from flexgen.paths.force.process_force import ProcessForce

# Largest change of beta v over an interval, relative to 1 + |beta v|. The poles of tanh are pi/2
# away, so that a quintic spline with knots as close has an error of 1e-6 of the step.
TURN = 0.25
# From this beta v on the friction is constant: 1 - tanh(12) = 8e-11.
SATURATED = 12.0
# Halvings of a sampling interval, at most: from 1 ms to 1 ns. What is steeper stays unresolved.
HALVINGS = 20
# New samples, at most: a motion that reverses all the time would otherwise fill the memory.
MOST = 200_000


def with_reversals(
    equations: Equations, result: MethodResult, force: ProcessForce | None = None
) -> MethodResult | None:
    """The result with samples around the reversals of motors whose friction is steep.

    None where it needs none.
    """
    slopes = _slopes(equations.model)
    t = _refine_instants(result, slopes)
    if t is None:
        return None
    return _sample_at(equations, result, t, force)


def unresolved_friction(equations: Equations, trajectory: Trajectory) -> str:
    """The friction that changes its sign where the residual is largest, as a reason; empty: none.

    Steep friction of a joint behind an elastic gear: its torque steps there, and the motor would
    have to follow within the time of the step.
    """
    model = equations.model
    limited = trajectory.meta.get("torque") == "limited"
    rows = np.abs(midpoint_residual(equations, motion_in(trajectory), limited))
    k = int(
        np.argmax((rows / np.maximum(rows.max(axis=0), 1e-300)).max(axis=1) * rows.max(axis=1))
    )
    t = trajectory.time
    near = slice(max(k - 1, 0), k + 3)
    parts = [
        (f"motor {m.name}", m.friction, trajectory["v_m"][near, j], trajectory["a_m"][near, j])
        for j, m in enumerate(model.motors)
    ]
    parts += [
        (
            f"coordinate {c.name}",
            c.dof.friction,
            trajectory["v_a"][near, i],
            trajectory["a_a"][near, i],
        )
        for i, c in enumerate(model.coordinates)
        if c.dof is not None
    ]
    for name, friction, v, a in parts:
        beta = steepness(friction)
        if not beta or v.min() * v.max() > 0 or beta * np.ptp(v) < TURN:
            continue
        width = 2.0 / (beta * max(float(np.abs(a).max()), 1e-300))
        return (
            f"the friction of {name} (beta = {friction.beta:.4g}) changes its sign within "
            f"{width:.1e} s at t = {t[k]:.4g} s, which no mesh resolves: use a smaller beta, at "
            f"most about {1.0 / max(float(np.ptp(v)), 1e-300):.2g} here, or a path without this "
            "reversal"
        )
    return ""


def _slopes(model: RobotModel) -> np.ndarray:
    """Matrix (k, n_m + n_a) from speeds to ``beta v`` of the frictions in motor torques.

    Those of the motors, and of joints with rigid gears.
    """
    rows = []
    for j, motor in enumerate(model.motors):
        rows.append(_row(model, j, motor.friction))
    for (gear, _), i in zip(gears(model), model.i_g, strict=True):
        dof = model.coordinates[i].dof
        if gear.rigid and dof is not None:
            rows.append(_row(model, model.n_m + i, dof.friction))
    given = [row for row in rows if row.any()]
    return np.array(given).reshape(len(given), model.n_m + model.n_a)


def _row(model: RobotModel, at: int, friction: Friction) -> np.ndarray:
    row = np.zeros(model.n_m + model.n_a)
    row[at] = steepness(friction)
    return row


def _refine_instants(result: MethodResult, slopes: np.ndarray) -> np.ndarray | None:
    """All instants (n,) [s] with those around the reversals; None where there are none to add.

    ``slopes``: rows that give the argument of each steep friction, beta times a speed, from motor
    and arm speeds. Intervals in which one changes too much near zero are halved.
    """
    if not len(slopes):
        return None
    t = result.t
    motors = result.motors
    channels = {
        "q_a": result.q,
        "v_a": result.v,
        "a_a": result.a,
        "q_m": motors.q_m,
        "v_m": motors.v_m,
        "a_m": motors.a_m,
    }

    def steep(instants: np.ndarray) -> np.ndarray:
        at = interpolate(t, channels, {}, instants)
        return np.hstack([at["v_m"], at["v_a"]]) @ slopes.T

    left = t[:-1]
    right = t[1:]
    added = np.zeros(0)
    for _ in range(HALVINGS):
        middle = (left + right) / 2
        ends = [steep(left), steep(middle), steep(right)]
        change = 2 * np.maximum(np.abs(ends[1] - ends[0]), np.abs(ends[2] - ends[1]))
        turns = np.min(ends, axis=0) * np.max(ends, axis=0) <= 0
        least = np.where(turns, 0.0, np.abs(ends).min(axis=0))
        split = ((change > TURN * (1 + least)) & (least < SATURATED)).any(axis=1)
        if not split.any() or len(added) + split.sum() > MOST:
            break
        added = np.concatenate([added, middle[split]])
        left = np.concatenate([left[split], middle[split]])
        right = np.concatenate([middle[split], right[split]])
    return _grade(np.union1d(t, added)) if len(added) else None


def _grade(t: np.ndarray) -> np.ndarray:
    """Instants whose neighboring intervals differ by at most a factor of two.

    The longer intervals are halved.
    """
    while True:
        h = np.diff(t)
        near = np.minimum(np.r_[np.inf, h[:-1]], np.r_[h[1:], np.inf])
        long = h > 2.5 * near
        if not long.any():
            return t
        t = np.union1d(t, (t[:-1] + t[1:])[long] / 2)


def _sample_at(
    equations: Equations, result: MethodResult, t: np.ndarray, force: ProcessForce | None
) -> MethodResult:
    """The result at the instants ``t`` [s], which contain its own, with torques such that the
    equations of the motors hold there. ``force``: on the tool.

    Motions are interpolated, and the motor torque is corrected by the residual of the motors, less
    the line through the residuals at the old samples, which are not due to friction.
    """
    old = result.t
    motors = result.motors
    channels = {
        "q_a": result.q,
        "v_a": result.v,
        "a_a": result.a,
        "q_m": motors.q_m,
        "v_m": motors.v_m,
        "a_m": motors.a_m,
        "tau_m": motors.tau_m,
        "tau_g": result.tau_g,
    }
    for name in ("tau_h", "tau_b"):
        if getattr(result, name) is not None:
            channels[name] = getattr(result, name)
    at = interpolate(old, channels, {}, t)
    own = np.searchsorted(t, old)
    for name, samples in channels.items():
        at[name][own] = samples
    memory: dict[str, Any] = {name: at.get(name) for name in ("tau_h", "tau_b")}
    pushed = None if force is None else force.at(t)
    arm = at["q_a"], at["v_a"], at["a_a"]
    motion = Motion(t, *arm, at["q_m"], at["v_m"], at["a_m"], at["tau_m"], force=pushed, **memory)
    missing = _motor_residual(equations, motion)
    # what the method leaves at its own samples is not a step of the friction
    missing = missing - make_interp_spline(old, missing[own], k=1)(t)
    missing[own] = 0.0
    tau_m = at["tau_m"] + missing
    found = MotorMotion(at["q_m"], at["v_m"], at["a_m"], tau_m)
    tau_g = gear_torques(equations, *arm, found)
    tau_g[own] = result.tau_g
    return replace(
        result,
        t=t,
        q=at["q_a"],
        v=at["v_a"],
        a=at["a_a"],
        tau_g=tau_g,
        motors=found,
        **memory,
    )


def _motor_residual(equations: Equations, motion: Motion) -> np.ndarray:
    """Torques (n, n_m) [N m] that the motors lack, for the equations in which they stand."""
    model = equations.model
    rows = residual_at(equations, motion)
    missing = np.zeros_like(motion.tau_m)
    missing[:, list(model.i_m)] = rows[:, model.n_a :]
    rigid = [j for j in range(model.n_m) if j not in model.i_m]
    if rigid:
        of_gears = rows[:, list(model.i_g)] @ np.linalg.inv(model.eta)
        missing[:, rigid] = of_gears[:, rigid]
    given = equations.function("given_torque")
    one, none = (
        evaluate(given, motion.q_m, x)[0].reshape(missing.shape)
        for x in (np.ones_like(missing), np.zeros_like(missing))
    )
    return np.asarray(missing / (one - none))
