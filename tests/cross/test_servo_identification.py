"""Servos planted in an arm by hand-written equations, and what `identify_servo` makes of noisy
records.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from elbow_under_servo import PERIOD, RATIO, TIME, H, commands, follow
from hysteretic import hysteretic
from servo_in_mujoco import OwnServo, sampled
from toolchain import needs_compiler

import flexgen
from flexgen.identification.servo import identify
from flexgen.identification.servo.fit_result import GAINS, ServoFit
from flexgen.identification.servo.identify import COMMON

pytestmark = needs_compiler

TRUE = {"k_p": np.array([25.0, 20.0]), "k_v": np.array([1.5, 1.2]), "k_i": np.array([6.0, 6.0])}
LATENCY = 1.7e-3  # s
NOISE = 1e-3  # rad of the motors
FILTERS = (flexgen.LowPass(200.0), flexgen.Notch(30.0, 0.2, 0.7))
SECTIONS = (
    sampled([0, 0, 1], [1, 1.4, 1], 200.0, H),
    sampled([1, 0.4, 1], [1, 1.4, 1], 30.0, H),
)


def angles_of(hold: bool, late: int, **servo: Any) -> np.ndarray:
    """Angles without noise of the arm under a servo whose commands come `LATENCY` late."""
    sent = commands()

    def at(time: float) -> np.ndarray:
        if hold:
            return sent[max(int((time - LATENCY) / PERIOD + 1e-9), 0)]
        return np.array([np.interp(time - LATENCY, TIME, joint) for joint in sent.T])

    return follow(partial(OwnServo, h=H, **servo), at, late)


def fit_of(angles: np.ndarray, seed: int, first: dict[str, Any], interpolation: str) -> ServoFit:
    noise = NOISE * np.random.default_rng(seed).standard_normal(angles.shape) / RATIO
    record = flexgen.ServoRecord(TIME, commands(), angles + noise)
    return flexgen.identify_servo(
        "elbow", record, servo=flexgen.Servo(**first), interpolation=interpolation, progress=False
    )


def errors_of(
    fit: ServoFit, true: dict[str, Any], latency: float
) -> tuple[np.ndarray, np.ndarray]:
    """Errors of all numbers in standard deviations, and of gains, relative."""
    gains = np.array([getattr(fit.servo.feedback, name) for name in GAINS])
    wanted = np.array([true["k_p"], true["k_v"], true["k_i"]])
    free = wanted > 0.0
    off = (gains[free] - wanted[free]) / wanted[free]
    common = np.array([fit.servo.speed_feedforward, fit.servo.reference_filter_s, fit.latency_s])
    apart = common - [true["feedforward"], true["filter_s"], latency]
    return np.concatenate(
        [off / fit.gain_sd[free], apart / [fit.common_sd[name] for name in COMMON]]
    ), off


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "own", "interpolation", "late"),
    [
        ({}, {}, "linear", 0),
        ({"feedforward": 0.0}, {}, "linear", 0),
        ({"filter_s": 0.0}, {}, "linear", 0),
        ({"k_i": np.zeros(2)}, {}, "linear", 0),
        ({"filters": SECTIONS}, {"filters": FILTERS}, "linear", 0),
        ({}, {}, "hold", 0),
        ({}, {}, "linear", 3),
    ],
    ids=["plain", "no-feedforward", "no-filter", "no-integral", "torque-filters", "hold", "delay"],
)
def test_planted_servos_are_found_within_their_intervals(changed, own, interpolation, late):
    """Errors of 9 numbers in standard deviations; steps of ``hold`` act at the next sample of the
    servo.
    """
    true = {**TRUE, "feedforward": 0.8, "filter_s": 3e-3, **changed}
    first = flexgen.Cascade(0.8 * TRUE["k_p"], 0.8 * TRUE["k_v"], 0.7 * true["k_i"], **own)
    angles = angles_of(interpolation == "hold", late, **true)
    latency = H * np.ceil(LATENCY / H) if interpolation == "hold" else LATENCY
    all_errors = []
    for seed in range(8):
        fit = fit_of(angles, seed, {"feedback": first, "delay": late * H}, interpolation)
        errors, off = errors_of(fit, true, latency)
        assert np.abs(off).max() < 0.01 and not np.any(fit.gain_sd[2][true["k_i"] == 0.0])
        assert np.abs(fit.unexplained / NOISE - 1.0).max() < 0.15
        all_errors.append(errors)
    assert np.abs(all_errors).max() < 4.5 and 0.4 < np.sqrt(np.mean(np.square(all_errors))) < 1.5


def test_a_search_that_does_not_end_begins_again_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With lower gains: near the limit of stability it crawls."""
    begun: list[float] = []
    own = identify.RecordedLoop.start
    monkeypatch.setattr(
        identify.RecordedLoop,
        "start",
        lambda fit, lower=1.0: begun.append(lower) or own(fit, lower),
    )
    monkeypatch.setattr(identify, "STEPS", 1)
    true = {**TRUE, "feedforward": 0.8, "filter_s": 3e-3}
    fit = fit_of(
        angles_of(False, 0, **true), 0, {"feedback": flexgen.Cascade(*TRUE.values())}, "linear"
    )
    assert begun == [1.0, *identify.LOWER]
    assert not fit.converged and "the search did not end" in fit.problem and not fit.is_explained


@pytest.mark.slow
def test_what_the_servo_does_not_describe_is_stated() -> None:
    """Filters of the torque that it does not have: gains are wrong by many standard deviations."""
    true = {**TRUE, "feedforward": 0.8, "filter_s": 3e-3}
    angles = angles_of(False, 0, **true, filters=SECTIONS)
    for filters, known in ((FILTERS, True), ((), False)):
        fit = fit_of(angles, 0, {"feedback": flexgen.Cascade(*TRUE.values(), filters)}, "linear")
        assert fit.is_explained == known != ("times the noise is left" in fit.sentence())
        assert np.abs(fit.noise / NOISE - 1.0).max() < 0.15


@pytest.mark.slow
def test_a_robot_whose_gears_have_hysteresis() -> None:
    """From other gains to those of the record; a model without hysteresis leaves several times the
    noise.
    """
    model = hysteretic("elbow")
    run = flexgen.command_positions(model, progress=False).today
    joints = np.linalg.inv(model.eta).T
    true = run.law
    sent = run.reference.motion["q_m"] @ joints
    shown = run.nominal.measured @ joints
    record = flexgen.ServoRecord(run.reference.time, sent, shown)
    first = flexgen.Cascade(
        1.3 * true.position_gain, 0.8 * true.speed_gain, 1.2 * true.integral_gain
    )
    fit = flexgen.identify_servo(model, record, servo=flexgen.Servo(first), progress=False)
    for name in ("position_gain", "speed_gain", "integral_gain"):
        np.testing.assert_allclose(
            getattr(fit.servo.feedback, name), getattr(true, name), rtol=1e-6
        )
    plain = flexgen.identify_servo("elbow", record, servo=flexgen.Servo(first), progress=False)
    assert fit.is_explained and not plain.is_explained
