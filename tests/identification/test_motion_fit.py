"""Parameters from recorded motions in short segments: exact on simulated robots, refusals, and the
integrator in C.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from identification_cases import another, poses_of
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.estimator.residuals import whiteness
from flexgen.identification.experiments.excitation import Plan
from flexgen.identification.motions.motion_fit import fit_motion
from flexgen.identification.records.recording_writer import RecordingWriter
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.result import FitStatus
from flexgen.model.elements import RobotModel
from flexgen.simulation.integration.segments import Segments

FREE = ["stiffness", "damping"]


def recorded(
    folder: Path, robot: RobotModel, noise: float = 0.0, *, seed: int = 0, encoder: bool = False
) -> Path:
    """A motion of a robot under its drives, as a description of recordings without period."""
    model = flexgen.read("planar5_nmp")
    if encoder:
        sensor = {
            "name": "link",
            "type": "link_encoder",
            "coordinate": "q1",
            "unit": "rad",
            "noise": 0.01 * noise,
        }
        sensors = flexgen.read("planar5_nmp", overrides={"sensor": [sensor]}).sensors
        model = replace(model, sensors=sensors)
        robot = replace(robot, sensors=sensors)
    drives = DriveHardware(5e-4, encoder_noise_rad=noise)
    plan: Plan = flexgen.excite(
        model,
        poses=poses_of(model, 1),
        speed_rms=0.1,
        f_max=60.0,
        hardware=drives,
        period_s=1.0,
        periods=2,
    )
    writer = RecordingWriter(folder, plan, model)
    flexgen.measure(plan, robot, seed=seed, raw=writer)
    path = writer.finish()
    if encoder:
        text = (Path(__file__).parents[2] / "models" / "planar5_nmp.toml").read_text()
        text += (
            '\n[[sensor]]\nname = "link"\ntype = "link_encoder"\ncoordinate = "q1"\nunit = "rad"\n'
        )
        (folder / "robot.toml").write_text(text)
    rows = [
        line
        for line in path.read_text().splitlines()
        if not line.startswith(("period_s", "line_numbers"))
    ]
    if encoder:
        rows[0] = 'model = "robot.toml"'
    path.write_text("\n".join(rows))
    return path


@pytest.fixture(scope="module")
def truth() -> RobotModel:
    """Other springs and dampers than in the file."""
    return another(flexgen.read("planar5_nmp"), seed=5)


@pytest.mark.slow
def test_parameters_of_a_motion_without_noise(truth: RobotModel, tmp_path: Path) -> None:
    found = fit_motion(None, recorded(tmp_path, truth), free=[*FREE, "friction"], segment_s=0.05)
    # what is left are roundings
    assert found.status == FitStatus.SMALL_ERROR and min(found.fit_percent) > 99.99
    exact = {
        p.name: p.value
        for p in flexgen.dynamics.mechanics.parameters.select(truth, list(found.values))
    }
    for name, value in found.values.items():
        if name in found.used():
            assert value == pytest.approx(exact[name], rel=1e-3), name
    assert {"q1.stiffness", "q2.stiffness", "m1.viscous"} <= set(found.used())


@pytest.mark.full
def test_errors_are_as_large_as_their_deviations(truth: RobotModel, tmp_path: Path) -> None:
    exact = {p.name: p.value for p in flexgen.dynamics.mechanics.parameters.select(truth, FREE)}
    scores = []
    for seed in range(4):
        folder = tmp_path / str(seed)
        found = fit_motion(
            None, recorded(folder, truth, 1e-4, seed=seed), free=FREE, segment_s=0.05
        )
        scores.append([np.log(found.values[n] / exact[n]) / found.sd[n] for n in found.values])
        assert min(found.white) > 0.8
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.6


@pytest.mark.slow
def test_a_link_encoder_makes_stiffness_more_accurate(truth: RobotModel, tmp_path: Path) -> None:
    sds = []
    for encoder in (False, True):
        folder = tmp_path / str(encoder)
        found = fit_motion(
            None, recorded(folder, truth, 1e-4, encoder=encoder), free=FREE, segment_s=0.05
        )
        exact = {
            p.name: p.value for p in flexgen.dynamics.mechanics.parameters.select(truth, FREE)
        }
        assert (
            abs(np.log(found.values["q1.stiffness"] / exact["q1.stiffness"]))
            < 5 * found.sd["q1.stiffness"]
        )
        sds.append(found.sd["q1.stiffness"])
        assert len(found.rms) == 2 + encoder
    assert sds[1] < 0.9 * sds[0]


@pytest.mark.full
def test_the_stated_delay_of_a_link_encoder_is_taken_out(
    truth: RobotModel, tmp_path: Path
) -> None:
    """Its samples are two and a half samples old; unless the model file says so, the residuals are
    not noise.
    """
    path = recorded(tmp_path, truth, 1e-4, encoder=True)
    for file in tmp_path.glob("*.npz"):
        arrays = dict(np.load(file))
        t = arrays["t"]
        arrays["s_1"] = CubicSpline(t, arrays["s_1"])(np.maximum(t - 1.25e-3, t[0]))
        np.savez(file, **arrays)
    late = fit_motion(None, path, free=FREE, segment_s=0.05)
    (tmp_path / "robot.toml").write_text(
        (tmp_path / "robot.toml").read_text() + "delay_s = 1.25e-3\n"
    )
    stated = fit_motion(None, path, free=FREE, segment_s=0.05)
    assert stated.rms[-1] < 0.2 * late.rms[-1] and stated.fit_percent[-1] > late.fit_percent[-1]


@pytest.mark.full
def test_a_wrong_hold_shows_as_a_delay(truth: RobotModel, tmp_path: Path) -> None:
    path = recorded(tmp_path, truth)
    right = fit_motion(None, path, free=[*FREE, "delay"], segment_s=0.05)
    assert abs(right.values["delay"]) < 2e-6
    path.write_text(path.read_text().replace('hold = "zoh"', 'hold = "none"'))
    wrong = fit_motion(None, path, free=[*FREE, "delay"], segment_s=0.05)
    assert wrong.values["delay"] == pytest.approx(2.5e-4, abs=5e-5)  # half of a sample


@pytest.mark.slow
def test_held_out_recordings_show_a_wrong_model(truth: RobotModel, tmp_path: Path) -> None:
    first, second = (recorded(tmp_path / name, truth, 1e-5, seed=k) for k, name in enumerate("ab"))
    found = fit_motion(None, first, free=FREE, segment_s=0.05, validate=second)
    stuck = fit_motion(None, first, free=["q1.damping"], segment_s=0.05, validate=second)
    assert min(found.held_out_percent) > min(stuck.held_out_percent) + 1
    assert min(stuck.white) < min(found.white)


@pytest.mark.slow
@pytest.mark.parametrize("robots", [1, 19])
def test_segments_are_those_of_another_integrator(robots: int) -> None:
    """More robots than are computed at once; outputs are rows, a function, or the states."""
    model = flexgen.read("planar5_nmp")
    local = LocalModel(model, ["q1.stiffness"])
    rows = np.hstack([local.motor_rows, np.zeros_like(local.motor_rows)])
    x, u, p = (local.rate.sx_in(k) for k in range(3))
    power = ca.Function(
        "power", [x, u, p], [p * u * ca.mtimes(ca.DM(local.motor_rows), x[model.dof :])]
    )
    segments = Segments(local.rate, rows, 1e-3, 16)
    powers = Segments(local.rate, power, 1e-3, 16)
    rng = np.random.default_rng(0)
    start = 0.1 * rng.normal(size=(robots, 2 * model.dof))
    torques = rng.normal(size=(2, 5 * 16, 3, model.n_m))
    torques[:, :, 1:] = torques[:, :, :1]  # constant within a step
    k = rng.uniform(500.0, 700.0, (robots, 1))
    offset = rng.normal(size=(robots, model.n_m))
    sets = rng.integers(0, 2, robots)
    given = start, torques, sets, offset, k
    y = segments(*given)
    whole = segments(*given, states=True)
    shown = powers(*given)
    assert np.array_equal(y, whole @ rows.T) or np.abs(y - whole @ rows.T).max() < 1e-14
    rate = local.equations.function("state_rate")
    for robot in range(robots):
        alone = segments(
            *(each[robot : robot + 1] for each in (start, torques[sets], sets * 0, offset, k))
        )
        assert np.array_equal(alone[0], y[robot])  # whatever is computed with it
        state = start[robot]
        for step in range(5 * 16):
            tau = torques[sets[robot], step, 0] + offset[robot]
            if step % 16 == 0:
                expected = k[robot] * tau * (local.motor_rows @ state[model.dof :])
                assert shown[robot, step // 16] == pytest.approx(expected, rel=1e-5, abs=1e-5)
            state = solve_ivp(
                lambda t, s, tau=tau, robot=robot: np.array(rate(s, tau, k[robot])).ravel(),
                (0, 6.25e-5), state, rtol=1e-10, atol=1e-12,
            ).y[:, -1]  # fmt: skip
            if step % 16 == 15:
                expected = local.motor_rows @ state[: model.dof]
                assert y[robot, (step + 1) // 16] == pytest.approx(expected, rel=1e-6, abs=1e-8)


def test_white_noise_is_white_and_a_sine_is_not() -> None:
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(50, 100, 1))
    none = np.zeros((50, 100, 0))
    assert whiteness(noise, none)[0] > 0.9
    assert whiteness(noise + np.sin(0.3 * np.arange(100))[None, :, None], none)[0] < 0.2
    # Residuals of straight lines: their correlation is that of the lines that were taken off.
    A = np.linalg.qr(np.vander(np.arange(100.0), 5))[0]
    left = noise - np.einsum("nk,mk,smj->snj", A, A, noise)
    assert whiteness(left, np.broadcast_to(A, (50, 100, 5)))[0] > 0.9 > whiteness(left, none)[0]


def test_what_cannot_be_fitted_is_refused(truth: RobotModel, tmp_path: Path) -> None:
    path = recorded(tmp_path, truth)
    with pytest.raises(ArgumentError, match="expected at least 4 samples"):
        fit_motion(None, path, free=FREE, segment_s=1e-3)
    with pytest.raises(ArgumentError, match="take shorter ones"):
        fit_motion(None, path, free=FREE, segment_s=1.9)
    with pytest.raises(ArgumentError, match="free: given no parameter"):
        fit_motion(None, path, free=[])
