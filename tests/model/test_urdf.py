"""URDF files and overlays: values by hand and by Pinocchio, what an overlay can say, and what is
refused and how.
"""

from __future__ import annotations

import json
import math
import random
import re
import sysconfig
from pathlib import Path

import numpy as np
import pytest
from bad_urdfs import BAD_OVERLAY, BAD_URDF, FINGER, OVERLAY, URDF
from referee import Answers

import flexgen
from flexgen.base.errors import ArgumentError, FlexgenError, ModelError
from flexgen.cli.main import main
from flexgen.codegen.emission.digest import model_digest
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model import elements as nouns
from flexgen.model.inertia import mass_matrix, massless_coordinates
from flexgen.model.reader import read
from flexgen.model.urdf.urdf import Urdf

HERE = Path(__file__).parents[1] / "support"
TWO_LINK = HERE / "urdf" / "two_link.urdf"
ROBOTS = Path(
    sysconfig.get_paths()["purelib"], "cmeel.prefix", "share", "example-robot-data", "robots"
)

EXACT = 1e-13  # sums of some ten products
POSE = 1e-12  # of a pose of size one, along chains of some ten frames
MASS = 1e-12  # of the largest entry of the inertia matrix
TORQUE = 1e-11  # of the largest torque


@pytest.fixture
def arm(tmp_path):
    """The good files, to be changed; the path of the overlay."""
    (tmp_path / "arm.urdf").write_text(URDF, encoding="utf-8")
    path = tmp_path / "arm.toml"
    path.write_text(OVERLAY, encoding="utf-8")
    return path


def edit(path: Path, *edits: tuple[str, str]) -> Path:
    text = path.read_text(encoding="utf-8")
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")
    return path


# --- values --------------------------------------------------------------------------------------


def test_two_links_by_hand():
    """Closed form of a planar arm with two links, the second with a camera lumped into it."""
    model = read(TWO_LINK, base="ground", tip="tip")
    l1 = 0.6
    l2 = 0.5
    m1 = 5.0
    c1 = 0.3
    j1 = 0.21
    m2 = 3.5
    c2 = (3.0 * 0.2 + 0.5 * 0.1) / 3.5
    # the camera is turned by 90 degrees about x: its Iyy is about z; its centre lies at (0.1, 0,
    # 0.06)
    j2 = 0.08 + 3.0 * (0.2 - c2) ** 2 + 0.0015 + 0.5 * (0.1 - c2) ** 2
    answers = Answers(derive(model))
    for q1, q2 in np.random.default_rng(1).uniform(-2, 2, (5, 2)):
        q = np.array([q1, q2])
        cosine = math.cos(q2 + math.pi / 2)
        m22 = j2 + m2 * c2**2
        m12 = m22 + m2 * l1 * c2 * cosine
        m11 = j1 + m1 * c1**2 + m22 + m2 * l1**2 + 2 * m2 * l1 * c2 * cosine
        expected = np.array([[m11, m12], [m12, m22]])
        assert np.abs(mass_matrix(model, q) - expected).max() < EXACT
        assert np.abs(answers.mass_matrix(q) - expected).max() < EXACT
        both = q1 + q2 + math.pi / 2
        position, rotation = answers.forward_kinematics(q)
        place = [
            l1 * math.cos(q1) + l2 * math.cos(both),
            l1 * math.sin(q1) + l2 * math.sin(both),
            0.0,
        ]
        assert np.abs(position - place).max() < EXACT
        assert np.abs(rotation[:, 0] - [math.cos(both), math.sin(both), 0.0]).max() < EXACT


def test_what_a_plain_file_gives():
    model = read(TWO_LINK, base="ground", tip="tip")
    assert (model.name, model.gravity, model.home, model.moves) == (
        "two_link",
        (0.0, 0.0, -9.81),
        (0.0, 0.0),
        (),
    )
    assert [e.name for e in model.elements] == [
        "upper",
        "fore",
        "tip",
    ] and model.tool == nouns.Placement()
    first, second = (e.dofs[0] for e in model.elements[:2])
    assert (first.name, first.type, first.axis) == ("shoulder", "rotation", (0.0, 0.0, 1.0))
    assert (first.lower, first.upper, first.speed_max, first.friction) == (
        None,
        None,
        None,
        nouns.NO_FRICTION,
    )
    assert (second.lower, second.upper, second.speed_max, second.friction.viscous) == (
        -2.0,
        1.5,
        4.0,
        0.7,
    )
    assert second.gear == nouns.Gear(rigid=True)
    assert model.motors[0] == nouns.Motor("m1", 0.0, ("shoulder",), (1.0,))
    assert model.motors[1] == nouns.Motor("m2", 0.0, ("elbow",), (1.0,), torque_max=60.0)
    assert model.output == nouns.Output("combination", "", ((1.0, 0.0), (0.0, 1.0)), "rad")
    assert model.elements[1].body.mass == 3.5 and model.elements[0].body.inertia[1][1] == 0.2
    assert read(f"{TWO_LINK}#ground:tip") == model and read(model.file) == model
    assert [e.name for e in read(f"{TWO_LINK}#ground:camera").elements] == [
        "upper",
        "fore",
        "camera",
    ]
    assert [e.name for e in read(f"{TWO_LINK}#ground:fore").elements] == ["upper", "fore"]
    assert read(f"{TWO_LINK}#upper:tip").n_a == 1  # the base is the ground


def test_the_file_is_read_to_the_last_digit(arm):
    """1.57079632679 is not a right angle, and it is not made one."""
    edit(arm.with_name("arm.urdf"), ('rpy="0.2 0 0"', 'rpy="1.57079632679 0 0"'))
    turned = read(arm).elements[1].origin.rotation
    assert turned[1][1] == math.cos(1.57079632679) != 0.0
    edit(arm.with_name("arm.urdf"), ("1.57079632679", "1.5707963267948966"))
    assert read(arm).elements[1].origin.rotation == ((1, 0, 0), (0, 0, -1), (0, 1, 0))


def test_tiny_numbers_of_converters_are_zero(arm):
    edit(
        arm.with_name("arm.urdf"),
        ('xyz="0.1 0 0.6"', 'xyz="1e-33 -2e-20 0"'),
        ('ixz="0.01"', 'ixz="1e-21"'),
    )
    model = read(arm)
    assert model.elements[1].origin.position == (0.0, 0.0, 0.0)


# --- against Pinocchio ---------------------------------------------------------------------------


class Peer:
    """The arm of a URDF file in Pinocchio, other joints locked; elastic coordinates of ours are
    not in it.
    """

    def __init__(self, model, urdf: Path, tip: str, locked: dict[str, float]):
        self.pin = pin = pytest.importorskip("pinocchio")
        whole = pin.buildModelFromUrdf(str(urdf))
        names = [c.name for c in model.coordinates if c.name in set(whole.names)]
        position = np.zeros(whole.nv)
        for name, value in locked.items():
            position[whole.idx_vs[whole.getJointId(name)]] = value
        rest = [
            whole.getJointId(name)
            for name in whole.names
            if name not in names and name != "universe"
        ]
        self.model = pin.buildReducedModel(
            whole, rest, pin.integrate(whole, pin.neutral(whole), position)
        )
        self.data = self.model.createData()
        self.ours = [k for k, c in enumerate(model.coordinates) if c.name in names]
        self.at = [self.model.idx_vs[self.model.getJointId(name)] for name in names]
        self.tip = self.model.getFrameId(tip)

    def _put(self, x):
        out = np.zeros(self.model.nv)
        out[self.at] = x[self.ours]
        return out

    def place(self, q):
        return self.pin.integrate(self.model, self.pin.neutral(self.model), self._put(q))

    def tool(self, q):
        self.pin.framesForwardKinematics(self.model, self.data, self.place(q))
        pose = self.data.oMf[self.tip]
        return pose.translation.copy(), pose.rotation.copy()

    def mass_matrix(self, q):
        M = np.triu(self.pin.crba(self.model, self.data, self.place(q)))
        return (M + np.triu(M, 1).T)[np.ix_(self.at, self.at)]

    def inverse_dynamics(self, q, v, a):
        return self.pin.rnea(self.model, self.data, self.place(q), self._put(v), self._put(a))[
            self.at
        ]


def close(found, expected, tolerance, size=None):
    size = np.abs(expected).max() if size is None else size
    assert np.abs(np.asarray(found) - expected).max() <= tolerance * size


def compare(model, urdf: Path, tip: str, locked) -> None:
    """Tool, inertia matrix and inverse dynamics of the arm at random states."""
    peer = Peer(model, urdf, tip, locked)
    answers = Answers(derive(model))
    rng = np.random.default_rng(3)
    block = np.ix_(peer.ours, peer.ours)
    for _ in range(10):
        q, v, a = np.zeros((3, model.n_a))
        q[peer.ours], v[peer.ours], a[peer.ours] = rng.uniform(-2, 2, (3, len(peer.ours)))
        for found, expected in zip(answers.forward_kinematics(q), peer.tool(q), strict=True):
            close(found, expected, POSE, 1.0)
        rotors = [0.0] * model.n_a
        for j, motor in enumerate(model.motors):
            if j not in model.i_m:
                rotors[[c.name for c in model.coordinates].index(motor.drives[0])] = (
                    motor.inertia * motor.ratio[0] ** 2
                )
        expected = peer.mass_matrix(q)
        close((mass_matrix(model, q) - np.diag(rotors))[block], expected, MASS)
        close(answers.mass_matrix(q)[block], expected, MASS)
        close(answers.inverse_dynamics(q, v, a)[peer.ours], peer.inverse_dynamics(q, v, a), TORQUE)


@pytest.mark.parametrize(
    ("name", "file", "tip", "locked"),
    [
        ("robots/ur5.toml", "ur_description/urdf/ur5_robot.urdf", "tool0", {}),
        ("robots/ur5_elastic.toml", "ur_description/urdf/ur5_robot.urdf", "tool0", {}),
        ("robots/panda.toml", "panda_description/urdf/panda.urdf", "panda_hand_tcp", {}),
    ],
    ids=["ur5", "ur5_elastic", "panda"],
)
def test_overlays_on_robots_agree_with_pinocchio(name, file, tip, locked):
    if not (ROBOTS / file).is_file():
        pytest.skip("no example-robot-data; run: make setup-test")
    compare(read(HERE / name), ROBOTS / file, tip, locked)


@pytest.mark.parametrize(
    ("file", "base", "tip"),
    [
        ("kinova_description/robots/kinova.urdf", "base", "j2s6s200_end_effector"),
        ("ur_description/urdf/ur10_robot.urdf", "world", "ee_link"),
        ("finger_edu_description/robots/finger_edu.urdf", "base_link", "finger_tip_link"),
    ],
)
def test_plain_robots_agree_with_pinocchio(file, base, tip):
    if not (ROBOTS / file).is_file():
        pytest.skip("no example-robot-data; run: make setup-test")
    compare(read(ROBOTS / file, base=base, tip=tip), ROBOTS / file, tip, {})


def test_own_examples_agree_with_pinocchio(arm):
    compare(read(f"{TWO_LINK}#ground:tip"), TWO_LINK, "tip", {})
    fingers = {"left_finger_joint": 0.02, "right_finger_joint": 0.02}
    compare(read("urdf_arm"), HERE.parents[1] / "models" / "urdf_arm.urdf", "tool_point", fingers)
    arm.write_text(arm.read_text().replace('rename = "q2"\n', "").replace(".q2.", ".lift."))
    compare(read(arm), arm.with_name("arm.urdf"), "tip", {"finger": 0.05})


def test_a_wrong_inertia_is_seen(arm):
    """The comparison would not pass a body that is left out or put elsewhere."""
    edit(arm, ('rename = "q2"\n', ""), (".q2.", ".lift."), (FINGER, "lock = { finger = 0.06 }\n"))
    with pytest.raises(AssertionError):
        compare(read(arm), arm.with_name("arm.urdf"), "tip", {"finger": 0.05})
    edit(arm, ("lock = { finger = 0.06 }\n", 'drop = ["finger"]\n'))
    with pytest.raises(AssertionError):
        compare(read(arm), arm.with_name("arm.urdf"), "tip", {"finger": 0.05})


# --- overlays ------------------------------------------------------------------------------------


def test_what_the_overlay_says(arm):
    model = read(arm)
    assert [c.name for c in model.coordinates] == ["turn", "q2", "bend", "slide"]
    assert [e.name for e in model.elements] == ["column", "arm2", "ram", "tip"]
    assert (model.n_m, model.n_g, model.n_e, model.dof) == (3, 3, 1, 5)
    assert model.coordinates[2].element == "arm2" and model.coordinates[2].dof.axis == (
        0.0,
        0.0,
        1.0,
    )
    assert [m.name for m in model.motors] == ["m1", "m2", "m3"]
    # of the limits, behind the gears
    assert [m.torque_max for m in model.motors] == [100 / 50, 200 / 80, 300]
    assert [m.inertia for m in model.motors] == [1e-3, 1e-3, 0.0]
    assert model.elements[1].dofs[0].gear.spring == nouns.LinearSpring(1e4)
    assert model.elements[1].dofs[0].friction.viscous == 0.5
    assert math.isclose(model.elements[2].body.mass, 2.2)
    assert model.elements[2].body.com[1] == pytest.approx(0.2 * 0.05 / 2.2)
    direct = read(arm, "direct")
    assert direct.dof == 4 and direct.motors[1].inertia == 0.0
    assert read(arm, overrides={"element.arm2.body.mass": 7}).elements[1].body.mass == 7.0
    assert model.home == (0.1, 0.2, 0.3)


def test_defaults_of_an_overlay(arm):
    arm.write_text('[urdf]\nfile = "arm.urdf"\nbase = "world"\ntip = "tip"\nlock = ["finger"]\n')
    model = read(arm)
    assert (model.name, model.description) == ("arm", 'from "world" to "tip" of arm.urdf')
    assert model.home == (0.0, 0.0, 0.3)  # zero is outside of the limits of the slide
    assert model.output.size == 3 and model.output.unit == "mixed"


def test_springs_bodies_limits_and_further_keys(arm):
    joint = (
        "[joint.slide]\n"
        'spring = { type = "linear", stiffness = 1e4 }\n'
        "damping = 3.0\n"
        "lower = -0.5\n"
        "limits = false\n"
        'before = [{ name = "early", type = "rotation", axis = [0, 2, 0], '
        'spring = { type = "linear", stiffness = 5.0 } }]\n'
        "[link.ram]\nbody = { mass = 1.0, com = [0.1, 0, 0], inertia = [1, 1, 1] }\n"
    )
    edit(
        arm,
        ("home_rad = [0.1, 0.2, 0.3]", "home_rad = [0.1, 0.2]"),
        (FINGER, 'drop = ["finger"]\n'),
    )
    arm.write_text(arm.read_text().replace("[variant", joint + "[variant"))
    model = read(arm)
    ram = model.elements[2]
    assert [d.name for d in ram.dofs] == ["early", "slide"] and not ram.dofs[1].actuated
    assert (ram.dofs[1].lower, ram.dofs[1].upper, ram.dofs[1].speed_max, ram.dofs[1].damping) == (
        -0.5,
        None,
        None,
        3.0,
    )
    assert ram.body == nouns.Body(1.0, (0.1, 0.0, 0.0), ((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    assert (model.n_m, model.n_e) == (2, 3)


def test_motors_of_the_overlay_may_be_coupled(arm):
    edit(
        arm,
        ("[joint.turn]\nmotor = { ratio = 50.0, inertia = 1e-3 }\n", ""),
        (
            "[variant",
            '[[motor]]\nname = "a"\ndrives = ["turn", "slide"]\nratio = [50, 3]\ninertia = 1e-3\n'
            '[[motor]]\nname = "b"\ndrives = "slide"\nratio = 100\ninertia = 1e-3\n[variant',
        ),
    )
    model = read(arm)
    assert [m.name for m in model.motors] == ["m2", "a", "b"]
    assert np.array_equal(model.eta, [[0, -80, 0], [50, 0, 3], [0, 0, 100]])
    assert [m.torque_max for m in model.motors] == [2.5, None, None]


def test_switches(arm):
    urdf = arm.with_name("arm.urdf")
    edit(
        urdf,
        ('friction="0"', 'friction="3"'),
        ('effort="200"', 'effort="0"'),
        ('izz="0.3"/>', 'izz="0.4"/>'),
    )
    edit(
        arm,
        (FINGER, FINGER + "dynamics = false\nlimits = false\n"),
        ('rename = "arm2"', "inertia_reduced = true"),
        ("element.arm2", "element.boom"),
    )
    model = read(arm)
    assert model.elements[1].dofs[0].friction == nouns.NO_FRICTION
    assert all(d.lower is None and d.speed_max is None for e in model.elements for d in e.dofs)
    assert all(m.torque_max is None for m in model.motors)
    assert model.elements[1].body.inertia[2][2] == 0.4


def test_joints_of_the_chain_can_be_locked(arm):
    edit(
        arm,
        ("finger = 0.05", "finger = 0.05, turn = 0.7"),
        ("home_rad = [0.1, 0.2, 0.3]", "home_rad = [0.2, 0.3]"),
        ("[joint.turn]\nmotor = { ratio = 50.0, inertia = 1e-3 }\n", ""),
        ("motor.m2", "motor.m1"),
    )
    turned = Answers(derive(read(arm)))
    free = None
    arm.write_text(OVERLAY)
    free = Answers(derive(read(arm)))
    for found, expected in zip(
        turned.forward_kinematics([0.2, 0.1, 0.3]),
        free.forward_kinematics([0.7, 0.2, 0.1, 0.3]),
        strict=True,
    ):
        close(found, expected, POSE, 1.0)


def test_bodies_fixed_to_the_ground_do_not_change_the_torques(arm):
    hung = (
        '<joint name="other" type="floating"><parent link="foot"/><child '
        'link="x"/></joint><link name="x"/>'
    )
    before = read(arm)
    edit(arm.with_name("arm.urdf"), ('<link name="foot"/>', '<link name="foot"/>' + hung))
    assert read(arm).text == before.text


def test_the_digest_follows_the_urdf_file(arm):
    before = read(arm)
    edit(arm.with_name("arm.urdf"), ('<sphere radius="0.1"/>', '<sphere radius="0.2"/>'))
    # a picture
    assert (read(arm).text, model_digest(read(arm))) == (before.text, model_digest(before))
    edit(arm.with_name("arm.urdf"), ('<mass value="6"/>', '<mass value="6.001"/>'))
    after = read(arm)
    assert after.text != before.text and model_digest(after) != model_digest(before)
    data = json.loads(after.text)
    assert data["element"][1]["body"]["mass"] == 6.001 and not {"urdf", "joint", "link"} & set(
        data
    )


def test_direct_drives_need_no_rotor(arm):
    """The inertia of a motor behind a rigid gear may be zero: forward dynamics undo inverse
    dynamics.
    """
    model = read(f"{TWO_LINK}#ground:tip")
    answers = Answers(derive(model))
    rng = np.random.default_rng(5)
    for _ in range(3):
        q, v, tau = rng.uniform(-1, 1, (3, 2))
        a = answers.forward_dynamics(q, v, np.zeros(2), np.zeros(2), tau)[0]
        friction = np.array([0.0, 0.7]) * v
        close(answers.inverse_dynamics(q, v, a), tau - friction, TORQUE, 1.0)
    with pytest.raises(
        ModelError, match=r"m2\.inertia: given 0\.0, expected a number > 0 behind an elastic gear"
    ):
        read(arm, overrides={"motor.m2.inertia": 0.0})


def test_massless_coordinates_are_found(arm):
    """Only where no body is moved: a massless link with a body behind it is none."""
    model = read(
        f"{TWO_LINK}#ground:tip",
        overrides={"element.upper.body.mass": 0.0, "element.upper.body.inertia": [0] * 3},
    )
    assert massless_coordinates(model) == () and model.elements[0].body.mass == 0.0
    with pytest.raises(
        ModelError,
        match=r"two_link\.urdf:17:joint\.elbow: given the coordinate elbow, which can move",
    ):
        read(model.file, overrides={"element.fore.body": {"mass": 0.0}})
    assert (
        read(
            model.file, overrides={"element.fore.body": {"mass": 0.0}, "motor.m2.inertia": 1e-6}
        ).n_a
        == 2
    )
    twice = 'name = "twice"\ntype = "rotation"\naxis = [0, 1, 0]'
    edit(arm, ('name = "bend"\ntype = "rotation"\naxis = [0, 0, 1]', twice))
    with pytest.raises(
        ModelError, match=r"joint\.twice: given the coordinates q2, twice, which can move"
    ):
        read(arm)


# --- where files are -----------------------------------------------------------------------------


def test_packages(arm, tmp_path, monkeypatch):
    for place in ("ros/arm_description/urdf", "ament/share/arm_ament/urdf"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "arm.urdf").write_text(
            URDF.replace('"finger" type="prismatic"', '"finger" type="fixed"')
        )
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/no/such/folder:{tmp_path / 'ros'}")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ament"))
    text = OVERLAY.replace(FINGER, "")
    arm.with_name("arm.urdf").write_text((tmp_path / place / "arm.urdf").read_text())
    expected = read(edit(arm, (FINGER, ""))).text
    for name in ("arm_description", "arm_ament"):
        arm.write_text(text.replace("arm.urdf", f"package://{name}/urdf/arm.urdf"))
        assert read(arm).text == expected
    plain = "package://arm_description/urdf/arm.urdf#world:tip"
    assert read(plain).file == plain and read(plain).n_a == 3
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ros" / "arm_description"))
    assert read(plain).n_a == 3  # the folder of the package itself


def test_plain_files_that_cannot_be_read(arm, tmp_path):
    urdf = edit(arm.with_name("arm.urdf"), ('"finger" type="prismatic"', '"finger" type="fixed"'))
    for wrong, words in (
        (
            dict(model=urdf),
            'without the two ends.*#BASE:TIP.*"world" and one of "jaw", "tip".*\\[urdf\\]',
        ),
        (dict(model=f"{urdf}#world"), "without the two ends"),
        (dict(model=urdf, base="world"), "without the two ends"),
        (dict(model=f"{urdf}#world:tip", base="world"), "expected each once"),
        (dict(model=urdf, base=3, tip="tip"), "base: given 3"),
        (dict(model=arm, base="world", tip="tip"), "expected a .urdf file"),
        (dict(model="elbow", tip="tip"), "expected a .urdf file"),
        (dict(model=tmp_path / "none.urdf", base="a", tip="b"), "which is not a file"),
        (dict(model="package://no_such/none.urdf#a:b"), "below ROS_PACKAGE_PATH"),
        (dict(model="a\0.urdf#a:b"), "which is not a file"),
        (dict(model=f"{urdf}#world:tip", variant="direct"), "variant of"),
    ):
        with pytest.raises(ArgumentError, match=words):
            read(**wrong)
    with pytest.raises(
        ModelError, match=r'urdf\.tip: given "ti", expected a link of .*"tip" \(there are'
    ):
        read(f"{urdf}#world:ti")
    big = tmp_path / "big.urdf"
    big.write_text(URDF + " " * 2_000_000)
    with pytest.raises(ModelError, match="more than 2000000 bytes"):
        read(f"{big}#world:tip")


def test_other_encodings(arm):
    urdf = arm.with_name("arm.urdf")
    expected = read(arm).text
    urdf.write_bytes(b"\xef\xbb\xbf" + URDF.encode())
    assert read(arm).text == expected
    urdf.write_bytes(URDF.encode("utf-16"))
    assert read(arm).text == expected
    urdf.write_bytes(URDF.encode().replace(b"grey", b"gr\xff"))
    with pytest.raises(ModelError, match=r"arm\.urdf:3:file: given text that is not XML"):
        read(arm)


def test_verbs_take_urdf_files(capsys, tmp_path):
    assert main(["describe", "--json", f"{TWO_LINK}#ground:tip"]) == 0
    assert json.loads(capsys.readouterr().out)["n_g"] == 2
    assert main(["describe", str(TWO_LINK)]) == 1
    assert "#BASE:TIP" in capsys.readouterr().err
    analysis = flexgen.analyze("urdf_arm")
    assert analysis.model.n_e == 1


# --- what is refused -----------------------------------------------------------------------------


def refused(path: Path, key: str, words: list[str], mark: str, text: str, file: Path) -> None:
    with pytest.raises(ModelError) as caught:
        read(path)
    error = caught.value
    message = str(caught.value)
    assert (
        message
        == f"{error.file}:{error.line}:{error.key}: given {error.given}, expected {error.expected}"
    )
    assert error.key == key or error.key.endswith(key)
    for word in words:
        assert word in message.removeprefix(error.file)
    marked = [number for number, line in enumerate(text.split("\n"), 1) if mark in line]
    if marked:
        assert (error.file, error.line) == (str(file), marked[0])
    assert message.isascii() and message.isprintable() and len(message) < 1000


@pytest.mark.parametrize("case", BAD_URDF)
def test_bad_urdf_is_refused(case, arm):
    edits, key, words = BAD_URDF[case]
    urdf = edit(arm.with_name("arm.urdf"), *edits)
    arm.write_text('[urdf]\nfile = "arm.urdf"\nbase = "world"\ntip = "tip"\nlock = ["finger"]\n')
    refused(arm, key, words, "<!--!-->", urdf.read_text(encoding="utf-8"), urdf)


def test_a_urdf_file_as_a_whole_is_refused_without_a_line(tmp_path, monkeypatch):
    with pytest.raises(ModelError, match=f"{tmp_path}: file: given a file that cannot be read"):
        Urdf(tmp_path, str(tmp_path))
    file = tmp_path / "large.urdf"
    file.write_text("<robot/>")
    monkeypatch.setattr("flexgen.model.urdf.urdf.SIZE_MAX", 3)
    with pytest.raises(ModelError, match=r"large\.urdf: file: given more than 3 bytes"):
        Urdf(file, str(file))


@pytest.mark.parametrize("case", BAD_OVERLAY)
def test_bad_overlay_is_refused(case, arm):
    edits, key, words = BAD_OVERLAY[case]
    edit(arm, *edits)
    refused(arm, key, words, "#!", arm.read_text(), arm)


WORDS = [
    "-1",
    "0",
    "1e400",
    "nan",
    '"x"',
    "",
    "<",
    ">",
    "/>",
    "turn",
    "fixed",
    "planar",
    "link",
    "joint",
    "&",
    "\x00",
    "é",
]


@pytest.mark.parametrize("seed", range(200))
def test_mutations_raise_nothing_else(seed, arm):
    rng = random.Random(seed)
    path = arm.with_name("arm.urdf") if seed % 4 else arm
    text = path.read_text()
    tokens = re.findall(r"\s+|[\w.]+|[^\w\s]", text)
    places = [i for i, token in enumerate(tokens) if not token.isspace()]
    for _ in range(rng.randrange(1, 3)):
        at = rng.choice(places)
        tokens[at] = rng.choice(
            ["", rng.choice(WORDS), tokens[at] * 2, tokens[rng.choice(places)]]
        )
    path.write_text("".join(tokens), encoding="utf-8")
    try:
        read(arm)
    except FlexgenError as error:
        assert isinstance(error, ModelError) and 0 <= error.line <= text.count("\n") + 2
