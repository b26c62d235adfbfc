"""Rotations of model files: exact at quarter turns, elsewhere those of SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from flexgen.model.format.format_robot import rotation_matrix

QUARTERS = [
    (90.0 * i, 90.0 * j, 90.0 * k) for i in range(-4, 5, 3) for j in (0, 1) for k in (2, 3)
]


@pytest.mark.parametrize("rpy", QUARTERS)
def test_quarter_turns_are_exact(rpy: tuple[float, float, float]) -> None:
    """In degrees and in radians: entries are 0, 1 and -1, and the rotation is the right one."""
    expected = Rotation.from_euler("xyz", rpy, degrees=True).as_matrix()
    for degrees, given in ((True, rpy), (False, tuple(np.radians(rpy).tolist()))):
        found = np.array(rotation_matrix(given, degrees))
        assert set(found.ravel().tolist()) <= {0.0, 1.0, -1.0}
        assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("degrees", [True, False])
def test_other_turns_are_roll_pitch_and_yaw(degrees: bool) -> None:
    for rpy in np.random.default_rng(0).uniform(-400, 400, (20, 3)):
        given = rpy if degrees else np.radians(rpy)
        expected = Rotation.from_euler("xyz", rpy, degrees=True).as_matrix()
        found = rotation_matrix(tuple(given.tolist()), degrees)
        assert_allclose(found, expected, atol=1e-13)
    tiny = np.array(rotation_matrix((2e-15, 0.0, 0.0), False))
    assert tiny[2, 1] == 2e-15  # only rounding errors become zero
    assert rotation_matrix((5e-16, 0.0, 0.0), False)[2][1] == 0.0
