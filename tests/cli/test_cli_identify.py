"""The verbs of identification on the command line: the whole chain, its files, its exit
statuses.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main
from flexgen.identification.motions import time_domain
from flexgen.identification.motions.time_domain import Validation

pytestmark = needs_compiler

TRUTH = ["--set", "element.arm1.dof.q1.gear.spring.stiffness=2.0e5"]
NOISE = ["--encoder-noise", "1e-4", "--torque-noise", "0.02"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Plan and experiment on a robot with one other spring."""
    folder = tmp_path_factory.mktemp("identify")
    words = [
        "excite",
        "planar5_nmp",
        "--poses",
        "3",
        "--period-s",
        "2",
        "--lines",
        "30",
        "--speed-rms",
        "0.02",
        *NOISE,
    ]
    assert (
        main(
            [
                *words,
                "--out",
                str(folder / "plan.npz"),
                "--references",
                str(folder / "references"),
                "-q",
            ]
        )
        == 0
    )
    assert len(list((folder / "references").glob("*.csv"))) == 6
    assert (
        main(
            [
                "measure",
                "planar5_nmp",
                str(folder / "plan.npz"),
                *TRUTH,
                "--out",
                str(folder / "data.npz"),
                "-q",
            ]
        )
        == 0
    )
    assert main(["frf", str(folder / "data.npz"), "--out", str(folder / "frf.npz"), "-q"]) == 0
    return folder


def run(capsys, *words):
    status = main([str(word) for word in words])
    return status, capsys.readouterr()


@pytest.mark.slow
def test_a_spring_is_found_and_written(folder, capsys, tmp_path):
    out = tmp_path / "new.toml"
    report = tmp_path / "report"
    words = [
        "identify",
        "planar5_nmp",
        folder / "frf.npz",
        "--free",
        "stiffness,damping",
        "--out",
        out,
        "--json",
        "-q",
    ]
    status, printed = run(capsys, *words, "--report", report)
    data = json.loads(printed.out)
    assert status == 0 and data["status"] == "fitted" and data["model_file"] == str(out)
    row = next(row for row in data["parameters"] if row["name"] == "q1.stiffness")
    assert (
        row["value"] == pytest.approx(2.0e5, rel=5e-3)
        and row["sd_is_relative"]
        and row["sd"] < 5e-3
    )
    dof = flexgen.read(out).elements[0].dofs[0]
    assert dof.gear is not None and dof.gear.spring.stiffness == row["value"]
    page = (report / "index.html").read_text()
    assert (
        "q1.stiffness" in page
        and "Natural frequencies at home" in page
        and page.count("<figure") == 6
    )
    assert (report / "residuals.png").stat().st_size > 10_000


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_a_second_level_says_whether_the_robot_is_nonlinear(folder, capsys, tmp_path):
    """Coulomb friction of m1 that the model lacks: three times the speed of the experiment, and
    the experiment.
    """
    friction = ["--set", "motor.m1.friction.coulomb=0.04", "--set", "motor.m1.friction.beta=20"]
    plan = flexgen.Plan.load(folder / "plan.npz")
    replace(plan, amplitudes=3 * plan.amplitudes).save(tmp_path / "0.npz")
    for k, given in enumerate((tmp_path / "0.npz", folder / "plan.npz")):
        data = tmp_path / f"data{k}.npz"
        assert run(capsys, "measure", "planar5_nmp", given, *friction, "--out", data, "-q")[0] == 0
        assert run(capsys, "frf", data, "--out", tmp_path / f"frf{k}.npz", "-q")[0] == 0
    words = [
        "identify",
        "planar5_nmp",
        tmp_path / "frf0.npz",
        "--levels",
        tmp_path / "frf1.npz",
        "--starts",
        "1",
    ]
    status, printed = run(capsys, *words, "--json", "--report", tmp_path / "report", "-q")
    found = json.loads(printed.out)["amplitude"]
    assert (
        status == 1
        and found["differs"]
        and found["causes"][0]["words"].startswith("Coulomb friction of m1 (0.04")
    )
    assert (
        f"Amplitude test: {found['sentence']}." in (tmp_path / "report" / "index.html").read_text()
    )
    assert f"amplitude test: {found['sentence']}" in run(capsys, *words, "-q")[1].out


@pytest.mark.slow
def test_text_names_units_and_accuracy(folder, capsys):
    status, printed = run(
        capsys, "identify", "planar5_nmp", folder / "frf.npz", "--starts", "2", "-q"
    )
    assert status == 0 and re.search(r"starts at the best cost +2 +of 2", printed.out)
    assert "N m/rad" in printed.out and "sd" in printed.out


@pytest.mark.slow
def test_a_model_error_has_exit_status_one_and_no_standard_deviations(folder, capsys):
    """A spring stays at a wrong value."""
    wrong = [
        "--set",
        "element.arm1.dof.q1.gear.spring.stiffness=1.5e5",
        "--fixed",
        "q1.stiffness,q1.damping",
    ]
    words = [
        "identify",
        "planar5_nmp",
        folder / "frf.npz",
        *wrong,
        "--starts",
        "1",
        "--move",
        "line",
        "-q",
    ]
    status, printed = run(capsys, *words)
    assert status == 1 and "model error" in printed.out and "model error" in printed.err
    assert "standard deviations are not given" in " ".join(printed.out.split()).lower()
    assert (
        "no tool errors of the move line: a result with model error has no covariance"
        in printed.out
    )
    row = next(line for line in printed.out.splitlines() if line.startswith("q2.stiffness"))
    assert row.split()[-4] == "-"  # before the start value and the change in percent


@pytest.mark.slow
def test_progress_is_on_standard_error(folder, capsys, tmp_path):
    words = [
        "measure",
        "planar5_nmp",
        folder / "plan.npz",
        "--out",
        tmp_path / "data.npz",
        "--json",
    ]
    status, printed = run(capsys, *words)
    assert status == 0 and "simulating 60 s of planar5_nmp" in printed.err
    assert json.loads(printed.out)["duration_s"] == 60.0


def test_raw_samples_are_recordings_that_can_be_read(folder, capsys, tmp_path):
    """Responses from the samples in files equal those from the spectra."""
    words = [
        "measure",
        "planar5_nmp",
        folder / "plan.npz",
        "--out",
        tmp_path / "data.npz",
        "--raw",
        tmp_path / "raw",
    ]
    status, printed = run(capsys, *words, "-q")
    assert status == 0 and "6 files with all samples" in printed.out
    for source, out in (
        (tmp_path / "data.npz", "a.npz"),
        (tmp_path / "raw" / "recordings.toml", "b.npz"),
    ):
        assert run(capsys, "frf", source, "--out", tmp_path / out, "-q")[0] == 0
    a, b = (flexgen.Frf.load(tmp_path / name) for name in ("a.npz", "b.npz"))
    assert np.allclose(a.poses, b.poses, atol=1e-12) and np.array_equal(a.w, b.w)
    assert np.allclose(a.G, b.G, rtol=1e-9) and np.allclose(a.variance, b.variance, rtol=1e-6)


def test_responses_for_python_control(folder):
    control = pytest.importorskip("control")
    data = flexgen.Frf.load(folder / "frf.npz")
    found = data.to_control(1)
    assert isinstance(found, control.FrequencyResponseData)
    assert np.allclose(found(1j * data.w[3]), data.G[1, 3])
    with pytest.raises(flexgen.ArgumentError, match="pose: given 3, expected 0 to 2"):
        data.to_control(3)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_measured_responses_have_a_report(folder, capsys, tmp_path):
    words = [
        "frf",
        folder / "data.npz",
        "--out",
        tmp_path / "frf.npz",
        "--report",
        tmp_path / "report",
        "-q",
    ]
    assert run(capsys, *words)[0] == 0
    assert (tmp_path / "report" / "index.html").read_text().count("<figure") == 3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["excite", "planar5_nmp", "--out", "plan.txt"],
            "argument --out: given 'plan.txt', expected a file name ending in .npz",
        ),
        (
            ["excite", "planar5_nmp", "--poses", "0", "--out", "p.npz"],
            "argument --poses: given .0., expected an integer >= 1",
        ),
        (
            ["excite", "manutec_r3", "--speed-rms", "2", "--out", "p.npz"],
            "speed_rms: joint q1 would reach",
        ),
        (
            ["excite", "planar5_nmp", "--f-max", "5000", "--out", "p.npz"],
            "f_max: given 5000.0 Hz, expected at most",
        ),
        (
            ["excite", "planar5_nmp", "--periods", "1", "--out", "p.npz"],
            "periods: given 1, expected a whole number",
        ),
        (
            ["excite", "planar5_nmp", "--free", "weight", "--out", "p.npz"],
            "parameters: given 'weight'",
        ),
        (
            ["measure", "planar5_nmp", "none.npz", "--out", "d.npz"],
            "plan none.npz: cannot be read",
        ),
        (["frf", "none.npz", "--out", "f.npz"], "experiment none.npz: cannot be read"),
        (["identify", "planar5_nmp", "none.npz"], "frf none.npz: cannot be read"),
    ],
)
def test_mistakes_are_named(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, printed = run(capsys, *words)
    assert status == (2 if "argument" in message else 1) and re.search(message, printed.err), (
        printed.err
    )
    assert list(tmp_path.iterdir()) == []


def test_a_start_is_a_number(folder, capsys):
    status, printed = run(
        capsys, "identify", "planar5_nmp", folder / "frf.npz", "--start", "q1.stiffness='soft'"
    )
    assert status == 1 and "--start q1.stiffness: given 'soft', expected a number" in printed.err


def test_data_of_another_robot_are_refused(folder, capsys):
    status, printed = run(capsys, "identify", "manutec_r3", folder / "frf.npz")
    assert status == 1 and "data: given the motors m1, m2, expected" in printed.err


def test_drives_have_no_noise_delay_or_resolution_where_none_is_given(
    capsys, monkeypatch, tmp_path
):
    def plan(model, hardware, **_):
        raise ArgumentError(
            f"{hardware.delay_s} {hardware.encoder_noise_rad} {hardware.encoder_resolution_rad} "
            f"{hardware.torque_noise_Nm} {hardware.sample_s}"
        )

    monkeypatch.setattr("flexgen.identification.experiments.plan.excite", plan)
    words = ["excite", "planar5_nmp", "-q", "--out", tmp_path / "plan.npz"]
    assert "0.0 0.0 0.0 0.0 0.0005" in run(capsys, *words)[1].err
    given = [
        "--delay",
        "1e-4",
        "--encoder-noise",
        "0.2",
        "--encoder-resolution",
        "0.3",
        "--torque-noise",
        "0.4",
    ]
    assert "0.0001 0.2 0.3 0.4 0.0005" in run(capsys, *words, *given)[1].err


@pytest.mark.parametrize("checked", [Validation((99.5, 87.0), 1.25, (0.95, 0.9)), None])
def test_a_refinement_shows_what_experiments_that_it_did_not_use_say(
    checked, folder, capsys, monkeypatch
):
    monkeypatch.setattr(
        time_domain, "refine_and_validate", lambda found, experiment, **more: (found, checked)
    )
    words = [
        "identify",
        "planar5_nmp",
        folder / "frf.npz",
        "--free",
        "q1.stiffness",
        "--starts",
        "1",
        "-q",
    ]
    words += ["--refine", folder / "data.npz"]
    data = json.loads(run(capsys, *words, "--json")[1].out)
    printed = run(capsys, *words)[1].out
    assert ("cost 1.25 (1 expected)" in printed) == (checked is not None)
    if checked is None:
        assert "validation" not in data
    else:
        assert data["validation"] == {
            "fit_percent": [99.5, 87.0],
            "cost": 1.25,
            "white": [0.95, 0.9],
        }
        rows = [
            line.split() for line in printed.splitlines() if line.split()[:1] in (["m1"], ["m2"])
        ]
        assert rows == [["m1", "99.5", "95"], ["m2", "87", "90"]]
