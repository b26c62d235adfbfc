"""Torques of gears with hysteresis in robots that differ from the model, along a motion and deviations from it.

Element l of gear k has a torque z that depends on the deflections p that were, see `flexgen.memory.hysteresis_law`:

    dz = K_h (1 - s |x|^n (...)) dp,    x = z/W,    s = sign(dp)

On a robot acts -P' (z - z_0), P: rows of deflections, z_0: torques of the model along the planned motion. A step of p
is one of Runge and Kutta's method of order 4, without reversal in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexgen.mechanics.parameters import with_values
from flexgen.memory.hysteresis import gear_layers
from flexgen.memory.hysteresis_law import element_rate
from flexgen.model.elements import RobotModel
from flexgen.uncertainty.sources import Sources

CHANGE = 1e-4  # of a source, in differences; of a torque and a step, over their largest


@dataclass(frozen=True)
class Gears:
    """Elements of some robots: ``K``, ``W`` (robots, layers, n_g), and ``n``, ``gamma`` (layers, n_g) of all."""

    K: np.ndarray
    W: np.ndarray
    n: np.ndarray
    gamma: np.ndarray

    @cached_property
    def laws(self) -> list[tuple[float, float, np.ndarray]]:
        """Each exponent and gamma, and the elements (layers, n_g) that have it."""
        pairs = {(float(n), float(g)) for n, g in zip(self.n.ravel(), self.gamma.ravel(), strict=True)}
        return [(n, g, (self.n == n) & (self.gamma == g)) for n, g in sorted(pairs)]

    def slope(self, z: np.ndarray, s: np.ndarray) -> np.ndarray:
        """dz/dp in the direction ``s``."""
        x = s[..., None, :] * np.clip(z / np.where(self.W > 0.0, self.W, 1.0), -1.0, 1.0)
        slopes = np.empty(x.shape)
        for n, gamma, own in self.laws:
            slopes[..., own] = element_rate(1.0, x[..., own], 1.0, n, gamma)
        return np.where(self.W > 0.0, self.K * slopes, 0.0)

    def step(self, z: np.ndarray, dp: np.ndarray) -> np.ndarray:
        """Torques after deflections have changed by ``dp`` (..., n_g)."""
        s, h = np.where(dp < 0.0, -1.0, 1.0), dp[..., None, :]
        k1 = self.slope(z, s)
        k2 = self.slope(z + h / 2 * k1, s)
        k3 = self.slope(z + h / 2 * k2, s)
        return np.asarray(z + h / 6 * (k1 + 2 * k2 + 2 * k3 + self.slope(z + h * k3, s)))


def gears_of(models: list[RobotModel]) -> Gears:
    """The elements of robots of one kind."""
    layers = [gear_layers(model) for model in models]
    K, W = (np.array([[getattr(x, name) for x in each] for each in layers]) for name in ("stiffness", "slip"))
    return Gears(K, W, *(np.array([getattr(x, name) for x in layers[0]]) for name in ("exponent", "gamma")))


@dataclass(frozen=True)
class PlannedGears:
    """Elements along the planned motion: its deflections ``p`` and torques ``z`` (k, layers, n_g); ``rows`` P (n_g, n).

    ``sources`` and ``model``: from whose errors the elements of other robots follow.
    """

    model: RobotModel
    sources: Sources
    rows: np.ndarray
    p: np.ndarray
    z: np.ndarray

    def robots(self, errors: np.ndarray) -> RobotGears:
        """Robots whose sources have these errors (robots, sources)."""
        return RobotGears(self, gears_of([self._robot(x) for x in self.sources.values(errors)]))

    def linear(self) -> LinearGears:
        """Derivatives of the torques in each source."""
        n = len(self.sources.names)
        parts = [self.robots(sign * CHANGE * np.eye(n)).gears for sign in (1.0, -1.0)]
        return LinearGears(self, gears_of([self.model]), parts[0], parts[1])

    def _robot(self, values: np.ndarray) -> RobotModel:
        names = [parameter.name for parameter in self.sources.parameters]
        return with_values(self.model, dict(zip(names, values.tolist(), strict=True)))


class RobotGears:
    """The torques of robots, from step to step of the motion."""

    def __init__(self, plan: PlannedGears, gears: Gears) -> None:
        self.plan, self.gears = plan, gears
        self.z = np.zeros(gears.K.shape)

    def after(self, k: int, change: np.ndarray) -> np.ndarray:
        """Torques at the instant k, where the deflections of deviations have changed by ``change`` (robots, n_g)."""
        return self.gears.step(self.z, change + self.plan.p[k] - self.plan.p[k - 1])

    def torque(self, k: int, z: np.ndarray) -> np.ndarray:
        """Torques (robots, n_g) in addition to those of the plan."""
        return np.asarray((z - self.plan.z[k]).sum(axis=1))

    def tangent(self, k: int, z: np.ndarray, change: np.ndarray) -> np.ndarray:
        """How they rise with the deflection (robots, n_g)."""
        s = np.where(change + self.plan.p[k] - self.plan.p[k - 1] < 0.0, -1.0, 1.0)
        return np.asarray(self.gears.slope(z, s).sum(axis=1))


class LinearGears:
    """Derivatives (sources, layers, n_g) of the torques in the sources, from step to step of the motion."""

    def __init__(self, plan: PlannedGears, own: Gears, more: Gears, less: Gears) -> None:
        self.plan, self.z = plan, np.zeros(more.K.shape)
        first, dp = plan.z[:-1], np.diff(plan.p, axis=0)
        small = CHANGE * np.where(own.W[0] > 0.0, own.W[0], 1.0)
        self._by_z = (own.step(first + small, dp) - own.step(first - small, dp)) / (2 * small)
        s = np.where(dp < 0.0, -1.0, 1.0)
        self._by_p = own.slope(plan.z[1:], s)
        self._more, self._less = more, less

    def after(self, k: int, change: np.ndarray) -> np.ndarray:
        """Derivatives at the instant k, where those of the deflections have changed by ``change`` (sources, n_g)."""
        plan = self.plan
        first, dp = np.broadcast_to(plan.z[k - 1], self.z.shape), (plan.p[k] - plan.p[k - 1])[None]
        own = (self._more.step(first, dp) - self._less.step(first, dp)) / (2 * CHANGE)
        return np.asarray(self._by_z[k - 1] * self.z + self._by_p[k - 1] * change[:, None] + own)

    def torque(self, k: int, z: np.ndarray) -> np.ndarray:
        """Derivatives (sources, n_g) of the torques of the gears."""
        return np.asarray(z.sum(axis=1))

    def tangent(self, k: int, z: np.ndarray, change: np.ndarray) -> np.ndarray:
        """How the torques of the model rise with the deflection (n_g,)."""
        return np.asarray(self._by_p[k - 1].sum(axis=0))


def plan_gears(model: RobotModel, sources: Sources, motion: dict[str, np.ndarray]) -> PlannedGears:
    """The elements of a model along the motion of its plan, from rest."""
    back, gears = np.linalg.inv(model.eta), gears_of([model])
    rows = np.zeros((model.n_g, model.dof))
    rows[:, model.n_a :] = back[:, list(model.i_m)]
    rows[np.arange(model.n_g), list(model.i_g)] = -1.0
    p = np.hstack([motion["q_a"], motion["q_m"][:, list(model.i_m)]]) @ rows.T
    z = np.zeros((len(p), *gears.K.shape[1:]))
    for k in range(1, len(p)):
        z[k] = gears.step(z[None, k - 1], (p[k] - p[k - 1])[None])[0]
    return PlannedGears(model, sources, rows, p, z)
