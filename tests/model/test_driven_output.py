"""Robots whose motors move the output through the deflection of a line alone are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import flexgen
from flexgen.model.format.driven_output import undriven_output
from tests.support.linkages import (
    FOUR_BAR,
    LINE,
    driven_by_a_line,
    driven_by_a_line_in_a_loop,
    read_text,
)

WRONG = {"tree": driven_by_a_line, "loop": driven_by_a_line_in_a_loop}
CALLS: dict[str, Callable[[flexgen.RobotModel], object]] = {
    "plan": flexgen.plan,
    "solve": flexgen.solve,
    "learn": flexgen.learn,
    "fastest": flexgen.fastest,
    "control": flexgen.control,
    "command_positions": flexgen.command_positions,
    "compare_shapers": flexgen.compare_shapers,
    "plan_problem": flexgen.plan_problem,
    "CollisionDetector": lambda robot: flexgen.CollisionDetector(robot, 1e-3),
}


@pytest.mark.parametrize("name", CALLS)
def test_driving_rod_as_a_line_is_refused(tmp_path: Path, name: str) -> None:
    """The joint, the line and the remedy are named."""
    robot = read_text(tmp_path, driven_by_a_line())
    with pytest.raises(flexgen.FlexgenError) as told:
        CALLS[name](robot)
    message = str(told.value)
    assert "given q2, whose motion changes the length of line bar" in message
    assert "make the stretch of the driving rod a coordinate" in message


@pytest.mark.parametrize("name", WRONG)
def test_both_forms_are_found(tmp_path: Path, name: str) -> None:
    """Without a loop, and with one whose rod is passive."""
    assert "line bar" in undriven_output(read_text(tmp_path, WRONG[name]()))


def test_outputs_that_follow_the_motors_are_taken(tmp_path: Path) -> None:
    """A rod whose stretch is a coordinate, with a line at its side; balancers."""
    side = LINE.replace("length = 0.5237", "length = 0.7")
    text = FOUR_BAR.replace("[[motor]]", side + "\n[[motor]]", 1)
    assert undriven_output(read_text(tmp_path, text)) == ""
    for name in ("palletizer", "linkage_arm", "kr300_balancer", "elbow"):
        assert undriven_output(flexgen.read(name)) == ""


def test_singular_home_is_not_a_line_that_drives() -> None:
    """The wrist is straight at home, and bent nearby."""
    home = {"home_deg": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]}
    assert undriven_output(flexgen.read("linkage_arm", overrides=home)) == ""


def test_line_with_mass_alone_does_not_drive(tmp_path: Path) -> None:
    """Such a robot has a singular pose, for another reason."""
    text = driven_by_a_line().replace("stiffness = 2e7", "stiffness = 0.0\nmass = 5.0")
    assert undriven_output(read_text(tmp_path, text)) == ""


@pytest.mark.slow
def test_library_of_such_a_robot_has_no_inversion(tmp_path: Path) -> None:
    """Its other functions are emitted."""
    robot = read_text(tmp_path, driven_by_a_line())
    made = flexgen.generate(robot, tmp_path / "c", build=False, progress=False)
    assert "inverse_dynamics" in made.functions
    assert not any("inversion" in name for name in made.functions)
