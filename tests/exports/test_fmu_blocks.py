"""Blocks of FMUs: start values, outputs and states against the robot; bounds of rates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from bristled import bristled, tables
from hysteretic import BENT, SLIPS, with_elements
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.exports.fmu.block import Block
from flexgen.exports.fmu.controller import controller
from flexgen.exports.fmu.feedforward import feedforward, home_output
from flexgen.exports.fmu.plant import graphs_of, plant
from flexgen.exports.fmu.plant_memory import memory_variables, plant_memory
from flexgen.exports.fmu.variables import RATE, STATE
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.gains import PPI
from flexgen.model.position_servo.filters import LowPass, Notch

ELBOW = flexgen.read("elbow")
RATIO = np.array([motor.ratio[0] for motor in ELBOW.motors])


def starts(block: Block, pattern: str, names: tuple[str, ...] = ("m1", "m2")) -> np.ndarray:
    """Start values of variables by the names of motors or coordinates."""
    every = {x.name: x.start for x in block.variables}
    return np.array([every[pattern.format(name)] for name in names])


# --- the controller


def test_the_block_of_a_cascade_has_its_gains_and_rests_at_home() -> None:
    gains = {"position_gain": [20.0, 30.0], "speed_gain": [5.0, 4.0], "integral_gain": [2.0, 1.0]}
    limits = {"torque_max": [300.0, 200.0]}
    given = {name: np.array(x) for name, x in (gains | limits).items()}
    law = Cascade(**given, filters=(Notch(60.0), LowPass(200.0)))
    made = controller(ELBOW, law, 1e-3)
    for name, values in given.items():
        assert_allclose(starts(made, f"motor.{{}}.{name}"), values)
    held = hold_joints(derive(ELBOW), np.array(ELBOW.home))
    for name in ("measured_angle", "reference_angle"):
        assert_allclose(starts(made, f"motor.{{}}.{name}"), held.q_m)
    for name in ("feedforward_torque", "torque"):
        assert_allclose(starts(made, f"motor.{{}}.{name}"), held.tau_m)
    filters = np.array(made.constants["FILTERS"]).reshape(2, 2, 5)
    for filtered, each in zip(filters, law.filters, strict=True):
        assert_allclose(filtered, np.tile(each.section(1e-3), (2, 1)))
    assert (made.defines, made.work) == ({"N_M": "2", "SECTIONS": "2"}, "0")
    assert (made.sample_time, made.step, made.derivatives) == (1e-3, 1e-3, False)
    # settings of a cascade, gains, sections, states of motors and of sections
    assert made.memory == str(4 + 4 * 2 + 2 * 2 * 5 + 3 * 2 + 2 * 2 * 2)
    places = {x.name: x.index for x in made.variables}
    inputs = ("measured_angle", "reference_angle", "feedforward_torque")
    assert [places[f"motor.m2.{x}"] for x in inputs] == [1, 3, 5]
    assert [places[f"motor.m2.{x}"] for x in given] == [1, 3, 5, 7]


def test_gains_that_are_not_given_are_those_at_home_with_a_sample_of_delay() -> None:
    made = controller(ELBOW, None, 2e-3)
    held = hold_joints(derive(ELBOW), np.array(ELBOW.home))
    rest = np.zeros((1, 2))
    motion = [held.q_a[None], rest, rest, held.q_m[None], rest, rest, held.tau_m[None]]
    expected = PPI().cascade(ELBOW, 4e-3, motion)
    for name in ("position_gain", "speed_gain", "integral_gain"):
        found = starts(made, f"motor.{{}}.{name}")
        assert_allclose(found, getattr(expected, name), rtol=1e-9)


WRONG: dict[Any, str] = {
    "none.toml": "given 'none.toml', which does not exist, expected a file .toml",
    __file__: f"given {__file__!r}, expected a file .toml of type ppi or cascade",
    3.0: "given float, expected a flexgen.Cascade or flexgen.PPI for the block 'controller'",
}


@pytest.mark.parametrize("given", WRONG, ids=["missing", "no table", "a number"])
def test_wrong_controllers_are_refused(given: Any) -> None:
    with pytest.raises(ArgumentError) as caught:
        controller(ELBOW, given, 1e-3)
    assert str(caught.value) == f"controller: {WRONG[given]}"


# --- the feedforward


@pytest.mark.parametrize("integral", [[0.0, 0.0], [5.0, 0.0]])
def test_a_servo_without_integral_part_is_commanded_ahead(integral: list[float]) -> None:
    """It holds the torque by ``tau / (k_p k_v)`` on the motor side; joints by the gears."""
    servo = {
        "type": "cascade",
        "position_gain": [30.0, 25.0],
        "speed_gain": [1.5, 0.4],
        "integral_gain": integral,
    }
    robot = flexgen.read("elbow", overrides={"servo": servo})
    held = hold_joints(derive(robot), np.array(robot.home))
    made = feedforward(robot, None)
    stiffness = np.array([30.0 * 1.5, 25.0 * 0.4])
    offset = np.where(np.array(integral) > 0, 0.0, held.tau_m / stiffness)
    expected = (held.q_m + offset) / RATIO
    joints = ("q1", "q2")
    assert_allclose(starts(made, "arm.{}.command", joints), expected, rtol=1e-12)
    assert_allclose(starts(made, "motor.{}.torque"), held.tau_m)
    assert_allclose(starts(made, "motor.{}.reference_angle"), held.q_m)
    assert_allclose(starts(made, "arm.{}.reference_position", joints), held.q_a)
    assert not starts(made, "arm.{}.reference_speed", joints).any()
    plain = feedforward(ELBOW, None)
    assert not any(row.name.endswith(".command") for row in plain.variables)


def test_an_output_with_an_angle_begins_with_the_angle_at_home() -> None:
    """Of the elbow in its plane: the sum of its joints."""
    output = {"type": "tool_position_angle", "axes": "xz", "rotation_axis": [0.0, 1.0, 0.0]}
    robot = flexgen.read("elbow", overrides={"output": output, "move": []})
    q = np.array([0.3, -0.4])
    x, z, angle = home_output(robot, derive(robot), q)
    assert x == pytest.approx(1.150 * np.sin(0.3) + 1.241 * np.cos(-0.1))
    assert z == pytest.approx(1.150 * np.cos(0.3) - 1.241 * np.sin(-0.1))
    assert abs(angle) == pytest.approx(abs(q.sum()))


# --- the plant


@pytest.mark.parametrize("name", ["elbow", "elbow@rigid", "planar5_nmp", "urdf_arm"])
def test_outputs_of_a_plant_are_those_of_the_robot(name: str) -> None:
    """Motors, tool with its velocity by differences, and deflections: of an elastic gear the motor
    less the arm, of a rigid one zero, of a passive coordinate itself.
    """
    equations = derive(flexgen.read(name), ("payload",))
    model = equations.model
    n = model.dof
    x = np.random.default_rng(1).normal(size=2 * n)

    def motors(part: np.ndarray) -> np.ndarray:
        out = model.eta @ part[list(model.i_g)]
        out[list(model.i_m)] = part[model.n_a :]
        return out

    def tool(q_a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p, R = evaluate(equations.function("forward_kinematics"), q_a)
        return p.ravel(), R.reshape(3, 3)

    q = x[:n]
    v = x[n:]
    p, R = tool(q[: model.n_a])
    h = 1e-6
    ahead, back = (tool(q[: model.n_a] + s * h * v[: model.n_a]) for s in (1.0, -1.0))
    hat = (ahead[1] - back[1]) @ R.T / (2 * h)
    turning = np.array([hat[2, 1], hat[0, 2], hat[1, 0]])
    deflection = q[: model.n_a].copy()
    gears = np.linalg.solve(model.eta, motors(q)) - q[list(model.i_g)]
    for k, i in enumerate(model.i_g):
        deflection[i] = gears[k]  # zero of a rigid gear, whose motor turns with the arm
    expected = [motors(q), motors(v), p, R.ravel(), (ahead[0] - back[0]) / (2 * h), turning]
    found = np.array(graphs_of(equations).output(x)).ravel()
    assert_allclose(found, np.concatenate([*expected, deflection]), rtol=1e-6, atol=1e-7)


MEMORIES: dict[str, tuple[Any, list[str]]] = {
    "one element": (
        with_elements("elbow", SLIPS[:1]),
        ["gear.q1.hysteresis", "gear.q2.hysteresis"],
    ),
    "several elements": (
        with_elements("elbow", SLIPS),
        [f"gear.{q}.hysteresis[{k}]" for k in (1, 2, 3) for q in ("q1", "q2")],
    ),
    "bristles": (bristled("elbow", tables("elbow")), ["motor.m1.bristles", "motor.m2.bristles"]),
}


@pytest.mark.parametrize("name", MEMORIES)
def test_states_of_a_plant_are_numbered_one_after_the_other(name: str) -> None:
    """Coordinates, their speeds, then torques of elements; each has a derivative."""
    model, memories = MEMORIES[name]
    found = plant(model, "rk4", None).variables
    states = [v for v in found if v.kind == STATE]
    rates = [v for v in found if v.kind == RATE]
    count = 8 + len(memories)
    assert [v.index for v in states] == list(range(count)) == [v.index for v in rates]
    places = ["arm.q1.position", "arm.q2.position", "rotor.m1.angle", "rotor.m2.angle"]
    speeds = [place.rpartition(".")[0] + ".speed" for place in places]
    assert [v.name for v in states] == places + speeds + memories
    assert [v.name for v in rates] == [f"der({v.name})" for v in states]
    held = hold_joints(derive(model), np.array(model.home))
    assert_allclose([v.start for v in states[:4]], [*held.q_a, *held.q_m])
    assert [v.unit for v in rates[3:5]] == ["rad/s", "rad/s2"]
    assert rates[-1].unit == "N.m/s" and not any(v.start for v in states[4:])


@pytest.mark.parametrize("name", ["elements", "bristles"])
def test_the_bound_of_rates_is_the_fastest_fading_of_small_changes(name: str) -> None:
    """Derivatives of the rates in the torques, by CasADi at many torques up to the largest: never
    faster than the bound, and as fast for some.
    """
    model = with_elements("elbow", BENT) if name == "elements" else MEMORIES["bristles"][0]
    made = plant_memory(derive(model))
    assert made is not None
    given = [ca.SX.sym(f"x{k}", made.function.size1_in(k)) for k in range(5)]
    rates, bound, _ = made.function(*given)
    fading = ca.Function("fading", given, [ca.jacobian(rates, given[4]), bound])
    largest = np.array([v.nominal for v in memory_variables(model, 0)])
    rng = np.random.default_rng(2)
    share = []
    for _ in range(60):
        speeds = rng.normal(size=4)
        z = largest * rng.choice([-1.0, 1.0, 0.999, -0.999, 0.0], size=made.size)
        slopes, most = fading(np.zeros(2), speeds[:2], np.zeros(2), RATIO * speeds[2:], z)
        share.append(-np.diag(np.array(slopes)).min() / float(most))
    assert 0.9 < max(share) <= 1.0 + 1e-9


def test_a_robot_without_memory_has_no_such_states() -> None:
    assert plant_memory(derive(ELBOW)) is None and memory_variables(ELBOW, 40) == []
    assert [v.index for v in memory_variables(MEMORIES["bristles"][0], 40)] == [40, 41]


@pytest.mark.parametrize(("block", "told"), [("plant", True), ("controller", False)])
def test_a_plant_says_what_it_leaves_out(block: str, told: bool, tmp_path: Path) -> None:
    """A controller needs no sensors of the robot."""
    tracker = {"name": "p", "type": "tracker", "unit": "m"}
    robot = flexgen.read("elbow", overrides={"sensor": [tracker]})
    found = flexgen.export_fmu(robot, tmp_path / "a.fmu", block=block, binary=False)
    assert found.notes == (("not in the file: sensor",) if told else ())
