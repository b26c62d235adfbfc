"""Tuning of the cascade of a robot: errors, margins of all robots, time limit, files."""

from __future__ import annotations

import json

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main

MODEL = "elbow"
EVALUATIONS = 16


@pytest.fixture(scope="module")
def told():
    """Lines that the tuning tells."""
    return []


@pytest.fixture(scope="module")
def tuned(told):
    return flexgen.tune_cascade(MODEL, evaluations=EVALUATIONS, progress=told.append)


def test_the_best_value_is_told(tuned, told):
    best = [line.rpartition(" ")[2] for line in told if "controllers, best " in line]
    assert best == [f"{value:.3f}" for value in tuned.history]


def test_errors_fall_and_the_run_is_that_of_the_tuned_controller(tuned):
    assert tuned.status == "tuned" and tuned.evaluations <= EVALUATIONS
    assert tuned.history[0] == 1.0 and tuned.history[-1] < 1.0
    plants = {"soft": {"stiffness": 0.8}, "stiff": {"stiffness": 1.2}}
    again = flexgen.control(MODEL, controller=tuned.controller, plants=plants, progress=False)
    errors = [again.figures(robot)["dynamic_error_max_m"] for robot in again.runs]
    before = flexgen.control(MODEL, plants=plants, progress=False)
    start = [before.figures(robot)["dynamic_error_max_m"] for robot in before.runs]
    value = np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(start)))
    assert tuned.history[-1] == pytest.approx(value, rel=1e-9)


def test_all_robots_keep_the_margins(tuned):
    """By the margins of a run, which the search does not use."""
    plants = {"soft": {"stiffness": 0.8}, "stiff": {"stiffness": 1.2}}
    run = flexgen.control(MODEL, controller=tuned.controller, plants=plants, progress=False)
    found = [m for robot in run.runs for m in run.margins(robot.name).values()]
    assert min(m.gain_db for m in found) == pytest.approx(tuned.margins.gain_db)
    assert min(m.gain_db for m in found) > 5.999 and min(m.phase_deg for m in found) > 29.999
    assert tuned.robust


@pytest.mark.slow
def test_a_larger_required_margin_is_kept_and_costs_accuracy(tuned):
    strict = flexgen.tune_cascade(
        MODEL, gain_margin_db=14.0, phase_margin_deg=50.0, evaluations=EVALUATIONS, progress=False
    )
    assert strict.robust and strict.margins.gain_db > 13.99 and strict.margins.phase_deg > 49.99
    assert strict.history[-1] >= tuned.history[-1]


@pytest.mark.slow
def test_a_start_without_the_margins_is_led_to_them():
    fast = flexgen.PPI(position_hz=20.0, speed_hz=400.0, integral_hz=1.0)
    found = flexgen.tune_cascade(
        MODEL, controller=fast, gain_margin_db=20.0, evaluations=40, progress=False
    )
    assert found.start_margins.gain_db < 20.0 <= found.margins.gain_db + 1e-3 and found.robust


def test_margins_that_no_cascade_has_are_reported():
    told: list[str] = []
    found = flexgen.tune_cascade(
        MODEL, phase_margin_deg=170.0, gain_margin_db=40.0, evaluations=4, progress=told.append
    )
    assert not found.robust and found.history[-1] >= 100.0
    assert "4 of 4 controllers, best none with the margins yet" in told


def test_a_time_limit_ends_with_the_best_so_far():
    found = flexgen.tune_cascade(MODEL, evaluations=5000, time_limit=0.3, progress=False)
    assert found.status == "time limit" and found.evaluations < 5000
    assert found.run.status == "done"


def test_the_file_is_taken_by_control(tuned, tmp_path):
    file = tuned.save(tmp_path / "tuned.toml")
    run = flexgen.control(MODEL, controller=file, progress=False)
    assert np.array_equal(run.law.speed_gain, tuned.controller.speed_gain)
    assert tuned.gains()[0]["speed_gain_after"] == run.law.speed_gain[0]


@pytest.mark.parametrize(
    "given, said",
    [
        ({"controller": "none"}, "controller: given FeedforwardOnly, expected a P-PI cascade"),
        ({"evaluations": 0}, "evaluations: given 0, expected 1 to 20000"),
        ({"gain_margin_db": -1.0}, "gain_margin_db: given -1.0, expected 0 to 40"),
        ({"phase_margin_deg": 180.0}, "phase_margin_deg: given 180.0, expected 0 to 170"),
    ],
)
def test_wrong_arguments_are_refused(given, said):
    with pytest.raises(ArgumentError, match=said):
        flexgen.tune_cascade(MODEL, **given)


def test_the_command_line_prints_gains_before_and_after(tmp_path, capsys):
    out = tmp_path / "tuned.toml"
    words = [
        "tune",
        MODEL,
        "--out",
        str(out),
        "--evaluations",
        "8",
        "--plant",
        "soft:stiffness=0.7",
    ]
    assert main(words) == 0
    said = capsys.readouterr().out
    for text in ("speed gain, N m s/rad", "position gain, 1/s", "soft", "phase margin, deg"):
        assert text in said
    assert f"flexgen control {MODEL} --controller {out}" in said
    assert main(["control", MODEL, "--controller", str(out), "--no-compare"]) == 0
    capsys.readouterr()
    words[words.index("8")] = "3"
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["robust"] and [row["robot"] for row in found["errors"]] == ["nominal", "soft"]
    assert main(["tune", MODEL, "--out", str(out), "--starts", "2"]) == 1
    assert "--starts" in capsys.readouterr().err


def test_a_name_of_a_benchmark_stays_one(tmp_path, capsys):
    words = ["tune", "four_mass@1", "--out", str(tmp_path / "x.toml"), "--delay", "1e-3"]
    assert main(words) == 1
    assert "a benchmark: given with --delay" in capsys.readouterr().err
