"""Accuracy and repeatability of paths against closed forms: circles, delays, oscillators; planted errors."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.errors import ArgumentError
from flexgen.paths import accuracy
from flexgen.paths.accuracy import path_accuracy

TIME = np.arange(0.0, 2.0005, 1e-3)
END = 1.0


def circle(time: np.ndarray, radius: float = 0.1) -> np.ndarray:
    """Half a circle in 1 s, slow at both ends, at rest after it."""
    x = np.clip(time, 0.0, END)
    angle = np.pi * (x - np.sin(2 * np.pi * x) / (2 * np.pi))
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def judged(*attained: np.ndarray, **options: float) -> flexgen.PathAccuracy:
    names = tuple(f"r{j}" for j in range(len(attained)))
    return path_accuracy(TIME, circle(TIME), np.array(attained), END, robots=names, **options)


def test_a_robot_that_is_late_on_the_path_has_no_error_of_the_path() -> None:
    found = judged(circle(TIME - 0.03))
    assert found.path_accuracy is not None and found.path_accuracy < 2e-7  # 5e-3 m at the same time
    assert found.path_repeatability is None and found.pose_repeatability is None
    assert found.pose_accuracy == pytest.approx(0.0, abs=1e-15)
    error = np.linalg.norm(circle(TIME - 0.03) - circle(TIME), axis=1).max()
    assert error > 5e-3


def test_larger_circles_have_the_repeatability_of_their_radii() -> None:
    """AT is the mean of the excess, RT = mean |excess - mean| + 3 s of it, on each plane."""
    excess = np.array([1e-4, 3e-4, 8e-4])
    found = judged(*(circle(TIME - 0.01 * j, 0.1 + x) for j, x in enumerate(excess)))
    away = np.abs(excess - excess.mean())
    expected = away.mean() + 3 * away.std(ddof=1)
    assert_allclose(found.path_accuracy, excess.mean(), rtol=1e-3)
    assert_allclose(found.path_repeatability, expected, rtol=1e-3)
    assert_allclose(found.pose_accuracy, excess.mean(), rtol=1e-9)
    assert_allclose(found.pose_repeatability, expected, rtol=1e-9)
    assert_allclose(found.path_errors, excess, rtol=1e-3)


def test_offsets_at_the_same_time_are_a_planted_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the search for the plane, lateness is taken for an error of the path."""
    monkeypatch.setattr(accuracy, "ITERATIONS", 0)
    found = judged(circle(TIME - 0.03))
    assert found.path_accuracy is not None and found.path_accuracy > 1e-4


def test_speeds_are_those_of_stretched_circles() -> None:
    """A robot on a circle that is larger by a part is faster by that part."""
    found = judged(circle(TIME, 0.101), circle(TIME, 0.103))
    assert_allclose(found.speed_accuracy, 0.02, rtol=1e-6)
    assert_allclose(found.speed_repeatability, 3 * np.std([0.01, 0.03], ddof=1), rtol=1e-6)
    speed = 0.1 * np.pi * (1 - np.cos(2 * np.pi * TIME)) * (TIME < END)
    assert_allclose(found.speed_fluctuation, 0.03 * np.ptp(speed[speed >= 0.95 * speed.max()]), rtol=1e-3)


@pytest.mark.parametrize(("damping", "frequency"), [(0.2, 8.0), (0.1, 8.0)])
def test_settling_and_overshoot_are_those_of_an_oscillator(damping: float, frequency: float) -> None:
    """A e^(-d w t) cos(w_d t) after the path: its peaks decide."""
    size, band, w = 1e-3, 1e-4, 2 * np.pi * frequency
    after = np.maximum(TIME - END, 0.0)
    away = size * np.exp(-damping * w * after) * np.cos(w * np.sqrt(1 - damping**2) * after)
    wave = np.where(TIME >= END, away, 0.0)[:, None] * [0.6, 0.8]
    found = judged(circle(TIME) + wave, band=band)
    last = wave[-1]
    distance = np.linalg.norm(wave - last, axis=1)
    outside = TIME[(TIME >= END) & (distance > band)]
    first = TIME[(TIME >= END) & (distance <= band)][0]
    assert found.settling_s[0] == pytest.approx(outside[-1] - END, abs=1.5e-3)
    assert found.overshoots[0] == pytest.approx(distance[first <= TIME].max(), rel=1e-9)
    half = size * np.exp(-damping * np.pi / np.sqrt(1 - damping**2))  # the first peak beyond
    assert found.overshoots[0] == pytest.approx(half, rel=0.05)


def test_a_robot_that_does_not_stay_in_the_band_has_no_settling_time() -> None:
    wave = np.where(TIME >= END, 1e-3 * np.cos(40.0 * (TIME - END)), 0.0)
    assert judged(circle(TIME) + wave[:, None] * [1.0, 0.0]).settling_s == (None,)


def test_a_robot_that_creeps_into_the_band_has_no_overshoot() -> None:
    away = 1e-3 * np.exp(-np.maximum(TIME - END, 0.0) / 0.05)
    found = judged(circle(TIME) + away[:, None] * [1.0, 0.0])
    assert found.overshoots == (0.0,)
    assert found.settling_s[0] == pytest.approx(0.05 * np.log(10.0), abs=2e-3)


def test_figures_of_a_reference_at_rest_are_not_stated() -> None:
    rest = np.zeros((len(TIME), 2))
    found = path_accuracy(TIME, rest, np.array([rest + 1e-3]), END, robots=("a",))
    assert found.path_accuracy is None and found.speed_accuracy is None and found.path_errors == (None,)
    assert found.pose_accuracy == pytest.approx(np.sqrt(2) * 1e-3)
    assert found.robot_rows() == [("a", "-", "0", "0")]
    with pytest.raises(ArgumentError, match=r"band: given -1, expected a number > 0 \[m\]"):
        judged(circle(TIME), band=-1)


def test_a_closed_loop_states_the_figures_of_its_robots() -> None:
    run = flexgen.control("elbow", plants={"soft": {"stiffness": 0.8}, "stiff": {"stiffness": 1.25}}, progress=False)
    found = run.accuracy(band=2e-5)
    assert found.robots == ("nominal", "soft", "stiff") and found.unit == "m"
    ends = [np.linalg.norm(robot.error[-1]) for robot in run.runs]
    one = run.accuracy(["soft"])
    assert one.pose_accuracy == pytest.approx(ends[1]) and one.path_repeatability is None
    for error, robot in zip(found.path_errors, run.runs, strict=True):
        assert error is not None and error <= run.distance(robot).max() * (1 + 1e-9) + 1e-9
    assert "path repeatability RT" in run.to_text() and "ISO 9283" in run.to_text()
    with pytest.raises(ArgumentError, match="plant: given 'other'"):
        run.accuracy(["other"])
    solved = run.solution.accuracy()
    assert solved.robots == ("elbow",) and solved.path_accuracy is not None and solved.path_accuracy < 1e-8
