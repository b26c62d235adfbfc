"""Arms with more motors than outputs: moves of the tool become motions of all joints, chosen by a
stated rule.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path as FilePath

import numpy as np
import pinocchio as pin
import pytest
from emitted import ROOT
from pinocchio_referee import Tree

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.inversion.judge.status import Status
from flexgen.inversion.solution import Solution
from flexgen.inversion.solve import solve
from flexgen.model.elements import Output, RobotModel
from flexgen.model.moves import Move
from flexgen.model.reader import read
from flexgen.paths.geometry.redundancy import joint_problem
from flexgen.paths.path import Path

PANDA = ROOT / "tests/support/robots/panda.toml"
START = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)
LINE = Move(
    "line",
    "tool_line",
    START,
    displacement=(0.1, -0.15, 0.1),
    rotation=(0.0, 0.0, 0.5),
    duration=1.0,
    smoothness=5,
)
NANOMETER = 1e-9
GEARS = "".join(
    f"""
[joint.panda_joint{k}]
gear = {{ type = "elastic", side = "arm", spring = {{ type = "linear", stiffness = {stiffness} \
}}, damping = 10.0 }}
motor = {{ ratio = 100, inertia = 1e-4 }}
"""
    for k, stiffness in zip(range(1, 8), (2e4, 2e4, 1e4, 1e4, 5e3, 5e3, 5e3), strict=True)
)


@cache
def panda(gears: str = "", output: str = "tool_pose") -> Equations:
    """The arm with the pose, or the position, of its tool as output."""
    file = FilePath(PANDA)
    if gears:
        folder = ROOT / "build"
        folder.mkdir(exist_ok=True)
        file = folder / "panda_with_gears.toml"
        file.write_text(PANDA.read_text() + gears)
    return derive(replace(read(file), output=Output(output)))


@cache
def solved(gears: str = "", fixed_joint: str | None = None) -> Solution:
    return solve(panda(gears), LINE, fixed_joint=fixed_joint, progress=False)


def tool(model: RobotModel, q_a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, orientations and Jacobians of the tool by Pinocchio."""
    tree = Tree(model)
    data = tree.model.createData()
    frame = tree.model.getFrameId("tool")
    p = []
    R = []
    J = []
    for q in q_a:
        J.append(
            pin.computeFrameJacobian(
                tree.model, data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )
        )
        pin.updateFramePlacements(tree.model, data)
        p.append(data.oMf[frame].translation.copy())
        R.append(data.oMf[frame].rotation.copy())
    return np.array(p), np.array(R), np.array(J)


@pytest.mark.parametrize(
    "gears", ["", pytest.param(GEARS, marks=pytest.mark.slow)], ids=["rigid", "elastic gears"]
)
def test_the_tool_follows_the_line(gears):
    """The simulated joints, by Pinocchio: on the line, turned in proportion."""
    solution = solved(gears)
    assert solution.status == Status.SOLVED and solution.move.rule == "least change of the joints"
    assert solution.simulation is not None
    p, R, _ = tool(solution.model, solution.simulation.trajectory["q_a"])
    along = (p - p[0]) @ np.array(LINE.displacement) / np.linalg.norm(LINE.displacement) ** 2
    assert along[-1] == pytest.approx(1.0, abs=1e-7) and np.all(np.diff(along) > -1e-9)
    assert np.abs(p - p[0] - along[:, None] * np.array(LINE.displacement)).max() < 100 * NANOMETER
    for share, turned in zip(along, R, strict=True):
        expected = pin.exp3(share * np.array(LINE.rotation)) @ R[0]
        assert np.abs(turned - expected).max() < 1e-7


@pytest.mark.slow
def test_the_joints_change_as_little_as_possible():
    """Their speeds have no part that leaves the tool where it is."""
    solution = solved()
    q = solution.trajectory["q_a"]
    v = solution.trajectory["v_a"]
    _, _, J = tool(solution.model, q)
    idle = np.array([np.linalg.svd(jacobian)[2][-1] for jacobian in J])
    assert np.abs((idle * v).sum(axis=1)).max() < 1e-7
    assert np.abs(v).max() > 0.1
    # a planted rule: it is not the least change
    other = solved("", "panda_joint3").trajectory["v_a"]
    _, _, J = tool(solution.model, solved("", "panda_joint3").trajectory["q_a"])
    idle = np.array([np.linalg.svd(jacobian)[2][-1] for jacobian in J])
    assert np.abs((idle * other).sum(axis=1)).max() > 1e-2


@pytest.mark.parametrize(
    "name", [pytest.param("panda_joint1", marks=pytest.mark.slow), "panda_joint3"]
)
def test_a_joint_can_be_kept(name):
    solution = solved("", name)
    q = solution.trajectory["q_a"][:, int(name[-1]) - 1]
    assert solution.status == Status.SOLVED and np.abs(q - q[0]).max() < 1e-12
    assert solution.move.rule == f"least change of the joints, {name} fixed"
    p, _, _ = tool(solution.model, solution.trajectory["q_a"][[0, -1]])
    assert np.abs(p[1] - p[0] - LINE.displacement).max() < NANOMETER


@pytest.mark.slow
def test_a_joint_move_needs_no_rule():
    move = panda().model.move("joints")
    solution = solve(panda(), move, progress=False)
    expected = solve(PANDA, move, progress=False)
    assert solution.status == Status.SOLVED and solution.move == move
    assert np.array_equal(solution.trajectory["tau_m"], expected.trajectory["tau_m"])
    assert solution.model.output == expected.model.output


@pytest.mark.slow
def test_three_outputs_and_seven_motors():
    """Only the position of the tool: four joints are free."""
    line = replace(LINE, rotation=(0.0, 0.0, 0.0))
    solution = solve(panda("", "tool_position"), line, progress=False)
    p, _, _ = tool(solution.model, solution.trajectory["q_a"])
    assert (
        solution.status == Status.SOLVED
        and np.abs(p[-1] - p[0] - line.displacement).max() < NANOMETER
    )
    turning = solved().trajectory["v_a"]
    assert (solution.trajectory["v_a"] ** 2).sum() < (turning**2).sum()


@pytest.mark.slow
def test_rounded_corners():
    """The tool of the undeflected arm is on the path of the move, with its speed and
    acceleration.
    """
    legs = (flexgen.MoveL((0.1, 0.0, 0.0), zone=0.03), flexgen.MoveL((0.0, 0.1, 0.0)))
    move = Move("corner", "tool_polyline", START, legs=legs, duration=1.5, smoothness=5)
    joints, path = joint_problem(panda(), move)
    t = np.linspace(0.0, path.duration, 3001)
    q_g = path.sample(t).q_g
    expected = Path(panda(), move).sample(t)
    p, _, J = tool(joints.model, q_g[:, :, 0])
    v = np.einsum("nij,nj->ni", J, q_g[:, :, 1])
    assert np.abs(p - expected.y[:, :, 0]).max() < 5 * NANOMETER
    assert np.abs(v[:, :3] - expected.y[:, :, 1]).max() < 1e-6
    step = (
        np.diff(q_g[:, :, 1], axis=0) / np.diff(t)[:, None] - (q_g[1:, :, 2] + q_g[:-1, :, 2]) / 2
    )
    assert np.abs(step).max() < 1e-3 * np.abs(q_g[:, :, 2]).max()


@pytest.mark.slow
def test_invalid_requests_for_redundant_arms_are_refused():
    with pytest.raises(
        ArgumentError, match="fixed_joint: given 'elbow', expected one of panda_joint1, "
    ):
        solve(panda(), LINE, fixed_joint="elbow")
    with pytest.raises(
        ArgumentError, match=r"fixed_joint: given 'q1' for model elbow, expected None"
    ):
        solve("elbow", fixed_joint="q1")
    with pytest.raises(
        SolverError, match=r"redundant arm: a singular pose after \d.* of the path"
    ):
        solve(panda(), replace(LINE, displacement=(1.0, 0.0, 0.3)), progress=False)


BEARING = """
[[joint.panda_joint1.after]]
name = "tilt"
type = "rotation"
axis = [1, 0, 0]
spring = { type = "linear", stiffness = 1e5 }
damping = 20.0
"""


@pytest.mark.slow
def test_the_pose_of_an_arm_with_a_bearing_is_followed():
    """A joint becomes an output next to the pose; the tool is on its line with the deflections."""
    equations = panda(BEARING)
    solution = solve(equations, LINE, fixed_joint="panda_joint3", progress=False)
    assert solution.status == Status.SOLVED and solution.model.output.size == 7
    assert solution.simulation is not None
    q_a = solution.simulation.trajectory["q_a"]
    names = [c.name for c in solution.model.coordinates]
    assert np.ptp(q_a[:, names.index("tilt")]) > 1e-6
    p, _, _ = tool(solution.model, q_a)
    along = (p - p[0]) @ np.array(LINE.displacement) / np.linalg.norm(LINE.displacement) ** 2
    assert along[-1] == pytest.approx(1.0, abs=1e-7)
    assert np.abs(p - p[0] - along[:, None] * np.array(LINE.displacement)).max() < 100 * NANOMETER
