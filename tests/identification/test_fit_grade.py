"""The grade of an identification: errors of the feedforward against closed forms.

Planted errors show that each law catches one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identification_cases import exact_responses, poses_of

import flexgen
from flexgen.identification.estimator.fit_grade import grade
from flexgen.identification.responses.response_inputs import Drive

W = 2 * np.pi * np.geomspace(0.5, 60.0, 30)
# rad/s^2 of a motor with rotor J and load behind a spring, the closed form below
J = 4e-3
LOAD = 1e-2
STIFFNESS = 30.0
DAMPING = 0.02


def two_masses(load: float, w: np.ndarray) -> np.ndarray:
    """Motor acceleration over torque of two masses with a spring, as in a textbook."""
    s = 1j * w
    spring = DAMPING * s + STIFFNESS
    return (
        s**2 * (load * s**2 + spring) / ((J * s**2 + spring) * (load * s**2 + spring) - spring**2)
    )


def responses(G: np.ndarray, w: np.ndarray, like: flexgen.Frf) -> flexgen.Frf:
    """One pose, one motor."""
    each = G[None, :, None, None]
    ones = np.ones_like(each)
    return replace(
        like, motors=("m",), poses=np.zeros((1, 1)), w=w, G=each, UU=ones + 0j, C=ones + 0j,
        variance=0 * ones.real, speed_sd=np.zeros((1, 1)), total=None,
    )  # fmt: skip


@pytest.fixture(scope="module")
def measured() -> flexgen.Frf:
    robot = flexgen.read("planar5_nmp")
    return exact_responses(robot, poses_of(robot, 1), W, Drive(5e-4))


@pytest.mark.parametrize("factor", [0.5, 0.9, 1.0, 1.3, 3.0])
def test_the_error_below_the_resonance_is_that_of_the_whole_inertia(
    measured: flexgen.Frf, factor: float
) -> None:
    """Far below the resonance torques are (J + load) a: e = load (factor - 1)/(J + load)."""
    locked = float(np.sqrt(STIFFNESS / LOAD) / (2 * np.pi))
    w = 2 * np.pi * locked * np.geomspace(0.02, 0.1, 12)
    data = responses(two_masses(LOAD, w), w, measured)
    found = grade(data, two_masses(factor * LOAD, w)[None, :, None, None], locked)
    expected = abs(LOAD * (factor - 1.0)) / (J + LOAD)
    assert [band.name for band in found.bands] == ["below"]
    assert found.bands[0].torque_error == pytest.approx(expected, rel=0.03, abs=1e-12)
    assert found.good == (expected <= 0.15)


def test_nonsense_reads_otherwise_than_a_missing_friction(measured: flexgen.Frf) -> None:
    """Responses of the other sign are twice as wrong as no feedforward.

    A tenth of the inertia is good enough.
    """
    right = measured.G
    near = grade(measured, right / 1.1, 9.0)
    assert near.good and "good enough for feedforward: yes" in near.sentence
    wrong = grade(measured, -right, 9.0)
    assert not wrong.good and wrong.bands[0].torque_error == pytest.approx(2.0)
    assert "more than without feedforward" in wrong.sentence
    useless = grade(measured, right * 1e9, 9.0)
    assert useless.bands[0].torque_error == pytest.approx(1.0, rel=1e-6) and not useless.good


def test_elements_that_carry_no_torque_do_not_decide(measured: flexgen.Frf) -> None:
    """A motor that was not moved may have any misfit; its element is named."""
    UU = measured.UU.copy()
    UU[:, :, 1] *= 1e-12
    UU[:, :, :, 1] *= 1e-12
    G = np.linalg.inv(measured.G[:, :, :2])
    G[:, :, 0, 1] *= 1.5  # torque of the first motor for the second, which is not moved
    wrong = np.linalg.inv(G)
    still = grade(replace(measured, UU=UU), wrong, 9.0)
    moved = grade(measured, wrong, 9.0)
    assert still.worst[3] > 0.5 and still.good
    assert still.bands[0].torque_error < 0.05 < 0.2 < moved.bands[0].torque_error


def test_a_planted_error_of_the_sign_is_seen(measured: flexgen.Frf) -> None:
    """Of G + I in place of G - I the right model would have the error 2."""
    found = grade(measured, measured.G, 9.0)
    assert found.bands[0].torque_error < 1e-12 and found.good
