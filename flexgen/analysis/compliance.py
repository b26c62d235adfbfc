"""Compliance of the tool: what a force or a moment there displaces while the motors stand still.

    static  C = J K^-1 J'        dynamic  C(f) = J (K + j w D - w^2 M)^-1 J',    w = 2 pi f

``J`` (6, n): linear, then angular velocity of the tool [m, rad] from the n coordinates that move
with held motors; ``M D K``: the linear robot in these coordinates, with the stiffness of gravity
in ``K``. By reciprocity C is symmetric.

Source: A. Albu-Schaeffer, C. Ott and G. Hirzinger, Int. J. Robotics Research 26 (2007), eq. 15,
for gears alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexgen.analysis.linear import UNDAMPED, LinearModel
from flexgen.analysis.second_order import with_motors_locked
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.statics import Equilibrium

NEAR = np.linspace(-3.0, 3.0, 61)  # half widths of a resonance about which it is sampled
# of the frequencies, in parts of the lowest and the highest natural frequency with held motors
RANGE = (0.05, 3.0)


@dataclass(frozen=True)
class ToolCompliance:
    """Compliance of the tool at a pose with held motors, in the axes of the world.

    ``M D K`` (n, n) and ``J`` (6, n): see the module. Forces and displacements are those of the
    tool's point.
    """

    M: np.ndarray
    D: np.ndarray
    K: np.ndarray
    J: np.ndarray

    @cached_property
    def matrix(self) -> np.ndarray:
        """``C`` (6, 6): displacement [m], rotation [rad] from force [N], moment [N m]."""
        C = self.J @ np.linalg.solve(self.K, self.J.T)
        return np.asarray((C + C.T) / 2)

    def principal(self, rotation: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Principal values (3,), falling, and their directions (3, 3), one a row.

        Displacement along the force [m/N], or with ``rotation`` rotation about the moment [rad/(N
        m)].
        """
        part = slice(3, 6) if rotation else slice(0, 3)
        values, directions = np.linalg.eigh(self.matrix[part, part])
        signs = np.sign(directions[np.abs(directions).argmax(axis=0), range(3)])
        return values[::-1], (directions * signs).T[::-1]

    def response(self, frequency: np.ndarray) -> np.ndarray:
        """``C(f)`` (k, 6, 6), complex, at the frequencies (k,) [Hz]."""
        s = 2j * np.pi * np.asarray(frequency)[:, None, None]
        return np.asarray(
            self.J @ np.linalg.solve(s**2 * self.M + s * self.D + self.K, self.J.T[None])
        )

    @cached_property
    def _roots(self) -> np.ndarray:
        """Poles with held motors that oscillate, one of each pair [1/s]."""
        n = len(self.M)
        lower = np.linalg.solve(self.M, np.hstack([-self.K, -self.D]))
        roots = np.linalg.eigvals(np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower]))
        return np.asarray(roots[roots.imag > 0])

    @cached_property
    def frequencies(self) -> np.ndarray:
        """Frequencies [Hz] that show every resonance with held motors; empty: nothing is
        elastic.
        """
        roots = self._roots
        if not len(roots):
            return np.zeros(0)
        grid = np.geomspace(RANGE[0] * np.abs(roots).min(), RANGE[1] * np.abs(roots).max(), 300)
        near = (roots.imag[:, None] - roots.real[:, None] * NEAR).ravel()
        w = np.concatenate([grid, near])
        return np.sort(w[(w >= grid[0]) & (w <= grid[-1])]) / (2 * np.pi)

    def resonance(self) -> tuple[float, float] | None:
        """Frequency [Hz] and value [m/N] of the largest displacement by a unit force.

        In any direction. The value is infinite where the mode at this frequency has no damping:
        what is computed then is the rounding error of a damping of zero.
        """
        if not len(self.frequencies):
            return None
        largest = np.linalg.norm(self.response(self.frequencies)[:, :3, :3], 2, axis=(1, 2))
        k = int(largest.argmax())
        hz = float(self.frequencies[k])
        root = self._roots[np.abs(self._roots.imag - 2 * np.pi * hz).argmin()]
        undamped = abs(root.real) < UNDAMPED * abs(root)
        return hz, float("inf") if undamped else float(largest[k])

    def to_dict(self) -> dict[str, Any]:
        """As JSON types, SI units."""
        (moved, along) = self.principal()
        (turned, about) = self.principal(rotation=True)
        peak = self.resonance()
        return {
            "matrix": self.matrix.tolist(),
            "principal_m_per_N": moved.tolist(),
            "directions": along.tolist(),
            "principal_rad_per_Nm": turned.tolist(),
            "axes": about.tolist(),
            "resonance_hz": None if peak is None else peak[0],
            "resonance_m_per_N": None if peak is None or np.isinf(peak[1]) else peak[1],
        }


def tool_compliance(
    equations: Equations, rest: Equilibrium, linear: LinearModel
) -> ToolCompliance | None:
    """The compliance of the tool at rest; None where held motors do not hold the arm, as within a
    backlash.
    """
    model = equations.model
    free = with_motors_locked(model)
    J = np.zeros((6, model.dof))
    J[:, : model.n_a] = evaluate(equations.function("jacobian"), rest.q_a)[0][0].reshape(
        6, model.n_a
    )
    M, D, K = (matrix[np.ix_(free, free)] for matrix in (linear.M, linear.D, linear.K))
    if len(free) and np.linalg.eigvalsh((K + K.T) / 2)[0] <= 1e-9 * np.abs(K).max():
        return None
    return ToolCompliance(M, D, K, J[:, free])
