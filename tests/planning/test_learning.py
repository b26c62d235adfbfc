"""Learning of a path: how far it gets, that nothing is learned from the model itself, that it
never ends worse.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_numbers import check_numbers
from scipy.spatial.transform import Rotation
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main
from flexgen.inversion.judge.status import Status
from flexgen.planning.learning.commanded import _left_jacobian
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


@pytest.mark.slow
@pytest.mark.parametrize(("frequency", "gain"), [(40.0, 2.0), (25.0, 1.9)])
def test_learning_that_diverges_ends_with_its_best(solution, frequency, gain):
    found = flexgen.learn(
        "planar5_nmp",
        plant={"stiffness": 0.6, "payload": 3.0},
        solution=solution,
        iterations=12,
        gain=gain,
        frequency_hz=frequency,
        progress=False,
    )
    assert found.stopped and found.errors_m[found.best] == min(found.errors_m)
    assert len(found.runs) < 13


def test_angular_velocity_of_a_rotation_vector():
    rng = np.random.default_rng(0)
    for size in (1e-6, 0.3, 2.0):
        r = size * rng.normal(size=(5, 3))
        dr = rng.normal(size=(5, 3))
        h = 1e-6
        R = [Rotation.from_rotvec(r + s * h * dr).as_matrix() for s in (-1, 0, 1)]
        spin = (R[2] - R[0]) / (2 * h) @ R[1].transpose(0, 2, 1)
        w = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        assert np.allclose(_left_jacobian(r, dr), w, atol=1e-8)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"iterations": 0}, "iterations: given 0"),
        ({"gain": 3.0}, "gain: given 3.0"),
        ({"frequency_hz": 1e4}, "frequency_hz: given 10000.0"),
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
