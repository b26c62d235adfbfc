"""Timed segments: bounds of the path and limits of joints are kept and reached, breaks, ends."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import SolverError
from flexgen.paths.geometry.blended_curve import BlendedCurve
from flexgen.paths.geometry.segments import Arc, Line
from flexgen.paths.reference import Reference
from flexgen.paths.timing import timed_segments
from flexgen.paths.timing.joint_limits import InverseKinematics
from flexgen.paths.timing.time_laws import TimeLaw
from flexgen.paths.timing.timed_segments import TimedSegment, plan_law

EXCESS = 1e-5  # relative: the largest derivatives are searched on a grid of 1/16 of 800 intervals
NO_TURN = np.zeros(3)
Q1 = "element.upper.dof.q1"


def reference(**overrides: Any) -> Reference:
    return Reference(flexgen.derive(flexgen.read("elbow", overrides=overrides)))


def arc(radius: float, angle: float, turn: np.ndarray = NO_TURN, per_rad: float = 1.0) -> Any:
    """From the origin about a center on the x axis; the tool turns by a vector [rad]."""
    segment = Arc(np.array([radius, 0, 0]), np.array([0, 0, 1.0]), angle, turn, per_rad)
    return BlendedCurve(np.zeros(3), np.eye(3) if turn.any() else None, [segment], [])


def corner(zone: float) -> BlendedCurve:
    """Two lines of 1 m at a right angle."""
    lines = [Line(np.eye(3)[k], NO_TURN, 1.0) for k in range(2)]
    return BlendedCurve(np.zeros(3), None, lines, [zone])


def norms(segment: TimedSegment, radius: float, n: int = 40001) -> np.ndarray:
    """Largest norm of each derivative, by many instants and its definition."""
    t = segment.start + np.linspace(0.0, segment.law.duration, n)
    x, attitude = segment.at(t)
    if segment.space != "tool":
        return np.abs(x[:, :, 1:]).max(axis=(0, 1))
    found = np.linalg.norm(x[:, :3, 1:], axis=1).max(axis=0)
    if attitude is not None:
        found = np.maximum(found, radius * np.linalg.norm(attitude[1], axis=1).max(axis=0))
    return found


ARC = (0.4, 1.5)  # radius [m] and angle [rad]


@pytest.mark.parametrize("smoothness", [0, 4])
@pytest.mark.parametrize(
    ("bounds", "speed"),
    [
        ((0.3, 9.0, 99.0), 0.3),
        ((3.0, 0.2, 99.0), np.sqrt(0.2 * 0.4)),  # v^2 / r
        ((3.0, 9.0, 0.1), np.cbrt(0.1 * 0.4**2)),  # v^3 / r^2
    ],
)
def test_curvature_bounds_the_speed_along_an_arc(
    bounds: tuple[float, ...], speed: float, smoothness: int
) -> None:
    """No derivative exceeds its bound; the speed of the middle is the one that curvature allows,
    unless a change of speed needs the bound, too.
    """
    own = bounds[:2] if smoothness == 0 else bounds
    curve = arc(*ARC)
    law = plan_law(reference(), "tool", curve, own, smoothness, 1.0, None)
    segment = TimedSegment("tool", curve, law)
    found = norms(segment, 1.0)
    if smoothness:
        assert (found[: len(own)] <= np.array(own) * (1 + EXCESS)).all()
        assert law.smoothness == smoothness
    if smoothness or bounds[2] > 9.0:
        assert found[0] <= speed * (1 + 1e-6)
    # the largest excess decides: some bound is reached
    if smoothness:
        assert (found[: len(own)] / own).max() > 0.9


def test_a_bound_that_is_exceeded_slows_the_whole_motion_down() -> None:
    """Derivatives of order k by the k-th power of one factor, until the bound is met."""
    curve = arc(*ARC)
    free = plan_law(reference(), "tool", curve, (0.5, 5.0, 1e9), 4, 1.0, None)
    peaks = norms(TimedSegment("tool", curve, free), 1.0)
    for part in (0.5, 0.01):
        # only the jerk of the changes of speed, which stretches of the curve do not have
        bounds = (0.5, 5.0, peaks[2] * part)
        law = plan_law(reference(), "tool", curve, bounds, 4, 1.0, None)
        found = norms(TimedSegment("tool", curve, law), 1.0)
        assert (found[:3] <= np.array(bounds) * (1 + EXCESS)).all()
        assert (found[:3] / bounds).max() > 0.9


@pytest.mark.parametrize(("per_rad", "bound"), [(0.01, "position"), (5.0, "rotation")])
def test_the_turn_of_the_tool_is_bounded_as_a_length(per_rad: float, bound: str) -> None:
    """An angular velocity times the radius, if that is more than the speed of the position."""
    turn = np.array([0.0, 0.3, 0.4])
    curve = arc(*ARC, turn, per_rad)
    law = plan_law(reference(), "tool", curve, (0.3, 90.0), 3, per_rad, None)
    x, attitude = TimedSegment("tool", curve, law).at(np.linspace(0, law.duration, 4001))
    assert attitude is not None
    speeds = {
        "position": np.linalg.norm(x[:, :, 1], axis=1).max(),
        "rotation": per_rad * np.linalg.norm(attitude[1][:, :, 0], axis=1).max(),
    }
    assert speeds[bound] == pytest.approx(0.3, rel=1e-4) and max(speeds.values()) < 0.3 + 1e-6


def test_speeds_of_steps_bound_their_stretches() -> None:
    """In a rounded corner the smaller one of both."""
    curve = corner(0.2)
    speeds = [0.5, 0.1]
    law = plan_law(reference(), "tool", curve, (9.0, 3.0), 0, 1.0, None, speeds)
    t = np.linspace(0.0, law.duration, 20001)
    x, _ = TimedSegment("tool", curve, law).at(t)
    place = law(t, 0)[:, 0]
    speed = np.linalg.norm(x[:, :, 1], axis=1)
    lengths = np.cumsum([section.length for section in curve.sections])
    first = place < lengths[0] - 1e-9
    assert speed[first].max() == pytest.approx(0.5, rel=1e-3)
    assert speed[~first].max() < 0.1 * (1 + 1e-3) and speed[~first].max() > 0.09


def test_coordinates_are_bounded_one_by_one() -> None:
    curve = BlendedCurve(
        np.zeros(2), None, [Line(np.array([3.0, -4.0]), NO_TURN, largest=True)], []
    )
    law = plan_law(reference(), "joint", curve, (0.5, 1e3), 3, 1.0, np.zeros(2))
    x, _ = TimedSegment("joint", curve, law).at(np.linspace(0.0, law.duration, 4001))
    assert_allclose(np.abs(x[:, :, 1]).max(axis=0), [0.375, 0.5], rtol=1e-3)
    tool = plan_law(reference(), "tool", arc(1e6, 5e-6), (0.5, 1e3), 3, 1.0, None)
    assert norms(TimedSegment("tool", arc(1e6, 5e-6), tool), 1.0)[0] == pytest.approx(
        0.5, rel=1e-3
    )


@pytest.mark.parametrize(
    ("limits", "ratio"),
    [
        ({f"{Q1}.speed_max": 0.1}, 0.1),
        ({f"{Q1}.acceleration_max": 0.05}, 0.05),
        ({"motor.m1.speed_max": 30.0}, 30.0),
    ],
)
@pytest.mark.parametrize("space", ["joint", "tool"])
def test_limits_of_joints_are_reached_and_kept(
    limits: dict[str, float], ratio: float, space: str
) -> None:
    """A line of the tool, or of the joints, that would be faster; speeds by differences."""
    made = reference(**limits)
    q_start = np.array([0.3, 0.8])
    p, _ = made.tool_pose(tuple(q_start))
    total = np.array([-0.2, 0.0, 0.1]) if space == "tool" else np.array([0.4, -0.2])
    start = p if space == "tool" else q_start
    curve = BlendedCurve(start, None, [Line(total, NO_TURN, 1.0, largest=space == "joint")], [])
    law = plan_law(made, space, curve, (5.0, 50.0, 500.0), 4, 1.0, q_start)
    segment = TimedSegment(space, curve, law)
    t = np.linspace(0.0, law.duration, 4001)
    x, attitude = segment.at(t)
    q = x[:, :, 0]
    if space == "tool":
        q = InverseKinematics(made.equations).follow(made.sample(space, x, attitude), q_start)
    v = np.gradient(q[:, 0], t, edge_order=2)
    key = next(iter(limits))
    found = {
        f"{Q1}.speed_max": np.abs(v).max(),
        f"{Q1}.acceleration_max": np.abs(np.gradient(v, t, edge_order=2)).max(),
        "motor.m1.speed_max": np.abs(v).max() * made.equations.model.eta[0, 0],
    }[key]
    assert found == pytest.approx(ratio, rel=2e-3)


def test_a_path_through_a_singular_pose_is_refused() -> None:
    """Limits of the joints would make it slower by more than 10,000."""
    made = reference(**{f"{Q1}.acceleration_max": 1e-7})
    line = Line(np.array([0.4, -0.2]), NO_TURN, largest=True)
    curve = BlendedCurve(np.array([0.3, 0.8]), None, [line], [])
    text = r"^path: the joint limits would slow it down by a factor of \d\.\de\+0\d; it passes a s"
    with pytest.raises(SolverError, match=text):
        plan_law(made, "joint", curve, (5.0, 50.0), 3, 1.0, np.array([0.3, 0.8]))


def test_a_segment_breaks_where_its_law_and_its_curve_do() -> None:
    """A derivative up to order 5 is continuous between, and jumps at some of them."""
    curve = corner(0.2)
    law = plan_law(reference(), "tool", curve, (0.5, 3.0, 40.0), 4, 1.0, None)
    segment = TimedSegment("tool", curve, law, 10.0)
    ends = [0.0, *np.cumsum([section.length for section in curve.sections])]
    places = law(segment.breaks - 10.0, 0)[:, 0]
    for end in ends[:-1]:
        assert np.abs(places - end).min() < 1e-9
    for instant in law.breaks:
        assert np.abs(segment.breaks - 10.0 - instant).min() < 1e-12
    assert (np.diff(segment.breaks) > 0).all()
    assert segment.breaks[0] == 10.0 and segment.breaks[-1] == pytest.approx(10.0 + law.duration)
    assert segment.smoothness == min(law.smoothness, curve.smoothness) == 4
    every = segment.instants(5)
    for low, high in pairwise(ends):
        inside = law(every - 10.0, 0)[:, 0]
        assert ((inside > low) & (inside < high)).sum() >= 15
    single = TimedSegment("tool", arc(*ARC), TimeLaw(2.0, 5, 0.6), 1.0)
    assert_allclose(single.instants(5), [1.0, 1.5, 2.0, 2.5, 3.0])


def test_a_segment_is_at_rest_at_its_ends() -> None:
    """Whatever the rounding of its start; before the end it moves."""
    line = BlendedCurve(np.zeros(3), None, [Line(np.array([0.3, 0.4, 0.0]), NO_TURN, 1.0)], [])
    segment = TimedSegment("tool", line, TimeLaw(0.7, 3, 0.5), 1e3 / 3)
    end = 1e3 / 3 + 0.7
    x, attitude = segment.at(np.array([0.0, 1e3 / 3, end, end + 1.0, 1e3 / 3 + 0.35]))
    assert attitude is None and not x[:4, :, 1:].any()
    assert_allclose(x[:, :, 0], np.outer([0, 0, 1, 1, 0.5], [0.3, 0.4, 0.0]), atol=1e-12)
    assert x[4, 0, 1] > 0.3


def test_the_configuration_after_a_segment_is_its_end() -> None:
    made = reference()
    q = np.array([0.3, 0.8])
    joints = BlendedCurve(q, None, [Line(np.array([0.1, -0.3]), NO_TURN, largest=True)], [])
    law = TimeLaw(1.0, 4, joints.length)
    end = timed_segments.configuration_at_end(made, TimedSegment("joint", joints, law, 5.0), q)
    assert_allclose(end, [0.4, 0.5], atol=1e-12)
    p, _ = made.tool_pose(tuple(q))
    target, _ = made.tool_pose((0.4, 0.5))
    there = BlendedCurve(p, None, [Line(target - p, NO_TURN, 1.0)], [])
    two = [Line(x, NO_TURN, 1.0) for x in (0.5 * (target - p), 0.5 * (target - p))]
    parts = BlendedCurve(p, None, two, [0.01])
    for curve in (there, parts):
        segment = TimedSegment("tool", curve, TimeLaw(1.0, 4, curve.length), 5.0)
        assert_allclose(timed_segments.configuration_at_end(made, segment, q), end, atol=1e-9)
