"""Deflections of gears with hysteresis that carry given torques.

    tau_g = spring(p) + D p' + z,    z' = K_h (p' - |p'| z/W)

As long as the deflection p moves in one direction s, z is a function of it,

    z = s W + (z_r - s W) exp(-s K_h (p - p_r)/W),

from the point (p_r, z_r) at which it reversed last. So between two reversals a damped gear is one scalar differential
equation, D p' = tau_g(t) - spring(p) - z(p), integrated by Radau IIA with three stages; an undamped one is an equation
for p. Reversals are located within the sampling intervals, in which the torque is a quintic. All gears advance side by
side.

Source: P. R. Dahl, Solid friction damping of mechanical vibrations, AIAA Journal 14(12), 1976.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.errors import SolverError
from flexgen.mechanics.equations import Equations
from flexgen.mechanics.hysteresis import GearHysteresis, gear_hysteresis
from flexgen.mechanics.lagrangian import gears
from flexgen.mechanics.statics import gear_damping, gear_deflection
from flexgen.numerics.evaluate import Evaluator
from flexgen.numerics.tableaus import radau

NEWTON, BISECTIONS, REVERSALS = 60, 60, 8
ROUNDING, SOLVED = 1e-15, 1e-9  # of the last step of Newton's method: at most, and where it cannot be smaller
TABLE = radau(3)


@dataclass
class _Branch:
    """The branch of each gear: where it reversed last, ``p_r``, ``z_r`` (n_g,), and its direction ``s`` (n_g,)."""

    p_r: np.ndarray
    z_r: np.ndarray
    s: np.ndarray
    law: GearHysteresis
    springs: Evaluator  # at the stages of a step, by columns

    def torque(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Torque of spring and hysteresis at deflections of the three stages (3, n_g), its slope, and z."""
        law, slip = self.law, np.where(self.law.present, self.law.slip, 1.0)
        value, slope = (x.T for x in self.springs(p.T))
        end = self.s * law.slip
        # Newton's method may try a deflection behind the reversal: there the branch is its tangent
        x = self.s * law.stiffness * (p - self.p_r) / slip
        fade, tangent = np.exp(-np.maximum(x, 0.0)), np.minimum(x, 0.0)
        z = end + (self.z_r - end) * fade * (1.0 - tangent)
        rise = law.stiffness * (1.0 - self.s * self.z_r / slip) * fade
        return value + z, slope + np.where(law.present, rise, 0.0), np.where(law.present, z, 0.0)


def hysteretic_deflections(equations: Equations, t: np.ndarray, tau_g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Deflections p of all gears and the torques z of their hysteresis, each (n, n_g), arm side.

    Parameters
    ----------
    equations : Equations
    t : array (n,) [s]
        Instants; the first one at rest.
    tau_g : array (n, n_g, 3)
        Gear torques and their first two time derivatives [N m, N m/s, N m/s^2].
    """
    model = equations.model
    law, spring = gear_hysteresis(model), equations.function("gear_law")
    elastic = np.array([not gear.rigid for gear, _ in gears(model)])
    D = np.where(elastic, gear_damping(equations), 0.0)
    start = gear_deflection(equations, tau_g[:1, :, 0])[0]
    springs = Evaluator(spring.map(len(TABLE.c)))
    branch = _Branch(start, np.zeros(model.n_g), np.where(tau_g[0, :, 1] < 0.0, -1.0, 1.0), law, springs)
    stage = _Stage(D, elastic, branch)
    p, z = np.empty(tau_g.shape[:2]), np.zeros(tau_g.shape[:2])
    p[0] = start
    for k in range(1, len(t)):
        p[k] = stage.advance(p[k - 1], t[k] - t[k - 1], tau_g[k - 1], tau_g[k])
        z[k] = branch.torque(np.tile(p[k], (3, 1)))[2][0]
    return p, z


@dataclass
class _Stage:
    """The equation of all gears over a step: damping ``D`` (n_g,), and the branches on which they are."""

    D: np.ndarray
    elastic: np.ndarray
    branch: _Branch

    def advance(self, p: np.ndarray, h: float, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Deflections after a step of ``h`` [s] from ``p`` (n_g,), torques (n_g, 3) at both ends."""
        begin, branch = np.zeros(len(p)), self.branch
        for _ in range(REVERSALS):
            end, rate = self.solve(p, begin, np.ones(len(p)), h, left, right)
            turned = self.elastic & branch.law.present & (branch.s * rate < 0.0)
            if not turned.any():
                return end
            low, high = begin.copy(), np.where(turned, 1.0, begin)
            # the instant at which p' vanishes: bisection, all gears that turn at once
            for _ in range(BISECTIONS):
                middle = (low + high) / 2
                _, rate = self.solve(p, begin, middle, h, left, right)
                before = branch.s * rate > 0.0
                low, high = np.where(turned & before, middle, low), np.where(turned & ~before, middle, high)
                if (high - low).max() <= ROUNDING:
                    break
            reversal, _ = self.solve(p, begin, low, h, left, right)
            z = branch.torque(np.tile(reversal, (3, 1)))[2][0]
            branch.p_r = np.where(turned, reversal, branch.p_r)
            branch.z_r = np.where(turned, z, branch.z_r)
            branch.s = np.where(turned, -branch.s, branch.s)
            p, begin = np.where(turned, reversal, p), np.where(turned, low, begin)
        return end

    def solve(
        self, p: np.ndarray, begin: np.ndarray, finish: np.ndarray, h: float, left: np.ndarray, right: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Deflections at ``finish`` and the sign of their rates, from ``p`` at ``begin``, both (n_g,) parts of a step.

        Undamped gears: the sign of the rate of the torque.
        """
        A, damped, size = TABLE.A, self.D > 0.0, (finish - begin) * h
        at = begin + TABLE.c[:, None] * (finish - begin)
        c = _quintic(h, left, right)
        torque = np.asarray(sum(c[k] * at**k for k in range(6)))
        later = sum(k * c[k] * at ** (k - 1) for k in range(1, 6))
        x, D = np.tile(p, (3, 1)), np.where(damped, self.D, 1.0)
        for _ in range(NEWTON):
            value, slope, _ = self.branch.torque(x)
            defect = np.where(damped, x - p - size * (A @ ((torque - value) / D)), value - torque)
            matrix = np.where(
                damped[:, None, None],
                np.eye(3) + size[:, None, None] * A * (slope / D).T[:, None, :],
                np.eye(3) * np.where(self.elastic, slope, 1.0).T[:, None, :],
            )
            defect = np.where(self.elastic, defect, 0.0)
            step = np.linalg.solve(matrix, defect.T[:, :, None])[:, :, 0].T
            x = x - step
            if np.abs(step).max() <= ROUNDING * (1e-3 + np.abs(x).max()):
                break
        if not np.abs(step).max() <= SOLVED * (1e-3 + np.abs(x).max()):
            raise SolverError(
                "hysteresis: no deflection of the gears carries their torques between two samples; expected finite "
                "torques and a spring whose torque rises with its deflection"
            )
        value, _, _ = self.branch.torque(x)
        return x[-1], np.where(damped, torque[-1] - value[-1], later[-1])


def _quintic(h: float, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Coefficients (6, n_g) in powers of the part of the step."""
    f0, d0, s0 = left[:, 0], h * left[:, 1], h * h * left[:, 2] / 2
    a, b, c = right[:, 0] - f0 - d0 - s0, h * right[:, 1] - d0 - 2 * s0, h * h * right[:, 2] - 2 * s0
    return np.stack([f0, d0, s0, 10 * a - 4 * b + c / 2, -15 * a + 7 * b - c, 6 * a - 3 * b + c / 2])
