"""Gears identified from records of robots in MuJoCo, whose hysteresis and Fourier sums are laws of
the tests.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bristled import Bristles, tables
from gear_records import motor_record, record_in_mujoco, with_noise
from harmonic import COGGING, ERROR, law_with_sums
from hysteretic import (
    ARCMIN,
    SLIPS,
    Element,
    Elements,
    hysteretic,
    joint_stiffness,
    law_of_gears,
    with_lost_motion,
)
from measured_numbers import check_numbers
from toolchain import needs_compiler

import flexgen
from flexgen.cli.main import main
from flexgen.exports.mujoco.mujoco_checks import with_friction
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.records.motor_record import read_motor_record

pytestmark = needs_compiler
NOISE = 1e-4  # rad, motor side
CLOSE = 0.05  # of the true numbers, as demanded


def hysteretic_record(name: str, seconds: float, **options: Any) -> flexgen.Trajectory:
    """Of a robot whose gears have 1 arcmin of lost motion."""
    pytest.importorskip("mujoco")
    return record_in_mujoco(
        name, lambda start: with_lost_motion(name, ARCMIN, start), seconds, **options
    )


def harmonic_record(seconds: float, **options: Any) -> flexgen.Trajectory:
    """Of planar5_nmp with transmission errors and cogging."""
    pytest.importorskip("mujoco")
    law = law_with_sums("planar5_nmp", ripple=0.0)
    return record_in_mujoco(
        "planar5_nmp", lambda _: (law, lambda q_g, q_m: None), seconds, **options
    )


def model_of(name: str, **overrides: Any) -> flexgen.RobotModel:
    return with_friction(flexgen.read(name, overrides=overrides or None), "viscous")


@pytest.fixture(scope="module")
def short() -> flexgen.Trajectory:
    return hysteretic_record("planar5_nmp", 12.0, step=5e-4)


def check_hysteresis(found: flexgen.GearFit) -> None:
    """Numbers within 5 %, and as far from the truth as their standard deviations say."""
    assert found.status is FitStatus.FITTED, str(found)
    for joint in found.joints:
        name = f"{joint}.hysteresis.lost_motion"
        assert found.values[name] == pytest.approx(ARCMIN, rel=CLOSE)
        assert abs(found.values[name] - ARCMIN) < 4 * found.sd[name] + 2e-3 * ARCMIN


@pytest.mark.slow
def test_noise_that_hides_a_gear_is_not_a_model_error() -> None:
    """Stiff gears with light rotors: 12 s show both through noise of 1e-4 rad, poorly through 1e-3
    rad.
    """
    record = hysteretic_record("elbow", 12.0, step=5e-4)
    model = model_of("elbow")
    found = flexgen.identify_gears(model, with_noise(record, 10 * NOISE), progress=False)
    assert found.status in (FitStatus.NOISE_TOO_LARGE, FitStatus.FITTED)
    wide = {
        x.name: x
        for x in found.numbers
        if found.status is FitStatus.FITTED and x.name.endswith("lost_motion")
    }
    assert all(abs(number.value - ARCMIN) < 3 * number.sd for number in wide.values())
    found = flexgen.identify_gears(model, with_noise(record, NOISE), progress=False)
    assert found.status is FitStatus.FITTED
    assert found.values["q1.hysteresis.lost_motion"] == pytest.approx(ARCMIN, rel=CLOSE)
    sd = found.sd["q2.hysteresis.lost_motion"]
    assert sd is not None and abs(found.values["q2.hysteresis.lost_motion"] - ARCMIN) < 3 * sd
    assert all(number.sd > 1.2 * (found.sd[name] or np.inf) for name, number in wide.items())


@pytest.mark.slow
def test_twelve_seconds_without_noise_give_the_loop(
    short: flexgen.Trajectory, tmp_path: Path
) -> None:
    found = flexgen.identify_gears(model_of("planar5_nmp"), short, progress=False)
    check_hysteresis(found)
    assert found.values["q1.stiffness"] == pytest.approx(4e5, rel=2e-3)
    assert abs(found.delay_s) < 1e-5
    again = flexgen.read(f"{found.save(tmp_path / 'arm.toml')}@identified")
    gear = again.elements[0].dofs[0].gear
    assert gear is not None and gear.hysteresis is not None
    assert gear.hysteresis.lost_motion == found.values["q1.hysteresis.lost_motion"]
    assert found.model.elements[0].dofs[0].gear == gear


@pytest.mark.slow
def test_a_rigid_gear_next_to_an_elastic_one_stays_rigid() -> None:
    """The transmission error of the elastic gear alone, from the closed loop of such a robot."""
    rigid = {"element.fore.dof.q2.gear": {"type": "rigid"}}
    error = {"element.upper.dof.q1.gear.transmission_error": {"harmonics": [1], "sin": [4e-5]}}
    record = flexgen.control(
        model_of("elbow", **rigid, **error), sample_time=1e-3, progress=False
    ).trajectory()
    found = flexgen.identify_gears(
        model_of("elbow", **rigid), record, hysteresis=False, harmonics=[1], progress=False
    )
    assert found.values["q1.transmission_error.sin_1"] == pytest.approx(4e-5, rel=1e-2)
    assert not any(name.startswith("q2") for name in found.values)
    figures = {
        name: found.values[f"q1.{name}"] for name in ("stiffness", "transmission_error.sin_1")
    }
    check_numbers(
        "gear_error", 1e-2, figures=figures, unexplained=found.unexplained, band_hz=found.band_hz
    )


@pytest.mark.slow
def test_quiet_torques_of_a_tree_give_springs_within_their_deviations() -> None:
    """The steps of the simulation leave 1e-6 of the torques, more than the noise: 20 deviations of
    a damping.
    """
    pytest.importorskip("mujoco")
    none = (lambda q_g, v_g, q_m, v_m, tau: (0.0 * q_g, 0.0 * q_m, tau), lambda q_g, q_m: None)
    record = with_noise(record_in_mujoco("two_arm", lambda _: none, 40.0), 1e-5)
    found = flexgen.identify_gears(
        model_of("two_arm"), record, joints=["r1", "l2"], hysteresis=False, progress=False
    )
    assert found.status is FitStatus.FITTED and found.sd is not None
    true = {"r1.stiffness": 1e5, "r1.damping": 60.0, "l2.stiffness": 5e4, "l2.damping": 30.0}
    for name, value in true.items():
        assert abs(found.values[name] - value) < 3.0 * found.sd[name], name
    assert found.sd["r1.stiffness"] < 1e-3 * 1e5


def record_of_elements(elements: Sequence[Element], seconds: float) -> flexgen.Trajectory:
    """Of planar5_nmp whose first gear has these elements of hysteresis, and whose second has
    none.
    """
    pytest.importorskip("mujoco")
    K = joint_stiffness(flexgen.read("planar5_nmp")) * [1.0, 1e-9]
    made = lambda start: law_of_gears("planar5_nmp", Elements(elements, K, start))  # noqa: E731
    return record_in_mujoco("planar5_nmp", made, seconds, step=5e-4)


@pytest.mark.slow
def test_elements_are_found_one_by_one(tmp_path: Path) -> None:
    """Each within 1 %, their sums within 0.2 %, and written as a list of tables."""
    record = record_of_elements(SLIPS, 9.0)
    found = flexgen.identify_gears(
        model_of("planar5_nmp"), record, joints=["q1"], elements=3, progress=False
    )
    assert found.status is FitStatus.FITTED, str(found)
    assert found.values["q1.hysteresis.lost_motion"] == pytest.approx(ARCMIN, rel=2e-3)
    assert found.values["q1.hysteresis.stiffness"] == pytest.approx(4e5, rel=2e-3)
    gear = flexgen.read(f"{found.save(tmp_path / 'arm.toml')}@identified").elements[0].dofs[0].gear
    assert gear is not None and isinstance(gear.hysteresis, tuple)
    for given, each in zip(SLIPS, gear.hysteresis, strict=True):
        assert each.lost_motion == pytest.approx(given.lost * ARCMIN, rel=1e-2)
        assert each.stiffness == pytest.approx(given.stiffness * 4e5, rel=1e-2)
    assert found.loops.shape[1:] == (1, 3)


@pytest.mark.slow
def test_an_exponent_is_found_and_dahls_law_is_a_model_error_there() -> None:
    record = record_of_elements([Element(1.0, 0.7, 6.0)], 8.0)
    found = flexgen.identify_gears(
        model_of("planar5_nmp"), record, joints=["q1"], exponents=True, progress=False
    )
    assert found.status is FitStatus.FITTED, str(found)
    assert found.values["q1.hysteresis.exponent"] == pytest.approx(6.0, rel=1e-2)
    assert found.values["q1.hysteresis.lost_motion"] == pytest.approx(ARCMIN, rel=2e-3)
    assert (
        found.changes["element.arm1.dof.q1.gear.hysteresis"]["exponent"]
        == found.values["q1.hysteresis.exponent"]
    )
    planted = flexgen.identify_gears(
        model_of("planar5_nmp"), record, joints=["q1"], progress=False
    )
    assert planted.status is FitStatus.MODEL_ERROR


@pytest.mark.full
@pytest.mark.parametrize(("elements", "seed"), [(2, 1), (2, 3), (3, 1), (3, 3)])
def test_two_elements_for_three_are_a_model_error(elements: int, seed: int) -> None:
    """They explain the residuals but for the noise, with a lost motion that is 4 to 5 % and 6 to 8
    deviations off.
    """
    made = lambda start: law_of_gears(  # noqa: E731
        "planar5_nmp", Elements(SLIPS, joint_stiffness(flexgen.read("planar5_nmp")), start)
    )
    record = with_noise(
        record_in_mujoco("planar5_nmp", made, 20.0, step=5e-4, seed=7), NOISE, seed
    )
    found = flexgen.identify_gears(
        model_of("planar5_nmp"), record, elements=elements, progress=False
    )
    if elements == 2:
        assert found.status is FitStatus.MODEL_ERROR and found.lacking == ("q1",)
        assert "q1. Fit one element more" in found.problem and set(found.sd.values()) == {None}
        return
    assert found.status is FitStatus.FITTED, str(found)
    for joint in found.joints:
        name = f"{joint}.hysteresis.lost_motion"
        assert found.sd[name] is not None and abs(found.values[name] - ARCMIN) < 4 * found.sd[name]


@pytest.mark.slow
@pytest.mark.parametrize(
    "seconds", [20.0, *(pytest.param(x, marks=pytest.mark.full) for x in (30.0, 60.0))]
)
def test_a_record_with_noise_gives_the_loop(seconds: float) -> None:
    record = with_noise(hysteretic_record("planar5_nmp", seconds, step=5e-4), NOISE)
    check_hysteresis(flexgen.identify_gears(model_of("planar5_nmp"), record, progress=False))


@pytest.mark.slow
def test_noise_in_the_loop_of_the_drives_leaves_the_loop_of_the_gears() -> None:
    """Drives make 10 % of their torques of noise of 1e-4 rad, which shakes the gears above the
    band of the motion.
    """
    record = hysteretic_record("planar5_nmp", 20.0, step=5e-4, seed=2, noise=NOISE)
    check_hysteresis(flexgen.identify_gears(model_of("planar5_nmp"), record, progress=False))


def sticking_record(seconds: float) -> flexgen.Trajectory:
    """Of planar5_nmp with 1 arcmin of lost motion, whose motors stick within 1e-3 rad at a Coulomb
    friction.
    """
    pytest.importorskip("mujoco")
    numbers = {
        motor: row | {"static": row["coulomb"]}
        for motor, row in tables("planar5_nmp", 0.3).items()
    }

    def made(start: np.ndarray) -> tuple[Any, Any]:
        law, kept = with_lost_motion("planar5_nmp", ARCMIN, start)
        friction: list[Bristles] = []

        def torques(q_g: Any, v_g: Any, q_m: np.ndarray, v_m: np.ndarray, tau: np.ndarray) -> Any:
            joints, rotors, given = law(q_g, v_g, q_m, v_m, tau)
            return joints, rotors - friction[0].torque(q_m, v_m), given

        def keep(q_g: np.ndarray, q_m: np.ndarray) -> None:
            kept(q_g, q_m)
            if not friction:  # where the motion begins
                friction.append(Bristles(numbers, q_m.copy()))
            friction[0].keep(q_m)

        return torques, keep

    return record_in_mujoco("planar5_nmp", made, seconds)


@pytest.mark.slow
def test_motors_that_stand_still_under_coulomb_friction_leave_the_loop() -> None:
    """Friction is any torque there; as one that follows the speed alone it was a model error, 2 %
    of the torques.
    """
    record = with_noise(sticking_record(20.0), NOISE)
    check_hysteresis(flexgen.identify_gears(model_of("planar5_nmp"), record, progress=False))


@pytest.mark.full
def test_a_minute_of_six_axes_with_noise_gives_the_loop() -> None:
    record = with_noise(hysteretic_record("manutec_r3_18", 60.0), NOISE)
    check_hysteresis(flexgen.identify_gears(model_of("manutec_r3_18"), record, progress=False))


@pytest.mark.full
def test_a_third_of_a_minute_with_noise_gives_the_harmonics() -> None:
    """Transmission errors and cogging within 0.5 %, and no hysteresis where none is."""
    record = with_noise(harmonic_record(20.0), NOISE)
    given = {"harmonics": ERROR["harmonics"], "cogging": COGGING["harmonics"]}
    found = flexgen.identify_gears(model_of("planar5_nmp"), record, progress=False, **given)
    assert found.status is FitStatus.FITTED, str(found)
    sums = {f"{q}.transmission_error": ERROR for q in ("q1", "q2")} | {
        f"{m}.cogging": COGGING for m in ("m1", "m2")
    }
    for name, table in sums.items():
        for part in ("cos", "sin"):
            for k, value in zip(table["harmonics"], table[part], strict=True):
                assert found.values[f"{name}.{part}_{k}"] == pytest.approx(value, rel=CLOSE)
    assert not any("hysteresis" in key for key in found.changes)


# --- wrong models: no number with a false interval -----------------------------------------------


@pytest.mark.slow
def test_a_wrong_payload_is_a_model_error(short: flexgen.Trajectory) -> None:
    wrong = model_of("planar5_nmp", **{"element.arm3.body.mass": 28.0})
    found = flexgen.identify_gears(wrong, short, progress=False)
    assert found.status is FitStatus.MODEL_ERROR and "wrong mass" in found.problem
    assert set(found.sd.values()) == {None}


@pytest.mark.full
def test_a_planted_gear_whose_motor_does_not_feel_it_is_a_model_error() -> None:
    """A law of another robot: the hysteresis acts on the joints alone."""
    pytest.importorskip("mujoco")

    def made(start: np.ndarray) -> tuple[Any, Any]:
        law, kept = with_lost_motion("planar5_nmp", ARCMIN, start)
        return (lambda *given: (law(*given)[0], 0.0 * law(*given)[1], law(*given)[2])), kept

    record = record_in_mujoco("planar5_nmp", made, 12.0, step=5e-4)
    found = flexgen.identify_gears(model_of("planar5_nmp"), record, progress=False)
    assert found.status is not FitStatus.FITTED


# --- the command line and bad input --------------------------------------------------------------


@pytest.mark.slow
def test_the_command_writes_a_model(
    short: flexgen.Trajectory,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    short.save("record.csv")
    words = [
        "identify-gears",
        "planar5_nmp",
        "record.csv",
        "--joints",
        "q1",
        "--out",
        "arm.toml",
        "--report",
        "page",
    ]
    assert main([*words, "--free", "q1.stiffness,q1.damping", "--json", "--quiet"]) in (0, 1)
    out = json.loads(capsys.readouterr().out)
    assert out["status"] == "model error"  # q2 has a hysteresis that is not fitted
    assert (tmp_path / "page").is_dir()


@pytest.mark.slow
def test_what_cannot_be_used_is_refused(short: flexgen.Trajectory) -> None:
    model = model_of("planar5_nmp")
    n = len(short.time)
    few = motor_record(model, short.time[:200], short["q_m"][:200], short["tau_m"][:200])
    late = motor_record(
        model, np.sort(short.time + 3e-4 * np.sin(np.arange(n))), short["q_m"], short["tau_m"]
    )
    read = read_motor_record(model, late)  # stamps that scatter about equal steps
    assert "time stamps scatter by 0.2" in read.notes[0]
    assert np.abs(read.trajectory["q_m"] - short["q_m"]).max() < 1e-9
    still = motor_record(model, short.time, short["q_m"] * [1.0, 0.0], short["tau_m"])
    for record, text in (
        (few, r"given 0.199 s, expected at least"),
        (still, "given motor 2 at rest, expected that all motors move"),
    ):
        with pytest.raises(flexgen.ArgumentError, match=text):
            flexgen.identify_gears(model, record, progress=False)
    for given, text in (
        ({"joints": ["q3"]}, r"joints: given \['q3'\], expected some of q1, q2"),
        (
            {"harmonics": [0]},
            r"harmonics: given \[0\], expected at most 64 different whole numbers from 1 to 1000",
        ),
        ({"harmonics": [2, 2]}, "harmonics: given"),
        ({"cogging": [1.5]}, "cogging: given"),
        ({"elements": 0}, "elements: given 0, expected a whole number from 1 to 8"),
        ({"band_hz": 400.0}, "band_hz: given 400.0, expected a number > 0, at most 50 Hz"),
        ({"free": ["nosuch"]}, "nosuch"),
    ):
        with pytest.raises(flexgen.ArgumentError, match=text):
            flexgen.identify_gears(model, short, progress=False, **given)
    both = hysteretic("planar5_nmp")
    with pytest.raises(
        flexgen.ArgumentError, match="given a fit without that of q1, which planar5_nmp has"
    ):
        flexgen.identify_gears(both, short, joints=["q2"], progress=False)
    with pytest.raises(flexgen.ArgumentError, match="given a fit without that of q1, q2"):
        flexgen.identify_gears(both, short, hysteresis=False, progress=False)
    with pytest.raises(flexgen.ArgumentError, match="given 2 columns of q_m, expected 6"):
        flexgen.identify_gears("manutec_r3", short, progress=False)
