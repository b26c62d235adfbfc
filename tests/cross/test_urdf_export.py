"""The URDF file and the overlay of a robot: read back, the equations are the same; Pinocchio reads
the rigid robot.
"""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_robots import Case, cases
from seeded_draws import on_draws
from shipped_models import all_variants
from unchecked import unchecked

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.files.atomic_files import write_text
from flexgen.base.numerics.evaluate import evaluate
from flexgen.cli.main import main
from flexgen.exports.poses import roll_pitch_yaw
from flexgen.exports.urdf import urdf as urdf_module
from flexgen.exports.urdf.urdf import export_urdf, joint_groups
from flexgen.model.elements import (
    BacklashSpring,
    Body,
    CubicSpring,
    Dof,
    Element,
    Friction,
    Gear,
    PiecewiseSpring,
    Placement,
    RobotModel,
    SmoothSpring,
)
from flexgen.model.format.format_robot import rotation_matrix
from tests.support.loop_difference import loop_difference

pin = pytest.importorskip("pinocchio", reason="no pin; run: make setup-test")

# Relative to the largest entry: the numbers of the files have all digits, but angles and products
# of rotations round.
SAME = 1e-12
# Pinocchio computes with other recursions: rounding times the number of bodies.
RIGID = 1e-12
REFUSED = {
    "beam_arm": "beam",
    "four_mass": "rotational_drag",
}


def difference(
    model: RobotModel, again: RobotModel, count: int = 3, forward: bool = True
) -> float:
    """Largest relative difference of the functions of two models at random states, with the
    forward dynamics or not.
    """
    a = flexgen.derive(model)
    b = flexgen.derive(again)
    rng = np.random.default_rng(3)
    worst = 0.0
    for _ in range(count):
        q, v, acceleration = rng.uniform(-1.0, 1.0, (3, model.n_a))
        q_m = model.eta @ q[list(model.i_g)] + 0.01 * rng.uniform(-1.0, 1.0, model.n_m) * np.abs(
            model.eta
        ).max(axis=1)
        v_m, tau = rng.uniform(-1.0, 1.0, (2, model.n_m))
        calls = {
            "inverse_dynamics": (q, v, acceleration),
            "forward_dynamics": (q, v, q_m, v_m, tau),
            "forward_kinematics": (q,),
            "mass_matrix": (q,),
            "output": (q,),
        }
        if not forward:
            del calls["forward_dynamics"]
        for name, at in calls.items():
            for one, other in zip(
                evaluate(a.function(name), *at), evaluate(b.function(name), *at), strict=True
            ):
                worst = max(worst, float(np.abs(one - other).max() / (np.abs(one).max() or 1.0)))
    return worst


def rigid_difference(model: RobotModel, path: Path, count: int = 3) -> float:
    """Largest relative difference of the joint torques from Pinocchio's; all other coordinates are
    at rest.
    """
    robot = pin.buildModelFromUrdf(str(path))
    names = list(robot.names)[1:]
    at = {c.name: i for i, c in enumerate(model.coordinates)}
    robot.gravity.linear = np.array(model.base.rotation).T @ np.array(model.gravity)
    data = robot.createData()
    equations = flexgen.derive(model)
    rng = np.random.default_rng(4)
    worst = 0.0
    rows = [at[name] for name in names]
    for _ in range(count):
        q, v, a = np.zeros((3, model.n_a))
        q[rows], v[rows], a[rows] = rng.uniform(-1.0, 1.0, (3, len(rows)))
        theirs_q = np.zeros(robot.nq)
        for k, name in enumerate(names, 1):
            joint = robot.joints[k]
            value = q[at[name]]
            theirs_q[joint.idx_q : joint.idx_q + joint.nq] = (
                value if joint.nq == 1 else [np.cos(value), np.sin(value)]
            )
        order = [robot.joints[k].idx_v for k in range(1, len(names) + 1)]
        theirs_v, theirs_a = np.zeros((2, robot.nv))
        theirs_v[order] = v[rows]
        theirs_a[order] = a[rows]
        theirs = pin.rnea(robot, data, theirs_q, theirs_v, theirs_a)[order]
        # payload and rotors are in the overlay; in complete coupling, rotors at rest are part of
        # the arm
        lifted = replace(model, payload=Body(), motor_coupling="simplified")
        ours = evaluate(flexgen.derive(lifted).function("inverse_dynamics"), q, v, a)[0][0][rows]
        worst = max(worst, float(np.abs(ours - theirs).max() / np.abs(ours).max()))
        tip = robot.getFrameId(flexgen.read(path.with_suffix(".toml")).tip)
        pin.framesForwardKinematics(robot, data, theirs_q)
        base = pin.SE3(np.array(model.base.rotation), np.array(model.base.position))
        tool = (
            base
            * data.oMf[tip]
            * pin.SE3(np.array(model.tool.rotation), np.array(model.tool.position))
        )
        p, R = evaluate(equations.function("forward_kinematics"), q)
        worst = max(
            worst,
            float(np.abs(tool.translation - p[0]).max()),
            float(np.abs(tool.rotation - R[0]).max()),
        )
    return worst


# --- round trip and Pinocchio --------------------------------------------------------------------


@pytest.mark.parametrize("name", all_variants())
def test_round_trip(name, tmp_path):
    model = flexgen.read(name)
    path = tmp_path / "arm.urdf"
    refused = REFUSED.get(model.name)
    if refused:
        with pytest.raises(ModelError, match=refused):
            export_urdf(model, path)
        assert list(tmp_path.iterdir()) == []
        return
    assert export_urdf(model, path).files == (path, tmp_path / "arm.toml")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["arm.toml", "arm.urdf"]
    again = flexgen.read(tmp_path / "arm.toml")
    assert (loop_difference(again, model) if model.loops else difference(model, again)) < SAME
    same = (
        "name",
        "description",
        "source",
        "gravity",
        "base",
        "payload",
        "output",
        "home",
        "motor_coupling",
    )
    assert all(getattr(model, key) == getattr(again, key) for key in same)
    # the overlay names the element of the tool by its end alone
    parts = ("position", "rotation", "speed_max", "acceleration_max")
    assert all(getattr(model.tool, k, None) == getattr(again.tool, k, None) for k in parts)
    assert model.motors == again.motors and model.coordinates == tuple(
        replace(c, dof=replace(c.dof, axis=o.dof.axis), element=o.element)
        for c, o in zip(again.coordinates, model.coordinates, strict=True)
    )
    assert [move.name for move in model.moves] == [move.name for move in again.moves]
    assert model.sensors == again.sensors
    # Pinocchio reads the tree without its loops
    assert model.loops or rigid_difference(model, path) < RIGID


@pytest.mark.slow
@pytest.mark.parametrize("coupling", ["simplified", "complete"])
def test_random_robots(coupling, tmp_path):
    """General placements, several actuated degrees of freedom in an element, coupled wrists,
    carried rotors.
    """
    compared = []

    def check(case: Case) -> None:
        model = case.model
        try:
            path, overlay = export_urdf(model, tmp_path / "arm.urdf").files
        except ModelError as reason:
            assert re.search(
                "rotational_drag|does not move relative|without moving any mass", str(reason)
            )
            return
        again = flexgen.read(overlay)
        compared.append(difference(model, again, 2, forward=False))
        # the condition of a mass matrix of these robots is up to 1e6
        assert difference(model, again, 2) < 1e-9
        assert compared[-1] < 10 * SAME and rigid_difference(model, path, 2) < 10 * RIGID

    on_draws(check, cases(linear=True, coupling=coupling), 12, 2)
    assert len(compared) >= 6


@pytest.mark.parametrize(
    "spring",
    [
        CubicSpring(1e5, 4e8),
        SmoothSpring(5e4, 4e5, 2e-3),
        PiecewiseSpring(5e4, 4e5, 2e-3),
        BacklashSpring(1e5, 1e-3, 1e-4),
    ],
    ids=lambda spring: type(spring).__name__,
)
def test_springs_and_frictions(spring, tmp_path):
    model = flexgen.read("planar5_nmp")
    friction = Friction(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    elements = []
    for element in model.elements:
        (dof,) = element.dofs
        dof = (
            replace(dof, spring=spring)
            if dof.gear is None
            else replace(dof, gear=replace(dof.gear, spring=spring))
        )
        elements.append(replace(element, dofs=(replace(dof, friction=friction),)))
    motors = tuple(replace(motor, friction=friction) for motor in model.motors)
    model = replace(model, elements=tuple(elements), motors=motors)
    _, overlay = export_urdf(model, tmp_path / "arm.urdf").files
    assert difference(model, flexgen.read(overlay)) < SAME


def test_temperature_servo_and_uncertainty_are_in_the_overlay(tmp_path):
    """A warm robot has less viscous friction; the servo and what is known of the numbers belong to
    it.
    """
    friction = {"type": "gear", "viscous": 1e-2, "viscous_share": 0.6, "viscous_decay": 15.0}
    overrides = {
        "temperature": 45.0,
        "motor.m1.friction": friction,
        "servo": {
            "type": "cascade",
            "position_gain": [20.0, 30.0],
            "speed_gain": [1.0, 1.0],
            "integral_gain": [1, 2],
        },
        "uncertainty": {
            "stiffness": 0.1,
            "common": ["stiffness"],
            "parameters": ["m1.inertia", "m2.inertia"],
            "sd": [0.1, 0.2],
            "correlation": [1.0, 0.5, 0.5, 1.0],
        },
    }
    model = flexgen.read("elbow", overrides=overrides)
    again = flexgen.read(export_urdf(model, tmp_path / "arm.urdf").details["overlay"])
    assert difference(model, again) < SAME
    assert (again.temperature, again.servo, again.uncertainty) == (
        45.0,
        model.servo,
        model.uncertainty,
    )


def test_link_frames_and_sensors(tmp_path):
    """Placements ``link`` with a rotation and a position: bodies, sensors and the tip stay where
    they are.
    """
    model = flexgen.read("planar5_nmp")
    turned = Placement((0.1, -0.2, 0.3), rotation_matrix((0.3, -0.7, 1.1), False))
    elements = tuple(replace(element, link=turned) for element in model.elements)
    base = Placement((1.0, 2.0, 3.0), rotation_matrix((0.1, 0.2, 0.3), False))
    model = replace(model, elements=elements, base=base)
    sensors = flexgen.read(
        "planar5_nmp",
        overrides={
            "sensor": [
                {
                    "name": "acc",
                    "type": "accelerometer",
                    "element": "arm2",
                    "unit": "g",
                    "position": [0.1, 0.2, 0.3],
                },
                {"name": "laser", "type": "tracker", "unit": "mm", "axes": [[1, 1, 0], "z"]},
                {
                    "name": "enc",
                    "type": "link_encoder",
                    "coordinate": "q3",
                    "unit": "deg",
                    "sample_s": 1e-3,
                },
            ]
        },
    ).sensors
    model = replace(model, sensors=sensors)
    path, overlay = export_urdf(model, tmp_path / "arm.urdf").files
    again = flexgen.read(overlay)
    assert difference(model, again) < SAME and rigid_difference(model, path) < RIGID
    rng = np.random.default_rng(0)
    q, v, a = rng.uniform(-1.0, 1.0, (3, model.n_a))
    ours, theirs = (
        [value.ravel() for value in evaluate(flexgen.derive(m).function("sensors"), q, v, a)]
        for m in (model, again)
    )
    for one, other in zip(ours, theirs, strict=True):
        assert np.abs(one - other).max() < SAME * max(1.0, np.abs(one).max())


def test_planted_bugs(tmp_path):
    model = flexgen.read("manutec_r3")
    path, overlay = export_urdf(model, tmp_path / "arm.urdf").files
    good = path.read_text()
    assert rigid_difference(model, path) < RIGID
    for pattern, other in (
        (r'(<link name="body2">\s*<inertial>\s*<origin xyz=")0.172', r"\g<1>0.1720001"),
        (r'(<joint name="q2".*?<origin xyz="[^"]*" rpy=")0 0 0', r"\g<1>0 0 1e-6"),
        (r'ixy="-0.46"', 'ixy="-0.4600001"'),
    ):
        bad, count = re.subn(pattern, other, good, flags=re.DOTALL)
        assert count == 1
        path.write_text(bad)
        assert rigid_difference(model, path) > 10 * RIGID
        assert difference(model, flexgen.read(overlay)) > 10 * SAME


# --- details -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "pitch", [0.0, 0.4, np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, 1.5707963, np.pi]
)
def test_roll_pitch_yaw(pitch):
    rng = np.random.default_rng(1)
    for roll, yaw in [(0.0, 0.0), (np.pi, np.pi / 2), *rng.uniform(-np.pi, np.pi, (20, 2))]:
        R = np.array(rotation_matrix((roll, pitch, yaw), False))
        found = np.array(rotation_matrix(tuple(roll_pitch_yaw(R)), False))
        assert np.abs(found - R).max() < 4e-15


def test_changed_moves_are_refused(tmp_path):
    model = flexgen.read("elbow")
    longer = replace(model, moves=(replace(model.moves[0], duration=9.0), *model.moves[1:]))
    with pytest.raises(ArgumentError, match="moves that are not those of its file"):
        export_urdf(longer, tmp_path / "arm.urdf")
    assert list(tmp_path.iterdir()) == []


def test_names_that_are_not_identifiers_are_refused(tmp_path):
    model = flexgen.read("elbow")
    first = replace(model.elements[0], name='a"<b>&')
    with pytest.raises(ModelError, match=r"element\.name: given .*expected a letter followed by"):
        export_urdf(unchecked(model, elements=(first, *model.elements[1:])), tmp_path / "arm.urdf")
    assert list(tmp_path.iterdir()) == []


def test_errors_name_the_file_that_would_be_written(tmp_path):
    """A first body without mass: the coordinate moves nothing, which the reader of URDF files
    refuses.
    """
    model = flexgen.read("elbow@rigid")
    light = tuple(replace(element, body=Body()) for element in model.elements)
    motors = tuple(replace(motor, inertia=0.0) for motor in model.motors)
    with pytest.raises(ModelError, match=r"arm\.urdf:\d+:joint") as caught:
        export_urdf(
            replace(model, elements=light, motors=motors, payload=Body()), tmp_path / "arm.urdf"
        )
    assert "staging" not in str(caught.value)


def test_samples_of_a_move_are_found_from_another_folder(tmp_path):
    rows = "".join(f"{k / 10},{1.0 + 0.01 * k},{-0.3}\n" for k in range(11))
    (tmp_path / "track.csv").write_text("t,x,y\n" + rows)
    text = (Path(__file__).parents[2] / "models" / "planar5_nmp.toml").read_text()
    text += (
        "\n"
        "[[move]]\n"
        'name = "track"\n'
        'type = "sampled"\n'
        'file = "track.csv"\n'
        "start_rad = [0.3, -1.1]\n"
    )
    (tmp_path / "arm.toml").write_text(text)
    _, overlay = export_urdf(tmp_path / "arm.toml", tmp_path / "out" / "arm.urdf").files
    assert Path(flexgen.read(overlay).moves[-1].file).samefile(tmp_path / "track.csv")


def test_numbers_changed_in_python_are_written(tmp_path):
    model = flexgen.read("elbow")
    motors = tuple(replace(motor, inertia=2 * motor.inertia) for motor in model.motors)
    loaded = replace(model, motors=motors, payload=Body(3.0, (0.1, 0.0, 0.0)))
    _, overlay = export_urdf(loaded, tmp_path / "arm.urdf").files
    assert (
        difference(loaded, flexgen.read(overlay)) < SAME < difference(model, flexgen.read(overlay))
    )


def test_command_line(tmp_path, capsys):
    out = tmp_path / "deep" / "arm.urdf"
    assert main(["export", "urdf", "elbow", "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["overlay"] == str(out.with_suffix(".toml"))
    assert main(["export", "urdf", "elbow", "--out", str(tmp_path / "arm.xml")]) == 1
    assert "ends in .urdf" in capsys.readouterr().err


# --- files that are there ------------------------------------------------------------------------


def test_the_files_of_the_robot_are_not_replaced(tmp_path, monkeypatch, capsys):
    """Its model file, its URDF file, and the URDF file of its overlay, also by another name of the
    same file.
    """
    text = (Path(__file__).parents[2] / "models" / "elbow.toml").read_text()
    own = tmp_path / "elbow.toml"
    own.write_text(text)
    monkeypatch.chdir(tmp_path)
    assert main(["export", "urdf", "elbow.toml@rigid", "--out", "elbow.urdf"]) == 1
    assert "from which the robot was read" in capsys.readouterr().err
    (tmp_path / "other.toml").symlink_to(own)
    with pytest.raises(ArgumentError, match=r"'other\.toml', from which the robot was read"):
        export_urdf("elbow.toml", "other.urdf")
    assert own.read_text() == text and sorted(p.name for p in tmp_path.iterdir()) == [
        "elbow.toml",
        "other.toml",
    ]

    path, overlay = export_urdf("elbow.toml", tmp_path / "out" / "arm.urdf").files
    before = path.read_bytes(), overlay.read_bytes()
    # what flexgen wrote is replaced
    assert export_urdf("elbow.toml", path).files == (path, overlay)
    assert (path.read_bytes(), overlay.read_bytes()) == before
    tip = re.search(r'tip = "(\w+)"', overlay.read_text()).group(1)
    overlay.rename(tmp_path / "out" / "mine.toml")
    for robot in ("out/mine.toml", f"out/arm.urdf#base_link:{tip}"):
        with pytest.raises(ArgumentError, match=r"arm\.urdf', from which the robot was read"):
            export_urdf(robot, path)
    assert path.read_bytes() == before[0]


def test_an_overlay_that_flexgen_did_not_write_is_not_replaced(tmp_path):
    (tmp_path / "arm.toml").write_text('name = "written by flexgen"\n')
    with pytest.raises(ArgumentError, match="a file that flexgen did not write"):
        export_urdf("elbow", tmp_path / "arm.urdf")
    assert [p.name for p in tmp_path.iterdir()] == ["arm.toml"]


def test_both_files_are_checked_before_one_is_written(tmp_path, monkeypatch):
    (tmp_path / "arm.toml").mkdir()
    with pytest.raises(
        ArgumentError, match=r"overlay would be .*arm\.toml', which is a directory"
    ):
        export_urdf("elbow", tmp_path / "arm.urdf")
    assert not (tmp_path / "arm.urdf").exists()
    (tmp_path / "b.urdf").mkdir()
    with pytest.raises(ArgumentError, match="which is a directory"):
        export_urdf("elbow", tmp_path / "b.urdf")
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # (the tests may run as root)
    with pytest.raises(ArgumentError, match="a folder that you may write"):
        export_urdf("elbow", tmp_path / "c.urdf")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["arm.toml", "b.urdf"]


def test_the_overlay_is_written_first(tmp_path, monkeypatch):
    """Where the second file fails there is no URDF file without its gears and motors."""

    def written(path, text):
        if Path(path).suffix == ".urdf":
            raise ArgumentError("output: no space")
        return write_text(path, text)

    monkeypatch.setattr(urdf_module, "write_text", written)
    with pytest.raises(ArgumentError, match="no space"):
        export_urdf("elbow", tmp_path / "arm.urdf")
    assert [p.name for p in tmp_path.iterdir()] == ["arm.toml"]


@pytest.mark.parametrize("motors", ["", "100", "010", "0", "1", "101", "011", "00110"])
def test_the_degrees_of_freedom_of_an_element_have_one_motor_in_a_group(motors):
    """In their order; a group begins with its motor, the first one with what is before it too."""
    dofs = tuple(
        Dof(f"q{k}", "rotation", (0, 0, 1), Gear(rigid=True) if motor == "1" else None)
        for k, motor in enumerate(motors)
    )
    groups = joint_groups(Element("arm", dofs=dofs))
    assert (
        tuple(
            dof
            for before, own, after in groups
            for dof in (*before, *([own] if own else []), *after)
        )
        == dofs
    )
    assert len(groups) == max(1, motors.count("1")) and not any(
        before for before, _, _ in groups[1:]
    )
    for before, own, after in groups:
        assert not any(dof.actuated for dof in (*before, *after))
        assert own is None if not dofs else own.actuated == ("1" in motors)


# --- joints that follow others -------------------------------------------------------------------

FOLLOWERS = """
<robot name="r"><link name="base"/>
<link name="l1">{body}</link><link name="l2">{body}</link><link name="tip">{body}</link>
<joint name="j1" type="{kind}"><parent link="base"/><child link="l1"/>
<axis xyz="0 1 0"/>{limit}</joint>
<joint name="j2" type="{kind}"><parent link="l1"/><child link="l2"/>
<origin xyz=".4 0 0" rpy="1 0 0"/>
<axis xyz="0 1 0"/>{limit}<mimic joint="j1" multiplier="-2" offset="0.1"/></joint>
<joint name="j3" type="prismatic"><parent link="l2"/><child link="tip"/><origin xyz=".3 0 0"/>
<axis xyz="0 0 1"/><limit lower="-0.4" upper="0.6" effort="7" \
velocity="0.5"/>{last}</joint></robot>
"""
BODY_OF_ALL = """<inertial><origin xyz=".2 0 0.1"/><mass value="2"/>
<inertia ixx="0.1" iyy="0.2" izz="0.15" ixy="0.01" ixz="0" iyz="0"/></inertial>"""
LIMIT_OF_ALL = '<limit lower="-3" upper="3" effort="10" velocity="2"/>'
LAST = '<mimic joint="j1" multiplier="0.1" offset="0.2"/>'


def followers(folder: Path, kind: str, last: str) -> RobotModel:
    """Two joints that follow the first one, with an elastic gear; or one where that one is
    free.
    """
    text = FOLLOWERS.format(body=BODY_OF_ALL, limit=LIMIT_OF_ALL, kind=kind, last=last)
    (folder / "source.urdf").write_text(text)
    (folder / "source.toml").write_text(
        '[urdf]\nfile = "source.urdf"\nbase = "base"\ntip = "tip"\n[joint.j1]\n'
        "motor = { ratio = 50, inertia = 1e-4 }\n"
        'gear = { type = "elastic", side = "arm", spring = { type = "linear", stiffness = 2e3 } '
        "}\n"
    )
    return flexgen.read(folder / "source.toml")


def mimic_difference(model: RobotModel, path: Path) -> float:
    """Largest relative difference of inertia, bias and tool from Pinocchio, which reads
    <mimic>.
    """
    robot = pin.buildModelFromUrdf(str(path), mimic=True)
    data = robot.createData()
    equations = flexgen.derive(model)
    at = [robot.joints[robot.getJointId(c.name)].idx_v for c in model.coordinates]
    assert robot.nv == model.n_a
    rng = np.random.default_rng(3)
    worst = 0.0
    for _ in range(3):
        q, v = rng.uniform(-1.0, 1.0, (2, model.n_a))
        full = np.zeros((2, robot.nv))
        full[:, at] = q, v
        place = pin.integrate(robot, pin.neutral(robot), full[0])
        # Pinocchio 4.1 adds to the matrix of the call before where a joint follows another one
        M = np.triu(pin.crba(robot, robot.createData(), place))
        M = (M + np.triu(M, 1).T)[np.ix_(at, at)]
        h = pin.rnea(robot, data, place, full[1], np.zeros(robot.nv))[at]
        pin.framesForwardKinematics(robot, data, place)
        tool = data.oMf[robot.getFrameId("tip")].translation
        for name, at_state, expected in (
            ("mass_matrix", (q,), M),
            ("bias", (q, v), h),
            ("forward_kinematics", (q,), tool),
        ):
            found = np.array(equations.function(name).call(at_state)[0]).reshape(expected.shape)
            worst = max(worst, float(np.abs(found - expected).max() / np.abs(expected).max()))
    return worst


@pytest.mark.parametrize(("kind", "last"), [("revolute", LAST), ("continuous", "")])
def test_pinocchio_reads_joints_that_follow_others(tmp_path, kind, last):
    """Planted: a multiplier and an offset that are wrong."""
    model = followers(tmp_path, kind, last)
    path = tmp_path / "out.urdf"
    flexgen.export_urdf(model, path)
    text = path.read_text()
    assert mimic_difference(model, path) < RIGID
    for change in (('multiplier="-2"', 'multiplier="-2.01"'), ('offset="0.1"', 'offset="0.11"')):
        path.write_text(text.replace(*change))
        assert mimic_difference(model, path) > 1e-4


def test_a_joint_that_follows_another_one_keeps_zero_offset_and_limits(tmp_path):
    path = tmp_path / "out.urdf"
    written = flexgen.export_urdf(followers(tmp_path, "revolute", LAST), path)
    robot, source = (
        pin.buildModelFromUrdf(str(file)) for file in (path, tmp_path / "source.urdf")
    )
    for name in ("j2", "j3"):
        ours, theirs = (one.jointPlacements[one.getJointId(name)] for one in (robot, source))
        np.testing.assert_allclose(ours.homogeneous, theirs.homogeneous, atol=1e-15)
    for limits in ("lowerPositionLimit", "upperPositionLimit"):
        np.testing.assert_array_equal(getattr(robot, limits), getattr(source, limits))
    again = flexgen.read(written.details["overlay"])
    assert difference(flexgen.read(tmp_path / "source.toml"), again) < 1e-9


def test_a_joint_that_follows_another_one_without_a_urdf_file_has_the_limits_of_that_one(tmp_path):
    followers(tmp_path, "revolute", LAST)
    flexgen.export_urdf(tmp_path / "source.toml", tmp_path / "out.urdf")
    robot = flexgen.read(tmp_path / "source.toml")
    flexgen.export_urdf(replace(robot, urdf_joints={}), tmp_path / "other.urdf")
    text = (tmp_path / "other.urdf").read_text()
    assert 'lower="-6.0" upper="6.0"' in text  # twice as far
    assert "offset" not in text
    assert mimic_difference(robot, tmp_path / "other.urdf") < RIGID
