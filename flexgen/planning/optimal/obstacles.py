"""Obstacles, and the distance of points of the arm from them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from flexgen.base.checks.type_checks import checked_class
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.arguments import check_not_negative, check_positive, is_number
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.planning.optimal.arguments import numbers_of

SAME = 1e-9  # m: corners of the chain that are as close are one point


@checked_class
@dataclass(frozen=True)
class Sphere:
    """A ball that the arm stays out of: ``center`` (3,) [m], world axes, and ``radius`` [m].

    Examples
    --------
    >>> problem = flexgen.plan_problem("planar5_nmp", mesh=20)
    >>> problem.avoid(flexgen.Sphere(center=(0.3, 1.5, 0.0), radius=0.1), margin=0.02)  # m
    """

    center: tuple[float, float, float]
    radius: float
    name: str = ""

    def __post_init__(self) -> None:
        _check_vector("center", self.center)
        check_positive("radius", self.radius)


@checked_class
@dataclass(frozen=True)
class HalfSpace:
    """A wall: the arm stays where ``normal . p >= offset``; ``normal`` (3,) is normalized,
    ``offset`` [m].

    Examples
    --------
    >>> problem = flexgen.plan_problem("planar5_nmp", mesh=20)
    >>> problem.avoid(flexgen.HalfSpace(normal=(0.0, 1.0, 0.0), offset=-0.1))  # y >= -0.1 m
    """

    normal: tuple[float, float, float]
    offset: float
    name: str = ""

    def __post_init__(self) -> None:
        _check_vector("normal", self.normal)
        if not np.linalg.norm(self.normal) > 0 or not is_number(self.offset):
            raise ArgumentError(
                f"normal: given {self.normal!r}, {self.offset!r}, expected a direction and a "
                "length"
            )


Obstacle = Sphere | HalfSpace


def _check_vector(name: str, value: tuple[float, float, float]) -> None:
    text = f"{name}: given {value!r}, expected three finite numbers"
    if numbers_of(value, text).shape != (3,):
        raise ArgumentError(text)


def arm_points(equations: Equations, q_a: ca.SX, samples: int) -> ca.SX:
    """Points (3, k) of the arm [m]: the corners of the chain, and ``samples`` (0 to 20) more on
    each link.

    Points that do not move with the arm are left out; ArgumentError where none does.
    """
    if isinstance(samples, bool) or not isinstance(samples, int) or not 0 <= samples <= 20:
        raise ArgumentError(f"samples: given {samples!r}, expected 0 to 20")
    corners = equations.function("chain_points")(q_a)
    home = evaluate(equations.function("chain_points"), np.zeros(equations.model.n_a))[0][0]
    columns = ca.horzsplit(corners)
    kept = [
        k
        for k in range(len(columns))
        if k == 0 or np.linalg.norm(home[:, k] - home[:, k - 1]) > SAME
    ]
    points = [columns[kept[0]]]
    for a, b in pairwise(kept):
        points += [
            columns[a] + (columns[b] - columns[a]) * ((j + 1) / (samples + 1))
            for j in range(samples)
        ]
        points.append(columns[b])
    moving = [point for point in points if ca.depends_on(point, q_a)]
    if not moving:
        raise ArgumentError(
            f"obstacles: model {equations.model.name} has no point that moves, expected an arm"
        )
    return ca.horzcat(*moving)


def distance_rows(
    equations: Equations, q_a: ca.SX, obstacle: Obstacle, margin: float, samples: int
) -> ca.SX:
    """Rows (k,) [m] that are >= 0 where the points of the arm are out of the obstacle, ``margin``
    [m] away from it; ``samples`` as for `arm_points`.

    For a sphere ``(|p - c|^2 - r^2) / (2 r)``, which is smooth everywhere; near the surface it is
    the distance.
    """
    if not isinstance(obstacle, Sphere | HalfSpace):
        raise ArgumentError(f"obstacle: given {obstacle!r}, expected a Sphere or a HalfSpace")
    check_not_negative("margin", margin, "a finite number >= 0, in m")
    points = arm_points(equations, q_a, samples)
    if isinstance(obstacle, HalfSpace):
        normal = np.asarray(obstacle.normal, float) / np.linalg.norm(obstacle.normal)
        return ca.mtimes(ca.DM(normal).T, points).T - obstacle.offset - margin
    r = obstacle.radius + margin
    away = points - ca.repmat(ca.DM(np.asarray(obstacle.center, float)), 1, points.shape[1])
    return (ca.sum1(away**2).T - r**2) / (2 * r)
