"""Fits of motions part by part: means of periods, judgments by percent, whiteness and other
recordings, and outputs that are late.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from identification_cases import another, poses_of
from numpy.testing import assert_allclose
from scipy.interpolate import CubicSpline

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.dynamics.mechanics.parameters import select
from flexgen.identification.estimator import residuals as of_residuals
from flexgen.identification.estimator import validation
from flexgen.identification.estimator.minimize import Minimum
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.motions import motion_fit as fits
from flexgen.identification.motions.motion_fit import MotionRecord, Shooting
from flexgen.identification.records.description import read_description
from flexgen.identification.records.experiment_file import read_experiment
from flexgen.identification.records.recording_writer import RecordingWriter
from flexgen.identification.responses.parameters import ParameterVector

BENCH = Path(__file__).resolve().parents[2] / "examples" / "motor_bench" / "bench.toml"
H = 4e-3


HEAD = """\
model = "bench.toml"
period_s = 0.2
hold = "zoh"

[time]
name = "t"
unit = "s"

[[torque]]
motor = "m1"
name = "u"
unit = "N m"
side = "motor"

[[angle]]
motor = "m1"
name = "q"
unit = "rad"
side = "motor"
"""


def ended(converged: bool, bound: bool) -> Minimum:
    return Minimum(np.zeros(2), 1.0, 1.0, np.eye(2), 3, converged, np.array([False, bound]))


def test_a_motion_fit_is_judged_by_percent_whiteness_and_other_recordings() -> None:
    for percent, white, status in (
        ((99.0, 98.0), (1.0, 1.0), "FITTED"),
        ((99.0, 98.0), (1.0, fits.WHITE - 0.01), "MODEL_ERROR"),
        ((99.0, 99.95), (1.0, fits.WHITE - 0.01), "SMALL_ERROR"),
        ((98.0, 99.95), (fits.WHITE - 0.01, 0.0), "MODEL_ERROR"),
        ((fits.POORLY_EXPLAINED - 0.1, 99.0), (1.0, 1.0), "MODEL_ERROR"),
    ):
        assert fits.motion_status(ended(True, False), percent, white) is FitStatus[status]
    for converged, bound, status in ((False, True, "NOT_CONVERGED"), (True, True, "AT_BOUND")):
        fit = ended(converged, bound)
        assert fits.motion_status(fit, (99.0,), (1.0,)) is FitStatus[status]
    worse = np.array([validation.WORSE + 0.1, 1.0])
    best = (99.0, 99.0)
    there = 100 - 1.1 * validation.WORSE
    assert fits.fails_on_others(best, (there, 99.0), worse) and not fits.fails_on_others(
        best, (there, 99.0), worse / 2
    )
    assert not fits.fails_on_others(best, (99.0, there), worse) and not fits.fails_on_others(
        best, (100 - 0.9 * validation.WORSE, 99.0), worse
    )
    assert not fits.fails_on_others((99.999, 99.0), (99.95, 99.0), worse)
    assert fits.fails_on_others(best, (99.0, fits.POORLY_EXPLAINED - 0.1), np.ones(2))


def test_fits_in_percent_and_whiteness_by_sums() -> None:
    rng = np.random.default_rng(0)
    y = rng.normal(size=(3, 30, 2)).cumsum(axis=1)
    e = rng.normal(size=(3, 30, 2))
    e[:, :, 1] = np.sin(0.2 * np.arange(30))
    n = np.arange(30)
    line = np.array(
        [[np.polyval(np.polyfit(n, y[s, :, j], 1), n) for j in range(2)] for s in range(3)]
    ).swapaxes(1, 2)
    away = [np.sqrt((e[..., j] ** 2).sum() / ((y - line)[..., j] ** 2).sum()) for j in range(2)]
    assert_allclose(fits.fit_percent_of(y, e), [100 * (1 - x) for x in away])
    Jz = rng.normal(size=(3, 60, 4))
    Jz[:, :, 3] = 2 * Jz[:, :, 0]
    Q = fits.span_of(Jz)
    for q, J in zip(Q, Jz, strict=True):
        assert_allclose(q @ q.T @ J, J, atol=1e-9)
        assert_allclose(np.trace(q @ q.T), 3.0)
    white = fits.whiteness(e, Q)
    P = Q.reshape(3, 30, 2, 4)
    for j in range(2):
        left = 90 - (P[:, :, j] ** 2).sum()
        power = (e[..., j] ** 2).sum()
        inside = []
        for lag in range(1, min(of_residuals.LAGS, 29) + 1):
            found = (
                sum(e[s, k + lag, j] * e[s, k, j] for s in range(3) for k in range(30 - lag))
                / power
            )
            wanted = (
                -sum(P[s, k + lag, j] @ P[s, k, j] for s in range(3) for k in range(30 - lag))
                / left
            )
            inside.append(abs(found - wanted) < 2.58 / np.sqrt(90))
        assert white[j] == pytest.approx(np.mean(inside))
    t = H * np.arange(40)
    signals = np.stack([np.sin(5 * t), np.cos(7 * t)], axis=1)
    assert fits.remove_delays(t, signals, np.zeros(2)) is signals
    late = fits.remove_delays(t, signals, np.array([0.0, 6e-3]))
    assert_allclose(late[:, 0], signals[:, 0], atol=1e-12)
    at = np.minimum(t + 6e-3, t[-1])
    assert_allclose(late[:, 1], CubicSpline(t, signals[:, 1], bc_type="not-a-knot")(at), atol=1e-6)
    assert_allclose(late[:-2, 1], np.cos(7 * (t[:-2] + 6e-3)), atol=1e-5)


def described(folder: Path, *runs: tuple[float, int], more: str = "") -> Path:
    """A description of recordings: the pose of each, and its samples of a millisecond."""
    (folder / "bench.toml").write_text(BENCH.read_text())
    text = HEAD.replace("period_s = 0.2\n", more)
    for k, (pose, count) in enumerate(runs):
        t = 1e-3 * np.arange(count)
        slow = np.sin(2 * np.pi * 10 * t) + 0.3 * t
        np.savez(folder / f"{k}.npz", t=t, u=slow, q=1e-2 * np.cos(2 * np.pi * 10 * t) + 0.01 * t)
        text += f'\n[[recording]]\nfile = "{k}.npz"\npose_rad = [{pose}]\n'
    (folder / "runs.toml").write_text(text)
    return folder / "runs.toml"


def test_recordings_have_as_many_periods_at_every_pose(tmp_path: Path) -> None:
    period = "period_s = 0.2\n"
    found = read_experiment(described(tmp_path, (0.0, 400), (0.5, 450), more=period))
    assert found.plan.periods == 2 and len(found.plan.poses) == 2
    words = "the same number of recordings, and of whole periods in each, at every pose"
    for runs in (((0.0, 400), (0.0, 400), (0.5, 400)), ((0.0, 400), (0.5, 600))):
        with pytest.raises(ModelError, match=words):
            read_experiment(described(tmp_path, *runs, more=period))
    with pytest.raises(ArgumentError, match=r"0\.npz: given 399 samples, expected at least two"):
        read_experiment(described(tmp_path, (0.0, 399), more=period))


@pytest.mark.parametrize("transients", [0, 1])
def test_a_recording_of_periods_is_their_mean_twice(transients: int, tmp_path: Path) -> None:
    """After the transients, which are left out, without a rest at the end."""
    keys = f"period_s = 0.2\ntransients = {transients}\n"
    data = read_description(described(tmp_path, (0.0, 850), more=keys))
    recording = data.recordings[0][1]
    found = MotionRecord(data, recording)
    first = 200 * transients
    for name in ("tau_m", "q_m"):
        x = getattr(recording, name)
        one = np.array([x[first + k : 800 : 200].mean(axis=0) for k in range(200)])
        assert_allclose(getattr(found, name), np.vstack([one, one]))
    assert_allclose(found.t, 1e-3 * np.arange(400), atol=1e-12)
    assert found.own == 200
    whole = read_description(described(tmp_path, (0.0, 850)))
    plain = MotionRecord(whole, recording)
    assert plain.own == 850 and plain.tau_m is recording.tau_m
    wrong = read_description(described(tmp_path, (0.0, 850), more="period_s = 0.9\n"))
    with pytest.raises(ArgumentError, match=r"0\.npz: given 850 samples, expected a whole"):
        MotionRecord(wrong, recording)


@pytest.mark.parametrize("hold", ["zoh", "none"])
def test_a_segment_is_that_of_the_torques_a_delay_before(hold: str, tmp_path: Path) -> None:
    """Held torques: whole samples later; along a curve: any delay. Motions of two delays differ
    by the shift of the record.
    """
    path = described(tmp_path, (0.0, 850))
    path.write_text(path.read_text().replace('hold = "zoh"', f'hold = "{hold}"'))
    data = read_description(path)
    vector = ParameterVector(data.model, ["delay"])
    shooting = Shooting(vector, data, 0.05)
    late = 3e-3 if hold == "zoh" else 2.4e-3
    moved = described(tmp_path, (0.0, 850))
    arrays = dict(np.load(tmp_path / "0.npz"))
    t = arrays["t"] - late
    arrays["u"] = np.sin(2 * np.pi * 10 * t) + 0.3 * t
    np.savez(tmp_path / "0.npz", **arrays)
    moved.write_text(path.read_text().replace('hold = "zoh"', f'hold = "{hold}"'))
    other = Shooting(vector, read_description(moved), 0.05)
    r, _ = shooting.settle(np.array([late]))
    s, _ = other.settle(np.array([0.0]))
    middle = slice(4, 12)  # away from the ends
    assert np.abs(r[middle] - s[middle]).max() < 0.02 * np.abs(r).max()


def test_segments_start_with_the_angles_and_speeds_of_the_motor(tmp_path: Path) -> None:
    """Differences of second order; changes for derivatives have the size of the motion."""
    data = read_description(described(tmp_path, (0.0, 850)))
    shooting = Shooting(ParameterVector(data.model, ["q1.stiffness"]), data, 0.05)
    q = 1e-2 * np.cos(2 * np.pi * 10 * 1e-3 * np.arange(850)) + 1e-5 * np.arange(850)
    begin = 50 * np.arange(len(shooting.starts))
    v = (-3 * q[begin] + 4 * q[begin + 1] - q[begin + 2]) / 2e-3
    eta = data.model.eta[0, 0]
    expected = np.stack([q[begin] / eta, q[begin], v / eta, v, 0 * v], axis=1)
    assert_allclose(shooting.z, expected, atol=1e-9)
    angle = np.std([np.diff(q[k : k + 51]) for k in begin])
    torque = data.recordings[0][1].tau_m
    drive = np.std(np.concatenate([torque[k : k + 50] for k in begin]))
    sizes = [angle, angle, angle / 1e-3, angle / 1e-3, drive]
    assert_allclose(shooting.scale, sizes, rtol=1e-6)


def test_a_tenth_of_a_second_of_motion_gives_a_spring(tmp_path: Path) -> None:
    """Of a simulated robot, validated by its own recording; and priors that are far narrower than
    what the data show.
    """
    model = flexgen.read("planar5_nmp")
    truth = another(model, seed=5)
    plan = flexgen.excite(
        model, poses=poses_of(model, 1), speed_rms=0.1, f_max=80.0, period_s=0.05, periods=2,
        hardware=flexgen.DriveHardware(1e-3), lines=4,
    )  # fmt: skip
    writer = RecordingWriter(tmp_path, plan, model)
    flexgen.measure(plan, truth, raw=writer)
    path = writer.finish()
    rows = path.read_text().splitlines()
    kept = [x for x in rows if not x.startswith(("period_s", "line_numbers"))]
    path.write_text("\n".join(kept))
    springs = {p.name: p.value for p in select(truth, ["q1.stiffness", "q2.stiffness"])}
    start = {"q1.stiffness": 1.2 * springs["q1.stiffness"]}
    found = fits.fit_motion(
        truth, path, free=list(start), segment_s=0.02, start=start, validate=path
    )
    assert found.values["q1.stiffness"] == pytest.approx(springs["q1.stiffness"], rel=1e-3)
    # what was not fitted is explained as well as what was
    assert_allclose(found.held_out_percent, found.fit_percent, atol=1e-3)
    assert "fit 100.0 %, 100.0 %" in repr(found) and found.status.agrees
    priors = {"q1.stiffness": 1e-11, "q2.stiffness": 2e-11}
    known = fits.fit_motion(truth, path, free=list(priors), segment_s=0.02, priors=priors)
    assert_allclose(known.formal_covariance, np.diag([1e-22, 4e-22]), rtol=1e-3, atol=1e-26)
    assert known.values == pytest.approx(springs, rel=1e-9)
    assert known.held_out_percent == () and known.segments == found.segments
    with pytest.raises(ArgumentError, match="expected at least 4 samples"):
        fits.fit_motion(truth, path, free=list(start), segment_s=1e-3)
