"""Laws of motors, gears and beams by hand, and rules of series by repeated derivatives."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from hysteretic import hysteretic
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import flexgen
from flexgen.base.spec.parts import Beam, Bending
from flexgen.dynamics.dae import taylor_series
from flexgen.dynamics.hysteresis.lugre import MotorBristles, bristle_rates, bristle_torques
from flexgen.dynamics.mechanics import statics
from flexgen.dynamics.mechanics.beam import modal_beam
from flexgen.dynamics.mechanics.equations import derive
from flexgen.simulation.integration.hysteretic_rate import hysteretic_rate, slip_torques


@pytest.mark.parametrize("code", taylor_series.RULES)
def test_rules_of_series_are_repeated_derivatives(code: int) -> None:
    """Up to order 6 at two points, against CasADi's
    derivatives in time.
    """
    t = ca.SX.sym("t")
    rule = taylor_series.RULES[code]
    points = np.array(
        [[0.7, 0.4, -0.3, 0.2, 0.5, -0.1, 0.3], [1.3, -0.6, 0.2, 0.7, -0.4, 0.1, 0.2]]
    )
    others = np.array(
        [[1.9, 0.3, 0.6, -0.2, 0.1, 0.4, -0.5], [0.8, 0.5, -0.1, 0.3, 0.2, -0.6, 0.1]]
    )
    if code == ca.OP_CONSTPOW:
        others = np.array([[3.0, *[0.0] * 6]] * 2)
    found = rule(points[:, :, None], others[:, :, None])
    for k, (a, b) in enumerate(zip(points, others, strict=True)):
        x, y = (ca.SX(sum(float(c) * t**n for n, c in enumerate(row))) for row in (a, b))
        unary = code in (
            ca.OP_NEG,
            ca.OP_TWICE,
            ca.OP_SQ,
            ca.OP_INV,
            ca.OP_SQRT,
            ca.OP_EXP,
            ca.OP_LOG,
            ca.OP_SIN,
            ca.OP_COS,
            ca.OP_TAN,
            ca.OP_SINH,
            ca.OP_COSH,
            ca.OP_TANH,
            ca.OP_ATAN,
            ca.OP_ASINH,
            ca.OP_FABS,
            ca.OP_SIGN,
            ca.OP_NOT,
            ca.OP_ASSIGN,
        )
        value = x
        if code != ca.OP_ASSIGN:
            value = ca.SX.unary(code, x) if unary else ca.SX.binary(code, x, y)
        for order in range(7):
            expected = float(ca.Function("f", [t], [value])(0.0)) / math.factorial(order)
            assert found[k, order, 0] == pytest.approx(expected, rel=1e-9, abs=1e-10), (
                code,
                order,
            )
            value = ca.jacobian(value, t)


@pytest.mark.parametrize(
    ("base", "power"), [(1.5, 0.0), (-1.5, 1.0), (-1.5, 8.0), (1.5, 9.0), (1.5, 2.5), (1.5, -1.0)]
)
def test_powers_of_series_are_products_or_exponentials(base: float, power: float) -> None:
    """Small whole ones of negative numbers, too, which have no logarithm."""
    a = np.array([[[base], [0.3], [-0.2], [0.1]]])
    b = np.array([[[power], [0.0], [0.0], [0.0]]])
    found = taylor_series.RULES[ca.OP_CONSTPOW](a, b)[0, :, 0]
    t = np.linspace(-1e-2, 1e-2, 9)
    assert np.polynomial.polynomial.polyval(t, found) == pytest.approx(
        np.polynomial.polynomial.polyval(t, a[0, :, 0]) ** power, rel=1e-6
    )


def test_torques_of_hysteresis_follow_the_law_of_dahl() -> None:
    """``dz/dt = K_h (w - |w| z / W)``: w is the rate of deflection, W the torque at which gears
    slip.
    """
    model = hysteretic("elbow", share=0.4)
    inputs, outputs = hysteretic_rate(derive(model))
    at = ca.Function("at", inputs, outputs[:2])
    rng = np.random.default_rng(3)
    n = model.dof
    x = 0.1 * rng.normal(size=2 * n)
    z = np.array([0.3, -0.6]) * slip_torques(model)
    _, found = at(x, z, np.zeros(2))
    arm = x[n : n + 2]
    motor = x[n + 2 :]
    rate = np.linalg.inv(model.eta) @ motor - arm
    springs = np.array([e.dofs[0].gear.spring.stiffness for e in model.elements])
    slip = 0.5 * np.pi / 180 / 60 * springs
    assert_allclose(slip_torques(model), slip)
    expected = 0.4 * springs * (rate - np.abs(rate) * z / slip)
    assert_allclose(np.array(found).ravel(), expected, rtol=1e-6)


def test_torques_of_bristles_follow_their_law() -> None:
    """``z' = v - |v| s0 z / g(v)``, torque ``s0 z + s1 z'``: in expressions, and along a motion
    that reverses.
    """
    rows = [(0.4, 0.6, 2.0, 300.0, 0.5), (0.3, 0.3, 1.0, 200.0, 0.2), (0.0, 0.0, 1.0, 0.0, 0.0)]
    law = MotorBristles(*np.array(rows).T)

    def rate(j: int, v: float, y: float) -> float:
        coulomb, static, speed = rows[j][:3]
        return v - abs(v) * y / (coulomb + (static - coulomb) * np.exp(-((v / speed) ** 2)))

    v, y = (ca.SX.sym(name, 3) for name in "vy")
    at = ca.Function("at", [v, y], list(bristle_rates(law, v, y)))
    speeds = [1.3, -0.7, 2.0]
    torques = [0.2, -0.1, 0.0]
    found = [np.array(x).ravel() for x in at(speeds, torques)]
    z = [rate(j, speeds[j], torques[j]) for j in range(2)]
    assert_allclose(found[0], [300.0 * z[0], 200.0 * z[1], 0.0])
    assert_allclose(found[1], [0.2 + 0.5 * z[0], -0.1 + 0.2 * z[1], 0.0])
    # from rest to rest
    t = np.linspace(0.0, 0.5, 501)
    w = 4 * np.pi
    way = np.outer(3.0 * np.sin(w * t) ** 3, [1.0, -0.5, 1.0])
    slope = np.outer(9.0 * w * np.sin(w * t) ** 2 * np.cos(w * t), [1.0, -0.5, 1.0])
    along = bristle_torques(law, t, way, slope)
    for j, gain in enumerate((1.0, -0.5)):
        speed = lambda x, gain=gain: gain * 3.0 * np.sin(w * x) ** 3  # noqa: E731
        stiffness, damping = rows[j][3:]

        def right(x, y, j=j, speed=speed, k=stiffness):
            return [k * rate(j, speed(x), y[0])]

        exact = solve_ivp(
            right, (0.0, 0.5), [0.0], "LSODA", t, rtol=1e-8, atol=1e-10, max_step=2e-3
        ).y[0]
        expected = [y + damping * rate(j, speed(x), y) for x, y in zip(t, exact, strict=True)]
        assert_allclose(along[:, j], expected, atol=2e-6)
    assert not along[:, 2].any()


def test_modes_of_a_beam_bend_in_their_direction() -> None:
    bendings = (Bending("z", 300.0, 2, 0.01), Bending("y", 500.0, 1, 0.02))
    found = modal_beam(Beam(0.7, 2.0, bendings))
    assert found.direction.tolist() == [[0, 0, 1], [0, 0, 1], [0, 1, 0]]
    assert found.mass == pytest.approx(1.4)
    assert found.s0 == pytest.approx(1.4 * 0.35) and found.j0 == pytest.approx(1.4 * 0.7**2 / 3)
    first = 1.87510406871**4  # (beta L)^4 of a cantilever
    omega = found.stiffness[0, 0] / found.m2[0, 0]
    assert omega == pytest.approx(first * 300.0 / (2.0 * 0.7**4), rel=1e-6)


def test_motors_hold_an_arm_by_the_deflections_of_its_springs() -> None:
    """``q_m = N (q + tau / k)``, ``tau_m = tau / N``: the gravity of two links by hand, in the
    plane of the elbow.
    """
    model = flexgen.read("elbow")
    q = np.array([0.4, -0.7])
    g = 9.81
    upper, fore = (element.body for element in model.elements)
    length = 1.150
    first = -upper.mass * g * upper.com[2] * np.sin(q[0]) - fore.mass * g * length * np.sin(q[0])
    behind = -fore.mass * g * fore.com[0] * np.cos(q.sum())
    torque = np.array([first + behind, behind])
    found = statics.equilibrium_at(derive(model), q)
    assert_allclose(found.tau_g, torque, rtol=1e-12)
    stiffness = np.array([7.5189e6, 4.0999e6])
    ratio = np.array([1872 / 7, 757 / 3])
    assert_allclose(found.q_m - ratio * q, ratio * torque / stiffness, rtol=1e-9)
    assert_allclose(found.tau_m, torque / ratio, rtol=1e-9)
    assert found.q_a.tolist() == q.tolist()
