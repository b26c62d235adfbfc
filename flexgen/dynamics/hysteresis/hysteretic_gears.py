"""Deflections of gears with hysteresis that carry given torques.

    tau_g = spring(p) + D p' + sum z_i,    z_i: see `flexgen.dynamics.hysteresis.hysteresis_law`

As long as the deflection p moves in one direction s, each z is a function of it, by Dahl's law

    z = s W + (z_r - s W) exp(-s K_h (p - p_r)/W),

from the point (p_r, z_r) at which it reversed last. So between two reversals a damped gear is one
scalar differential equation, D p' = tau_g(t) - spring(p) - z(p), integrated by Radau IIA with
three stages; an undamped one is an equation for p. Reversals are located within the sampling
intervals, in which the torque is a quintic. All gears advance side by side.

Source: P. R. Dahl, Solid friction damping of mechanical vibrations, AIAA Journal 14(12), 1976.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import Evaluator
from flexgen.base.numerics.tableaus import radau
from flexgen.dynamics.hysteresis.hysteresis import Layer, gear_layers
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.dynamics.mechanics.statics import gear_damping, gear_deflection

NEWTON = 60
SECANTS = 60
REVERSALS = 8
SOLVED = 1e-9  # relative: last step of Newton's method; its square is left
INSTANT = 1e-11  # of a step: error of the instant of a reversal, whose square moves the deflection
TABLE = radau(3)


@dataclass
class Branch:
    """The branch of each gear: where it reversed last, ``p_r`` (n_g,), ``z_r`` of each layer, its
    direction ``s``.
    """

    p_r: np.ndarray
    z_r: np.ndarray
    s: np.ndarray
    layers: Sequence[Layer]
    springs: Evaluator  # at the stages of a step, by columns

    def __post_init__(self) -> None:
        self.start = np.zeros_like(self.z_r)
        self.present = np.any([layer.present for layer in self.layers], axis=0)

    def elements(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torques of the elements (layers, 3, n_g) at deflections of the three stages (3, n_g),
        and their slopes.
        """
        found = []
        for layer, z_r, start in zip(self.layers, self.z_r, self.start, strict=True):
            way = self.s * layer.stiffness * (p - self.p_r) / layer.divisor
            found.append(layer.along(way, z_r, self.s, start))
        return np.array([z for z, _ in found]), np.array([rise for _, rise in found])

    def torque(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Torque of spring and hysteresis at deflections of the three stages (3, n_g), its slope,
        and z.
        """
        value, slope = (x.T for x in self.springs(p.T))
        z, rise = (x.sum(axis=0) for x in self.elements(p))
        return value + z, slope + rise, z

    def turn(self, turned: np.ndarray, p: np.ndarray) -> None:
        """The gears ``turned`` reverse at the deflections ``p`` (n_g,)."""
        z = self.elements(np.tile(p, (3, 1)))[0][:, 0]
        self.p_r = np.where(turned, p, self.p_r)
        self.z_r = np.where(turned, z, self.z_r)
        self.s = np.where(turned, -self.s, self.s)
        paths = [
            layer.paths(self.s * x / layer.divisor)
            for layer, x in zip(self.layers, self.z_r, strict=True)
        ]
        self.start = np.where(turned, paths, self.start)


def hysteretic_deflections(
    equations: Equations, t: np.ndarray, tau_g: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
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
    layers = gear_layers(model)
    spring = equations.function("gear_law")
    elastic = np.array([not gear.rigid for gear, _ in gears(model)])
    D = np.where(elastic, gear_damping(equations), 0.0)
    start = gear_deflection(equations, tau_g[:1, :, 0])[0]
    springs = Evaluator(spring.map(len(TABLE.c)))
    direction = np.where(tau_g[0, :, 1] < 0.0, -1.0, 1.0)
    branch = Branch(start, np.zeros((len(layers), model.n_g)), direction, layers, springs)
    stage = _Stage(D, elastic, branch)
    p = np.empty(tau_g.shape[:2])
    z = np.zeros(tau_g.shape[:2])
    p[0] = start
    for k in range(1, len(t)):
        p[k], z[k] = stage.advance(p[k - 1], t[k] - t[k - 1], tau_g[k - 1], tau_g[k])
    return p, z


@dataclass
class _Stage:
    """The equation of all gears over a step: damping ``D`` (n_g,), and the branches on which they
    are.
    """

    D: np.ndarray
    elastic: np.ndarray
    branch: Branch

    def advance(
        self, p: np.ndarray, h: float, left: np.ndarray, right: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Deflections (n_g,) [rad or m] and torques z of the hysteresis after a step of ``h`` [s]
        from ``p`` (n_g,).

        ``left``, ``right`` (n_g, 3): torques of the gears and two derivatives at both ends. Where
        a gear reverses within the step, its branch begins anew there.
        """
        begin = np.zeros(len(p))
        branch = self.branch
        c = _quintic(h, left, right)
        for _ in range(REVERSALS):
            end, rate, z = self.solve(p, begin, np.ones(len(p)), h, c)
            turned = self.elastic & branch.present & (branch.s * rate < 0.0)
            if not turned.any():
                break
            instant, reversal = self.find_reversal(p, begin, turned, branch.s * rate, h, c)
            branch.turn(turned, reversal)
            p = np.where(turned, reversal, p)
            begin = np.where(turned, instant, begin)
        return end, z

    def find_reversal(
        self,
        p: np.ndarray,
        begin: np.ndarray,
        turned: np.ndarray,
        last: np.ndarray,
        h: float,
        c: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Instants, parts of a step, at which p' of the gears ``turned`` vanishes, and deflections
        there.

        Illinois' method, all gears that turn at once; ``last``: rates at the end of the step, in
        their directions.
        """
        low = begin
        high = np.ones(len(p))
        at = begin
        # the rate at the begin may be that of another reversal
        f_low = -last
        f_high = last
        side = np.zeros(len(p))
        for _ in range(SECANTS):
            before = at
            at = np.where(
                turned, low + (high - low) * f_low / np.where(turned, f_low - f_high, 1.0), begin
            )
            found, rate, _ = self.solve(p, begin, at, h, c)
            f = self.branch.s * rate
            moving = f > 0.0
            low = np.where(moving, at, low)
            high = np.where(moving, high, at)
            f_low = np.where(moving, f, np.where(side < 0, f_low / 2, f_low))
            f_high = np.where(moving, np.where(side > 0, f_high / 2, f_high), f)
            side = np.where(moving, 1, -1)
            if (np.abs(at - before)[turned] <= INSTANT).all() or not f[turned].any():
                break
        return at, found

    def solve(
        self, p: np.ndarray, begin: np.ndarray, finish: np.ndarray, h: float, c: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Deflections at ``finish``, the sign of their rates, and z, from ``p`` at ``begin``,
        (n_g,) parts of a step of ``h`` [s].

        ``c``: coefficients of the torque tau over a step. Damped gears: ``D p' = tau - f(p)`` by
        one step of Radau IIA, Newton's method for its three stages; undamped ones: ``f(p) = tau``
        at each stage, and the sign is that of tau'.
        """
        A = TABLE.A
        damped = self.D > 0.0
        size = (finish - begin) * h
        at = begin + TABLE.c[:, None] * (finish - begin)
        torque = c[0] + at * (c[1] + at * (c[2] + at * (c[3] + at * (c[4] + at * c[5]))))
        x = np.tile(p, (3, 1))
        D = np.where(damped, self.D, 1.0)
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
            if np.abs(step).max() <= SOLVED * (1e-3 + np.abs(x).max()):
                break
        else:
            raise SolverError(
                "hysteresis: no deflection of the gears carries their torques between two "
                "samples; expected finite torques and a spring whose torque rises with its "
                "deflection"
            )
        value, _, z = self.branch.torque(x)
        u = at[-1]
        later = c[1] + u * (2 * c[2] + u * (3 * c[3] + u * (4 * c[4] + u * 5 * c[5])))
        return x[-1], np.where(damped, torque[-1] - value[-1], later), z[-1]


def _quintic(h: float, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Coefficients (6, n_g) of the quintic polynomial in the part, 0 to 1, of a step of ``h`` [s],
    with value and two derivatives ``left``, ``right`` (n_g, 3) at its ends.
    """
    f0 = left[:, 0]
    d0 = h * left[:, 1]
    s0 = h * h * left[:, 2] / 2
    a = right[:, 0] - f0 - d0 - s0
    b = h * right[:, 1] - d0 - 2 * s0
    c = h * h * right[:, 2] - 2 * s0
    return np.stack(
        [f0, d0, s0, 10 * a - 4 * b + c / 2, -15 * a + 7 * b - c, 6 * a - 3 * b + c / 2]
    )
