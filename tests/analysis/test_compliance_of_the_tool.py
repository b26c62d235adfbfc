"""Compliance of a tool on two springs: matrix, principal directions and resonance in closed
form.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.analysis.compliance import ToolCompliance

M = 2.0  # kg
D = 0.4  # N s/m
K = np.array([800.0, 200.0])  # N/m
DIRECTIONS = np.array([[0.6, 0.8], [0.8, -0.6]])  # of the springs, rows x and z


@pytest.fixture
def two() -> ToolCompliance:
    J = np.zeros((6, 2))
    J[[0, 2]] = DIRECTIONS
    J[4, 0] = 1.0
    return ToolCompliance(np.diag([M, M]), np.diag([D, D]), np.diag(K), J)


def test_a_force_moves_the_tool_by_the_sum_of_both_springs(two: ToolCompliance) -> None:
    """Principal directions are those of the springs, the softer one first; a moment turns it by
    one of them.
    """
    expected = sum(np.outer(d, d) / k for d, k in zip(DIRECTIONS.T, K, strict=True))
    assert_allclose(two.matrix[:3:2, :3:2], expected)
    values, directions = two.principal()
    assert_allclose(values, [1 / 200, 1 / 800, 0.0], atol=1e-15)
    assert_allclose(directions[:2], [[0.8, 0.0, -0.6], [0.6, 0.0, 0.8]], atol=1e-12)
    assert_allclose(two.principal(rotation=True)[0], [1 / 800, 0.0, 0.0], atol=1e-15)


def test_the_response_and_its_resonance_are_those_of_a_damped_mass(two: ToolCompliance) -> None:
    w = 10.0
    found = two.response(np.array([w / (2 * np.pi)]))[0, 4, 4]
    assert abs(found) == pytest.approx(1 / abs(800 - M * w**2 + 1j * D * w))
    peak = two.resonance()
    assert peak is not None
    natural = np.sqrt(200 / M)
    ratio = D / (2 * np.sqrt(M * 200.0))
    assert peak[0] == pytest.approx(natural * np.sqrt(1 - 2 * ratio**2) / (2 * np.pi), rel=1e-3)
    assert peak[1] == pytest.approx(1 / 200 / (2 * ratio * np.sqrt(1 - ratio**2)), rel=1e-3)
    ends = two.frequencies[[0, -1]] * 2 * np.pi
    assert ends[0] < natural / 5 and ends[1] > 2 * np.sqrt(800 / M)
    assert two.to_dict()["resonance_m_per_N"] == peak[1]


def test_a_stiff_arm_has_no_resonance() -> None:
    none = np.zeros((0, 0))
    stiff = ToolCompliance(none, none, none, np.zeros((6, 0)))
    assert stiff.resonance() is None and not stiff.matrix.any()
    assert stiff.to_dict()["resonance_hz"] is None
