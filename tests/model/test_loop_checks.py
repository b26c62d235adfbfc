"""Closed loops in model files: errors with their place, their number and what is expected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.model.format.closure import home_closure
from tests.support.linkages import FOUR_BAR, read_text

SPRING = 'spring = { type = "linear", stiffness = 2e7 }\ndamping = 4000.0'
ROD = "passive = { near_deg = 100.0 }"
FORE = "passive = { near_deg = -100.0 }"
# Changes of the text, the key in the message, and parts of it.
BAD: dict[str, tuple[list[tuple[str, str]], str, list[str]]] = {
    "rod too short": (
        [('"rod_end", position = [0.35', '"rod_end", position = [0.02')],
        "loop.bar",
        ["cannot be assembled at home", "stay at least 0.1", "m apart"],
    ),
    "over-constrained": (
        [(ROD, SPRING)],
        "loop.bar",
        ["2 independent equations", "1 passive joints", "over-constrained"],
    ),
    "joint left free": (
        [(SPRING, "passive = { near = 0.0 }")],
        "loop.bar",
        ["2 independent equations", "3 passive joints", "free"],
    ),
    "two configurations": (
        [(FORE, "passive = { near_deg = -21.0 }"), (ROD, "passive = { near_deg = 140.0 }")],
        "element.fore.dof.q3.passive",
        ["selects neither", "-101", "deg"],
    ),
    "elastic loop": (
        [('name = "bar"\n', 'name = "bar"\nstiffness = 1e6\n')],
        "loop.bar.stiffness",
        ["a key of a spring", "a table [[line]]", "a dof with a spring"],
    ),
    "type of a spring": (
        [('name = "bar"\n', 'name = "bar"\ntype = "spring"\n')],
        "loop.bar.type",
        ['given "spring", expected one of axis, point, pose', "a table [[line]]"],
    ),
    "type that is close": (
        [('name = "bar"\n', 'name = "bar"\ntype = "points"\n')],
        "loop.bar.type",
        ["expected point (there are: axis, point, pose)"],
    ),
    "no loop": (
        [("[[loop]]", "[[loop_]]")],
        "loop_",
        ["unknown key"],
    ),
    "one body": (
        [('to = { element = "fore"', 'to = { element = "rod_end"')],
        "loop.bar.to",
        ["another body"],
    ),
    "spring and passive": (
        [(ROD, ROD + "\ndamping = 1.0")],
        "element.rod.dof.q4.damping",
        ["no damping together with passive"],
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_loops_that_are_wrong_are_refused(tmp_path: Path, name: str) -> None:
    """Each with its key and the number that shows it."""
    changes, key, parts = BAD[name]
    text = FOUR_BAR
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    with pytest.raises(flexgen.ModelError) as error:
        read_text(tmp_path, text)
    message = str(error.value)
    assert f"{key}:" in message
    assert all(part in message for part in parts), message


def test_passive_joint_outside_every_loop_is_refused(tmp_path: Path) -> None:
    """The error names the joint."""
    text = FOUR_BAR[: FOUR_BAR.index("[[loop]]")] + FOUR_BAR[FOUR_BAR.index("[[motor]]") :]
    with pytest.raises(flexgen.ModelError, match=r"q3.*a joint of a closed loop"):
        read_text(tmp_path, text)


def test_dead_center_is_refused_with_its_condition(tmp_path: Path) -> None:
    """A rod that is as long as its two levers can reach, within a micrometer."""
    model = read_text(tmp_path, FOUR_BAR)
    home = home_closure(model)
    crank = 0.2 * np.array([-np.cos(home["q2"]), -np.sin(home["q2"])])
    elbow = 0.7 * np.array([np.cos(home["q1"]), np.sin(home["q1"])])
    length = float(np.linalg.norm(elbow - crank)) + 0.18 - 1e-8
    text = FOUR_BAR.replace(
        '"rod_end", position = [0.35', f'"rod_end", position = [{length - 0.35}'
    )
    with pytest.raises(flexgen.ModelError, match=r"condition number of \d"):
        read_text(tmp_path, text)


def test_file_without_a_position_selects_no_configuration(tmp_path: Path) -> None:
    """The key near is required."""
    with pytest.raises(flexgen.ModelError, match=r"q4\.passive\.near_rad.*near_deg"):
        read_text(tmp_path, FOUR_BAR.replace(ROD, "passive = {}"))
