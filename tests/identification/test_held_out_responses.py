"""Responses that `identify` does not fit: what the model leaves of them, and the status."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identification_cases import exact_responses, poses_of, without_coulomb

import flexgen
from flexgen.dynamics.mechanics.parameters import with_values
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.response_inputs import Drive

W = 2 * np.pi * np.geomspace(1.0, 120.0, 20)
ROBOT = without_coulomb("planar5_nmp")


def measured(stiffness: float, seed: int) -> Frf:
    """Responses at other poses for each seed, with noise of 0.1 %."""
    plant = with_values(ROBOT, {"q1.stiffness": stiffness})
    data = exact_responses(plant, poses_of(ROBOT, 2, seed), W, Drive(0.0))
    noise = np.random.default_rng(seed).standard_normal((2, *data.G.shape)) / np.sqrt(2)
    return replace(data, G=data.G + np.sqrt(data.variance) * (noise[0] + 1j * noise[1]))


def fit(*held: Frf) -> flexgen.IdentificationResult:
    """The fit of one stiffness to the first responses."""
    return flexgen.identify(
        ROBOT, measured(3.5e5, 0), free=["q1.stiffness"], validate=held, starts=1, progress=False
    )


def test_the_same_robot_at_other_poses_is_explained():
    found = fit(measured(3.5e5, 1))
    assert found.status == "fitted" and found.held_out == (0.0,)
    assert "misfit of responses 1, not fitted" in found.to_text()
    assert found.to_dict()["held_out"] == [0.0]


def test_another_robot_is_poorly_validated():
    """The part that is left is the difference of the responses themselves, over their size."""
    other = measured(2.8e5, 1)
    found = fit(measured(3.5e5, 2), other)
    assert found.status == "poorly validated" and set(found.sd.values()) == {None}
    first = exact_responses(
        with_values(ROBOT, {"q1.stiffness": 3.5e5}), poses_of(ROBOT, 2, 1), W, Drive(0.0)
    ).G
    apart = np.abs(other.G - first) ** 2 / other.variance
    whole = np.abs(other.G) ** 2 / other.variance
    parts = np.sqrt(apart.sum(axis=(0, 1)) / whole.sum(axis=(0, 1)))
    assert found.held_out[0] == 0.0
    assert found.held_out[1] == pytest.approx(parts.max(), rel=0.02)


def test_responses_of_another_robot_are_refused():
    with pytest.raises(flexgen.ArgumentError, match="validate: given the motors"):
        fit(replace(measured(3.5e5, 1), motors=("a", "b")))
