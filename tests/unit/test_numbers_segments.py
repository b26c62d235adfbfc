"""Timed segments by hand: breaks of law and curve, norms, speeds that curvature allows, rest at the end."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.errors import SolverError
from flexgen.paths import move_planner, timed_segments
from flexgen.paths.blended_curve import BlendedCurve
from flexgen.paths.reference import Reference
from flexgen.paths.segments import Arc
from flexgen.paths.timed_segments import TimedSegment


class Squared:
    """s = t^2 on [0, 1]."""

    smoothness, duration, breaks = 3, 1.0, np.array([0.0, 0.5, 1.0])

    def __call__(self, t: np.ndarray, order: int = 5) -> np.ndarray:
        t = np.clip(t, 0.0, 1.0)
        out = np.zeros((len(t), order + 1))
        out[:, 0] = t**2
        if order:
            out[:, 1:3] = np.stack([2 * t, np.full_like(t, 2.0)], axis=1) * (t < 1)[:, None]
        return out


class Straight:
    """p = (3 s, -4 s)."""

    length, smoothness = 1.0, 2

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
    assert_allclose(x[0], [[3 * 0.09, 3 * 0.6, 3 * 2.0, 0, 0, 0], [-4 * 0.09, -4 * 0.6, -4 * 2.0, 0, 0, 0]], atol=1e-12)
    assert_allclose(x[1, :, 1], [6.0, -8.0], rtol=1e-9)
    assert not x[2:, :, 1:].any()  # at rest from the end on


def test_norms_of_a_segment_are_euclidean_for_the_tool_only() -> None:
    x = np.zeros((2, 3, 6))
    x[0, :, 1:] = np.array([[3.0], [-4.0], [0.0]]) * np.arange(1, 6)
    turn = np.zeros((2, 3, 5))
    turn[:, 2] = [[60.0, 1.0, 0.0, 0.0, 90.0], [-1.0, 2.0, 3.0, 4.0, 5.0]]
    assert_allclose(timed_segments.derivative_norms("joint", x, None, 9.0), [4.0 * np.arange(1, 6), np.zeros(5)])
    assert_allclose(timed_segments.derivative_norms("tool", x, None, 9.0), [5.0 * np.arange(1, 6), np.zeros(5)])
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
    assert found.length == pytest.approx(0.4 * 1.5) and found.speed == pytest.approx(speed, rel=1e-6)
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
            return np.stack([80.0**k * np.sin(80.0 * t + k * np.pi / 2) for k in range(order + 1)], axis=1)

    class Same:
        length, smoothness, breaks = 1.0, 9, np.zeros(0)

        def __call__(self, s: np.ndarray) -> tuple[np.ndarray, None]:
            return s[:, None, :], None

    segment = TimedSegment("joint", Same(), Sine())
    assert_allclose(timed_segments._peaks(segment, 1.0), 80.0 ** np.arange(1, 6), rtol=3e-6)


def test_the_configuration_after_a_joint_segment_is_its_end() -> None:
    reference: Any = None
    segment = TimedSegment("joint", Straight(), Squared(), 5.0)
    assert_allclose(timed_segments.configuration_at_end(reference, segment, np.zeros(2)), [3.0, -4.0])
    reference = Reference(flexgen.derive("elbow"))
    q = np.array([0.3, 0.8])
    start = reference.outputs(q)

    class There:
        length, smoothness, breaks = 1.0, 2, np.zeros(0)

        def __call__(self, s: np.ndarray) -> tuple[np.ndarray, None]:
            x = s[:, None, :] * np.array([[-0.1], [0.05]])
            x[:, :, 0] += start
            return x, None

    found = timed_segments.configuration_at_end(reference, TimedSegment("output", There(), Squared()), q)
    assert_allclose(reference.outputs(found), start + np.array([-0.1, 0.05]), atol=1e-9)


def test_a_segment_that_would_become_too_slow_passes_a_singular_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bounds slow a law down by the root of their excess; joint limits by their own factor, up to 10,000."""

    class Law:
        duration = 2.0

        def __call__(self, t: np.ndarray) -> np.ndarray:
            return t

        def slow_down(self, factor: float) -> float:
            return factor

    law: Any = Law()
    monkeypatch.setattr("flexgen.paths.speed_planning.speed_law", lambda stretches, bounds, smoothness: law)
    monkeypatch.setattr(timed_segments, "_stretches", lambda *given: [Made(speed=1.0), Made(speed=2.0)])
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
    assert plan(1.0, 2.0, 3.0 / 64) == pytest.approx(4.0) and plan(0.1, 0.5, 3.0) == pytest.approx(10.0)
    limits.update(has_limits=True, slowdown=lambda v, a: 5.0)
    assert plan(1.0, 2.0, 3.0) == pytest.approx(5.0 * (1 + 1e-6), abs=1e-7)
    limits.update(slowdown=lambda v, a: 0.999e4)
    assert plan(1.0, 2.0, 3.0) == pytest.approx(0.999e4, rel=1e-5)
    limits.update(slowdown=lambda v, a: 1.001e4)
    with pytest.raises(SolverError, match=r"^path: the joint limits would slow it down by a factor of 1\.0e\+04; it"):
        plan(1.0, 2.0, 3.0)


def test_a_path_across_the_axes_of_the_output_is_refused() -> None:
    planner: Any = object.__new__(move_planner._Planner)
    model = Made(output=Made(axes="xy"))
    move = Made(where=None, type="tool_line", name="line")
    vars(planner).update(reference=Made(axes=(0, 1)), model=model, move=move, name="move line")

    def segment(z: float, space: str = "tool") -> Any:
        x = np.zeros((65, 3, 6))
        x[:, 0, 0], x[:, 2, 0] = np.linspace(0.0, 1.0, 65), np.linspace(0.0, z, 65)
        return Made(space=space, start=0.0, law=Made(duration=1.0), at=lambda t: (x, None))

    planner._check_axes(segment(0.3, "joint"))
    planner._check_axes(segment(1.9 * move_planner.NO_MOTION))
    with pytest.raises(Exception, match=r"0\.3 m along z.*a path along x, y only, because the output has"):
        planner._check_axes(segment(0.3))
    with pytest.raises(Exception, match="along z"):
        planner._check_axes(segment(2.1 * move_planner.NO_MOTION))
    planner.reference.axes = (0, 1, 2)
    planner._check_axes(segment(0.3))
