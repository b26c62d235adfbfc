"""Search of `flexgen.commission`: simulations that stay stable, places that stay as drawn, and
moves that are quicker than the records.
"""

from dataclasses import replace

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.identification.commissioning.elastic_arm import ElasticArm
from flexgen.identification.commissioning.joint_fit import find_nominal
from flexgen.identification.commissioning.motion_block import Motion, MotionBlock
from flexgen.identification.commissioning.quick_moves import find_quicker_moves
from flexgen.identification.commissioning.unknowns import DatasheetTolerances, make_unknowns

pytestmark = needs_compiler

HAND = {"name": "hand", "type": "tracker", "unit": "m", "position": [0.0, 0.0, 0.1]}


def reach(duration: float) -> flexgen.Move:
    """A move of both joints that lasts this long [s]."""
    return flexgen.Move(
        "reach", "joint", start=(0.0, 0.0), end=(0.8, -0.6), duration=duration, smoothness=5
    )


def tracked(duration: float) -> MotionBlock:
    """Block of this move, followed by a tracker."""
    robot = flexgen.read("elbow", overrides={"sensor": [HAND]})
    run = flexgen.solve(robot, reach(duration), verify=False).trajectory
    unknowns = make_unknowns(
        robot,
        DatasheetTolerances(),
        bodies=True,
        positions=True,
        lengths=False,
        motions=1,
        levels=0,
    )
    place = np.column_stack([np.sin(3 * run.time), np.cos(4 * run.time), 0.1 * run.time])
    return MotionBlock(ElasticArm(unknowns, unknowns.sensors), Motion("run", run, place), 0)


def test_growing_dampings_leave_the_simulation_stable() -> None:
    """Dampings a hundred times as large, in the same round: the same torques as those of a block
    that begins there.
    """
    block = tracked(1.5)
    unknowns = block.arm.unknowns
    there = np.array(unknowns.start)
    for k, name in enumerate(unknowns.names):
        if name.endswith(".damping"):
            there[k] += np.log(100.0)
    block.channels(np.array(unknowns.start), False)
    found = block.channels(there, False)
    other = tracked(1.5)
    other.relinearize(there)
    for one, same in zip(found, other.channels(there, False), strict=True):
        assert np.isfinite(one.residual).all()
        assert np.abs(one.residual - same.residual).max() < 1e-4 * one.size


@pytest.mark.parametrize("duration, is_quicker", [(6.0, True), (0.8, False)])
def test_moves_that_are_quicker_than_the_records_are_named(
    duration: float, is_quicker: bool
) -> None:
    """By a joint, its acceleration in the move, and the largest one of the records."""
    block = tracked(duration)
    robot = replace(flexgen.read("elbow"), moves=(reach(1.0),))
    found = find_quicker_moves(robot, [block])
    assert bool(found) == is_quicker
    assert all(line.startswith("move reach accelerates q") for line in found)


def test_places_without_a_seen_change_are_nominal() -> None:
    """Two places that the records hardly tell apart: one of them carries what both show."""
    shown = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    hidden = np.array([1.0, -1.0, 0.0]) / np.sqrt(2)
    other = np.array([0.0, 0.0, 1.0])
    C = 1e-4 * np.outer(shown, shown) + np.outer(hidden, hidden) + 0.01 * np.outer(other, other)
    nothing = 0.015 * shown + 0.3 * hidden
    assert sorted(find_nominal(C, nothing, [0, 1])) == [0, 1]
    something = 0.1 * shown + 0.3 * hidden + 0.5 * other
    assert len(find_nominal(C, something, [0, 1, 2])) == 1
    assert find_nominal(C, something, []) == []
