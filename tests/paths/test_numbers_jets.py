"""Derivatives, quaternions and trigonometric polynomials against definitions; splines of forces;
masses of arms.
"""

from __future__ import annotations

import math
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from numpy.polynomial import Polynomial
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.analysis.printing import trigonometric
from flexgen.analysis.printing.trigonometric import TrigonometricRing
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.inertia import mass_matrix
from flexgen.paths.geometry import jets
from flexgen.paths.geometry.trigonometry import root, sine_cosine
from flexgen.planning.optimal import force as planned
from flexgen.views.plots import canvas

RNG = np.random.default_rng(6)


# --- elementary functions ------------------------------------------------------------------------
def test_sine_cosine_and_root_are_exact_to_rounding() -> None:
    x = np.concatenate(
        [RNG.uniform(-1e6, 1e6, 2000), RNG.uniform(-10, 10, 2000), np.arange(-40, 41) * np.pi / 4]
    )
    sine, cosine = sine_cosine(x)
    assert np.abs(sine - [math.sin(v) for v in x]).max() <= 2.3e-16
    assert np.abs(cosine - [math.cos(v) for v in x]).max() <= 2.3e-16
    small = np.array([1e-300, 1e-9, -3e-8])
    assert_allclose(sine_cosine(small)[0], small, rtol=4e-16)
    for value in (1e6 + 1e-3, -2e6, np.nan):
        assert np.isnan(sine_cosine(np.array([value]))).all()
    assert np.isfinite(sine_cosine(np.array([1e6, -1e6]))).all()
    y = 10.0 ** RNG.uniform(-290, 290, 500)
    assert_allclose(root(y), np.sqrt(y), rtol=2.3e-16)
    assert_array_equal(root(np.array([0.0, -4.0, 1e300, np.inf])), [0.0, -4.0, 1e300, np.inf])
    assert_array_equal(root(np.array([4.0, 0.25, 16.0, 1.0])), [2.0, 0.5, 4.0, 1.0])


def jet(p: Polynomial, t: float, size: int = 6) -> np.ndarray:
    return np.array([p.deriv(k)(t) if k else p(t) for k in range(size)])


def test_jets_are_derivatives() -> None:
    f = Polynomial([2.0, -1.0, 0.5, 0.3, 0.2, -0.1])
    g = Polynomial([0.7, 0.4, -0.6, 0.2])
    t = 0.3
    a = jet(f, t)
    b = jet(g, t)
    assert_allclose(jets.product(a, b), jet(f * g, t))
    assert jets.product(a[:3], b).shape == (3,)
    assert_allclose(jets.product(jets.reciprocal(a), a), [1, 0, 0, 0, 0, 0], atol=1e-12)
    assert_allclose(jets.square_root(jets.product(a, a)), a)
    outer = jet(f, float(g(t)))[None, None]
    assert_allclose(jets.compose(outer, b[None])[0, 0], jet(f(g), t))
    whole = Polynomial([0.0, 1.0, 0.2, 0.4, 0.1])  # s(u)
    u = jets.inverse_function(np.array([t]), jet(whole.deriv(), t, 5)[None])
    s = jets.compose(jet(whole, t)[None, None], u)[0, 0]
    assert_allclose(s, [whole(t), 1, 0, 0, 0, 0], atol=1e-10)


def test_quaternions_are_rotations_with_their_rates() -> None:
    first, second = Rotation.random(2, random_state=3)
    p, q = (jets.quaternion(x.as_matrix()) for x in (first, second))
    assert_allclose(np.abs(p), np.abs(np.roll(first.as_quat(), 1)))
    still = jets.quaternion_product(p[None, :, None], q[None, :, None])[:, :, 0]
    assert_allclose(
        jets.matrices_of_quaternions(still)[0], (first * second).as_matrix(), atol=1e-14
    )
    assert_allclose(jets.rotation_vector(p), first.as_rotvec())
    assert_allclose(jets.rotation_vector(-p), first.as_rotvec())
    assert_array_equal(jets.rotation_vector(np.array([1.0, 0, 0, 0])), np.zeros(3))
    # each entry the largest
    for vector in ([3.1, 0, 0], [0, 3.1, 0], [0, 0, 3.1], [0.2, 0.1, -0.3], [-3.0, 0.1, 0.2]):
        R = Rotation.from_rotvec(vector).as_matrix()
        found = jets.quaternion(R)
        assert found[0] >= 0 and np.linalg.norm(found) == pytest.approx(1.0)
        assert_allclose(jets.matrices_of_quaternions(found[None])[0], R, atol=1e-14)
    axis, angle = jets.axis_angle(np.array([0.0, 0.6, 0.8]) * 2.5)
    assert_allclose(axis, [0, 0.6, 0.8])
    assert angle == pytest.approx(2.5) and jets.axis_angle(np.zeros(3))[0].tolist() == [0, 0, 1]
    angles = np.array([0.3, -2.0, 1e-9])
    expected = Rotation.from_rotvec(angles[:, None] * axis).as_matrix()
    assert_allclose(jets.rotation_matrices(axis, angles), expected, atol=1e-15)
    R = second.as_matrix()
    assert_allclose(jets.multiply_rotations(expected, R), expected @ R, atol=1e-15)
    law = Polynomial([0.4, -1.0, 0.5, 0.2, -0.3, 0.1])
    moving = jets.rotation_quaternion(jet(law, 0.3)[None], axis)
    assert_allclose(
        jets.matrices_of_quaternions(moving[:, :, 0])[0],
        Rotation.from_rotvec(law(0.3) * axis).as_matrix(),
    )
    R, w = jets.attitude(moving)
    assert_allclose(w[0], np.outer(axis, jet(law.deriv(), 0.3, 5)), atol=1e-10)
    turned = jets.quaternion_product(moving, np.pad(q[None, :, None], ((0, 0), (0, 0), (0, 5))))
    # of the same motion from another attitude
    assert_allclose(jets.angular_velocity(turned), w, atol=1e-10)


# --- polynomials in sines and cosines ------------------------------------------------------------
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

    names = dict(
        zip(ring._trig, (x for q in (q1, q2) for x in (sp.cos(q), sp.sin(q))), strict=True)
    )
    for p in polynomials:
        p = ring.reduce(p)
        plain = p.as_expr().xreplace(names)
        found = ring.expression(p)
        assert at(found) == pytest.approx(at(plain), rel=1e-12)
        assert sp.count_ops(found) <= sp.count_ops(plain)
        for by in (q1, q2, m, v):
            slope = ring.diff(p, by).as_expr().xreplace(names)
            assert at(slope) == pytest.approx(at(sp.diff(plain, by)), rel=1e-12)
        for form, functions in ring._forms(p):
            assert at(form.as_expr().xreplace(functions)) == pytest.approx(at(plain))
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
    assert trigonometric.MAX_TERMS == 3000
    monkeypatch.setattr(trigonometric, "MAX_TERMS", 12)
    ring.reduce(sum((ex**i for i in range(12)), ring.zero))
    with pytest.raises(
        ArgumentError,
        match=r"^symbolic: given a model whose equations have more than 12 terms in one",
    ):
        ring.reduce(sum((ex**i for i in range(13)), ring.zero))


# --- forces in plans -----------------------------------------------------------------------------
def test_the_spline_of_a_force_is_the_quintic_one_with_equal_knots() -> None:
    """Against SciPy's; in a plan it is an expression of the path parameter."""
    count = 25
    coefficients = RNG.normal(size=(30, 6))
    spline = BSpline((np.arange(36) - 5.0) / count, coefficients, 5)
    s = np.linspace(0.0, 1.0, 77)
    made = planned.PlanForce(coefficients, None)  # type: ignore[arg-type]
    assert_allclose(made.at(s), spline(s), atol=1e-12)
    place = ca.SX.sym("s")
    at = ca.Function("at", [place], [made.of(place)])
    assert_allclose([np.array(at(x)).ravel() for x in s], spline(s), atol=1e-12)
    assert not made.constant
    held = planned.PlanForce(coefficients[:1], None)  # type: ignore[arg-type]
    assert held.constant and held_everywhere(held, s, coefficients[0])
    equations: Any = Made(pushed_by=lambda force: force)
    pushed: Any = [made.pushing(equations, 0.4), held.pushing(equations, None)]
    assert_allclose(pushed, [spline(0.4), coefficients[0]], atol=1e-12)
    with pytest.raises(
        ArgumentError, match=r"^bound: given within a problem whose force depends on the place"
    ):
        made.pushing(equations, None, "bound")


def held_everywhere(held: Any, s: np.ndarray, value: np.ndarray) -> bool:
    return (
        bool((held.at(s) == value).all())
        and np.array(ca.DM(held.of(None))).ravel().tolist() == value.tolist()
    )


def test_forces_that_change_quickly_are_refused_in_a_plan() -> None:
    """Waves along the path: with as many intervals as they need, up to a hundred."""
    equations = derive("elbow")
    s = np.linspace(0.0, 1.0, 801)
    intervals = []
    for waves in (1, 6, 14):
        wave = np.outer(np.sin(2 * np.pi * waves * s), [30.0, 0.0, 20.0])
        found = planned.make_plan_force(wave, equations, True)
        intervals.append(len(found.coefficients) - 5)
        assert_allclose(found.at(s)[:, :3], wave, atol=0.06)
    assert intervals == [25, 50, 100]
    with pytest.raises(
        ArgumentError, match=r"changes too quickly: a spline of 100 intervals .*, expected 0\.001"
    ):
        planned.make_plan_force(
            np.outer(np.sin(2 * np.pi * 40 * s), [30.0, 0.0, 20.0]), equations, True
        )
    with pytest.raises(
        ArgumentError, match="which the motion need not follow with timing='given'"
    ):
        planned.make_plan_force(wave, equations, False)
    assert planned.make_plan_force([3.0, 0.0, 1.0], equations, False).constant


# --- masses --------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["elbow", "manutec_r3", "two_arm"])
def test_the_numeric_mass_matrix_is_that_of_the_equations(name: str) -> None:
    model = flexgen.read(name)
    q = RNG.uniform(-1, 1, model.n_a)
    M = np.array(derive(model).function("mass_matrix")(q))
    i_g = list(model.i_g)
    rigid = [j for j in range(model.n_m) if j not in model.i_m]
    rotors = np.diag([model.motors[j].inertia for j in rigid])
    M[np.ix_(i_g, i_g)] += model.eta[rigid].T @ rotors @ model.eta[rigid]  # of rigid gears
    assert_allclose(mass_matrix(model, q), M, atol=1e-10 * np.abs(M).max())


# --- plots ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("largest", "unit", "prefix"),
    [
        (0.99e-7, "m", "nm"),
        (1.01e-7, "m", "µm"),
        (0.99e-3, "rad", "µrad"),
        (1.01e-3, "m", "mm"),
        (2.0, "N m", "N m"),
    ],
)
def test_prefixes_of_units(largest: float, unit: str, prefix: str) -> None:
    factor, found = canvas.choose_prefix(-largest, unit)
    assert found == prefix and factor == {"n": 1e9, "µ": 1e6, "m": 1e3, "N": 1.0}[prefix[0]]
    assert canvas.choose_prefix(1e-5, "rad or m") == (1e6, "µrad or µm")


def test_ticks_of_logarithmic_axes_are_powers() -> None:
    assert [canvas.power(x) for x in (0, 1.0, 10.0, 1e-3, -1e12, 100.0)] == [
        "0",
        "1",
        "10",
        "10⁻³",
        "\N{MINUS SIGN}10¹²",
        "10²",
    ]
