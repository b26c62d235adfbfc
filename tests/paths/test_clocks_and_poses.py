"""Poses that no tool can have, and a clock as a time law."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.errors import ArgumentError
from flexgen.paths.inverse_kinematics.search import kinematics
from flexgen.paths.timing.time_laws import Clock


def test_a_clock_has_a_distance_of_its_time() -> None:
    clock = Clock(2.0, 3)
    found = clock(np.array([-1.0, 0.0, 0.5, 2.0, 3.0]), 4)
    assert found.shape == (5, 5) and clock(np.zeros(1)).shape == (1, 6)
    assert_allclose(found[:, 0], [0.0, 0.0, 0.5, 2.0, 2.0])
    assert_allclose(found[:, 1], [0.0, 0.0, 1.0, 0.0, 0.0])
    assert not found[:, 2:].any() and clock.breaks.tolist() == [0.0, 2.0]


def test_a_wrong_pose_of_the_tool_is_refused() -> None:
    p = np.array([0.5, 0.6, 1.2])
    R = np.eye(3)
    for wrong in (
        np.diag([1.0, 1.0, -1.0]),
        np.diag([1.0, 1.0, 1.1]),
        R + 2e-6 * np.eye(3, k=1),
        np.zeros((3, 3)),
    ):
        with pytest.raises(
            ArgumentError,
            match=r"^rotation: given a matrix that is not a rotation, expected orthogonal",
        ):
            kinematics("manutec_r3", p, wrong)
    for position, rotation in ((p[:2], R), (p, R[:2]), (p[:, None], R)):
        shapes = (
            f"pose: given shapes {position.shape}, {rotation.shape}, expected (3,) and (3, 3), "
            "finite"
        )
        with pytest.raises(ArgumentError) as caught:
            kinematics("manutec_r3", position, rotation)
        assert str(caught.value) == shapes
    with pytest.raises(
        ArgumentError, match=r"^fixed: given joint 'q9', expected some of q1, q2, q3, q4, q5, q6$"
    ):
        kinematics("manutec_r3", p, R, fixed={"q9": 0.0})
