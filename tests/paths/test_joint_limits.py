"""Joints along a path, and limits of joints and motors: closed forms of sines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import SolverError
from flexgen.paths.reference import Reference
from flexgen.paths.timing.joint_limits import InverseKinematics, beyond_range

Q1 = "element.upper.dof.q1"
SIZES = np.array([0.4, 0.3])  # rad
RATES = np.array([1.0, 2.0])  # rad/s


def swing(t: np.ndarray) -> np.ndarray:
    """Joints of the elbow and their derivatives up to order 5, (n, 2, 6)."""
    turn = np.array([0.0, np.pi / 2])
    rows = [SIZES * RATES**k * np.sin(RATES * t[:, None] + turn + k * np.pi / 2) for k in range(6)]
    rows[0] += [0.3, 0.5]
    return np.stack(rows, axis=2)


def test_joints_along_a_path_are_those_that_it_was_made_of() -> None:
    """From a start that is near, at many instants one by one or at once; also their rates."""
    equations = flexgen.derive("elbow")
    kinematics = InverseKinematics(equations)
    t = np.linspace(0.0, 2.0, 41)
    x = swing(t)
    sample = Reference(equations).sample("joint", x, None)
    start = x[0, :, 0] + [0.05, -0.05]
    for found in (
        kinematics.follow(sample, start),
        kinematics.follow_many(sample, start, t / t[-1]),
    ):
        assert_allclose(found, x[:, :, 0], atol=1e-9)
    v, a = kinematics.velocities(sample, x[:, :, 0])
    assert_allclose(v, x[:, :, 1], atol=1e-9)
    assert_allclose(a, x[:, :, 2], atol=1e-9)


def test_points_that_the_arm_does_not_reach_are_named_by_their_time() -> None:
    equations = flexgen.derive("elbow")
    kinematics = InverseKinematics(equations)
    x = swing(np.linspace(0.0, 2.0, 11))
    sample = Reference(equations).sample("joint", x, None)
    sample.y[6:, 0, 0] += 9.0
    with pytest.raises(SolverError, match=r"^inverse kinematics: .* after 60 % of the time"):
        kinematics.follow(sample, x[0, :, 0])


@pytest.mark.parametrize(
    ("limits", "factor"),
    [
        ({f"{Q1}.speed_max": 0.1}, 0.4 / 0.1),
        ({f"{Q1}.acceleration_max": 0.025}, (0.4 / 0.025) ** 0.5),
        ({f"{Q1}.speed_max": 0.1, f"{Q1}.acceleration_max": 0.1}, 4.0),
        ({f"{Q1}.speed_max": 0.4, f"{Q1}.acceleration_max": 0.004}, 10.0),
        ({"motor.m1.speed_max": 50.0}, 0.4 * 1872 / 7 / 50.0),
        ({"motor.m2.speed_max": 10.0, "motor.m1.speed_max": 1e3}, 0.6 * 757 / 3 / 10.0),
        ({}, 0.0),
    ],
)
def test_limits_slow_a_motion_down(limits: dict[str, float], factor: float) -> None:
    """Speeds by their ratio, accelerations by its root, motors through their gears; maxima
    between the instants are found.
    """
    model = flexgen.read("elbow", overrides=limits)
    kinematics = InverseKinematics(flexgen.derive(model))
    x = swing(np.linspace(0.0, 3.0, 21))
    assert kinematics.has_limits == bool(limits)
    assert kinematics.slowdown(x[:, :, 1], x[:, :, 2]) == pytest.approx(factor, rel=2e-3)


@pytest.mark.parametrize(
    ("angle", "told"),
    [
        (0.75, ""),
        (0.75 + 1e-6, "coordinate q1 goes to 0.75 rad, its range is -0.5 to 0.75 rad"),
        (1.25, "coordinate q1 goes to 1.25 rad, its range is -0.5 to 0.75 rad"),
        (-0.6, "coordinate q1 goes to -0.6 rad, its range is -0.5 to 0.75 rad"),
    ],
)
def test_coordinates_that_leave_their_range_are_named(angle: float, told: str) -> None:
    limits: Any = {f"{Q1}.lower_rad": -0.5, f"{Q1}.upper_rad": 0.75, "home_deg": [0, 0]}
    model = flexgen.read("elbow", overrides={**limits, "move": []})
    q = np.array([[0.0, 9.0], [angle, 9.0], [0.0, -9.0]])
    assert beyond_range(model, q) == ((told,) if told else ())
