"""Timed segments by hand: breaks of law and curve, norms, speeds that curvature allows, rest at
the end.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.model.moves import MoveC, MoveJ, MoveL
from flexgen.paths.geometry.blended_curve import BlendedCurve
from flexgen.paths.geometry.segments import Arc
from flexgen.paths.reference import Reference
from flexgen.paths.timing import move_planner, timed_segments
from flexgen.paths.timing.joint_limits import InverseKinematics
from flexgen.paths.timing.timed_segments import TimedSegment


class Squared:
    """s = t^2 on [0, 1]."""

    smoothness = 3
    duration = 1.0
    breaks = np.array([0.0, 0.5, 1.0])

    def __call__(self, t: np.ndarray, order: int = 5) -> np.ndarray:
        t = np.clip(t, 0.0, 1.0)
        out = np.zeros((len(t), order + 1))
        out[:, 0] = t**2
        if order:
            out[:, 1:3] = np.stack([2 * t, np.full_like(t, 2.0)], axis=1) * (t < 1)[:, None]
        return out


class Straight:
    """p = (3 s, -4 s)."""

    length = 1.0
    smoothness = 2

    def __init__(self, *breaks: float) -> None:
        self.breaks = np.array(breaks)

    def __call__(self, s: np.ndarray) -> tuple[np.ndarray, None]:
        return np.stack([3 * s, -4 * s], axis=1), None


def test_a_segment_breaks_where_its_law_and_its_curve_do() -> None:
    made: Any = TimedSegment("output", Straight(0.09, 0.64), Squared(), 10.0)
    assert_allclose(made.breaks, 10.0 + np.array([0.0, 0.3, 0.5, 0.8, 1.0]), atol=1e-12)
    assert made.smoothness == 2
    made = TimedSegment("output", Straight(), Squared(), 10.0)
    assert_allclose(made.breaks, [10.0, 10.5, 11.0])
    x, attitude = made.at([10.3, 11.0 - 1e-12, 11.0, 12.0])
    assert attitude is None and x.shape == (4, 2, 6)
    assert_allclose(
        x[0],
        [[3 * 0.09, 3 * 0.6, 3 * 2.0, 0, 0, 0], [-4 * 0.09, -4 * 0.6, -4 * 2.0, 0, 0, 0]],
        atol=1e-12,
    )
    assert_allclose(x[1, :, 1], [6.0, -8.0], rtol=1e-9)
    assert not x[2:, :, 1:].any()  # at rest from the end on


def test_norms_of_a_segment_are_euclidean_for_the_tool_only() -> None:
    x = np.zeros((2, 3, 6))
    x[0, :, 1:] = np.array([[3.0], [-4.0], [0.0]]) * np.arange(1, 6)
    turn = np.zeros((2, 3, 5))
    turn[:, 2] = [[60.0, 1.0, 0.0, 0.0, 90.0], [-1.0, 2.0, 3.0, 4.0, 5.0]]
    assert_allclose(
        timed_segments.derivative_norms("joint", x, None, 9.0),
        [4.0 * np.arange(1, 6), np.zeros(5)],
    )
    assert_allclose(
        timed_segments.derivative_norms("tool", x, None, 9.0), [5.0 * np.arange(1, 6), np.zeros(5)]
    )
    found = timed_segments.derivative_norms("tool", x, (np.zeros((2, 3, 3)), turn), 0.5)
    assert_allclose(found, [[30.0, 10.0, 15.0, 20.0, 45.0], [0.5, 1.0, 1.5, 2.0, 2.5]])


@pytest.mark.parametrize(
    ("bounds", "speed"),
    [
        ((0.3, 9.0, 99.0), 0.3),
        ((3.0, 0.5, 99.0), np.sqrt(0.5 * 0.4)),  # v^2 / r
        ((3.0, 9.0, 0.2), np.cbrt(0.2 * 0.4**2)),  # v^3 / r^2
    ],
)
def test_curvature_bounds_the_speed_along_an_arc(bounds: tuple[float, ...], speed: float) -> None:
    arc = Arc(np.array([0.4, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), 1.5, np.zeros(3), 1.0)
    curve = BlendedCurve(np.zeros(3), None, [arc], [])
    (found,) = timed_segments._stretches("tool", curve, bounds, 1.0, None)
    assert found.length == pytest.approx(0.4 * 1.5) and found.speed == pytest.approx(
        speed, rel=1e-6
    )
    (found,) = timed_segments._stretches("tool", curve, bounds, 1.0, [0.1])
    assert found.speed == pytest.approx(0.1)

    class Curve:
        length = 2.4

        def __call__(self, s: np.ndarray) -> tuple[np.ndarray, None]:
            return 2.0 * s[:, None, :], None

    other: Any = Curve()
    stretches = timed_segments._stretches("joint", other, bounds, 1.0, None)
    assert len(stretches) == 48 and stretches[5].length == pytest.approx(0.05)
    assert stretches[5].speed == pytest.approx(bounds[0] / 2)


def test_largest_derivatives_between_instants_are_found() -> None:
    """Of sines whose maxima are between the instants: to a millionth."""

    class Sine:
        duration = 1.0
        breaks = np.array([0.0, 0.4, 1.0])
        smoothness = 9

        def __call__(self, t: np.ndarray, order: int = 5) -> np.ndarray:
            return np.stack(
                [80.0**k * np.sin(80.0 * t + k * np.pi / 2) for k in range(order + 1)], axis=1
            )

    class Same:
        length = 1.0
        smoothness = 9
        breaks = np.zeros(0)

        def __call__(self, s: np.ndarray) -> tuple[np.ndarray, None]:
            return s[:, None, :], None

    segment = TimedSegment("joint", Same(), Sine())
    assert_allclose(timed_segments._peaks(segment, 1.0), 80.0 ** np.arange(1, 6), rtol=3e-6)


def test_the_configuration_after_a_joint_segment_is_its_end() -> None:
    reference: Any = None
    segment = TimedSegment("joint", Straight(), Squared(), 5.0)
    assert_allclose(
        timed_segments.configuration_at_end(reference, segment, np.zeros(2)), [3.0, -4.0]
    )
    reference = Reference(flexgen.derive("elbow"))
    q = np.array([0.3, 0.8])
    start = reference.outputs(q)

    class There:
        length = 1.0
        smoothness = 2
        breaks = np.zeros(0)

        def __call__(self, s: np.ndarray) -> tuple[np.ndarray, None]:
            x = s[:, None, :] * np.array([[-0.1], [0.05]])
            x[:, :, 0] += start
            return x, None

    found = timed_segments.configuration_at_end(
        reference, TimedSegment("output", There(), Squared()), q
    )
    assert_allclose(reference.outputs(found), start + np.array([-0.1, 0.05]), atol=1e-9)


def test_a_segment_that_would_become_too_slow_passes_a_singular_pose(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Bounds slow a law down by the root of their excess; joint limits by their own factor, up to
    10,000.
    """

    class Law:
        duration = 2.0
        breaks = np.array([0.0, 0.7, 2.0])

        def __call__(self, t: np.ndarray, order: int = 5) -> np.ndarray:
            return t

        def slow_down(self, factor: float) -> float:
            return factor

    law: Any = Law()
    monkeypatch.setattr(
        "flexgen.paths.timing.speed_planning.speed_law", lambda stretches, bounds, smoothness: law
    )
    monkeypatch.setattr(
        timed_segments, "_stretches", lambda *given: [Made(speed=1.0), Made(speed=2.0)]
    )
    peaks = np.array([1.0, 2.0, 3.0])
    monkeypatch.setattr(timed_segments, "_peaks", lambda segment, radius: peaks)
    limits: dict[str, Any] = {"has_limits": False, "slowdown": lambda v, a: 1.0}
    monkeypatch.setattr(timed_segments, "InverseKinematics", lambda equations: Made(**limits))
    reference: Any = Made(equations=None)
    curve: Any = lambda s: (np.zeros((len(s), 2, 6)), None)  # noqa: E731

    def plan(*bounds: float) -> Any:
        return timed_segments.plan_law(reference, "joint", curve, bounds, 3, 1.0, None)

    assert plan(1.0, 2.0, 3.0) is law and plan(1.0, 2.0, 3.0 / (1 + 2e-6)) is law
    assert plan(0.5, 2.0, 3.0) == pytest.approx(2.0) and plan(1.0, 0.5, 3.0) == pytest.approx(2.0)
    assert plan(1.0, 2.0, 3.0 / 64) == pytest.approx(4.0) and plan(0.1, 0.5, 3.0) == pytest.approx(
        10.0
    )
    limits.update(has_limits=True, slowdown=lambda v, a: 5.0)
    assert plan(1.0, 2.0, 3.0) == pytest.approx(5.0 * (1 + 1e-6), abs=1e-7)
    limits.update(slowdown=lambda v, a: 9999.9)
    assert plan(1.0, 2.0, 3.0) == pytest.approx(9999.9 * (1 + 1e-6), abs=1e-7)
    limits.update(slowdown=lambda v, a: 10000.0)
    with pytest.raises(
        SolverError,
        match=r"^path: the joint limits would slow it down by a factor of 1\.0e\+04; it",
    ):
        plan(1.0, 2.0, 3.0)


def swing(t: np.ndarray) -> list[np.ndarray]:
    """Joints of the elbow over time, their speeds and accelerations, (n, 2) each."""
    w = np.array([1.0, 2.0])
    turn = np.array([0.0, np.pi / 2])
    rows = [w**k * np.sin(w * t[:, None] + turn + k * np.pi / 2) * [0.4, 0.3] for k in range(3)]
    return [rows[0] + [0.3, 0.5], rows[1], rows[2]]


def test_joints_along_a_path_are_those_of_the_closed_form() -> None:
    """Of the elbow: x = l1 sin q1 + l2 cos s, z = l1 cos q1 - l2 sin s, s = q1 + q2, with two
    derivatives by hand.
    """
    l1 = 1.15
    l2 = 1.241
    t = np.linspace(0.0, 2.0, 41)
    q, v, a = swing(t)
    q1 = q[:, 0]
    s = q.sum(axis=1)
    v1 = v[:, 0]
    vs = v.sum(axis=1)
    a1 = a[:, 0]
    as_ = a.sum(axis=1)
    sin1 = np.sin(q1)
    cos1 = np.cos(q1)
    sins = np.sin(s)
    coss = np.cos(s)
    rates = {
        1: [l1 * cos1 * v1 - l2 * sins * vs, -l1 * sin1 * v1 - l2 * coss * vs],
        2: [
            l1 * (cos1 * a1 - sin1 * v1**2) - l2 * (sins * as_ + coss * vs**2),
            -l1 * (sin1 * a1 + cos1 * v1**2) - l2 * (coss * as_ - sins * vs**2),
        ],
    }
    y = np.stack([l1 * sin1 + l2 * coss, l1 * cos1 - l2 * sins], axis=1)
    sample: Any = Made(y=y[:, :, None], R=None, derivative=lambda k: np.stack(rates[k], axis=1))
    kinematics = InverseKinematics(flexgen.derive("elbow"))
    found = kinematics.follow(sample, q[0] + [0.05, -0.05])
    assert_allclose(found, q, atol=1e-10)
    for x, expected in zip(kinematics.velocities(sample, found), (v, a), strict=True):
        assert_allclose(x, expected, atol=1e-9)
    far: Any = Made(y=np.array([[[9.0], [0.0]]]), R=None)
    with pytest.raises(SolverError, match="inverse kinematics: "):
        kinematics.follow(far, q[0])


def test_limits_of_joints_and_motors_slow_a_motion_down() -> None:
    """Speeds by their factor, accelerations by its root, motors through their ratios; also between
    the instants.
    """
    first = "element.upper.dof.q1"
    t = np.linspace(0.0, 3.0, 21)
    _, v, a = swing(t)
    for changes, factor in (
        ({f"{first}.speed_max": 0.1}, 0.4 / 0.1),
        ({f"{first}.speed_max": 0.8}, 0.4 / 0.8),
        ({f"{first}.acceleration_max": 0.025}, (0.4 / 0.025) ** 0.5),
        ({f"{first}.speed_max": 0.1, f"{first}.acceleration_max": 0.1}, 4.0),
        ({f"{first}.speed_max": 0.4, f"{first}.acceleration_max": 0.004}, 10.0),
        ({"motor.m1.speed_max": 50.0}, 0.4 * 1872 / 7 / 50.0),
        ({"motor.m2.speed_max": 10.0, "motor.m1.speed_max": 1e3}, 0.6 * 757 / 3 / 10.0),
        ({}, 0.0),
    ):
        made = InverseKinematics(Made(model=flexgen.read("elbow", overrides=changes)))
        assert made.has_limits == bool(changes)
        assert made.slowdown(v, a) == pytest.approx(factor, rel=2e-3)


def test_a_path_across_the_axes_of_the_output_is_refused() -> None:
    planner: Any = object.__new__(move_planner._Planner)
    model = Made(output=Made(axes="xy"))
    move = Made(where=None, type="tool_line", name="line")
    vars(planner).update(reference=Made(axes=(0, 1)), model=model, move=move, name="move line")

    def segment(z: float, space: str = "tool") -> Any:
        x = np.zeros((65, 3, 6))
        x[:, 0, 0] = np.linspace(0.0, 1.0, 65)
        x[:, 2, 0] = np.linspace(0.0, z, 65)
        return Made(space=space, start=0.0, law=Made(duration=1.0), at=lambda t: (x, None))

    planner._check_axes(segment(0.3, "joint"))
    planner._check_axes(segment(1.9 * move_planner.NO_MOTION))
    with pytest.raises(
        Exception, match=r"0\.3 m along z.*a path along x, y only, because the output has"
    ):
        planner._check_axes(segment(0.3))
    with pytest.raises(Exception, match="along z"):
        planner._check_axes(segment(2.1 * move_planner.NO_MOTION))
    planner.reference.axes = (0, 1, 2)
    planner._check_axes(segment(0.3))


# --- steps ---------------------------------------------------------------------------------------
def planner(pose: bool = True, **move: Any) -> Any:
    """Of a robot whose output is the pose of the tool."""
    made: Any = object.__new__(move_planner._Planner)
    output = Made(has_angle=False)
    vars(made).update(reference=Made(pose=pose, tool=True), name="move m", q_g=np.zeros(6))
    vars(made).update(model=Made(output=output))
    made.move = Made(
        **{
            "profile": (1.0, 2.0),
            "timing": (),
            "where": None,
            "name": "m",
            "type": "tool_polyline",
        }
        | move
    )
    return made


def legs(*zones: float) -> list[Any]:
    """Lines of length 1, each turning left."""
    return [
        MoveL(tuple(np.round(x, 9)), zone=z)
        for x, z in zip(np.eye(3)[[0, 1, 2, 0, 1]], zones, strict=False)
    ]


def test_rounded_corners_of_steps_fit_between_them() -> None:
    """Zones of two corners may fill a step, not more; the step that is blamed is the one with the
    zone.
    """
    made = planner()
    curve, speeds = made._polyline(np.zeros(3), np.eye(3), legs(0.4, 0.6, 0.0), 1.0)
    assert speeds == [1.0, 1.0, 1.0] and [segment.length for segment in curve.segments] == [
        1.0,
        1.0,
        1.0,
    ]
    assert curve.zones == [0.4, 0.6]
    assert_allclose(curve.end[0], [1.0, 1.0, 1.0])
    for zones, text in (
        (
            (0.4, 0.61, 0.0),
            (
                r"step 2: .*given zone 0\.4 and 0\.61, expected zones that fit into the length "
                r"1 of step 2"
            ),
        ),
        ((0.4, 0.4, 1.01, 0.0), r"step 3: .*given zone 0\.4 and 1\.01, .* the length 1 of step 3"),
        ((1.01, 0.0), r"step 1: .*given zone 0 and 1\.01, .* of step 1"),
        ((0.3, 0.3), r"step 2: .*given zone 0\.3, expected 0 at the end"),
        (
            (0.0, 0.0),
            (
                r"step 1: .*given zone 0\.0, expected a radius > 0 \[m\], because the tool does "
                r"not stop here"
            ),
        ),
        ((), "given legs none, expected one or more"),
    ):
        with pytest.raises(ArgumentError, match=text):
            made._polyline(np.zeros(3), np.eye(3), legs(*zones), 1.0)
    short = [MoveL((1.0, 0.0, 0.0), zone=0.5), MoveL((0.0, 0.4, 0.0))]
    with pytest.raises(
        ArgumentError, match=r"step 1: .*given zone 0\.5 and 0, .* into the length 0\.4 of step 2"
    ):
        made._polyline(np.zeros(3), np.eye(3), short, 1.0)
    back = [MoveL((1.0, 0.0, 0.0), zone=0.2), MoveL((-1.0, 0.0, 0.0))]
    with pytest.raises(
        ArgumentError, match=r"step 1: .*expected 0, because the path reverses here"
    ):
        made._polyline(np.zeros(3), np.eye(3), back, 1.0)


def test_speeds_of_steps_need_a_profile() -> None:
    made = planner()
    step = MoveL((1.0, 0.0, 0.0), speed=0.4)
    assert (
        made._speed(step, 0, (2.0, 1.0)) == 0.4
        and made._speed(MoveL((1.0, 0.0, 0.0)), 0, (2.0, 1.0)) == 2.0
    )
    assert (
        made._speed(MoveL((1.0, 0.0, 0.0)), 0, ()) == 1.0
        and planner(timing=(1.0,))._speed(step, 0, ()) == 0.4
    )
    with pytest.raises(
        ArgumentError,
        match=r"step 3: .*given speed 0\.4, expected no speed, or a move with a profile",
    ):
        made._speed(step, 2, ())
    with pytest.raises(ArgumentError, match=r"step 1: .*expected a speed > 0"):
        made._speed(Made(speed=0.0, where=None), 0, (2.0, 1.0))


def test_steps_are_lines_and_arcs_from_where_the_tool_is() -> None:
    made = planner()
    here = np.array([1.0, 2.0, 3.0])
    turn = Rotation.from_rotvec([0.0, 0.0, 0.5]).as_matrix()
    R = Rotation.from_rotvec([0.0, 0.0, 0.2]).as_matrix()
    line = made._segment(MoveL((1.0, 0.0, 0.0)), 0, here, R, 1.0)
    assert_allclose(line.total, [1, 0, 0])
    line = made._segment(MoveL(position=(1.0, 2.5, 3.0)), 0, here, R, 1.0)
    assert_allclose(line.total, [0, 0.5, 0])
    to = tuple(map(tuple, turn.tolist()))
    line = made._segment(MoveL(position=(1.0, 2.0, 3.0), orientation=to), 0, here, R, 0.25)
    assert_allclose(line.rotation, [0, 0, 0.3], atol=1e-12)
    assert line.length == pytest.approx(0.25 * 0.3)
    for absolute in (False, True):
        end = np.array([1.0, 1.0, 0.0])
        via = np.array([np.sqrt(0.5), 1 - np.sqrt(0.5), 0.0])
        given: Any = {"position": tuple(end + here)} if absolute else {"displacement": tuple(end)}
        arc = made._segment(MoveC(via=tuple(via + here * absolute), **given), 0, here, R, 1.0)
        assert arc.length == pytest.approx(np.pi / 2)
        assert_allclose(arc.total, end, atol=1e-12)
    for step, text in (
        (MoveL((0.0, 0.0, 0.0)), r"displacement.*expected a step with a displacement or rotation"),
        (
            MoveL(position=(1.0, 2.0, 3.0)),
            r"position.*expected a step with a displacement or rotation",
        ),
        (
            MoveL((1.0, 0.0, 0.0), position=(1.0, 0.0, 0.0)),
            "expected either displacement or position",
        ),
        (MoveL(), "expected either displacement or position"),
        (MoveL((1.0, 0.0)), "expected 3 finite numbers"),
        (
            MoveL((1.0, 0.0, 0.0), rotation=(0.0, 0.0, 1.0), orientation=to),
            "expected either rotation or orientation",
        ),
        (
            MoveL((1.0, 0.0, 0.0), orientation=tuple(map(tuple, (-turn).tolist()))),
            "expected a rotation matrix",
        ),
        (
            MoveC((1.0, 0.0, 0.0), via=(0.5, 0.0, 0.0)),
            "expected a point that is not on a line through start and end",
        ),
        (MoveL((1.0, 0.0, 0.0), zone=-0.1), r"expected a radius >= 0 \[m\]"),
    ):
        with pytest.raises(ArgumentError, match=f"step 5: .*{text}"):
            made._segment(step, 4, here, R, 1.0)
    with pytest.raises(
        ArgumentError, match=r'expected no rotation, .*, or an output of type "tool_pose"'
    ):
        planner(pose=False)._segment(
            MoveL((1.0, 0.0, 0.0), rotation=(0.0, 0.0, 1.0)), 0, here, R, 1.0
        )


def test_steps_of_a_program_stop_where_they_must() -> None:
    made = planner()
    good: list[Any] = [
        MoveL((1.0, 0.0, 0.0), zone=0.1),
        MoveL((0.0, 1.0, 0.0), pause=0.5),
        MoveJ((0.0, 0.0)),
    ]

    def check(k: int, **changes: Any) -> None:
        steps = [*good]
        steps[k] = replace(steps[k], **changes)
        made._check_step(steps[k], k, Made(steps=steps))

    for k in range(3):
        check(k)
    for k, changes, text in (
        (0, {"zone": -1e-9}, "expected a zone >= 0"),
        (1, {"pause": -1e-9}, r"expected a time >= 0 \[s\]"),
        (2, {"zone": 0.1}, "expected 0 at the end of the program"),
        (0, {"pause": 0.1}, "expected 0 because the step has a zone, or no zone"),
        (1, {"pause": 0.0, "zone": 0.1}, "expected 0 between a MoveJ and a move of the tool"),
    ):
        with pytest.raises(ArgumentError, match=f"step {k + 1}: .*{text}"):
            check(k, **changes)
    with pytest.raises(
        ArgumentError, match=r"^move m, step 1: given 3, expected a MoveJ, MoveL or MoveC$"
    ):
        made._check_step(3, 0, Made(steps=[3]))
