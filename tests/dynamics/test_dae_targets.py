"""Targets of the inverse dynamics: each derivative is the slope of the one before along a path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.dae.system import InverseDae
from flexgen.paths.path import Path

MOVES = [("elbow", "line"), ("elbow", "joints"), ("manutec_r3", "line"), ("manutec_r3", "joints")]


@pytest.mark.parametrize(("name", "move"), MOVES)
def test_derivatives_of_targets_are_their_slopes(name: str, move: str) -> None:
    """Of positions, poses of the tool (by the columns of the rotation matrix) and joints."""
    equations = flexgen.derive(name)
    chosen = equations.model.move(move)
    if name == "manutec_r3" and move == "line":
        chosen = replace(chosen, rotation=(0.3, 0.0, 0.4))
    path = Path(equations, chosen)
    dae = InverseDae(equations, joints=chosen.type == "joint")
    t = chosen.duration * np.array([0.2, 0.45, 0.7])
    h = 1e-4
    at = dae.targets(path.sample(t), 2)
    ahead, back = (dae.targets(path.sample(t + s * h), 2) for s in (1.0, -1.0))
    slopes = (ahead - back) / (2 * h)
    size = np.abs(at).max(axis=(0, 1))
    for order in range(2):
        assert_allclose(at[:, :, order + 1], slopes[:, :, order], atol=2e-5 * size[order + 1])
    if chosen.type != "joint" and equations.model.output.type == "tool_pose":
        R = at[:, 3:, 0].reshape(-1, 3, 3)
        assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (3, 1, 1)), atol=1e-12)
        assert_allclose(R[0].T.ravel(), path.sample(t).R[0].ravel())


def test_more_derivatives_than_a_path_has_are_refused() -> None:
    equations = flexgen.derive("elbow")
    sample = Path(equations, equations.model.move("line")).sample(np.array([0.3]))
    known = sample.y.shape[2] - 1
    text = f"path: given derivatives up to order {known}, expected up to order 9"
    with pytest.raises(ArgumentError, match=text):
        InverseDae(equations).targets(sample, 9)
    with pytest.raises(
        ArgumentError, match="given derivatives none of the joints, expected up to"
    ):
        InverseDae(equations, joints=True).targets(sample, 1)
