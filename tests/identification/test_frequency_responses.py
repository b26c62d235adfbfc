"""Frequency responses of simulated experiments: those of the linear model, with the noise that was
predicted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identification_cases import NOISY, another, poses_of, small_plan, without_coulomb
from measured_numbers import check_numbers
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.experiments.operating_points import noise_covariance
from flexgen.identification.responses.frequency_response import coherence
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.response_inputs import Drive

pytestmark = needs_compiler

PLAIN = DriveHardware(5e-4)


def differences(name: str, drive: Drive, hardware: DriveHardware = PLAIN) -> np.ndarray:
    """Relative differences of the diagonal between experiment and linear model, without noise."""
    model = without_coulomb(name)
    plan = small_plan(
        model, poses_of(model, 3), speed_rms=0.005, transients=2, hardware=hardware, period_s=4.0
    )
    data = flexgen.frf(flexgen.measure(plan, model, progress=False))
    local = LocalModel(model, ())
    G = local.response(local.values, data.poses, data.w, drive, derivatives=False).G
    return np.abs(np.einsum("klaa->kla", data.G / G) - 1)


@pytest.mark.parametrize(
    "name", ["planar5_nmp", pytest.param("manutec_r3_18", marks=pytest.mark.slow)]
)
def test_an_experiment_without_noise_gives_the_linear_model(name):
    found = differences(name, Drive(5e-4))
    assert np.median(found) < 1e-4 and found.max() < 2e-3
    for wrong in (Drive(0.0), Drive(5e-4, 2.5e-4)):
        assert np.median(differences(name, wrong)) > 1e-2  # hold or delay left out


@pytest.mark.parametrize("delay", [2e-4, 1.05e-3])
def test_a_delay_is_the_delay_of_the_drive(delay):
    """Also one of 2.1 samples."""
    hardware = DriveHardware(5e-4, delay_s=delay)
    assert differences("planar5_nmp", Drive(5e-4, delay), hardware).max() < 2e-3
    assert differences("planar5_nmp", Drive(5e-4, delay - 1e-5), hardware).max() > 5e-3


@pytest.mark.slow
def test_the_noise_is_the_one_predicted():
    """Covariances of the errors, and the scatter of repeated experiments."""
    model = without_coulomb("planar5_nmp")
    plan = small_plan(
        model, poses_of(model, 2), hardware=NOISY, periods=8, period_s=4.0, speed_rms=0.05
    )
    measured = [flexgen.measure(plan, model, seed=seed, progress=False) for seed in range(8)]
    # noise from the periods
    runs = [flexgen.frf(replace(x, offsets=None, beside=None)) for x in measured]
    found = np.mean([np.real(np.einsum("klaa->kla", run.C)) for run in runs], axis=0)
    local = LocalModel(model, ())
    G = local.response(local.values, plan.poses, runs[0].w, Drive(5e-4), derivatives=False).G
    expected = np.array(
        [np.real(np.einsum("laa->la", noise_covariance(g, runs[0].w, plan, model))) for g in G]
    )
    ratio = found / expected
    assert 0.9 < np.median(ratio) < 1.15
    scatter = np.var([run.G for run in runs], axis=0, ddof=1)
    claimed = np.mean([run.variance for run in runs], axis=0)
    assert 0.8 < np.median(scatter / claimed) < 1.25  # 480 variances of eight numbers each
    wrong = claimed * plan.periods  # the variance of one period for that of the mean
    assert not 0.8 < np.median(scatter / wrong) < 1.25


@pytest.mark.slow
def test_averages_of_realizations_agree_and_show_distortion():
    model = flexgen.read("manutec_r3")
    plan = small_plan(model, poses_of(model, 1), realizations=4, speed_rms=0.02, lines=12)
    experiment = flexgen.measure(plan, model, progress=False)
    means = {
        name: flexgen.frf(experiment, average=name)
        for name in ("arithmetic", "harmonic", "logarithmic")
    }
    first = means["arithmetic"]
    assert first.total is not None
    for other in means.values():
        away = np.abs(np.einsum("klaa->kla", other.G / first.G) - 1)
        assert np.median(away) < 0.05
    # friction changes the responses from realization to realization; the noise-free experiment has
    # no other scatter
    assert np.median(np.sqrt(first.total) / np.abs(first.G)) > 10 * first.relative_sd()


def test_the_coherence_falls_with_noise():
    model = without_coulomb("planar5_nmp")
    values = []
    for noise in (1e-6, 1e-3):
        plan = small_plan(
            model, poses_of(model, 1), hardware=replace(NOISY, encoder_noise_rad=noise), periods=4
        )
        values.append(coherence(flexgen.measure(plan, model, progress=False)))
    assert np.all(values[0] <= 1) and np.median(values[0]) > 0.99
    check_numbers("coherence", values=values)
    assert np.median(1 - values[1]) > 2 * np.median(1 - values[0])


# --- what is refused -----------------------------------------------------------------------------
@pytest.fixture(scope="module")
def experiment():
    model = without_coulomb("planar5_nmp")
    return flexgen.measure(
        small_plan(model, poses_of(model, 1), periods=4, hardware=NOISY), model, progress=False
    )


def test_saturated_motors_are_refused(experiment):
    with pytest.raises(
        ArgumentError, match=r"torques were at their limits at the poses 1; .* take less speed_rms"
    ):
        flexgen.frf(replace(experiment, saturated=np.array([3])))


def test_a_period_that_does_not_repeat_is_named(experiment):
    q = experiment.q_m.copy()
    q[0, 0, 1, 2] *= 1.5
    with pytest.raises(
        ArgumentError, match=r"pose 1, realization 1, experiment 2: period 3 differs"
    ):
        flexgen.frf(replace(experiment, q_m=q))


def test_inputs_that_are_not_independent_are_refused(experiment):
    tau = experiment.tau_m.copy()
    tau[:, :, 1] = tau[:, :, 0]
    with pytest.raises(SolverError, match="not independent: expected at least 2 experiments"):
        flexgen.frf(replace(experiment, tau_m=tau, offsets=None, beside=None))


def test_a_robot_with_other_motors_is_refused(experiment):
    with pytest.raises(ArgumentError, match=r"truth: given the motors .* expected m1, m2"):
        flexgen.measure(experiment.plan, "manutec_r3", progress=False)


def test_a_model_that_changed_since_the_plan_is_not_simulated_silently():
    """The plan names a file; this model was changed in memory."""
    plan = small_plan(
        another(without_coulomb("planar5_nmp"), 1), poses_of(without_coulomb("planar5_nmp"), 1)
    )
    with pytest.raises(ArgumentError, match="is another model than the one of the plan"):
        flexgen.measure(plan, progress=False)


def test_files_come_back_as_they_were(experiment, tmp_path):
    experiment.plan.save(tmp_path / "plan.npz")
    again = flexgen.Plan.load(tmp_path / "plan.npz")
    assert (
        np.array_equal(again.reference(0, 1), experiment.plan.reference(0, 1)) and again.predicted
    )
    assert again.hardware == experiment.plan.hardware and hash(again.hardware) == hash(
        experiment.plan.hardware
    )
    other = flexgen.measure(again, another(without_coulomb("planar5_nmp"), 1), progress=False)
    experiment.save(tmp_path / "data.npz")
    assert np.array_equal(flexgen.Experiment.load(tmp_path / "data.npz").tau_m, experiment.tau_m)
    data = flexgen.frf(other)
    data.save(tmp_path / "frf.npz")
    back = flexgen.Frf.load(tmp_path / "frf.npz")
    assert all(
        np.array_equal(getattr(back, name), getattr(data, name))
        for name in ("G", "C", "UU", "w", "poses")
    )
    with pytest.raises(ArgumentError, match="given a file with 'frf', expected the kind 'plan'"):
        flexgen.Plan.load(tmp_path / "frf.npz")
    with pytest.raises(ArgumentError, match="cannot be read"):
        flexgen.Frf.load(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(ArgumentError, match=r"frf .*text\.npz"):
        flexgen.Frf.load(tmp_path / "text.npz")
