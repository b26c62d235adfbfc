"""The chain of a small model as polynomials: what the closed-form equations are put together
from.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import sympy as sp
from scipy.spatial.transform import Rotation

from flexgen.analysis.printing.elements import (
    Expr3,
    Joint,
    Mass,
    Return,
    Rotor,
    Shift,
    Step,
    Symbols,
    Tip,
    Turn,
)
from flexgen.analysis.printing.trigonometric import Element as Polynomial
from flexgen.analysis.printing.trigonometric import (
    Matrix3,
    TrigonometricRing,
    Vector3,
    accumulate_angles,
)


class SymbolicChain:
    """Inertia ``M`` of arm and rotors, drag ``D``, potential and tool position along a chain.

    ``R``, ``p``: the current frame in the world. ``Jv``, ``Jw``: one vector for each coordinate,
    the velocity of the frame's origin and the angular velocity by that coordinate's speed, in the
    current frame.
    """

    def __init__(
        self, ring: TrigonometricRing, q_a: tuple[sp.Symbol, ...], n_m: int, gravity: Expr3
    ) -> None:
        n = len(q_a)
        zero = ring.zero
        self.ring = ring
        self.q_a = q_a
        self.n = n
        self.weight = [-ring.element(x) for x in gravity]
        self.R: Matrix3 = [[ring.one if i == j else zero for j in range(3)] for i in range(3)]
        self.p: Vector3 = [zero] * 3
        self.Jv: list[Vector3] = [[zero] * 3 for _ in range(n)]
        self.Jw: list[Vector3] = [[zero] * 3 for _ in range(n)]
        size = range(n + n_m)
        self.M: list[list[Polynomial]] = [[zero for _ in size] for _ in size]  # of arm and rotors
        self.D: list[list[Polynomial]] = [[zero for _ in range(n)] for _ in range(n)]
        self.potential = zero
        self._tips = {"base": (self.R, self.p, self.Jv, self.Jw)}

    def element(self, step: Step) -> None:
        """Walk one step of the chain: move the current frame, add a body's or a rotor's inertia,
        or keep and restore the frame at a branch.
        """
        ring = self.ring
        if isinstance(step, Shift):
            self._shift([ring.element(x) for x in step.by])
        elif isinstance(step, Turn):
            self._turn([ring.element(int(k == step.axis)) for k in range(3)], step.angle)
        elif isinstance(step, Joint):
            axis = [ring.element(x) for x in step.axis]
            if step.rotation:
                self._turn(axis, self.q_a[step.index])
                self.Jw[step.index] = axis
            else:
                self._shift([x * ring.element(self.q_a[step.index]) for x in axis])
                self.Jv[step.index] = axis
        elif isinstance(step, Mass):
            self._mass(step)
        elif isinstance(step, Tip):
            self._tips[step.name] = self.R, self.p, self.Jv, self.Jw
        elif isinstance(step, Return):
            self.R, self.p, self.Jv, self.Jw = self._tips[step.name]
        else:
            axis = [ring.element(x) for x in step.axis]
            seen = [ring.dot(axis, Jw) for Jw in self.Jw]
            seen += [
                ring.one if j == step.index else ring.zero for j in range(len(self.M) - self.n)
            ]
            self._add(self.M, ring.element(step.inertia), seen, seen)

    def _turn(self, axis: Vector3, angle: sp.Symbol | int) -> None:
        """Turn the current frame about ``axis``, in its own axes, by a symbol or a number of
        quarter turns; position and velocities are expressed in the new frame.
        """
        ring = self.ring
        if isinstance(angle, int):
            c = ring.element((1, 0, -1, 0)[angle % 4])
            s = ring.element((0, 1, 0, -1)[angle % 4])
        else:
            c = ring.cos(angle)
            s = ring.sin(angle)
        turn = ring.rotation(axis, c, s)
        columns = [list(column) for column in zip(*turn, strict=True)]
        self.R = [ring.multiply(columns, row) for row in self.R]
        self.Jv = [ring.multiply(columns, v) for v in self.Jv]
        self.Jw = [ring.multiply(columns, w) for w in self.Jw]

    def _shift(self, by: Vector3) -> None:
        self.p = [x + y for x, y in zip(self.p, self.ring.multiply(self.R, by), strict=True)]
        self.Jv = self._move_point(by)

    def _move_point(self, by: Vector3) -> list[Vector3]:
        """Velocities of the point ``by`` of the current frame."""
        turned = [self.ring.cross(w, by) for w in self.Jw]
        return [
            [x + y for x, y in zip(v, t, strict=True)]
            for v, t in zip(self.Jv, turned, strict=True)
        ]

    def _mass(self, body: Mass) -> None:
        """Add a body that is fixed in the current frame: inertia M, rotational drag D and
        potential.
        """
        ring = self.ring
        m = ring.element(body.mass)
        com = [ring.element(x) for x in body.com]
        inertia = [[ring.element(body.inertia[i, j]) for j in range(3)] for i in range(3)]
        # x, y, z of the velocities by each coordinate
        rows = list(zip(*self._move_point(com), strict=True))
        spins = list(zip(*self.Jw, strict=True))
        for k in range(3):
            self._add(self.M, m, rows[k], rows[k])
            self._add(self.D, ring.element(body.drag), spins[k], spins[k])
            for j in range(3):
                self._add(self.M, inertia[k][j], spins[k], spins[j])
        height = [x + y for x, y in zip(self.p, ring.multiply(self.R, com), strict=True)]
        self.potential = ring.reduce(self.potential + m * ring.dot(self.weight, height))

    def _add(
        self,
        to: list[list[Polynomial]],
        factor: Polynomial,
        a: Sequence[Polynomial],
        b: Sequence[Polynomial],
    ) -> None:
        """``to += factor a b'``."""
        if factor:
            for i, x in enumerate(a):
                for j, y in enumerate(b):
                    if x and y:
                        to[i][j] = self.ring.reduce(to[i][j] + factor * self.ring.reduce(x * y))

    def velocity_terms(self, speeds: Sequence[sp.Symbol]) -> list[Polynomial]:
        """Coriolis and centrifugal terms of arm and rotors: Christoffel symbols of ``M``, which
        depends on q_a only.
        """
        ring = self.ring
        v = [self.ring.element(s) for s in speeds]
        n = len(speeds)
        slope = [
            [[ring.diff(self.M[i][j], q) for q in self.q_a] for j in range(n)] for i in range(n)
        ]

        def d(i: int, j: int, k: int) -> Polynomial:
            return slope[i][j][k] if k < self.n else ring.zero

        half = ring.element(sp.Rational(1, 2))
        return [
            ring.reduce(
                sum(
                    (
                        (d(i, j, k) + d(i, k, j) - d(j, k, i)) * half * v[j] * v[k]
                        for j in range(n)
                        for k in range(n)
                    ),
                    ring.zero,
                )
            )
            for i in range(n)
        ]


def polynomial_ring(
    symbols: Symbols, steps: Sequence[Step], q_a: tuple[sp.Symbol, ...], v: Sequence[sp.Symbol]
) -> TrigonometricRing:
    """The ring in which the equations of a chain are polynomials.

    Its constants are parameters with a value, its angles those of rotations and of placements.
    Symbolic unit vectors give relations; joints about parallel axes let sums of angles be printed.
    """
    values = {entry.symbol: entry.value for entry in symbols.entries if entry.value is not None}
    fixed = [
        step.angle for step in steps if isinstance(step, Turn) and not isinstance(step.angle, int)
    ]
    units = []
    turning = []
    heavy = []
    same: list[int] = []
    axis = None  # of the joint before, in the current frame
    for step in steps:
        if isinstance(step, Turn) and axis is not None:
            angle = step.angle * math.pi / 2 if isinstance(step.angle, int) else values[step.angle]
            axis = Rotation.from_rotvec(-angle * np.eye(3)[step.axis]).apply(axis)
        elif isinstance(step, Joint):
            free = tuple(x for x in step.axis if x.is_Symbol)
            units += [free] if free else []
            if step.rotation:
                turning.append(q_a[step.index])
                new = np.array([float(values.get(x, x)) for x in step.axis])
                along = 0.0 if axis is None else float(new @ axis)
                same.append(round(along) if abs(abs(along) - 1) < 1e-9 else 0)
                axis = new
        elif isinstance(step, Return):
            axis = None
        elif isinstance(step, Mass):
            heavy += [
                x
                for x in dict.fromkeys([step.mass, step.drag, *step.inertia.values()])
                if x.is_Symbol
            ]
        elif isinstance(step, Rotor):
            free = tuple(x for x in step.axis if x.is_Symbol)
            units += [free] if free else []
            heavy += [step.inertia] if step.inertia.is_Symbol else []
    slides = [q for q in q_a if q not in turning]
    constants = [symbol for symbol in values if symbol not in fixed]
    rows = accumulate_angles([*same, *[0] * len(fixed)])
    return TrigonometricRing([*constants, *slides, *v], [*turning, *fixed], units, heavy, v, rows)
