"""Laws of speeds along a path: closed forms of trapezoids, bounds, slower laws, refused input."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.errors import ArgumentError
from flexgen.paths.timing.speed_planning import SpeedLaw, Stretch, speed_law


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


def test_distances_without_derivatives_are_those_with_them() -> None:
    law = speed_law([Stretch(2.0, 1.0), Stretch(2.0, 2.0)], (9.0, 2.0))
    t = np.linspace(-0.1, law.duration + 0.1, 99)
    for order in range(5):
        assert_allclose(law(t, order), law(t)[:, : order + 1], rtol=0, atol=0)
