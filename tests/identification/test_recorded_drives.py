"""Recordings with the references and gains of their drives: `refine` simulates them as it does an
experiment.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured_numbers import check_numbers
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.dynamics.mechanics.parameters import with_values
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.experiments.experiment import Experiment
from flexgen.identification.motions.time_domain import Simulated
from flexgen.identification.records.experiment_file import read_experiment
from flexgen.identification.records.recording_writer import RecordingWriter
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.model.position_servo.filters import LowPass, Notch

pytestmark = needs_compiler
FREE = ["stiffness", "damping"]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """An experiment on a robot with Coulomb friction, and the description of its recordings."""
    folder = tmp_path_factory.mktemp("recordings")
    model = flexgen.read("planar5_nmp")
    drives = DriveHardware(1e-3, encoder_noise_rad=1e-7)
    plan = flexgen.excite(
        model,
        poses=np.array([[0.3, -0.2]]),
        lines=20,
        period_s=1.0,
        periods=2,
        f_max=60.0,
        speed_rms=0.02,
        hardware=drives,
        progress=False,
    )
    writer = RecordingWriter(folder, plan, model)
    rough = with_values(
        model,
        {f"{m.name}.{k}": x for m in model.motors for k, x in (("coulomb", 1.0), ("beta", 2.0))},
    )
    return flexgen.measure(plan, rough, raw=writer, progress=False), writer.finish()


def changed(path: Path, name: str, *pairs: tuple[str, str]) -> Path:
    text = path.read_text()
    for old, new in pairs:
        assert old in text, old
        text = text.replace(old, new, 1)
    path.with_name(name).write_text(text)
    return path.with_name(name)


@pytest.mark.slow
def test_recordings_with_their_drives_are_simulated_as_the_experiment(recorded, tmp_path):
    """Residuals of a model with other springs are those of the experiment; also after saving to a
    file and loading.
    """
    experiment, path = recorded
    found = read_experiment(path)
    found.save(tmp_path / "data.npz")
    model = with_values(flexgen.read("planar5_nmp"), {"q1.stiffness": 3e5})
    vector = ParameterVector(model, FREE)
    expected, *others = (
        Simulated(vector, one, [(0, 0, 0)]).residual(vector.start)
        for one in (experiment, found, Experiment.load(tmp_path / "data.npz"))
    )
    assert np.abs(expected).max() > 100
    for residual in others:
        assert np.allclose(residual, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_filters_of_the_drives_are_read_and_kept(recorded, tmp_path):
    path = changed(
        recorded[1], "filtered.toml",
        ("[drive]", "[drive]\nlow_pass = { frequency_hz = 200.0 }\n"
         "notch = { frequency_hz = 80.0, zero_damping = 0.2 }"),
    )  # fmt: skip
    found = read_experiment(path)
    found.save(tmp_path / "data.npz")
    for one in (found, Experiment.load(tmp_path / "data.npz")):
        assert one.plan.controller.filters == (LowPass(200.0, 0.7), Notch(80.0, 0.2, 0.7))
        check_numbers("recorded", experiment=one, plan=one.plan)


def test_lines_of_distortion_are_not_excited_lines(recorded):
    """Friction moves the torques at other lines; the references tell which ones were excited."""
    experiment, path = recorded
    numbers = re.search(r"line_numbers = .*\n", path.read_text())[0]
    every = changed(path, "lines.toml", (numbers, ""))
    assert read_experiment(every).plan.lines.tolist() == experiment.plan.lines.tolist()
    text = every.read_text()
    without = re.sub(r'\n\[\[reference\]\]\n(?:[a-z]+ = "[^"]*"\n?)+', "\n", text)
    every.with_name("without.toml").write_text(without)
    guessed = read_experiment(every.with_name("without.toml"))
    assert len(guessed.plan.lines) > len(experiment.plan.lines)
    guessed.save(every.with_name("guessed.npz"))
    for one in (guessed, Experiment.load(every.with_name("guessed.npz"))):
        said = flexgen.frf(one).warnings[-1]
        assert (
            f"the {len(guessed.plan.lines)} lines are those where the torques are large" in said
        ), said
        assert "line_numbers" in said and "[[reference]]" in said
    for known in (path, every):
        assert not any(
            "lines are those" in said for said in flexgen.frf(read_experiment(known)).warnings
        )


def test_scale_turns_a_channel_and_an_offset_shifts_it_in_one_file(recorded):
    path = recorded[1]
    turned = changed(
        path, "turned.toml", ('name = "q_1"\n', 'name = "q_1"\nscale = -2.0\n'),
        ('[[recording]]\nfile = "pose1_realization1_experiment1.npz"\n',
         '[[recording]]\nfile = "pose1_realization1_experiment1.npz"\noffset = { m1 = 0.5 }\n'),
    )  # fmt: skip
    found = read_experiment(turned)
    before = read_experiment(path)
    assert np.allclose(found.q_m[..., 0], -2 * before.q_m[..., 0]) and np.allclose(
        found.q_m[..., 1], before.q_m[..., 1]
    )
    shift = found.references - before.references
    assert np.allclose(shift[0, 0, 0], [0.5, 0.0]) and np.allclose(shift[0, 0, 1], 0.0)
    for old, new, words in (
        ("scale = -2.0", "scale = 0.0", "scale: given 0.0, expected a factor other than 0"),
        ("{ m1 = 0.5 }", "{ m9 = 0.5 }", "m9"),
        ("[drive]", "[drive]\nspeed = 3", "speed: given an unknown key"),
    ):
        with pytest.raises(ModelError, match=words):
            read_experiment(changed(turned, "wrong.toml", (old, new)))


@pytest.mark.slow
def test_what_refine_needs_of_recordings_is_named(recorded):
    path = recorded[1]
    model = flexgen.read("planar5_nmp")
    text = path.read_text()
    unknown = path.with_name("unknown.toml")
    unknown.write_text(re.sub(r"\n\[drive\](?:\n[a-z_A-Z]+ = .*)+", "\n", text))
    found = flexgen.identify(
        model, flexgen.frf(read_experiment(unknown)), free=["damping"], starts=1, progress=False
    )
    check_numbers("damping", 1e-5, found=found, figures=found.to_dict())
    with pytest.raises(ArgumentError, match=r"expected tables \[drive\] and \[\[reference\]\]"):
        flexgen.refine(found, read_experiment(unknown), progress=False)
    lost = replace(read_experiment(path), references=None)
    with pytest.raises(ArgumentError, match=r"without the gains and references"):
        flexgen.refine(found, lost, progress=False)


def test_references_in_csv_files_are_those_of_the_recordings(recorded, tmp_path):
    """Angles as the drives followed them; speeds are their derivatives."""
    experiment, path = recorded
    files = experiment.plan.write_references(tmp_path / "references")
    assert [file.name for file in files] == [
        f"pose1_realization1_experiment{k}.csv" for k in (1, 2)
    ]
    for k, file in enumerate(files):
        names = file.read_text().partition("\n")[0].split(",")
        assert names == ["t", "m1_q_ref_rad", "m2_q_ref_rad", "m1_v_ref_rad_s", "m2_v_ref_rad_s"]
        t, *columns = np.loadtxt(file, delimiter=",", skiprows=1).T
        q = np.array(columns[:2]).T
        v = np.array(columns[2:]).T
        assert np.allclose(q, read_experiment(path).references[0, 0, k], atol=1e-9)
        slope = (np.roll(q, -1, axis=0) - np.roll(q, 1, axis=0)) / (2 * t[1])
        assert np.abs(slope - v).max() < 0.05 * np.abs(v).max()  # differences at up to 60 Hz


@pytest.mark.slow
def test_recordings_are_refined_from_the_command_line(recorded, tmp_path, capsys):
    from flexgen.cli.main import main

    _, path = recorded
    assert main(["frf", str(path), "--out", str(tmp_path / "frf.npz"), "-q"]) == 0
    capsys.readouterr()
    words = [
        "identify",
        "planar5_nmp",
        str(tmp_path / "frf.npz"),
        "--refine",
        str(path),
        "--starts",
        "1",
        "-q",
    ]
    main(
        [
            *words,
            "--start",
            "m1.viscous=0.01",
            "--start",
            "m2.viscous=0.01",
            "--free",
            "stiffness,damping,friction",
        ]
    )
    assert "simulation of experiments that were not used" in capsys.readouterr().out
