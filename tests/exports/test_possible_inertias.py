"""Inertias that MuJoCo can have, and targets of the self-test of a stream."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.exports.c_code.selftest import motion
from flexgen.exports.mujoco import mujoco_inertia


def test_inertias_that_rounding_makes_impossible_get_as_much_as_is_missing() -> None:
    """Of a long rod: 2e-14 of its largest moment on all; a tensor that is possible stays."""
    model = flexgen.read("elbow")
    for size in (4.0, 0.25):
        rod = size * np.diag([1.0 + 4e-15, 1.0 - 4e-15, 0.0])
        kept = size * np.diag([1.0, 1.2, 0.4])
        found = mujoco_inertia.regroup(model, [rod, kept], [np.eye(3)] * 2)
        assert np.abs(found[0] - rod - 2e-14 * rod.max() * np.eye(3)).max() < 5e-16 * size
        assert np.array_equal(found[1], kept) and mujoco_inertia.missing(found[0]) <= 0.0


def test_poses_of_a_stream_have_their_rotation_by_columns() -> None:
    y = np.arange(12.0).reshape(2, 3, 2)
    R = Rotation.random(2, random_state=1).as_matrix()
    made: Any = Made(y=y, R=R)
    found = motion.targets(made)
    assert_allclose(found, [[*y[k, :, 0], *R[k].T.ravel()] for k in range(2)])
    made.R = None
    assert_allclose(motion.targets(made), y[:, :, 0])
