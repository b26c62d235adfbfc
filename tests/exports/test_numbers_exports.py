"""Parts of exports by other routes: directions of bodies by rotations, frictions and limits by
their definitions.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError, BuildError, ModelError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import derive
from flexgen.exports.c_code.plcopen import blocks as plc
from flexgen.exports.fmu import controller as block
from flexgen.exports.mujoco import mujoco_checks
from flexgen.exports.ros2 import export as ros2
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.gains import PPI
from flexgen.model.elements import BacklashSpring, Friction, Output
from flexgen.model.position_servo.filters import LowPass, Notch


# --- MuJoCo --------------------------------------------------------------------------------------
def turn_of(model: flexgen.RobotModel, name: str, q: dict[str, float]) -> np.ndarray:
    """Rotation of an element's body, joint after joint."""
    chain = [name]
    while chain[-1] in model.parents:
        chain.append(model.parents[chain[-1]])
    R = np.array(model.base.rotation)
    for element in (e for e in model.elements if e.name in chain):
        R = R @ np.array(element.origin.rotation)
        for dof in element.dofs:
            if dof.type == "rotation":
                R = R @ Rotation.from_rotvec(q[dof.name] * np.array(dof.axis)).as_matrix()
        R = R @ np.array(element.link.rotation)
    return R


@pytest.mark.parametrize(
    ("name", "turning"),
    [("elbow", 2), ("planar5_nmp", None), ("manutec_r3", 1), ("four_mass@high", None)],
)
def test_bodies_with_one_direction_turn_about_it(name: str, turning: int | None) -> None:
    """By differences of rotations at a pose: the sum over joints of sign times speed; else several
    directions.
    """
    model = flexgen.read(name)
    h = 1e-6
    rng = np.random.default_rng(3)
    count = 0
    joints = [c.name for c in model.coordinates if c.dof is not None]
    q, v = (dict(zip(joints, rng.uniform(-1.0, 1.0, len(joints)), strict=True)) for _ in range(2))
    for element in model.elements:
        found = mujoco_checks.common_axis(model, element.name)
        R, before, after = (
            turn_of(model, element.name, {k: q[k] + s * h * v[k] for k in q})
            for s in (0.0, -1.0, 1.0)
        )
        hat = R.T @ (after - before) / (2 * h)
        speed = np.array([hat[2, 1], hat[0, 2], hat[1, 0]])
        if found is not None:
            axis, signs = found
            assert_allclose(speed, axis * sum(sign * v[k] for k, sign in signs.items()), atol=1e-8)
            count += 1
        else:
            other = {k: rng.uniform(-1.0, 1.0) for k in v}
            hat = R.T @ (turn_of(model, element.name, {k: q[k] + h * other[k] for k in q}) - R) / h
            assert np.linalg.norm(np.cross(speed, [hat[2, 1], hat[0, 2], hat[1, 0]])) > 1e-4
    assert count == (len(model.elements) if turning is None else turning)


def test_a_model_for_mujoco_has_the_frictions_that_are_asked_for() -> None:
    change = {"motor.m1.friction": {"viscous": 0.3, "coulomb": 2.0, "beta": 9.0}}
    model = flexgen.read(
        "elbow",
        overrides=change | {"element.fore.dof.q2.friction": {"viscous": 4.0, "offset": 1.5}},
    )
    assert mujoco_checks.with_friction(model, "exact") is model
    for kind, coulomb in (("viscous", 0.0), ("dry", 2.0)):
        found = mujoco_checks.with_friction(model, kind)
        # beta, without which the law has no Coulomb friction
        law = Friction(0.3, coulomb, beta=9.0) if coulomb else Friction(0.3)
        assert found.motors[0].friction == law and found.elements[1].dofs[0].friction == Friction(
            4.0
        )
        mujoco_checks.check_laws(found, kind == "dry")
    with pytest.raises(ArgumentError) as caught:
        mujoco_checks.with_friction(model, "none")
    assert str(caught.value) == "friction: given 'none', expected one of exact, viscous, dry"
    with pytest.raises(
        ModelError,
        match=r"motor\.m1\.friction\.coulomb: given 2, which is a function tanh of the speed",
    ):
        mujoco_checks.check_laws(replace(model, elements=()), False)
    with pytest.raises(
        ModelError,
        match=r"element\.fore\.dof\.q2\.friction\.offset: given 1\.5, a constant torque, expec",
    ):
        mujoco_checks.check_laws(replace(model, motors=()), False)
    mujoco_checks.check_laws(model, True)
    balanced = flexgen.read(
        "elbow", overrides={"element.upper.dof.q1.counterbalance": {"sin": [5.0]}}
    )
    with pytest.raises(
        ModelError,
        match=r"element\.upper\.dof\.q1\.counterbalance: given a counterbalance, expected",
    ):
        mujoco_checks.check_laws(balanced, True)
    with pytest.raises(
        ModelError,
        match=r"\.beam: given a beam with assumed modes, expected for MuJoCo rigid bodies",
    ):
        mujoco_checks.check_laws(flexgen.read("beam_arm"), True)
    first = model.elements[0]
    dof = first.dofs[0]
    assert dof.gear is not None
    slack = replace(dof, gear=replace(dof.gear, spring=BacklashSpring(1e6, 1e-3, 1e-4)))
    with pytest.raises(
        ModelError,
        match=r"dof\.q1\.gear\.spring: given a spring with a smooth dead band, expected",
    ):
        mujoco_checks.check_laws(replace(model, elements=(replace(first, dofs=(slack,)),)), True)


def test_an_export_for_mujoco_says_which_friction_it_changes(tmp_path: Path) -> None:
    """Nothing where the file has all friction of the model, whatever was asked for."""
    key = "motor.m1.friction"
    differ = "accelerations in MuJoCo differ from those of the model"
    left_out = f"all friction but viscous is left out: {differ}"
    stick = f"Coulomb friction is a constraint with stick: {differ}"
    for friction, notes in (
        (None, {"exact": (), "viscous": ()}),
        ({"viscous": 0.3}, {"dry": ()}),
        ({"viscous": 0.3, "coulomb": 2.0, "beta": 9.0}, {"viscous": (left_out,), "dry": (stick,)}),
    ):
        model = flexgen.read("elbow", overrides={key: friction} if friction else {})
        for kind, expected in notes.items():
            found = flexgen.export_mujoco(model, tmp_path / "arm.xml", friction=kind)
            assert found.notes == expected and found.details["friction"] == kind
    with pytest.raises(
        ModelError, match=r"motor\.m1\.friction\.coulomb: given 2, which is a function tanh"
    ):
        flexgen.export_mujoco(model, tmp_path / "arm.xml")


def test_drives_have_the_ratios_of_their_joints() -> None:
    model = flexgen.read("planar5_nmp")
    found = mujoco_checks.drives(model)
    assert [drive.motor for drive in found] == list(model.motors)
    names = [model.coordinates[i].name for i in model.i_g]
    for drive, row in zip(found, np.array(model.eta), strict=True):
        assert drive.elastic and drive.ratios == {
            n: x for n, x in zip(names, row.tolist(), strict=True) if x
        }
    rigid = mujoco_checks.drives(flexgen.read("elbow@rigid"))
    assert [drive.elastic for drive in rigid] == [False, False]


# --- FMI -----------------------------------------------------------------------------------------
def test_the_block_of_a_cascade_has_its_gains_and_rests_at_home() -> None:
    model = flexgen.read("elbow")
    law = Cascade(
        np.array([20.0, 30.0]),
        np.array([5.0, 4.0]),
        np.array([2.0, 1.0]),
        filters=(Notch(60.0), LowPass(200.0)),
        torque_max=np.array([300.0, 200.0]),
    )
    made = block.controller(model, law, 1e-3)
    start = {x.name: x.start for x in made.variables}
    for k, motor in enumerate(("m1", "m2")):
        own = {
            name: start[f"motor.{motor}.{name}"]
            for name in ("position_gain", "speed_gain", "integral_gain", "torque_max")
        }
        assert list(own.values()) == [
            [20.0, 30.0][k],
            [5.0, 4.0][k],
            [2.0, 1.0][k],
            [300.0, 200.0][k],
        ]
        assert start[f"motor.{motor}.measured_angle"] == start[f"motor.{motor}.reference_angle"]
        assert start[f"motor.{motor}.feedforward_torque"] == start[f"motor.{motor}.torque"]
    held = np.array([start[f"motor.m{k}.torque"] for k in (1, 2)])
    ratio = np.array([motor.ratio[0] for motor in model.motors])
    weight = evaluate(derive(model).function("gravity"), np.array([model.home]))[0].ravel()
    # of the arm at home, whose springs bend little
    assert_allclose(held * ratio, weight, rtol=1e-3)
    angles = np.array([start[f"motor.m{k}.measured_angle"] for k in (1, 2)])
    assert_allclose(angles / ratio, model.home, atol=2e-3)
    filters = np.array(made.constants["FILTERS"]).reshape(2, 2, 5)
    for filtered, each in zip(filters, law.filters, strict=True):
        assert_allclose(filtered, np.tile(each.section(1e-3), (2, 1)))
    assert made.memory == str(4 + 4 * 2 + 20 + 3 * 2 + 2 * 2 * 2) and made.defines == {
        "N_M": "2",
        "SECTIONS": "2",
    }
    assert (made.sample_time, made.step, made.derivatives, made.work) == (1e-3, 1e-3, False, "0")
    order = {x.name: (x.kind, x.index) for x in made.variables}
    assert [
        order[f"motor.m2.{x}"][1]
        for x in ("measured_angle", "reference_angle", "feedforward_torque")
    ] == [1, 3, 5]
    assert [order[f"motor.m2.{x}"][1] for x in ("position_gain", "torque_max")] == [1, 7]
    proposed = block.controller(model, None, 2e-3)
    home = [
        np.array([model.home]),
        *np.zeros((2, 1, 2)),
        np.array([model.home]) * ratio,
        *np.zeros((3, 1, 2)),
    ]
    expected = PPI().cascade(model, 4e-3, home)  # with one sample time of delay
    gains: dict[str, Any] = {x.name: x.start for x in proposed.variables}
    assert_allclose(
        [gains[f"motor.m{k}.speed_gain"] for k in (1, 2)], expected.speed_gain, rtol=1e-2
    )
    assert_allclose(
        [gains[f"motor.m{k}.position_gain"] for k in (1, 2)], expected.position_gain, rtol=1e-2
    )
    for given, text in (
        (
            "none.toml",
            "controller: given 'none.toml', which does not exist, expected a file .toml",
        ),
        (
            3.0,
            (
                "controller: given float, expected a flexgen.Cascade or flexgen.PPI for the "
                "block 'controller'"
            ),
        ),
    ):
        with pytest.raises(ArgumentError) as caught:
            block.controller(model, given, 1e-3)
        assert str(caught.value) == text


# --- ROS 2 ---------------------------------------------------------------------------------------
def test_limits_of_a_controller_are_those_of_the_model() -> None:
    """Zero where there is none."""
    change = {
        "motor.m1.torque_max": 300.0,
        "motor.m2.speed_max": 40.0,
        "motor.m2.torque_rate_max": 8e3,
    }
    found = ros2._limits(flexgen.read("elbow", overrides=change))
    assert_allclose(found["torque_max"], [300.0, 0.0])
    assert_allclose(found["speed_max"], [0.0, 40.0])
    assert_allclose(found["torque_rate_max"], [0.0, 8e3])
    assert [
        found[name].shape for name in ("tool_speed_max", "tool_acceleration_max", "torque_speed")
    ] == [
        (1,),
        (1,),
        (0,),
    ]
    none = ros2._limits(flexgen.read("elbow"))
    assert none.keys() == found.keys() and not any(x.any() for x in none.values())
    other = ros2._limits(flexgen.read("four_mass"))  # whose output is none of the tool
    assert [other[name].tolist() for name in ("tool_speed_max", "tool_acceleration_max")] == [
        [0.0],
        [0.0],
    ]


@pytest.mark.parametrize(
    ("sample_s", "samples"), [(1e-3, 4), (4e-3, 1), (4e-3 / 3 * (1 + 0.9e-6), 3)]
)
def test_a_servo_has_whole_samples_in_an_interval(sample_s: float, samples: int) -> None:
    assert ros2._servo_samples(Made(name="arm", servo=Made(sample_time=sample_s)), 4e-3) == samples


@pytest.mark.parametrize("sample_s", [9e-3, 3e-3, 4e-3 / 3 * (1 + 1.1e-6)])
def test_servos_without_whole_samples_in_an_interval_are_refused(sample_s: float) -> None:
    with pytest.raises(ArgumentError) as caught:
        ros2._servo_samples(Made(name="arm", servo=Made(sample_time=sample_s)), 4e-3)
    text = (
        f"servo.sample_time of arm: given {sample_s} s, expected a part of 0.004 s, an interval "
        "of the stream"
    )
    assert str(caught.value) == text


def test_words_of_a_package_for_ros() -> None:
    assert (
        ros2._package_name(None, "Arm") == "flexgen_arm"
        and ros2._package_name("a" * 60, "x") == "a" * 60
    )
    for name in ("a" * 61, "A", "a__b", "1a", "a_", ""):
        with pytest.raises(
            BuildError,
            match="expected small letters, digits and single underscores, beginning with a",
        ):
            ros2._package_name(name, "x")
    with pytest.raises(
        BuildError,
        match=r"given 'double', which is a word of C\+\+, expected another name, such as",
    ):
        ros2._package_name("double", "x")
    assert ros2.numbers([1.0, 1e-5, -2e22, 0.1]) == "1.0, 1.0e-05, -2.0e+22, 0.1"
    for kind, axes, rows in (
        ("tool_position", "xz", "0, 2"),
        ("tool_pose", "xyz", "0, 1, 2, 3, 4, 5"),
    ):
        model: Any = Made(output=Output(kind, axes=axes))
        assert ros2._wrench_rows(model) == rows
    with pytest.raises(
        ArgumentError,
        match="given force for arm, whose output is none of the tool, expected no parts",
    ):
        ros2._wrench_rows(Made(name="arm", output=Made(type="combination")))
    units = (
        "position_gain: [1.0, 2.0]  # [1/s]",
        "speed_gain: [3.0, 0.0]  # [N m s/rad]",
        "integral_gain: [5.0, 6.0]",
    )
    law = Cascade(np.array([1.0, 2.0]), np.array([3.0, 0.0]), np.array([5.0, 6.0]))
    text = ros2._gains_text(law, 2)
    assert all(f"    {unit}" in text for unit in units) and text.startswith(
        "    # P-PI control.\n"
    )
    assert "    # speed_gain: [..., ...]  # [N m s/rad]\n" in ros2._gains_text(None, 2)
    for wrong, words in (
        (
            replace(law, filters=(Notch(60.0),)),
            "gains: given Cascade, expected a Cascade without filters",
        ),
        (law, "gains, position_gain: given [1. 2.], expected 3 numbers >= 0, one for each motor"),
    ):
        with pytest.raises(ArgumentError) as caught:
            ros2._gains_text(wrong, 3)
        assert str(caught.value) == words
    files: Any = ros2._files("arm", True, ("force",))
    assert files["force_ramp.hpp"] == "include/arm/force_ramp.hpp" and "cascade.hpp" in files
    assert (
        len(files)
        == len(ros2._files("arm", True, ())) + 1
        == len(ros2._files("arm", False, ())) + 8
    )
    served = ros2._files("arm", True, ("position",))
    assert "position_window.hpp" in served and "cascade.hpp" not in served


# --- PLCopen -------------------------------------------------------------------------------------
def test_blocks_of_a_controller_have_the_sizes_of_the_robot() -> None:
    """Two motors, four samples in an interval; the memory of the stream by the numbers in the
    header.
    """

    def port(name: str, size: int, unit: str) -> dict[str, Any]:
        return {"name": name, "shape": [size], "unit": unit, "doc": f"the {name}"}

    dynamics = {
        "name": "inverse_dynamics",
        "summary": "torques of a motion",
        "inputs": [port("q_a", 3, "rad"), port("v_a", 3, "rad/s")],
        "outputs": [port("tau_a", 3, "N m")],
    }
    macro = (
        "#define ARM_STREAM_SIZE(intervals, samples_per_interval) \\\n"
        "    (INT64_C(100) + INT64_C(7) * (intervals) + INT64_C(3) * (samples_per_interval))"
    )
    library: Any = Made(
        name="arm",
        model=Made(name="arm"),
        functions=[{"name": "gravity"}, dynamics],
        sizes={"n_m": 2, "n_t": 12, "n_y": 6, "n_a": 3},
        stream=Made(intervals=20, samples_per_interval=4, period=0.004),
        header=f"/* sizes */\n{macro}\n",
    )
    first, stream = plc.blocks(library, True)
    assert (first.name, first.doc, first.memory) == (
        "FB_arm_inverse_dynamics",
        "torques of a motion",
        (),
    )
    assert [(v.name, v.type, v.size, v.doc) for v in first.inputs] == [
        ("q_a", "LREAL", 3, "[rad] the q_a"),
        ("v_a", "LREAL", 3, "[rad/s] the v_a"),
    ]
    assert [v.name for v in first.outputs] == ["tau_a", "valid", "error", "status"]
    sizes = {v.name: v.size for v in (*stream.inputs, *stream.outputs, *stream.memory)}
    assert sizes == {
        **{"enable": 0, "start_output": 12, "q_start": 3, "y": 12, "dy": 6, "ddy": 6},
        **{"tau_m": 8, "q_m": 8, "v_m": 8, "valid": 0, "error": 0, "status": 0},
        **{"memory": 100 + 7 * 20 + 3 * 4, "started": 0},
    }
    assert (
        stream.name == "FB_arm_stream"
        and "a moving horizon of 20 intervals. Call it every 0.004 s" in stream.doc
    )
    assert [keyword for keyword, _ in first.sections] == [
        keyword for keyword, _ in stream.sections
    ][:2]
    text = plc.struct(first).splitlines()
    assert text[0] == "typedef struct {" and text[-1] == "} fb_arm_inverse_dynamics;"
    assert text[2].strip() == "double q_a[3];" and text[-2].strip().endswith(" status;")
    assert len(plc.blocks(library, False)) == 1
    library.stream = None
    assert len(plc.blocks(library, False)) == 1
    with pytest.raises(ArgumentError) as caught:
        plc.blocks(library, True)
    assert str(caught.value).startswith(
        "model arm: given a home pose at which no stream can start (singular, or without"
    )
