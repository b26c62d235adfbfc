"""Robots that differ from the model: numbers, rest, fastest rates, and elements with states."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.hysteresis.lugre import MotorBristles, without_states
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop import hysteresis
from flexgen.feedback.loop.plants import LocalDynamics, check_motion, plants_of
from flexgen.simulation.integration.hysteretic_rate import hysteretic_rate

ELEMENTS = [
    {"stiffness": 2e5, "lost_motion": 1e-4},
    {"stiffness": 1e5, "lost_motion": 4e-4, "exponent": 3.0},
]
BRISTLES = {
    "coulomb": 0.5,
    "static": 0.8,
    "stribeck_speed": 4.0,
    "stiffness": 800.0,
    "damping": 1.5,
}
OTHER = BRISTLES | {"coulomb": 0.9, "static": 1.1, "stiffness": 500.0}


def test_numbers_of_plants_are_factors_and_added_loads() -> None:
    """Of a kind all its numbers; of a payload what is added, down to none, and where it is."""
    model = flexgen.read("manutec_r3")
    changes = {"a": {"stiffness": 0.8, "payload": -15.0}, "b": {}, "c": {"q1.stiffness": 2.0}}
    found = plants_of(model, changes)
    names = [p.name for p in found.parameters]
    nominal = {p.name: p.value for p in found.parameters}
    rows = [dict(zip(names, row, strict=True)) for row in found.values.tolist()]
    assert found.names == ("a", "b", "c") and rows[1] == nominal
    assert (nominal["payload.mass"], rows[0]["payload.mass"]) == (15.0, 0.0)
    springs = [name for name in names if name.endswith(".stiffness")]
    assert springs[:3] == ["q1.stiffness", "q2.stiffness", "q3.stiffness"]
    assert_allclose([rows[0][x] / nominal[x] for x in springs], 0.8)
    assert rows[2] == nominal | {"q1.stiffness": 2.0 * nominal["q1.stiffness"]}
    place = ", ".join(f"{x:g}" for x in model.payload.com)
    tool = replace(model, tool=replace(model.tool, position=model.payload.com))
    far = replace(model, tool=replace(model.tool, position=(9.0, 0.0, 0.0)))
    for own, where in ((tool, "tool"), (far, "center of mass of the payload")):
        loads = plants_of(own, {"a": {"payload": 2.5}, "b": {}}).loads
        assert loads == (f"+2.5 kg at the {where}, [{place}] m in the frame of the last tip", "")
    plants_of(model, {"a": {"stiffness": 100.0, "payload": 1e5}, "b": {"damping": 0.0}})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"payload": -15.1}, "plant a, payload: given -15.1 kg, expected -15 to 100000 kg to add"),
        ({"payload": 1.1e5}, "plant a, payload: given 110000.0 kg, expected -15 to 100000 kg"),
        ({"stiffness": -0.1}, "plant a, stiffness: given the factor -0.1, expected 0 to 100"),
        ({"stiffness": 100.1}, "plant a, stiffness: given the factor 100.1, expected 0 to 100"),
        ({"stiffness": True}, "plant a, stiffness: given True, expected a number"),
        ({"lost_motion": 2.0}, "plant a, lost_motion: the model manutec_r3 has no number of this"),
        (3, "plant a: given 3, expected changes such as "),
    ],
)
def test_wrong_changes_are_refused(changes: Any, message: str) -> None:
    with pytest.raises(ArgumentError, match=f"^{message}"):
        plants_of(flexgen.read("manutec_r3"), {"a": changes})


def test_a_factor_that_changes_nothing_is_refused() -> None:
    text = "plant a, payload.mass: the model elbow has no number of this kind but 0"
    with pytest.raises(ArgumentError, match=text):
        plants_of(flexgen.read("elbow"), {"a": {"payload.mass": 50.0}})


def test_other_robots_rest_where_their_springs_hold_them() -> None:
    """No residual at rest, motors where they are held; the fastest rate is that of M, D and K."""
    model = flexgen.read("planar5_nmp")
    made = plants_of(model, {"model": {}, "soft": {"stiffness": 0.8, "damping": 3.0}})
    equations = derive(model, tuple(p.name for p in made.parameters))
    local = LocalDynamics(equations)
    q_m = model.eta @ [0.2, 0.4]
    start = np.array([0.2, 0.4, *[0.0] * (model.n_a - 2)])
    q_a, tau = local.rest(q_m, made.values[1], start)
    still = np.zeros(model.n_a)
    none = np.zeros(model.n_m)
    point = (q_a, still, still, q_m, none, none, tau)
    r_a, r_m = equations.function("residual")(*point, made.values[1])
    assert np.abs(np.array(ca.vertcat(r_a, r_m))).max() < 1e-8
    motion = [x[None] for x in point]
    M, D, K, _ = (x[0] for x in local.matrices(motion, made.values[1]))
    n = len(M)
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ D]])
    rate = np.abs(np.linalg.eigvals(A)).max()
    assert local.largest_rate(motion, made.values[1]) == pytest.approx(rate, rel=1e-6)
    with pytest.raises(ArgumentError, match=r"motion: given arrays of shapes .*\(k, 3\) and q_m"):
        check_motion(model, motion[:6])


def with_states(**changes: Any) -> tuple[Any, Any, Any]:
    """The elbow with elements of states, these states, and its numbers."""
    own = {"element.upper.dof.q1.gear.hysteresis": ELEMENTS} | changes
    model = flexgen.read("elbow", overrides=own)
    plants, (states,) = hysteresis.split_plants(model, plants_of(model, {"model": {}}))
    return model, states, plants


def test_the_fastest_rate_of_a_loop_with_states_by_hand() -> None:
    """Swings of springs with elements and bristles that stick, slips n |d'| K_h/W, slides |v| s0/F
    of the motors, F the Coulomb friction.
    """
    own = {"motor.m1.lugre": BRISTLES, "motor.m2.lugre": OTHER}
    model, states, _ = with_states(**own)
    local = LocalDynamics(derive(without_states(model)))
    ratio = np.diag(model.eta)
    K = model.elements[0].dofs[0].gear.spring.stiffness
    q = np.array([0.2, 0.4])
    still = np.zeros((1, 2))
    points = [q[None], still, still, (model.eta @ q)[None], still, still, still]

    def rate(v_a: list[float], v_m: list[float]) -> float:
        motion = {"v_a": np.array([[0.0, 0.0], v_a]), "v_m": np.array([v_m, [0.0, 0.0]])}
        return hysteresis.largest_rate(local, points, motion, np.zeros(0), states)

    M, D, stiff, _ = (np.array(x[0]) for x in local.matrices(points, np.zeros(0)))
    gear = np.array([1.0, 0.0, -1.0 / ratio[0], 0.0])
    stiff = stiff + 3e5 * np.outer(gear, gear) + np.diag([0.0, 0.0, 800.0, 500.0])
    D = D + np.diag([0.0, 0.0, 1.5, 1.5])
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((4, 4)), np.eye(4)], [-inverse @ stiff, -inverse @ D]])
    swings = np.abs(np.linalg.eigvals(A)).max()
    slips = max(2e5 / (1e-4 * K / 2), 3.0 * 1e5 / (4e-4 * K / 2))
    assert rate([0.0, 0.0], [0.0, 0.0]) == pytest.approx(swings, rel=1e-6)
    assert rate([500.0, 0.0], [0.0, 0.0]) == pytest.approx(500.0 * slips)
    assert rate([0.0, 9e9], [0.0, 0.0]) == pytest.approx(swings, rel=1e-6)  # has no elements
    slides = max(800.0 / 0.5, slips / ratio[0])
    assert rate([0.0, 0.0], [1e3, 0.0]) == pytest.approx(1e3 * slides)
    assert rate([0.0, 0.0], [0.0, 1e3]) == pytest.approx(1e3 * 500.0 / 0.9)


@pytest.mark.parametrize("bristled", [False, True])
def test_rates_of_a_loop_are_those_of_the_simulation(bristled: bool) -> None:
    """In the loop states are parts of the largest torques, and motors stand before the arm's
    speeds.
    """
    model, states, plants = with_states(**{"motor.m2.lugre": BRISTLES} if bristled else {})
    equations = derive(without_states(model))
    robots = hysteresis.hysteretic_robots(equations, plants.values, (states,), lambda line: None)
    rng = np.random.default_rng(4)
    q = 0.1 * rng.standard_normal(4)
    v = rng.standard_normal(4)
    tau = rng.standard_normal(2)
    slip = np.concatenate([layer.slip for layer in states.gears])
    share = rng.uniform(-0.9, 0.9, 4) * (slip > 0)
    bent = np.array([0.0, 0.4])[: 2 * bristled]
    x = np.concatenate([q[:2], v[:2], q[2:], v[2:], share, bent])
    rate = np.array(robots.function(x, tau, robots.numbers[0])).ravel()
    inputs, outputs = hysteretic_rate(derive(model))
    most = np.array([1.0, BRISTLES["static"]])[: 2 * bristled]
    z = np.concatenate([share * slip, bent * most])
    function = ca.Function("rate", inputs, outputs)
    dx, dz, _ = (np.array(y).ravel() for y in function(np.concatenate([q, v]), z, tau))
    expected = np.concatenate([dx[:2], dx[4:6], dx[2:4], dx[6:]])
    assert_allclose(rate[:8], expected, rtol=1e-9, atol=1e-9)
    scale = np.concatenate([np.where(slip > 0, slip, 1.0), most])
    assert_allclose(rate[8:], dz / scale, rtol=1e-9, atol=1e-12)
    assert np.abs(rate[8:]).max() > 1.0 and len(rate) == len(x)


def test_states_of_motors_do_not_divide_by_zero_where_there_are_none() -> None:
    motors = MotorBristles(
        *(np.array(x) for x in ([0.0, 2.0, 3.0], [0.0, 2.5, 1.0], [0.0, 0.1, 0.2])),
        *np.zeros((2, 3)),
    )
    layer: Any = Made(
        stiffness=np.array([6.0, 5.0]), slip=np.array([3.0, 0.0]), present=np.array([True, False])
    )
    found = hysteresis.States((layer,), motors)
    levels = [0.0, 2.5, 3.0, 1.0, 2.0, 3.0, 1.0, 2.5, 1.0]  # the larger one, Coulomb, static
    assert_allclose(found.of_motors()[:12], [*levels, 0.0, 0.1, 0.2])
    assert_allclose(found.numbers(), [3.0, 0.0, 2.0, 0.0])
