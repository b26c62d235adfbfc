"""Inverse kinematics near and at a wrist singularity, against forward kinematics by Lagrange's
equations.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.base.numerics.evaluate import evaluate

pytestmark = needs_compiler

UR5 = str(Path(__file__).resolve().parents[1] / "support" / "robots" / "ur5.toml")


def wrapped(x: np.ndarray) -> np.ndarray:
    return np.asarray((x + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.parametrize(
    "q5", [0.0, 1e-9, *(pytest.param(x, marks=pytest.mark.slow) for x in (1e-6, 1e-3))]
)
def test_a_configuration_near_a_wrist_singularity_is_found_once(q5):
    equations = flexgen.derive("manutec_r3")
    rng = np.random.default_rng(7)
    for q in rng.uniform(-1.5, 1.5, (12, 6)):
        q[4] = q5
        p, R = evaluate(equations.function("forward_kinematics"), q[None])
        found = flexgen.kinematics(equations.model, p.ravel(), R.reshape(3, 3))
        all_p, all_R = evaluate(
            equations.function("forward_kinematics"), np.array([c.q for c in found])
        )
        assert np.abs(all_p.reshape(-1, 3) - p.ravel()).max() < 1e-10
        assert np.abs(all_R.reshape(-1, 3, 3) - R.reshape(3, 3)).max() < 1e-10
        assert any(c.distance < 1e-3 for c in found)
        if q5:
            assert sum(np.abs(wrapped(c.q - q)).max() < 1e-5 for c in found) == 1
            assert not any(c.singular for c in found)
        else:  # a family: the sum of the fourth and sixth angle is what the pose determines
            rows = [
                np.r_[c.q[:3] - q[:3], c.q[4], c.q[3] + c.q[5] - q[3] - q[5]]
                for c in found
                if c.singular
            ]
            assert sum(np.abs(wrapped(row)).max() < 1e-6 for row in rows) == 1


# The elbow is 0.0124 rad from stretched, so that small rotations of the goal one way are out of
# reach.
STRETCHED = (
    0.759149969559,
    -0.182313203717,
    0.265140327935,
    -1.117924583519,
    0.0,
    -0.659752793832,
)


@pytest.mark.parametrize("q5", [1e-7, 1e-6])
def test_a_configuration_near_singular_wrist_and_elbow_is_found(q5):
    equations = flexgen.derive("manutec_r3")
    q = np.array(STRETCHED)
    q[4] = q5
    p, R = evaluate(equations.function("forward_kinematics"), q[None])
    found = flexgen.kinematics(equations.model, p.ravel(), R.reshape(3, 3))
    assert (
        sum(np.abs(wrapped(c.q - q)).max() < 1e-5 for c in found) == 1
        and max(c.error for c in found) < 1e-11
    )


@pytest.mark.slow
def test_configurations_that_rounding_cannot_separate_are_found_once():
    """1e-10 rad from the singular wrist: four or eight configurations, or one of a family that is
    flagged.
    """
    equations = flexgen.derive("manutec_r3")
    rng = np.random.default_rng(0)
    for q in rng.uniform(-1.5, 1.5, (12, 6)):
        q[4] = 1e-10
        p, R = evaluate(equations.function("forward_kinematics"), q[None])
        found = flexgen.kinematics(equations.model, p.ravel(), R.reshape(3, 3))
        assert len(found) in (4, 8) or any(c.singular for c in found), len(found)


# Three parallel axes before the wrist: a small rotation of the goal fixes the sum of their angles,
# and of the family of configurations only an arc is in reach.
ARCS = [
    (-0.3381, -1.8977, -0.0776, -2.25, 1e-10, -2.7236),
    (0.0819, 1.2251, -0.405, -0.5508, 1e-10, -2.0703),
    (1.5237, -0.6454, -0.1128, -1.8711, 1e-8, -1.7425),
    (-1.8641, -0.4126, -2.3539, -0.5632, 1e-10, 1.0378),
]


@pytest.mark.parametrize("q", ARCS)
def test_a_configuration_of_parallel_axes_near_a_wrist_singularity_is_found_once(q):
    equations = flexgen.derive(UR5)
    p, R = evaluate(equations.function("forward_kinematics"), np.array([q]))
    found = flexgen.kinematics(equations.model, p.ravel(), R.reshape(3, 3))
    assert sum(not c.singular for c in found) <= 8 and max(c.error for c in found) < 1e-11
    assert (
        any(c.singular for c in found)
        or sum(np.abs(wrapped(c.q - q)).max() < 1e-3 for c in found) == 1
    )
