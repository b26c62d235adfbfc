"""Accuracy and repeatability of paths against closed forms: circles, delays, oscillators; planted
errors.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.paths.accuracy import figures
from flexgen.paths.accuracy.figures import path_accuracy

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
    # 5e-3 m at the same time
    assert found.path_accuracy is not None and found.path_accuracy < 2e-7
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
    monkeypatch.setattr(figures, "ITERATIONS", 0)
    found = judged(circle(TIME - 0.03))
    assert found.path_accuracy is not None and found.path_accuracy > 1e-4


def test_speeds_are_those_of_stretched_circles() -> None:
    """A robot on a circle that is larger by a part is faster by that part."""
    found = judged(circle(TIME, 0.101), circle(TIME, 0.103))
    assert_allclose(found.speed_accuracy, 0.02, rtol=1e-6)
    assert_allclose(found.speed_repeatability, 3 * np.std([0.01, 0.03], ddof=1), rtol=1e-6)
    speed = 0.1 * np.pi * (1 - np.cos(2 * np.pi * TIME)) * (TIME < END)
    assert_allclose(
        found.speed_fluctuation, 0.03 * np.ptp(speed[speed >= 0.95 * speed.max()]), rtol=1e-3
    )


@pytest.mark.parametrize(("damping", "frequency"), [(0.2, 8.0), (0.1, 8.0)])
def test_settling_and_overshoot_are_those_of_an_oscillator(
    damping: float, frequency: float
) -> None:
    """A e^(-d w t) cos(w_d t) after the path: its peaks decide."""
    size = 1e-3
    band = 1e-4
    w = 2 * np.pi * frequency
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
    assert found.stabilizations_s[0] == pytest.approx(outside[-1] - first, abs=1.5e-3)
    assert found.drifts[0] == pytest.approx(distance[(END + TIME[-1]) / 2 <= TIME].max(), rel=1e-9)
    half = size * np.exp(-damping * np.pi / np.sqrt(1 - damping**2))  # the first peak beyond
    assert found.overshoots[0] == pytest.approx(half, rel=0.05)


@pytest.mark.parametrize("band", [0.0, -1.0, np.inf, np.nan])
def test_the_band_is_a_length(band: float) -> None:
    t = np.linspace(0.0, 2.0, 21)
    way = np.outer(np.clip(t, 0.0, 1.0), [1.0, 0.0, 0.0])
    with pytest.raises(ArgumentError, match=r"^band: given .*, expected a number > 0 \[m\]$"):
        path_accuracy(t, way, way[None], 1.0, robots=("a",), band=band)


def test_a_robot_that_does_not_stay_in_the_band_has_no_settling_time() -> None:
    wave = np.where(TIME >= END, 1e-3 * np.cos(40.0 * (TIME - END)), 0.0)
    found = judged(circle(TIME) + wave[:, None] * [1.0, 0.0])
    assert found.settling_s == (None,) and found.stabilizations_s == (None,)


def test_a_robot_that_creeps_into_the_band_has_no_overshoot() -> None:
    away = 1e-3 * np.exp(-np.maximum(TIME - END, 0.0) / 0.05)
    found = judged(circle(TIME) + away[:, None] * [1.0, 0.0])
    assert found.overshoots == (0.0,)
    assert found.settling_s[0] == pytest.approx(0.05 * np.log(10.0), abs=2e-3)
    assert found.stabilizations_s == (0.0,)  # it enters the band once


def test_a_robot_that_creeps_at_rest_drifts_by_its_speed() -> None:
    creep = 2e-5 * np.maximum(TIME - END, 0.0)
    found = judged(circle(TIME) + creep[:, None] * [0.6, 0.8])
    assert found.drifts[0] == pytest.approx(2e-5 * 0.5, rel=1e-9)
    assert (
        found.to_dict()["robots"][0]["drift_m"] == found.drifts[0]
        and found.to_dict()["drift_m"] == found.drifts[0]
    )


def turned(angles: np.ndarray) -> np.ndarray:
    """Matrices (n, 3, 3) of rotation vectors (n, 3), by the formula of Rodrigues."""
    size = np.linalg.norm(angles, axis=1)[:, None, None]
    x, y, z = angles.T
    o = np.zeros(len(angles))
    hat = np.stack([o, -z, y, z, o, -x, -y, x, o], axis=1).reshape(-1, 3, 3)
    return np.asarray(
        np.eye(3)
        + np.sinc(size / np.pi) * hat
        + 0.5 * np.sinc(size / (2 * np.pi)) ** 2 * hat @ hat
    )


def command(time: np.ndarray) -> np.ndarray:
    """The tool turns by 1 rad about an axis along the path."""
    x = np.clip(time, 0.0, END)
    return turned((x - np.sin(2 * np.pi * x) / (2 * np.pi))[:, None] * [0.48, 0.6, 0.64])


PLANTED = np.array([[3e-4, -1e-4, 0.0], [1e-4, -2e-4, 5e-4], [-2e-4, -6e-4, 4e-4]])


def oriented(errors: np.ndarray, late: float, *, reverse: bool = False) -> flexgen.PathAccuracy:
    """Robots that are late on the path, with constant errors of the angles about the world
    axes.
    """
    each = [turned(np.tile(error, (len(TIME), 1))) for error in errors]
    R = np.array([command(TIME - late) @ x if reverse else x @ command(TIME - late) for x in each])
    names = tuple("abc"[: len(errors)])
    p = np.array([circle(TIME - late)] * len(errors))
    return path_accuracy(TIME, circle(TIME), p, END, robots=names, orientations=(command(TIME), R))


@pytest.mark.parametrize("late", [0.0, 0.03])
def test_angles_that_were_planted_are_found_whatever_the_lateness(late: float) -> None:
    """AP and AT are the means of the planted angles, RP and RT three standard deviations of
    each.
    """
    found = oriented(PLANTED, late)
    mean = PLANTED.mean(axis=0)
    spread = 3 * np.sqrt(((PLANTED - PLANTED.mean(axis=0)) ** 2).sum(axis=0) / 2)
    assert_allclose(found.orientation_accuracy, mean, rtol=1e-9)
    assert_allclose(found.orientation_repeatability, spread, rtol=1e-9)
    # linear between the samples
    assert_allclose(found.orientation_path_accuracy, np.abs(mean), atol=3e-7)
    assert_allclose(found.orientation_path_repeatability, spread, atol=3e-7)
    data = found.to_dict()
    assert_allclose(data["orientation_accuracy_rad"], mean, rtol=1e-9)
    assert data["orientation_accuracy_max_rad"] == pytest.approx(np.abs(mean).max(), rel=1e-9)


def test_angles_about_the_axes_of_the_tool_are_a_planted_error() -> None:
    found = oriented(PLANTED, 0.0, reverse=True).orientation_accuracy
    assert found is not None and np.abs(np.array(found) - PLANTED.mean(axis=0)).max() > 5e-5


def test_orientations_at_the_same_time_are_a_planted_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(figures, "ITERATIONS", 0)
    found = oriented(PLANTED, 0.03).orientation_path_accuracy
    assert found is not None and max(found) > 1e-2


def test_one_robot_has_angles_without_repeatability_and_a_position_has_none() -> None:
    found = oriented(PLANTED[1:2], 0.0)
    assert found.orientation_path_repeatability is None and found.orientation_repeatability is None
    assert_allclose(found.orientation_accuracy, PLANTED[1], rtol=1e-9)
    assert judged(circle(TIME)).to_dict()["orientation_accuracy_rad"] is None


@pytest.mark.slow
def test_a_closed_loop_of_poses_states_angles_in_its_json() -> None:
    """The norm of the mean angles at the end of one robot is its angle from the reference
    there.
    """
    run = flexgen.control("kr300", plants={"heavy": {"payload": 20.0}}, progress=False)
    data = run.to_dict()["accuracy"]
    assert data["path_accuracy_m"] == run.accuracy().path_accuracy and len(data["robots"]) == 2
    one = run.accuracy(["heavy"])
    assert run["heavy"].turn is not None and one.orientation_accuracy is not None
    assert np.linalg.norm(one.orientation_accuracy) == pytest.approx(
        run["heavy"].turn[-1], rel=1e-6
    )
    assert run["heavy"].turn[-1] > 1e-6
    assert "angles AP_a, AP_b, AP_c at the end" in run.to_text()
    solved = run.solution.to_dict()["accuracy"]
    assert solved["orientation_path_accuracy_max_rad"] < 1e-5
    assert flexgen.solve("elbow", verify=False).to_dict()["accuracy"] is None


@pytest.mark.parametrize("zone", [0.0, 0.002])
def test_a_robot_that_stops_short_of_a_corner_is_measured_at_its_nearest(
    zone: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two legs of 100 mm: the robot is 10 mm short of the end of the first one, so that it is 10
    mm off the other.
    """
    s = np.clip(np.linspace(-0.02, 0.22, 2401), 0.0, 0.2)  # [m] along the legs
    s = np.concatenate([s[:1201], np.full(200, s[1200]), s[1201:]])  # with a stop in the corner
    time = np.linspace(0.0, 2.6, len(s))
    x = np.minimum(s, 0.1)
    y = np.clip(s - 0.1, 0.0, 0.1)
    if zone:
        near = np.abs(s - 0.1) < zone
        part = (s[near] - 0.1 + zone) / (2 * zone)
        x[near] = 0.1 - zone * (1 - part) ** 2
        y[near] = zone * part**2
    line = np.column_stack([x, y])
    short = np.column_stack([np.minimum(x, 0.09), y])
    judge = partial(path_accuracy, time, line, np.array([short]), 2.5, robots=("short",))
    # on planes at up to 60 degrees in a round one
    assert 0.0099 < judge().path_accuracy < (0.0201 if zone else 0.0101)
    monkeypatch.setattr(figures, "TURN", 10.0)
    assert judge().path_accuracy > 0.03  # the planted error: on the other leg


def test_figures_of_a_reference_at_rest_are_not_stated() -> None:
    rest = np.zeros((len(TIME), 2))
    found = path_accuracy(TIME, rest, np.array([rest + 1e-3]), END, robots=("a",))
    assert (
        found.path_accuracy is None
        and found.speed_accuracy is None
        and found.path_errors == (None,)
    )
    assert found.pose_accuracy == pytest.approx(np.sqrt(2) * 1e-3)
    assert found.robot_rows() == [("a", "-", "0", "0", "0", "0")]
    with pytest.raises(ArgumentError, match=r"band: given -1, expected a number > 0 \[m\]"):
        judged(circle(TIME), band=-1)


def test_an_output_with_one_axis_has_no_offsets_from_its_path() -> None:
    """A robot that is a tenth too far is on the line of one axis: only its end and its speed show
    it.
    """
    line = circle(TIME)[:, :1]
    found = path_accuracy(TIME, line, np.array([1.1 * line, line]), END, robots=("far", "right"))
    assert (
        found.path_accuracy is None
        and found.path_repeatability is None
        and found.path_errors == (None, None)
    )
    assert found.pose_accuracy == pytest.approx(0.005) and found.speed_accuracy == pytest.approx(
        0.05
    )
    assert found.robot_rows()[0][1] == "-" and "path accuracy AT" not in dict(found.rows())
    run = flexgen.control("four_mass", plants={"soft": {"stiffness": 0.9}})
    assert (
        run.accuracy().path_accuracy is None
        and run.to_dict()["accuracy"]["path_accuracy_m"] is None
    )


def test_a_closed_loop_states_the_figures_of_its_robots() -> None:
    run = flexgen.control(
        "elbow", plants={"soft": {"stiffness": 0.8}, "stiff": {"stiffness": 1.25}}, progress=False
    )
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
    assert (
        solved.robots == ("elbow",)
        and solved.path_accuracy is not None
        and solved.path_accuracy < 1e-8
    )
