"""From gear torques to motors: the stable stage behind the reduced inverse dynamics.

A gear with the deflection p carries ``D p' + spring(p) = tau_g``; the motor follows from
``eta^-1 q_m = q_g + p``:

    tau_m = J_m eta (a_g + p'') + f(v_m) + eta^-T tau_g

With Fourier sums of the motor angles: `flexgen.dynamics.mechanics.motor_harmonics`.
In complete motor coupling the rotors also turn with their carriers. The torque of a gear then
depends on the accelerations of the motors that its joint turns, and these on the torques of their
own gears: the gears follow in stages, from the last joint to the first (`couple_torques`).
Without damping p is algebraic and p'' needs tau_g'' (the fourth derivative of the path); with
damping p obeys a stable first-order equation, which starts at rest, and p'' needs tau_g' only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.dynamics.mechanics.motor_harmonics import carried_along, friction_along, motor_stage
from flexgen.dynamics.mechanics.statics import gear_damping, gear_deflection
from flexgen.model.abilities import obstacle
from flexgen.model.elements import LinearSpring

# of a sampling interval: gears with a time constant D / K below it are nearly algebraic
INSTANT = 5e-3


ENDS = 8  # samples at rest before the first one, for the derivatives of a spline there


@dataclass(frozen=True)
class MotorMotion:
    """Motors at n instants: ``q_m v_m a_m tau_m`` (n, n_m), motor side."""

    q_m: np.ndarray
    v_m: np.ndarray
    a_m: np.ndarray
    tau_m: np.ndarray


def motor_motion(
    equations: Equations,
    t: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    tau_g: np.ndarray,
) -> MotorMotion:
    """Motor motion and torque.

    Parameters
    ----------
    equations : Equations
    t : array (n,) [s]
        Instants; the first one at rest.
    q, v, a : arrays (n, n_a)
        Motion of the arm.
    tau_g : array (n, n_g, 3)
        Gear torque on the arm side and its first two time derivatives [N m, N m/s, N m/s^2].
    """
    i_g = list(equations.model.i_g)
    p, dp, ddp = deflections(equations, t, tau_g)
    theta = [q[:, i_g] + p, v[:, i_g] + dp, a[:, i_g] + ddp]
    return motors_behind(equations, theta, tau_g[:, :, 0], (q, v, a))


def motors_behind(
    equations: Equations,
    theta: Sequence[np.ndarray],
    tau_g: np.ndarray,
    arm: Sequence[np.ndarray] | None = None,
) -> MotorMotion:
    """Motion and torques of motors behind gears.

    ``theta`` (3, n, n_g) [rad or m]: motor angles over the ratios, and two derivatives; ``tau_g``
    (n, n_g): torques of the gears; ``arm`` (3, n, n_a): the coordinates of the arm and two
    derivatives, for complete motor coupling. The torque of a motor is that of its rotor, its
    friction and its gear, less cogging, over its gain.
    """
    model = equations.model
    found = motor_stage(equations.function, model, theta, tau_g)
    friction = friction_along(equations.function, model, found.v_m, found.carried)
    inertia = np.array([motor.inertia for motor in model.motors])
    rotor = inertia * found.a_m
    if arm is not None and obstacle(model, "rotors in C") is None:
        coupling = equations.function("rotor_coupling")
        taken = evaluate(coupling, *arm, found.v_m, found.a_m)[1]
        rotor = rotor + taken.reshape(rotor.shape)
    tau_m = (rotor + friction + found.carried - found.cogging) / found.gain
    return MotorMotion(found.q_m, found.v_m, found.a_m, tau_m)


def couple_torques(
    equations: Equations,
    t: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    tau_g: np.ndarray,
) -> np.ndarray:
    """Torques of the gears with two derivatives (n, n_g, 3), complete motor coupling included.

    The forces of the moving rotors on the joints, ``S' J (a_m + ...)``, are added to those of
    rotors at rest in as many passes as there are stages of motors; each takes the motors of the
    pass before. Their derivatives in time are those of a spline of degree seven.

    Parameters
    ----------
    equations, t, q, v, a
        As in `motor_motion`.
    tau_g : array (n, n_g, 3)
        For rotors at rest; the result in simplified motor coupling.
    """
    model = equations.model
    if obstacle(model, "simplified coupling") is None:
        return tau_g
    from flexgen.model.inertia import rotor_stages  # here: most robots need it not

    passes = max(rotor_stages(model), default=0)
    if passes == 0:
        return tau_g
    i_g = list(model.i_g)
    coupling = equations.function("rotor_coupling")
    step = t[1] - t[0]
    wide = np.r_[t[0] - step * np.arange(ENDS, 0, -1), t]
    coupled = tau_g
    for _ in range(passes):
        _, dp, ddp = deflections(equations, t, coupled)
        v_m = (v[:, i_g] + dp) @ model.eta.T
        a_m = (a[:, i_g] + ddp) @ model.eta.T
        on_joints = evaluate(coupling, q, v, a, v_m, a_m)[0].reshape(len(t), -1)
        before = np.zeros((ENDS, model.n_g))
        smooth = make_interp_spline(wide, np.vstack([before, on_joints]), k=7)
        coupled = tau_g + np.stack([smooth(t, k) for k in range(3)], axis=-1)
    return coupled


def deflections(
    equations: Equations, t: np.ndarray, tau_g: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gear deflections p, p', p'' on the arm side, each (n, n_g) [rad or m]; zero for rigid gears.

    Elastic gears obey ``D p' + spring(p) = tau_g``; ``tau_g`` (n, n_g, 3): torque with two
    derivatives at the instants ``t`` (n,) [s]. Without damping p is static; a linear spring has a
    closed form; other springs are integrated. A damping too small for the samples is expanded
    about the static value.
    """
    from flexgen.base.numerics.gear_lag import gear_lag

    spring = equations.function("gear_law")
    D = gear_damping(equations)
    elastic = np.array([not gear.rigid for gear, _ in gears(equations.model)])
    damped = elastic & (D > 0)
    static = gear_deflection(equations, tau_g[:, :, 0])
    stiffness, curvature = _stiffness(equations, static)
    p = static.copy()
    safe = np.where(elastic, stiffness, 1.0)
    dp = np.where(elastic, tau_g[:, :, 1] / safe, 0.0)
    ddp = np.where(elastic, (tau_g[:, :, 2] - curvature * dp**2) / safe, 0.0)
    if damped.any():
        linear = damped & np.array(
            [isinstance(gear.spring, LinearSpring) for gear, _ in gears(equations.model)]
        )
        moving = static.copy()
        if (damped & ~linear).any():
            moving = _integrate_deflections(spring, np.where(damped, D, 1.0), t, tau_g, static[0])
        if linear.any():
            lag_steps = gear_lag(t, stiffness[0, linear], D[linear])
            moving[:, linear] = lag_steps.deflections(
                tau_g[:, linear].transpose(2, 0, 1), static[0, linear]
            )
        rigidity, _ = _stiffness(equations, moving)
        torque = evaluate(spring, moving)[0].reshape(moving.shape)
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = (tau_g[:, :, 0] - torque) / D
            second = (tau_g[:, :, 1] - rigidity * rate) / D
        # where D is tiny, p' and p'' would be differences of large numbers divided by it; there
        # the expansion p = p_s - (D / K) p_s' + ... about the static value p_s has an error of the
        # square of D / K
        lag = -D / safe * dp
        nearly = damped & ((D / safe).max(axis=0) < INSTANT * np.median(np.diff(t)))
        late = make_interp_spline(t, lag, k=min(5, len(t) - 1))
        slow = damped & ~nearly
        p = np.where(slow, moving, p + np.where(nearly, lag, 0.0))
        dp = np.where(slow, rate, dp + np.where(nearly, late(t, 1), 0.0))
        ddp = np.where(slow, second, ddp + np.where(nearly, late(t, 2), 0.0))
    return p, dp, ddp


def gear_torques(
    equations: Equations, q: np.ndarray, v: np.ndarray, a: np.ndarray, motors: MotorMotion
) -> np.ndarray:
    """Torques of the gears (n, n_g) [N m or N], arm side, along a motion ``q, v, a`` (n, n_a).

    Elastic gears: torque of spring and damper. Rigid gears: torque of the motor less that of its
    rotor and friction.
    """
    elastic_torque = evaluate(equations.function("gear_torque"), q, v, motors.q_m, motors.v_m)[
        0
    ].reshape(len(q), -1)
    rotor = evaluate(equations.function("rotor_torque"), q, v, a, motors.v_m, motors.a_m)[
        0
    ].reshape(len(q), -1)
    carried = carried_along(equations.model, motors.q_m, elastic_torque)
    friction = friction_along(equations.function, equations.model, motors.v_m, carried)
    given = evaluate(equations.function("given_torque"), motors.q_m, motors.tau_m)[0].reshape(
        len(q), -1
    )
    through = (given - rotor - friction) @ equations.model.eta
    rigid = np.array([gear.rigid for gear, _ in gears(equations.model)])
    return np.where(rigid, through, elastic_torque)


def _stiffness(equations: Equations, deflection: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness of the gear springs and its derivative in the deflection, each (n, n_g)."""
    spring = equations.function("gear_law")
    x = ca.SX.sym("deflection", equations.model.n_g)
    second = ca.Function("second", [x], [ca.jtimes(spring(x)[1], x, ca.SX.ones(x.shape))])
    stiffness = evaluate(spring, deflection)[1].reshape(deflection.shape)
    return stiffness, evaluate(second, deflection)[0].reshape(deflection.shape)


def _integrate_deflections(
    spring: ca.Function, D: np.ndarray, t: np.ndarray, tau_g: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """Integrate ``D p' + spring(p) = tau_g(t)`` from ``start`` (n_g,) at the first instant, by
    Radau IIA with 3 stages on each interval of ``t`` (n,) [s], with a quintic Hermite torque.

    ``D`` (n_g,) [N m s/rad]: above zero; ``tau_g`` (n, n_g, 3): torque and two derivatives.
    Returns p (n, n_g) [rad or m].
    """
    from flexgen.base.numerics.tableaus import radau

    table = radau(3)
    n, n_g = tau_g.shape[:2]
    out = np.empty((n, n_g))
    out[0] = p = start
    for k in range(n - 1):
        h = t[k + 1] - t[k]
        torque = _hermite(table.c, h, tau_g[k], tau_g[k + 1])  # (s, n_g)
        stages = np.tile(p, (3, 1))
        for _ in range(30):
            value, stiffness = (x.reshape(3, n_g) for x in evaluate(spring, stages))
            defect = stages - p - h * table.A @ ((torque - value) / D)
            matrix = np.eye(3)[None] + h * table.A[None] * (stiffness / D).T[:, None, :]
            step = np.linalg.solve(matrix, defect.T[:, :, None])[:, :, 0].T
            stages = stages - step
            if np.abs(step).max() <= 1e-15 * (1e-3 + np.abs(stages).max()):
                break
        out[k + 1] = p = stages[-1]
    return out


def _hermite(c: np.ndarray, h: float, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Quintic Hermite interpolation (s, m) at the parts ``c`` (s,), in [0, 1], of an interval of
    length ``h``; ``left``, ``right`` (m, 3): value and two derivatives at its ends.
    """
    x = c[:, None]
    y = 1 - x

    def half(u: np.ndarray, values: np.ndarray, sign: float) -> np.ndarray:
        # share of one end: its weight functions vanish to third order at the other end
        """Share of one end at the distance u (s, 1) from it, over the interval; its weight
        functions vanish to third order at the other end. ``sign``: -1 at the right end, whose u
        runs backwards.
        """
        w = (1 - u) ** 3
        return w * (
            values[:, 0] * (1 + 3 * u + 6 * u**2)
            + sign * h * values[:, 1] * (u + 3 * u**2)
            + h**2 * values[:, 2] * u**2 / 2
        )

    return half(x, left, 1.0) + half(y, right, -1.0)
