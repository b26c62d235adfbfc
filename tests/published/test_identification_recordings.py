"""Identification from recordings of real machines: a motor bench and a fine steering mirror."""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.identification.motions.motion_fit import fit_motion
from flexgen.identification.records.experiment_file import read_experiment
from flexgen.identification.responses.response_estimates import estimate
from flexgen.identification.responses.result import FitStatus

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("FLEXGEN_DATA", ROOT.parent / "shared" / "data"))
BENCH = DATA / "motorbench" / "MultisineTypeA.mat"
MIRROR = DATA / "fsm" / "u_300mV_train.npy"
FREE = ["stiffness", "damping", "m1.viscous", "m1.inertia", "load.inertia_zz", "delay"]


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    if not BENCH.exists():
        pytest.skip(f"no recording {BENCH.name}: a data set of the Hori-Fujimoto laboratory")
    folder = tmp_path_factory.mktemp("bench")
    # but not the compiled files of Python
    for file in (ROOT / "examples" / "motor_bench").glob("*.*"):
        shutil.copy(file, folder)
    shutil.copy(BENCH, folder)
    return folder


@pytest.mark.parametrize("residual", ["nls", "lls"])
def test_the_motor_bench_has_its_known_parameters(bench, residual):
    """A fit by other software: J_m 4.83e-3, J_l 4.71e-3, k 548, delay 0.106 ms; both within 2
    %.
    """
    data = flexgen.frf(read_experiment(bench / "recordings.toml"))
    found = flexgen.identify(
        bench / "bench.toml", data, free=FREE, residual=residual, progress=False
    )
    assert found.values["m1.inertia"] == pytest.approx(4.83e-3, rel=0.02)
    assert found.values["load.inertia_zz"] == pytest.approx(4.71e-3, rel=0.02)
    assert found.values["q1.stiffness"] == pytest.approx(548.0, rel=0.02)
    assert 0.08e-3 < found.values["delay"] < 0.14e-3
    assert (
        found.status == FitStatus.MODEL_ERROR and 0.01 < found.model_error < 0.2
    )  # friction, a coupling that is not a spring
    assert found.agreed == found.starts
    assert data.warnings and "period 7 differs" in data.warnings[0]  # it does


def test_the_first_period_of_the_bench_is_a_transient(bench, tmp_path):
    for file in bench.glob("*.*"):
        shutil.copy(file, tmp_path)
    text = (tmp_path / "recordings.toml").read_text().replace("transients = 1", "transients = 0")
    (tmp_path / "recordings.toml").write_text(text)
    settled, all_periods = (
        flexgen.frf(read_experiment(x / "recordings.toml")) for x in (bench, tmp_path)
    )
    assert "a transient is in the first of" in all_periods.warnings[-1]
    assert (all_periods.G == settled.G).all() and all_periods.periods == settled.periods


def test_a_wrong_hold_is_a_wrong_delay(bench, tmp_path):
    """A hold that the recording does not have changes the identified delay: half a sample of 0.4
    ms.
    """
    for file in bench.glob("*.*"):
        shutil.copy(file, tmp_path)
    text = (tmp_path / "recordings.toml").read_text().replace('hold = "none"', 'hold = "zoh"')
    (tmp_path / "recordings.toml").write_text(text)
    found = flexgen.identify(
        tmp_path / "bench.toml",
        flexgen.frf(read_experiment(tmp_path / "recordings.toml")),
        free=FREE,
        progress=False,
    )
    assert found.values["delay"] == pytest.approx(0.11e-3 - 0.2e-3, abs=0.03e-3)


def test_the_motor_bench_in_the_time_domain(bench):
    """Segments of 50 ms with free start states: the same parameters without frequency
    responses.
    """
    found = fit_motion(None, bench / "recordings.toml", free=FREE, segment_s=0.05, progress=False)
    assert found.values["m1.inertia"] == pytest.approx(4.83e-3, rel=0.02)
    assert found.values["load.inertia_zz"] == pytest.approx(4.71e-3, rel=0.02)
    assert found.values["q1.stiffness"] == pytest.approx(548.0, rel=0.02)
    assert 0.08e-3 < found.values["delay"] < 0.14e-3
    assert found.fit_percent[0] > 95 and found.white[0] < 0.5  # friction that is not in the model


@pytest.mark.slow
def test_four_routes_to_the_damping_of_the_bench_state_no_interval(bench):
    """They differ by a factor of five: a model error, with its reason, so that none is stated.

    The deviation of the fit to motions has Student's quantiles of few blocks and is wide; those of
    the responses are formal, and exclude it.
    """
    experiment = read_experiment(bench / "recordings.toml")
    damping = []
    logs = []
    fits = []
    for average, residual in (("arithmetic", "nls"), ("arithmetic", "lls"), ("h1", "nls")):
        data = flexgen.frf(experiment, average=average)
        fits.append(
            flexgen.identify(
                bench / "bench.toml", data, free=FREE, residual=residual, progress=False
            )
        )
        # the reason: responses that noise does not explain
        assert fits[-1].model_error > 5 * data.relative_sd()
    fits.append(
        fit_motion(None, bench / "recordings.toml", free=FREE, segment_s=0.05, progress=False)
    )
    assert fits[-1].white[0] < 0.85  # the reason: residuals that are not noise
    for found in fits:
        k = found.vector.names.index("q1.damping")
        damping.append(found.values["q1.damping"])
        deviation = 1.96 * np.sqrt(found.formal_covariance[k, k])
        logs.append(np.log(damping[-1]) + deviation * np.array([-1, 1]))
        assert found.status == FitStatus.MODEL_ERROR and set(found.sd.values()) == {None}
    assert max(damping) > 4 * min(damping)
    assert np.log(damping[3]) < min(low for low, _ in logs[:3])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "words", "expected"),
    [
        ("motor_bench/identify_bench.py", (), ("q1.stiffness", "fit of the motor angle")),
        ("kr300/identify_kr300.py", (), ("36 base parameters", "q1: not identifiable", "q3: ")),
        ("steering_mirror.py", ("u", "y", "out.svg"), ("noise: 0.217 %", "distortion: 2.89 %")),
    ],
)
def test_examples_of_recordings(script, words, expected, tmp_path, capsys):
    sources = {
        "motor_bench": [BENCH],
        "kr300": sorted(DATA.glob("kr300/*.npz")),
        "steering_mirror.py": [MIRROR],
    }
    files = sources[script.partition("/")[0]]
    if not files or not files[0].exists():
        pytest.skip(f"no recordings for {script}")
    for file in files:
        shutil.copy(file, tmp_path)
    arguments = [str(tmp_path)]
    if words:
        arguments = [str(MIRROR.with_name(f"{name}_300mV_train.npy")) for name in "uy"] + [
            str(tmp_path / "out.svg")
        ]
    spec = importlib.util.spec_from_file_location("example", ROOT / "examples" / script)
    module = importlib.util.module_from_spec(spec)
    sys.modules["example"] = module
    spec.loader.exec_module(module)
    module.main(arguments if words else tmp_path)
    printed = capsys.readouterr().out
    assert all(text in printed for text in expected), printed
    assert list(tmp_path.glob("*.svg"))


def test_responses_of_a_steering_mirror():
    """Against a plain average; noise and total deviations as published for the same records."""
    if not MIRROR.exists():
        pytest.skip(f"no recording {MIRROR.name}: M. Floren et al., fine steering mirror")
    u, y = (np.load(MIRROR.with_name(f"{name}_300mV_train.npy")) for name in "uy")
    samples = len(u)
    # (lines, channels, records, periods)
    U, Y = (2 / samples * np.fft.rfft(x, axis=0) for x in (u, y))
    size = np.abs(U).max(axis=(1, 2, 3))
    lines = np.flatnonzero(size > 0.1 * size.max())
    blocks = [
        x[lines].reshape(len(lines), 3, 2, 3, 2).transpose(2, 4, 0, 1, 3)[None] for x in (U, Y)
    ]
    found = estimate(*blocks)
    plain = np.zeros((2, len(lines), 3, 3), complex)
    for block in range(2):
        for k, line in enumerate(lines):
            inputs, outputs = (
                x[line, :, 3 * block : 3 * block + 3, :].mean(axis=-1) for x in (U, Y)
            )
            plain[block, k] = outputs @ np.linalg.inv(inputs)
    assert np.allclose(
        found.G[0], plain.mean(axis=0), rtol=1e-10, atol=1e-12 * np.abs(plain).max()
    )
    assert found.total is not None
    assert np.median(np.sqrt(found.variance) / np.abs(found.G)) == pytest.approx(0.0022, rel=0.05)
    assert np.median(np.sqrt(found.total) / np.abs(found.G)) == pytest.approx(0.029, rel=0.05)
