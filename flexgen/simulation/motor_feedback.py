"""Continuous feedback of the motor angles around a trajectory, for simulations of motions that are
unstable without it.

An upright robot falls under any torque with a rounding error. The drives of a real robot close a
loop around the motor angle. The default is the P-PI cascade of `flexgen.control` with its default
frequencies, here continuous: no sampling, delay, noise, filter or torque limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.dynamics.mechanics.equations import Equations


@dataclass(frozen=True)
class MotorFeedback:
    """P-PI feedback of every motor, motor side.

        w = v_ref + position_gain (q_ref - q) - v,
        u = tau_m + speed_gain (w + integral_gain int w dt)

    Attributes
    ----------
    rows : array (n_m, n)
        Motor angles from the coordinates ``(q_a, q_m of the motors behind elastic gears)``.
    position_gain, speed_gain, integral_gain : arrays (n_m,) [1/s], [N m s/rad], [1/s]
    frequencies : dict of str to float [Hz]
        Frequencies from which the gains follow: ``position_hz``, ``speed_hz``, ``integral_hz``.
    """

    rows: np.ndarray
    position_gain: np.ndarray
    speed_gain: np.ndarray
    integral_gain: np.ndarray
    frequencies: dict[str, float]

    @property
    def title(self) -> str:
        """The feedback in words."""
        return (
            "P-PI motor feedback, continuous, position {:.3g} Hz, speed {:.3g} Hz, integral "
            "{:.3g} Hz"
        ).format(*self.frequencies.values())

    def torque(
        self, x: np.ndarray, total: np.ndarray, reference: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Torque of the feedback and ``w``, (n_m,) each.

        ``x``: the state, coordinates and speeds first; ``total``: the integral of w;
        ``reference``: angles and speeds.
        """
        n_m, n = self.rows.shape
        q = self.rows @ x[:n]
        v = self.rows @ x[n : 2 * n]
        w = reference[n_m:] + self.position_gain * (reference[:n_m] - q) - v
        return self.speed_gain * (w + self.integral_gain * total), w

    def state_feedback(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the torque and of w in (coordinates, speeds): (n_m, 2 n) each."""
        in_w = -np.hstack([self.position_gain[:, None] * self.rows, self.rows])
        return self.speed_gain[:, None] * in_w, in_w


def default_feedback(
    equations: Equations, q_a: np.ndarray, q_m: np.ndarray, tau_m: np.ndarray
) -> MotorFeedback:
    """The default feedback of a model, with the inertias and the lowest locked frequency at rest
    at a pose.

    ``q_a`` (n_a,), ``q_m`` (n_m,), ``tau_m`` (n_m,).
    """
    from flexgen.analysis.second_order import motor_rows
    from flexgen.analysis.servo_gains import MULTIPLES, chosen_frequencies, inertias_at_rest

    model = equations.model
    inertia, _, lowest = inertias_at_rest(equations, q_a, q_m, tau_m)
    frequencies = chosen_frequencies(dict.fromkeys(MULTIPLES), lowest)
    position, speed, integral = (np.full(model.n_m, 2 * np.pi * x) for x in frequencies.values())
    return MotorFeedback(motor_rows(model), position, speed * inertia, integral, frequencies)
