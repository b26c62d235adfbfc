"""Rigid fits of arms whose gears bend, and of torques that are late: records by the exact inverse
of elastic gears.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from rigid_records import (
    COULOMB,
    DAMPING,
    OFFSET,
    STIFFNESS,
    VISCOUS,
    H,
    derivative,
    recorded,
    soft,
)

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.low_pass import LowPass, bandwidth
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.rigid.rigid_body import RigidFit, identify_rigid
from flexgen.identification.rigid.rigid_columns import Columns, band_of
from flexgen.identification.rigid.rigid_file import RigidIdentification
from flexgen.identification.rigid.rigid_regressor import Motion, Regressor
from flexgen.model.elements import RobotModel

ROOT = Path(__file__).resolve().parents[2]


def check(found: RigidFit, compliance: np.ndarray, late: float, other: Motion) -> None:
    """Numbers within four deviations, which are small; the torques of a motion that was not
    fitted.
    """
    assert found.status == FitStatus.FITTED and found.lags_sd is not None
    away = (found.lags - np.append(compliance, late)) / found.lags_sd
    assert (
        (np.abs(away) < 4).all()
        and (found.lags_sd[:2] < 0.1 / STIFFNESS).all()
        and found.lags_sd[2] < 2e-4
    )
    sd = np.sqrt(np.diag(found.covariance))[len(found.pi) :][: found.friction.size].reshape(2, -1)
    ratio = np.abs(np.diag(found.file.eta))
    for column, true in enumerate((VISCOUS * ratio, COULOMB, OFFSET)):
        assert (np.abs(found.friction[:, column] - true) < 4 * sd[:, column]).all()
    assert (found.relative_errors(other) < 0.003).all()


SLOW = pytest.mark.slow
CASES = [
    ("too stiff", 6e-3),
    pytest.param("right", 0.0, marks=SLOW),
    pytest.param("rigid", 0.0, marks=SLOW),
]


@pytest.mark.parametrize("file, late", CASES)
def test_gears_that_the_file_leaves_out_and_late_torques_are_found(file: str, late: float) -> None:
    model = {
        "right": soft(),
        "too stiff": soft(1.5 * STIFFNESS),
        "rigid": flexgen.read("elbow@rigid"),
    }[file]
    missing = {"right": 0.0, "too stiff": 1 / 3, "rigid": 1.0}[file] / STIFFNESS
    # of what is missing in the file nothing is known
    damping = DAMPING if file == "right" else 0.01 * DAMPING
    found = identify_rigid(model, [recorded(late, 0.05, k, damping) for k in range(2)], parts=2)
    check(found, missing, late, recorded(late, 0.0, 7, damping))
    answer = RigidIdentification(found, {}, {}, "")
    text = answer.to_text().replace("\n", " ")
    assert ("Gears of q1, q2 deflect otherwise than in the model file" in text) == (
        file != "right"
    )
    assert "q1.compliance" in text and f"below {found.limit_hz:.3g} Hz" in text
    data = answer.to_dict()
    assert [lag["name"] for lag in data["lags"]] == ["q1.compliance", "q2.compliance", "delay"]
    assert [lag["unit"] for lag in data["lags"]] == ["rad/(N m)", "rad/(N m)", "s"]
    assert data["lags"][2]["value"] == found.lags[2] and data["limit_hz"] == found.limit_hz


@pytest.mark.slow
@pytest.mark.parametrize(
    "late, status", [(0.05, FitStatus.NOT_CHECKED), (0.3, FitStatus.MODEL_ERROR)]
)
def test_long_delays_are_found_or_refused(late: float, status: FitStatus) -> None:
    """Some samples are found in a few rounds more; a third of a second of motions of 0.2 to 1.4 Hz
    is none of them.
    """
    found = identify_rigid(soft(), [recorded(late, 0.02)], parts=0)
    assert found.status == status
    if status == FitStatus.NOT_CHECKED:
        assert found.lags[2] == pytest.approx(late, abs=1e-3)


@pytest.mark.parametrize("motors", [[1], pytest.param([0, 1], marks=SLOW)])
def test_friction_that_falls_with_speed_is_found(motors: list[int], tmp_path: Path) -> None:
    """Numbers within four deviations, also from the new model file; without it nothing of the kind
    is found.
    """
    model = soft()
    plain = recorded(noise=0.02)
    size = np.array([0.3, 0.4]) * [k in motors for k in (0, 1)]
    alpha = np.array([1 / 25.0, 1 / 40.0])
    w = derivative(plain.q, 1) @ model.eta.T
    more = size / np.cosh(alpha * w) * np.tanh(w / np.abs(np.diag(model.eta)) / 5e-4)
    motion = replace(plain, tau_m=plain.tau_m + more)
    found = identify_rigid(model, [motion], parts=2)
    assert found.status == FitStatus.FITTED and found.mistake is None
    assert np.flatnonzero(found.fades).tolist() == motors
    answer = RigidIdentification(found, {}, {}, "")
    answer.write(tmp_path / "found.toml")
    assert "stribeck, N m" in answer.to_text() and "alpha, s/rad" in answer.to_text()
    true = {
        "viscous": VISCOUS,
        "coulomb": COULOMB,
        "offset": OFFSET,
        "stribeck": size,
        "alpha": alpha,
    }
    # the springs of `soft` are overrides: numbers and overrides are a variant of the file
    robot = flexgen.read(tmp_path / "found.toml", "identified")
    assert robot.overrides == {}
    springs = [element.dofs[0].gear.spring.stiffness for element in robot.elements]
    assert springs == STIFFNESS.tolist()
    written = robot.motors
    for j in motors:
        for name, value in true.items():
            key = f"{written[j].name}.{name}"
            assert abs(answer.numbers[key] - value[j]) < 4 * answer.deviations[key]
            # weight is like an offset
            assert name == "offset" or 4 * answer.deviations[key] < 0.1 * value[j]
            assert getattr(written[j].friction, name) == pytest.approx(
                answer.numbers[key], rel=1e-5
            )
    assert (found.relative_errors(motion) < 0.003).all()
    gear = found.gear_torques(motion) - identify_rigid(model, [plain], parts=0).gear_torques(plain)
    assert np.abs(gear[50:-50]).max() < 0.1 * (size * np.abs(np.diag(model.eta))).max()
    assert not identify_rigid(model, [plain], parts=0).fades.any()


def test_a_new_file_keeps_no_friction_that_the_fit_did_not_find(tmp_path: Path) -> None:
    """Friction that falls with speed in the old file, and none in the recording."""
    law = "\nfriction = { coulomb = 0.1, beta = 10.0, stribeck = 0.2, alpha = 0.04 }\n"
    text = (ROOT / "models" / "elbow.toml").read_text()
    (tmp_path / "old.toml").write_text(text.replace("[[motor]]", f"[[motor]]{law}"))
    RigidIdentification(
        identify_rigid(flexgen.read(tmp_path / "old.toml"), [recorded()], parts=0), {}, {}, ""
    ).write(tmp_path / "new.toml")
    for motor, coulomb in zip(flexgen.read(tmp_path / "new.toml").motors, COULOMB, strict=True):
        assert motor.friction.stribeck == 0.0 and motor.friction.coulomb == pytest.approx(
            coulomb, rel=0.05
        )


def other_gravity(model: RobotModel, motion: Motion) -> Motion:
    """The torques where the base hangs from the ceiling."""
    more = Regressor(replace(model, gravity=(0.0, 0.0, 2 * 9.81)))
    torque = more(motion.q, 0 * motion.q, 0 * motion.q) @ more.of_model()
    return replace(motion, tau_m=motion.tau_m + torque @ np.linalg.inv(model.eta))


@pytest.mark.parametrize(
    "mistake, words, value",
    [
        ("torque", "torques of m2 times", 1.2),
        pytest.param("ratio", "a ratio of the gear of q1 times", 1 / 0.9, marks=SLOW),
        pytest.param(
            "gravity", "gravity along z of the base [m/s^2] more by", 2 * 9.81, marks=SLOW
        ),
    ],
)
def test_one_mistake_in_the_recording_or_the_file_is_named(
    mistake: str, words: str, value: float
) -> None:
    """It explains the errors, and the fit has no deviations."""
    model = soft()
    motion = recorded(noise=0.02)
    if mistake == "torque":
        motion = replace(motion, tau_m=motion.tau_m * [1.0, 1.2])
    # that of q2 is larger in the file than in the robot, and so its angles are too small
    elif mistake == "ratio":
        motor = model.motors[1]
        model = replace(
            model, motors=(model.motors[0], replace(motor, ratio=(motor.ratio[0] / 0.9,)))
        )
        motion = replace(motion, q=motion.q * [1.0, 0.9])
    else:
        motion = other_gravity(model, motion)
    found = identify_rigid(model, [motion], parts=0)
    assert (
        found.status == FitStatus.MODEL_ERROR
        and found.mistake is not None
        and found.numbers_sd is None
    )
    # only quotients of the two motors act: as good, but for rounding
    if found.mistake.what == "torques of m1 times":
        words = found.mistake.what
        value = 1 / value
    near = 2.0 if mistake == "gravity" else 0.15  # to first order
    assert found.mistake.what == words and found.mistake.value == pytest.approx(value, rel=near)
    answer = RigidIdentification(found, {}, {}, "")
    assert found.mistake.sentence in answer.to_text().replace("\n", " ")
    assert answer.to_dict()["mistake"]["what"] == words


def test_the_torque_changes_with_lags_as_its_columns() -> None:
    """By differences of the whole torque."""
    model = soft()
    motion = recorded()
    regressor = Regressor(model)
    pi = regressor.of_model()
    friction = np.arange(8.0).reshape(2, 4) / 8
    lags = np.array([1e-7, 2e-7, H / 2])
    whole = Columns(regressor, [motion], {})
    limit = band_of(regressor, [motion])

    def torque(x: np.ndarray) -> np.ndarray:
        return whole.bent(pi, friction, x, limit).torques(pi, friction)[0]

    bent = whole.bent(pi, friction, lags, limit)
    for k in range(2):
        step = 1e-8 * (np.arange(3) == k)
        change = (torque(lags + step) - torque(lags - step)) / 2e-8
        assert_allclose(bent.Z[0][:, :, k], change, atol=1e-3 * np.abs(change).max())
    inner = slice(50, -50)
    tau = {k: np.roll(torque(lags), k, axis=0) for k in (-3, -2, -1, 1, 2, 3)}
    # of sixth order
    late = (45 * (tau[1] - tau[-1]) - 9 * (tau[2] - tau[-2]) + tau[3] - tau[-3]) / (60 * H)
    assert_allclose(bent.Z[0][inner, :, 2], late[inner], atol=2e-4 * np.abs(late).max())
    at = bent.measured[0][inner]
    # half a sample later
    mean = (motion.torques[inner] + np.roll(motion.torques, -1, axis=0)[inner]) / 2
    assert_allclose(at, mean, atol=0.02 * np.abs(np.diff(motion.torques, axis=0)).max())


def test_band_and_filter() -> None:
    """Sines far below and above the limit; the band of two sines; a limit of 5 times the band, or
    none.
    """
    t = 1e-3 * np.arange(4000)
    low = np.sin(2 * np.pi * 1.5 * t)
    high = np.sin(2 * np.pi * 17.0 * t)
    keep = LowPass(1e-3, 8.0)
    found = keep(np.stack([low, high], axis=1))
    assert_allclose(found[:, 0], keep.kept(low), atol=2e-3)  # ripples of -60 dB
    assert (
        np.abs(found[:, 1]).max() < 2e-3
        and keep.every == 12
        and len(found) == (4000 - 2 * keep.half + 11) // 12
    )
    assert_allclose(keep.kept(keep.whole(np.stack([low, high], axis=1))), found, atol=1e-12)
    assert_allclose(LowPass(1e-3, 8.0)(np.ones(2000)), 1.0)
    assert bandwidth([low + 0.2 * high, low[:3000]], 1e-3) == pytest.approx(17.0, abs=0.6)
    assert bandwidth([low + 0.02 * high], 1e-3) == pytest.approx(1.5, abs=0.6)
    motion = recorded()
    assert band_of(Regressor(soft()), [motion]) == pytest.approx(5 * 1.4, rel=0.15)
    short = Motion(motion.t[:300], motion.q[:300], motion.tau_m[:300])
    assert band_of(Regressor(soft()), [motion, short]) == pytest.approx(4 * 3.0 / (300 * H))
    assert (
        band_of(Regressor(soft()), [Motion(short.t[:180], short.q[:180], short.tau_m[:180])])
        == np.inf
    )


def test_motions_have_one_sample_time() -> None:
    motion = recorded()
    other = Motion(1.5 * motion.t, motion.q, motion.tau_m)
    with pytest.raises(
        ArgumentError, match=r"given samples every 0.006 s, expected 0.004 s as in the first one$"
    ):
        identify_rigid(soft(), [motion, other])
