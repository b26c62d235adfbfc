"""Frequency responses from motions that have not settled, that are averaged by H1, and that have
no period.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification_cases import NOISY, poses_of, without_coulomb
from measured_numbers import check_numbers

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.experiments.experiment import Experiment
from flexgen.identification.records.experiment_file import read_experiment
from flexgen.identification.records.recording_writer import RecordingWriter
from flexgen.identification.responses import frequency_response, response_estimates, spectra
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.spectra import (
    line_offsets,
    spectra_beside,
    without_transients,
)

ROOT = Path(__file__).parents[2]
LEFT_OUT = "a transient is in the first of 4 periods; it is left out"
REMAINS = "a transient remains: in the motion of m1; leave out more transient periods"


def unsettled(
    hardware: DriveHardware, periods: int = 4, seed: int = 0
) -> tuple[Experiment, np.ndarray]:
    """An experiment that begins with its first period, and the responses of the settled robot
    without noise.
    """
    model = without_coulomb("planar5_nmp")
    plan = flexgen.excite(
        model,
        poses=poses_of(model, 1),
        speed_rms=0.005,
        f_max=100.0,
        hardware=hardware,
        periods=periods,
        transients=0,
    )
    quiet = replace(plan, transients=3, hardware=DriveHardware(hardware.sample_s))
    return flexgen.measure(plan, model, beside=True, seed=seed), flexgen.frf(
        flexgen.measure(quiet, model)
    ).G


def test_transients_are_removed() -> None:
    """The remaining error is below one percent of the error without the removal, which is the
    default.
    """
    experiment, truth = unsettled(DriveHardware(5e-4))
    experiment = replace(experiment, beside_later=None)  # all periods
    removed = np.abs(flexgen.frf(experiment, transients=True).G - truth)
    with_transients = flexgen.frf(replace(experiment, offsets=None, beside=None))
    check_numbers(
        "transients", removed=flexgen.frf(experiment, transients=True), kept=with_transients
    )
    assert any("period 1 differs from the others" in line for line in with_transients.warnings)
    assert np.array_equal(flexgen.frf(experiment).G, flexgen.frf(experiment, transients=True).G)
    left = np.abs(with_transients.G - truth)
    assert np.median(left / np.abs(truth)) > 1e-3, "there must be a transient to remove"
    assert np.sqrt((removed**2).sum() / (left**2).sum()) < 0.01
    assert np.median(removed / left) < 0.01


def test_a_transient_that_decays_in_a_period_is_left_out_and_a_slower_one_is_stated() -> None:
    """Masses come to rest in one or two periods of 2 s, not of 0.5 s."""
    quiet = DriveHardware(5e-4, encoder_noise_rad=1e-5, torque_noise_Nm=0.002)
    for period, settled, lines in (
        (2.0, 1, [LEFT_OUT]),
        (2.0, 2, []),
        (0.5, 1, [LEFT_OUT, REMAINS]),
        (0.5, 20, []),
    ):
        plan = flexgen.excite(
            "four_mass", poses=[[0.0]], period_s=period, lines=40, speed_rms=0.02, hardware=quiet
        )
        experiment = flexgen.measure(replace(plan, transients=settled), progress=False)
        assert experiment.beside is not None and experiment.beside_later is not None
        for transients in (False, True):
            found = flexgen.frf(experiment, transients=transients)
            assert [x for x in found.warnings if "transient" in x and "differs" not in x] == lines
            assert found.periods == 4 - len(lines[:1])


def test_polynomials_leave_a_part_of_a_narrow_transient_and_the_later_periods_have_none() -> None:
    """Of a robot after one period of 1 s, in deviations of the noise, against responses of the
    settled robot.
    """
    model = without_coulomb("elbow")
    noisy = DriveHardware(5e-4, encoder_noise_rad=1e-5, torque_noise_Nm=0.02)
    plan = flexgen.excite(model, poses=4, lines=40, period_s=1.0, speed_rms=0.03, hardware=noisy)
    quiet = replace(plan, hardware=DriveHardware(5e-4))
    sd = np.sqrt(flexgen.frf(flexgen.measure(plan)).variance)
    moving = flexgen.measure(quiet)
    settled = flexgen.frf(flexgen.measure(replace(quiet, transients=30))).G
    later, all_periods = (flexgen.frf(x) for x in (moving, replace(moving, beside_later=None)))
    left = [
        np.sqrt((np.abs((x.G - settled) / sd) ** 2).mean(axis=(0, 2, 3)).max())
        for x in (later, all_periods)
    ]
    assert later.warnings == (LEFT_OUT,) and left[0] < 0.05 and left[1] > 0.2


@pytest.mark.slow
def test_a_removal_with_the_wrong_sign_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, truth = unsettled(DriveHardware(5e-4))
    # in the later periods there is little to remove
    experiment = replace(experiment, beside_later=None)
    real = spectra.without_transients
    monkeypatch.setattr(
        frequency_response,
        "without_transients",
        lambda lines, beside, at: real(lines, -beside, at),
    )
    wrong = np.abs(flexgen.frf(experiment, transients=True).G - truth)
    assert np.median(wrong / np.abs(truth)) > 1e-3


@pytest.mark.slow
def test_the_noise_beside_the_lines_is_that_at_the_lines() -> None:
    """Errors over predicted deviations: mean square 1, as of a settled experiment with as many
    periods.
    """
    squares = []
    for seed in range(6):
        experiment, truth = unsettled(NOISY, seed=seed)
        found = flexgen.frf(experiment, transients=True)
        squares.append(np.abs(found.G - truth) ** 2 / found.variance)
    assert 0.8 < np.mean(squares) < 1.2


def test_spectra_beside_the_lines_are_those_of_the_whole_record() -> None:
    rng = np.random.default_rng(0)
    N = 128
    P = 3
    lines = np.array([3, 5, 11])
    x = rng.normal(size=(P, N, 2))
    offsets = line_offsets(lines, P)
    summed = sum(spectra_beside(x[p], lines, offsets, p, P) for p in range(P))
    whole = 2 / (P * N) * np.fft.fft(x.reshape(P * N, 2), axis=0)
    assert np.allclose(summed, whole[P * lines[None] + offsets[:, None]], rtol=0, atol=1e-14)
    assert not set((P * lines[None] + offsets[:, None]).ravel().tolist()) & set(
        (P * lines).tolist()
    )


def test_a_quadratic_transient_is_removed_exactly() -> None:
    offsets = np.array([-4, -3, -2, -1, 1, 2, 3, 4])
    transient = 2.0 - 0.3j + (0.1 + 0.2j) * offsets + 0.05 * offsets**2
    found = without_transients(
        np.full((1, 1), 7.0 + 2.0 - 0.3j), transient[:, None, None], offsets
    )
    assert found.lines[0, 0] == pytest.approx(7.0, abs=1e-13) and np.abs(found.noise).max() < 1e-13
    assert found.freedom == 5


def test_too_few_periods_for_a_polynomial_are_refused() -> None:
    with pytest.raises(ArgumentError, match="measure more periods"):
        line_offsets(np.array([1, 2, 3]), 2)
    model = without_coulomb("planar5_nmp")
    plan = flexgen.excite(model, poses=poses_of(model, 1), speed_rms=0.005, f_max=100.0)
    plan = replace(plan, lines=np.arange(1, 1 + len(plan.lines)), periods=2)
    with pytest.raises(ArgumentError, match="measure more periods"):
        flexgen.measure(plan, model, beside=True)
    with pytest.raises(ArgumentError, match="no spectra beside the lines"):
        flexgen.frf(flexgen.measure(plan, model), transients=True)


@pytest.mark.slow
def test_h1_without_noise_is_the_mean() -> None:
    model = without_coulomb("planar5_nmp")
    plan = flexgen.excite(
        model, poses=poses_of(model, 2), speed_rms=0.005, f_max=100.0, realizations=2
    )
    # noise from the periods in both
    experiment = replace(flexgen.measure(plan, model), offsets=None, beside=None)
    mean, h1 = (flexgen.frf(experiment, average=name) for name in ("arithmetic", "h1"))
    assert np.abs(mean.G - h1.G).max() < 1e-6 * np.abs(mean.G).max()
    assert np.median(h1.variance / mean.variance) == pytest.approx(1.0, rel=0.05)


def test_torque_noise_makes_h1_too_small() -> None:
    """H1 = G S_uu / (S_uu + S_nn) where the noise of the recorded torques n does not move the
    robot.
    """
    rng = np.random.default_rng(1)
    shape = (1, 1, 64, 1, 1, 1)
    U = np.ones(shape) + 0j
    Y = 2.0 * U
    noisy = U + 0.5 * (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)
    assert abs(response_estimates.estimate(noisy, Y, "h1").G.item()) == pytest.approx(
        2 / 1.25, rel=0.15
    )
    assert abs(response_estimates.estimate(noisy, Y).G.item()) == pytest.approx(2.0, rel=0.15)


def recorded_without_period(folder: Path) -> tuple[Path, LocalModel]:
    """A recording of `four_mass` under random torques, exact samples of the linear response."""
    model = without_coulomb("four_mass")
    local = LocalModel(model, ())
    n = 2**17
    T = 1e-3
    w = 2 * np.pi * np.fft.rfftfreq(n, T)
    rng = np.random.default_rng(2)
    U = np.fft.rfft(rng.normal(size=n)) * (w > 2 * np.pi * 0.5) * (w < 2 * np.pi * 150)
    G = np.zeros(len(w), complex)
    G[1:] = local.response(local.values, np.zeros((1, 1)), w[1:], Drive(), derivatives=False).G[
        0, :, 0, 0
    ]
    G[1:] /= -(w[1:] ** 2)
    noise = 1e-7 * rng.normal(size=n)
    np.savez(
        folder / "run.npz",
        t=T * np.arange(n),
        u=np.fft.irfft(U, n),
        q=np.fft.irfft(G * U, n) + noise,
    )
    text = f"""
model = {json.dumps(str(ROOT / "models" / "four_mass.toml"))}
segment_s = 8.192
hold = "none"
lines = "all"
f_min = 2.0
f_max = 60.0
[time]
name = "t"
unit = "s"
[[torque]]
motor = "m1"
name = "u"
unit = "N m"
side = "motor"
[[angle]]
motor = "m1"
name = "q"
unit = "rad"
side = "motor"
[[recording]]
file = "run.npz"
pose_rad = [0.0]
"""
    path = folder / "run.toml"
    path.write_text(text)
    return path, local


def test_a_motion_without_period_is_estimated_with_a_warning(tmp_path: Path) -> None:
    path, local = recorded_without_period(tmp_path)
    found = flexgen.frf(read_experiment(path))
    assert any("not periodic" in line for line in found.warnings)
    truth = local.response(local.values, np.zeros((1, 1)), found.w, Drive(), derivatives=False).G
    error = np.abs(found.G - truth) / np.abs(truth)
    assert np.median(error) < 0.02, "leakage of a Hann window, 31 segments"
    assert np.quantile(error, 0.9) < 0.15


@pytest.mark.slow
def test_recordings_keep_the_spectra_beside_the_lines(tmp_path: Path) -> None:
    model = without_coulomb("planar5_nmp")
    plan = flexgen.excite(
        model,
        poses=poses_of(model, 1),
        speed_rms=0.005,
        f_max=100.0,
        hardware=NOISY,
        periods=4,
        transients=0,
    )
    writer = RecordingWriter(tmp_path / "raw", plan, model)
    experiment = flexgen.measure(plan, model, beside=True, raw=writer)
    again = read_experiment(writer.finish())
    assert again.offsets is not None and (again.offsets == experiment.offsets).all()
    first, second = (flexgen.frf(x, transients=True) for x in (experiment, again))
    assert np.abs(first.G - second.G).max() < 1e-9 * np.abs(first.G).max()
