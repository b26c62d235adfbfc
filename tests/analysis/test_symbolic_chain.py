"""The symbolic chain of printed equations against frames in numbers, whose Jacobians are
differences.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from flexgen.analysis.printing.chain import SymbolicChain, polynomial_ring
from flexgen.analysis.printing.elements import (
    Joint,
    Mass,
    Return,
    Rotor,
    Shift,
    Symbols,
    Tip,
    Turn,
)

VALUES = dict(zip("lmipjbfwxy", (0.7, 3.0, 0.4, 0.2, 0.05, 0.6, 0.9, 0.3, 0.6, 0.8), strict=True))


def steps_of(symbols: Symbols) -> list[Any]:
    """A turn, a slide, a branch with a rotor, and turns about fixed and quarter angles."""
    s = {name: symbols.parameter(name, (), value, "1", name) for name, value in VALUES.items()}
    zero = sp.Integer(0)
    one = sp.Integer(1)
    inertia = {(i, j): zero for i in range(3) for j in range(3)}
    body = inertia | {
        (0, 0): s["i"],
        (1, 1): 2 * s["i"],
        (2, 2): s["i"],
        (0, 1): s["p"],
        (1, 0): s["p"],
    }
    return [
        Shift((s["l"], zero, zero)),
        Joint(0, (zero, zero, one), True),
        Turn(0, 1),
        Mass(s["m"], (s["l"], zero, s["l"]), body, s["b"]),
        Tip("first"),
        Shift((zero, s["l"], zero)),
        Joint(1, (s["x"], s["y"], zero), False),
        Turn(1, s["f"]),
        Mass(s["m"], (zero, s["l"], zero), body, zero),
        Return("first"),
        Joint(2, (one, zero, zero), True),
        Rotor(1, s["j"], (zero, one, zero)),
        Turn(2, 3),
        Shift((zero, zero, s["w"])),
        Mass(s["m"], (s["l"], s["w"], zero), body, s["b"]),
    ]


class Frames:
    """Numerical evaluation of the steps: masses, rotors, height and drag at some coordinates."""

    def __init__(self, steps: list[Any], values: dict[Any, float], q: np.ndarray) -> None:
        # spin: angular velocities of the coordinates, world
        R = np.eye(3)
        p = np.zeros(3)
        spin = np.zeros((3, 3))
        self.bodies: list[Any] = []
        self.rotors: list[Any] = []
        tips: dict[str, Any] = {}

        def number(x: Any) -> float:
            factor, symbol = x.as_coeff_Mul()
            return float(factor) * values.get(symbol, 1.0)

        for step in steps:
            match step:
                case Shift():
                    p = p + R @ [number(x) for x in step.by]
                case Turn():
                    angle = (
                        step.angle * np.pi / 2
                        if isinstance(step.angle, int)
                        else values[step.angle]
                    )
                    R = R @ Rotation.from_rotvec(angle * np.eye(3)[step.axis]).as_matrix()
                case Joint():
                    axis = np.array([number(x) for x in step.axis])
                    if step.rotation:
                        spin = spin.copy()
                        spin[:, step.index] = R @ axis
                        R = R @ Rotation.from_rotvec(q[step.index] * axis).as_matrix()
                    else:
                        p = p + R @ axis * q[step.index]
                case Mass():
                    own = np.array(
                        [[number(step.inertia[i, j]) for j in range(3)] for i in range(3)]
                    )
                    com = p + R @ [number(x) for x in step.com]
                    self.bodies.append(
                        (number(step.mass), com, R @ own @ R.T, spin, number(step.drag))
                    )
                case Tip():
                    tips[step.name] = R, p, spin
                case Return():
                    R, p, spin = tips[step.name]
                case Rotor():
                    axis = R @ [number(x) for x in step.axis]
                    self.rotors.append((step.index, number(step.inertia), axis @ spin))


def test_inertia_potential_drag_and_speeds_are_those_of_frames() -> None:
    """Bodies, a rotor that is carried along, and a branch; Christoffel terms by differences of the
    inertia.
    """
    symbols = Symbols()
    q_a = sp.symbols("q1:4", real=True)
    v = sp.symbols("v1:6", real=True)
    steps = steps_of(symbols)
    ring = polynomial_ring(symbols, steps, q_a, v)
    chain = SymbolicChain(ring, q_a, 2, (sp.Integer(0), sp.Integer(0), sp.Rational(-981, 100)))
    for step in steps:
        chain.element(step)
    values: dict[Any, float] = {
        entry.symbol: float(entry.value or 0.0) for entry in symbols.entries
    }
    at = np.array([0.3, 0.2, -0.8])
    speeds = np.array([0.5, -0.7, 0.9, 3.0, -2.0])
    numbers = values | dict(zip(q_a, at, strict=True)) | dict(zip(v, speeds, strict=True))

    point = [numbers[x] for x in ring.constants] + [
        f(numbers[x]) for x in ring.angles for f in (np.cos, np.sin)
    ]

    def value(x: Any) -> float:
        return float(
            sum(float(factor) * np.prod(np.power(point, powers)) for powers, factor in x.terms())
        )

    def inertia(q: np.ndarray) -> np.ndarray:
        M = np.zeros((5, 5))
        h = 1e-6
        here = Frames(steps, values, q)
        moved = [[Frames(steps, values, q + s * h * e) for s in (1, -1)] for e in np.eye(3)]
        for k, (mass, _, turned, spin, _) in enumerate(here.bodies):
            J = np.stack([(a.bodies[k][1] - b.bodies[k][1]) / (2 * h) for a, b in moved], axis=1)
            M[:3, :3] += mass * J.T @ J + spin.T @ turned @ spin
        for index, J_m, seen in here.rotors:
            row = np.concatenate([seen, np.eye(2)[index]])
            M += J_m * np.outer(row, row)
        return M

    M = inertia(at)
    assert_allclose([[value(x) for x in row] for row in chain.M], M, atol=1e-8)
    frames = Frames(steps, values, at)
    assert value(chain.potential) == pytest.approx(
        9.81 * sum(m * com[2] for m, com, *_ in frames.bodies)
    )
    drag = sum(b * spin.T @ spin for *_, spin, b in frames.bodies)
    assert_allclose([[value(x) for x in row] for row in chain.D], drag, atol=1e-12)
    slopes = np.stack(
        [(inertia(at + 1e-4 * e) - inertia(at - 1e-4 * e)) / 2e-4 for e in np.eye(3)], axis=2
    )
    slopes = np.concatenate([slopes, np.zeros((5, 5, 2))], axis=2)
    terms = slopes + slopes.transpose(0, 2, 1) - slopes.transpose(2, 1, 0)
    found = [value(x) for x in chain.velocity_terms(v)]
    assert_allclose(found, 0.5 * np.einsum("ijk,j,k->i", terms, speeds, speeds), atol=1e-5)
