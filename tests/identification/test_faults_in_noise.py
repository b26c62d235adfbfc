"""A fault of one channel is a model error, also where noise hides most of it, or most elements of
the responses.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identification_cases import another, exact_responses, poses_of, small_plan, without_coulomb

import flexgen
from flexgen.dynamics.mechanics.parameters import select, with_values
from flexgen.identification.causes import explain
from flexgen.identification.experiments.experiment import Experiment
from flexgen.identification.responses import residuals
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.result import FitStatus
from flexgen.identification.rigid.missing_springs import without

W = 2 * np.pi * np.geomspace(1.0, 80.0, 30)
NOISE = np.array([[0.01, 3.0], [3.0, 0.01]])  # of each response, over its size
DRIVES = flexgen.DriveHardware(encoder_noise_rad=1e-4, torque_noise_Nm=0.02)
FAULT = 1.01
DEGREES = 180 / np.pi


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1.0, None),
        pytest.param(1.1, "angle of m2 9.8 % too large", marks=pytest.mark.slow),
        (DEGREES, "angle of m2 in degrees, read as radians,"),
    ],
)
def test_where_noise_hides_all_but_one_response_its_fault_counts(factor, words):
    """The median over all elements of what noise does not explain is zero."""
    robot = without_coulomb("planar5_nmp")
    rng = np.random.default_rng(2)
    data = exact_responses(another(robot, 1, 0.1), poses_of(robot, 3), W, Drive(5e-4))
    sd = NOISE * np.abs(data.G)
    x, y = rng.standard_normal((2, *data.G.shape)) / np.sqrt(2)
    G = (data.G + sd * (x + 1j * y)) * np.array([[1.0], [factor]])
    data = replace(data, G=G, variance=(sd * np.array([[1.0], [factor]])) ** 2)
    found = flexgen.identify(robot, data, starts=1, progress=False)
    assert found.status == (FitStatus.MODEL_ERROR if words else FitStatus.FITTED)
    assert (
        any(cause.words.startswith(words) for cause in found.causes)
        if words
        else found.causes == ()
    )


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    robot = without_coulomb("planar5_nmp")
    plan = small_plan(
        robot, poses_of(robot, 2), lines=20, period_s=1.0, periods=4, hardware=DRIVES
    )
    return flexgen.measure(plan, another(robot, 1, 0.15), seed=1, progress=False)


def fitted(experiment: Experiment, factor: float) -> flexgen.IdentificationResult:
    """The fit where the file has the first torque too large."""
    data = flexgen.frf(
        replace(experiment, tau_m=experiment.tau_m * [factor, 1.0], offsets=None, beside=None)
    )
    return flexgen.identify(without_coulomb("planar5_nmp"), data, starts=1, progress=False)


@pytest.mark.slow
def test_a_fault_that_noise_of_single_elements_covers_is_seen_by_its_structure(
    experiment, monkeypatch
):
    """Torques 1 % wrong move a stiffness by four standard deviations; planted: nothing is sure
    enough.
    """
    assert fitted(experiment, 1.0).status == FitStatus.FITTED
    found = fitted(experiment, FAULT)
    assert found.status == FitStatus.MODEL_ERROR and set(found.sd.values()) == {None}
    assert found.causes[0].words == "torque of m1 1 % too large in the record"
    monkeypatch.setattr(residuals, "SURE", 1e9)
    monkeypatch.setattr(residuals, "SURE_ALONE", 1e9)
    monkeypatch.setattr(explain, "SEEN", np.inf)
    assert fitted(experiment, FAULT).status == FitStatus.FITTED


def test_a_missing_spring_that_noise_covers_is_seen_by_its_own_test(monkeypatch):
    """The cost is that of noise, and a number is off by three deviations; planted: no decrease is
    large enough.
    """
    robot = without_coulomb("planar5_nmp")
    (spring,) = (p for p in select(robot, ["stiffness"]) if p.name == "q3.stiffness")
    truth = with_values(robot, {spring.name: 16.0 * spring.value})
    data = exact_responses(truth, poses_of(robot, 3), W, Drive(5e-4))
    sd = 6e-3 * np.abs(data.G)
    x, y = np.random.default_rng(2).standard_normal((2, *data.G.shape)) / np.sqrt(2)
    data = replace(data, G=data.G + sd * (x + 1j * y), variance=sd**2)
    found = flexgen.identify(without(robot, "q3"), data, starts=1, progress=False)
    assert found.status is FitStatus.MODEL_ERROR and found.model_error == 0.0 and found.cost < 1.2
    assert found.causes[0].words.startswith("a missing spring arm3_z of")
    assert found.causes[0].size == pytest.approx(16.0 * spring.value, rel=0.2)
    monkeypatch.setattr(explain, "SEEN", np.inf)
    found = flexgen.identify(without(robot, "q3"), data, starts=1, progress=False)
    true = {p.name: p.value for p in select(truth, list(found.vector.names))}
    errors = [np.log(found.values[name] / true[name]) / sd for name, sd in found.sd.items() if sd]
    assert found.status is FitStatus.FITTED and np.abs(errors).max() > 3
