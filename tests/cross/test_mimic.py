"""Axes that a mechanism moves, against the robot with all axes free: forces are projected on the
coordinates left.

q_all = T q,    M = T' M_all(T q) T,    h = T' h_all(T q, T v):    M_all, h_all: MuJoCo, free robot
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st
from mujoco_referee import MujocoReferee
from random_trees import trees
from seeded_draws import on_draws

import flexgen
from flexgen.base.errors import ModelError
from flexgen.codegen.recursion.functions import (
    RECURSIVE_BUILDERS,
    agrees,
    fast_function,
    operations_of,
    recursive_function,
)
from flexgen.codegen.recursion.joints import Joints
from flexgen.dynamics.mechanics.equations import derive
from flexgen.exports.mechanisms import mechanisms as mechanisms_of
from flexgen.exports.mujoco import mujoco_forces
from flexgen.model.elements import RobotModel
from flexgen.model.inertia import mass_matrix
from flexgen.model.reader import read

CLOSE = 1e-10  # of the largest entry
COUNT = 12


@st.composite
def mechanisms(draw: st.DrawFn) -> tuple[RobotModel, RobotModel, np.ndarray]:
    """A random tree, the same with some axes without motor moved by mechanisms, and T of the
    module's equation.
    """
    case = draw(
        trees().filter(
            lambda case: case.model.n_e > 0 and case.model.motor_coupling == "simplified"
        )
    )
    free = case.model
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    chosen = []
    factors = {}
    for k, c in enumerate(free.coordinates):
        before = [other.name for other in free.coordinates[:k] if other.name not in chosen]
        if not c.actuated and before and (not chosen or rng.integers(2)):
            names = rng.choice(before, size=min(2, len(before)), replace=False)
            chosen.append(c.name)
            factors[c.name] = {str(name): float(rng.uniform(-1.5, 1.5)) for name in names}
    if not chosen:
        return free, free, np.eye(free.n_a)
    elements = tuple(
        replace(
            e,
            dofs=tuple(
                replace(
                    d,
                    spring=None,
                    damping=0.0,
                    friction=type(d.friction)(),
                    mimic=tuple(factors[d.name].items()),
                )
                if d.name in factors
                else d
                for d in e.dofs
            ),
        )
        for e in free.elements
    )
    moved = replace(free, elements=elements)
    left = [c.name for c in moved.coordinates]
    rows = [factors.get(c.name, {c.name: 1.0}) for c in free.coordinates]
    return free, moved, np.array([[row.get(name, 0.0) for name in left] for row in rows])


def rotors_of(model: RobotModel) -> np.ndarray:
    """Inertia of the rotors behind rigid gears on the coordinates."""
    rigid = [j for j in range(model.n_m) if j not in model.i_m]
    eta = np.zeros((len(rigid), model.n_a))
    eta[:, list(model.i_g)] = model.eta[rigid]
    return eta.T @ np.diag([model.motors[j].inertia for j in rigid]) @ eta


def compare(free: RobotModel, moved: RobotModel, T: np.ndarray) -> None:
    """The arm's functions at random states."""
    referee = MujocoReferee(free, rotors=False)
    equations = derive(moved)
    rng = np.random.default_rng(0)
    for _ in range(2):
        q, v = rng.uniform(-1, 1, (2, moved.n_a))
        M = T.T @ referee.mass_matrix(T @ q) @ T
        h = T.T @ referee.bias(T @ q, T @ v)
        for found, expected in (
            (equations.function("mass_matrix")(q), M),
            (mass_matrix(moved, q), M + rotors_of(moved)),
            (equations.function("bias")(q, v), h[:, None]),
            (equations.function("forward_kinematics")(q)[0], referee.tool(T @ q)[0][:, None]),
        ):
            np.testing.assert_allclose(
                np.array(found), expected, rtol=0, atol=CLOSE * (1e-6 + np.abs(expected).max())
            )


def on_mechanisms(check) -> None:
    """A check of some random mechanisms, the same ones every time."""
    on_draws(lambda x: check(*x), mechanisms(), COUNT, 2)


@pytest.mark.slow
def test_the_moments_of_a_mechanism_act_on_its_coordinates():
    on_mechanisms(compare)


@pytest.mark.slow
def test_a_wrong_factor_is_found():
    def check(free, moved, T):
        wrong = np.where((T != 0.0) & (T != 1.0), 1.01 * T, T)
        compare(free, moved, wrong)

    with pytest.raises(AssertionError, match="Not equal"):
        on_mechanisms(check)


GEAR = (
    'gear = { type = "elastic", side = "arm", spring = { type = "linear", stiffness = 2e5 }, '
    "damping = 150 }"
)
TORSO = (
    """
name = "torso"
gravity = [0.0, -9.81, 0.0]
home_rad = [0.4, 0.5, 0.2]
tool = { position = [0.3, 0, 0] }
output = { type = "joint", joints = ["q1", "q2", "q4"] }
[[move]]
name = "joints"
type = "joint"
start_rad = [0.4, 0.5, 0.2]
end_rad = [0.6, 0.3, 0.5]
duration = 0.6
smoothness = 5
"""
    + "".join(
        f"""
[[element]]
name = "{name}"
origin = {{ position = {place} }}
body = {{ mass = {mass}, com = [0.15, 0.02, 0], inertia = [0.3, 0.3, 0.3] }}
[[element.dof]]
name = "{joint}"
type = "rotation"
axis = [0, 0, 1]
{drive}
"""
        for name, place, mass, joint, drive in (
            (
                "leg1",
                [0, 0, 0],
                20,
                "q1",
                GEAR,
            ),
            (
                "leg2",
                [0.3, 0, 0],
                15,
                "q2",
                GEAR,
            ),
            ("chest", [0.3, 0, 0], 10, "q3", "mimic = { q1 = -1.0, q2 = -1.0 }"),
            (
                "arm",
                [0.1, 0.3, 0],
                6,
                "q4",
                GEAR,
            ),
        )
    )
    + "".join(
        f"""
[[motor]]
name = "m{joint}"
drives = "{joint}"
ratio = 100
inertia = 1e-3
friction = {{ viscous = 1e-3 }}
"""
        for joint in ("q1", "q2", "q4")
    )
)


def test_a_torso_whose_chest_stays_upright_is_solved(tmp_path):
    (tmp_path / "torso.toml").write_text(TORSO)
    model = read(tmp_path / "torso.toml")
    assert [c.name for c in model.coordinates] == ["q1", "q2", "q4"]
    solution = flexgen.solve(model, "joints")
    assert solution.status == "solved"
    q = solution.trajectory["q_a"][::20]
    turned = [np.array(derive(model).function("forward_kinematics")(x)[1]) for x in q]
    for R, x in zip(turned, q, strict=True):  # the chest is upright: only q4 turns the tool
        np.testing.assert_allclose(R[:2, 0], [np.cos(x[2]), np.sin(x[2])], atol=1e-12)


# --- recursion -----------------------------------------------------------------------------------
PRODUCTS = ("inverse_dynamics", "arm_forward_dynamics", "forward_dynamics")


def compare_recursion(moved: RobotModel) -> None:
    """Every function with a recursion, and products with derivatives, against Lagrange's
    equations.
    """
    equations = derive(moved)
    rng = np.random.default_rng(0)
    checked = 0
    for name in (
        *RECURSIVE_BUILDERS,
        *(f"{one}_{kind}" for one in PRODUCTS for kind in ("jvp", "vjp")),
    ):
        fast = recursive_function(equations, name)
        if fast is None:
            continue
        slow = equations.function(name)
        for _ in range(2):
            given = [rng.uniform(-1.0, 1.0, fast.size_in(k)) for k in range(fast.n_in())]
            for x, y in zip(fast.call(given), slow.call(given), strict=True):
                expected = np.array(y)
                near = CLOSE * (1e-6 + np.abs(expected).max(initial=0.0))
                np.testing.assert_allclose(
                    np.array(x), expected, rtol=0, atol=10.0 * near, err_msg=name
                )
        checked += 1
    assert checked >= 9


def linkage(tmp_path: Path) -> RobotModel:
    """Two parallel linkages in space: a rod moves the elbow, and the hand stays upright."""
    text = TORSO.replace("axis = [0, 0, 1]", "axis = [0, 1, 0]").replace(
        "axis = [0, 1, 0]", "axis = [0, 0, 1]", 1
    )
    text = text.replace('name = "arm"', 'name = "arm"\nparent = "leg1"').replace(
        "[0.1, 0.3, 0]", "[0.1, 0.3, 0.2]"
    )
    (tmp_path / "linkage.toml").write_text(text)
    return read(tmp_path / "linkage.toml")


def test_recursions_of_mechanisms_are_lagranges_equations(tmp_path):
    (tmp_path / "torso.toml").write_text(TORSO)
    for robot in (read(tmp_path / "torso.toml"), linkage(tmp_path)):
        equations = derive(robot)
        compare_recursion(robot)
        fast = fast_function(equations, "inverse_dynamics")
        slow = equations.function("inverse_dynamics")
        assert fast is not None and operations_of(fast) < 0.7 * operations_of(slow.expand())


def test_a_recursion_without_the_torques_of_the_mechanism_is_found(tmp_path, monkeypatch):
    """A planted error: torques of the axis that the mechanism moves are lost, so that the robot
    has no recursion.
    """
    added = Joints.gather

    def without_the_third(self, x):
        return added(
            self, [*x[:2], [0.0 * y for y in x[2]] if isinstance(x[2], list) else 0.0, *x[3:]]
        )

    monkeypatch.setattr(Joints, "gather", without_the_third)
    robot = linkage(tmp_path)
    assert not agrees(derive(robot)) and fast_function(derive(robot), "mass_matrix") is None


@pytest.mark.slow
def test_recursions_of_random_mechanisms_are_lagranges_equations():
    on_mechanisms(lambda free, moved, T: compare_recursion(moved))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("mimic = { q1 = -1.0, q2 = -1.0 }", "mimic = { q1 = -1.0, q3 = -1.0 }"), r"mimic.*q3"),
        (("mimic = { q1 = -1.0, q2 = -1.0 }", "mimic = { q1 = -1.0, q9 = -1.0 }"), r"mimic.*q9"),
        (("mimic = { q1 = -1.0, q2 = -1.0 }", "mimic = {}"), r"mimic.*at least one"),
        (
            (
                "mimic = { q1 = -1.0, q2 = -1.0 }",
                "mimic = { q1 = -1.0 }\nfriction = { viscous = 1.0 }",
            ),
            r"friction.*mimic",
        ),
        (
            (
                "mimic = { q1 = -1.0, q2 = -1.0 }",
                'mimic = { q1 = -1.0 }\nspring = { type = "linear", stiffness = 1 }',
            ),
            r"both a",
        ),
    ],
)
def test_wrong_mechanisms_are_refused(tmp_path, change, words):
    (tmp_path / "torso.toml").write_text(TORSO.replace(*change))
    with pytest.raises(ModelError, match=words):
        read(tmp_path / "torso.toml")


LINK = """<link name="{}"><inertial><origin xyz="0.02 0 0"/><mass value="0.1"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><origin xyz="{} \
0 0"/>
<axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="5" velocity="2"/>{}</joint>"""
MIMIC = '<mimic joint="base" multiplier="0.5" offset="0.25"/>'
URDF = "\n".join(
    [
        '<robot name="fingers"><link name="palm"/>',
        LINK.format("first") + LINK.format("second"),
        JOINT.format("base", "palm", "first", 0, ""),
        JOINT.format("end", "first", "second", 0.04, MIMIC),
        "</robot>",
    ]
)


def test_mimic_of_a_urdf_file(tmp_path):
    (tmp_path / "fingers.urdf").write_text(
        URDF.replace('name="base"', 'name="q1"').replace('joint="base"', 'joint="q1"')
    )
    model = read(f"{tmp_path / 'fingers.urdf'}#palm:second")
    assert [c.name for c in model.coordinates] == ["q1"] and model.n_m == 1
    R = np.array(derive(model).function("forward_kinematics")(0.4)[1])
    angle = 0.4 + 0.5 * 0.4 + 0.25
    np.testing.assert_allclose(R[:2, 0], [np.cos(angle), np.sin(angle)], atol=1e-12)


def test_a_mimic_of_a_joint_that_is_not_there_is_refused(tmp_path):
    (tmp_path / "fingers.urdf").write_text(
        URDF.replace('joint="base" multiplier', 'joint="thumb" multiplier')
    )
    with pytest.raises(ModelError, match=r"joint.end.mimic.*thumb"):
        read(f"{tmp_path / 'fingers.urdf'}#palm:second")


def deviation(
    model: RobotModel, solution: flexgen.Solution, file: Path, step: float = 2e-4
) -> float:
    """Largest difference [rad] of the coordinates in MuJoCo, under the torques of a solution, to
    those planned.
    """
    mujoco = pytest.importorskip("mujoco")
    robot = mujoco.MjModel.from_xml_path(str(file))
    state = mujoco.MjData(robot)
    path = solution.trajectory
    robot.opt.timestep = step
    names = [robot.joint(k).name for k in range(robot.njnt)]
    start = dict(zip([c.name for c in model.coordinates], path["q_a"][0], strict=True))
    start |= {f"rotor.{m.name}": x for m, x in zip(model.motors, path["q_m"][0], strict=True)}
    start |= {
        key: sum(x * start[name] for name, x in own.items())
        for key, own in mechanisms_of(model).items()
    }
    state.qpos[:] = [start[name] for name in names]
    times = path.time[0] + step * np.arange(int((path.time[-1] - path.time[0]) / step))
    found = []
    for tau in path.at(times + step / 2)["tau_m"]:
        state.ctrl[:] = tau
        mujoco.mj_step(robot, state)
        found.append([state.qpos[names.index(c.name)] for c in model.coordinates])
    return float(np.abs(np.array(found) - path.at(times + step)["q_a"]).max())


def test_mujoco_keeps_the_mechanism(tmp_path):
    """Planted: a factor that is 5 % too large."""
    (tmp_path / "torso.toml").write_text(TORSO)
    model = read(tmp_path / "torso.toml")
    written = flexgen.export_mujoco(model, tmp_path / "torso.xml")
    assert "constraints" in str(written.notes)
    solution = flexgen.solve(model, "joints", verify=False)
    file = tmp_path / "torso.xml"
    assert deviation(model, solution, file) < 1e-7
    text = file.read_text()
    assert text.count('<joint joint="q2" coef="1"') == 1
    file.write_text(text.replace('<joint joint="q2" coef="1"', '<joint joint="q2" coef="1.05"'))
    assert deviation(model, solution, file) > 1e-3


def palletizer(turns: str) -> str:
    """The torso with the arm's direction relative to the world: a mechanism turns it back by
    ``turns``, next to q4.
    """
    moved = '\n[[element.dof]]\nname = "q3"\ntype = "rotation"\naxis = [0, 0, 1]\nmimic = '
    chest = TORSO.index('[[element]]\nname = "chest"'), TORSO.index('[[element]]\nname = "arm"')
    text = TORSO[: chest[0]] + TORSO[chest[1] :]
    drive = text.rindex(GEAR) + len(GEAR)
    return text[:drive] + moved + turns + text[drive:]


def test_mujoco_moves_two_axes_that_turn_one_body_about_one_direction(tmp_path, monkeypatch):
    """As in a palletizer. Planted: tendons without their armature, with which MuJoCo divides by
    zero.
    """
    (tmp_path / "torso.toml").write_text(palletizer("{ q1 = -1.0, q2 = -1.0 }"))
    model = read(tmp_path / "torso.toml")
    solution = flexgen.solve(model, "joints", verify=False)
    file = tmp_path / "torso.xml"
    flexgen.export_mujoco(model, file)
    assert deviation(model, solution, file) < 1e-7
    monkeypatch.setattr(mujoco_forces, "held_axes", lambda _: ({"q3": 0.0}, ""))
    flexgen.export_mujoco(model, file)
    assert not deviation(model, solution, file) < 1e-3


def test_an_axis_that_only_a_mechanism_of_another_branch_holds_is_refused_for_mujoco(tmp_path):
    """Its inertia would have to be that of a tendon over two branches, which MuJoCo ignores."""
    side = """
[[element]]
name = "side"
parent = "leg1"
body = { mass = 1, com = [0.1, 0, 0], inertia = [0.1, 0.1, 0.1] }
[[element.dof]]
name = "q5"
type = "rotation"
axis = [0, 0, 1]
spring = { type = "linear", stiffness = 1e4 }
"""
    text = palletizer("{ q5 = -1.0 }").replace(
        '[[element]]\nname = "leg2"', side + '[[element]]\nname = "leg2"\nparent = "leg1"'
    )
    (tmp_path / "torso.toml").write_text(text)
    with pytest.raises(
        ModelError, match=r"element\.arm\.dof\.q3\.mimic: given an axis that moves without inertia"
    ):
        flexgen.export_mujoco(read(tmp_path / "torso.toml"), tmp_path / "torso.xml")


@pytest.mark.parametrize("others", ["{ q1 = -1.0, q2 = -1.0 }", "{ q2 = -0.8 }"])
def test_an_exported_urdf_file_has_the_mechanism(tmp_path, others):
    """Read again it has the same equations; a URDF file with another factor has not."""
    (tmp_path / "torso.toml").write_text(TORSO.replace("{ q1 = -1.0, q2 = -1.0 }", others))
    model = read(tmp_path / "torso.toml")
    written = flexgen.export_urdf(model, tmp_path / "out" / "torso.urdf")
    text = written.files[0].read_text()
    assert ('<mimic joint="q2" multiplier="-0.8"' in text) == ("q1" not in others)

    def differs(again: RobotModel) -> float:
        (q, v, a) = np.random.default_rng(0).uniform(-1, 1, (3, model.n_a))
        angles = np.zeros((3, model.n_m))
        given = q, v, a, *angles, np.zeros(model.n_m)
        (x, _), (y, _) = (derive(m).function("residual")(*given) for m in (model, again))
        return float(np.abs(np.array(x - y)).max())

    assert [c.name for c in read(written.details["overlay"]).coordinates] == ["q1", "q2", "q4"]
    assert differs(read(written.details["overlay"])) < 1e-9
    overlay = written.details["overlay"]
    overlay.write_text(
        overlay.read_text().replace("q2 = -0.8", "q2 = -0.9").replace("q2 = -1 ", "q2 = -1.1 ")
    )
    assert differs(read(overlay)) > 1.0


def test_axes_of_mechanisms_in_elements_with_a_motor_move_in_the_urdf_file(tmp_path):
    """Pinocchio has the tool of flexgen; an axis that follows an elastic one, rigid in the file,
    has no <mimic>.
    """
    pinocchio = pytest.importorskip("pinocchio")
    bend = f'{GEAR}\n[[element.dof]]\nname = "e1"\ntype = "rotation"\naxis = [0, 1, 0]\n'
    bend += 'spring = { type = "linear", stiffness = 1e5 }'
    for turns, text in (
        ("{ q2 = -0.8 }", palletizer("{ q2 = -0.8 }")),
        ("{ e1 = -1.0 }", palletizer("{ e1 = -1.0 }").replace(GEAR, bend, 1)),
    ):
        (tmp_path / "torso.toml").write_text(text)
        model = read(tmp_path / "torso.toml")
        file = tmp_path / "out.urdf"
        flexgen.export_urdf(model, file)
        assert ("<mimic" in file.read_text()) == ("q2" in turns)
        robot = pinocchio.buildModelFromUrdf(str(file))
        data = robot.createData()
        q = np.array([0.4, 0.5, 0.2])
        angles = dict(zip(("q1", "q2", "q4"), q, strict=True)) | {
            "q3": -0.8 * q[1] if "q2" in turns else 0.0
        }
        turned = [f(angles[name]) for name in list(robot.names)[1:] for f in (np.cos, np.sin)]
        pinocchio.framesForwardKinematics(robot, data, np.array(turned))
        full = np.zeros(model.n_a)
        full[list(model.i_g)] = q
        R = np.array(derive(model).function("forward_kinematics")(full)[1])
        np.testing.assert_allclose(data.oMf[robot.nframes - 1].rotation, R, atol=1e-12)
