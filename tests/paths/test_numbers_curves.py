"""Springs of MuJoCo, laws of speeds and curves through samples: closed forms and SciPy."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace as Made
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from flexgen.base.errors import ArgumentError
from flexgen.exports.mujoco import mujoco_forces
from flexgen.model.elements import CubicSpring, LinearSpring, PiecewiseSpring, SmoothSpring
from flexgen.paths.geometry.spline import SplineCurve
from flexgen.paths.samples.sample_files import Samples
from flexgen.paths.timing.speed_planning import SpeedLaw, Stretch, speed_law


# --- MuJoCo --------------------------------------------------------------------------------------
def pull(tendons: ElementTree.Element, d: float) -> float:
    """Torque of springs ``k x + k2 x^2 + k3 x^3`` of tendons at a deflection; x: beyond their
    range of rest.
    """
    total = 0.0
    for tendon in tendons:
        ((joint, gain),) = ((each.get("joint"), float(each.get("coef", "0"))) for each in tendon)
        assert joint == "q"
        rest = [float(x) for x in str(tendon.get("springlength")).split()]
        length = gain * d
        x = length - rest[-1] if len(rest) == 1 else max(length - rest[1], 0.0)
        assert len(rest) == 1 or rest[0] == -1e9
        k = [float(value) for value in str(tendon.get("stiffness")).split()]
        total += gain * sum(value * x ** (i + 1) for i, value in enumerate(k))
    return total


@pytest.mark.parametrize("d", [0.0, 0.7e-3, -1.3e-3, 2e-3, 2.9e-3, -5e-3])
def test_springs_of_mujoco_are_those_of_the_model(d: float) -> None:
    size = abs(d)
    b = 2e-3
    low = 1e4
    high = 5e4
    cases: list[tuple[Any, float]] = [
        (LinearSpring(low), low * size),
        (CubicSpring(low, 3e9), low * size + 3e9 * size**3),
        (PiecewiseSpring(low, high, b), low * size + (high - low) * max(size - b, 0.0)),
        (
            SmoothSpring(low, high, b),
            low * size + (high - low) * (size**3 / (3 * b**2) if size < b else size - 2 * b / 3),
        ),
    ]
    for spring, torque in cases:
        tendons = ElementTree.Element("tendon")
        mujoco_forces._spring(tendons, "gear", spring, 7.0, {"q": 1.0})
        assert pull(tendons, d) == pytest.approx(np.sign(d) * torque, rel=1e-9, abs=1e-9)
        assert [x.get("damping") for x in tendons] == ["7", *[None] * (len(tendons) - 1)]
        assert [x.get("name") for x in tendons] == ["gear", "gear.above", "gear.below"][
            : len(tendons)
        ]


def test_rigid_drives_of_several_joints_have_tendons() -> None:
    def made(**changes: Any) -> list[ElementTree.Element]:
        friction = Made(viscous=0.3, coulomb=changes.pop("coulomb", 0.0))
        drive: Any = Made(
            motor=Made(name="m", friction=friction, inertia=2e-3), turning=None, ratios={"q1": 5.0}
        )
        vars(drive).update(changes)
        tendons = ElementTree.Element("tendon")
        mujoco_forces._rigid_drive(tendons, drive)
        return list(tendons)

    def ends(tendon: ElementTree.Element) -> dict[str, float]:
        return {str(each.get("joint")): float(each.get("coef", "nan")) for each in tendon}

    assert made() == []
    drive, rotor = made(ratios={"q1": 5.0, "q2": -2.0}, coulomb=0.4)
    assert ends(drive) == ends(rotor) == {"q1": 5.0, "q2": -2.0}
    assert (drive.get("name"), rotor.get("name")) == ("drive.m", "rotor.m")
    assert [float(drive.get(key, "nan")) for key in ("damping", "frictionloss")] == [0.3, 0.4]
    assert float(rotor.get("armature", "nan")) == 2e-3
    drive, rotor = made(turning={"q1": 1.0, "q0": -1.0})
    assert ends(drive) == {"q1": 5.0} and ends(rotor) == {"q1": 6.0, "q0": -1.0}
    assert drive.get("frictionloss") is None


# --- laws of speeds ------------------------------------------------------------------------------
def trapezoid(law: SpeedLaw) -> list[tuple[float, float, float]]:
    return [
        (phase.first, phase.last, phase.duration) for phase in law.phases if phase.duration > 1e-12
    ]


@pytest.mark.parametrize(
    ("lengths", "speeds", "expected"),
    [
        ([3.0], [1.0], [(0, 1, 0.5), (1, 1, 2.5), (1, 0, 0.5)]),
        ([0.5], [1.0], [(0, 1, 0.5), (1, 0, 0.5)]),
        ([0.02], [1.0], [(0, 0.2, 0.1), (0.2, 0, 0.1)]),  # v^2 = a L
        (
            [2.0, 2.0],
            [1.0, 2.0],
            [(0, 1, 0.5), (1, 1, 1.75), (1, 2, 0.5), (2, 2, 0.125), (2, 0, 1.0)],
        ),
        ([2.0, 0.09, 2.0], [9.0, 0.6, 9.0], None),
    ],
)
def test_changes_of_speed_are_as_short_as_the_bounds_allow(
    lengths: list[float], speeds: list[float], expected: list[tuple[float, float, float]] | None
) -> None:
    """Trapezoids with an acceleration of 2 m/s^2."""
    law = speed_law(
        [Stretch(length, speed) for length, speed in zip(lengths, speeds, strict=True)], (9.0, 2.0)
    )
    if expected is not None:
        assert_allclose(trapezoid(law), expected, atol=1e-9)
    t = np.linspace(0.0, law.duration, 4001)
    s = law(t)
    assert law.length == pytest.approx(sum(lengths)) and s[-1, 0] == pytest.approx(sum(lengths))
    assert np.abs(s[:, 2]).max() <= 2.0 * (1 + 1e-9) and s[0, 1] == s[-1, 1] == 0.0
    for begin, end, speed in zip(
        np.r_[0, np.cumsum(lengths)], np.cumsum(lengths), speeds, strict=False
    ):
        inside = (s[:, 0] >= begin) & (s[:, 0] <= end)
        assert s[inside, 1].max() <= speed * (1 + 1e-9)
    assert_allclose(np.gradient(s[:, 0], t)[2:-2], s[2:-2, 1], atol=2e-3)
    slow = law.slow_down(3.0)
    assert slow.duration == pytest.approx(3 * law.duration)
    assert_allclose(slow(3.0 * t)[:, :3], s[:, :3] / [1, 3, 9], atol=1e-9)
    assert_allclose(slow.breaks, 3 * law.breaks)


def test_bounds_of_a_law_of_speeds_are_checked() -> None:
    good = [Stretch(1.0, 1.0)]
    for stretches, bounds, smoothness, text in (
        (good, (1.0,), 0, r"^profile: given \[1\.0\], expected two or more positive bounds"),
        (good, (1.0, 0.0), 0, r"^profile: given \[1\.0, 0\.0\]"),
        (good, (1.0, np.inf), 0, "^profile"),
        (good, (1.0, 1.0), 1, "^smoothness: given 1, expected 0 for trapezoids, or 2 to 9$"),
        (good, (1.0, 1.0), 10, "^smoothness: given 10"),
        ([], (1.0, 1.0), 0, "^stretches: given"),
        ([Stretch(0.0, 1.0)], (1.0, 1.0), 0, "^stretches: given"),
        ([Stretch(1.0, 0.0)], (1.0, 1.0), 0, "^stretches: given"),
    ):
        with pytest.raises(ArgumentError, match=text):
            speed_law(stretches, bounds, smoothness)
    assert (
        speed_law(good, (1.0, 2.0), 9).smoothness == 9
        and speed_law(good, (1.0, 2.0, 3.0)).smoothness == 2
    )


# --- curves through samples ----------------------------------------------------------------------
def jet(s: np.ndarray) -> np.ndarray:
    out = np.zeros((len(s), 6))
    out[:, 0] = s
    out[:, 1] = 1.0
    return out


@pytest.mark.parametrize("degree", [5, 7])
def test_a_curve_through_samples_with_times_rests_at_its_ends(degree: int) -> None:
    """SciPy's spline over time; the first derivatives are zero at both ends."""
    t = np.array([2.0, 2.5, 2.8, 3.6, 4.0, 4.4, 5.0, 5.5])
    values = np.stack([np.cos(t), np.sin(2 * t)], axis=1)
    curve = SplineCurve(Samples("output", values, None, t, True), degree, 1.0)
    assert curve.length == pytest.approx(3.5) and curve.smoothness == degree - 1
    rest = [(k, np.zeros(2)) for k in range(1, (degree - 1) // 2 + 1)]
    spline = make_interp_spline(t, values, k=degree, bc_type=(rest, rest))
    s = np.linspace(0.0, 3.5, 29)
    x, attitude = curve(jet(s))
    assert attitude is None
    for k in range(6):
        assert_allclose(
            x[:, :, k], spline.derivative(k)(s + 2.0) if k else spline(s + 2.0), atol=1e-7 * 20**k
        )
    # where derivative 5 jumps
    assert_allclose(curve.breaks, np.unique(spline.t) - 2.0 if degree == 5 else [])


def test_a_curve_through_samples_without_times_has_arc_length() -> None:
    """Speed one everywhere; its length is the integral of the speed of SciPy's spline over
    chords.
    """
    angle = np.linspace(0.0, 2.0, 9)
    values = np.stack([np.cos(angle), np.sin(angle), 0.3 * angle], axis=1)
    curve = SplineCurve(Samples("tool", values, None, None, False), 5, 1.0, np.eye(3))
    chords = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(values, axis=0), axis=1))]
    spline = make_interp_spline(chords, values, k=5)
    speed = spline.derivative()
    length = sum(quad(lambda u: np.linalg.norm(speed(u)), a, b)[0] for a, b in pairwise(chords))
    assert curve.length == pytest.approx(length, rel=1e-9)
    assert curve.length == pytest.approx(np.hypot(1.0, 0.3) * 2.0, rel=1e-4)  # of the helix
    s = np.linspace(0.0, curve.length, 41)
    x, attitude = curve(jet(s))
    assert_allclose(np.linalg.norm(x[:, :, 1], axis=1), 1.0, atol=1e-9)
    assert_allclose((x[:, :, 1] * x[:, :, 2]).sum(axis=1), 0.0, atol=1e-6)
    # curvature of a helix
    assert_allclose(np.linalg.norm(x[1:-1, :, 2], axis=1), 1.0 / (1 + 0.3**2), atol=0.05)
    assert attitude is not None and (attitude[0] == np.eye(3)).all() and not attitude[1].any()


def test_a_curve_that_only_turns_has_the_angle_times_the_radius_as_length() -> None:
    angles = np.linspace(0.0, 1.2, 13)
    q = np.roll(Rotation.from_rotvec(np.outer(angles, [0.0, 0.6, 0.8])).as_quat(), 1, axis=1)
    curve = SplineCurve(
        Samples("tool", np.tile([1.0, 2.0, 3.0], (13, 1)), q, None, False), 5, 0.25
    )
    assert curve.length == pytest.approx(0.25 * 1.2, rel=1e-6)
    s = np.linspace(0.0, curve.length, 7)
    x, attitude = curve(jet(s))
    assert_allclose(x[:, :, 0], np.tile([1.0, 2.0, 3.0], (7, 1)))
    assert attitude is not None
    expected = Rotation.from_rotvec(np.outer(s / 0.25, [0.0, 0.6, 0.8])).as_matrix()
    assert_allclose(attitude[0], expected, atol=1e-6)
    assert_allclose(
        attitude[1][:, :, 0], np.tile([0.0, 0.6 / 0.25, 0.8 / 0.25], (7, 1)), atol=1e-4
    )


def test_samples_that_turn_back_or_begin_in_motion_are_told() -> None:
    x = np.array([0.0, 1.0, 2.0, 3.0, 2.5, 2.0, 1.5, 1.0])
    with pytest.raises(
        ArgumentError, match=r"^samples: given a path that stops or reverses near sample \d, exp"
    ):
        SplineCurve(Samples("output", x[:, None], None, None, False), 5, 1.0)
    t = np.linspace(0.0, 2.0, 60)
    moving = SplineCurve(Samples("output", t[:, None] ** 2, None, t, True), 5, 1.0)
    text = (
        "its samples end at 100 % of their largest speed, the path at rest: add samples until rest"
    )
    assert moving.notes == (text,)
    still = SplineCurve(
        Samples("output", (1 - np.cos(np.pi * t / 2))[:, None], None, t, True), 5, 1.0
    )
    assert still.notes == ()
