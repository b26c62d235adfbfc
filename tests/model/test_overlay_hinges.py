"""Hinges that an overlay adds where a URDF file has fixed links, and elements that it carries: the
same robots as those whose URDF file has joints there.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from panda import FLANGE, panda_urdf

import flexgen
from flexgen.base.errors import ModelError

EXACT = 1e-12
HINGE = '{ name = "bend", type = "rotation", axis = [0, 1, 0], spring = '
HINGE += '{ type = "linear", stiffness = 7.5 }, damping = 0.1 }'
FIXED = (
    '<joint name="to_flange" type="fixed"><parent link="link7"/>\n'
    f'<child link="flange"/><origin xyz="0 0 {FLANGE}"/></joint>'
)
MOVING = FIXED.replace('"to_flange" type="fixed"', '"bend" type="continuous"').replace(
    "</joint>", '<axis xyz="0 1 0"/></joint>'
)
BODY = (
    '<inertial><origin xyz="0.3 0 0"/><mass value="0.4"/><inertia ixx="0.001" iyy="0.002" '
    'izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial>'
)
WITH_BODY = ('<link name="flange"/>', f'<link name="flange">{BODY}</link>')
SPRING = '[joint.bend]\nspring = { type = "linear", stiffness = 7.5 }\ndamping = 0.1\n'
TOML_BODY = "body = { mass = 0.4, com = [0.3, 0, 0], inertia = [0.001, 0.002, 0.002] }\n"


def robot(folder: Path, name: str, text: str, *edits: tuple[str, str], tip: str = "flange"):
    """The robot of an overlay, on a Panda whose file is changed."""
    urdf = panda_urdf()
    for old, new in edits:
        assert old in urdf
        urdf = urdf.replace(old, new)
    (folder / f"{name}.urdf").write_text(urdf, encoding="utf-8")
    head = f'name = "arm"\n[urdf]\nfile = "{name}.urdf"\nbase = "link0"\ntip = "{tip}"\n'
    (folder / f"{name}.toml").write_text(head + text, encoding="utf-8")
    return flexgen.read(folder / f"{name}.toml")


def behaviour(model: flexgen.RobotModel) -> list[np.ndarray]:
    """Mass matrix, bias, elastic torques and pose of the tool at random states."""
    equations = flexgen.derive(model)
    rng = np.random.default_rng(5)
    out = []
    for _ in range(4):
        q, v = rng.uniform(-1.5, 1.5, (2, model.n_a))
        for name in ("mass_matrix", "bias", "elastic_torque", "forward_kinematics"):
            function = equations.function(name)
            found = function(*(q, v)[: function.n_in()])
            out += [np.array(x) for x in (found if isinstance(found, tuple) else (found,))]
    return out


def assert_same(one: flexgen.RobotModel, other: flexgen.RobotModel) -> None:
    for a, b in zip(behaviour(one), behaviour(other), strict=True):
        assert a == pytest.approx(b, abs=EXACT)


@pytest.fixture
def expected(tmp_path) -> flexgen.RobotModel:
    """The hinge is a joint of the URDF file, with a spring in the overlay."""
    return robot(tmp_path, "joint", SPRING, WITH_BODY, (FIXED, MOVING))


@pytest.mark.parametrize("side", ["before", "after"])
def test_hinge_between_two_fixed_links_is_that_of_a_joint_with_a_spring(tmp_path, expected, side):
    found = robot(tmp_path, "hinge", f"[joint.to_flange]\n{side} = [{HINGE}]\n", WITH_BODY)
    assert [c.name for c in found.coordinates][-1] == "bend"
    assert (found.n_m, found.n_e) == (7, 1)
    assert_same(found, expected)


def test_element_behind_the_tip_is_a_further_link(tmp_path, expected):
    text = (
        f'[[element]]\nname = "beam"\norigin = {{ position = [0, 0, {FLANGE}] }}\n'
        f"{TOML_BODY}[[element.dof]]\n"
    )
    text += 'name = "bend"\ntype = "rotation"\naxis = [0, 1, 0]\ndamping = 0.1\n'
    text += 'spring = { type = "linear", stiffness = 7.5 }\n'
    found = robot(tmp_path, "element", text, tip="link7")
    assert_same(found, expected)
    key = "element.beam.dof.bend.damping"
    changed = flexgen.read(found.file, overrides={key: 0.2})
    assert changed.elements[-1].dofs[0].damping == 0.2


def test_hinge_in_a_wrong_place_is_another_robot(tmp_path, expected):
    """The planted error: a hinge behind the joint before, which turns the body of that joint."""
    found = robot(tmp_path, "wrong", f"[joint.q7]\nafter = [{HINGE}]\n", WITH_BODY)
    pairs = zip(behaviour(found), behaviour(expected), strict=True)
    assert any(np.abs(a - b).max() > 1e-3 for a, b in pairs)


def test_elements_follow_the_tip_also_with_branches(tmp_path):
    camera = (
        '<link name="camera"/><joint name="pan" type="revolute"><parent link="link3"/>'
        '<child link="camera"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" '
        'effort="1"/></joint></robot>'
    ).replace('<link name="camera"/>', f'<link name="camera">{BODY}</link>')
    text = 'branches = ["camera"]\n[[element]]\nname = "load"\n' + TOML_BODY
    found = robot(tmp_path, "tree", text, ("</robot>", camera))
    assert found.parents["load"] == "flange"
    assert found.tip == "load"


def test_names_of_elements_must_be_new(tmp_path):
    with pytest.raises(ModelError, match="link3"):
        robot(tmp_path, "double", '[[element]]\nname = "link3"\n' + TOML_BODY)
