"""Line elements: their forces against an own computation, their laws, and who refuses what."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ModelError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.recursion.functions import fast_function
from flexgen.dynamics.mechanics import lagrangian
from flexgen.dynamics.mechanics.lines import elastic_tension, stored_energy
from flexgen.exports.urdf.urdf import export_urdf
from flexgen.inversion.solution import line_warnings
from flexgen.model.format.line_checks import body_poses, line_lengths

GRAVITY = np.array([0.0, 0.0, -9.81])


def end(element: str, *position: float) -> dict[str, Any]:
    return {"element": element, "position": list(position)}


# Every kind, between bodies and with the base, in a six-axis arm.
LINES: list[dict[str, Any]] = [
    {
        "name": "push",
        "type": "gas_spring",
        "from": end("base", -0.4, 0.1, -0.3),
        "to": end("link2", -0.4, 0.1, 0.05),
        "area": 1e-3,
        "pressure": 9e6,
        "volume": 4e-3,
        "exponent": 1.4,
        "length": 3.0,
        "stroke": 2.9,
        "damping": 700.0,
    },
    {
        "name": "pull",
        "type": "gas_spring",
        "from": end("link1", 0.3, 0.2, -0.1),
        "to": end("link3", 0.2, 0.0, 0.3),
        "acts": "pull",
        "area": 8e-4,
        "pressure": 7e6,
        "volume": 5e-3,
        "exponent": 1.0,
        "length": 0.1,
        "stroke": 3.5,
        "mass": 9.0,
    },
    {
        "name": "rod",
        "type": "rod",
        "from": end("link2", 0.1, -0.2, 0.1),
        "to": end("link5", 0.05, 0.1, 0.2),
        "stiffness": 2e5,
        "length": 1.01,
        "mass": 14.0,
        "damping": 90.0,
    },
    {
        "name": "balancer",
        "type": "spring",
        "from": end("base", 0.3, -0.2, -0.6),
        "to": end("link3", 0.1, 0.1, -0.3),
        "stiffness": 6e3,
        "length": 0.5,
        "preload": 900.0,
    },
    {
        "name": "rope",
        "type": "cable",
        "from": end("link1", -0.3, 0.2, 0.5),
        "to": end("link4", 0.0, 0.1, 0.2),
        "stiffness": 4e4,
        "length": 1.6,
        "preload": 500.0,
        "smoothing": 0.05,
        "damping": 60.0,
        "mass": 2.0,
    },
]
# Instants and weights that differentiate smooth functions of time to rounding.
STEP = 0.03
TIMES = STEP * np.arange(-6, 7)
POWERS = np.linalg.inv((TIMES[:, None] / STEP) ** np.arange(13))
FIRST = POWERS[1] / STEP
SECOND = 2.0 * POWERS[2] / STEP**2


def robot(*names: str) -> flexgen.RobotModel:
    """The KUKA KR 300, with the lines of these names."""
    lines = [line for line in LINES if line["name"] in names]
    return flexgen.read("kr300", overrides={"line": lines})


def tension(line: Any, length: float, rate: float) -> float:
    """The tension [N] as the documentation states it."""
    kind = type(line).__name__
    if kind == "GasSpringLine":
        sign = {"push": 1.0, "pull": -1.0}[line.acts]
        volume = line.volume + sign * line.area * (length - line.length)
        pressure = line.pressure * (line.volume / volume) ** line.exponent
        return -sign * (pressure - line.ambient_pressure) * line.area + line.damping * rate
    if kind == "CableLine":
        x = length - line.length + line.preload / line.stiffness
        root = np.hypot(x, line.smoothing)
        return line.stiffness * (x + root) / 2 + line.damping * (1 + x / root) / 2 * rate
    preload = line.preload if kind == "SpringLine" else 0.0
    return preload + line.stiffness * (length - line.length) + line.damping * rate


def ends(model: flexgen.RobotModel, q: np.ndarray) -> np.ndarray:
    """The two ends of each line (lines, 6) [m] in the world."""
    poses = body_poses(model, q)
    points = [
        poses[at.element][0] + poses[at.element][1] @ np.array(at.position)
        for line in model.lines
        for at in (line.start, line.end)
    ]
    return np.reshape(points, (-1, 6))


def needed(model: flexgen.RobotModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Torques (n_a,) that the lines need in a motion: inertia, weight and tension at the ends.

    The masses are those of a rod of uniform mass, ``m/6 (2 a1 + a2)`` at the first end, from the
    accelerations of the ends along the motion; no Lagrangian, no frames that move.
    """
    paths = np.array([ends(model, q + v * t + a * t**2 / 2) for t in TIMES])
    columns = [
        np.tensordot(FIRST, [ends(model, q + t * axis) for t in TIMES], 1)
        for axis in np.eye(model.n_a)
    ]
    total = np.zeros(model.n_a)
    for k, line in enumerate(model.lines):
        path = paths[:, k]
        J = np.array([column[k] for column in columns]).T
        speed = FIRST @ path
        a1, a2 = np.split(SECOND @ path, 2)
        way = path[6, 3:] - path[6, :3]
        length = float(np.linalg.norm(way))
        pull = tension(line, length, way @ (speed[3:] - speed[:3]) / length) * way / length
        weight = line.mass / 2 * GRAVITY
        inertia = [line.mass / 6 * (2 * a1 + a2), line.mass / 6 * (a1 + 2 * a2)]
        total += J.T @ np.concatenate([inertia[0] - weight - pull, inertia[1] - weight + pull])
    return total


def largest_error(count: int) -> float:
    """Largest error of the equations, as a part of the largest torque, at random states."""
    model = robot(*(line["name"] for line in LINES))
    rng = np.random.default_rng(1)
    q = np.array(model.home) + rng.uniform(-0.5, 0.5, (count, model.n_a))
    v, a = rng.uniform(-1.0, 1.0, (2, count, model.n_a))
    made = []
    for each in (model, robot()):
        equations = flexgen.derive(each)
        left = evaluate(equations.function("inverse_dynamics"), q, v, a)[0]
        made.append(left - evaluate(equations.function("arm_forces"), q, v)[0])
    expected = np.array([needed(model, *state) for state in zip(q, v, a, strict=True)])
    return float(np.abs(made[0] - made[1] - expected).max() / np.abs(expected).max())


def test_lines_need_the_forces_at_their_ends() -> None:
    assert largest_error(4) < 1e-10


@pytest.mark.slow
def test_lines_need_the_forces_at_their_ends_in_many_states() -> None:
    assert largest_error(100) < 1e-10


def test_a_planted_tension_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    right = lagrangian.line_forces
    monkeypatch.setattr(lagrangian, "line_forces", lambda chain: 1.001 * right(chain))
    assert largest_error(2) > 1e-5


@pytest.mark.parametrize("name", [line["name"] for line in LINES])
def test_the_tension_is_the_slope_of_the_energy(name: str) -> None:
    (line,) = robot(name).lines
    x = ca.SX.sym("x")
    slope = ca.Function("slope", [x], [ca.gradient(stored_energy(line, x), x)])
    for length in np.linspace(0.4, 2.5, 12):
        force = float(ca.Function("force", [x], [elastic_tension(line, x)])(length))
        assert float(slope(length)) == pytest.approx(force, rel=1e-11, abs=1e-8)
        assert tension(line, length, 0.0) == pytest.approx(force, rel=1e-12)


# Weights of the elbow arm on its first and second angle; q1 is measured from the vertical.
WEIGHT_1 = 9.81 * (339.12 * 0.441 + 190.25 * 1.150)  # N m
WEIGHT_2 = 9.81 * 190.25 * 0.465
# m, of the ends below and behind the first joint
HEIGHT = 0.6
RADIUS = 0.2


def torques_at_rest(line: dict[str, Any], q: np.ndarray) -> np.ndarray:
    """Torques (n, 2) [N m] that hold the elbow arm with a line from 0.6 m below its first joint to
    0.2 m behind it on the upper arm.
    """
    points = {"from": end("base", 0, 0, -HEIGHT), "to": end("upper", 0, 0, -RADIUS)}
    robot = flexgen.read("elbow", overrides={"line": [{"name": "line"} | points | line]})
    equations = flexgen.derive(robot)
    held = evaluate(equations.function("gravity"), q)[0]
    return np.asarray(held - evaluate(equations.function("arm_forces"), q, 0 * q)[0])


def test_a_spring_without_free_length_carries_the_upper_arm_in_all_poses() -> None:
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (100, 2))
    line = {"type": "spring", "stiffness": WEIGHT_1 / (HEIGHT * RADIUS), "length": 0.0}
    rest = -WEIGHT_2 * np.cos(q.sum(axis=1))
    expected = np.stack([rest, rest], axis=1)
    assert np.abs(torques_at_rest(line, q) - expected).max() < 1e-9 * WEIGHT_1


def test_a_gas_spring_has_the_moment_of_the_law_of_cosines() -> None:
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (100, 2))
    gas = {"area": 2e-3, "pressure": 1e7, "volume": 4e-3, "exponent": 1.2}
    line = {"type": "gas_spring", "acts": "pull", **gas, "length": 0.3, "stroke": 0.5}
    length = np.sqrt(HEIGHT**2 + RADIUS**2 - 2 * HEIGHT * RADIUS * np.cos(q[:, 0]))
    pressure = 1e7 * (4e-3 / (4e-3 - 2e-3 * (length - 0.3))) ** 1.2
    moment = (pressure - 101325.0) * 2e-3 * HEIGHT * RADIUS * np.sin(q[:, 0]) / length
    weight = -WEIGHT_1 * np.sin(q[:, 0]) - WEIGHT_2 * np.cos(q.sum(axis=1))
    assert np.abs(torques_at_rest(line, q)[:, 0] - weight - moment).max() < 1e-9 * WEIGHT_1


def test_the_power_of_motors_and_losses_is_the_rate_of_the_energy() -> None:
    equations = flexgen.derive(robot("push", "rod", "balancer"))
    model = equations.model
    rng = np.random.default_rng(3)
    state = {
        "q_a": np.array(model.home) + rng.uniform(-0.3, 0.3, model.n_a),
        "v_a": rng.uniform(-1, 1, model.n_a),
        "q_m": rng.uniform(-0.1, 0.1, model.n_m),
        "v_m": rng.uniform(-1, 1, model.n_m),
    }
    state["q_m"] = model.eta @ state["q_a"][list(model.i_g)]
    torque = rng.uniform(-5, 5, model.n_m)
    a_a, a_m = equations.function("forward_dynamics")(*state.values(), torque)
    given, lost = equations.function("power")(*state.values(), torque)
    energy = equations.function("energy")
    symbols = [ca.SX.sym(name, len(x)) for name, x in state.items()]
    total = sum(energy(*symbols))
    rates = ca.vertcat(ca.DM(state["v_a"]), a_a, ca.DM(state["v_m"]), a_m)
    rate = ca.Function("rate", symbols, [ca.jtimes(total, ca.vertcat(*symbols), rates)])
    assert float(rate(*state.values())) == pytest.approx(float(given - lost), rel=1e-8)


def test_fast_functions_are_those_of_the_lagrangian() -> None:
    equations = flexgen.derive(robot("push", "balancer"))
    slow = equations.function("forward_dynamics")
    fast = fast_function(equations, "forward_dynamics")
    assert fast is not None
    rng = np.random.default_rng(1)
    arguments = [rng.uniform(-1, 1, (20, slow.size1_in(k))) for k in range(slow.n_in())]
    for a, b in zip(evaluate(slow, *arguments), evaluate(fast, *arguments), strict=True):
        assert np.allclose(a, b, rtol=1e-9, atol=1e-9)


def test_numbers_of_lines_are_parameters() -> None:
    model = robot("push", "rod")
    equations = flexgen.derive(model, ["push.pressure", "rod.mass", "rod.stiffness"])
    assert [p.value for p in equations.parameters] == [9e6, 14.0, 2e5]
    forces = equations.function("arm_forces")
    q = np.array(model.home)
    half = forces(q, 0 * q, [4.5e6, 14.0, 1e5])
    plain = flexgen.derive(
        flexgen.read(
            "kr300",
            overrides={
                "line": [
                    LINES[0] | {"pressure": 4.5e6},
                    LINES[2] | {"stiffness": 1e5},
                ]
            },
        )
    )
    expected = plain.function("arm_forces")(q, 0 * q).full()
    assert np.allclose(half.full(), expected, rtol=1e-12)


def test_the_overlay_of_a_urdf_file_has_them(tmp_path: Path) -> None:
    model = robot("push", "rod", "rope")
    again = flexgen.read(export_urdf(model, tmp_path / "arm.urdf").details["overlay"])
    q = np.array(model.home)
    assert np.allclose(line_lengths(again, q), line_lengths(model, q), rtol=1e-12)
    forces = [evaluate(flexgen.derive(one).function("arm_forces"), q, q) for one in (model, again)]
    assert np.allclose(forces[0][0], forces[1][0], rtol=1e-9)


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        ("push", {"to": end("base", 0, 0, 1)}, "line.push.to: .*another body"),
        ("push", {"to": end("link9")}, 'line.push.to.element: given "link9"'),
        ("push", {"volume": 1e-3}, "volume: given 0.001, expected a volume of gas above .*0.0029"),
        ("push", {"stroke": 1.0}, "given ends that are .* m apart .* from 2 to 3 m"),
        ("push", {"exponent": 0.9}, "exponent: given 0.9, expected a number >= 1"),
        ("rod", {"length": 1.2}, "length: given 1.2 m.* a stretch of -14.7 %"),
        ("rod", {"length_min": 2.0, "length_max": 1.0}, "length_min: given 2.0"),
        ("rod", {"length_min": 3.0}, "expected a distance from 3 to inf m"),
        ("rod", {"name": "link2"}, "expected a name that no element has"),
        ("rope", {"smoothing": 0}, "smoothing: given 0"),
        ("rope", {"type": "belt"}, "expected one of cable, gas_spring, rod, spring"),
        ("balancer", {"mass": -1}, "mass: given -1"),
        ("balancer", {"volume": 1}, "volume.*gas_spring"),
    ],
)
def test_wrong_lines_are_refused(kind: str, change: dict[str, Any], message: str) -> None:
    line = next(one for one in LINES if one["name"] == kind)
    with pytest.raises(ModelError, match=message):
        flexgen.read("kr300", overrides={"line": [line | change]})


def test_ends_that_coincide_are_refused() -> None:
    plain = robot()
    base = body_poses(plain, np.array(plain.home))["base"]
    p, _ = body_poses(plain, np.array(plain.home))["link3"]
    at = base[1].T @ (p - base[0])
    line = LINES[3] | {"from": end("base", *at.tolist()), "to": end("link3", 0, 0, 0)}
    with pytest.raises(ModelError, match="two points that are apart"):
        flexgen.read("kr300", overrides={"line": [line]})


def test_a_motion_beyond_the_stroke_is_reported_with_the_length() -> None:
    model = robot("push")
    (line,) = model.lines
    solution = flexgen.solve(model, progress=False)
    assert line_warnings(model, solution.trajectory) == ()
    short = replace(model, lines=(replace(line, length=1.42, stroke=0.05),))
    (text,) = line_warnings(short, solution.trajectory)
    states = flexgen.derive(model).function("line_states")
    lengths = evaluate(states, solution.trajectory["q_a"], solution.trajectory["v_a"])[0]
    assert f"{lengths.max():.4g} m is above its limit 1.42 m" in text
