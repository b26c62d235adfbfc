"""Numbers of flexgen/studies/tolerances: laws with a state by integration, robots by matrices,
shares and texts by hand.
"""

from __future__ import annotations

import tomllib
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bristled import bristled, tables
from hysteretic import BENT, with_elements
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.memory import Hysteresis
from flexgen.dynamics.mechanics.parameters import with_values
from flexgen.studies.tolerances import prediction, response
from flexgen.studies.tolerances.bristle_states import Bristles, bristles_of
from flexgen.studies.tolerances.gear_states import Gears, gear_rows, gears_of
from flexgen.studies.tolerances.memory_states import plan_states
from flexgen.studies.tolerances.model_file import with_uncertainty
from flexgen.studies.tolerances.result import Band, Prediction, Share
from flexgen.studies.tolerances.sources import NONE, Sources, of_equations, sources_of


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


def small_sources() -> Sources:
    def named(name: str, value: float, key: str = "element.x") -> Any:
        return SimpleNamespace(name=name, value=value, key=key)

    parameters = (
        named("q1.stiffness", 100.0),
        named("q1.cubic", 5.0),
        named("payload.mass", 2.0),
        named("x", 3.0),
    )
    root = np.array([[1.0, 0.0], [0.6, 0.8], [0.0, 1.0]])
    kinds = ("stiffness", "payload", "delay")
    owner = np.array([0, 0, 1, NONE])
    return Sources(
        ("q1.stiffness", "payload.mass", "delay"),
        kinds,
        np.array([0.1, 1.5, 1e-3]),
        root,
        parameters,
        owner,
    )


def test_numbers_of_robots_follow_from_the_errors_of_their_sources() -> None:
    """A relative error multiplies, a mass is added, a delay is a source alone; others stay."""
    found = small_sources()
    assert found.added.tolist() == [False, True, True] and found.springs.tolist() == [
        True,
        False,
        False,
    ]
    errors = np.array([[0.1, -0.5, 7.0], [-0.2, 1.0, 0.0]])
    assert_allclose(found.values(errors), [[110.0, 5.5, 1.5, 3.0], [80.0, 4.0, 3.0, 3.0]])
    directions = np.zeros((4, 3))
    directions[[0, 1, 2], [0, 0, 1]] = [100.0, 5.0, 1.0]
    assert_allclose(found.directions, directions)
    z = np.array([[1.0, -2.0], [-30.0, 0.0]])
    x = found.errors(z)
    assert_allclose(x[0], [0.1, 1.5 * (0.6 - 1.6), -2e-3])
    # a spring has no negative stiffness, a payload no negative mass
    assert_allclose(x[1], [-1.0, -2.0, 0.0])
    kept = of_equations(found, flexgen.read("elbow"))
    assert [p.name for p in kept.parameters] == [p.name for p in found.parameters]
    states: Any = [
        SimpleNamespace(key=f"a{x}b", name="s", value=1.0) for x in (".hysteresis.", ".lugre.")
    ]
    only = Sources(
        ("s", "t"),
        ("lost_motion", "friction"),
        np.ones(2),
        np.eye(2),
        tuple(states),
        np.array([0, 1]),
    )
    kept = of_equations(only, flexgen.read("elbow"))
    assert [p.name for p in kept.parameters] == ["payload.mass"] and kept.owner.tolist() == [NONE]
    one = Sources(
        ("s", "t"),
        ("a", "b"),
        np.ones(2),
        np.eye(2),
        (states[0], found.parameters[0]),
        np.array([0, 1]),
    )
    kept = of_equations(one, flexgen.read("elbow"))
    assert [p.name for p in kept.parameters] == ["q1.stiffness"] and kept.owner.tolist() == [1]


def test_sources_of_a_table_have_its_numbers_and_correlations() -> None:
    """Common errors are one column; numbers that are named belong to no group; roots give the
    correlation back.
    """
    table = {
        "stiffness": 0.1,
        "masses": 0.05,
        "friction": 0.3,
        "motor_inertia": 0.02,
        "payload": 1.0,
        "delay": 1e-3,
        "common": ["masses", "friction"],
        "parameters": ["q2.stiffness", "m1.viscous", "q1.damping"],
        "sd": [0.4, 0.0, 0.2],
        "correlation": [1.0, 0.2, -0.5, 0.2, 1.0, 0.1, -0.5, 0.1, 1.0],
    }
    model = flexgen.read("elbow", overrides={"uncertainty": table})
    found = sources_of(model, model.uncertainty)
    named = dict(zip(found.names, found.sd.tolist(), strict=True))
    assert (
        named["q2.stiffness"] == 0.4
        and named["q1.damping"] == 0.2
        and "m1.viscous" not in found.names
    )
    assert named["q1.stiffness"] == 0.1 and named["payload.mass"] == 1.0 and named["delay"] == 1e-3
    assert set(found.names[-2:]) == {"q2.stiffness", "q1.damping"} and found.kinds[-2:] == (
        "parameters",
        "parameters",
    )
    C = found.root @ found.root.T
    k = {name: i for i, name in enumerate(found.names)}
    assert C[k["q2.stiffness"], k["q1.damping"]] == pytest.approx(-0.5)
    assert C[k["upper.mass"], k["fore.mass"]] == pytest.approx(1.0)
    rest = [
        k[x]
        for x in (
            "q1.stiffness",
            "m1.inertia",
            "m2.inertia",
            "payload.mass",
            "delay",
            "upper.mass",
        )
    ]
    assert_allclose(C[np.ix_(rest, rest)], np.eye(6), atol=1e-12)
    assert_allclose(np.diag(C), 1.0)
    kinds = [kind for kind in dict.fromkeys(found.kinds)]
    order = ["stiffness", "friction", "masses", "motor_inertia", "payload", "delay", "parameters"]
    assert kinds == [kind for kind in order if kind in kinds]
    owners = {p.name: found.names[i] for p, i in zip(found.parameters, found.owner, strict=True)}
    assert owners["upper.inertia_yy"] == "upper.mass" and owners["payload.mass"] == "payload.mass"
    assert "upper.com_x" not in owners and "delay" not in owners


def test_bodies_without_mass_have_no_source() -> None:
    model = flexgen.read("elbow", overrides={"uncertainty": {"masses": 0.05}})
    hollow = replace(model.elements[0], body=replace(model.elements[0].body, mass=0.0))
    assert set(sources_of(model, model.uncertainty).names) == {"upper.mass", "fore.mass"}
    model = replace(model, elements=(hollow, *model.elements[1:]))
    assert sources_of(model, model.uncertainty).names == ("fore.mass",)


def test_a_correlation_that_none_has_is_refused() -> None:
    """Given in Python; rounding is forgiven."""
    pair = {"parameters": ["q1.stiffness", "q2.stiffness", "m1.inertia"], "sd": [0.1, 0.2, 0.1]}
    model = flexgen.read(
        "elbow", overrides={"uncertainty": {**pair, "correlation": np.eye(3).ravel().tolist()}}
    )
    assert model.uncertainty is not None

    def given(x: float) -> Sources:
        correlation = (1.0, x, 0.0, x, 1.0, 0.0, 0.0, 0.0, 1.0)
        return sources_of(model, replace(model.uncertainty, correlation=correlation))

    with pytest.raises(
        ArgumentError,
        match=r"^uncertainty, correlation: given a matrix with the eigenvalue -0\.25, exp",
    ):
        given(1.25)
    found = given(1.0 + 1e-10)
    assert_allclose((found.root @ found.root.T)[:2, :2], 1.0, rtol=1e-8)
    with pytest.raises(ArgumentError, match="eigenvalue -1e-08"):
        given(1.0 + 1e-8)


def test_states_of_a_robot_are_sources() -> None:
    model, found, _, _ = states_of("gears")
    lost = [
        name for name, kind in zip(found.names, found.kinds, strict=True) if kind == "lost_motion"
    ]
    assert lost == ["q1.lost_motion", "q2.lost_motion"]
    of_q1 = [
        p.name
        for p, i in zip(found.parameters, found.owner, strict=True)
        if found.names[i] == "q1.lost_motion"
    ]
    assert len(of_q1) == len(BENT) and all("lost_motion" in name for name in of_q1)
    model, found, _, _ = states_of("bristles")
    bristles = [name for name in found.names if name.endswith(".lugre")]
    assert bristles and all(
        found.kinds[found.names.index(name)] == "friction" for name in bristles
    )
    numbers = [
        p.name
        for p, i in zip(found.parameters, found.owner, strict=True)
        if found.names[i] == bristles[0]
    ]
    assert {x.partition("_")[2] for x in numbers} == {"coulomb", "static"} and model.motors


def test_instants_of_matrices_are_denser_where_the_arm_moves() -> None:
    """One of four parts of the weight is for the time, three for the speed; the ends are among
    them.
    """
    speed = np.zeros((1001, 2))
    speed[500:, 1] = -2.0
    found = response._knots(speed)
    assert found[0] == 0 and found[-1] == 1000 and len(found) == 60
    still = np.diff(found[found < 500])
    moving = np.diff(found[found >= 500])
    assert np.median(still) == pytest.approx(4 * np.median(moving), rel=0.15)
    assert_allclose(response._knots(np.zeros((5, 1))), np.arange(5))


def test_figures_of_drawn_robots_by_hand() -> None:
    """Largest errors, the quantile of robots on a line, shares of the variance, bands and what
    halves the error.
    """
    # two instants, two sources, two parts
    rows = np.array([[[3.0, 4.0], [0.0, 1.0]], [[0.0, 0.0], [0.0, 2.0]]])
    errors = np.array([[1.0, 0.0], [0.0, 1.0], [0.2, -1.0]])
    assert_allclose(prediction._largest(rows, errors), [5.0, 2.0, 2.0])
    first = np.linspace(1.0, 2.0, 4001)
    assert prediction._quantile(2 * first[::100], first, 0) is not None
    found = prediction._quantile(2 * first[:41] ** 1.5, first, 0)
    assert found == pytest.approx(2 * 1.95**1.5, rel=1e-6)
    assert prediction._quantile(np.array([1.0, np.inf]), first, 0) is None
    assert prediction._quantile(np.full(3, 0.25), np.full(5, 1.0), 0) == pytest.approx(0.25)
    one: Any = SimpleNamespace(
        names=("a", "b"),
        kinds=("x", "y"),
        sd=np.array([0.1, 0.2]),
        root=np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]]),
    )
    shares = prediction._shares(one, rows)
    own = (0.3**2 + 0.4**2, 0.2**2)
    both = 0.4 * 0.2 * 0.5
    total = sum(own) + 2 * both
    assert [(s.name, s.kind) for s in shares] == [("a", "x"), ("b", "y")]
    assert_allclose([s.share for s in shares], [(own[0] + both) / total, (own[1] + both) / total])
    drawn = np.random.default_rng(0).standard_normal((1000, 3)) * [1.0, 0.8, 0.1]
    three: Any = SimpleNamespace(names=("a", "b", "c"))
    order = tuple(Share(x, "", 0.0) for x in "abc")
    flat = np.array([[[1.0], [1.0], [1.0]]])
    assert prediction._to_halve(three, order, flat, drawn) == ("a", "b")
    assert prediction._to_halve(three, order, flat, drawn * [1.0, 0.2, 1.0]) == ("a",)
    assert prediction._to_halve(three, order[::-1], flat, drawn * [1.0, 1.0, 1.0]) == (
        "c",
        "b",
        "a",
    )
    along: Any = SimpleNamespace(
        motors=("m",),
        springs=("q",),
        motion={"tau_m": np.array([[5.0], [6.0]]), "deflection": np.zeros((2, 1))},
    )
    answers: Any = SimpleNamespace(
        tau_m=np.array([[[1.0]], [[-2.0]]]), deflection=np.array([[[0.0]], [[0.5]]])
    )
    spread = np.linspace(-1.0, 1.0, 401)[:, None]
    torque, deflection = prediction._bands(along, answers, spread, np.array([0, 1]))
    assert torque.names == ("m",) and deflection.names == ("q",)
    assert_allclose([torque.low, torque.high], [[[4.05], [4.1]], [[5.95], [7.9]]])
    assert_allclose([deflection.low, deflection.high], [[[0.0], [-0.475]], [[0.0], [0.475]]])
    assert_allclose(torque.planned, [[5.0], [6.0]])


def a_prediction(output: str = "tool_position", **changed: Any) -> Prediction:
    solution: Any = SimpleNamespace(
        model=SimpleNamespace(title="Arm", output=SimpleNamespace(type=output)),
        move=SimpleNamespace(name="line"),
    )
    band = Band(("m",), np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)))
    made = object.__new__(Prediction)
    shares = (Share("a", "x", 0.75), Share("b", "y", 0.2451), Share("c", "y", 0.004))
    fields = {
        "solution": solution,
        "feedback": SimpleNamespace(title="cascade"),
        "sources": tuple("abc"),
        "sd": np.ones(3),
        "robots": 48,
        "seed": 0,
        "error_m": 1.5e-4,
        "error_rad": 2e-3,
        "errors_m": None,
        "errors_rad": None,
        "time": np.zeros(1),
        "torque": band,
        "deflection": band,
        "shares": shares,
        "to_halve": ("a", "b"),
    }
    for name, value in (fields | changed).items():
        object.__setattr__(made, name, value)
    return made


def test_the_text_of_a_prediction() -> None:
    made = a_prediction()
    assert str(made).splitlines() == [
        "Arm, move line",
        (
            "tool error 95 % <= 150 um and <= 2 mrad with motor feedback (3 uncertain numbers, "
            "48 robots simulated)"
        ),
        "cascade",
        "shares of the variance: a 75 %, b 25 %",
        "to halve the error, measure a, b",
    ]
    assert (
        made.problem == ""
        and repr(made) == "<Prediction Arm, line: tool error 95 % <= 150 um and <= 2 mrad>"
    )
    lost = a_prediction("combination", error_m=None, error_rad=None)
    assert lost.problem == "a robot with the motor feedback is unstable"
    assert lost.sentence() == f"output error 95 % not known: {lost.problem}"
    assert a_prediction(error_m=None).problem == "" and a_prediction(error_rad=None).problem == ""
    assert a_prediction(error_m=None).sentence() == "tool error 95 % <= 2 mrad"
    names = tuple("abcdefghij")
    many = a_prediction(shares=tuple(Share(x, "", 0.1) for x in names), to_halve=names)
    assert many.lines()[2:] == [
        "shares of the variance: " + ", ".join(f"{x} 10 %" for x in "abcdefgh"),
        "to halve the error, measure a, b, c, d, e, f, g, h and 2 more",
    ]
    assert (
        a_prediction(to_halve=names[:8]).lines()[3]
        == "to halve the error, measure a, b, c, d, e, f, g, h"
    )
    assert [figure.value for figure in made.figures()] == [
        1.5e-4,
        2e-3,
        "cascade",
        3,
        48,
        "75.0",
        "24.5",
        "a, b",
    ]


def test_the_table_of_a_model_file_has_the_deviations_and_correlations() -> None:
    covariance = np.array([[0.04, -0.01], [-0.01, 36.0]])
    text = with_uncertainty('name = "x"\n', ["a.b", "c.d"], covariance)
    assert text.startswith(
        'name = "x"\n'
        "\n"
        "[uncertainty]\n"
        'parameters = ["a.b", "c.d"]\n'
        "sd = [0.2, 5]\n"
        "correlation = [\n"
    )
    found = tomllib.loads(text)["uncertainty"]
    r = -0.01 / (0.2 * 6.0)
    assert_allclose(found["correlation"], [1.0, r, r, 1.0], rtol=1e-10)
    assert with_uncertainty(text, ["a.b", "c.d"], covariance) == text
