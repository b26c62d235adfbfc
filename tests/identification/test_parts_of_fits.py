"""Residuals that noise does not explain, files of servos, and models of a calibration."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.identification.poses import result as calibrated
from flexgen.identification.responses.residuals import Residuals
from flexgen.identification.servo.fit_result import ServoFit


def test_the_part_that_noise_does_not_explain_is_of_the_worst_element() -> None:
    """Squares of residuals above their number by 8 deviations, 30 where the variances are of
    single elements.
    """
    made: Any = object.__new__(Residuals)
    G = np.ones((1, 100, 1, 2), complex)
    size = np.sqrt(np.array([1.5, 4.5]) + 0j)  # of a residual
    vars(made).update(_noisy=None, data=Made(G=10 * G), response=lambda x: Made(G=G))
    vars(made).update(_weigh=lambda r: (np.where(r.G == 1.0, size, 3.0) * np.ones(G.shape), None))
    assert made.find_unexplained(np.zeros(1)) == pytest.approx(np.sqrt((450 - 100) / 900))
    for excess, found in ((2.99, 0.0), (3.01, np.sqrt(301 / 900))):
        size[1] = np.sqrt(1 + excess)
        assert made.find_unexplained(np.zeros(1)) == pytest.approx(found, abs=1e-9)
    made._noisy = (None, np.full((1, 100, 2), 0.5))
    limit = 8 / np.sqrt(50)
    for part, found in ((0.99, 0.0), (1.01, np.sqrt(0.5 * 1.01 * limit / 9))):
        size[:] = 0.1, np.sqrt(0.5 * (1 + part * limit))
        assert made.find_unexplained(np.zeros(1)) == pytest.approx(found, abs=1e-9)
    vars(made).update(weight=lambda x, slopes: (np.array([3 + 4j, 2.0]), None))
    assert made.misfit(np.zeros(1)) == 29.0


def test_an_identified_servo_is_read_as_it_was_written(tmp_path: Path) -> None:
    gains = {"position_gain": [20.0, 30.0], "speed_gain": [0.5, 0.25], "integral_gain": [4.0, 0.0]}
    filters = (flexgen.LowPass(90.0), flexgen.Notch(30.0, 0.2, 0.5))
    cascade = flexgen.Cascade(**{key: np.array(x) for key, x in gains.items()}, filters=filters)
    servo = flexgen.Servo(
        cascade, sample_time=5e-4, delay=2.5e-4, speed_feedforward=0.75, reference_filter_s=3e-3
    )
    save: Any = ServoFit.write
    fit = Made(servo=servo, model="elbow@soft", record=Made(source="/a/b/day.csv"), ended="")
    read = flexgen.Servo.read(save(fit, tmp_path / "servo.toml"))
    for name in ("sample_time", "delay", "speed_feedforward", "reference_filter_s"):
        assert getattr(read, name) == getattr(servo, name)
    for name, values in gains.items():
        assert_allclose(getattr(read.feedback, name), values)
    assert getattr(read.feedback, "filters", None) == filters
    text = (tmp_path / "servo.toml").read_text()
    assert text.startswith(
        'description = "servo of elbow@soft, identified from day.csv"\ntype = "cascade"\n'
    )
    fit.record.source = ""
    assert 'identified from a record"' in save(fit, tmp_path / "servo.toml").read_text()


def test_a_calibrated_model_is_of_the_same_variant(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(
        calibrated,
        "read",
        lambda file, variant, overrides: asked.append((file, variant, overrides)),
    )
    monkeypatch.setattr(calibrated.Calibration, "changes", property(lambda self: {"key": 1.0}))
    for variant, expected in (("stiff", "stiff"), ("", None)):
        made = object.__new__(calibrated.Calibration)
        nominal = Made(file="arm.toml", variant=variant, overrides={}, text="{}", not_measured=())
        object.__setattr__(made, "nominal", nominal)
        assert made.model is None and asked[-1] == ("arm.toml", expected, {"key": 1.0})
    object.__setattr__(made, "nominal", Made(file="", variant=""))
    text = (
        "calibration: given a model without a file, expected one that was read from a .toml file"
    )
    with pytest.raises(ArgumentError) as caught:
        _ = made.model
    assert str(caught.value) == text
