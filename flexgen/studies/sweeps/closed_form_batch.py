"""Joint moves of a flexible-joint robot, many at once: vectorised numpy around the emitted inverse
dynamics.

Without non-actuated coordinates the torques follow from the motion at each instant. Along a joint
move it is ``q = start + (end - start) s(t)`` with the time law s, so that all moves of one law
differ by factors only. The gears need ``tau_g`` with two derivatives: central differences of sixth
order along the Taylor polynomial of the law at each instant, by the inverse dynamics at six
neighbors; no differences across instants, so the ends of the move do no harm.

The moves are computed in batches whose width depends on the time law alone, so the bits of a
result depend on the move alone. After the moves the deflections of damped gears decay, as in the
method closed-form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import factorial
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.numerics.gear_lag import Lag, gear_lag
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.dynamics.mechanics.limits import Limits, limits_of_model
from flexgen.dynamics.mechanics.statics import gear_damping
from flexgen.inversion.methods.closed_form import instants
from flexgen.inversion.problem.motor_side import INSTANT
from flexgen.inversion.problem.problem import STEP, gear_settling
from flexgen.model.abilities import obstacle
from flexgen.model.elements import Friction, LinearSpring, RobotModel
from flexgen.paths.timing.time_laws import TimeLaw

WIDTH = 32  # moves of a batch, at most: their arrays fit into the cache
BATCH = 40_000  # samples of a batch, at most: long moves have smaller batches
NEIGHBOR = 1 / 2000  # of the duration: distance of the neighbors
FIRST = (3 / 4, -3 / 20, 1 / 60)  # central differences of sixth order
SECOND = (3 / 2, -3 / 20, 1 / 90)
CENTER = -49 / 18

InverseDynamics = Callable[..., Any]


@dataclass(frozen=True)
class Peaks:
    """Figures of N moves.

    Motors, (N, n_m), motor side: ``torque_max`` and ``torque_rms`` [N m], ``speed_max`` [rad/s],
    ``energy`` [J], the work done by the motor. Actuated coordinates, (N, n_g): ``speed`` [rad/s or
    m/s] and ``acceleration`` [rad/s^2 or m/s^2], the largest ones.
    """

    torque_max: np.ndarray
    torque_rms: np.ndarray
    speed_max: np.ndarray
    energy: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray


def unfit(model: RobotModel) -> str:
    """Why the moves of a model cannot be computed in batches; empty where they can."""
    if (reason := obstacle(model, "batches of moves")) is not None:
        return reason
    for friction in (
        *(c.dof.friction for c in model.coordinates if c.dof),
        *(m.friction for m in model.motors),
    ):
        if type(friction) is not Friction:
            return f"model {model.name} has a friction law {type(friction).__name__}"
    if limits_of_model(model).without("torque", "speed") != Limits():
        return f"model {model.name} has limits other than of motor torque and speed"
    return ""


class JointMoves:
    """The motors of one flexible-joint robot along joint moves of one time law.

    Parameters
    ----------
    equations : Equations
        Of a model without non-actuated coordinates, with linear gear springs.
    law : TimeLaw
        Of all moves.
    inverse_dynamics : callable, optional
        ``(q_a, v_a, a_a, out=tau_a)`` on arrays (N, n_a), such as that of a generated library;
        default: CasADi's virtual machine, which is slower.
    step : float, optional [s]
        Largest distance of two samples; default: that of `flexgen.solve`.

    Raises
    ------
    ArgumentError
        Where the model cannot be computed this way, see `unfit`.
    """

    def __init__(
        self,
        equations: Equations,
        law: TimeLaw,
        inverse_dynamics: InverseDynamics | None = None,
        step: float | None = None,
    ) -> None:
        """``law``: time law of all moves; ``inverse_dynamics``: of the arm (default: interpreted,
        slower); ``step``: between samples [s].

        The memory of a batch is made at the first one. Gears with damping need their lag, and
        elastic ones neighbors in time for two derivatives.
        """
        model = equations.model
        problem = unfit(model)
        if problem:
            raise ArgumentError(
                f"batch of joint moves: {problem}; use flexgen.solve for each of them"
            )
        self.model = model
        self.law = law
        step = min(STEP, law.duration / 400) if step is None else step
        self.t, _ = instants(law.duration, step, gear_settling(equations))
        self.n = len(self.t)
        self._width = min(max(1, BATCH // self.n), WIDTH)
        self._inverse_dynamics = inverse_dynamics or _interpret(equations)
        rows = gears(model)
        self._elastic = [k for k, (gear, _) in enumerate(rows) if not gear.rigid]
        stiffness = [
            ratio**2 * gear.spring.stiffness
            for gear, ratio in rows
            if isinstance(gear.spring, LinearSpring)
        ]
        self._stiffness = np.array(stiffness)
        self._damping = gear_damping(equations)[self._elastic]
        damped = self._damping > 0
        slow = self._damping[damped] / self._stiffness[damped]
        h = self.t[1]
        if (slow < INSTANT * h).any():
            raise ArgumentError(
                f"batch of joint moves: model {model.name} has a gear with a time constant of "
                f"{slow.min():.2g} s, much less than a sample of {h:.2g} s; use flexgen.solve "
                "for each of the moves"
            )
        self._slow = [int(k) for k in np.flatnonzero(damped)]  # among the elastic ones
        self._lag: Lag | None = (
            gear_lag(self.t, self._stiffness[self._slow], self._damping[self._slow])
            if self._slow
            else None
        )
        s = law(self.t, 5)
        self._here = [np.ascontiguousarray(s[:, k]) for k in range(4)]
        self._apart = NEIGHBOR * law.duration
        offsets = [sign * k * self._apart for k in (1, 2, 3) for sign in (1, -1)]
        self._near = [_taylor(s, offset) for offset in offsets] if self._elastic else []
        self._memory: list[np.ndarray] = []

    def peaks(self, starts: np.ndarray, ends: np.ndarray) -> Peaks:
        """Figures of N moves from ``starts`` to ``ends`` (N, n_g) [rad or m]."""
        n_m = self.model.n_m
        largest, rms, fastest, work = (np.empty((len(starts), n_m)) for _ in range(4))
        for rows, tau, speed in self._batches(starts, ends):
            count = len(rows)
            largest[rows] = _largest(tau)[:, :count].T
            fastest[rows] = _largest(speed)[:, :count].T
            rms[rows] = np.sqrt(_integral(tau * tau, self.t) / self.t[-1])[:, :count].T
            work[rows] = _integral(tau * speed, self.t)[:, :count].T
        way = np.abs(np.asarray(ends) - np.asarray(starts))
        s1, s2 = (np.abs(x).max() for x in self._here[1:3])
        return Peaks(largest, rms, fastest, work, way * s1, way * s2)

    def torques(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Motor torques (N, n, n_m) [N m, motor side] at the instants `t`; 8 n n_m bytes a
        move.
        """
        out = np.empty((len(starts), self.n, self.model.n_m))
        for rows, tau, _ in self._batches(starts, ends):
            out[rows] = tau[:, :, : len(rows)].transpose(2, 1, 0)
        return out

    def _batches(self, starts: np.ndarray, ends: np.ndarray) -> Any:
        """Numbers, motor torques and motor speeds (n_m, n, width) of each batch; the last one is
        padded.
        """
        q0 = np.asarray(starts, dtype=float)
        q1 = np.asarray(ends, dtype=float)
        if q0.ndim != 2 or q0.shape != q1.shape or q0.shape[1] != self.model.n_g:
            raise ArgumentError(
                f"joint moves: given starts {q0.shape} and ends {q1.shape}, expected (N, "
                f"{self.model.n_g}) for both"
            )
        if not (np.isfinite(q0).all() and np.isfinite(q1).all()):
            raise ArgumentError(
                "joint moves: given starts or ends that are not finite, expected finite numbers"
            )
        if not self._memory:
            self._memory = [np.empty((self.model.n_g, self.n, self._width)) for _ in range(8)]
        for first in range(0, len(q0), self._width):
            rows = np.arange(first, min(first + self._width, len(q0)))
            filled = np.r_[rows, np.full(self._width - len(rows), rows[-1])]
            start = np.ascontiguousarray(q0[filled].T)
            tau, speed = self._motors(start, np.ascontiguousarray(q1[filled].T) - start)
            if not np.isfinite(tau).all():
                raise SolverError(
                    f"joint moves {rows[0]} to {rows[-1]}: the torques are not finite"
                )
            yield rows, tau, speed

    def _arm(
        self, start: np.ndarray, way: np.ndarray, s: Sequence[np.ndarray], tau: np.ndarray
    ) -> None:
        """Write the inverse dynamics (n_g, n, width) [N m, N] of the moves at (s, s', s'') to
        ``tau``; uses three arrays.

        ``start``, ``way`` (n_g, width): where the moves begin, and their lengths [rad, m].
        """
        q, v, a = self._memory[:3]
        for x, factor in zip((q, v, a), s, strict=False):
            np.multiply(way[:, None, :], factor[None, :, None], out=x)
        q += start[:, None, :]
        n_g = len(way)
        self._inverse_dynamics(
            *(x.reshape(n_g, -1).T for x in (q, v, a)), out=tau.reshape(n_g, -1).T
        )

    def _motors(self, start: np.ndarray, way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Motor torques [N m] and speeds [rad/s] (n_m, n, width): arm, joint friction, rates of
        the deflections, gears, rotors and motor friction; arguments as for `_arm`.
        """
        model = self.model
        elastic = self._elastic
        tau, near, first, second = self._memory[3:7]
        if elastic:
            self._derivatives(start, way, near, first, second)
        self._arm(start, way, self._here, tau)
        v, a = self._memory[1:3]
        if elastic:
            second[elastic] += CENTER * tau[elastic]
            first[elastic] *= 1 / self._apart
            second[elastic] *= 1 / self._apart**2
        jerk = self._here[3][:, None]
        for k, i in enumerate(model.i_g):
            dof = model.coordinates[i].dof
            if dof is None or dof.friction == Friction():
                continue
            if k not in elastic:
                tau[k] += friction(dof.friction, v[k])
                continue
            torque, first_derivative, second_derivative = friction_derivatives(dof.friction, v[k])
            tau[k] += torque
            first[k] += first_derivative * a[k]
            second[k] += second_derivative * a[k] ** 2 + first_derivative * (way[k] * jerk)
        if elastic:
            rates, second_rates = self._deflection_rates(
                tau[elastic], first[elastic], second[elastic]
            )
            v[elastic] += rates
            a[elastic] += second_rates
        eta = model.eta
        back = np.linalg.inv(model.eta).T
        speed = _multiply(eta, v)
        torque = _multiply(back, tau)
        acceleration = _multiply(eta, a)
        for j, motor in enumerate(model.motors):
            acceleration[j] *= motor.inertia
            if motor.friction != Friction():
                acceleration[j] += friction(motor.friction, speed[j])
        return np.add(torque, acceleration, out=torque), speed

    def _derivatives(
        self,
        start: np.ndarray,
        way: np.ndarray,
        near: np.ndarray,
        first: np.ndarray,
        second: np.ndarray,
    ) -> None:
        """Write the neighbors' share of two time derivatives of the inverse dynamics, times the
        step and its square, to ``first`` and ``second``; ``near`` is overwritten.
        """
        later = self._memory[7]
        first.fill(0.0)
        second.fill(0.0)
        for k, (c, d) in enumerate(zip(FIRST, SECOND, strict=True)):
            self._arm(start, way, self._near[2 * k], later)
            self._arm(start, way, self._near[2 * k + 1], near)
            for i in self._elastic:
                first[i] += c * (later[i] - near[i])
                second[i] += d * (later[i] + near[i])

    def _deflection_rates(
        self, tau: np.ndarray, first: np.ndarray, second: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Time derivatives one and two of the elastic gears' deflections (m, n, width), from gear
        torques ``tau`` with two derivatives.

        Without damping those of ``tau / K``; with damping of ``K d + D d' = tau``, solved by the
        lag of the gear.
        """
        K = self._stiffness[:, None, None]
        D = self._damping[:, None, None]
        rates = first / K
        second_rates = second / K
        if self._lag is not None:
            slow = self._slow
            given = np.stack([x[slow].transpose(1, 0, 2) for x in (tau, first, second)])
            deflections = self._lag.deflections(given, given[0, 0] / K[slow][:, 0]).transpose(
                1, 0, 2
            )
            rates[slow] = (tau[slow] - K[slow] * deflections) / D[slow]
            second_rates[slow] = (first[slow] - K[slow] * rates[slow]) / D[slow]
        return rates, second_rates


# The law of `force_laws.friction_torque` in numpy: for whole arrays, of joints as well as motors
# (the function motor_friction is of the motors alone), and with two derivatives, which no function
# of the model has. A test compares it with the CasADi expression.
def friction(law: Friction, w: np.ndarray) -> np.ndarray:
    """Friction torque [N m or N] at the speed ``w`` [rad/s or m/s]."""
    out = law.viscous * w
    if law.coulomb or law.stribeck:
        level: Any = law.coulomb
        if law.stribeck:
            level = level + law.stribeck * _sech(law.alpha * w)
        out += level * np.tanh(law.beta * w)
    return out + law.offset


def friction_derivatives(
    law: Friction, w: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Friction torque at the speed ``w`` [rad/s, m/s] and its first two derivatives in w, of the
    shape of w.
    """
    T = np.tanh(law.beta * w)
    T1 = law.beta * (1 - T * T)
    T2 = -2 * law.beta * T * T1
    L = np.full_like(w, law.coulomb)
    L1 = L2 = np.zeros_like(w)
    if law.stribeck:
        C = _sech(law.alpha * w)
        U = np.tanh(law.alpha * w)
        L = L + law.stribeck * C
        L1 = -law.stribeck * law.alpha * C * U
        L2 = law.stribeck * law.alpha**2 * C * (2 * U * U - 1)
    return (
        law.viscous * w + L * T + law.offset,
        law.viscous + L1 * T + L * T1,
        L2 * T + 2 * L1 * T1 + L * T2,
    )


def _sech(x: np.ndarray) -> np.ndarray:
    decay = np.exp(-np.abs(x))  # no overflow at high speed
    return 2 * decay / (1 + decay * decay)


def _taylor(s: np.ndarray, offset: float) -> tuple[np.ndarray, ...]:
    """Taylor expansion of (s, s', s'') (n,) at an offset [s], up to the fourth derivative, from
    ``s`` (n, 6).
    """
    return tuple(
        sum((s[:, k + i] * (offset**i / factorial(i)) for i in range(1, 5 - k)), s[:, k].copy())
        for k in range(3)
    )


def _multiply(matrix: np.ndarray, x: np.ndarray) -> np.ndarray:
    """``matrix @ x`` along the first axis, term by term, with the same bits for any shape."""
    out = np.zeros((len(matrix), *x.shape[1:]))
    for row, weights in zip(out, matrix, strict=True):
        for weight, values in zip(weights, x, strict=True):
            if weight != 0.0:
                row += weight * values
    return out


def _largest(x: np.ndarray) -> np.ndarray:
    return np.asarray(np.maximum(x.max(axis=1), -x.min(axis=1)))


def _integral(x: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Over time (axis 1) by the trapezoidal rule."""
    return np.asarray((x.sum(axis=1) - (x[:, 0] + x[:, -1]) / 2) * t[1])


def _interpret(equations: Equations) -> InverseDynamics:
    """Inverse dynamics of a batch by CasADi's interpreter, where no compiled one is given; it
    writes to ``out``.
    """
    function = equations.function("inverse_dynamics")

    def call(q: np.ndarray, v: np.ndarray, a: np.ndarray, out: np.ndarray) -> None:
        out[...] = evaluate(function, q, v, a)[0].reshape(out.shape)

    return call
