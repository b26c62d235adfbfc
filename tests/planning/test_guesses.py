"""Numbers of flexgen/planning/optimal by other routes: guesses by derivatives and equilibria,
paths by samples, distances.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.paths.path import Path
from flexgen.paths.timing.time_laws import TimeLaw
from flexgen.planning.optimal import guesses, reference_curve
from flexgen.planning.optimal.obstacles import HalfSpace, Sphere, arm_points, distance_rows


@dataclass(frozen=True)
class Part:
    """A segment with this law."""

    law: Any


def test_a_guess_between_equilibria_begins_and_ends_there() -> None:
    """Rates by differences; torques of the rigid robot; the motors' sag fades from one end to the
    other.
    """
    equations = flexgen.derive("elbow")
    model = equations.model
    ends = (
        guesses.rest_at(equations, np.array([0.1, 0.4])),
        guesses.rest_at(equations, np.array([0.7, -0.2])),
    )
    made = guesses.between(equations, ends, 0.8, None)
    assert made.duration == 0.8
    # knots of the splines
    t = np.linspace(0.0, 0.8, 5)
    e = 1e-5
    y, dy, ddy, tau = made.at(t)
    assert_allclose(y[[0, -1]], ends, atol=1e-9)
    assert_allclose(dy[[0, -1], :2], 0.0, atol=1e-6)
    law = TimeLaw(0.8, 3)(t, 0)[:, :1]
    assert_allclose(y[:, :2], ends[0][:2] + law * (ends[1] - ends[0])[:2], atol=1e-4)
    inner = t[1:4]
    slope = (made.at(inner + e)[0] - made.at(inner - e)[0])[:, :2] / (2 * e)
    assert_allclose(dy[1:4, :2], slope, atol=1e-4)
    assert_allclose(dy[:, 2:], dy[:, :2] @ model.eta.T, atol=1e-9)
    assert_allclose(ddy[:, 2:], ddy[:, :2] @ model.eta.T, atol=1e-9)
    share = (t / 0.8)[:, None]
    sag = [end[2:] - model.eta @ end[:2] for end in ends]
    assert_allclose(
        y[:, 2:] - y[:, :2] @ model.eta.T, (1 - share) * sag[0] + share * sag[1], atol=1e-9
    )
    for k in range(5):
        needed = np.array(
            equations.function("inverse_dynamics")(y[k, :2], dy[k, :2], ddy[k, :2])
        ).ravel()
        rotor = np.array([m.inertia for m in model.motors]) * (model.eta @ ddy[k, :2])
        assert_allclose(tau[k], np.linalg.inv(model.eta).T @ needed + rotor, rtol=1e-3, atol=1e-3)
    assert_allclose(made.at(np.array([-1.0, 9.0]))[0], ends, atol=1e-9)
    path = Path(equations, model.moves[0])
    rests = guesses.ends_of(equations, path)
    along = guesses.between(equations, rests, 2 * path.duration, path).at(
        np.array([path.duration])
    )[0]
    tool = np.array(equations.function("output")(along[0, :2])).ravel()
    assert_allclose(tool, path.sample(np.array([path.duration / 2])).y[0, :, 0], atol=1e-3)


def test_a_guess_from_a_trajectory_is_its_part() -> None:
    equations = flexgen.derive("elbow")
    t = np.linspace(0.0, 1.0, 51)
    columns = np.stack([np.sin(t), np.cos(t)], axis=1)
    names = ("q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m")
    channels = {name: (k + 1) * columns for k, name in enumerate(names)}
    ports = {name: Port(name, (2,), "", "") for name in names}
    given = Trajectory(t, channels, ports, dict.fromkeys(names, ("1", "2")))
    made = guesses.from_trajectory(equations, given, 0.2, 0.7)
    assert made.duration == pytest.approx(0.5)
    found = made.at(np.array([0.1, 5.0]))
    at = np.array([[np.sin(0.3), np.cos(0.3)], [np.sin(1.0), np.cos(1.0)]])
    for part, (arm, motor) in zip(found[:3], ((1, 4), (2, 5), (3, 6)), strict=True):
        assert_allclose(part, np.hstack([arm * at, motor * at]), atol=1e-4 * motor)
    assert_allclose(found[3], 7 * at, atol=1e-3)


def test_the_polynomial_of_a_path_goes_through_its_samples() -> None:
    equations = flexgen.derive("elbow")
    path = Path(equations, equations.model.moves[0])
    by_length, length = reference_curve.path_by_parameter(path)
    ends = path.sample(np.array([0.0, path.duration])).y[:, :, 0]
    assert (
        length == pytest.approx(np.linalg.norm(ends[1] - ends[0])) and by_length.duration == length
    )
    t = np.linspace(0.0, path.duration, 9)
    s = path.segments[0].law(t, 0)[:, 0] / length
    wanted = path.sample(t).y[:, :, 0]
    assert_allclose(reference_curve.targets_at(path, s), wanted, atol=1e-9)
    x = ca.SX.sym("s")
    curve = ca.Function("curve", [x], [reference_curve.curve(path, x)])
    assert_allclose(np.array(curve(s[None])).T, wanted, atol=1e-8)
    beyond = np.array(curve(1.5)).ravel()
    assert_allclose(beyond, ends[0] + 1.5 * (ends[1] - ends[0]), atol=1e-8)  # a line stays one


def test_a_path_with_corners_is_for_several_phases() -> None:
    """One of several segments, and one with a corner."""
    equations = flexgen.derive("elbow")
    path = Path(equations, equations.model.moves[0])
    path.segments = (path.segments[0], path.segments[0])
    with pytest.raises(ArgumentError) as caught:
        reference_curve.path_by_parameter(path)
    assert str(caught.value) == (
        "move line: given one of 2 segments, expected a single one; use one phase for each segment"
    )
    corner = Made(move=Made(name="corner"), duration=1.0, segments=(Part(TimeLaw(1.0, 5)),))
    corner.sample = lambda s: Made(y=np.abs(s - 0.4)[:, None, None] + [[[0.0], [1.0]]], R=None)
    with pytest.raises(ArgumentError) as caught:
        reference_curve.curve(corner, ca.SX.sym("s"))
    assert str(caught.value).startswith(
        "move corner: its curve is not a smooth function of the path parameter, expected"
    )
    round_off = Made(move=Made(name="arc"), duration=1.0, segments=(Part(TimeLaw(1.0, 5)),))
    round_off.sample = lambda s: Made(
        y=np.stack([np.cos(2 * s), np.sin(2 * s)], axis=1)[:, :, None], R=None
    )
    x = ca.SX.sym("s")
    made = ca.Function("arc", [x], [reference_curve.curve(round_off, x)])
    s = np.linspace(0.0, 1.0, 7)
    assert_allclose(np.array(made(s[None])), [np.cos(2 * s), np.sin(2 * s)], atol=1e-9)


def test_distances_of_the_arm_from_obstacles() -> None:
    equations = flexgen.derive("planar5_nmp")
    q = ca.SX.sym("q", equations.model.n_a)
    pose = 0.3 * np.arange(1, equations.model.n_a + 1)
    points = np.array(ca.Function("p", [q], [arm_points(equations, q, 1)])(pose))
    corners = np.array(ca.Function("c", [q], [arm_points(equations, q, 0)])(pose))
    assert points.shape[1] == 2 * corners.shape[1]
    assert_allclose(points[:, 1::2], corners)
    assert_allclose(points[:, 2::2], (corners[:, :-1] + corners[:, 1:]) / 2)
    center = np.array([0.5, 1.5, 0.2])
    half = np.array([3.0, -4.0, 0.0])
    at = ca.Function(
        "d",
        [q],
        [
            distance_rows(equations, q, Sphere(tuple(center), 0.1), 0.05, 1),
            distance_rows(equations, q, HalfSpace(tuple(half), -2.0), 0.3, 1),
        ],
    )
    sphere, space = (np.array(x).ravel() for x in at(pose))
    far = np.linalg.norm(points - center[:, None], axis=0)
    assert_allclose(sphere, (far**2 - 0.15**2) / 0.3)
    assert_allclose(space, half @ points / 5 + 2.0 - 0.3)
    for samples in (-1, 21, True):
        with pytest.raises(ArgumentError, match=r"samples: given .*, expected 0 to 20"):
            arm_points(equations, q, samples)
    arm_points(equations, q, 20)
    with pytest.raises(
        ArgumentError, match=r"obstacle: given 3, expected a Sphere or a HalfSpace"
    ):
        distance_rows(equations, q, 3, 0.0, 0)
    with pytest.raises(ArgumentError, match="margin"):
        distance_rows(equations, q, Sphere((0.0, 0.0, 0.0), 0.1), -0.1, 0)
