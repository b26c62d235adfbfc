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
    """The law of some robots in steps of time ``h`` [s]: numbers (robots, 1, n_m), zero where a
    motor has none.
    """

    h: float

    @property
    def largest(self) -> np.ndarray:
        """Torques of friction at the lowest speed; 1 where there is none."""
        return np.where(self.static > 0.0, self.static, 1.0)

    @property
    def weights(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the torques after and before a step in that of the friction."""
        damping = self.damping / (np.where(self.stiffness > 0.0, self.stiffness, 1.0) * self.h)
        return 1.0 + damping, damping

    def step(self, y: np.ndarray, dp: np.ndarray) -> np.ndarray:
        """Torques after the angles have changed by ``dp`` (..., n_m)."""
        end, left = self._limit(dp[..., None, :])
        return np.asarray(end + (y - end) * left)

    def rise(self, y: np.ndarray, after: np.ndarray, dp: np.ndarray) -> np.ndarray:
        """Derivative of `step` in ``dp``, g(v) constant; s0 where dp is zero."""
        end, left = self._limit(dp[..., None, :])
        turned = np.where(dp < 0.0, -1.0, 1.0)[..., None, :]
        return np.asarray(
            self.stiffness
            * np.maximum(1.0 - turned * y / np.maximum(np.abs(end), 1e-300), 0.0)
            * left
        )

    def _limit(self, dp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The torque that y goes to, and the part of its distance that is left."""
        level = sliding_torque(dp / self.h, self.coulomb, self.static, self.stribeck_speed)
        left = np.exp(-self.stiffness * np.abs(dp) / np.where(level > 0.0, level, 1.0))
        return np.where(dp < 0.0, -level, level), left


def bristles_of(models: list[RobotModel], h: float) -> Bristles:
    """The bristles of robots of one kind, for steps of time ``h`` [s]."""
    laws = [motor_bristles(model) for model in models]
    names = "coulomb", "static", "stribeck_speed", "stiffness", "damping"
    return Bristles(
        **{name: np.array([getattr(law, name) for law in laws])[:, None] for name in names}, h=h
    )
