"""Transmission error of gears, cogging and torque ripple of motors: Fourier sums of the motor
angle.

    d = (eta^-1 q_m)_k - e_k(q_m) - q_g
    deflection of a gear, e_k: its transmission error at the joint
    J_m a_m + f(v_m) + (eta^-1 - e')' tau_g = tau_m (1 + r(q_m)) + c(q_m)

The gear torque acts on the motor by the factor with which its speed deflects the gear, so that the
springs store what the motor gives. The motor angle q_m behind a gear with the angle w = n (q_g +
d) follows from ``q_m - n e(q_m) = w``; for ``|n e'| < 1/2`` a fixed number of steps gives it to
rounding:

    v_m = w'/(1 - n e'),    a_m = (w'' + n e'' v_m^2)/(1 - n e')
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import casadi as ca
import numpy as np

from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.fourier import STEEPEST, FourierSum
from flexgen.model.elements import RobotModel
from flexgen.model.friction import loaded_motors

T = TypeVar("T", np.ndarray, ca.SX)

SOLVED = 1e-17  # rad: error of a motor angle after its last step, by its bound


def fourier_sum(given: FourierSum, q: ca.SX, orders: int = 1) -> list[ca.SX]:
    """The sum ``sum_k c_k cos(k q) + s_k sin(k q)`` at the angle ``q`` [rad], and its derivatives
    in q, ``orders`` expressions in all.
    """
    turned = {1: (ca.cos(q), ca.sin(q))}

    def turn(k: int) -> tuple[ca.SX, ca.SX]:  # cosine and sine of k q, from those of half of it
        """Cosine and sine of k q from those of two halves of k, by the addition theorem; each
        once.
        """
        if k not in turned:
            (a, b) = turn(k // 2)
            (c, s) = turn(k - k // 2)
            turned[k] = (a * c - b * s, b * c + a * s)
        return turned[k]

    terms = [
        (k, c, s, *turn(k)) for k, c, s in zip(given.harmonics, given.cos, given.sin, strict=True)
    ]
    out = []
    for order in range(orders):
        parts = [
            ((c * x + s * y), (s * x - c * y))[order % 2] * k**order for k, c, s, x, y in terms
        ]
        out.append((1, 1, -1, -1)[order % 4] * sum(parts, ca.SX(0)))
    return out


def fourier_integral(given: FourierSum, q: ca.SX) -> ca.SX:
    """The integral of the sum from any fixed angle to ``q``."""
    cos = tuple(-s / k for k, s in zip(given.harmonics, given.sin, strict=True))
    sin = tuple(c / k for k, c in zip(given.harmonics, given.cos, strict=True))
    return fourier_sum(FourierSum(given.harmonics, cos, sin), q)[0]


def transmission_errors(model: RobotModel) -> dict[int, tuple[int, FourierSum]]:
    """Gears with a transmission error: index of the gear -> index of its motor, the error [rad or
    m at the joint].
    """
    out = {}
    for k, i in enumerate(model.i_g):
        dof = model.coordinates[i].dof
        assert dof is not None and dof.gear is not None  # what makes a coordinate actuated
        if dof.gear.transmission_error is not None:
            out[k] = (
                next(j for j, m in enumerate(model.motors) if m.drives == (dof.name,)),
                dof.gear.transmission_error,
            )
    return out


def highest_harmonics(model: RobotModel) -> np.ndarray:
    """The highest harmonic of each motor's angle (n_m,), 0 where it has none."""
    out = np.zeros(model.n_m)
    sums = [
        (j, each)
        for j, motor in enumerate(model.motors)
        for each in (motor.cogging, motor.torque_ripple)
    ]
    for j, given in (*sums, *transmission_errors(model).values()):
        if given is not None:
            out[j] = max(out[j], *given.harmonics)
    return out


def gear_rates(model: RobotModel, q_m: ca.SX) -> ca.SX:
    """Matrix (n_g, n_m) from the motor speeds to the speeds of the gears' arm sides,
    ``eta^-1 - e'(q_m)``.
    """
    rates = ca.SX(ca.DM(np.linalg.inv(model.eta)))
    for k, (j, error) in transmission_errors(model).items():
        rates[k, j] -= fourier_sum(error, q_m[j], 2)[1]
    return rates


def gear_angles(model: RobotModel, q_m: ca.SX) -> ca.SX:
    """Angles of the gears' arm sides (n_g,) without deflection, ``eta^-1 q_m - e(q_m)`` [rad or
    m].
    """
    angles = ca.mtimes(ca.SX(ca.DM(np.linalg.inv(model.eta))), q_m)
    for k, (j, error) in transmission_errors(model).items():
        angles[k] -= fourier_sum(error, q_m[j])[0]
    return angles


def given_torques(model: RobotModel, q_m: ca.SX, tau_m: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Torques that the motors give (n_m,), with their ripple ``tau (1 + sum)``, cogging torques
    (n_m,) [N m], and the energy of the cogging [J], at motor angles ``q_m`` (n_m,) [rad].
    """
    given = []
    cogging = []
    stored = ca.SX(0)
    for j, motor in enumerate(model.motors):
        ripple = motor.torque_ripple
        pull = motor.cogging
        given.append(
            tau_m[j] if ripple is None else tau_m[j] * (1 + fourier_sum(ripple, q_m[j])[0])
        )
        cogging.append(ca.SX(0) if pull is None else fourier_sum(pull, q_m[j])[0])
        if pull is not None:
            stored = stored - fourier_integral(pull, q_m[j])
    return ca.vertcat(ca.SX(0, 1), *given), ca.vertcat(ca.SX(0, 1), *cogging), stored


def _steps(error: FourierSum, ratio: float) -> tuple[int, int]:
    """Number of steps of fixed-point iteration, then of Newton's method, after which the motor
    angle of a gear with a transmission error is solved to rounding.

    By bounds of the error, its slope and its curvature times the ``ratio``; of an error with
    run-time parameters for all that are less steep than `STEEPEST`.
    """
    if any(isinstance(x, ca.SX) for x in (*error.cos, *error.sin)):
        size = STEEPEST / min(error.harmonics)
        slope = STEEPEST
        bend = STEEPEST * max(error.harmonics)
    else:
        size, slope, bend = (abs(ratio) * error.bound(order) for order in range(3))
    curvature = bend / (2 * (1 - slope))
    fixed = 1
    newton = 0
    left = size * slope
    while curvature * left > 0.5:
        left = left * slope
        fixed = fixed + 1
    while left > SOLVED:
        left = curvature * left**2
        newton = newton + 1
    return fixed, newton


def motors_of_gears(
    model: RobotModel, w: ca.SX, dw: ca.SX, ddw: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Motor angles, speeds and accelerations, and the parts ``1 - n e'`` of the gear torques that
    the motors carry.

    ``w`` (n_m,): motor angles of gears without transmission error, ``eta (q_g + d)``, and two
    derivatives.
    """
    q = ca.SX(w)
    v = ca.SX(dw)
    a = ca.SX(ddw)
    share = ca.SX.ones(model.n_m)
    for k, (j, error) in transmission_errors(model).items():
        ratio = float(model.eta[j, k])
        fixed, newton = _steps(error, ratio)
        for step in range(fixed + newton):
            value, slope = fourier_sum(error, q[j], 2)
            q[j] = (
                w[j] + ratio * value
                if step < fixed
                else q[j] - (q[j] - ratio * value - w[j]) / (1 - ratio * slope)
            )
        _, slope, bend = fourier_sum(error, q[j], 3)
        share[j] = 1 - ratio * slope
        v[j] = dw[j] / share[j]
        a[j] = (ddw[j] + ratio * bend * v[j] ** 2) / share[j]
    return q, v, a, share


def gear_angles_along(model: RobotModel, q_m: np.ndarray) -> np.ndarray:
    """`gear_angles` of motor angles (n, n_m), (n, n_g)."""
    if not transmission_errors(model):
        return np.asarray(q_m @ np.linalg.inv(model.eta).T)
    symbol = ca.SX.sym("q_m", model.n_m)
    function = ca.Function("gear_angles", [symbol], [ca.densify(gear_angles(model, symbol))])
    return evaluate(function, q_m)[0].reshape(len(q_m), -1)


def carried_along(model: RobotModel, q_m: np.ndarray, tau_g: np.ndarray) -> np.ndarray:
    """Torques of the gears on the motor side (n, n_m), from the motor angles (n, n_m) and the arm
    side (n, n_g).
    """
    if not transmission_errors(model):
        return np.asarray(tau_g @ np.linalg.inv(model.eta))
    angles = ca.SX.sym("q_m", model.n_m)
    torques = ca.SX.sym("tau_g", model.n_g)
    carried = ca.densify(ca.mtimes(gear_rates(model, angles).T, torques))
    return evaluate(ca.Function("carried", [angles, torques], [carried]), q_m, tau_g)[0].reshape(
        len(q_m), -1
    )


@dataclass(frozen=True)
class MotorStage:
    """Motors behind gears at n instants, (n, n_m) each: their motion, and what their torques
    follow from.

    ``tau_m = (J_m a_m + f(v_m) + carried - cogging) / gain``, ``carried``: torques of the gears,
    motor side.
    """

    q_m: np.ndarray
    v_m: np.ndarray
    a_m: np.ndarray
    carried: np.ndarray
    cogging: np.ndarray | float = 0.0
    gain: np.ndarray | float = 1.0


def motor_stage(
    function: Callable[[str], ca.Function],
    model: RobotModel,
    theta: Sequence[np.ndarray],
    tau_g: np.ndarray,
) -> MotorStage:
    """Motors behind gears, whose angles over the ratios and two derivatives are ``theta`` (3, n,
    n_g).

    ``function``: `Equations.function` of the model; ``tau_g`` (n, n_g): torques of the gears, arm
    side.
    """
    w, dw, ddw = (x @ model.eta.T for x in theta)
    carried = np.linalg.solve(model.eta.T, tau_g.T).T
    if not highest_harmonics(model).any():
        return MotorStage(w, dw, ddw, carried)
    found = evaluate(function("motor_harmonics"), w, dw, ddw)
    q_m, v_m, a_m, share, cogging, gain = (x.reshape(carried.shape) for x in found)
    return MotorStage(q_m, v_m, a_m, share * carried, cogging, gain)


def friction_along(
    function: Callable[[str], ca.Function], model: RobotModel, v_m: np.ndarray, carried: np.ndarray
) -> np.ndarray:
    """Friction torques of the motors (n, n_m) at their speeds and the torques of the gears on the
    motor side.
    """
    name, given = friction_function(model, v_m, carried)
    return evaluate(function(name), *given)[0].reshape(v_m.shape)


def friction_function(model: RobotModel, v_m: T, carried: T) -> tuple[str, tuple[T, ...]]:
    """The function of the friction torques of a robot's motors, and its arguments.

    ``v_m``: speeds of the motors; ``carried``: torques of the gears on the motor side, an argument
    where a friction depends on them.
    """
    if loaded_motors(model):
        return "loaded_friction", (v_m, carried)
    return "motor_friction", (v_m,)
