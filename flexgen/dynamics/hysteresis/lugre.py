"""Friction of motors with a state, the LuGre law, in addition to the equations of motion.

    tau_f = f(v) + y + s1 z',    z' = v - s0 |v| z/g(v),
    g(v) = F_c + (F_s - F_c) exp(-(v/v_s)^2),    y = s0 z

with the speed v of the motor, motor side; f: its friction without a state. Poles, zeros, frequency
responses and the growth of perturbations are those of f alone. What does not take the state into
account refuses a model that has it: `flexgen.model.friction.refuse_lugre`.

Along a known motion z obeys a linear equation. A sampling interval is divided where v, a cubic
between the samples, vanishes, and then into parts within which z follows its limit g/s0 by a few
time constants at most; on each part Radau IIA with three stages solves it. Where v has left the
range of static friction and z has come to its limit, z is this limit. The torques at the samples
are differences of their impulse, ``s0 int z dt + s1 z``: their sum is the change of momentum,
however short a reversal of the friction is against the sampling interval.

Source: C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, IEEE TAC 40(3), 1995.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.numerics.tableaus import radau
from flexgen.dynamics.hysteresis.hysteresis import without_hysteresis
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.model.elements import RobotModel
from flexgen.model.friction import bristled_motors

# most parts of an interval; parts for each time constant, for each v_s
PARTS = 64
GROWTH = 1.0
TURN = 2.0
# speeds over v_s without static friction; time constants after which z is its limit
FAR = 5.5
SETTLED = 30.0
LEAST = 1e-8  # time constants in an interval below which a reversal in it has no effect
TABLE = radau(3)


@dataclass(frozen=True)
class MotorBristles:
    """Numbers of the law of all motors, (n_m,) each, motor side; without the friction ``coulomb``
    is zero.
    """

    coulomb: np.ndarray
    static: np.ndarray
    stribeck_speed: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray

    @property
    def present(self) -> np.ndarray:
        """Which motors have the friction (n_m,)."""
        return np.asarray(self.coulomb > 0.0)

    def level(self, v: np.ndarray, motor: int) -> np.ndarray:
        """The torque g(v) [N m] of a motor that slides at the speeds ``v`` [rad/s]."""
        return np.asarray(
            sliding_torque(v, self.coulomb[motor], self.static[motor], self.stribeck_speed[motor])
        )


def sliding_torque(v: Any, coulomb: Any, static: Any, speed: Any) -> Any:
    """The torque g(v) [N m] of a motor that slides at the speed ``v`` [rad/s]; CasADi expressions
    or arrays.
    """
    exp = ca.exp if isinstance(v, ca.SX) else np.exp
    return coulomb + (static - coulomb) * exp(-((v / speed) ** 2))


def motor_bristles(model: RobotModel) -> MotorBristles:
    """The numbers of the law of all motors."""
    rows = [(0.0, 0.0, 1.0, 0.0, 0.0) for _ in model.motors]
    for j, motor in enumerate(model.motors):
        if (law := motor.lugre) is not None:
            rows[j] = (law.coulomb, law.static, law.stribeck_speed, law.stiffness, law.damping)
    return MotorBristles(*np.array(rows, float).reshape(-1, 5).T)


def without_lugre(model: RobotModel) -> RobotModel:
    """The model with the frictions of its motors that have no state alone."""
    if not bristled_motors(model):
        return model
    return replace(model, motors=tuple(replace(motor, lugre=None) for motor in model.motors))


def without_states(model: RobotModel) -> RobotModel:
    """The model without elements that have a state; the same object where it has none."""
    return without_lugre(without_hysteresis(model))


def bristle_rates(law: MotorBristles, v: ca.SX, y: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Rates of the torques ``y = s0 z`` (n_m,) [N m/s], and the torques ``y + s1 z'`` of the
    bristles [N m], at the motor speeds ``v`` (n_m,) [rad/s]; zero for motors without bristles.
    """
    rates = []
    torques = []
    for j, present in enumerate(law.present):
        if not present:
            rates.append(ca.SX(0))
            torques.append(ca.SX(0))
            continue
        coulomb, static, speed = (
            float(x[j]) for x in (law.coulomb, law.static, law.stribeck_speed)
        )
        level = sliding_torque(v[j], coulomb, static, speed) if static > coulomb else coulomb
        rate = v[j] - ca.fabs(v[j]) * y[j] / level  # of z
        rates.append(float(law.stiffness[j]) * rate)
        torques.append(y[j] + float(law.damping[j]) * rate)
    return ca.vertcat(*rates), ca.vertcat(*torques)


def bristle_torques(law: MotorBristles, t: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Torques ``y + s1 z'`` of the bristles (n, n_m) along a motion from rest with z = 0, motor
    side [N m].

    Parameters
    ----------
    law : MotorBristles
    t : array (n,) [s]
        Instants at equal distances.
    v, a : arrays (n, n_m) [rad/s, rad/s^2]
        Speeds and accelerations of the motors.

    Raises
    ------
    SolverError
        The motion is not finite.
    """
    if not (np.isfinite(v).all() and np.isfinite(a).all()):
        raise SolverError(
            "lugre: given speeds or accelerations of the motors that are not finite, expected "
            "finite ones"
        )
    out = np.zeros_like(v)
    h = float(t[1] - t[0])
    for j in np.flatnonzero(law.present):
        z, w = bristles_along(law, int(j), h, v[:, j], a[:, j])
        out[:, j] = _derivative(
            law.stiffness[j] * w + law.damping[j] * z, law.stiffness[j] * z[-1] * h, h
        )
    return out


def torques_to_send(equations: Equations, q_m: np.ndarray, torques: np.ndarray) -> np.ndarray:
    """Torques (n, n_m) that motors send at their angles ``q_m`` so that they give ``torques``,
    with their ripple.
    """
    given = equations.function("given_torque")
    one, none = (
        evaluate(given, q_m, x)[0].reshape(torques.shape)
        for x in (np.ones_like(torques), 0 * torques)
    )
    return np.asarray(torques / (one - none))


def _derivative(impulse: np.ndarray, step: float, h: float) -> np.ndarray:
    """Time derivative by central differences of order six; at rest before, and with equal steps
    after the end.
    """
    ends = np.full(3, impulse[0]), impulse[-1] + step * np.arange(1, 4)
    x = np.concatenate([ends[0], impulse, ends[1]])
    n = len(impulse)
    one, two, three = (x[3 + k : n + 3 + k] - x[3 - k : n + 3 - k] for k in (1, 2, 3))
    return np.asarray((45 * one - 9 * two + three) / (60 * h))


def bristles_along(
    law: MotorBristles, j: int, h: float, v: np.ndarray, a: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Deflections z of the bristles of motor ``j`` at the samples (n,) [rad], and their integrals
    [rad s].

    In each interval of ``h`` [s] the speed is a cubic polynomial of the samples ``v`` [rad/s] and
    ``a`` [rad/s^2], divided at its reversals. z depends linearly on its start, ``z = E z_0 + F``;
    where the motor slides far and steadily z is at its limit. Otherwise steps of an implicit
    method, fine enough for the level of friction and the turns.
    """
    slope = law.stiffness[j] / law.coulomb[j]
    cubic = np.stack(
        [
            v[:-1],
            h * a[:-1],
            3 * np.diff(v) - h * (2 * a[:-1] + a[1:]),
            h * (a[:-1] + a[1:]) - 2 * np.diff(v),
        ]
    )
    # (4 + 1, n - 1): where the parts of one sign begin and end
    bounds = _reversals(cubic, LEAST / (h * slope))
    turned = [abs(_integral(cubic, bounds[k], bounds[k + 1])) * h * slope for k in range(4)]
    control = np.stack([v[:-1], v[:-1] + h * a[:-1] / 3, v[1:] - h * a[1:] / 3, v[1:]])
    slow = np.maximum(control.min(axis=0), -control.max(axis=0))
    falls = law.static[j] > law.coulomb[j]
    near = slow <= FAR * law.stribeck_speed[j]
    quick = np.where(falls, ~near, slow > 0.0)
    way = _integral(cubic, bounds[0], np.ones_like(slow)) * h * slope
    moves = np.abs(way) > LEAST
    settled = (
        _since_reversal(np.sum(turned, axis=0), np.where(moves, way, 0.0), bounds[1] < 1.0)
        > SETTLED
    )
    quick &= settled & moves
    limit = np.sign(v[:-1]) * law.coulomb[j] / law.stiffness[j]
    # z at the end = E z + F, its integral = G z + H
    E = np.where(quick, 0.0, 1.0)
    F = np.where(quick, limit, 0.0)
    G = np.zeros_like(F)
    H = np.where(quick, h * limit, 0.0)
    change = np.where(falls & near, np.ptp(control, axis=0) / law.stribeck_speed[j], 0.0)
    for k in range(4):
        size = bounds[k + 1] - bounds[k]
        fine = np.maximum(GROWTH * turned[k] * ((k > 0) | ~settled), TURN * change * size)
        parts = np.where(quick | (size == 0.0), 0, np.clip(np.floor(fine) + 1, 1, PARTS))
        for part in range(int(parts.max(initial=0))):
            at = np.flatnonzero(parts > part)
            width = size[at] / parts[at]
            e, f, g, i = _step(law, j, h, cubic[:, at], bounds[k][at] + part * width, width)
            G[at] = G[at] + g * E[at]
            H[at] = H[at] + g * F[at] + i
            E[at] = e * E[at]
            F[at] = e * F[at] + f
    z = np.zeros(len(v))
    w = np.zeros(len(v))
    for k in range(len(v) - 1):
        z[k + 1] = E[k] * z[k] + F[k]
        w[k + 1] = w[k] + G[k] * z[k] + H[k]
    return z, w


def _step(
    law: MotorBristles, j: int, h: float, cubic: np.ndarray, begin: np.ndarray, width: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """``z = E z_0 + F`` at the end of parts of intervals, ``int z dt = G z_0 + H``, (m,) each, by
    one step of the implicit method `TABLE`.

    ``h`` [s]: length of an interval; ``cubic`` (4, m): its speed; ``begin``, ``width`` (m,): of
    the parts, over h.
    """
    A = TABLE.A
    c = TABLE.c
    v = cubic_at(cubic[:, :, None], begin[:, None] + width[:, None] * c)
    decay = law.stiffness[j] * np.abs(v) / law.level(v, j)
    size = h * width[:, None]
    matrix = np.eye(3) + (size[:, :, None] * A) * decay[:, None, :]
    right = np.stack([np.ones_like(v), (size * v) @ A.T], axis=2)
    stages = np.linalg.solve(matrix, right)
    whole = size * (stages * TABLE.b[:, None]).sum(axis=1)
    return stages[:, -1, 0], stages[:, -1, 1], whole[:, 0], whole[:, 1]


def cubic_at(cubic: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values of cubic polynomials with coefficients ``cubic`` (4, ...), the constant first."""
    return np.asarray(cubic[0] + at * (cubic[1] + at * (cubic[2] + at * cubic[3])))


def _integral(cubic: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Integral of the speeds ``cubic`` (4, m) from ``low`` to ``high`` (m,), parts of an interval,
    over its length.
    """

    def until(x: np.ndarray) -> np.ndarray:
        return np.asarray(
            x * (cubic[0] + x * (cubic[1] / 2 + x * (cubic[2] / 3 + x * cubic[3] / 4)))
        )

    return until(high) - until(low)


def _reversals(cubic: np.ndarray, least: float) -> np.ndarray:
    """0, the instants at which the speed reverses within each interval in order, then 1: (5, n -
    1).

    Changes of the speed below ``least`` count as none: rests are full of them, by rounding.
    """
    out = np.ones((5, cubic.shape[1]))
    out[0] = 0.0
    control = np.stack(
        [
            cubic[0],
            cubic[0] + cubic[1] / 3,
            cubic[0] + (2 * cubic[1] + cubic[2]) / 3,
            cubic.sum(axis=0),
        ]
    )
    low = control.min(axis=0)
    high = control.max(axis=0)
    for k in np.flatnonzero((low < 0.0) & (high > 0.0) & (high - low > least)):
        roots = np.roots(np.trim_zeros(cubic[::-1, k], "f"))
        real = np.sort(roots.real[np.abs(roots.imag) <= 1e-9])
        inside = real[(real > 0.0) & (real < 1.0)]
        out[1 : 1 + len(inside), k] = inside
    return out


def _since_reversal(turned: np.ndarray, way: np.ndarray, reverses: np.ndarray) -> np.ndarray:
    """Time constants from the last reversal to the start of each interval (n - 1,), of those of
    all intervals.

    A reversal is in an interval, or between two on a ``way`` of opposite directions; at rest the
    way is zero.
    """
    total = np.concatenate([[0.0], np.cumsum(turned)])[:-1]
    at = np.arange(len(turned))
    moved = np.sign(way)[np.maximum.accumulate(np.where(way != 0.0, at, 0))]
    begins = np.concatenate([[False], (moved[1:] * moved[:-1] < 0.0) | reverses[:-1]])
    return np.asarray(total - total[np.maximum.accumulate(np.where(begins, at, 0))])
