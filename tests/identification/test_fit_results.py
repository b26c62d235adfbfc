"""The one base of results of estimations: numbers, deviations, status and files of each class, by
routes that share no code with it.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_fits import FITS, small_fit

import flexgen
from flexgen.identification.estimator.fit_result import FitResult, FittedNumber
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.responses.result import write_parameters
from flexgen.identification.rigid.rigid_file import RigidIdentification

CLASSES = {
    "gears": "GearFit",
    "spring": "SpringFit",
    "servo": "ServoFit",
    "load": "Load",
    "poses": "Calibration",
    "commissioning": "Commissioning",
    "responses": "IdentificationResult",
    "motions": "MotionFit",
    "rigid": "RigidIdentification",
}
# The fit of a rigid arm takes more than 3 s.
NAMES = [
    pytest.param(make.__name__, marks=[pytest.mark.slow] * (make.__name__ == "rigid"))
    for make in FITS
]


def misfits(found: FitResult) -> list[str]:
    """The rules of the base that a result breaks."""
    broken = []
    if not found.fitted:
        broken.append("no numbers")
    names = [number.name for number in found.fitted]
    if list(found.values) != names or list(found.sd) != names or len(set(names)) < len(names):
        broken.append("names of values and deviations")
    if not isinstance(found.status, FitStatus):
        broken.append("status")
    for sentence in (*found.weak, *map(str, found.causes)):
        if not isinstance(sentence, str) or " " not in sentence:
            broken.append(f"no sentence: {sentence!r}")
    stated = [number.sd for number in found.fitted if number.sd is not None]
    if stated and not found.status.has_deviations:
        broken.append("deviations with a status that has none")
    if not all(sd >= 0.0 and np.isfinite(sd) for sd in stated):
        broken.append("deviations below zero")
    return broken


def test_the_results_of_all_fits_have_the_base():
    public = [getattr(flexgen, name) for name in flexgen.__all__]
    found = {
        each.__name__
        for each in (*public, RigidIdentification)
        if isinstance(each, type) and issubclass(each, FitResult)
    }
    assert found == set(CLASSES.values())


@pytest.mark.parametrize("name", NAMES)
def test_a_fit_keeps_the_rules_of_the_base(name):
    found = small_fit(name)
    assert type(found).__name__ == CLASSES[name]
    assert misfits(found) == []


def test_planted_faults_are_found():
    class Planted(FitResult):
        fitted = (FittedNumber("a", 1.0, "m", 0.1), FittedNumber("a", 1.0, "m", -0.1))
        status = FitStatus.MODEL_ERROR
        weak = ("direction",)

    assert misfits(Planted()) == [
        "names of values and deviations",
        "no sentence: 'direction'",
        "deviations with a status that has none",
        "deviations below zero",
    ]


def test_values_are_those_of_the_fields_that_users_read():
    servo = small_fit("servo")
    gains = [getattr(servo.servo.feedback, f"{kind}_gain") for kind in ("position", "speed")]
    assert servo.values["m2.position_gain"] == gains[0][1]
    assert servo.values["m1.speed_gain"] == gains[1][0]
    assert servo.sd["m2.speed_gain"] == servo.gain_sd[1, 1]
    assert servo.sd["latency_s"] == servo.common_sd["latency_s"]
    load = small_fit("load")
    assert [load.values[f"com_{axis}"] for axis in "xyz"] == load.com.tolist()
    assert (load.values["mass"], load.sd["mass"]) == (load.mass, load.mass_sd)
    poses = small_fit("poses")
    assert list(poses.values.values()) == poses.x.tolist()
    assert np.allclose(np.square(list(poses.sd.values())), np.diag(poses.covariance), rtol=1e-12)
    gears = small_fit("gears")
    changed = gears.changes["motor.m1.cogging"]
    assert changed["sin"] == [gears.values["m1.cogging.sin_6"]]
    responses = small_fit("responses")
    rows = {row["name"]: row for row in responses.to_dict()["parameters"]}
    spring = responses.model.elements[0].dofs[0].gear.spring.stiffness
    assert rows["q1.stiffness"]["value"] == responses.values["q1.stiffness"] == spring
    of_x = np.exp(responses.x[responses.vector.names.index("q1.stiffness")])
    assert spring == pytest.approx(of_x, rel=1e-12)


def test_a_relative_deviation_is_that_of_the_number():
    assert FittedNumber("a", -20.0, "N", 0.1, is_relative=True).deviation == 2.0
    assert FittedNumber("a", -20.0, "N", 0.1).deviation == 0.1
    assert FittedNumber("a", -20.0, "N", None, is_relative=True).deviation is None


@pytest.mark.parametrize(
    ("name", "value", "sd", "text"),
    [
        ("q1.stiffness", 5e4, 0.0123, "1.2 %"),
        ("arm1.com_x", 0.1, 0.0123, "0.012"),
        ("m1.offset", 0.2, 0.0123, "0.012"),
        ("m1.offset", 0.2, "fixed", "fixed"),
    ],
)
def test_deviations_of_numbers_with_a_sign_are_not_relative(name, value, sd, text):
    robot = flexgen.read("planar5_nmp")
    model = Path(robot.file).read_text(encoding="utf-8")
    found = write_parameters(model, robot, {name: value}, {name: sd}, "test", "planar5.toml")
    assert f"{name}: sd {text}\n" in found


@pytest.mark.parametrize("reason", ["time limit", "interrupted"])
@pytest.mark.parametrize("name", ["servo", "load", "poses"])
def test_a_search_that_was_ended_has_the_reason_as_status(name, reason):
    found = replace(small_fit(name), ended=reason)
    assert found.status == reason and reason in found.problem


def test_the_status_of_a_calibration_follows_from_poses_that_were_not_fitted():
    found = small_fit("poses")
    assert found.status is FitStatus.FITTED
    worse = replace(found, errors_held_out=3.0 * found.errors)
    assert worse.status is FitStatus.POORLY_VALIDATED
    assert replace(found, errors_held_out=None).status is FitStatus.NOT_CHECKED
    assert replace(found, converged=False).status is FitStatus.NOT_CONVERGED


def test_the_status_of_a_servo_follows_from_what_it_explains():
    found = small_fit("servo")
    rest = 2.0 * found.noise
    assert replace(found, unexplained=rest).status is FitStatus.MODEL_ERROR
    assert replace(found, explained=0.5).status is FitStatus.MODEL_ERROR
    assert replace(found, converged=False).status is FitStatus.NOT_CONVERGED


@pytest.mark.parametrize("name", ["gears", "servo", "responses", "motions"])
def test_save_and_write_make_the_same_file(name, tmp_path):
    found = small_fit(name)
    saved = found.save(tmp_path / "a.toml").read_bytes()
    assert saved == found.write(tmp_path / "b.toml").read_bytes() and saved


def test_a_load_has_no_model_file(tmp_path):
    load = small_fit("load")
    with pytest.raises(flexgen.ArgumentError, match=r"'a.toml', expected a name that ends in"):
        load.save(tmp_path / "a.toml")
    assert json.loads(load.write(tmp_path / "a.json").read_text())["mass"] == load.mass
