"""A model against a record of motion: an oscillator on a slide in closed form, the rules for small
signals, windows and lags, and logs of libfranka.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from panda import FLANGE, LOWER, TABLE, UPPER, panda_urdf
from scipy.spatial.transform import Rotation
from slide import OFFSET, SLIDE, STEP, TIP, shaken

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.identification.records import libfranka

NOISE = 0.02  # N
LAG = 0.008  # s


@pytest.fixture
def slide(tmp_path) -> Path:
    path = tmp_path / "slide.toml"
    path.write_text(SLIDE, encoding="utf-8")
    return path


def test_oscillator_on_a_slide_is_predicted_with_lag_and_offset(slide):
    found = flexgen.compare_record(slide, shaken(LAG, NOISE), window=(1.1, 3.9))
    (score,) = found.scores
    assert score.r2_lag == pytest.approx(1 - (NOISE / score.signal) ** 2, abs=2e-4)
    assert score.r2 < score.r2_lag
    assert found.lag_s == pytest.approx(LAG, abs=2e-4)
    assert score.offset == pytest.approx(OFFSET, abs=NOISE)
    assert score.noise == pytest.approx(NOISE, rel=0.3)
    assert score.rms_lag == pytest.approx(NOISE, rel=0.1)
    assert score.largest_lag < 5 * NOISE


def test_a_wrong_stiffness_is_seen_and_a_given_lag_is_kept(slide):
    """The planted error: a spring that is 10 % stiffer."""
    wrong = flexgen.read(
        slide, overrides={"element.tip.dof.sway.spring.stiffness": 1.1 * TIP * 18.85**2}
    )
    right = flexgen.compare_record(slide, shaken(), window=(1.1, 3.9), lag=0.0)
    found = flexgen.compare_record(wrong, shaken(), window=(1.1, 3.9), lag=0.0)
    assert (found.lag_s, found.is_lag_fitted) == (0.0, False)
    assert found.scores[0].r2 < 0.5 < 0.999 < right.scores[0].r2


def test_no_score_is_printed_below_the_noise(slide):
    record = shaken(noise=NOISE)
    quiet = flexgen.JointRecord(
        record.time, record.angle, OFFSET + NOISE * np.ones_like(record.torque), ("q1",)
    )
    noise = np.random.default_rng(2).normal(size=record.torque.shape)
    for torque, smallest in ((quiet.torque, 0.0), (noise, 0.0), (record.torque, 1e3)):
        given = flexgen.JointRecord(record.time, record.angle, torque, ("q1",))
        found = flexgen.compare_record(slide, given, window=(1.1, 3.9), smallest=smallest)
        assert (found.scores[0].is_predicted, found.lag_s) == (False, None)
        entry = found.to_dict()["channels"][0]
        assert {entry[key] for key in ("r2", "rms", "largest", "r2_lag", "offset")} == {None}
        assert "small motions: not predicted: torque of q1" in found.to_text()


def test_a_lag_at_the_end_of_its_search_is_not_stated(slide):
    found = flexgen.compare_record(slide, shaken(lag=0.08), window=(1.1, 3.9))
    assert found.lag_s is None
    assert found.scores[0].r2_lag is None
    assert found.scores[0].r2 is not None


def test_the_window_does_not_change_the_motion_within_it(slide):
    """The low pass runs over the whole record; one that ended at the window would bend it."""
    record = shaken()
    whole = record.motion(25.0)
    cut = flexgen.JointRecord(
        *(x[1100:2900] for x in (record.time, record.angle, record.torque)), ("q1",)
    )
    inside = np.arange(1.1, 2.89, STEP)
    apart = np.abs(whole.at(inside)[2] - cut.motion(25.0).at(inside)[2]).ravel()
    edge = whole.edge
    middle = (inside > 1.1 + edge) & (inside < 2.89 - edge)
    assert apart[middle].max() < 1e-6
    wide = flexgen.compare_record(slide, record)
    narrow = flexgen.compare_record(slide, record, window=(1.5, 2.5))
    rows = (wide.time >= 1.5) & (wide.time <= 2.5)
    assert wide.lag_s == pytest.approx(narrow.lag_s, abs=1e-3)
    assert wide.measured[rows] == pytest.approx(narrow.measured)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"window": (0.0, 2.0)}, "the low pass reaches beyond"),
        ({"window": (2.0, 1.0)}, "two increasing times"),
        ({"window": (1.0,)}, "expected two: begin and end"),
        ({"window": (1.5, 1.51)}, "expected at least 50"),
        ({"limit_hz": 450.0}, "0.4 of the sample rate"),
        ({"about": "sway"}, "expected at least 6"),
        ({"about": "q1"}, "a coordinate without motor behind all joints"),
        ({"columns": ["t"]}, "expected the name of a .csv file"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(slide, change, words):
    with pytest.raises(ArgumentError, match=words):
        flexgen.compare_record(slide, shaken(), **change)


def test_records_that_begin_in_motion_or_have_gaps_are_refused(slide):
    record = shaken()
    late = flexgen.JointRecord(
        *(x[700:] for x in (record.time, record.angle, record.torque)), ("q1",)
    )
    with pytest.raises(ArgumentError, match="joints that move at the begin"):
        flexgen.compare_record(slide, late)
    kept = np.delete(np.arange(len(record.time)), slice(1000, 1030))
    holes = flexgen.JointRecord(
        record.time[kept], record.angle[kept], record.torque[kept], ("q1",)
    )
    with pytest.raises(ArgumentError, match=r"a gap of 0\.031 s at 0\.999 s"):
        flexgen.compare_record(slide, holes)
    with pytest.raises(ArgumentError, match="given the joints q2, expected q1"):
        flexgen.compare_record(
            slide, flexgen.JointRecord(record.time, record.angle, record.torque, ("q2",))
        )
    with pytest.raises(ArgumentError, match="times that increase"):
        flexgen.JointRecord(record.time[::-1], record.angle, record.torque, ("q1",))


def test_single_lost_samples_change_nothing(slide):
    record = shaken()
    kept = np.delete(np.arange(len(record.time)), [900, 901, 1500, 2000, 2001, 2002])
    lost = flexgen.JointRecord(record.time[kept], record.angle[kept], record.torque[kept], ("q1",))
    found = flexgen.compare_record(slide, lost, window=(1.1, 3.9))
    assert found.scores[0].r2 > 0.9999


def test_the_move_of_a_record_goes_through_its_joints(slide, tmp_path):
    record = shaken()
    move = record.save_move(tmp_path / "samples.npz")
    path = flexgen.plan(slide, move)
    assert path.duration == pytest.approx(record.time[-1], abs=2 * STEP)
    at = np.array([0.5, 0.8, 1.5])
    assert path.sample(at).y[:, 0, 0] == pytest.approx(record.motion().spline(at)[:, 0], abs=1e-6)
    with pytest.raises(ArgumentError, match=r"ends in \.npz"):
        record.save_move(tmp_path / "samples.csv")


# --- logs of libfranka ---------------------------------------------------------------------------


def pose_of_flange(q: np.ndarray) -> np.ndarray:
    """Position [m] of the flange by Craig's convention of Denavit and Hartenberg."""
    T = np.eye(4)
    for (a, d, alpha), angle in zip(TABLE, q, strict=True):
        about_x = Rotation.from_euler("x", alpha).as_matrix()
        step = np.eye(4)
        step[:3, :3] = about_x @ Rotation.from_euler("z", angle).as_matrix()
        step[:3, 3] = about_x @ [0.0, 0.0, d] + [a, 0.0, 0.0]
        T = T @ step
    return T[:3, 3] + FLANGE * T[:3, 2]


@pytest.fixture
def panda(tmp_path) -> flexgen.RobotModel:
    (tmp_path / "panda.urdf").write_text(panda_urdf(), encoding="utf-8")
    return flexgen.read(tmp_path / "panda.urdf", base="link0", tip="flange")


def log_of(path: Path, rows: int = 300, commands: bool = False) -> dict[str, np.ndarray]:
    """Write a log as franka::logToCSV does; its arrays."""
    rng = np.random.default_rng(3)
    state = {name: rng.normal(size=(rows, 7)) for name in ("q", "q_d", "dq", "dq_d", "tau_J")}
    state["tau_ext_hat_filtered"] = rng.normal(size=(rows, 7))
    widths = {"q_d": 7, "dq_d": 7, "O_T_EE_d": 16, "O_dP_EE_d": 6, "tau_J_d": 7}
    command = {name: np.zeros((rows, n)) for name, n in widths.items()}
    if commands:
        command["q_d"] = rng.normal(size=(rows, 7))
    arrays = {f"state.{k}": x for k, x in state.items()}
    arrays |= {f"cmd.{k}": x for k, x in command.items()}
    names = ", ".join(f"{k}[{i}]" for k, x in arrays.items() for i in range(x.shape[1]))
    table = np.column_stack([np.arange(rows), np.ones(rows), *arrays.values()])
    np.savetxt(
        path, table, delimiter=",", fmt="%.9g", header=f"time, success_rate, {names}", comments=""
    )
    return arrays


def test_panda_has_the_flange_of_its_published_table(panda):
    rng = np.random.default_rng(4)
    forward = flexgen.derive(panda).function("forward_kinematics")
    for q in rng.uniform(LOWER, UPPER, (8, 7)):
        assert np.ravel(np.array(forward(q)[0])) == pytest.approx(pose_of_flange(q), abs=1e-12)


@pytest.mark.parametrize("commands", [False, True])
def test_logs_of_libfranka_are_read_as_they_are(panda, tmp_path, commands):
    arrays = log_of(tmp_path / "log.csv", commands=commands)
    record = flexgen.JointRecord.read(tmp_path / "log.csv", panda)
    assert record.joints == tuple(f"q{k}" for k in range(1, 8))
    assert record.time == pytest.approx(1e-3 * np.arange(300))
    assert record.angle == pytest.approx(arrays["state.q"], rel=1e-8)
    assert record.torque == pytest.approx(arrays["state.tau_J"], rel=1e-8)
    servo = flexgen.ServoRecord.read(tmp_path / "log.csv", panda)
    sent = arrays["cmd.q_d" if commands else "state.q_d"]
    assert servo.command == pytest.approx(sent, rel=1e-8)


def test_logs_of_another_robot_and_torn_logs_are_refused(panda, tmp_path):
    log_of(tmp_path / "log.csv")
    with pytest.raises(ArgumentError, match="a robot with 7 joints, expected 2, q1, q2"):
        flexgen.JointRecord.read(tmp_path / "log.csv", flexgen.read("elbow"))
    text = (tmp_path / "log.csv").read_text(encoding="utf-8")
    (tmp_path / "torn.csv").write_text(text.replace("state.tau_J[3]", "other"), encoding="utf-8")
    with pytest.raises(ArgumentError, match=r"without the column 'state.tau_J\[3\]'"):
        flexgen.JointRecord.read(tmp_path / "torn.csv", panda)
    assert not libfranka.is_log({"q1_deg": 0})


def test_a_table_with_units_is_read(tmp_path):
    rows = np.column_stack([np.arange(200.0), *np.ones((4, 200))])
    header = "time_ms,q1_deg,q2_deg,q1_torque_Nm,q2_torque_Nm"
    np.savetxt(tmp_path / "r.csv", rows, delimiter=",", header=header, comments="")
    record = flexgen.JointRecord.read(tmp_path / "r.csv", flexgen.read("elbow"))
    assert record.angle[0] == pytest.approx(np.radians([1.0, 1.0]))
    assert record.step == pytest.approx(1e-3)
    with pytest.raises(ArgumentError, match=r"expected a \.csv file that exists"):
        flexgen.JointRecord.read(tmp_path / "none.csv", flexgen.read("elbow"))
