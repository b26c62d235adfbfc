"""Poses of experiments keep away from boxes.

Distances are compared with those of a plane arm, whose links are lines in closed form.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main

INF = math.inf
SHORT = {"period_s": 1.0, "lines": 6, "progress": False}


def joints_of_elbow(q: np.ndarray) -> np.ndarray:
    """Second joint and tool of `elbow` (2, 3) [m] at joints (2,) [rad], see its file."""
    first = 1.150  # m
    second = 1.241  # m
    elbow = first * np.array([math.sin(q[0]), 0.0, math.cos(q[0])])
    angle = q[0] + q[1]
    return np.array([elbow, elbow + second * np.array([math.cos(angle), 0.0, -math.sin(angle)])])


@pytest.mark.parametrize("seed", range(6))
def test_a_box_is_as_far_as_the_nearest_of_many_points(seed: int) -> None:
    random = np.random.default_rng(seed)
    lower = random.uniform(-1.0, 0.0, 3)
    upper = random.uniform(0.1, 1.0, 3)
    box = flexgen.Box(lower, upper)
    points = random.uniform(-2.0, 2.0, (20, 3))
    grid = np.stack(np.meshgrid(*np.linspace(lower, upper, 25).T), axis=-1).reshape(-1, 3)
    nearest = np.linalg.norm(points[:, None] - grid, axis=2).min(axis=1)
    found = box.distance(points)
    step = np.linalg.norm(upper - lower) / 24
    assert (found <= nearest + 1e-12).all() and (nearest - found <= step).all()


def test_chosen_poses_keep_their_clearance_and_given_ones_are_refused() -> None:
    """The wall is put through the places that the arm would take."""
    free = flexgen.excite("elbow", poses=4, **SHORT)
    model = flexgen.read("elbow")
    reaches = [joints_of_elbow(q)[:, 0].max() for q in free.joints(model)]
    level = float(np.median(reaches))
    wall = flexgen.Box((level, -INF, -INF), (INF, INF, INF))
    kept = flexgen.excite("elbow", poses=4, obstacles=[wall], clearance=0.05, **SHORT)
    assert len(kept.poses) == 4
    for q in kept.joints(model):
        assert joints_of_elbow(q)[:, 0].max() <= level - 0.05
    farthest = free.joints(model)[int(np.argmax(reaches))]
    with pytest.raises(ArgumentError, match=r"pose 1: the link from .* comes within"):
        flexgen.excite("elbow", poses=[farthest], obstacles=[wall], **SHORT)
    everything = flexgen.Box((-INF, -INF, -INF), (INF, INF, INF))
    with pytest.raises(ArgumentError, match="no pose has room for the motion"):
        flexgen.excite("elbow", poses=2, obstacles=[everything], **SHORT)


def test_a_line_between_two_joints_may_not_cross_a_box() -> None:
    """Both ends of the link are far from it."""
    q = np.array([0.4, -0.3])
    second, tool = joints_of_elbow(q)
    middle = 0.5 * (second + tool)
    box = flexgen.Box(middle - 0.02, middle + 0.02)
    assert box.distance([second, tool]).min() > 0.1
    with pytest.raises(ArgumentError, match="to the tool comes within"):
        flexgen.excite("elbow", poses=[q], obstacles=[box], clearance=0.03, **SHORT)


@pytest.mark.parametrize(
    ("corners", "words"),
    [
        (((0, 0), (1, 1, 1)), "box, lower: given .* expected three numbers in m"),
        (((0, 0, 0), (1, math.nan, 1)), "box, upper: given .* expected three numbers in m"),
        (((0, 0, 0), (1, 0, 1)), "expected upper numbers above the lower ones"),
    ],
)
def test_corners_that_make_no_box_are_refused(corners: tuple, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        flexgen.Box(*corners)


def test_poses_and_boxes_of_the_command_line(tmp_path, capsys) -> None:
    out = str(tmp_path / "plan.npz")
    short = ["--period-s", "1", "--lines", "6", "-q", "--out", out]
    given = ["--pose", "0.5,-0.3", "--pose", "0.1,0.2", "--obstacles", "-inf,-inf,-inf:inf,inf,-9"]
    assert main(["excite", "elbow", *given, *short]) == 0
    model = flexgen.read("elbow")
    assert np.allclose(flexgen.Plan.load(out).joints(model), [[0.5, -0.3], [0.1, 0.2]])
    assert main(["excite", "elbow", "--pose", "0.5", *short]) == 1
    assert "--pose: given 1 numbers, expected 2: q1, q2" in capsys.readouterr().err
    assert main(["excite", "elbow", "--obstacles", "0,0,0:1,1", *short]) == 2
    assert "expected X,Y,Z:X,Y,Z, lower and upper corner" in capsys.readouterr().err
