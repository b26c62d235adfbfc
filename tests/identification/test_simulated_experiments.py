"""Simulated experiments: their spectra are those that were measured, derivatives, noise."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.motions import time_domain
from flexgen.identification.motions.time_domain import Simulated
from flexgen.identification.responses.parameters import ParameterVector


def experiment_of(hardware: DriveHardware) -> tuple[Simulated, np.ndarray]:
    """An experiment with a robot whose first spring differs, and its parameters."""
    given = {"poses": [[0.5, -0.3]], "period_s": 0.5, "lines": 6, "periods": 2, "transients": 3}
    plan = flexgen.excite("elbow", **given, hardware=hardware, progress=False)
    model = flexgen.read("elbow")
    stiffness = model.coordinates[model.i_g[0]].dof.gear.spring.stiffness
    robot = flexgen.read(
        "elbow", overrides={"element.upper.dof.q1.gear.spring.stiffness": 0.8 * stiffness}
    )
    experiment = flexgen.measure(plan, robot, progress=False)
    vector = ParameterVector(model, ["q1.stiffness", "q2.damping"], controller=plan.controller)
    return Simulated(vector, experiment, [(0, 0, 0)]), vector.start + np.array([np.log(0.8), 0.0])


@pytest.fixture(scope="module")
def quiet() -> tuple[Simulated, np.ndarray]:
    return experiment_of(DriveHardware(1e-3))


def test_the_simulated_experiment_is_the_one_that_was_measured(
    quiet: tuple[Simulated, np.ndarray],
) -> None:
    made, x = quiet
    found = made.spectra(x)
    assert found.shape == made.measured.shape == (1, 6, 2) and made.count == 12
    size = np.linalg.norm(found)
    assert np.linalg.norm(found - made.measured) < 1e-3 * size < 0.02 * size
    assert np.linalg.norm(made.spectra(x + np.array([0.1, 0.0])) - found) > 0.02 * size
    assert_allclose(made.residual(x) * made.sd, found - made.measured, rtol=1e-6, atol=1e-9 * size)
    assert made.cost(x) == pytest.approx(float((np.abs(made.residual(x)) ** 2).sum()))
    simulations = made.simulations
    made.use_noise(x)  # there is none
    assert made.simulations == simulations and not made.shift.any()


def test_derivatives_of_an_experiment_are_those_of_whole_simulations(
    quiet: tuple[Simulated, np.ndarray],
) -> None:
    """Also where their simulations begin late; they are used again where x and the cost are
    near.
    """
    made, x = quiet
    x = x + np.array([0.05, 0.1])
    cost, gradient, A = made.sums(x)
    r = made.residual(x).ravel()
    assert cost == pytest.approx(float((np.abs(r) ** 2).sum()))
    h = 1e-3
    columns = [
        (made.residual(x + z) - made.residual(x - z)).ravel() / (2 * h) for z in h * np.eye(2)
    ]
    J = np.stack(columns, axis=1)
    assert_allclose(A, np.real(J.conj().T @ J), rtol=2e-2)
    assert_allclose(gradient, np.real(J.conj().T @ r), rtol=2e-2)
    before = made.simulations
    near = made.sums(x + np.array([0.005, 0.0]))
    assert made.simulations == before + 1
    assert_allclose(near[2], A)
    made.use_whole()
    whole = made.sums(x)
    assert made.simulations == before + 4 and made.whole
    assert_allclose(whole[2], np.real(J.conj().T @ J), rtol=1e-2)
    far = made.sums(x + np.array([0.2, 0.0]))
    assert made.simulations == before + 7 and np.abs(far[2] / A - 1).max() > 1e-3


def test_noise_changes_the_mean_of_the_spectra_and_their_deviation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(time_domain, "SEEDS", 3)
    made, x = experiment_of(DriveHardware(1e-3, encoder_noise_rad=2e-4))
    told: list[str] = []
    made.progress = told.append
    sd = made.sd.copy()
    made.use_noise(x)
    assert told == ["change of the motion by noise: 3 simulations"]
    assert_allclose(made.sd, sd * np.sqrt(1 + 2 / 3))
    noisy = [made.spectra(x, noise=time_domain.SEED + k) for k in range(3)]
    assert_allclose(made.shift, np.mean(noisy, axis=0) - made.spectra(x), rtol=1e-6, atol=1e-12)
    assert np.abs(noisy[0] - noisy[1]).max() > 0
    made.sums(x)
    assert (
        told[-1].startswith("simulation ")
        and told[-1].endswith(" s of robot in the plan")
        and len(told) == 3
    )
