"""Learning of a path: how far it gets, that nothing is learned from the model itself, that it
never ends worse.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_numbers import check_numbers
from scipy.interpolate import interp1d
from scipy.signal import butter, filtfilt
from scipy.spatial.transform import Rotation
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main
from flexgen.dynamics.mechanics.output_columns import columns_in
from flexgen.feedback.loop.gains import lowest_locked_hz
from flexgen.inversion.judge.status import Status
from flexgen.planning.learning.corrected import angular_velocity
from flexgen.views.plots.control import plot_learned
from flexgen.views.reports.control_page import write_learned

pytestmark = needs_compiler


@pytest.fixture(scope="module")
def solution():
    return flexgen.solve("planar5_nmp", progress=False)


@pytest.mark.slow
def test_a_soft_robot_is_learned_in_two_iterations(solution, tmp_path):
    found = flexgen.learn(
        "planar5_nmp",
        plant={"stiffness": 0.8},
        solution=solution,
        iterations=3,
        sample_time=1e-3,
        progress=False,
    )
    assert found.errors_m[0] > 1.5e-3 and found.errors_m[2] <= 2e-5
    assert found.best == int(np.argmin(found.errors_m))
    check_numbers(
        "learn", 1e-5, found=found.to_dict(), corrections=found.corrections, time=found.time
    )
    assert found.trajectory["q_a"].shape[1] == 3
    before, after = plot_learned(found).get_axes()[1].get_lines()[:2]
    assert max(before.get_ydata()) == pytest.approx(1e3 * found.errors_m[0])
    assert max(after.get_ydata()) == pytest.approx(1e3 * found.errors_m[found.best])
    page = found.report(tmp_path / "page").read_text()
    alone = replace(found, runs=found.runs[:1], corrections=found.corrections[:1], best=0)
    assert "0, best" in write_learned(alone, tmp_path / "alone").read_text()
    assert "iteration" in page and (tmp_path / "page" / "learning.png").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "after", "limit"), [("manutec_r3_18", 2, 2e-5), ("manutec_r3_24", 5, 3e-5)]
)
def test_six_axes_are_learned(name, after, limit):
    found = flexgen.learn(
        name, plant={"stiffness": 0.8}, iterations=after, sample_time=1e-3, progress=False
    )
    assert min(found.errors_m[: after + 1]) <= limit


def test_nothing_is_learned_from_the_model_itself(solution):
    """No correction above a hundredth of a micrometer: the error of the feedforward."""
    found = flexgen.learn("planar5_nmp", solution=solution, iterations=3, progress=False)
    assert max(np.abs(c).max() for c in found.corrections) < 1e-8
    assert max(found.errors_m) < 1e-7


@pytest.mark.slow
def test_corrections_of_noise_are_no_larger_than_the_noise(solution):
    """1e-4 rad at the motors moves the tool by micrometers."""
    found = flexgen.learn(
        "planar5_nmp", solution=solution, iterations=3, encoder_noise=1e-4, progress=False
    )
    assert max(found.errors_m) < 2e-5 and max(np.abs(c).max() for c in found.corrections) < 2e-5


@pytest.mark.slow
def test_the_feedforward_has_force_and_model_of_the_solution():
    """The first run is that of `control`: of a force, of another model."""
    pushed = flexgen.solve(
        "elbow", force=lambda t: np.outer(np.ones_like(t), [0.0, 0.0, -900.0]), progress=False
    )
    found = flexgen.learn("elbow", solution=pushed, iterations=1, progress=False)
    assert max(found.errors_m) < 1e-9
    moved = {"element.upper.dof.q1.gear.hysteresis": {"lost_motion": 2.9e-4, "stiffness": 7e6}}
    robot = flexgen.read("elbow", overrides=moved)
    plain = flexgen.solve("elbow", progress=False)
    found = flexgen.learn(robot, solution=plain, iterations=3, progress=False)
    assert found.errors_m[0] == pytest.approx(
        flexgen.control(robot, solution=plain, progress=False).tool_error_max_m
    )
    assert found.errors_m[0] > 5e-5 and found.errors_m[found.best] < 0.5 * found.errors_m[0]


@pytest.mark.slow
def test_sensors_of_forces_do_not_disturb_accelerometers(solution):
    """Their readings along the plan are compared with, which were zero."""
    acceleration = {
        "name": "a",
        "type": "accelerometer",
        "element": "tool",
        "unit": "m/s^2",
        "noise": 1e-4,
    }
    torque = {"name": "t", "type": "joint_torque", "coordinate": "q1", "unit": "N m", "noise": 1.0}
    robot = flexgen.read("planar5_nmp", overrides={"sensor": [torque, acceleration]})
    given = {
        "plant": {"stiffness": 0.8},
        "measured_by": "accelerometer",
        "encoder_noise": 1e-9,
        "progress": False,
    }
    found = flexgen.learn(robot, solution=solution, iterations=1, **given)
    assert found.measured_errors[0] == pytest.approx(found.errors_m[0], rel=0.3)
    assert found.errors_m[1] < 0.8 * found.errors_m[0]


def test_a_solution_that_leaves_the_path_is_not_learned(solution):
    limited = replace(solution, status=Status.LIMITS_ACTIVE)
    with pytest.raises(ArgumentError, match=r"^solution: given one whose path limits changed"):
        flexgen.learn("planar5_nmp", solution=limited, progress=False)


def test_angular_velocity_of_a_rotation_vector():
    rng = np.random.default_rng(0)
    for size in (1e-6, 0.3, 2.0):
        r = size * rng.normal(size=(5, 3))
        dr = rng.normal(size=(5, 3))
        h = 1e-6
        R = [Rotation.from_rotvec(r + s * h * dr).as_matrix() for s in (-1, 0, 1)]
        spin = (R[2] - R[0]) / (2 * h) @ R[1].transpose(0, 2, 1)
        w = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        assert np.allclose(angular_velocity(r, dr), w, atol=1e-8)


@pytest.fixture(scope="module", params=["elbow", "kr300"])
def learned(request) -> flexgen.LearningResult:
    """A position of a planar arm, and a pose of six axes."""
    given = {"gain": 0.6, "sample_time": 2e-3, "iterations": 2 if request.param == "elbow" else 1}
    return flexgen.learn(request.param, plant={"stiffness": 0.8}, **given)


def errors_of(found: flexgen.LearningResult, k: int) -> np.ndarray:
    """Position, and rotation vector from the reference to the tool, at the samples of the path."""
    run = found.runs[k]
    robot = run[found.plant]
    parts = [robot.error]
    if run.reference.R_ref is not None:
        forward = flexgen.derive(run.model).function("forward_kinematics").map(len(robot.q_a))
        R = np.array(forward(robot.q_a.T)[1]).reshape(3, -1, 3).transpose(1, 0, 2)
        wanted = Rotation.from_matrix(run.reference.R_ref.reshape(-1, 3, 3))
        parts.append((Rotation.from_matrix(R) * wanted.inv()).as_rotvec())
    whole = interp1d(run.reference.time, np.hstack(parts), axis=0)
    return whole(found.time)


def filtered(found: flexgen.LearningResult, error: np.ndarray) -> np.ndarray:
    """Low pass inside, mean of 50 ms at each end, an odd polynomial of degree 7 between."""
    h = found.time[1] - found.time[0]
    b, a = butter(2, 2 * found.frequency_hz * h)
    pad = min(len(error) - 1, round(1.0 / (found.frequency_hz * h)))
    smooth = filtfilt(b, a, error, axis=0, padlen=pad)
    blend = round(0.1 / h)
    u = np.linspace(0, 1, blend)[:, None]
    ramp = 35 * u**4 - 84 * u**5 + 70 * u**6 - 20 * u**7
    for part, mean in (
        (slice(0, blend), error[: blend // 2].mean(axis=0)),
        (slice(None, -blend - 1, -1), error[-(blend // 2) :].mean(axis=0)),
    ):
        smooth[part] = ramp * smooth[part] + (1 - ramp) * mean
    return smooth


def test_corrections_are_the_filtered_errors(learned) -> None:
    """Of each iteration, times the gain; the filter is below the lowest frequency of the arm."""
    assert not learned.corrections[0].any() and learned.best == int(np.argmin(learned.errors_m))
    for k in range(len(learned.runs) - 1):
        change = learned.corrections[k + 1] - learned.corrections[k]
        expected = -0.6 * filtered(learned, errors_of(learned, k))
        assert np.allclose(change, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    run = learned.runs[0]
    lowest = lowest_locked_hz(run.model, run.reference.points(np.array([0])))
    assert learned.frequency_hz == pytest.approx(0.7 * lowest)
    dynamic = [x.figures(x["robot"])["dynamic_error_max_m"] for x in learned.runs]
    assert learned.dynamic_errors_m == pytest.approx(dynamic)


def test_the_feedforward_is_that_of_the_corrected_path(learned) -> None:
    """The planned tool is off the path by the correction, its rotation by the rotation vector."""
    run = learned.runs[-1]
    correction = interp1d(learned.time, learned.corrections[-1], axis=0)
    at = np.flatnonzero(
        (run.reference.time > -0.1) & (run.reference.time < learned.time[-1] - 0.2)
    )
    at = at[:: max(len(at) // 40, 1)]
    forward = flexgen.derive(run.model).function("forward_kinematics")
    rows = columns_in(run.model, "m")
    for k in at:
        off = correction(run.reference.time[k])
        p, R = (np.array(x) for x in forward(run.reference.motion["q_a"][k]))
        tool = p.ravel()["xyz".index(run.model.output.axes[0]) :][[0, 2]] if len(rows) == 2 else p
        wanted = run.reference.y_ref[k][rows] + off[: len(rows)]
        assert np.allclose(np.ravel(tool), wanted, rtol=0, atol=1e-6)
        if run.reference.R_ref is not None:
            turned = Rotation.from_rotvec(off[len(rows) :]).as_matrix()
            assert np.allclose(R, turned @ run.reference.R_ref[k].reshape(3, 3), atol=1e-5)


def test_learning_ends_where_a_robot_fails(solution) -> None:
    wild = flexgen.Cascade(np.zeros(2), np.full(2, -50.0), np.zeros(2))
    found = flexgen.learn(
        "planar5_nmp", solution=solution, controller=wild, sample_time=5e-3, progress=False
    )
    assert found.stopped == found.problem == "the robot fails without correction"
    assert len(found.runs) == 1 and found.measured_errors == (np.inf,)


def test_learning_ends_where_the_error_grows(solution) -> None:
    """By a twentieth over the best one, and a fiftieth of the first."""
    found = flexgen.learn(
        "planar5_nmp",
        plant={"stiffness": 0.6, "payload": 3.0},
        solution=solution,
        iterations=12,
        gain=2.0,
        frequency_hz=40.0,
        sample_time=2e-3,
        progress=False,
    )
    *kept, last = found.errors_m
    assert found.best == int(np.argmin(kept))
    assert last - 1.05 * min(kept) > 0.02 * kept[0]
    grown = [e - 1.05 * min(kept[: k + 1]) > 0.02 * kept[0] for k, e in enumerate(kept)]
    assert not any(grown) and found.stopped == (
        f"iteration {len(kept)}: the error grows; the best iteration is {found.best}"
    )


def test_accelerometers_estimate_the_moving_error(solution) -> None:
    """Steps fall with the number of the iteration, and errors are those of the estimate."""
    found = flexgen.learn(
        "elbow",
        plant={"stiffness": 0.8, "payload": 2.0},
        iterations=1,
        measured_by="accelerometer",
        sample_time=1e-3,
        progress=False,
    )
    lines = str(found).splitlines()
    assert lines[0].endswith(found.runs[0]["robot"].load) and "load +2 kg" in lines[0]
    assert ", dynamic " in lines[1] and ", estimated " in lines[1]
    assert found.measured_m == found.measured_errors != found.errors_m


def test_learning_is_told_by_iterations(learned) -> None:
    """The best iteration and why it ended."""
    found = replace(learned, stopped="the error grows", frequency_hz=12.5)
    lines = str(found).splitlines()
    name = found.runs[0].model.name
    assert lines[0] == f"{name}, move line: largest error of each iteration, Q 12.5 Hz, gain 0.6"
    assert (
        lines[1].startswith("  0: ") and lines[1].endswith(" um") and lines[-2].endswith("(best)")
    )
    assert lines[-1] == "  the error grows"
    assert repr(found).startswith(f"<LearningResult {name}: {lines[1][5:]} -> ")
    figures = found.to_dict()
    assert (figures["model"], figures["move"], figures["plant"]) == (name, "line", "robot")
    assert figures["errors_max_m"] == list(found.errors_m)
    assert np.array_equal(found.trajectory["q_a"], found.runs[found.best]["robot"].q_a)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"iterations": 0}, "iterations: given 0, expected 1 to 1000"),
        ({"iterations": 1001}, "iterations: given 1001"),
        ({"gain": 0.0}, "gain: given 0.0, expected more than 0, at most 2"),
        ({"gain": 2.01}, "gain: given 2.01"),
        ({"measured_by": "eye"}, "measured_by: given 'eye', expected one of tracker, accelerom"),
        ({"frequency_hz": -1.0}, "frequency_hz: given -1.0, expected more than 0, below"),
        ({"frequency_hz": 1e4}, r"given 10000.0, expected more than 0, below \d{2,3}"),
        ({"plant": {"stifness": 0.5}}, "given 'stifness'"),
    ],
)
def test_wrong_arguments_are_refused(solution, arguments, words):
    with pytest.raises(ArgumentError, match=words):
        flexgen.learn("planar5_nmp", solution=solution, progress=False, **arguments)


@pytest.mark.slow
def test_learning_on_the_command_line(tmp_path, capsys):
    words = ["learn", "planar5_nmp", "-q", "--plant", "stiffness=0.8", "--iterations", "1"]
    assert main([*words, "--out", str(tmp_path / "best.csv")]) == 0
    assert "(best)" in capsys.readouterr().out and (tmp_path / "best.csv").exists()
