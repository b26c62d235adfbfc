"""Closed loops of URDF files: the equations are those of a model file with a table [[loop]]."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.model.format.closure import home_closure
from flexgen.studies.templates.new_model import new_overlay
from tests.support.linkage_urdfs import (
    BEARING,
    ROS2_CONTROL,
    TRANSMISSIONS,
    constraint,
    hinge_in_base,
    rigid_four_bar,
    urdf_of_four_bar,
)
from tests.support.linkages import FOUR_BAR, read_text
from tests.support.loop_difference import loop_difference

FRAMES = """
<link name="end_a"/><link name="end_b"/>
<joint name="at_rod" type="fixed"><parent link="rod_end"/><child link="end_a"/>
<origin xyz="0.35 0 0"/></joint>
<joint name="at_fore" type="fixed"><parent link="fore"/><child link="end_b"/>
<origin xyz="-0.18 0 0"/></joint>"""
EXTENDED = """
closed_loop: [['at_rod', 'end_b']]
type: ['3D']
name_mot: ['q1', 'q2']
joint_name: []
joint_type: []
"""


@cache
def home() -> dict[str, float]:
    """The angles of the arm at home, closed."""
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as folder:
        return home_closure(read_text(Path(folder), rigid_four_bar()))


def cut(mark: str = "") -> str:
    """The file of an exporter of CAD programs, with lines that are broken as long ones are."""
    point = ", ".join(repr(x) for x in hinge_in_base(home()).tolist())
    return (
        "# Closed loops\nclosures:\n- link_a: rod_end\n  link_b: fore\n"
        f"  point: [{point}]\n  axis: [0.0, -2.0, 1.0e-17]\n"
        f"dependent: [q3,\n  q4{mark}]\nindependent: [q1, q2]\n"
    )


def write(folder: Path, urdf: str, yaml: str = "", name: str = "loop_closures.yaml") -> Path:
    (folder / "arm.urdf").write_text(urdf, encoding="utf-8")
    if yaml:
        (folder / name).write_text(yaml, encoding="utf-8")
    return folder / "arm.urdf"


WAYS = {
    "point": (constraint() + TRANSMISSIONS, "", ""),
    "pin": (constraint("revolute") + ROS2_CONTROL, "", ""),
    "cut": ("", "loop_closures.yaml", "cut"),
    "frames": (FRAMES, "arm.yaml", EXTENDED),
}


@pytest.mark.parametrize("way", WAYS)
def test_equations_are_those_of_the_model_file(way: str, tmp_path: Path) -> None:
    """Asked 1e-12 of accelerations; <mimic> of a joint that the loop moves is left out."""
    inside, name, yaml = WAYS[way]
    more = '<mimic joint="q1" multiplier="-0.9"/>' if way == "cut" else ""
    text = urdf_of_four_bar(inside, home(), more)
    write(tmp_path, text, cut() if way == "cut" else yaml, name)
    found = flexgen.read(tmp_path / "arm.urdf", base="base", tip="fore")
    expected = read_text(tmp_path, rigid_four_bar())
    assert [c.name for c in found.coordinates] == ["q1", "q2"]
    assert loop_difference(found, expected, True) < 1e-12


OVERLAY = """
name = "four_bar"
gravity = [0.0, 0.0, -9.81]
home_deg = [60.0, -40.0]
[urdf]
file = "arm.urdf"
base = "base"
tip = "fore"
[joint."*"]
gear = { type = "elastic", side = "arm", spring = { type = "linear", stiffness = 4e5 } }
motor = { inertia = 0.004, ratio = 120.0 }
[joint.q1]
gear.damping = 300.0
[joint.q2]
gear = { damping = 200.0, spring = { stiffness = 3e5 } }
motor = { inertia = 0.003, ratio = 110.0 }
[joint.q3]
passive = { near_deg = -100.0 }
[joint.q4]
passive = { near_deg = 100.0 }
[[joint.bolt.after]]
name = "s"
type = "translation"
axis = [1, 0, 0]
spring = { type = "linear", stiffness = 2e7 }
damping = 4000.0
[tool]
position = [0.8, 0, 0]
[payload]
mass = 25.0
com = [0.8, 0, 0]
[output]
type = "tool_position"
axes = "xz"
"""


def overlaid(folder: Path, urdf: str, text: str = OVERLAY) -> flexgen.RobotModel:
    write(folder, urdf)
    (folder / "overlay.toml").write_text(text, encoding="utf-8")
    return flexgen.read(folder / "overlay.toml")


def test_an_overlay_adds_gears_and_the_stretch_of_the_rod(tmp_path: Path) -> None:
    """The elastic arm of the other tests of loops, and an error of 1 mm that it sees."""
    expected = read_text(tmp_path, FOUR_BAR)
    found = overlaid(tmp_path, urdf_of_four_bar(constraint(), {}))
    assert [c.name for c in found.coordinates] == [c.name for c in expected.coordinates]
    assert loop_difference(found, expected) < 1e-12
    wrong = overlaid(tmp_path, urdf_of_four_bar(constraint(at=BEARING + 1e-3), {}))
    assert loop_difference(wrong, expected) > 1e-4


def test_an_end_that_is_1_mm_aside_cannot_be_assembled(tmp_path: Path) -> None:
    with pytest.raises(ModelError) as found:
        overlaid(tmp_path, urdf_of_four_bar(constraint(aside=1e-3), {}))
    assert found.value.file.endswith("arm.urdf") and found.value.line == 14
    assert "its frames stay at least 0.00104" in str(found.value)


def test_loops_are_left_out_where_the_overlay_says_so(tmp_path: Path) -> None:
    plain = (
        OVERLAY.replace("[tool]", "[unused]").split("[joint")[0].replace("home_deg", "home_deg")
    )
    text = plain + 'loops = false\nbranches = ["rod_end"]\n'
    text = text.replace("home_deg = [60.0, -40.0]", "home_deg = [0, 0, 0, 0]")
    assert not overlaid(tmp_path, urdf_of_four_bar(constraint("screw"), {}), text).loops


ERRORS = {
    "type": (
        constraint("universal"),
        "",
        'constraint.bar.type: given "universal", expected one of "spherical", "revolute", ',
    ),
    "link": (
        constraint().replace('child link="fore"', 'child link="forearm"'),
        "",
        'constraint.bar.child: given an unknown link "forearm", expected "fore"',
    ),
    "element": (
        constraint().replace("parent_origin", "origin"),
        "",
        "constraint.bar: given an unknown element <origin>, expected ",
    ),
    "axis": (
        constraint("revolute").replace('<child_axis xyz="0 1 0"/>', '<child_axis xyz="0 0 0"/>'),
        "",
        'child_axis.xyz: given "0 0 0", expected a direction that is not zero',
    ),
    "number": (
        constraint().replace('xyz="0.35 0 0"', 'xyz="0.35 0"'),
        "",
        'parent_origin.xyz: given "0.35 0", expected 3 numbers',
    ),
    "twice": (constraint() * 2, "", "given a second constraint"),
    "motors": (
        constraint(),
        "",
        'given a closed loop of the joints "q2", "q4", "q1", "q3", none of them without a motor',
    ),
    "yaml": ("", "closures: [", "given a bracket that is not closed, expected ] or }"),
    "yaml link": (
        "",
        "closures:\n- {link_a: rod_end, link_b: x, point: [0, 0, 0], axis: [0, 1, 0]}\n",
        'loop_closures.yaml:2:closures[0].link_b: given "x", expected a link of ',
    ),
    "yaml key": (
        "",
        "closures:\n- {link_a: rod_end, link_b: fore, points: [0, 0, 0]}\n",
        "closures[0].points: given an unknown key, expected point ",
    ),
    "yaml of others": (
        "",
        "pin_loops:\n  - {name: a}\nball_loops: []\n",
        "closures: given the keys pin_loops, ball_loops, expected closures, dependent, "
        "independent (or in the overlay: [urdf] loops = false)",
    ),
    "yaml joint": ("", cut("x"), 'dependent: given an unknown joint "q4x", expected joints of '),
    "frame": (
        "",
        EXTENDED,
        'closed_loop[0]: given an unknown frame "at_rod", expected a link or joint of ',
    ),
    "dimension": ("", EXTENDED.replace("3D", "5d"), 'type: given "5d", expected 3d or 6d'),
    "ball": ("", EXTENDED.replace("joint_name: []", "joint_name: [q4]"), "joint_name: given"),
}


@pytest.mark.parametrize("case", ERRORS)
def test_what_is_wrong_is_refused_with_its_place(case: str, tmp_path: Path) -> None:
    inside, yaml, expected = ERRORS[case]
    inside = FRAMES if case == "dimension" else inside
    path = write(tmp_path, urdf_of_four_bar(inside, home()), yaml)
    with pytest.raises(ModelError) as found:
        flexgen.read(path, base="base", tip="fore")
    assert expected in str(found.value)


def test_an_end_before_the_base_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, urdf_of_four_bar(constraint() + TRANSMISSIONS, home()))
    with pytest.raises(ModelError, match='"rod_end", which is not behind the base "lower"'):
        flexgen.read(path, base="lower", tip="fore")


def test_a_chain_that_no_loop_holds_stays_a_chain(tmp_path: Path) -> None:
    """A second arm on the same base."""
    arm = (
        '<link name="other"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link><joint name="o" type="continuous">'
        '<parent link="base"/><child link="other"/></joint>'
    )
    path = write(tmp_path, urdf_of_four_bar(constraint() + arm, home()))
    found = flexgen.read(path, base="base", tip="other")
    assert not found.loops and [c.name for c in found.coordinates] == ["o"]


def test_new_writes_passive_joints_and_a_move_that_is_solved(tmp_path: Path) -> None:
    path = write(tmp_path, urdf_of_four_bar(constraint() + TRANSMISSIONS, home()))
    made = new_overlay("bar", urdf=f"{path}#base:fore", folder=tmp_path)
    assert [note.split(",")[0] for note in made.repairs] == [
        f'joint "{name}": passive' for name in ("q3", "q4")
    ]
    (tmp_path / "bar.toml").write_text(made.text, encoding="utf-8")
    robot = flexgen.read(tmp_path / "bar.toml")
    assert [c.name for c in robot.coordinates] == ["q1", "q2"] and robot.n_m == 2
    assert flexgen.solve(robot).status == "solved"


def test_new_asks_for_the_motors_of_a_loop(tmp_path: Path) -> None:
    path = write(tmp_path, urdf_of_four_bar(constraint(), home()))
    with pytest.raises(ArgumentError, match="none of them without a motor, expected <transmis"):
        new_overlay("bar", urdf=f"{path}#base:fore", folder=tmp_path)


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ("motor = { inertia = 1.0 }", "motor: given both a motor and a passive, expected either"),
        ("damping = 1.0", "no damping together with passive"),
        ("gear = { type = 'rigid' }", "gear"),
    ],
)
def test_a_passive_joint_has_nothing_else(more: str, expected: str, tmp_path: Path) -> None:
    text = OVERLAY.replace("[joint.q4]\n", f"[joint.q4]\n{more}\n")
    with pytest.raises(ModelError) as found:
        overlaid(tmp_path, urdf_of_four_bar(constraint(), {}), text)
    assert expected in str(found.value)
