"""Forms of a robot that `flexgen.commission` adds to the one of the datasheet."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.identification.commissioning import forms
from flexgen.model.elements import Body

ARM = """
name = "arm"
gravity = [0, 0, -9.81]
home_rad = [0, 0]

[[element]]
name = "upper"
body = {{ mass = {mass}, com = {com}, inertia = [1.0, {inertia}, {inertia}, 0.02, 0.01, -0.03] }}

[[element.dof]]
name = "q1"
type = "rotation"
axis = [0, 1, 0]
gear = {{ type = "elastic", side = "arm", spring = {{ type = "linear", stiffness = 6e5 }} }}

[[element.dof]]
name = "t1"
type = "rotation"
axis = [0, 0, 1]
spring = {{ type = "linear", stiffness = 2e6 }}

[[element]]
name = "fore"
origin = {{ position = {way} }}
body = {{ mass = 20, com = [0.3, 0, 0], inertia = [0.2, 1.5, 1.5, 0, 0, 0] }}

[[element.dof]]
name = "q2"
type = "rotation"
axis = [0, 1, 0]
gear = {{ type = "elastic", side = "arm", spring = {{ type = "linear", stiffness = 3e5 }} }}

[[motor]]
name = "m1"
drives = "q1"
ratio = 100.0
inertia = 1e-3

[[motor]]
name = "m2"
drives = "q2"
ratio = 100.0
inertia = 1e-3

[tool]
position = [0.6, 0, 0]

[output]
type = "tool_position"
axes = "xz"
"""


def draw(folder: Path, seed: int) -> flexgen.RobotModel:
    """An arm of two links with a bearing; the first one has a drawn length, mass and center."""
    random = np.random.default_rng(seed)
    way = [float(x) for x in (1.0 + 0.2 * random.random(), 0.1 * random.random(), 0.05)]
    com = [0.5, *(float(x) for x in 0.05 * random.normal(size=2))]
    mass = 40 + 20 * random.random()
    file = folder / "arm.toml"
    file.write_text(ARM.format(way=way, com=com, mass=mass, inertia=0.2 * mass))
    return flexgen.read(str(file))


def composite(parts: list[tuple[Body, np.ndarray]]) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, first moment and second moment about the origin of bodies at places (3,) [m]."""
    mass = sum(body.mass for body, _ in parts)
    first = sum(body.mass * (place + np.array(body.com)) for body, place in parts)
    second = np.zeros((3, 3))
    for body, place in parts:
        c = place + np.array(body.com)
        second += np.array(body.inertia) + body.mass * (c @ c * np.eye(3) - np.outer(c, c))
    return float(mass), np.asarray(first), second


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_halves_of_a_link_are_the_link(tmp_path: Path, seed: int) -> None:
    """Mass, center and inertia of both by Steiner's theorem; the next joint is where it was; axes
    are across the link. A half whose center is a millimetre off is found.
    """
    robot = draw(tmp_path, seed)
    cut = forms.with_bending_link(robot)
    assert cut is not None and (cut.link, cut.tip) == ("upper", "upper_tip")
    whole, after = robot.elements
    inner, outer, last = cut.robot.elements
    middle = np.array(outer.origin.position)
    way = np.array(after.origin.position)
    assert_allclose(middle + np.array(last.origin.position), way, rtol=1e-12)
    for off in (0.0, 1e-3):
        place = middle + np.array([off, 0.0, 0.0])
        moved = composite([(inner.body, np.zeros(3)), (outer.body, place)])
        errors = [
            np.abs(np.array(a) - np.array(b)).max()
            for a, b in zip(moved, composite([(whole.body, np.zeros(3))]), strict=True)
        ]
        assert max(errors) < 1e-9 if off == 0.0 else max(errors) > 1e-3
    axes = np.array([dof.axis for dof in outer.dofs])
    assert_allclose(axes @ way, 0.0, atol=1e-8)
    assert_allclose(axes @ axes.T, np.eye(2), atol=1e-8)


def test_robots_without_a_link_to_cut(tmp_path: Path) -> None:
    """No bearing, or a name that is taken: no form."""
    robot = draw(tmp_path, 4)
    text = (tmp_path / "arm.toml").read_text()
    (tmp_path / "taken.toml").write_text(text.replace('"t1"', '"upper_bend_a"'))
    assert forms.with_bending_link(flexgen.read(str(tmp_path / "taken.toml"))) is None
    assert forms.with_bending_link(flexgen.read("elbow")) is None
    assert forms.with_bending_link(robot) is not None


def test_friction_of_joints_is_none_at_first(tmp_path: Path) -> None:
    """The form has the torques of the file; its friction has the width of the recorded speeds."""
    robot = draw(tmp_path, 5)
    form = forms.with_joint_friction(robot, forms.Extent({"q1": 1e3}, {"q1": 2.0}))
    random = np.random.default_rng(0)
    q, v, a = random.normal(size=(3, robot.n_a))
    one, other = (flexgen.derive(r).function("inverse_dynamics") for r in (robot, form))
    assert_allclose(np.array(one(q, v, a)), np.array(other(q, v, a)), rtol=1e-12)
    beta = {dof.name: dof.friction.beta for e in form.elements for dof in e.dofs}
    assert beta == {"q1": pytest.approx(50.0), "t1": 0.0, "q2": 0.0}
    tolerances = forms.friction_tolerances(form, forms.Extent({"q1": 1e3}, {"q1": 2.0}))
    assert tolerances == {"q1.viscous": pytest.approx(5.0), "q1.coulomb": pytest.approx(10.0)}
