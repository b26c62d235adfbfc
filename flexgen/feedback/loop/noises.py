"""The noises that a filter expects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.base.spec.arguments import check_not_negative, check_positive
from flexgen.model.elements import RobotModel


@dataclass(frozen=True)
class Noises:
    """Noises that a filter expects of the model.

    ``torque``: of the torques of a sample, ``rate``: growth of disturbances in a second, both
    relative to the ``largest`` torques (n_m,) [N m]; ``tool_force`` [N].
    """

    model: RobotModel
    torque: float = 0.05
    rate: float = 1.0
    tool_force: float = 50.0

    def __post_init__(self) -> None:
        for name, value in (("torque_noise", self.torque), ("disturbance_rate", self.rate)):
            check_positive(name, value)
        check_not_negative("tool_force", self.tool_force, "a number >= 0")

    @property
    def largest(self) -> np.ndarray:
        """Largest torques of the motors; where the model file has none, the largest of all, or 1 N
        m.
        """
        limits = np.array([motor.torque_max or 0.0 for motor in self.model.motors])
        return np.where(limits > 0, limits, max(limits.max(initial=0.0), 1.0))
