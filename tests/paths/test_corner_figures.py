"""Corners of paths against geometry: lines, rounding by parabolas, overshoots of a known size;
planted errors.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.paths.accuracy import corners
from flexgen.paths.accuracy.corners import Corner, corner_figures, find_corners

TIME = np.arange(0.0, 2.0005, 1e-3)
U = np.array([1.0, 0.0])
W = np.array([0.0, 1.0])
CORNER = Corner(np.array([0.3, 0.1]), U, W, 0.5, 1.5)
PROFILE = (0.5, 2.0, 20.0, 200.0)


def along(time: np.ndarray, zone: float = 0.0, beyond: float = 0.0) -> np.ndarray:
    """To the corner in 1 s and up from it, rounded by a parabola within the zone; a bump beyond
    the second line.
    """
    s = 0.2 * (time - 1.0)
    x = np.minimum(s, 0.0)
    y = np.maximum(s, 0.0)
    if zone:
        inside = np.abs(s) < zone
        x, y = (
            np.where(inside, f, g)
            for f, g in ((-((zone - s) ** 2) / (4 * zone), x), ((zone + s) ** 2 / (4 * zone), y))
        )
    bump = beyond * np.where((s > 0) & (s < 0.02), np.sin(np.pi * s / 0.02) ** 2, 0.0)
    return CORNER.point + np.outer(x + bump, U) + np.outer(y, W)


def test_a_parabola_in_the_corner_has_the_round_off_of_its_vertex() -> None:
    """At s = 0 it is at (-z/4, z/4): z/(2 sqrt 2) from the corner."""
    found = corner_figures(
        [CORNER], TIME, along(TIME, 0.01), np.array([along(TIME, 0.01), along(TIME - 0.02, 0.03)])
    )
    assert_allclose(found["corner_round_off_commanded"], 0.01 / (2 * np.sqrt(2)), rtol=1e-3)
    assert_allclose(found["corner_round_off"], 0.03 / (2 * np.sqrt(2)), rtol=1e-3)
    assert found["corner_overshoot"] == pytest.approx(0.0, abs=1e-12)


def test_a_planted_overshoot_is_found_whatever_the_lateness() -> None:
    found = corner_figures(
        [CORNER], TIME, along(TIME), np.array([along(TIME - 0.03, beyond=4e-4)])
    )
    assert_allclose(found["corner_overshoot"], 4e-4, rtol=1e-3)
    assert found["corner_round_off"] == pytest.approx(0.0, abs=1e-9)
    inward = corner_figures([CORNER], TIME, along(TIME), np.array([along(TIME, beyond=-4e-4)]))
    assert inward["corner_overshoot"] == pytest.approx(0.0, abs=1e-12)


def test_the_nearest_sample_is_a_planted_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Samples of a fast robot lie to both sides of a corner that it passes exactly."""
    late = np.array([along(TIME - 0.0005)])
    assert (
        corner_figures([CORNER], TIME, along(TIME), late)["corner_round_off"]
        < 1e-4 / np.sqrt(2) + 1e-9
    )
    monkeypatch.setattr(
        corners, "distance_from_path", lambda x, d: np.linalg.norm(d, axis=1).min(keepdims=True)
    )
    assert corner_figures([CORNER], TIME, along(TIME), late)["corner_round_off"] > 0.99e-4


def elbow_move(zone: float) -> flexgen.Move:
    legs = (flexgen.MoveL((-0.2, 0.0, 0.0), zone=zone), flexgen.MoveL((0.0, 0.0, -0.2)))
    return flexgen.Move("corner", "tool_polyline", (0.5, -0.3), 0.0, 5, legs=legs, profile=PROFILE)


def test_corners_of_moves_are_those_of_their_legs() -> None:
    robot = flexgen.read("elbow")
    move = elbow_move(0.05)
    path = flexgen.plan(robot, move)
    y = path.sample([0.0, path.duration]).y[:, :, 0]
    (corner,) = find_corners(robot, path.move)
    assert_allclose(corner.point, y[0] + [-0.2, 0.0], atol=1e-12)
    assert_allclose([corner.before, corner.after], [[-1.0, 0.0], [0.0, -1.0]], atol=1e-12)
    # of the straight parts, 0.15 m each
    middles = path.sample([corner.begin, corner.end]).y[:, :, 0]
    assert_allclose(middles, y[[0, 1]] + [[-0.075, 0.0], [0.0, 0.075]], atol=1e-5)
    assert find_corners(robot, robot.move("line")) == ()
    steps = (
        flexgen.MoveL((-0.2, 0.0, 0.0), pause=0.1),
        flexgen.MoveL((-0.1, 0.0, 0.0)),
        flexgen.MoveL((0.0, 0.0, -0.2)),
    )
    program = flexgen.Program(
        "stops", start=(0.5, -0.3), smoothness=5, steps=steps, profile=PROFILE
    )
    (stop,) = find_corners(robot, program)  # straight on after the first step
    assert_allclose(stop.point, y[0] + [-0.3, 0.0], atol=1e-12)


@pytest.mark.slow
def test_a_solution_and_a_closed_loop_state_the_round_off_of_their_corner() -> None:
    run = flexgen.control(
        "elbow", elbow_move(0.05), plants={"soft": {"stiffness": 0.8}}, progress=False
    )
    found = run.accuracy()
    solved = run.solution.accuracy()
    path = flexgen.plan("elbow", elbow_move(0.05))
    y = path.sample(np.linspace(0.0, path.duration, 20_001)).y[:, :, 0]
    commanded = np.linalg.norm(y - (y[0] + [-0.2, 0.0]), axis=1).min()
    assert found.corner_round_off_commanded == pytest.approx(commanded, abs=1e-7)
    assert solved.corner_round_off == pytest.approx(commanded, abs=1e-7)
    soft = run["soft"].error + run.reference.y_ref
    expected = np.linalg.norm(soft - (y[0] + [-0.2, 0.0]), axis=1).min()
    assert run.accuracy(["soft"]).corner_round_off == pytest.approx(expected, abs=1e-6)
    assert run.to_dict()["accuracy"]["corner_round_off_m"] == found.corner_round_off
    assert "corner overshoot CO" in run.to_text()
    assert flexgen.control("elbow", progress=False).accuracy().corner_overshoot is None
