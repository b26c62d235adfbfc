"""The page "From a datasheet": its table, commands and model file work as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import flexgen
from flexgen.cli.main import main

PAGE = Path(__file__).resolve().parents[2] / "docs" / "datasheet.md"


def block(language: str, number: int = 0) -> str:
    """A block of the page by its language; the table of the arm is the first text."""
    found = re.findall(
        rf"^```{language}\n(.*?)^```$", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL
    )
    return str(found[number])


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with the table of the page."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "reports").mkdir()
    Path("my_arm.csv").write_text(block("text"), encoding="utf-8")
    return tmp_path


def test_the_table_of_the_page_gives_the_output_of_the_page(place, capsys):
    command = block("bash").splitlines()[0]
    assert main(command.split()[1:]) == 0
    printed = capsys.readouterr().out
    assert block("text", 1).strip() in printed
    assert not flexgen.check("reports/my_arm.toml").warnings


@pytest.mark.slow
def test_the_commands_of_the_page_solve_all_moves(place):
    for command in block("bash").splitlines():
        assert main(command.split()[1:]) == 0
    for move in flexgen.read("reports/my_arm.toml").moves:
        assert str(flexgen.solve("reports/my_arm.toml", move).status) == "solved"


def test_the_palletizer_of_the_page_is_plausible_and_its_wrist_stays_level(place):
    Path("palletizer.toml").write_text(block("toml"), encoding="utf-8")
    robot = flexgen.read("palletizer.toml")
    assert not flexgen.check(robot).warnings
    assert robot.eta[2].tolist() == [0.0, 140.0, 140.0, 0.0]
    equations = flexgen.derive(robot)
    tool = equations.function("forward_kinematics")
    for q2, q3 in ((0.1, 0.4), (0.6, -0.3)):
        rotation = tool([0.0, 0.0, q2, q3, 0.0])[1].full()
        assert abs(rotation - [[1, 0, 0], [0, 1, 0], [0, 0, 1]]).max() < 1e-15


@pytest.mark.slow
def test_the_move_of_the_palletizer_is_solved(place):
    Path("palletizer.toml").write_text(block("toml"), encoding="utf-8")
    assert str(flexgen.solve("palletizer.toml").status) == "solved"


def test_the_arm_of_the_page_takes_the_motor_of_a_parallelogram(place):
    assert main(block("bash").splitlines()[0].split()[1:]) == 0
    changed = {"motor.m3.drives": ["A2", "A3"], "motor.m3.ratio": [101, 101]}
    robot = flexgen.read("reports/my_arm.toml", overrides=changed)
    assert robot.eta[2].tolist() == [0.0, 101.0, 101.0, 0.0, 0.0, 0.0]
