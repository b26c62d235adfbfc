"""Identified numbers that the data do not determine: by their standard deviation, or hidden by a
Coulomb friction.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identification_cases import exact_responses, poses_of

import flexgen
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.result import (
    TIME_DOMAIN,
    WEAK,
    IdentificationResult,
)

NAMES = ("q1.stiffness", "m1.viscous")


@pytest.fixture(scope="module")
def found() -> IdentificationResult:
    """Of a robot whose motor has Coulomb friction."""
    coulomb = {"motor.m1.friction": {"viscous": 0.01, "coulomb": 0.02, "beta": 3.0}}
    robot = flexgen.read("elbow", overrides=coulomb)
    data = exact_responses(robot, poses_of(robot, 2), 2 * np.pi * np.geomspace(2, 80, 15), Drive())
    return flexgen.identify(robot, data, free=NAMES, starts=1, progress=False)


@pytest.mark.parametrize(
    ("weights", "share", "weak"),
    [
        ("noise", 0.9, (False, True)),
        ("noise", 1.1, (True, True)),
        (TIME_DOMAIN, 0.9, (False, False)),
        (TIME_DOMAIN, 1.1, (True, True)),
    ],
)
def test_weak_numbers(
    found: IdentificationResult, weights: str, share: float, weak: tuple[bool, bool]
) -> None:
    """The viscous friction next to a Coulomb friction is hidden in frequency responses only."""
    sd = share * WEAK
    given = replace(found, weights=weights, formal_covariance=sd**2 * np.eye(2))
    assert tuple(given.is_weak(name) for name in NAMES) == weak
