"""Curves through samples against splines of SciPy, arcs with known lengths, refused samples."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from flexgen.base.errors import ArgumentError
from flexgen.paths.geometry import spline
from flexgen.paths.geometry.spline import SplineCurve
from flexgen.paths.samples.sample_files import Samples


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
    reference = make_interp_spline(t, values, k=degree, bc_type=(rest, rest))
    s = np.linspace(0.0, 3.5, 29)
    x, attitude = curve(jet(s))
    assert attitude is None
    for k in range(6):
        assert_allclose(
            x[:, :, k],
            reference.derivative(k)(s + 2.0) if k else reference(s + 2.0),
            atol=1e-7 * 20**k,
        )
    # where derivative 5 jumps
    assert_allclose(curve.breaks, np.unique(reference.t) - 2.0 if degree == 5 else [])


def test_a_curve_through_samples_without_times_has_arc_length() -> None:
    """Speed one everywhere; its length is the integral of the speed of SciPy's spline over
    chords.
    """
    angle = np.linspace(0.0, 2.0, 9)
    values = np.stack([np.cos(angle), np.sin(angle), 0.3 * angle], axis=1)
    curve = SplineCurve(Samples("tool", values, None, None, False), 5, 1.0, np.eye(3))
    chords = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(values, axis=0), axis=1))]
    reference = make_interp_spline(chords, values, k=5)
    speed = reference.derivative()
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


def test_breaks_by_arc_length_are_at_samples() -> None:
    """The fifth derivative of a quintic spline jumps at some of its samples, and nowhere else."""
    angle = np.linspace(0.0, 2.0, 9)
    values = np.stack([np.cos(angle), 0.5 * np.sin(angle), 0.3 * angle], axis=1)
    curve = SplineCurve(Samples("tool", values, None, None, False), 5, 1.0, np.eye(3))
    at = curve(jet(curve.breaks))[0][:, :, 0]
    nearest = np.linalg.norm(at[:, None] - values[None], axis=2).min(axis=1)
    assert len(at) >= 3 and nearest.max() < 1e-7


@pytest.mark.parametrize("degree", [5, 7])
def test_few_samples_have_one_polynomial(degree: int) -> None:
    """Four samples: the cubic in the sum of chords that NumPy fits, and its length."""
    x = np.array([0.0, 0.5, 1.2, 2.0])
    values = np.stack([x, x**2], axis=1)
    curve = SplineCurve(Samples("output", values, None, None, False), degree, 1.0)
    chords = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(values, axis=0), axis=1))]
    cubic = [Polynomial.fit(chords, column, 3) for column in values.T]
    dense = np.linspace(0.0, chords[-1], 4001)
    points = np.stack([each(dense) for each in cubic], axis=1)
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    assert curve.length == pytest.approx(length[-1], rel=1e-6)
    s = np.linspace(0.0, curve.length, 15)
    expected = np.stack([np.interp(s, length, column) for column in points.T], axis=1)
    assert_allclose(curve(jet(s))[0][:, :, 0], expected, atol=1e-5)


@pytest.mark.parametrize("kind", ["column", "quaternion"])
def test_distances_add_turns_by_their_radius(kind: str) -> None:
    """Steps of 0.3 m and of 0.01 rad on a radius of 40 m are 0.5 m each."""
    k = np.arange(5.0)
    line = np.stack([0.3 * k, 0 * k, 0 * k], axis=1)
    if kind == "column":
        samples = Samples("tool", np.hstack([line, 0.01 * k[:, None]]), None, None, False)
    else:
        q = np.stack([np.cos(0.005 * k), np.sin(0.005 * k), 0 * k, 0 * k], axis=1)
        samples = Samples("tool", line, q, None, False)
    assert_allclose(spline.distances(samples, 40.0), 0.5 * k, rtol=1e-5)


@pytest.mark.parametrize("kind", ["column", "quaternion"])
@pytest.mark.parametrize(("radius", "turns"), [(1.0, []), (4.0, [2])])
def test_a_path_turns_back_where_most_of_its_step_does(
    kind: str, radius: float, turns: list[int]
) -> None:
    """Half a meter forward at each step; the orientation turns by 0.2 rad, at the third back."""
    line = np.stack([0.5 * np.arange(4.0), np.zeros(4), np.zeros(4)], axis=1)
    angle = np.array([0.0, 0.2, 0.4, 0.2])
    if kind == "column":
        samples = Samples("tool", np.hstack([line, angle[:, None]]), None, None, False)
    else:
        q = np.stack([np.cos(angle / 2), np.sin(angle / 2), 0 * angle, 0 * angle], axis=1)
        samples = Samples("tool", line, q, None, False)
    assert spline.turns_of(samples, radius) == turns
    timed = Samples("tool", samples.values, samples.quaternions, np.arange(4.0), True)
    assert spline.turns_of(timed, radius) == []


@pytest.mark.parametrize("corners", [0, 1, 2])
@pytest.mark.parametrize("timed", [False, True])
def test_kinks_of_samples_are_told_at_their_sample(corners: int, timed: bool) -> None:
    """A line with right angles at samples 21 and 41; smooth samples have no note on kinks."""
    step = np.zeros((60, 2))
    step[:, 0] = 0.1
    if corners >= 1:
        step[20:, :] = [0.0, 0.1]
    if corners == 2:
        step[40:, :] = [-0.1, 0.0]
    values = np.vstack([np.zeros((1, 2)), np.cumsum(step, axis=0)])
    knots = np.linspace(0.0, 2.0, 61) if timed else None
    made = SplineCurve(Samples("output", values, None, knots, timed), 5, 1.0)
    kinks = [note for note in made.notes if "kink" in note]
    assert len(kinks) == min(corners, 1)
    if kinks:
        assert "its samples have a kink at sample 21" in kinks[0]
        assert (", and at 1 more" in kinks[0]) == (corners == 2)
        word = "the speed changes by" if timed else "the direction changes by 90 deg"
        assert word in kinks[0]
