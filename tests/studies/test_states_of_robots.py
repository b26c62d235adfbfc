"""Gears and bristles with a state: their laws by integration, robots that differ by their own
laws, derivatives by differences of robots.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from bristled import bristled, tables
from hysteretic import BENT, with_elements
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import flexgen
from flexgen.base.spec.memory import Hysteresis
from flexgen.dynamics.mechanics.parameters import with_values
from flexgen.studies.tolerances.bristle_states import Bristles, bristles_of
from flexgen.studies.tolerances.gear_states import Gears, gear_rows, gears_of
from flexgen.studies.tolerances.memory_states import plan_states
from flexgen.studies.tolerances.sources import Sources, sources_of


def test_gears_follow_their_law_in_small_steps() -> None:
    """Against an integration of the law; planted numbers of two robots, two layers, two gears, one
    of them without.
    """
    K = np.array([[[100.0, 50.0], [30.0, 0.0]], [[80.0, 60.0], [20.0, 0.0]]])
    W = np.array([[[0.2, 0.1], [0.3, 0.0]], [[0.25, 0.15], [0.2, 0.0]]])
    n = np.array([[1.0, 2.0], [1.7, 1.0]])
    gamma = np.array([[0.0, 0.5], [-0.4, 0.0]])
    laws = [
        [Hysteresis(1.0, 1.0, *pair) for pair in zip(*layer, strict=True)]
        for layer in zip(n, gamma, strict=True)
    ]
    gears = Gears(K, W, tuple(map(tuple, laws)))
    assert_allclose(gears.largest, np.where(W > 0, W, 1.0))
    assert [float(x) for x in gears.weights] == [1.0, 0.0]

    def rate(z: float, s: float, at: tuple[int, ...]) -> float:
        x = z / W[at]
        g = gamma[at[1:]]
        return K[at] * (1.0 - s * abs(x) ** n[at[1:]] * (np.sign(x) * (1 - g) + s * g))

    for way in (1e-5, -2e-5):
        z0 = np.array([0.3, -0.5])[:, None, None] * W
        found = gears.step(z0, np.array([[way, 1.5 * way], [-way, way]]))
        for at in np.ndindex(*K.shape):
            if W[at] == 0.0:
                assert found[at] == 0.0
                continue
            dp = [[way, 1.5 * way], [-way, way]][at[0]][at[2]]
            s = np.sign(dp)
            exact = solve_ivp(
                lambda p, z, s=s, at=at: rate(z[0], s, at),
                (0, dp),
                [z0[at]],
                rtol=1e-11,
                atol=1e-13,
            )
            assert found[at] == pytest.approx(exact.y[0, -1], rel=1e-7)
    dp = np.array([[2e-4, -1e-4], [-2e-4, 3e-4]])
    after = gears.step(z0, dp)
    h = 1e-8
    rise = (gears.step(z0, dp + h) - gears.step(z0, dp - h)) / (2 * h)
    assert_allclose(gears.rise(z0, after, dp), rise, rtol=1e-5, atol=1e-6)
    assert_allclose(gears.slope(0 * z0, np.zeros((2, 2)) + 1.0), np.where(W > 0, K, 0.0))
    # no more than at the slip torque
    assert_allclose(gears.slope(2 * W, np.ones((2, 2)))[W > 0], 0.0, atol=1e-12)


def test_bristles_follow_their_law_at_a_constant_speed() -> None:
    h = 1e-3
    numbers = {
        "coulomb": 0.5,
        "static": 0.8,
        "stribeck_speed": 0.2,
        "stiffness": 300.0,
        "damping": 0.7,
    }
    given = {name: np.array([[[x, 0.0]]]) for name, x in numbers.items()}
    given["stribeck_speed"][..., 1] = 1.0  # the second motor has none
    law = Bristles(**given, h=h)
    assert_allclose(law.largest, [[[0.8, 1.0]]])
    after, before = law.weights
    assert_allclose(before, [[[0.7 / (300.0 * h), 0.0]]])
    assert_allclose(after, 1.0 + before)
    for v, y0 in ((0.3, 0.2), (-0.3, 0.2), (-2.0, -0.4), (0.05, 0.0)):
        level = 0.5 + 0.3 * np.exp(-((v / 0.2) ** 2))
        exact = solve_ivp(
            lambda t, y, v=v, g=level: 300.0 * (v - abs(v) * y / g),
            (0, h),
            [y0],
            rtol=1e-11,
            atol=1e-13,
        )
        y = np.array([[[y0, 0.0]]])
        dp = np.array([[v * h, v * h]])
        found = law.step(y, dp)
        assert_allclose(found[0, 0], [exact.y[0, -1], 0.0], rtol=1e-7)
        slope = (
            300.0 * max(1.0 - np.sign(v) * y0 / level, 0.0) * np.exp(-300.0 * abs(v) * h / level)
        )
        assert_allclose(law.rise(y, found, dp)[0, 0], [slope, 0.0], rtol=1e-9)
    still = law.step(np.array([[[0.3, 0.0]]]), np.zeros((1, 2)))
    assert_allclose(still, [[[0.3, 0.0]]])
    assert law.rise(np.zeros((1, 1, 2)), still, np.zeros((1, 2)))[0, 0].tolist() == [300.0, 0.0]
    over = law.rise(np.array([[[2.0, 0.0]]]), still, np.array([[1e-4, 0.0]]))
    assert over[0, 0, 0] == 0.0  # above the limit the torque does not rise


def states_of(kind: str) -> tuple[flexgen.RobotModel, Sources, Any, np.ndarray]:
    """A robot with states, its sources, its law and the rows of their angles."""
    table = {"uncertainty": {"stiffness": 0.1, "friction": 0.2, "lost_motion": 0.3}}
    if kind == "gears":
        model = with_elements("elbow", BENT, **table)
        return model, sources_of(model, model.uncertainty), gears_of, gear_rows(model)
    model = bristled("elbow", tables("elbow"), **table)
    rows = np.eye(model.dof)[model.n_a :]
    return (
        model,
        sources_of(model, model.uncertainty),
        lambda robots: bristles_of(robots, 1e-3),
        rows,
    )


@pytest.mark.parametrize("kind", ["gears", "bristles"])
def test_robots_with_states_differ_as_their_laws_do(kind: str) -> None:
    """Forces along a deviation are those of each robot's own law less those of the plan;
    derivatives by differences.
    """
    model, table, law_of, rows = states_of(kind)
    t = np.linspace(0.0, 1.0, 40)[:, None]
    p = (3e-4 if kind == "gears" else 0.02) * np.sin(7 * t + [0.0, 1.0]) * [1.0, -0.6]
    p = p - p[0]
    plan = plan_states(model, table, law_of, rows, p)
    own = law_of([model])
    y = np.zeros((1, *own.largest.shape[1:]))
    for k in range(1, len(p)):
        y = own.step(y, (p[k] - p[k - 1])[None])
        assert_allclose(plan.y[k], y[0], rtol=1e-12)
    rng = np.random.default_rng(2)
    errors = 0.1 * rng.standard_normal((3, len(table.names)))
    d = (
        0.1
        * np.abs(p).max()
        * np.sin(np.arange(40)[:, None, None] / 9 + rng.standard_normal((3, model.dof)))
    )
    states = plan.robots(errors)
    states.start(d[0])
    values = table.values(errors)
    names = [x.name for x in table.parameters]
    robots = [with_values(model, dict(zip(names, row.tolist(), strict=True))) for row in values]
    laws = [law_of([robot]) for robot in robots]
    y = [np.zeros((1, *law.largest.shape[1:])) for law in laws]
    planned = np.zeros((1, *own.largest.shape[1:]))
    for k in range(1, len(p)):
        force, rise = states.at(k, d[k])
        A, B = own.weights
        after = own.step(planned, (p[k] - p[k - 1])[None])
        base = (A * after - B * planned).sum(axis=1)[0]
        planned = after
        for i, law in enumerate(laws):
            dp = p[k] - p[k - 1] + rows @ (d[k, i] - d[k - 1, i])
            A, B = law.weights
            after = law.step(y[i], dp[None])
            torque = (A * after - B * y[i]).sum(axis=1)[0]
            assert_allclose(force[i], rows.T @ (torque - base), rtol=1e-9, atol=1e-12)
            slope = (A * law.rise(y[i], after, dp[None])).sum(axis=1)[0]
            assert_allclose(rise[i], rows.T @ np.diag(slope) @ rows, rtol=1e-9, atol=1e-12)
            y[i] = after
        states.keep(k, d[k])


@pytest.mark.parametrize("kind", ["gears", "bristles"])
def test_states_to_first_order_are_differences_of_robots(kind: str) -> None:
    """Small errors and deviations: forces of robots over the error, minus those with the other
    sign.
    """
    model, table, law_of, rows = states_of(kind)
    t = np.linspace(0.0, 1.0, 60)[:, None]
    # no reversal, where slopes jump
    p = (3e-4 if kind == "gears" else 0.02) * (1 - np.cos(3 * t + 0 * rows[:, 0]))
    plan = plan_states(model, table, law_of, rows, p)
    n = len(table.names)
    linear = plan.linear()
    small = 1e-4
    shape = np.random.default_rng(1).standard_normal((n, model.dof))
    size = 0.02 * np.abs(np.diff(p, axis=0)).max()
    pair = [plan.robots(sign * small * np.eye(n)) for sign in (1.0, -1.0)]
    for states in (linear, *pair):
        states.start(np.zeros((n, model.dof)))
    for k in range(1, 40):
        d = size * (k / 40) ** 2 * shape
        force, rise = linear.at(k, d)
        more, less = (
            states.at(k, sign * small * d)[0]
            for states, sign in zip(pair, (1.0, -1.0), strict=True)
        )
        if k > 5:
            assert_allclose(
                force, (more - less) / (2 * small), rtol=2e-2, atol=2e-3 * np.abs(force).max()
            )
        for states, factor in ((linear, 1.0), (pair[0], small), (pair[1], -small)):
            states.keep(k, factor * d)
    step = 1e-6 * size * rows.T @ np.ones(len(rows))
    change = (linear.at(40, d + step)[0] - linear.at(40, d)[0])[0]
    assert_allclose(
        linear.at(40, d)[1] @ step, change, rtol=1e-6, atol=1e-9 * np.abs(change).max()
    )
    assert np.abs(force).max() > 0 and rise.shape == (model.dof, model.dof)


def test_rows_of_gears_are_deflections() -> None:
    model = flexgen.read("manutec_r3")
    rng = np.random.default_rng(0)
    q_a = rng.standard_normal(model.n_a)
    q_m = rng.standard_normal(model.n_m)
    y = np.concatenate([q_a, q_m[list(model.i_m)]])
    expected = np.linalg.solve(model.eta, q_m) - q_a[list(model.i_g)]
    elastic = [
        model.motors[j].name in {model.motors[i].name for i in model.i_m} for j in range(model.n_m)
    ]
    rows = gear_rows(model)
    assert_allclose((rows @ y)[elastic], expected[elastic], rtol=1e-12)
    assert sum(elastic) == 3 and not rows[3:, model.n_a :].any()  # rigid gears have no deflection
