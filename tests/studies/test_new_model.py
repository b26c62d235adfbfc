"""`flexgen new`: templates and overlays for URDF files are read, plausible, and their default move
is solved.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

import flexgen
from flexgen.base.errors import ModelError
from flexgen.cli.main import main
from flexgen.cli.verb_tables.verb_texts import LISTS
from flexgen.model.reader import read
from flexgen.studies.templates import new_model

ROOT = Path(__file__).resolve().parents[2]
URDF = ROOT / "models" / "urdf_arm.urdf"
OVERLAY = """
[urdf]
file = "{}"
base = "floor"
tip = "tool_point"
lock = ["left_finger_joint", "right_finger_joint"]
{}
"""


@pytest.fixture
def made(tmp_path, capsys):
    """Run ``flexgen new`` and read what it wrote."""

    def call(*words):
        path = tmp_path / "mine.toml"
        assert main(["new", "mine", *words, "--out", str(path)]) == 0
        assert f"wrote {path}" in capsys.readouterr().out
        return path

    return call


def test_the_command_line_offers_the_templates_that_exist():
    folder = Path(new_model.__file__).parent
    assert sorted(path.stem for path in folder.glob("*.toml")) == sorted(LISTS["TEMPLATES"]())


@pytest.mark.parametrize("template", LISTS["TEMPLATES"]())
def test_a_template_is_plausible_and_its_numbers_have_comments(made, template):
    path = made("--template", template)
    robot = read(path)
    assert robot.name == "mine" and flexgen.describe(path)["dof"] == robot.dof >= 4
    found = flexgen.check(path)
    assert not found.errors and not found.warnings, found
    text = path.read_text()
    assert all(
        word in text
        for word in ("kg m^2", "N m", "rad/s", "# m, world axes" if template != "scara" else "# s")
    )
    analysis = flexgen.analyze(path)
    assert 0.1 < analysis.modes[0][0] < 100.0 and analysis.structural_index is not None


@pytest.mark.slow
@pytest.mark.parametrize("template", LISTS["TEMPLATES"]())
def test_the_default_move_of_a_template_is_solved(made, template):
    solution = flexgen.solve(made("--template", template))
    assert str(solution.status) == "solved"


def test_the_overlay_of_a_urdf_file_is_plausible(made):
    path = made("--urdf", f"{URDF}#floor:tool_point")
    robot = read(path)
    assert (robot.n_m, robot.dof) == (3, 6)  # every gear is elastic
    assert not flexgen.check(path).errors
    assert {motor.ratio for motor in robot.motors} == {(100.0,), (500.0,)}  # rad/rad, rad/m
    moved = flexgen.plan(robot).sample([0.0, 1.0]).q_g
    assert abs(moved[1, :, 0] - moved[0, :, 0]).min() > 0.01


def test_the_ends_of_a_urdf_file_are_found(made):
    assert made("--urdf", str(URDF)).read_text().count('base = "floor"') == 1


def test_the_link_that_bends_of_the_planar_template_is_plausible(made):
    """As its comment says: without the signs #, and with another position of the tool."""
    path = made("--template", "planar")
    before, after = path.read_text().split("remove these signs #:\n")
    lines, rest = after.split("\n\n", 1)
    bends = "\n".join(line.removeprefix("# ") for line in lines.splitlines())
    path.write_text(
        f"{before}\n{bends}\n\n{rest}".replace("position = [0, 0, 0.4]", "position = [0, 0, 0.15]")
    )
    found = flexgen.check(path)
    assert found.errors == found.warnings == () and flexgen.read(path).dof == 5


def test_an_existing_file_is_not_replaced(made, tmp_path, capsys):
    path = made()
    assert main(["new", "mine", "--out", str(path)]) == 1
    assert "which exists, expected a new file; --force replaces it" in capsys.readouterr().err
    assert (
        main(["new", "mine", "--out", str(path), "--force", "--template", "gantry", "--json"]) == 0
    )
    assert json.loads(capsys.readouterr().out)["out"] == str(path) and read(path).n_m == 3
    assert main(["new", "1st", "--out", str(tmp_path / "x.toml")]) == 1
    assert "name: given '1st', expected" in capsys.readouterr().err
    assert (
        main(["new", "mine", "--urdf", str(tmp_path / "no.urdf"), "--force", "--out", str(path)])
        == 1
    )


@pytest.mark.parametrize("ends", ["flor:tool_point", "floor:tool", "floor"])
def test_an_end_that_is_not_a_link_is_refused_with_the_names_of_all(ends, tmp_path, capsys):
    assert (
        main(["new", "mine", "--urdf", f"{URDF}#{ends}", "--out", str(tmp_path / "x.toml")]) == 1
    )
    said = capsys.readouterr().err
    assert (
        f"expected a link of {URDF}: " in said
        and '"pedestal"' in said
        and "rigid.toml" not in said
    )


def test_a_urdf_file_without_a_usable_name_and_a_move_without_a_tool_say_what_to_do(tmp_path):
    joint = (
        '<joint name="q" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 '
        '1"/></joint>'
    )
    links = (
        '<link name="a"/><link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" '
        'izz="1" '
    )
    links += 'ixy="0" ixz="0" iyz="0"/></inertial></link>'
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm-1">{links}{joint}</robot>')
    with pytest.raises(
        ModelError,
        match=r"name: given nothing.*'flexgen new NAME --urdf FILE' writes a file with one",
    ):
        read(f"{tmp_path / 'arm.urdf'}#a:b")
    move = (
        "[[move]]\n"
        'name = "m"\n'
        'type = "tool_line"\n'
        "start_deg = [0, 0, 0]\n"
        "displacement = [0, 0, 0.1]\n"
    )
    with pytest.raises(
        ModelError, match=r'or a table \[output\] with type = "tool_pose" or "tool_position"'
    ):
        overlay(tmp_path, move + "duration = 1.0\nsmoothness = 5\n")


def overlay(tmp_path, text):
    path = tmp_path / "overlay.toml"
    path.write_text(OVERLAY.format(URDF, text))
    return read(path)


def test_defaults_of_all_joints_fill_the_keys_that_a_joint_does_not_have(tmp_path):
    robot = overlay(
        tmp_path,
        """
[joint."*"]
gear = { type = "elastic", side = "arm", spring = { type = "linear", stiffness = 1e5 }, damping = \
10.0 }
motor = { ratio = 100, inertia = 1e-4 }
friction = { viscous = 2.0 }

[joint.lift]
gear = { spring = { stiffness = 3e5 } }
motor = { ratio = 50 }

[joint.slide]
gear = { type = "rigid" }
friction = { viscous = 7.0 }
""",
    )
    turn, lift, slide = (coordinate.dof for coordinate in robot.coordinates)
    assert (turn.gear.spring.stiffness, turn.gear.damping, turn.friction.viscous) == (
        1e5,
        10.0,
        2.0,
    )
    assert (lift.gear.spring.stiffness, lift.gear.damping, lift.gear.side) == (3e5, 10.0, "arm")
    assert slide.gear.rigid and slide.friction.viscous == 7.0
    assert [motor.ratio for motor in robot.motors] == [(100.0,), (50.0,), (100.0,)]
    assert all(math.isclose(motor.inertia, 1e-4) for motor in robot.motors)


def test_defaults_leave_joints_with_a_spring_and_motors_of_their_own_alone(tmp_path):
    robot = overlay(
        tmp_path,
        """
[joint."*"]
motor = { ratio = 100, inertia = 1e-4 }

[joint.lift]
spring = { type = "linear", stiffness = 1e4 }

[[motor]]
name = "own"
drives = "slide"
ratio = 300
inertia = 2e-5
""",
    )
    assert robot.n_e == 1 and [motor.ratio for motor in robot.motors] == [(100.0,), (300.0,)]


def test_defaults_have_no_names(tmp_path):
    with pytest.raises(flexgen.ModelError, match=r"joint\..*rename: given .*an unknown key"):
        overlay(tmp_path, '[joint."*"]\nrename = "q"\n')
