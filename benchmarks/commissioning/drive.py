"""A cascade in a drive: proportional control of position, proportional-integral of speed.

The sampled law of `[drive]` in a description of records: u = k_v (w + k_i h sum w),
w = k_p (r - q) + D (r - q), D x = (x_k - x_(k-1)) / h, angles and torques on the motor side.
"""

from __future__ import annotations

import numpy as np

from benchmarks.commissioning.chains import Chain


class Cascade:
    """The drives of all motors of an arm."""

    def __init__(self, chain: Chain, sample_s: float) -> None:
        gains = np.array([gear.drive for gear in chain.gears])
        self.k_p = gains[:, 0]
        self.k_v = gains[:, 1]
        self.k_i = gains[:, 2]
        self.sample_s = sample_s
        self.sum = np.zeros(len(gains))
        self.error = np.zeros(len(gains))

    def hold(self, torque: np.ndarray) -> None:
        """Start at rest without an error and with this torque [N m]."""
        self.sum = torque / (self.k_v * self.k_i * self.sample_s)
        self.error = np.zeros_like(self.sum)

    def torque(self, error: np.ndarray) -> np.ndarray:
        """Of this sample (n,) [N m], from the position errors r - q [rad]."""
        speed = self.k_p * error + (error - self.error) / self.sample_s
        self.error = error
        self.sum = self.sum + speed
        return np.asarray(self.k_v * (speed + self.k_i * self.sample_s * self.sum))
