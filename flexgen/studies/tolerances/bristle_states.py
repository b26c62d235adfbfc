"""Torques of frictions with a state, the LuGre law, in robots that differ from the model.

In a step of time h in which the angle p of a motor changes by dp its speed is v = dp/h, and the
torque y = s0 z of the bristles goes to its limit sign(dp) g(v):

    y_+ = sign(dp) g + (y - sign(dp) g) exp(-s0 |dp| / g),    tau = y_+ + s1 (y_+ - y) / (s0 h)

This is exact for a constant speed, however short the time constant g/(s0 |v|) is against the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.dynamics.hysteresis.lugre import MotorBristles, motor_bristles, sliding_torque
from flexgen.model.elements import RobotModel


@dataclass(frozen=True)
class Bristles(MotorBristles):
    """The LuGre law of several robots in steps of time ``h`` [s].

    The parameters have the shape (robots, 1, n_m) and are zero where a motor has no such friction:
    ``stiffness`` s0 [N m/rad] and ``damping`` s1 [N m s/rad] of the bristles, and the torques
    ``coulomb`` and ``static`` [N m] of the Stribeck curve g(v).
    """

    h: float

    @property
    def largest(self) -> np.ndarray:
        """Torques of friction at the lowest speed (robots, 1, n_m) [N m]; 1 where there is
        none.
        """
        return np.where(self.static > 0.0, self.static, 1.0)

    @property
    def weights(self) -> tuple[np.ndarray, np.ndarray]:
        """Weights A and B of the bristle torques after and before a step.

        The friction torque is ``A y_+ - B y``, with ``A = 1 + B`` and ``B = s1 / (s0 h)``.
        """
        damping = self.damping / (np.where(self.stiffness > 0.0, self.stiffness, 1.0) * self.h)
        return 1.0 + damping, damping

    def step(self, y: np.ndarray, dp: np.ndarray) -> np.ndarray:
        """Bristle torques y_+ [N m] after the motor angles have changed by ``dp`` (..., n_m)
        [rad].

        ``y`` (robots, 1, n_m) [N m]: the torques before.
        """
        limit, remaining = self._limit(dp[..., None, :])
        return np.asarray(limit + (y - limit) * remaining)

    def rise(self, y: np.ndarray, after: np.ndarray, dp: np.ndarray) -> np.ndarray:
        """Tangent stiffness of the bristles, the derivative of `step` in ``dp`` [N m/rad].

            d y_+ / d dp = s0 (1 - sign(dp) y / g) exp(-s0 |dp| / g)

        with g(v) taken as constant, for Newton's method in an implicit step of time. At dp = 0 it
        is that towards positive angles, which is s0 for bristles without a torque. Zero where y
        exceeds g, as after the level g has fallen: a negative stiffness would spoil the
        convergence.

        ``y`` (robots, 1, n_m) [N m] and ``dp`` (..., n_m) [rad] as in `step`. ``after``, the
        torques y_+, is part of the common interface `Law`: the hysteresis of gears needs it, this
        law does not.
        """
        limit, remaining = self._limit(dp[..., None, :])
        sign = np.where(dp < 0.0, -1.0, 1.0)[..., None, :]
        level = np.maximum(np.abs(limit), 1e-300)  # g; without friction 0, and so is s0
        return np.asarray(self.stiffness * np.maximum(1.0 - sign * y / level, 0.0) * remaining)

    def _limit(self, dp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Limit ``sign(dp) g`` [N m] of the torque y in a long motion, and the part
        ``exp(-s0 |dp| / g)`` of the distance to it that remains after ``dp`` [rad].
        """
        level = sliding_torque(dp / self.h, self.coulomb, self.static, self.stribeck_speed)
        remaining = np.exp(-self.stiffness * np.abs(dp) / np.where(level > 0.0, level, 1.0))
        return np.where(dp < 0.0, -level, level), remaining


def bristles_of(models: list[RobotModel], h: float) -> Bristles:
    """The bristles of robots of one kind, for steps of time ``h`` [s]."""
    laws = [motor_bristles(model) for model in models]
    names = "coulomb", "static", "stribeck_speed", "stiffness", "damping"
    return Bristles(
        **{name: np.array([getattr(law, name) for law in laws])[:, None] for name in names}, h=h
    )
