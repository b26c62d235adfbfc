"""Checks of `plan` in long programs: ranges, reach and limits of joints in short sections, against
closed forms.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import SolverError
from flexgen.model.moves import Move, MoveJ, MoveL, Program
from flexgen.paths.path import CHECKED, Path, joints_along
from flexgen.paths.timing.joint_limits import InverseKinematics
from flexgen.studies.check.moves import moves

LENGTH = 0.8  # m, of both links of planar5_nmp
START = (0.3, -1.1)
PROFILE = (0.5, 5.0, 200.0, 1e4)


def joints(y: np.ndarray) -> np.ndarray:
    """Angles (n, 2) of the arm without deflections at positions (n, 2)."""
    q2 = -np.arccos(((y**2).sum(axis=1) - 2 * LENGTH**2) / (2 * LENGTH**2))
    q1 = np.arctan2(y[:, 1], y[:, 0]) - np.arctan2(LENGTH * np.sin(q2), LENGTH * (1 + np.cos(q2)))
    return np.stack([np.unwrap(q1), q2], axis=1)


def program(*steps: Any, profile: tuple[float, ...] = PROFILE, **more: Any) -> Program:
    return Program("long", start=START, smoothness=5, steps=steps, profile=profile, **more)


DETOUR = (
    MoveL((0.0, 0.12, 0.0), zone=0.002),
    MoveL((0.05, 0.0, 0.0), zone=0.002),
    MoveL((0.0, -0.12, 0.0), zone=0.002),
)
SLOW = MoveL((-0.05, 0.0, 0.0), zone=0.002, speed=2e-4)  # 250 s


@pytest.mark.parametrize("pause", [0.0, 300.0])
def test_a_range_left_for_a_short_time_of_a_long_program_is_refused(pause: float) -> None:
    steps = (SLOW, *DETOUR, MoveL((-0.05, 0.0, 0.0)))
    if pause:
        steps = (*DETOUR, MoveL((-0.05, 0.0, 0.0), pause=pause), MoveL((0.0, 0.02, 0.0)))
    path = flexgen.plan("planar5_nmp", program(*steps))
    q = joints(path.sample(np.linspace(0.0, path.duration, 200_001)).y[:, :, 0])
    largest = q[:, 0].max()
    assert ((q[:, 0] > largest - 0.01).sum() / len(q)) * path.duration < 0.01 * path.duration

    def with_range(upper: float) -> flexgen.RobotModel:
        changes = {
            "element.arm1.dof.q1.upper_rad": float(upper),
            "move.joints.end_rad": [0.32, -1.2],
        }
        return replace(flexgen.read("planar5_nmp", overrides=changes), programs=(program(*steps),))

    flexgen.plan(with_range(largest + 1e-4), program(*steps))
    with pytest.raises(
        SolverError, match=r"coordinate q1 goes to .*choose another target or path"
    ):
        flexgen.plan(with_range(largest - 0.01), program(*steps))
    flexgen.plan(with_range(largest - 0.01), program(*steps), ignore_limits=True)
    (found,) = [
        f
        for f in moves(flexgen.derive(with_range(largest - 0.01)))
        if "long" in f.key and "range" in f.quantity
    ]
    assert "q1 reaches" in str(found)


def test_a_path_out_of_reach_for_a_short_time_of_a_long_program_is_refused() -> None:
    """1.70 m from the base of an arm that reaches 1.6 m, for less than 1 s of 200 s."""
    steps = (
        MoveL((0.345, 0.0, 0.0)),
        MoveL((-0.345, 0.0, 0.0), pause=200.0),
        MoveL((0.0, 0.1, 0.0)),
    )
    path = Path(flexgen.derive("planar5_nmp"), program(*steps))
    far = (
        np.linalg.norm(path.sample(np.linspace(0.0, path.duration, 100_001)).y[:, :, 0], axis=1)
        > 2 * LENGTH
    )
    assert 0.001 < far.mean() < 0.01
    with pytest.raises(SolverError, match=r"inverse kinematics: .* after 0\.\d+ % of the time"):
        flexgen.plan("planar5_nmp", program(*steps))


@pytest.mark.parametrize("smoothness", [0, 5])
def test_accelerations_of_joints_are_kept_in_short_corners_of_long_programs(
    smoothness: int,
) -> None:
    limits = {
        "element.arm1.dof.q1.acceleration_max": 1.0,
        "element.arm2.dof.q2.acceleration_max": 1.0,
    }
    robot = flexgen.read("planar5_nmp", overrides=limits)
    steps = (SLOW, *DETOUR, MoveL((-0.05, 0.0, 0.0)))
    path = flexgen.plan(
        robot,
        Program(
            "long", start=START, smoothness=smoothness, steps=steps, profile=(0.1, *PROFILE[1:])
        ),
    )
    t = np.linspace(path.duration - 8.0, path.duration, 80_001)
    rates = np.gradient(np.gradient(joints(path.sample(t).y[:, :, 0]), t, axis=0), t, axis=0)[3:-3]
    assert 0.99 < np.abs(rates).max() < 1.0 + 2e-4


@pytest.mark.parametrize("distance", [0.01, 0.002])
def test_speeds_of_joints_are_kept_near_a_singular_pose_in_a_program(distance: float) -> None:
    """A line of 1.8 m past the base, where the first joint turns half around within some
    millimeters.
    """
    robot = flexgen.read("planar5_nmp", overrides={"element.arm1.dof.q1.speed_max": 2.0})
    start = tuple(joints(np.array([[-0.9, distance]]))[0])
    steps = MoveL((1.8, 0.0, 0.0), zone=0.01), MoveL((0.0, 0.2, 0.0))
    path = flexgen.plan(
        robot,
        Program("p", start=start, smoothness=5, steps=steps, profile=(0.5, 2.0, 30.0, 600.0)),
    )
    t = np.linspace(0.0, path.duration, 400_001)
    q1 = joints(path.sample(t).y[:, :, 0])[:, 0]
    assert 1.999 < np.abs(np.gradient(q1, t)).max() < 2.0002


def test_single_moves_and_programs_are_checked_at_instants_in_each_section() -> None:
    robot = flexgen.derive("planar5_nmp")
    ((q, v),) = joints_along(
        Path(robot, Move("line", "tool_line", START, 0.5, 5, (-0.2, 0.21, 0.0))), speeds=True
    )
    assert q.shape == v.shape == (CHECKED, 2)
    path = Path(robot, program(SLOW, *DETOUR, MoveL((-0.05, 0.0, 0.0))))
    t = path.segments[0].instants(CHECKED)
    ends = np.cumsum([s.length for s in path.segments[0].curve.sections])
    place = path.segments[0].law(t)[:, 0]
    inside = np.histogram(place, [0.0, *ends])[0]
    assert (inside >= 16).all() and len(inside) == 9 and (np.diff(t) > 0).all()
    assert np.abs(np.interp(ends[:-1], place, place) - ends[:-1]).max() < 1e-9
    mixed = program(
        MoveJ((0.4, -1.2)), MoveL((-0.1, 0.0, 0.0)), joint_profile=(1.0, 5.0, 60.0, 900.0)
    )
    first, second = joints_along(Path(robot, mixed))
    assert (
        np.abs(first[0][-1] - (0.4, -1.2)).max() < 1e-12
        and np.abs(second[0][0] - (0.4, -1.2)).max() < 1e-9
    )


def test_many_instants_are_solved_as_one_by_one() -> None:
    """Also where those at once do not converge nearby: then all are solved one after the other."""
    robot = flexgen.derive("planar5_nmp")
    path = Path(robot, program(SLOW, *DETOUR, MoveL((-0.05, 0.0, 0.0))))
    t = path.segments[0].instants(401)
    sample = path.sample(t)
    kinematics = InverseKinematics(robot)
    expected = joints(sample.y[:, :, 0])
    for found in (
        kinematics.follow_many(sample, np.array(START), t / path.duration),
        kinematics.follow(sample, np.array(START), t / path.duration),
    ):
        assert np.abs(found - expected).max() < 1e-9
    targets = sample.y[:, :, 0]
    assert kinematics._at_once(targets, expected + 0.01, np.zeros_like(expected)) is not None
    # the elbow on the other side
    other = np.stack([expected[:, 0] + expected[:, 1], -expected[:, 1]], axis=1)
    assert kinematics._at_once(targets, other - 0.3, np.zeros_like(expected)) is None
    # singular
    assert kinematics._at_once(targets, np.zeros_like(expected), np.ones_like(expected)) is None
    kinematics._at_once = lambda *given: None  # type: ignore[method-assign]
    assert (
        np.abs(kinematics.follow_many(sample, np.array(START), t / path.duration) - expected).max()
        < 1e-9
    )
