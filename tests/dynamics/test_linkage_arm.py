"""A six-axis arm whose forearm is driven by a four-bar, with a gas spring: its equations, and the
closure of its loop along a solved move.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import flexgen
from flexgen.dynamics.mechanics.closed_loops import closed_joints
from flexgen.model.format.closure import passive_joints
from tests.support import multipliers
from tests.support.multipliers import Multipliers
from tests.support.worst_accelerations import worst_of


def closure_along(robot: flexgen.RobotModel, solution: flexgen.Solution) -> float:
    """Largest distance [m] of the frames of the loops along a move: passive joints from the graph
    of the emitted C, frames by an own walk of the tree.
    """
    own = Multipliers(robot)
    q_a = ca.SX.sym("q_a", robot.n_a)
    joints = closed_joints(robot, q_a)
    at = ca.Function("at", [q_a], list(joints.values()))
    still = dict.fromkeys(own.dofs, 0.0)
    worst = 0.0
    for q in np.array(solution.trajectory["q_a"])[::20]:
        own.nodes(dict(zip(joints, map(float, at(q)), strict=True)), still)
        worst = max(worst, float(np.abs(own.errors()).max()))
    return worst


@pytest.mark.slow
def test_accelerations_are_those_of_multipliers() -> None:
    """20 states, asked 1e-9."""
    assert worst_of(flexgen.read("linkage_arm"), 20) < 1e-11


@pytest.mark.full
@pytest.mark.parametrize("name", ["linkage_arm", "palletizer", "delta"])
def test_hundred_accelerations_are_those_of_multipliers(name: str) -> None:
    """Accelerations of each robot with loops, asked 1e-9."""
    assert worst_of(flexgen.read(name), 100) < 1e-11


def test_multipliers_find_a_changed_gas(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: 200 N of the 20 kN of the gas spring."""
    right = multipliers.tension

    def wrong(line: object, length: float) -> float:
        more = 200.0 if hasattr(line, "pressure") else 0.0
        return right(line, length) + more

    monkeypatch.setattr(multipliers, "tension", wrong)
    assert worst_of(flexgen.read("linkage_arm"), 1) > 1e-5


@pytest.mark.slow
def test_the_loop_stays_closed_along_a_solved_move() -> None:
    """Asked 1e-12 m, where the forearm turns by more than 10 degrees."""
    robot = flexgen.read("linkage_arm")
    solution = flexgen.solve(robot, "joints", verify=False)
    assert closure_along(robot, solution) < 1e-12
    assert [dof.name for dof in passive_joints(robot)] == ["rod_angle", "fore_angle"]


@pytest.mark.full
@pytest.mark.parametrize("name", ["palletizer", "delta"])
def test_other_loops_stay_closed_along_a_solved_move(name: str) -> None:
    """Planar loops in sequence, and spatial ones by an iteration: asked 1e-12 m."""
    robot = flexgen.read(name)
    assert closure_along(robot, flexgen.solve(robot)) < 1e-12


def test_the_gas_spring_relieves_axis_two() -> None:
    """Static torque of the lower arm 60 degrees forward: less than half of that without it."""
    robot = flexgen.read("linkage_arm")
    equations = flexgen.derive(robot)
    q = np.zeros(robot.n_a)
    q[list(robot.i_g)] = robot.home
    names = [c.name for c in robot.coordinates]
    second = names.index("q2")
    q[second] = np.radians(60.0)
    q[names.index("q3")] = np.radians(30.0)
    gravity = float(equations.function("gravity")(q)[second])
    relief = float(equations.function("arm_forces")(q, 0 * q)[second])
    assert abs(gravity - relief) < abs(gravity) / 2
