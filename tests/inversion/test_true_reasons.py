"""Reasons that must be true: iterations that diverge, and moves that take too long."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

import flexgen
from flexgen.base.errors import ArgumentError, SolverError

SOFTER = 1e-2  # of the bearings' stiffness: the arm deflects by radians in a move of 0.2 s


@pytest.fixture(scope="module")
def soft_arm():
    model = flexgen.read("manutec_r3_24")
    changes = {f"move.{model.moves[0].name}.duration": 0.2}
    for element in model.elements:
        for dof in element.dofs:
            if dof.gear is None:
                key = f"element.{element.name}.dof.{dof.name}.spring.stiffness"
                changes[key] = dof.spring.stiffness * SOFTER
    return flexgen.read("manutec_r3_24", overrides=changes)


@pytest.mark.slow
def test_a_soft_arm_in_a_fast_move_is_not_said_to_leave_its_workspace(soft_arm):
    with pytest.raises(SolverError) as caught:
        flexgen.solve(soft_arm, method="lq")
    assert "the iteration diverged" in str(caught.value)
    assert "leaves the workspace" not in str(caught.value)


def test_a_path_out_of_reach_is_said_to_be():
    line = flexgen.read("planar5_nmp").moves[0]
    far = replace(line, displacement=(5.0, 0.0, 0.0))
    with pytest.raises(SolverError, match="leaves the workspace"):
        flexgen.solve("planar5_nmp", far)


@pytest.mark.parametrize("duration", [1.1e5, 1e9, 1e300])
def test_moves_of_more_than_a_day_are_refused_at_once(duration):
    equations = flexgen.derive("elbow")
    move = replace(equations.model.moves[0], duration=duration)
    began = time.process_time()
    with pytest.raises(ArgumentError, match="expected at most 100000 s"):
        flexgen.plan(equations, move)
    assert time.process_time() - began < 1.0  # s; 8 GB and a minute before
