"""Third-order correction of the responses of the linear robot for the finite amplitude of a
periodic motion about rest.

    Z(w) Y(w) = B U(w) - N(w),    N: spectrum of  l(y, y', y'') less its linear part,
    Z = -w^2 M + j w D + K

l: left side of Lagrange's equations, of inertia and gravity. The torques U are known at the
excited lines of a multisine; at other lines the drives answer, ``U = -F Q_m``, so that Z has
``B F C_m`` more. The first of two steps finds the motion of second order, mostly between the
lines, the second what it causes at the lines with that of first order. What is left is of fifth
order.

Source: T. Cameron and J. Griffin, Journal of Applied Mechanics 56(1), 1989 (alternating between
frequency and time).
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from flexgen.analysis.second_order import motor_rows
from flexgen.base.numerics.evaluate import Evaluator, evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.sensors import sensor_signals

# samples in a period over the highest line: products of three lines do not fall on lines
OVERSAMPLING = 4
STEPS = 2


class LargeMotions:
    """The nonlinear parts of a robot and of its outputs, motor angles and chosen channels of
    sensors.

    Parameters
    ----------
    equations : Equations
    values : array (n_p,)
        Of the parameters of the equations.
    channels : sequence of int
        Numbers of the channels, in the order of all sensors of the model.
    compiled : callable
        What makes a function faster that is called for many points.
    """

    def __init__(
        self,
        equations: Equations,
        values: np.ndarray,
        channels: list[int],
        compiled: Callable[..., ca.Function],
    ) -> None:
        y = equations.y
        n = equations.model.dof
        signals = sensor_signals(equations)[channels] if channels else ca.SX(0, 1)
        left, signals = ca.substitute(
            [equations.left, signals], [equations.symbols], [ca.SX(ca.DM(values))]
        )
        functions = (ca.Function("along", [*y], [ca.densify(ca.cse(x))]) for x in (left, signals))
        self._left, self._signals = (compiled(function) for function in functions)
        still = [
            ca.densify(ca.substitute(ca.jacobian(left, x), ca.vertcat(*y[1:]), ca.SX.zeros(2 * n)))
            for x in y[::2]
        ]
        self._at_rest = ca.Function("at_rest", [y[0]], still)  # derivatives in y and y''
        self._motor_rows = motor_rows(equations.model)
        self._sensed = bool(channels)
        self._many: dict[tuple[ca.Function, int], Evaluator] = {}

    def _along(
        self, function: ca.Function, rest: np.ndarray, motion: list[np.ndarray]
    ) -> np.ndarray:
        """A function along the motion y, y', y'' (points, n) less its value at rest, (points,
        rows).
        """
        key = function, len(motion[0])
        if key not in self._many:
            self._many[key] = Evaluator(function.map(len(motion[0])))
        zero = np.zeros_like(rest)
        moved = self._many[key]((rest + motion[0]).T, motion[1].T, motion[2].T)[0].T
        return np.asarray(moved - evaluate(function, rest[None], zero, zero)[0])

    def outputs(
        self,
        rest: np.ndarray,
        lines: np.ndarray,
        speed: float,
        Z: np.ndarray,
        held: np.ndarray,
        linear: np.ndarray,
    ) -> np.ndarray:
        """Amplitudes of motor angles and signals at the lines, (lines, outputs, experiments).

        Parameters
        ----------
        rest : array (n,)
            Coordinates at rest.
        lines : array of int (lines,)
            Excited multiples of the lowest frequency of the period.
        speed : float [rad/s]
            That frequency.
        Z, held : complex arrays (2 lines[-1] + 1, n, n)
            At the multiples from zero; ``held``: ``B F C_m``.
        linear : complex array (lines, n, experiments)
            Amplitudes of the coordinates of the linear robot.
        """
        n, experiments = linear.shape[1:]
        samples = next_fast_len(OVERSAMPLING * int(lines[-1]) + 2, real=True)
        K, M = (x.reshape(n, n) for x in evaluate(self._at_rest, rest[None]))
        s = 1j * speed * np.arange(samples // 2 + 1)[:, None, None]
        amplitudes = np.zeros((len(s), experiments, n), complex)
        amplitudes[lines] = linear.swapaxes(1, 2)

        def motion() -> list[np.ndarray]:
            rates = (amplitudes, s * amplitudes, s**2 * amplitudes)
            return [irfft(x, samples, axis=0).reshape(-1, n) * samples / 2 for x in rates]

        def spectrum(x: np.ndarray) -> np.ndarray:
            """(multiples, rows, experiments)."""
            whole = rfft(x.reshape(samples, experiments, -1), axis=0)[: len(Z)] * 2 / samples
            return np.asarray(whole.swapaxes(1, 2))

        for step in range(STEPS):
            y = motion()
            N = spectrum(self._along(self._left, rest, y) - y[0] @ K.T - y[2] @ M.T)
            if step == 0:
                amplitudes[: len(Z)] = -np.linalg.solve(Z + held, N).swapaxes(1, 2)
            amplitudes[lines] = (linear - np.linalg.solve(Z[lines], N[lines])).swapaxes(1, 2)
        angles = self._motor_rows @ amplitudes[lines].swapaxes(1, 2)
        if not self._sensed:
            return np.asarray(angles)
        return np.concatenate(
            [angles, spectrum(self._along(self._signals, rest, motion()))[lines]], axis=1
        )
