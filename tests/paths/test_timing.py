"""Time laws under bounds: exact derivatives, bounds kept and reached, durations of the textbooks,
stretches in turn.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations, pairwise
from math import factorial, prod

import numpy as np
import pytest

from flexgen.base.errors import ArgumentError
from flexgen.paths.timing import velocity_profiles
from flexgen.paths.timing.speed_planning import SpeedLaw, Stretch, speed_law
from flexgen.paths.timing.time_laws import TimeLaw
from flexgen.paths.timing.velocity_profiles import TrapezoidStep, box_times

ROUNDING = 1e-12  # relative; a step is a sum over at most 32 pieces, each evaluated in Taylor form
OFFSET = 1e-9  # of the duration, from a break
BOUNDS = [(0.5, 4.0), (0.5, 4.0, 60.0), (0.5, 4.0, 60.0, 2000.0), (0.5, 4.0, 60.0, 2000.0, 1e5)]


def exact_step(times: tuple[float, ...], t: float, order: int) -> Fraction:
    """Derivative of the convolution of boxes by truncated powers, in rational numbers."""
    boxes = [Fraction(x) for x in times]
    p = len(times)
    total = Fraction(0)
    for size in range(p + 1):
        for chosen in combinations(boxes, size):
            rest = Fraction(t) - sum(chosen, Fraction(0))
            if rest > 0:
                total += (-1) ** size * rest ** (p - order) / factorial(p - order)
    return total / prod(boxes)


def worst_step(step: TrapezoidStep) -> float:
    """Largest error of the integral, the step and its derivatives, relative to the size of
    each.
    """
    t = step.duration * np.array([0.013, 0.11, 0.29, 0.46, 0.5001, 0.63, 0.81, 0.97])
    found = step.with_integral(t)
    worst = 0.0
    for column, order in enumerate(range(-1, min(len(step.times), 4))):
        right = np.array([float(exact_step(step.times, x, order)) for x in t])
        worst = max(worst, float(np.abs(found[:, column] - right).max() / np.abs(right).max()))
    return worst


@pytest.mark.parametrize(
    "times",
    [(0.3,), (0.3, 0.2), (0.5, 0.2, 0.1), (0.5, 0.2, 0.1, 0.03), (1.6, 0.8, 0.4, 0.2, 0.2)],
)
def test_trapezoid_steps_are_exact(times: tuple[float, ...]) -> None:
    assert worst_step(TrapezoidStep(times)) < ROUNDING


def test_a_wrong_taylor_coefficient_would_be_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    right = velocity_profiles._taylor
    monkeypatch.setattr(
        velocity_profiles, "_taylor", lambda values, dt, size: right(values, dt * (1 + 1e-9), size)
    )
    assert worst_step(TrapezoidStep((0.5, 0.2, 0.1))) > 10 * ROUNDING


@pytest.mark.parametrize("bounds", BOUNDS[1:])
@pytest.mark.parametrize("size", [1e-5, 0.02, 0.5, 3.0, 50.0])
def test_steps_keep_all_bounds_and_reach_the_highest(
    bounds: tuple[float, ...], size: float
) -> None:
    step = TrapezoidStep(box_times(size, bounds))
    t = np.sort(np.concatenate([np.linspace(0, step.duration, 4001), step.breaks * (1 - OFFSET)]))
    values = size * step.with_integral(t, len(bounds) + 1)
    reached = np.abs(values[:, 2:]).max(axis=0) / bounds
    assert (reached < 1 + ROUNDING).all() and reached[-1] > 1 - ROUNDING
    assert (values[:, 1] >= -1e-15 * size).all() and abs(values[-1, 1] - size) < ROUNDING * size
    # it is odd about its middle, so the mean speed is half the change
    assert abs(values[-1, 0] - size * step.duration / 2) < ROUNDING * size * step.duration


def test_seven_and_fifteen_segments_last_as_the_textbooks_say() -> None:
    d = 1.0
    v = 0.5
    a = 4.0
    j = 60.0
    s = 2000.0
    seven = speed_law([Stretch(d, v)], (v, a, j))
    assert len(seven.breaks) == 8 and abs(seven.duration - (d / v + v / a + a / j)) < ROUNDING
    fifteen = speed_law([Stretch(d, v)], (v, a, j, s))
    assert (
        len(fifteen.breaks) == 16
        and abs(fifteen.duration - (d / v + v / a + a / j + j / s)) < ROUNDING
    )
    # too short to reach any bound but the jerk's: four pieces of equal length
    short = speed_law([Stretch(1e-4, v)], (v, a, j))
    assert abs(short.duration - 4 * (1e-4 / (2 * j)) ** (1 / 3)) < 1e-9 * short.duration


def law_errors(law: SpeedLaw, bounds: tuple[float, ...], stretches: list[Stretch]) -> list[str]:
    """Names of the properties that a speed law violates."""
    wrong = []
    t = np.sort(np.concatenate([np.linspace(0, law.duration, 20001), law.breaks * (1 - OFFSET)]))
    values = law(t, 6)
    if abs(values[-1, 0] - sum(s.length for s in stretches)) > ROUNDING:
        wrong.append("length")
    if (np.diff(values[:, 0]) < -ROUNDING).any():
        wrong.append("goes back")
    for k, bound in enumerate(bounds, 1):
        if np.abs(values[:, k]).max() > bound * (1 + 1e-6):
            wrong.append(f"bound {k}")
    ends = np.cumsum([s.length for s in stretches])
    for k, stretch in enumerate(stretches):
        on = (values[:, 0] > ends[k] - stretch.length + 1e-9) & (values[:, 0] < ends[k] - 1e-9)
        if values[on, 1].max() > stretch.speed * (1 + 1e-9):
            wrong.append(f"speed of stretch {k}")
    h = OFFSET * law.duration
    inner = law.breaks
    for k in range(min(law.smoothness, 6) + 1):
        change = np.abs(law(inner + h, 6)[:, k] - law(inner - h, 6)[:, k]).max()
        steepest = np.abs(values[:, k + 1]).max() if k < 6 else np.inf
        if change > 2.1 * h * steepest + ROUNDING * np.abs(values[:, k]).max():
            wrong.append(f"derivative {k} jumps")
    # each column is the derivative of the one before, away from the breaks
    inside = (law.breaks[:-1] + law.breaks[1:]) / 2
    e = 1e-5 * np.diff(law.breaks)
    for k in range(3):
        slope = (law(inside + e, 6)[:, k] - law(inside - e, 6)[:, k]) / (2 * e)
        if np.abs(slope - law(inside, 6)[:, k + 1]).max() > 1e-4 * np.abs(values[:, k + 1]).max():
            wrong.append(f"derivative {k + 1}")
    return wrong


WAYS = {
    "long": [Stretch(1.0, 9.0)],
    "short": [Stretch(1e-3, 9.0)],
    "slow corner": [Stretch(0.4, 0.5), Stretch(0.02, 0.1), Stretch(0.3, 0.4)],
    "crawling starts": [Stretch(1e-4, 0.01), Stretch(0.2, 0.5), Stretch(1e-4, 0.01)],
    "many": [Stretch(0.01 + 0.004 * (k % 7), 0.05 + 0.03 * (k * 5 % 11)) for k in range(40)],
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("smoothness", [0, 3, 6])
@pytest.mark.parametrize("bounds", BOUNDS)
def test_laws_keep_speeds_and_bounds(bounds: tuple[float, ...], smoothness: int, way: str) -> None:
    law = speed_law(WAYS[way], bounds, smoothness)
    assert law.smoothness == (smoothness or len(bounds) - 1)
    assert law_errors(law, bounds, WAYS[way]) == []


def test_wrong_laws_would_be_seen() -> None:
    bounds = BOUNDS[2]
    way = WAYS["slow corner"]
    law = speed_law(way, bounds)
    assert "bound 4" in law_errors(law.slow_down(0.999), bounds, way)
    assert law_errors(speed_law(way, (*bounds[:2], 61.0, bounds[3])), bounds, way) == ["bound 3"]
    assert "speed of stretch 1" in law_errors(
        speed_law([Stretch(0.4, 0.5), Stretch(0.02, 0.2), way[2]], bounds), bounds, way
    )
    assert any("jumps" in text for text in law_errors(SpeedLaw(law.phases, 5), bounds, way))


def test_more_time_is_never_taken_for_looser_bounds() -> None:
    for way in WAYS.values():
        times = [
            speed_law(way, (0.5, 4.0, 60.0 * f, 2000.0 * f)).duration
            for f in (1.0, 2.0, 5.0, 50.0)
        ]
        assert all(b <= a * (1 + 1e-9) for a, b in pairwise(times))


def test_slowed_laws_divide_the_derivatives() -> None:
    law = speed_law(WAYS["slow corner"], BOUNDS[3])
    slow = law.slow_down(1.7)
    t = np.linspace(0.01, law.duration * 0.99, 57)
    assert abs(slow.duration / law.duration - 1.7) < 1e-15
    assert np.abs(slow(1.7 * t) * 1.7 ** np.arange(6) - law(t)).max() < 1e-9 * np.abs(law(t)).max()


def test_laws_rest_outside_their_time() -> None:
    for law in (speed_law(WAYS["short"], BOUNDS[1]), TimeLaw(0.5, 4, 2.0)):
        ends = law(np.array([-1.0, 0.0, law.duration, law.duration + 1]))
        assert not ends[:, 1:].any() and not ends[:2, 0].any() and ends[2, 0] == ends[3, 0] > 0


def test_polynomial_steps_know_their_integral() -> None:
    for k in (2, 5, 8):
        step = TimeLaw(0.7, k)
        u = np.array([0.05, 0.3, 0.5, 0.7, 0.95]) * 0.7
        x, weights = np.polynomial.legendre.leggauss(24)
        right = [b / 2 * weights @ TimeLaw(0.7, k)(b / 2 * (x + 1), 0)[:, 0] for b in u]
        assert np.abs(step.with_integral(u)[:, 0] - right).max() < 1e-15


def test_invalid_arguments_are_refused() -> None:
    for bounds in ((1.0,), (), (1.0, -1.0), (1.0, np.nan), (np.inf, 1.0)):
        with pytest.raises(ArgumentError, match="two or more positive bounds"):
            speed_law([Stretch(1.0, 1.0)], bounds)
    for stretches in ([], [Stretch(0.0, 1.0)], [Stretch(1.0, -1.0)], [Stretch(np.nan, 1.0)]):
        with pytest.raises(ArgumentError, match="stretches"):
            speed_law(stretches, (1.0, 1.0))
    with pytest.raises(ArgumentError, match="smoothness: given 1"):
        speed_law([Stretch(1.0, 1.0)], (1.0, 1.0), 1)
