"""Robots with more axes than the tool has outputs, whose model file names joints as further
outputs: the posture of a move chooses them, and the emitted C inverts the whole.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from emitted import ROOT, made, run, sources
from pinocchio_referee import Tree
from stream_machine import Machine, error
from toolchain import CC, STRICT, needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.inversion.judge.status import Status
from flexgen.model.moves import Posture
from flexgen.model.reader import read
from flexgen.paths.path import Path

NANOMETER = 1e-9
MICROMETER = 1e-6
STREAMED = 0.1 * MICROMETER  # m or rad: 1e-11 was measured, a user is promised 1 um
T = np.linspace(0.0, 1.2, 121)


@cache
def planned(name: str, move: str) -> Path:
    return flexgen.plan(name, move)


def of_tool(path: Path, q_g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) and Jacobians (n, 6, n_g) of the tool of the undeflected arm, by
    Pinocchio.
    """
    robot = path.equations.model
    tree = Tree(robot)
    data = tree.model.createData()
    frame = tree.model.getFrameId("tool")
    places = []
    jacobians = []
    for joints in q_g:
        q = np.zeros(robot.n_a)
        q[list(robot.i_g)] = joints
        J = pin.computeFrameJacobian(
            tree.model, data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        pin.updateFramePlacements(tree.model, data)
        places.append(data.oMf[frame].translation.copy())
        jacobians.append(J[:, list(robot.i_g)])
    return np.array(places), np.array(jacobians)


def idle_part(jacobians: np.ndarray, v: np.ndarray, weights: np.ndarray) -> float:
    """Largest weighted part of the speeds that leaves the tool where it is, of unit directions."""
    idle = np.array([np.linalg.svd(J)[2][-1] for J in jacobians])
    return float(np.abs((idle * weights * v).sum(axis=1)).max())


def test_weights_choose_the_motion_of_the_track():
    """The speeds are stationary: no part along the idle motion in the metric of the weights."""
    path = planned("track_arm", "line")
    sample = path.sample(T)
    q_g = sample.q_g
    places, jacobians = of_tool(path, q_g[:, :, 0])
    assert np.abs(places - sample.y[:, :3, 0]).max() < 5 * NANOMETER
    assert np.array_equal(sample.y[:, 3, 0], q_g[:, 0, 0])
    weights = np.where(np.arange(7) == 0, 4.0, 1.0)
    assert idle_part(jacobians, q_g[:, :, 1], weights) < 1e-7
    # a planted rule: that of equal weights
    assert idle_part(jacobians, q_g[:, :, 1], np.ones(7)) > 1e-2


def test_a_posture_moves_the_track_by_its_change():
    path = planned("track_arm", "carried")
    y = path.sample(T).y
    share = (y[:, 0, 0] - y[0, 0, 0]) / 0.6
    assert np.abs(y[:, 3, 0] - 0.5 * share).max() < NANOMETER
    assert y[-1, 3, 0] == pytest.approx(0.5, abs=NANOMETER)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "move"),
    [("track_arm", "carried"), pytest.param("seven_axis", "elbow", marks=pytest.mark.full)],
)
def test_the_emitted_c_inverts_and_streams(name, move):
    """`solve` in simulation of the full model, and a stream, which repeats to the last bit."""
    solution = flexgen.solve(name, move, progress=False)
    assert solution.status == Status.SOLVED
    assert max(solution.tool_error_max_m, solution.tool_error_max_rad) < MICROMETER
    machine = Machine(name, move)
    t, streamed = machine.followed()
    # the arm with seven axes falls over without feedback, with which it is simulated then
    assert error(machine.simulation(t, streamed)) < STREAMED
    assert np.array_equal(streamed["tau_m"], machine.followed()[1]["tau_m"])


@needs_compiler
@pytest.mark.slow
def test_the_example_in_c_holds_the_pose(tmp_path):
    """Its output at home, of constraint and kinematics, is one that inversion and stream take."""
    folder = made("track_arm").directory
    files = [folder / "example.c", *sources(folder)]
    run(
        CC,
        *STRICT,
        "-O0",
        f"-I{folder}",
        *files,
        "-lm",
        "-o",
        tmp_path / "example",
        folder=tmp_path,
    )
    printed = run(tmp_path / "example", folder=tmp_path)
    assert "invert: success" in printed and "stream: success" in printed


def test_the_output_of_an_overlay_is_that_of_the_model(tmp_path):
    flexgen.export_urdf("track_arm", tmp_path / "arm.urdf")
    assert read(tmp_path / "arm.toml").output == read("track_arm").output


def test_postures_that_do_not_fit_are_refused():
    robot = read("track_arm")
    line = robot.move("line")
    for posture, text in (
        (Posture(("side",), (0.0,)), r"given joint 'side', expected one of rail, q1"),
        (Posture(("rail", "q1"), (0.0, 0.0)), "motions of 2 joints, expected at most 1"),
        (Posture((), (), ("rail",), (0.0,)), "expected numbers > 0"),
        (
            Posture(("q1",), (1e3,)),
            "given a change of 1000 rad of joint .q1., expected at most 399",
        ),
    ):
        with pytest.raises(ArgumentError, match=text):
            Path(derive(robot), replace(line, posture=posture))
    elbow = read("elbow")
    with pytest.raises(ArgumentError, match="the tool determines all joints"):
        Path(derive(elbow), replace(elbow.move("line"), posture=Posture.hold("q1")))
    with pytest.raises(ArgumentError, match="given 1 numbers for 0 joints"):
        Posture((), (1.0,))


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('joints = ["rail"]', 'joints = ["side"]', r"output.joints: .*rail"),
        ("weights = { rail = 4.0 }", "weights = { rail = -4.0 }", "weights: .*numbers > 0"),
        ("weights = { rail = 4.0 }", "weight = { rail = 4.0 }", "posture.weight: .*unknown key"),
        ("joints = { rail = 0.5 }", "joints = { rail = 0.5, q1 = 0.0 }", "at most 1 joints"),
    ],
)
def test_keys_that_do_not_fit_are_refused(tmp_path, old, new, text):
    file = tmp_path / "track.toml"
    text_of_model = (ROOT / "models/track_arm.toml").read_text()
    assert old in text_of_model
    file.write_text(text_of_model.replace(old, new))
    with pytest.raises(ModelError, match=text):
        read(file)
