"""Limits of the model file in the files for other programs, where only one end or only some are
stated.
"""

from __future__ import annotations

import re
from xml.etree import ElementTree

import flexgen

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
        'auto_declare<std::vector<double>>("torque_max", std::vector<double>(TORQUE_MAX.begin()'
        in source
    )
