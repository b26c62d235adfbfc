"""Distance from a path against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from flexgen.paths.geometry.path_distance import distance_from_path


def test_a_circle_and_a_line() -> None:
    angle = np.linspace(0.0, 2 * np.pi, 2001)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    points = np.random.default_rng(1).normal(size=(200, 3))
    expected = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 1.0, points[:, 2])
    # sagitta of a segment: 1.2e-6
    assert np.abs(distance_from_path(points, circle) - expected).max() < 2e-6
    line = np.linspace(0.0, 1.0, 11)[:, None] * np.array([1.0, 2.0, -2.0])
    beyond = np.array([[0.0, 0.0, 3.0], [1.0, 2.0, -5.0], [0.5, 1.0, -1.0]])
    assert distance_from_path(beyond, line) == pytest.approx([3.0, 3.0, 0.0], abs=1e-12)


def test_a_path_that_rests() -> None:
    rests = np.repeat([[0.0, 0.0], [1.0, 0.0]], 5, axis=0)
    assert distance_from_path(np.array([[0.0, 2.0], [3.0, 0.0]]), rests) == pytest.approx(
        [2.0, 2.0]
    )


def test_distances_from_a_path_are_those_from_its_chords() -> None:
    corner = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]])
    points = np.array([[-3.0, 4.0], [1.0, -0.5], [2.5, 0.5], [2.0, 3.0], [1.5, 0.75], [2.0, 0.0]])
    np.testing.assert_allclose(
        distance_from_path(points, corner), [5.0, 0.5, 0.5, 2.0, 0.5, 0.0], atol=1e-15
    )
