"""Paths of robots with kinematic loops."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import flexgen
from tests.support.linkages import FOUR_BAR, read_text


def test_path_beyond_a_dead_center_is_refused(tmp_path: Path) -> None:
    """The rod of the four-bar cannot reach the forearm on this line."""
    far = FOUR_BAR.replace("displacement = [0.15, 0.0, 0.2]", "displacement = [0.9, 0.0, 0.3]")
    with pytest.raises(flexgen.SolverError, match=r"loops cannot be closed .* dead center"):
        flexgen.plan(read_text(tmp_path, far))


def test_joint_move_on_which_a_loop_comes_apart_is_refused(tmp_path: Path) -> None:
    """Between two closed ends, too: the instant, the joints and the loop are named."""
    robot = read_text(tmp_path, FOUR_BAR)
    ends = ([60.0, -40.0], [150.0, -40.0])
    move = flexgen.Move("apart", "joint", tuple(np.radians(ends[0])), 1.0, 5)
    far = replace(move, end=tuple(np.radians(ends[1])))
    with pytest.raises(
        flexgen.SolverError, match=r"move apart: .*q1 = .* at t = 0\..*loop bar is open by .* m"
    ):
        flexgen.plan(robot, far)
    near = replace(move, end=tuple(np.radians([70.0, -40.0])))
    assert flexgen.plan(robot, near).duration == 1.0
