"""Limits of the model file in the files for other programs, where only one end or only some are
stated.
"""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.exports.ros2.export import servo_samples, wrench_rows
from flexgen.exports.urdf.urdf import UNLIMITED
from flexgen.feedback.loop.controllers import Cascade
from flexgen.model.position_servo.filters import Notch

LOWER = "element.upper.dof.q1.lower_rad"


def test_a_limit_at_one_end_is_kept(tmp_path):
    robot = flexgen.read("elbow", overrides={LOWER: -1.5})
    urdf = ElementTree.parse(flexgen.export_urdf(robot, tmp_path / "arm.urdf").path)
    joints = {joint.get("name"): joint for joint in urdf.iter("joint")}
    assert joints["q1"].get("type") == "revolute" and joints["q2"].get("type") == "continuous"
    limit = joints["q1"].find("limit")
    assert (float(limit.get("lower")), float(limit.get("upper"))) == (-1.5, 1e6)
    mjcf = ElementTree.parse(flexgen.export_mujoco(robot, tmp_path / "arm.xml").path)
    ranges = {joint.get("name"): joint.get("range") for joint in mjcf.iter("joint")}
    assert ranges["q1"].split()[0] == "-1.5" and ranges["q2"] is None


def test_the_controller_for_ros_has_the_torque_limits_without_its_file_of_parameters(tmp_path):
    robot = flexgen.read("elbow", overrides={"motor.m1.torque_max": 30.0})
    package = flexgen.export_ros2(robot, tmp_path / "arm", package="arm", gains=None).directory
    assert "torque_max: [30.0, 0.0]" in (package / "config" / "controller.yaml").read_text()
    assert re.search(
        r"TORQUE_MAX = \{30.0, 0.0\};", (package / "include" / "arm" / "arm.hpp").read_text()
    )
    source = (package / "src" / "stream_controller.cpp").read_text()
    assert (
        'auto_declare<std::vector<double>>( "torque_max", std::vector<double>(TORQUE_MAX.begin()'
        in " ".join(source.split())
    )


Q1 = "element.upper.dof.q1"
JOINTS = {
    "free": ({}, "continuous", {}, None),
    "one end": (
        {f"{Q1}.lower_rad": -1.5, f"{Q1}.speed_max": 3.0},
        "revolute",
        {"lower": -1.5, "upper": UNLIMITED, "velocity": 3.0},
        None,
    ),
    "a torque": ({"motor.m1.torque_max": 2.0}, "continuous", {"effort": 2.0 * 1872 / 7}, None),
    "viscous friction": ({f"{Q1}.friction": {"viscous": 2.0}}, "continuous", {}, (2.0, 0.0)),
    "dry friction": (
        {f"{Q1}.friction": {"coulomb": 3.0, "beta": 9.0}},
        "continuous",
        {},
        (0.0, 3.0),
    ),
}


@pytest.mark.parametrize("name", JOINTS)
def test_joints_of_a_urdf_file_have_the_limits_and_frictions_of_the_model(name, tmp_path):
    changes, kind, limits, friction = JOINTS[name]
    robot = flexgen.read("elbow", overrides=changes)
    root = ElementTree.parse(flexgen.export_urdf(robot, tmp_path / "arm.urdf").path)
    joint = next(x for x in root.iter("joint") if x.get("name") == "q1")
    found = {key: float(x) for key, x in joint.find("limit").attrib.items()}
    none = {"effort": UNLIMITED, "velocity": UNLIMITED}
    assert joint.get("type") == kind and found == pytest.approx(none | limits)
    rubs = joint.find("dynamics")
    assert (rubs is None) == (friction is None)
    if friction:
        assert (float(rubs.get("damping")), float(rubs.get("friction"))) == friction


def test_a_joint_of_a_translation_has_both_limits(tmp_path):
    root = ElementTree.parse(flexgen.export_urdf("urdf_arm", tmp_path / "arm.urdf").path)
    slide = next(x for x in root.iter("joint") if x.get("name") == "slide")
    assert slide.get("type") == "prismatic" and slide.find("limit").get("lower") is not None


def test_the_controller_for_ros_has_all_limits_of_the_model(tmp_path):
    """Zero where there is none."""
    changes = {
        "motor.m1.torque_max": 300.0,
        "motor.m2.speed_max": 40.0,
        "motor.m2.torque_rate_max": 8e3,
        "tool.speed_max": 1.5,
    }
    robot = flexgen.read("elbow", overrides=changes)
    gains = Cascade(*([1.0, 2.0], [3.0, 0.0], [5.0, 6.0]))
    package = flexgen.export_ros2(
        robot, tmp_path / "arm", package="arm", gains=gains, parts=["limits"]
    ).directory
    text = (package / "config" / "controller.yaml").read_text()
    for line in (
        "torque_max: [300.0, 0.0]",
        "speed_max: [0.0, 40.0]",
        "torque_rate_max: [0.0, 8000.0]",
        "tool_speed_max: 1.5",
        "tool_acceleration_max: 0.0",
        "position_gain: [1.0, 2.0]  # [1/s]",
        "speed_gain: [3.0, 0.0]  # [N m s/rad]",
        "integral_gain: [5.0, 6.0]  # [1/s]",
    ):
        assert line in text, line
    source = (package / "include" / "arm" / "arm.hpp").read_text()
    assert "LIMIT_SPEED_MAX = {0.0, 40.0};" in source
    assert "LIMIT_TOOL_SPEED_MAX = {1.5};" in source


GAINS = {
    "a filter": (
        Cascade([1.0, 2.0], [3.0, 4.0], [5.0, 6.0], filters=(Notch(60.0),)),
        "gains: given Cascade, expected a Cascade without filters",
    ),
    "three motors": (
        Cascade([1.0] * 3, [3.0] * 3, [5.0] * 3),
        "gains, position_gain: given [1. 1. 1.], expected 2 numbers >= 0, one for each motor",
    ),
}


@pytest.mark.parametrize("name", GAINS)
def test_gains_that_a_package_cannot_have_are_refused(name, tmp_path):
    gains, text = GAINS[name]
    with pytest.raises(ArgumentError) as caught:
        flexgen.export_ros2("elbow", tmp_path / "arm", gains=gains)
    assert str(caught.value) == text


SERVO = {
    "type": "cascade",
    "position_gain": [30.0, 25.0],
    "speed_gain": [1.5, 0.4],
    "integral_gain": [0.0, 0.0],
}


def sampled(sample_s):
    robot = flexgen.read("elbow", overrides={"servo": SERVO})
    return replace(robot, servo=replace(robot.servo, sample_time=sample_s))


@pytest.mark.parametrize(
    ("sample_s", "samples"), [(1e-3, 4), (4e-3, 1), (4e-3 / 3 * (1 + 0.9e-6), 3)]
)
def test_a_servo_has_whole_samples_in_an_interval(sample_s, samples):
    assert servo_samples(sampled(sample_s), 4e-3) == samples


@pytest.mark.parametrize("sample_s", [9e-3, 3e-3, 4e-3 / 3 * (1 + 1.1e-6)])
def test_servos_without_whole_samples_in_an_interval_are_refused(sample_s):
    text = f"servo.sample_time of elbow: given {sample_s} s, expected a part of 0.004 s"
    with pytest.raises(ArgumentError, match=re.escape(text)):
        servo_samples(sampled(sample_s), 4e-3)


ROWS = {
    "elbow": "0, 2",
    "manutec_r3": "0, 1, 2, 3, 4, 5",
    "four_mass": "whose output is none of the tool, expected no parts",
}


@pytest.mark.parametrize("name", ROWS)
def test_a_force_acts_on_the_directions_of_the_output(name):
    robot = flexgen.read(name)
    if robot.output.type == "combination":
        with pytest.raises(ArgumentError, match=ROWS[name]):
            wrench_rows(robot)
        return
    assert wrench_rows(robot) == ROWS[name]
