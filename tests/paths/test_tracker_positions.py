"""Positions of trackers: the closed form of the elbow, and the sag of its springs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError

L1 = 1.15  # m
L2 = 1.241
Q = np.array([[0.3, -0.4], [0.1, 0.7]])


def closed_form(q: np.ndarray) -> np.ndarray:
    """``x = l1 sin q1 + l2 cos(q1 + q2)``, ``z = l1 cos q1 - l2 sin(q1 + q2)``."""
    total = q.sum(axis=1)
    x = L1 * np.sin(q[:, 0]) + L2 * np.cos(total)
    z = L1 * np.cos(q[:, 0]) - L2 * np.sin(total)
    return np.stack([x, z], axis=1)


def test_trackers_without_sag_are_those_of_the_arm() -> None:
    found = flexgen.tracker_positions("elbow", Q, sag=False)
    assert found.shape == (2, 1, 3)
    assert_allclose(found[:, 0, [0, 2]], closed_form(Q))


def test_springs_carry_the_arm() -> None:
    """Joints are ``q - K^-1 g`` of the joints themselves, found by many small corrections."""
    equations = flexgen.derive("elbow")
    gears: list[Any] = [element.dofs[0].gear for element in equations.model.elements]
    k = np.array([gear.spring.stiffness for gear in gears])
    joints = Q.copy()
    for _ in range(60):
        g = np.array([np.array(equations.function("gravity")(q)).ravel() for q in joints])
        joints = Q - g / k
    found = flexgen.tracker_positions(equations, Q)[:, 0, [0, 2]]
    assert_allclose(found, closed_form(joints), atol=1e-12)
    assert np.abs(found - closed_form(Q)).max() > 1e-4


@pytest.mark.parametrize(
    ("commands", "text"),
    [
        ([[0.1]], r"given shape \(1, 1\), expected finite numbers of shape \(N, 2\)"),
        ([[0.1, np.nan]], "given .*, expected an array of numbers without nan"),
        ([[0.1], [0.1, 2]], "given .*rows of the same length"),
    ],
)
def test_commands_that_do_not_fit_are_refused(commands: Any, text: str) -> None:
    with pytest.raises(ArgumentError, match=f"commands: {text}"):
        flexgen.tracker_positions("elbow", commands)
