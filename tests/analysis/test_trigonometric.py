"""Polynomials in sines and cosines: normal forms, values, derivatives, rotations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from flexgen.analysis.printing import trigonometric
from flexgen.analysis.printing.trigonometric import TrigonometricRing
from flexgen.base.errors import ArgumentError


def test_equal_trigonometric_polynomials_are_equal_and_their_forms_have_the_same_values() -> None:
    m, v, q1, q2 = sp.symbols("m v q1 q2")
    ring = TrigonometricRing([m, v], [q1, q2], heavy=[m], light=[v], absolute=[[1, 0], [1, 1]])
    c1 = ring.cos(q1)
    s1 = ring.sin(q1)
    c2 = ring.cos(q2)
    s2 = ring.sin(q2)
    assert ring.reduce(s1**4 + 2 * s1**2 * c1**2 + c1**4) == ring.one
    assert ring.reduce(s1**3) == ring.reduce(s1 - s1 * c1**2)
    mass = ring.element(m)
    assert (
        ring.element(sp.Rational(3, 4) * m) == sp.QQ(3, 4) * mass
        and ring.element(-2) == -2 * ring.one
    )
    sum_cos = c1 * c2 - s1 * s2
    sum_sin = s1 * c2 + c1 * s2
    polynomials = [
        sum_cos * mass + 3 * c1,
        sum_sin**2 * mass * ring.element(v) ** 2 - s2 * c2 * mass,
    ]

    def at(expression: Any) -> float:
        return float(sp.lambdify([m, v, q1, q2], expression, "math")(1.3, -0.7, 0.4, 1.1))

    names = {
        made(q).as_expr(): function(q)
        for q in (q1, q2)
        for made, function in ((ring.cos, sp.cos), (ring.sin, sp.sin))
    }
    for p in polynomials:
        p = ring.reduce(p)
        plain = p.as_expr().xreplace(names)
        found = ring.expression(p)
        assert at(found) == pytest.approx(at(plain), rel=1e-12)
        assert sp.count_ops(found) <= sp.count_ops(plain)
        for by in (q1, q2, m, v):
            slope = ring.diff(p, by).as_expr().xreplace(names)
            assert at(slope) == pytest.approx(at(sp.diff(plain, by)), rel=1e-12)
    assert ring.expression(ring.reduce(sum_cos)) == sp.cos(q1 + q2)
    assert ring.expression(ring.reduce(c1**2 - s1**2)) == sp.cos(2 * q1)
    axis = [ring.zero, ring.one * sp.QQ(3, 5), ring.one * sp.QQ(4, 5)]
    turn = ring.rotation(axis, c1, s1)
    expected = Rotation.from_rotvec([0, 0.6 * 0.4, 0.8 * 0.4]).as_matrix()
    numbers = [[at(x.as_expr().xreplace(names)) for x in row] for row in turn]
    assert_allclose(numbers, expected, atol=1e-15)
    a = [c1, s1, mass]
    b = [ring.one, c2, s2]
    x, y = (np.array([at(e.as_expr().xreplace(names)) for e in each]) for each in (a, b))
    found = [at(e.as_expr().xreplace(names)) for e in ring.cross(a, b)]
    assert_allclose(found, np.cross(x, y))
    assert at(ring.dot(a, b).as_expr().xreplace(names)) == pytest.approx(x @ y)


def test_symbols_of_unit_vectors_have_the_length_one(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y, z, q = sp.symbols("x y z q")
    ring = TrigonometricRing([x, y, z], [q], unit_vectors=[(x, y, z)])
    ex, ey, ez = (ring.element(s) for s in (x, y, z))
    assert (
        ring.reduce(ex**2 + ey**2 + ez**2) == ring.one and ring.reduce(ez**2) == 1 - ex**2 - ey**2
    )
    monkeypatch.setattr(trigonometric, "MAX_TERMS", 12)
    ring.reduce(sum((ex**i for i in range(12)), ring.zero))
    with pytest.raises(
        ArgumentError,
        match=r"^symbolic: given a model whose equations have more than 12 terms in one",
    ):
        ring.reduce(sum((ex**i for i in range(13)), ring.zero))
