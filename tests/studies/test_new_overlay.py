"""`flexgen new --urdf`: each fault of a URDF file is repaired in the overlay, or is named."""

from __future__ import annotations

import json
import math
import tomllib
from itertools import pairwise
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.spec.toml_text import toml
from flexgen.cli.main import main
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.reader import read
from flexgen.studies.templates.new_model import new_overlay
from flexgen.studies.templates.urdf_names import new_names
from flexgen.studies.templates.urdf_overlay import FREQUENCY

BODY = (
    '<inertial><origin xyz=".2 0 0"/><mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.1" '
    'ixy="0" ixz="0" iyz="0"/></inertial>'
)
LIMIT = '<limit lower="-3" upper="3" effort="10" velocity="2"/>'


def link(name: str, body: str = BODY) -> str:
    return f"<link name={quoteattr(name)}>{body}</link>"


def joint(
    name: str, parent: str, child: str, inner: str = LIMIT, axis: str = "0 1 0", **more: str
) -> str:
    kind = more.get("kind", "revolute")
    place = more.get("place", ".4 0 0")
    ends = f"<parent link={quoteattr(parent)}/><child link={quoteattr(child)}/>"
    head = f'<joint name={quoteattr(name)} type="{kind}">{ends}<origin xyz="{place}"/>'
    return f'{head}<axis xyz="{axis}"/>{inner}</joint>'


def arm(*parts: str) -> str:
    """A file with two links on a base, and further parts."""
    text = [link("base", ""), link("l1"), link("tip"), *parts]
    return '<robot name="r">' + "\n".join(text) + "</robot>"


@pytest.fixture
def make(tmp_path):
    """The overlay of a file, written and as an object."""

    def call(text: str, ends: str = ""):
        (tmp_path / "r.urdf").write_text(text, encoding="utf-8")
        made = new_overlay("r", urdf=f"{tmp_path / 'r.urdf'}{ends}", folder=tmp_path)
        (tmp_path / "r.toml").write_text(made.text, encoding="utf-8")
        return tmp_path / "r.toml", made

    return call


FIRST = joint("j1", "base", "l1")
REPAIRS = {
    "slash": (joint("panda/j2", "l1", "tip"), "called panda_j2"),
    "dash": (joint("j-2", "l1", "tip"), "called j_2"),
    "digit": (joint("2_joint", "l1", "tip"), "called joint2_joint"),
    "space": (joint("joint 2", "l1", "tip"), "called joint_2"),
    "accent": (joint("Gelenk_\u00e4", "l1", "tip"), "called Gelenk_a"),
    "no letter": (joint("\u95a2\u7bc0", "l1", "tip"), "called joint in the model"),
    "long": (joint("a" * 40, "l1", "tip"), f"called {'a' * 31} "),
    "zero": (
        joint("j2", "l1", "tip", LIMIT.replace("10", "0").replace('"2"', '"-1"')),
        'limits left out: effort "0", velocity "-1"',
    ),
    "infinite": (
        joint("j2", "l1", "tip", LIMIT.replace('"3"', '"inf"').replace("10", "1e15")),
        'limits left out: upper "inf", effort "1e15"',
    ),
    "no ends": (
        joint("j2", "l1", "tip", '<limit effort="10" velocity="1"/>'),
        "limits left out: lower missing, upper missing",
    ),
    "no limits": (joint("j2", "l1", "tip", ""), "limits left out: lower missing, upper missing"),
    "friction": (
        joint("j2", "l1", "tip", f'{LIMIT}<dynamics damping="0.5" friction="0.1"/>'),
        "Coulomb friction 0.1 made smooth",
    ),
    "negative friction": (
        joint("j2", "l1", "tip", f'{LIMIT}<dynamics damping="-1"/>'),
        "no friction",
    ),
    "axis": (joint("j2", "l1", "tip", axis="0 1.5 0"), 'axis "0 1.5 0" normalized'),
    "mimic of nothing": (
        joint("j2", "l1", "tip", f'{LIMIT}<mimic joint="j9"/>'),
        "a coordinate of its own",
    ),
    "mimic of itself": (
        joint("j2", "l1", "tip", f'{LIMIT}<mimic joint="j2"/>'),
        "a coordinate of its own",
    ),
}


@pytest.mark.parametrize("case", REPAIRS)
def test_a_fault_is_repaired_and_named(case, make):
    second, words = REPAIRS[case]
    path, made = make(arm(FIRST, second))
    assert len(made.repairs) == 1
    assert words in made.repairs[0]
    assert f"# - {made.repairs[0]}" in made.text
    assert read(path).n_a == 2
    assert not flexgen.check(path).errors


def test_limits_that_are_right_are_kept(make):
    path, _ = make(arm(FIRST, joint("j2", "l1", "tip", LIMIT.replace('"2"', '"0"'))))
    robot = read(path)
    dof = robot.coordinates[1].dof
    assert (dof.lower, dof.upper, dof.speed_max) == (-3.0, 3.0, None)
    assert [motor.torque_max for motor in robot.motors] == [0.1, 0.1]  # effort over the ratio


BODIES = {
    "triangle": (BODY.replace('izz="0.1"', 'izz="0.3"'), "inertia_reduced"),
    "negative": (BODY.replace('izz="0.1"', 'izz="-0.1"'), "closest inertia"),
    "no mass": (BODY.replace('value="2"', 'value="0"'), "mass 1e-12 kg"),
}


@pytest.mark.parametrize("case", BODIES)
def test_an_invalid_body_is_repaired(case, make):
    body, words = BODIES[case]
    text = arm(FIRST, joint("j2", "l1", "l2"), joint("j3", "l2", "tip"), link("l2", body))
    path, made = make(text)
    assert [words in note for note in made.repairs] == [True]
    assert read(path).n_a == 3


def test_missing_bodies_are_listed_and_the_file_is_refused_until_they_are_filled_in(make, capsys):
    text = arm(FIRST, joint("j2", "l1", "tip")).replace(BODY, "")
    path, made = make(text)
    assert made.unfinished == ("l1", "tip")
    with pytest.raises(ModelError, match=r'unfinished: given bodies without mass: "l1", "tip"'):
        read(path)
    assert main(["solve", str(path)]) == 1
    assert '"l1", "tip"' in capsys.readouterr().err
    once = path.read_text().replace("mass = 0, com", "mass = 2, com", 1)
    path.write_text(once)
    with pytest.raises(ModelError, match=r'unfinished: given bodies without mass: "tip"'):
        read(path)
    body = "mass = 2, com = [0.2, 0, 0], inertia = [0.1, 0.1, 0.1]"
    for start in ("mass = 2, com = [0, 0, 0]", "mass = 0, com = [0, 0, 0]"):
        once = once.replace(f"{start}, inertia = [0, 0, 0, 0, 0, 0]", body)
    path.write_text(once)
    assert read(path).n_a == 2


def test_a_body_without_inertia_about_its_joint_gets_a_rotor(make):
    point = '<inertial><mass value="1"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'
    text = arm(FIRST, joint("j2", "l1", "tip"))
    path, made = make(text.replace(link("tip"), link("tip", f"{point}</inertial>")))
    assert "a rotor of" in made.repairs[0]
    assert read(path).n_a == 2


def test_what_is_not_repaired_is_named_in_one_message(make):
    text = arm(
        joint("j1", "base", "l1", axis="0 0 0"),
        joint("j2", "l1", "l2", kind="floating"),
        joint("j3", "l2", "tip", place="0 nan 0"),
        link("l2"),
    )
    with pytest.raises(ArgumentError, match="with 3 errors that no overlay repairs") as caught:
        make(text, "#base:tip")
    for words in ("joint.j1.axis.xyz", 'joint "j2" (line', "floating", "joint.j3.origin.xyz"):
        assert words in str(caught.value)


def test_the_chain_begins_behind_a_floating_joint_and_ends_before_links_without_mass(make):
    text = arm(
        joint("free", "base", "l1", kind="floating"),
        joint("j2", "l1", "l2"),
        joint("j3", "l2", "l3"),
        joint("j4", "l3", "tip"),
        link("l2"),
        link("l3"),
    )
    path, _ = make(text.replace(link("tip"), link("tip", "")))
    table = tomllib.loads(path.read_text())["urdf"]
    assert (table["base"], table["tip"]) == ("l1", "l3")


HOSTILE = (
    'x"\n[[motor]]\nname = "m',
    "a; system('ls') //",
    "*/ int x; /*",
    "\u202eevil\u2028",
    "]\nname=1",
    "'''",
)


def test_names_are_data_wherever_they_are_written(make, tmp_path):
    inner = "".join(
        joint(f"j{name}", f"l{name}", f"l{after}") for name, after in pairwise(HOSTILE)
    )
    links = "".join(link(f"l{name}") for name in HOSTILE)
    ends = joint("in", "l1", f"l{HOSTILE[0]}") + joint("out", f"l{HOSTILE[-1]}", "tip")
    text = arm(FIRST, ends, links, inner)
    path, made = make(text.replace("\n[[", "&#10;[[").replace("]\nname", "]&#10;name"))
    robot = read(path)
    assert robot.n_a == len(HOSTILE) + 2
    assert all(line.isprintable() for line in made.text.splitlines())
    assert [one.name for one in robot.urdf_joints.values()][2:-1] == [
        f"j{x}" for x in HOSTILE[:-1]
    ]
    library = flexgen.generate(robot, functions=["gravity"], directory=tmp_path / "c", build=False)
    for file in (path for path in library.directory.rglob("*") if path.is_file()):
        assert not any(name.strip() in file.read_text() for name in HOSTILE[1:])


def test_names_are_different_identifiers():
    names = ["a/b", "a-b", "a_b", "a" * 40, "a" * 41, "base", "1", "", "__"]
    new = new_names(names, "link", ("base",))
    assert new["a/b"] == "a_b_2"
    assert len({*new.values(), "a_b"}) == len(names)
    assert all(len(name) <= 31 for name in new.values())


@pytest.mark.parametrize("text", ["\u202e", "\x7f", "\x85", "\U000e0001", 'a"\\\n\t'])
def test_texts_and_keys_of_toml_are_read_back(text):
    written = toml({text: text, "k": [text]})
    assert written.isprintable()
    assert tomllib.loads(f"t = {written}")["t"] == {text: text, "k": [text]}


def test_the_verb_lists_the_repairs(tmp_path, capsys):
    file = tmp_path / "r.urdf"
    file.write_text(arm(FIRST, joint("j-2", "l1", "tip", "")))
    words = ["new", "r", "--urdf", str(file), "--out", str(tmp_path / "r.toml")]
    assert main(words) == 0
    assert capsys.readouterr().out.count("\nrepaired: joint ") == 2
    assert main([*words, "--force", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["repairs"]) == 2


def test_empty_lists_are_read(make):
    path, _ = make(arm(FIRST, joint("j2", "l1", "tip")))
    text = path.read_text()
    empty = "drop = []\nbranches = []\nlock = []\nunfinished = []"
    path.write_text(text.replace('tip = "tip"', f'tip = "tip"\n{empty}'))
    assert read(path).n_a == 2


def test_stiffness_is_that_of_the_pose_with_the_largest_inertia(make):
    """Upright at home the arm has next to no inertia about the column; stretched it has m l^2."""
    upright = BODY.replace('xyz=".2 0 0"', 'xyz="0 0 0.5"').replace("0.1", "0.003")
    text = arm(
        joint("turn", "base", "l1", axis="0 0 1", place="0 0 0"),
        joint("lift", "l1", "tip", place="0 0 0"),
    ).replace(BODY, upright)
    path, _ = make(text)
    gear = read(path).coordinates[0].dof.gear
    stretched = 2.0 * 0.5**2 + 0.006
    upper = stretched * (2.0 * math.pi * FREQUENCY) ** 2
    assert 0.9 * upper < gear.spring.stiffness < 1.05 * upper


@pytest.mark.parametrize("inertia", ["0.1", "0.001", "0.0001", "0.00005"])
def test_the_assumed_numbers_are_usual_where_the_inertia_is_small(make, inertia):
    """Upright at home the inertia about the column is up to 5000 times smaller than stretched."""
    upright = BODY.replace('xyz=".2 0 0"', 'xyz="0 0 0.5"').replace("0.1", inertia)
    turn = joint("turn", "base", "l1", axis="0 0 1", place="0 0 0")
    text = arm(turn, joint("lift", "l1", "tip", place="0 0 0")).replace(BODY, upright)
    path, _ = make(text)
    assumed = ("gear", "ratio", "inertia")
    told = [one for one in flexgen.check(path).warnings if one.key.endswith(assumed)]
    told += [one for one in flexgen.check(path).warnings if ".gear." in one.key]
    assert told == []


def test_the_rotor_of_a_light_last_axis_is_a_real_motor(make):
    """5e-5 kg m^2 over 100^2 are 5e-9 kg m^2: no motor."""
    light = BODY.replace('xyz=".2 0 0"', 'xyz="0 0 0"').replace("0.1", "5e-5")
    last = joint("j2", "l1", "tip", axis="0 0 1", place="0 0 0")
    text = arm(FIRST, last)
    text = text.replace(link("tip"), link("tip", light))
    path, _ = make(text)
    assert read(path).motors[1].inertia == pytest.approx(1e-7)
    assert not [one for one in flexgen.check(path).warnings if "rotor" in one.quantity]


def test_check_finds_what_happens_in_a_move_only(make):
    """Upright at home a soft gear carries nothing; in the move it hangs sideways."""
    upright = BODY.replace('xyz=".2 0 0"', 'xyz="0 0 0.5"')
    weak = LIMIT.replace("10", "5")
    first = joint("j1", "base", "l1", weak, place="0 0 0")
    text = arm(first, joint("j2", "l1", "tip", kind="fixed"))
    path, _ = make(text.replace(link("tip"), link("tip", "")).replace(BODY, upright))
    assert not flexgen.check(path).warnings
    wide = path.read_text().replace("end_rad = [0.3]", "end_rad = [1.5]")
    path.write_text(wide.replace("duration = 1.0", "duration = 5.0"))
    assert not flexgen.check(path, motions=False).warnings
    words = [one.quantity for one in flexgen.check(path).warnings]
    assert words == ["torque of the motor to that of gravity in the move joints"]


def test_the_move_is_within_the_limits_of_the_speeds(make):
    slow = LIMIT.replace('velocity="2"', 'velocity="0.2"')
    path, _ = make(arm(FIRST, joint("j2", "l1", "tip", slow)))
    assert not any("speeds" in one.quantity for one in flexgen.check(path).warnings)
    fast = path.read_text().replace("duration = 4.9", "duration = 1.0")
    path.write_text(fast)
    assert any("speeds" in one.quantity for one in flexgen.check(path).warnings)


# --- joints that follow others -------------------------------------------------------------------


def mimic(leader: str, factor: float, offset: float) -> str:
    return f'{LIMIT}<mimic joint="{leader}" multiplier="{factor}" offset="{offset}"/>'


CHAIN = (
    joint("j3", "l2", "tip", mimic("j2", 0.5, 0.2)),
    joint("j2", "l1", "l2", mimic("j1", -2.0, 0.1)),
    joint("j1", "base", "l1"),
    link("l2"),
)


def angle_of_tip(robot, q: np.ndarray) -> float:
    """The rotation of the tool about y."""
    R = np.array(derive(robot).function("forward_kinematics")(q)[1])
    return math.atan2(R[0, 2], R[0, 0])


def test_a_chain_of_mimic_in_any_order_is_folded(make):
    path, _ = make(arm(*CHAIN))
    robot = read(path)
    assert [c.name for c in robot.coordinates] == ["j1"]
    second = -2.0 * 0.3 + 0.1
    expected = 0.3 + second + 0.5 * second + 0.2
    assert abs(angle_of_tip(robot, np.array([0.3])) - expected) < 1e-12


def test_followers_of_a_locked_joint_are_where_it_has_them(make, tmp_path):
    make(arm(*CHAIN, joint("j4", "tip", "end"), link("end")))
    overlay = tmp_path / "locked.toml"
    ends = '[urdf]\nfile = "r.urdf"\nbase = "base"\ntip = "end"\n'
    second = -2.0 * 0.3 + 0.1
    for lock, third in (("{ j1 = 0.3 }", 0.5 * second + 0.2), ("{ j1 = 0.3, j3 = 0.7 }", 0.7)):
        overlay.write_text(f"{ends}lock = {lock}\n")
        robot = read(overlay)
        assert [c.name for c in robot.coordinates] == ["j4"]
        found = angle_of_tip(robot, np.array([0.4]))
        assert abs(found - (0.3 + second + third + 0.4)) < 1e-12


def test_a_joint_follows_one_behind_it(make):
    """The joint that moves is the second one; the first has its angle and the opposite sign."""
    first = joint("j1", "base", "l1", mimic("j2", -1.0, 0.25))
    path, _ = make(arm(first, joint("j2", "l1", "tip")))
    robot = read(path)
    assert [c.name for c in robot.coordinates] == ["j2"]
    assert abs(angle_of_tip(robot, np.array([0.4])) - 0.25) < 1e-12


def test_defaults_of_all_joints_do_not_free_a_follower(make):
    path, _ = make(arm(FIRST, joint("j2", "l1", "tip", mimic("j1", 0.5, 0.0))))
    assert '[joint."*"]' in path.read_text()
    assert read(path).n_m == 1


@pytest.mark.parametrize(
    ("keys", "names", "second"),
    [
        ("", ["j1"], 0.5 * 0.3 + 0.1),
        ('gear = { type = "rigid" }', ["j1", "j2"], 0.4),
        ('spring = { type = "linear", stiffness = 1e3 }', ["j1", "j2"], 0.4),
        ("mimic = { j1 = -1.0 }", ["j1"], -0.3 + 0.1),
    ],
)
def test_the_overlay_can_free_a_follower_or_change_its_factor(make, tmp_path, keys, names, second):
    make(arm(FIRST, joint("j2", "l1", "tip", mimic("j1", 0.5, 0.1))))
    overlay = tmp_path / "own.toml"
    ends = '[urdf]\nfile = "r.urdf"\nbase = "base"\ntip = "tip"\n'
    overlay.write_text(f"{ends}[joint.j2]\n{keys}\n")
    robot = read(overlay)
    assert [c.name for c in robot.coordinates] == names
    found = angle_of_tip(robot, np.array([0.3, 0.4][: len(names)]))
    assert abs(found - (0.3 + second)) < 1e-12


def test_a_chain_of_followers_only_moves_with_the_joint_that_they_follow(make):
    """Another follower of it stays where it is, on its own branch."""
    text = arm(
        joint("j1", "base", "l1", mimic("side", 1.0, 0.2)),
        joint("j2", "l1", "tip", mimic("side", -1.0, 0.0)),
        joint("side", "base", "s"),
        joint("finger", "s", "f", mimic("side", 0.5, 0.1)),
        link("s"),
        link("f"),
    )
    path, made = make(text, "#base:tip")
    robot = read(path)
    assert [c.name for c in robot.coordinates] == ["side"]
    assert "locked at 0.1" in made.repairs[-1]
    assert abs(angle_of_tip(robot, np.array([0.4])) - 0.2) < 1e-12


def test_names_of_links_may_have_colons(make, tmp_path):
    text = (
        arm(FIRST, joint("j2", "l1", "tip")).replace('"base"', '"a:b"').replace('"tip"', '"c:d:e"')
    )
    path, _ = make(text, "#a:b:c:d:e")
    assert read(path).n_a == 2
    with pytest.raises(ModelError, match=r'link\."c:d:e"\.name: .* rename'):  # the ends are found
        read(f"{tmp_path / 'r.urdf'}#a:b:c:d:e")


def test_a_leader_outside_the_chain_is_named(make, tmp_path):
    second = joint("j2", "l1", "tip", mimic("side", 1.0, 0.0))
    text = arm(FIRST, second, link("s"), joint("side", "base", "s"))
    file = tmp_path / "r.urdf"
    file.write_text(text)
    with pytest.raises(
        ModelError, match=r'follows "side", which is outside .* branches = \["s"\]'
    ):
        read(f"{file}#base:tip")
    path, made = make(text, "#base:tip")
    assert "fixed at 0" in made.repairs[0]
    assert read(path).n_a == 1


def test_mimic_of_each_other_is_refused(make, tmp_path):
    make(arm(FIRST, joint("j2", "l1", "tip")))
    file = tmp_path / "r.urdf"
    each = arm(
        joint("j1", "base", "l1", mimic("j2", 1.0, 0.0)),
        joint("j2", "l1", "tip", mimic("j1", 1.0, 0.0)),
    )
    file.write_text(each)
    with pytest.raises(ModelError, match="which follows it"):
        read(f"{file}#base:tip")


def test_degrees_of_freedom_before_a_follower_with_an_offset_are_refused(make):
    path, _ = make(arm(FIRST, joint("j2", "l1", "tip", mimic("j1", 0.5, 0.1))))
    path.write_text(
        path.read_text()
        + '\n[[joint.j2.before]]\nname = "b"\ntype = "rotation"\naxis = [1, 0, 0]\n'
        + 'spring = { type = "linear", stiffness = 1e4 }\n'
    )
    with pytest.raises(ModelError, match=r"joint\.j2\.before: given degrees of freedom before"):
        read(path)


# --- limits, axes, prefixes ----------------------------------------------------------------------


def test_limits_of_the_overlay_replace_wrong_ones(make, tmp_path):
    bad = '<limit lower="-inf" upper="inf" effort="inf" velocity="-1"/>'
    make(arm(FIRST, joint("j2", "l1", "tip", bad)))
    overlay = tmp_path / "limits.toml"
    ends = '[urdf]\nfile = "r.urdf"\nbase = "base"\ntip = "tip"\n[joint.j2]\n'
    keys = ["lower_deg = -90", "upper_deg = 90", "speed_max = 2.0", "motor = { torque_max = 5.0 }"]
    overlay.write_text(ends + "\n".join(keys))
    robot = read(overlay)
    dof = robot.coordinates[1].dof
    assert (dof.lower, dof.upper, dof.speed_max) == (-math.pi / 2, math.pi / 2, 2.0)
    assert robot.motors[1].torque_max == 5.0
    for k, word in enumerate(("lower", "upper", "velocity", "effort")):
        overlay.write_text(ends + "\n".join(keys[:k] + keys[k + 1 :]))
        with pytest.raises(ModelError, match=rf"limit\.{word}: .*limits = false"):
            read(overlay)


@pytest.mark.parametrize("axis", ["0 1.5 0", "0 0.01 0", "0 1e6 0"])
def test_an_axis_of_any_length_is_normalized(make, axis):
    path, _ = make(arm(FIRST, joint("j2", "l1", "tip", axis=axis)))
    assert read(path).coordinates[1].dof.axis == (0.0, 1.0, 0.0)


@pytest.mark.parametrize(
    "change",
    [
        ("<limit ", '<limit drake:acceleration="2" '),
        ("<robot ", '\n<?xml version="1.0"?>\n<robot '),
        ("</robot>", "<sensor:camera/></robot>"),
    ],
)
def test_prefixes_without_declaration_and_lines_before_the_declaration_are_read(make, change):
    path, _ = make(arm(FIRST, joint("j2", "l1", "tip")).replace(*change))
    assert read(path).n_a == 2
