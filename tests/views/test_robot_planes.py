"""The planes in which a robot is drawn, and the margins of the drawing, read back from the axes of
its figure.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_results import made_trajectory
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.views.plots import solution

DOWN = [0.0, 0.0, -9.81]
# An arm of one link along x, whose axis is along y or z, or a slider along x.
ARM = """
name = "one"
description = "an arm of one link"
source = "invented"
gravity = {gravity}
home_rad = [0.2]
[[element]]
name = "link"
body = {{ mass = 1.0, com = [0.3, 0, 0], inertia = [0.01, 0.01, 0.01] }}
[[element.dof]]
name = "q"
type = "{type}"
axis = {axis}
gear = {{ type = "rigid" }}
[[motor]]
name = "m"
drives = "q"
ratio = 50.0
inertia = 1e-5
[tool]
position = [0.7, 0, 0]
[output]
type = "joint"
joints = ["q"]
[[move]]
name = "line"
type = "joint"
start_rad = [0.0]
end_rad = [1.0]
duration = 1.0
smoothness = 5
"""
ROLL = ("rotation", [0, 1, 0])
YAW = ("rotation", [0, 0, 1])
SLIDE = ("translation", [1, 0, 0])


def labels(figure: Any) -> list[str]:
    return [ax.get_xlabel()[0] + ax.get_ylabel()[0] for ax in figure.get_axes()]


def drawn(equations: Equations) -> Any:
    return solution.robot(equations, made_trajectory(equations))


@pytest.mark.parametrize(
    ("gravity", "planes"),
    [
        (DOWN, ["xz", "yz", "xy"]),
        ([0.0, 0.0, 0.0], ["xz", "yz", "xy"]),
        ([9.81, 0.0, 0.0], ["yx", "zx", "yz"]),
    ],
)
def test_a_spatial_robot_is_drawn_in_three_planes_with_its_gravity_downwards(
    gravity: list[float], planes: list[str]
) -> None:
    model = flexgen.read("urdf_arm", overrides={"gravity": gravity})
    assert labels(drawn(derive(model))) == planes


@pytest.mark.parametrize(
    ("kind", "gravity", "planes"),
    [
        (ROLL, DOWN, ["xz"]),
        (ROLL, [-9.81, 0.0, 0.0], ["zx"]),
        (ROLL, [0.0, -9.81, 0.0], ["xz"]),  # gravity across the plane
        (YAW, [0.0, -9.81, 0.0], ["xy"]),
        (YAW, [-9.81, 0.0, 0.0], ["yx"]),
        (SLIDE, DOWN, ["xz"]),  # a line: a plane that contains gravity
        (SLIDE, [0.0, -9.81, 0.0], ["xy"]),
    ],
)
def test_a_flat_robot_is_drawn_in_its_own_plane(
    kind: tuple[str, list[int]], gravity: list[float], planes: list[str], tmp_path: Path
) -> None:
    file = tmp_path / "one.toml"
    file.write_text(ARM.format(gravity=gravity, type=kind[0], axis=kind[1]))
    assert labels(drawn(derive(file))) == planes


def test_a_robot_without_extent_is_drawn_by_its_output() -> None:
    assert [ax.get_ylabel() for ax in drawn(derive("four_mass")).get_axes()] == ["output, m"]


def test_a_drawing_has_a_margin_of_its_largest_extent() -> None:
    """Seven hundredths, of the robot at its instants and of the path of the tool."""
    equations = derive("elbow")
    trajectory = made_trajectory(equations)
    (ax,) = solution.robot(equations, trajectory).get_axes()
    lines = [line.get_xydata() for line in ax.lines if len(line.get_xdata()) > 2]
    tool = evaluate(equations.function("forward_kinematics"), trajectory["q_a"])[0][:, [0, 2]]
    assert any(line.shape == tool.shape and np.allclose(line, tool) for line in lines)
    points = np.vstack([*[x for x in lines if len(x) != len(tool)], tool])
    margin = 0.07 * np.ptp(points, axis=0).max()
    low = points.min(axis=0) - margin
    high = points.max(axis=0) + margin
    assert_allclose([ax.get_xlim(), ax.get_ylim()], np.stack([low, high], axis=1))
