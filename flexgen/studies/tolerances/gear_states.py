"""Torques of gears with hysteresis in robots that differ from the model.

Element l of gear k has a torque z that depends on the deflections p that were, see
`flexgen.dynamics.hysteresis.hysteresis_law`:

    dz = K_h (1 - s |x|^n (...)) dp,    x = z/W,    s = sign(dp)

A step of p is one of Runge and Kutta's method of order 4, without reversal in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexgen.base.spec.memory import HysteresisLaw
from flexgen.dynamics.hysteresis.hysteresis import gear_layers
from flexgen.dynamics.hysteresis.hysteresis_law import element_slope
from flexgen.model.elements import RobotModel


@dataclass(frozen=True)
class Gears:
    """Elements of some robots: ``K``, ``W`` (robots, layers, n_g), and the laws of the layers of
    all.
    """

    K: np.ndarray
    W: np.ndarray
    of_layers: tuple[tuple[HysteresisLaw, ...], ...]

    @cached_property
    def laws(self) -> list[tuple[HysteresisLaw, np.ndarray]]:
        """Each law, and the elements (layers, n_g) that have it."""
        found = dict.fromkeys(law for layer in self.of_layers for law in layer)
        return [
            (law, np.array([[law == each for each in layer] for layer in self.of_layers]))
            for law in found
        ]

    @property
    def weights(self) -> tuple[np.ndarray, np.ndarray]:
        """The torque after a step is that of the gear."""
        return np.array(1.0), np.array(0.0)

    @property
    def largest(self) -> np.ndarray:
        """Torques at which they slip; 1 where there is none."""
        return np.where(self.W > 0.0, self.W, 1.0)

    def slope(self, z: np.ndarray, s: np.ndarray) -> np.ndarray:
        """dz/dp in the direction ``s``."""
        x = s[..., None, :] * np.clip(z / self.largest, -1.0, 1.0)
        slopes = np.empty(x.shape)
        for law, own in self.laws:
            slopes[..., own] = element_slope(x[..., own], law)
        return np.where(self.W > 0.0, self.K * slopes, 0.0)

    def step(self, z: np.ndarray, dp: np.ndarray) -> np.ndarray:
        """Torques after deflections have changed by ``dp`` (..., n_g)."""
        s = np.where(dp < 0.0, -1.0, 1.0)
        h = dp[..., None, :]
        k1 = self.slope(z, s)
        k2 = self.slope(z + h / 2 * k1, s)
        k3 = self.slope(z + h / 2 * k2, s)
        return np.asarray(z + h / 6 * (k1 + 2 * k2 + 2 * k3 + self.slope(z + h * k3, s)))

    def rise(self, z: np.ndarray, after: np.ndarray, dp: np.ndarray) -> np.ndarray:
        """Derivative of `step` in ``dp``: the slope of the law at the torques ``after`` the step.

        ``z``, the torques before, is part of the common interface `Law` and not needed here.
        """
        return self.slope(after, np.where(dp < 0.0, -1.0, 1.0))


def gears_of(models: list[RobotModel]) -> Gears:
    """The elements of robots of one kind."""
    layers = [gear_layers(model) for model in models]
    K, W = (
        np.array([[getattr(x, name) for x in each] for each in layers])
        for name in ("stiffness", "slip")
    )
    return Gears(K, W, tuple(layer.laws for layer in layers[0]))


def gear_rows(model: RobotModel) -> np.ndarray:
    """Rows from the coordinates to the deflections of the gears, (n_g, n)."""
    rows = np.zeros((model.n_g, model.dof))
    rows[:, model.n_a :] = np.linalg.inv(model.eta)[:, list(model.i_m)]
    rows[np.arange(model.n_g), list(model.i_g)] = -1.0
    return rows
