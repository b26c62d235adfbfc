"""Forces with a state in robots that differ from the model, along a motion and deviations from it.

A part l of coordinate k, a gear or a motor, has a torque y that depends on the deflections or
angles p that were:

    y_+ = step(y, dp),    tau = sum_l (A y_+ - B y)

On a robot acts -P' (tau - tau_0), P: rows of p, tau_0: torques of the model along the planned
motion. The laws are in `flexgen.studies.tolerances.gear_states` and
`flexgen.studies.tolerances.bristle_states`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flexgen.dynamics.mechanics.parameters import with_values
from flexgen.model.elements import RobotModel
from flexgen.studies.tolerances.sources import Sources

CHANGE = 1e-4  # of a source, in differences; of a torque, over its largest


class Law(Protocol):
    """The parts of some robots: arrays (robots, parts, rows), which may be of one robot."""

    @property
    def largest(self) -> np.ndarray:
        """Torques that they do not exceed by much; 1 where there is none."""

    @property
    def weights(self) -> tuple[np.ndarray, np.ndarray]:
        """A and B."""

    def step(self, y: np.ndarray, dp: np.ndarray) -> np.ndarray:
        """Torques after p has changed by ``dp`` (..., rows)."""

    def rise(self, y: np.ndarray, after: np.ndarray, dp: np.ndarray) -> np.ndarray:
        """Derivative of `step` in ``dp``; ``after``: the torques y_+ after the step."""


@dataclass(frozen=True)
class PlannedStates:
    """States along the planned motion: its ``p`` (k, rows) and torques ``y`` (k, parts, rows);
    ``rows`` P (rows, n).

    ``sources`` and ``model``: from whose errors other robots follow. ``law_of``: their law.
    """

    model: RobotModel
    sources: Sources
    law_of: Callable[[list[RobotModel]], Law]
    rows: np.ndarray
    p: np.ndarray
    y: np.ndarray

    def robots(self, errors: np.ndarray) -> RobotStates:
        """Robots whose sources have these errors (robots, sources)."""
        return RobotStates(self, self._law(errors))

    def linear(self) -> LinearStates:
        """Derivatives of the torques in each source."""
        n = len(self.sources.names)
        parts = [self._law(sign * CHANGE * np.eye(n)) for sign in (1.0, -1.0)]
        return LinearStates(self, self.law_of([self.model]), parts[0], parts[1])

    def _law(self, errors: np.ndarray) -> Law:
        """The law of robots with these errors (robots, sources)."""
        names = [parameter.name for parameter in self.sources.parameters]
        values = self.sources.values(errors)
        return self.law_of(
            [with_values(self.model, dict(zip(names, x.tolist(), strict=True))) for x in values]
        )


def plan_states(
    model: RobotModel,
    sources: Sources,
    law_of: Callable[[list[RobotModel]], Law],
    rows: np.ndarray,
    p: np.ndarray,
) -> PlannedStates:
    """The states of a model along the ``p`` (n, count) of its plan, from rest; ``law_of``: makes
    the law of some robots, ``rows``: from deviations of coordinates to those of p.
    """
    law = law_of([model])
    y = np.zeros((len(p), *law.largest.shape[1:]))
    for k in range(1, len(p)):
        y[k] = law.step(y[None, k - 1], (p[k] - p[k - 1])[None])[0]
    return PlannedStates(model, sources, law_of, rows, p, y)


class States(ABC):
    """Common base of both: deviations of the last step, and torques of the plan."""

    def __init__(self, plan: PlannedStates, shape: tuple[int, ...]) -> None:
        self.plan = plan
        self.y = np.zeros(shape)
        self.before = np.zeros((shape[0], shape[-1]))

    def start(self, d: np.ndarray) -> None:
        """Deviations (robots, n) at rest before the motion."""
        self.before = d @ self.plan.rows.T

    def at(self, k: int, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces (robots, n) in addition to those of the plan at the instant k, and their
        derivative (..., n, n).
        """
        change = d @ self.plan.rows.T - self.before
        P = self.plan.rows
        torque, rise = self._torque(k, change)
        return torque @ P, (P.T * rise[..., None, :]) @ P

    def keep(self, k: int, d: np.ndarray) -> None:
        """Go to the instant k."""
        p = d @ self.plan.rows.T
        self.y = self._after(k, p - self.before)
        self.before = p

    @abstractmethod
    def _after(self, k: int, change: np.ndarray) -> np.ndarray:
        """Torques of the parts at the instant k, where p has changed by ``change`` in addition to
        the plan.
        """

    @abstractmethod
    def _torque(self, k: int, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torques (robots, rows) in addition to those of the plan, and their derivatives in
        ``change``.
        """


class RobotStates(States):
    """The torques of robots, from step to step of the motion."""

    def __init__(self, plan: PlannedStates, law: Law) -> None:
        """``law``: of the robots; the torque of the plan's states is subtracted later."""
        super().__init__(plan, law.largest.shape)
        self.law = law
        own = plan.law_of([plan.model])
        A, B = own.weights
        self._planned = (A * plan.y - B * np.concatenate([0 * plan.y[:1], plan.y[:-1]])).sum(
            axis=1
        )

    def _after(self, k: int, change: np.ndarray) -> np.ndarray:
        return self.law.step(self.y, change + self.plan.p[k] - self.plan.p[k - 1])

    def _torque(self, k: int, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torque of the states at instant k less that of the plan, and its derivative in p;
        ``change`` (robots, count): deviation of p from the plan.
        """
        A, B = self.law.weights
        after = self._after(k, change)
        dp = change + self.plan.p[k] - self.plan.p[k - 1]
        rise = A * self.law.rise(self.y, after, dp)
        return np.asarray((A * after - B * self.y).sum(axis=1) - self._planned[k]), np.asarray(
            rise.sum(axis=1)
        )


class LinearStates(States):
    """Derivatives (sources, parts, rows) of the torques in the sources, from step to step of the
    motion.
    """

    def __init__(self, plan: PlannedStates, own: Law, more: Law, less: Law) -> None:
        """Derivatives of a step along the plan in the state, in p and in each source, by central
        differences: ``own`` is the law of the model, ``more`` and ``less`` those with one source
        changed by `CHANGE`.
        """
        super().__init__(plan, more.largest.shape)
        first = plan.y[:-1]
        after = plan.y[1:]
        dp = np.diff(plan.p, axis=0)
        small = CHANGE * own.largest[0]
        self._by_y = (own.step(first + small, dp) - own.step(first - small, dp)) / (2 * small)
        self._by_p = own.rise(first, after, dp)
        self._by_number = (
            more.step(first[:, None], dp[:, None]) - less.step(first[:, None], dp[:, None])
        ) / (2 * CHANGE)
        self._own = own
        self._more = more
        self._less = less

    def _after(self, k: int, change: np.ndarray) -> np.ndarray:
        moved = self._by_y[k - 1] * self.y + self._by_p[k - 1] * change[:, None]
        return np.asarray(moved + self._by_number[k - 1])

    def _torque(self, k: int, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Change of ``A y_k - B y_(k-1)``, summed over the layers, to first order in each source,
        and its derivative in p; ``change`` (sources, count): deviation of p at instant k.

        The states y change, and so do the weights A and B, by which the planned states are
        multiplied.
        """
        A, B = self._own.weights
        of_weights = [
            (x - y) / (2 * CHANGE)
            for x, y in zip(self._more.weights, self._less.weights, strict=True)
        ]
        planned = of_weights[0] * self.plan.y[k] - of_weights[1] * self.plan.y[k - 1]
        torque = A * self._after(k, change) - B * self.y + planned
        return np.asarray(torque.sum(axis=1)), np.asarray(
            (A * self._by_p[k - 1]).reshape(self.y.shape[1:]).sum(axis=0)
        )
