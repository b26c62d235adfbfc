"""A known force on the tool in a planned motion: constant, or over the place on the path, the path
parameter.

Over the place it is a quintic spline with equal intervals, f(s) = sum_j c_j B(n s - j + 2), with
the cardinal spline B on [-3, 3] written for CasADi by powers of positive parts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.paths.force.place_force import force_along, make_place_force
from flexgen.paths.path import Path

if TYPE_CHECKING:
    from flexgen.paths.force.process_force import ProcessForce

INTERVALS = (25, 50, 100)  # of the spline
CLOSE = 1e-3  # of the size of the force: largest error of the spline
CHECKED = 2001  # places
PARTS = ((1, 3), (-6, 2), (15, 1))  # B(u) = sum_k weight_k max(edge_k - |u|, 0)^5 / 120


@dataclass(frozen=True)
class PlanForce:
    """Force and torque on the tool (6,) [N, N m], world axes.

    ``coefficients``: (n + 5, 6) of the spline, or (1, 6) where it is constant; ``given``: over the
    place from 0 to 1.
    """

    coefficients: np.ndarray
    given: ProcessForce

    @property
    def constant(self) -> bool:
        """Whether it is the same everywhere."""
        return len(self.coefficients) == 1

    def of(self, s: ca.SX | None) -> ca.SX:
        """The force as an expression of the path parameter; None where there is none."""
        if self.constant or s is None:
            return ca.SX(ca.DM(self.coefficients[0]))
        count = len(self.coefficients)
        u = ca.fabs((count - 5) * s - ca.DM(range(count)) + 2)
        basis = sum(weight * ca.fmax(edge - u, 0) ** 5 for weight, edge in PARTS) / 120
        return ca.mtimes(ca.DM(self.coefficients).T, basis)

    def at(self, s: np.ndarray) -> np.ndarray:
        """Values (n, 6) at the path parameters ``s`` (n,)."""
        if self.constant:
            return self.coefficients[np.zeros(len(s), int)]
        return np.asarray(basis_at(s, len(self.coefficients) - 5) @ self.coefficients)

    def along(self, path: Path) -> Callable[[np.ndarray], np.ndarray]:
        """Values (n, 6) as a function of instants (n,) [s] on a path."""
        return force_along(self.given, path)

    def pushing(self, equations: Equations, s: float | None, what: str = "") -> Equations:
        """The equations under the force at the path parameter ``s``; ArgumentError, with ``what``
        in it, where the force depends on s and s is None.
        """
        if s is None and not self.constant:
            raise ArgumentError(
                f"{what}: given within a problem whose force depends on the place, expected at "
                "its start or its end, where the place is known"
            )
        return equations.pushed_by(self.at(np.array([s or 0.0]))[0])


def basis_at(s: np.ndarray, count: int) -> np.ndarray:
    """Values (n, count + 5) of the basis of the spline with ``count`` intervals."""
    u = np.abs(count * s[:, None] - np.arange(count + 5) + 2)
    parts = [weight * np.maximum(edge - u, 0.0) ** 5 for weight, edge in PARTS]
    return np.asarray(sum(parts) / 120)


def make_plan_force(given: Any, equations: Equations, free: bool) -> PlanForce:
    """The force from the argument ``force``; ``free``: the path parameter is an unknown of the
    problem.

    ArgumentError for another type, for a force over the path parameter where the problem has no
    unknown one, and for a force that changes too quickly along the path.
    """
    if isinstance(given, list | tuple | np.ndarray) and np.ndim(given) == 1:
        held = make_place_force(np.tile(given, (2, 1)), equations.model, 1)
        return PlanForce(held.at(np.zeros(1)), held)
    force = make_place_force(given, equations.model, 1)
    if not free:
        raise ArgumentError(
            "force: given over the place on the path, which the motion need not follow with "
            "timing='given'; expected a constant force (3,) [N], or timing='free' and "
            "problem.follow(...)"
        )
    s = np.linspace(0.0, 1.0, CHECKED)
    values = force.at(s)
    size = max(float(np.abs(values).max()), 1e-300)
    for count in INTERVALS:
        basis = basis_at(s, count)
        coefficients = np.linalg.lstsq(basis, values, rcond=None)[0]
        error = float(np.abs(basis @ coefficients - values).max())
        if error <= CLOSE * size:
            return PlanForce(coefficients, force)
    raise ArgumentError(
        f"force: given one that changes too quickly: a spline of {INTERVALS[-1]} intervals "
        f"along the path is up to {error / size:.2g} of its size from it, expected {CLOSE:g}; "
        "smooth it, or plan a shorter path"
    )
