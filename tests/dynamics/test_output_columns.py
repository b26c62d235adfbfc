"""Angles between rotations, against rotations about known axes."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from flexgen.dynamics.mechanics.output_columns import turn_angle


def test_angles_between_rotations_from_tiny_to_half_a_turn() -> None:
    angles = np.array([1e-9, 0.4, 2.0, np.pi - 1e-7])
    axis = np.array([[1, 2, 3], [3, -1, 2], [0, 0, 1], [1, 1, 0]]) / np.sqrt(
        [[14], [14], [1], [2]]
    )
    start = Rotation.from_rotvec([[0.3, 1.1, -0.4]] * 4).as_matrix()
    R = Rotation.from_rotvec(axis * angles[:, None]).as_matrix() @ start
    assert_allclose(turn_angle(R, start), angles, rtol=1e-6)
