"""The MJCF file of a robot: MuJoCo's accelerations are flexgen's, and a solved torque moves the
tool along its path.

Routes without common code: flexgen differentiates a Lagrangian; MuJoCo reads the file and runs its
own composite body and Newton-Euler algorithms.
"""

from __future__ import annotations

import functools
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from random_robots import Case, cases
from seeded_draws import on_draws
from shipped_models import all_variants

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.cli.main import main
from flexgen.exports.mujoco import mujoco_checks
from flexgen.exports.mujoco.mujoco import _Writer, mjcf
from flexgen.exports.mujoco.mujoco_checks import with_friction
from flexgen.exports.mujoco.mujoco_inertia import regroup
from flexgen.model.elements import Body, CubicSpring, PiecewiseSpring, RobotModel, SmoothSpring

# Relative to the largest acceleration of the arm, and of all: rounding, amplified by the condition
# of the mass matrix (1e4 in these robots); up to 9e-12 was measured on 80 random robots, 2e-13 on
# the files in models/.
ACCELERATION = 1e-9
# Models with laws that MuJoCo does not have, and a word of the reason.
REFUSED = {
    "abb_arm": "coulomb",
    "beam_arm": "beam",
    "kr300_balancer": "gas spring",
    "palletizer": "line without mass",
    "delta": "line without mass",
    "linkage_arm": "line without mass",
    "kr300@backlash": "dead band",
    "manutec_r3": "coulomb",
    "manutec_r3@coupled": "coulomb",
    "manutec_r3_18": "coulomb",
    "manutec_r3_18@coupled": "coulomb",
    "manutec_r3_24": "coulomb",
    "manutec_r3_30": "coulomb",
    "manutec_r3_efjm": "coulomb",
    "urdf_arm": "coulomb",
}


class Machine:
    """A file in MuJoCo, with the states and accelerations of flexgen's coordinates."""

    def __init__(self, model: RobotModel, text: str | None = None):
        self.model = model
        self.m = mujoco.MjModel.from_xml_string(mjcf(model) if text is None else text)
        self.d = mujoco.MjData(self.m)
        names = [c.name for c in model.coordinates] + [
            f"rotor.{model.motors[j].name}" for j in model.i_m
        ]
        joints = [self.m.joint(name).id for name in names]
        assert sorted(joints) == list(range(self.m.njnt)) and self.m.nv == model.dof
        self.at = self.m.jnt_dofadr[joints]
        self.motors = [self.m.actuator(motor.name).id for motor in model.motors]

    def set(self, q_a, v_a, q_m, v_m):
        i_m = list(self.model.i_m)
        self.d.qpos[self.at] = np.concatenate([q_a, q_m[i_m]])
        self.d.qvel[self.at] = np.concatenate([v_a, v_m[i_m]])

    def accelerations(self, q_a, v_a, q_m, v_m, tau_m):
        self.set(q_a, v_a, q_m, v_m)
        self.d.ctrl[self.motors] = tau_m
        mujoco.mj_forward(self.m, self.d)
        return self.d.qacc[self.at].copy()


def states(model: RobotModel, count: int):
    """Random states: gears up to 0.02 rad off (beyond the break of each spring in models/),
    springs 0.01.
    """
    rng = np.random.default_rng(7)
    i_g = list(model.i_g)
    i_e = list(model.i_e)
    for _ in range(count):
        q_a, v_a = rng.uniform(-1.0, 1.0, (2, model.n_a))
        q_a[i_e] *= 0.01
        size = np.abs(model.eta).max(axis=1)
        q_m = model.eta @ q_a[i_g] + rng.uniform(-0.02, 0.02, model.n_m) * size
        v_m = model.eta @ (v_a[i_g] + rng.uniform(-0.1, 0.1, model.n_g))
        yield q_a, v_a, q_m, v_m, rng.uniform(-10.0, 10.0, model.n_m)


def difference(model: RobotModel, machine: Machine, count: int = 4) -> float:
    """Largest relative difference of the accelerations, of the arm and of all coordinates."""
    function = flexgen.derive(model).function("forward_dynamics")
    worst = 0.0
    for at in states(model, count):
        a_a, a_m = (value[0] for value in evaluate(function, *at))
        ours = np.concatenate([a_a, a_m[list(model.i_m)]])
        theirs = machine.accelerations(*at)
        n = model.n_a
        for one, other in ((ours[:n], theirs[:n]), (ours, theirs)):
            worst = max(worst, float(np.abs(one - other).max() / np.abs(one).max()))
    return worst


# --- accelerations -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", all_variants())
def test_accelerations_or_a_reason(name):
    model = flexgen.read(name)
    if name in REFUSED:
        with pytest.raises(ModelError, match=REFUSED[name]):
            mjcf(model)
    else:
        assert difference(model, Machine(model)) < ACCELERATION


# Wrists with rigid gears, whose rotors turn about several directions.
RIGID_WRIST = "manutec_r3@coupled"


@pytest.mark.parametrize(
    "name", [name for name, why in REFUSED.items() if why == "coulomb" and name != RIGID_WRIST]
)
def test_without_coulomb_friction(name):
    model = flexgen.read(name)
    smooth = lambda f: replace(f, coulomb=0.0, stribeck=0.0, offset=0.0)  # noqa: E731
    elements = [
        replace(e, dofs=tuple(replace(d, friction=smooth(d.friction)) for d in e.dofs))
        for e in model.elements
    ]
    motors = tuple(replace(m, friction=smooth(m.friction)) for m in model.motors)
    less = replace(model, elements=tuple(elements), motors=motors)
    assert difference(less, Machine(model, mjcf(model, "viscous"))) < ACCELERATION


@pytest.mark.slow
@pytest.mark.parametrize("coupling", ["simplified", "complete"])
def test_random_robots(coupling):
    """General axes and placements, several degrees of freedom in an element, massless bodies,
    coupled wrists.
    """
    compared = []

    def check(case: Case) -> None:
        try:
            text = mjcf(case.model)
        # complete coupling behind rigid gears, thin bodies that carry rotors
        except ModelError as reason:
            assert re.search("several directions|principal moments|an inertia of", str(reason))
            return
        compared.append(difference(case.model, Machine(case.model, text), 2))
        assert compared[-1] < ACCELERATION

    on_draws(check, cases(linear=True, coupling=coupling), 20, 1)
    assert len(compared) >= 10


SPRINGS = [
    CubicSpring(1e5, 4e8),
    SmoothSpring(5e4, 4e5, 2e-3),
    SmoothSpring(4e5, 5e4, 2e-3),
    PiecewiseSpring(5e4, 4e5, 2e-3),
    PiecewiseSpring(4e5, 5e4, 2e-3),
]


@pytest.mark.parametrize("spring", SPRINGS, ids=lambda spring: f"{type(spring).__name__}")
def test_nonlinear_springs_in_gears_and_in_joints_without_motor(spring):
    model = flexgen.read("planar5_nmp")
    elements = []
    for element in model.elements:
        (dof,) = element.dofs
        dof = (
            replace(dof, spring=spring)
            if dof.gear is None
            else replace(dof, gear=replace(dof.gear, spring=spring))
        )
        elements.append(replace(element, dofs=(dof,)))
    model = replace(model, elements=tuple(elements))
    # 0.02 rad are ten times the break: the cubic polynomial and its correction are a thousand
    # times their sum
    assert difference(model, Machine(model)) < ACCELERATION


@functools.cache
def wrist(coupling: str, rigid: bool) -> RobotModel:
    """planar5_nmp with both motors driving both joints, and a drag on the last body."""
    gear = {"type": "rigid"} if rigid else None
    changes = {
        "motor_coupling": coupling,
        "motor.m2.drives": ["q1", "q2"],
        "motor.m2.ratio": [30.0, -90.0],
        "element.arm3.body.rotational_drag": 3.0,
        "motor.m1.axis": [0, 0, 1],
        "motor.m2.axis": [0, 0.6, 0.8],
        "motor.m1.carrier": "base",
        "motor.m2.carrier": "arm1",
    }
    if gear is not None:
        changes |= {"element.arm1.dof.q1.gear": gear, "element.arm2.dof.q2.gear": gear}
    return flexgen.read("planar5_nmp", overrides=changes)


@pytest.mark.parametrize("rigid", [False, True])
@pytest.mark.parametrize("coupling", ["simplified", "complete"])
def test_coupled_drives_rotors_that_ride_along_and_drags(coupling, rigid):
    model = wrist(coupling, rigid)
    assert difference(model, Machine(model)) < ACCELERATION


@pytest.mark.parametrize("joints", [["r1", "r2"], ["r1", "l1"]])
def test_a_rotor_behind_rigid_gears_of_two_branches_is_refused(joints, monkeypatch):
    """MuJoCo ignores what the armature of a tendon couples across branches: without the refusal
    motions differ.
    """
    two = {"motor.m_r1.drives": joints, f"motor.m_{joints[1]}.drives": joints}
    two |= {"motor.m_r1.ratio": [100, 40], f"motor.m_{joints[1]}.ratio": [-30, 100]}
    places = {"r1": "right1", "r2": "right2", "l1": "left1"}
    model = flexgen.read(
        "two_arm",
        overrides=two | {f"element.{places[q]}.dof.{q}.gear": {"type": "rigid"} for q in joints},
    )
    if joints == ["r1", "r2"]:
        assert difference(model, Machine(model)) < ACCELERATION
        return
    with pytest.raises(ModelError, match=r"motor\.m_r1\.drives: .*several branches \(r1, l1\)"):
        mjcf(model)
    monkeypatch.setattr(mujoco_checks, "on_one_chain", lambda *_: True)
    assert difference(model, Machine(model)) > 1e-3


def test_drag_of_the_payload_and_what_is_left_out(tmp_path):
    encoder = {"harmonics": [2], "cos": [1e-3]}
    drag = {"payload": {"mass": 3.0, "rotational_drag": 50.0}, "motor.m1.encoder_error": encoder}
    model = flexgen.read("planar5_nmp", overrides=drag)
    assert difference(model, Machine(model)) < ACCELERATION
    assert flexgen.export_mujoco(model, tmp_path / "a.xml").notes == (
        "not in the file: encoder_error",
    )
    assert flexgen.export_mujoco("planar5_nmp", tmp_path / "a.xml").notes == ()


def test_the_tool_is_in_its_place():
    for name in ("elbow", "kr300_efjm"):
        model = flexgen.read(name)
        machine = Machine(model)
        equations = flexgen.derive(model)
        for at in states(model, 2):
            p, R = evaluate(equations.function("forward_kinematics"), at[0])
            machine.accelerations(*at)
            site = machine.d.site("tool")
            assert (
                np.abs(site.xpos - p[0]).max() < 1e-12
                and np.abs(site.xmat.reshape(3, 3) - R[0]).max() < 1e-12
            )


def test_home_is_an_equilibrium():
    """At the key frame no coordinate accelerates: by less than 1e-9 of the acceleration with other
    torques.
    """
    # both arms in turn: MuJoCo has the joints of one branch after those of the other
    model = flexgen.read("two_arm")
    parents = model.parents
    elements = model.elements
    mixed = tuple(
        replace(elements[k], parent=parents[elements[k].name]) for k in (0, 1, 2, 4, 3, 5)
    )
    tree = replace(model, elements=mixed, home=tuple(model.home[k] for k in (0, 1, 3, 2, 4)))
    for robot in (tree, *map(flexgen.read, ("planar5_nmp", "kr300_efjm", "four_mass"))):
        machine = Machine(robot)
        mujoco.mj_resetDataKeyframe(machine.m, machine.d, machine.m.key("home").id)
        mujoco.mj_forward(machine.m, machine.d)
        held = np.abs(machine.d.qacc).max()
        machine.d.ctrl[:] += 1.0
        mujoco.mj_forward(machine.m, machine.d)
        assert held < 1e-9 * np.abs(machine.d.qacc).max()


# --- the same robot in motion --------------------------------------------------------------------


def played_back(machine: Machine, path, factor: float) -> np.ndarray:
    """The arm's motion under the torque of a trajectory times a factor: RK4, the torque of each
    stage.
    """
    start = float(path.time[0])
    end = float(path.time[-1])
    steps = round((end - start) / machine.m.opt.timestep)
    machine.m.opt.timestep = h = (end - start) / steps
    torques = factor * path.at(np.linspace(start, end, 2 * steps + 1))["tau_m"]

    def control(m, d):
        d.ctrl[machine.motors] = torques[min(round((d.time - start) / (h / 2)), 2 * steps)]

    mujoco.mj_resetData(machine.m, machine.d)
    machine.d.time = start
    machine.set(*(path[key][0] for key in ("q_a", "v_a", "q_m", "v_m")))
    moved = [machine.d.qpos[machine.at].copy()]
    mujoco.set_mjcb_control(control)
    try:
        for _ in range(steps):
            mujoco.mj_step(machine.m, machine.d)
            moved.append(machine.d.qpos[machine.at].copy())
    finally:
        mujoco.set_mjcb_control(None)
    return np.array(moved)[:, : machine.model.n_a]


@pytest.mark.parametrize(
    "name", ["planar5_nmp", pytest.param("four_mass@high", marks=pytest.mark.slow)]
)
def test_played_back_in_mujoco(name):
    """The solved torque in MuJoCo moves the output as in flexgen's own verification.

    The error of the verification is that of the torque. RK4 with the step of the file, h |pole| <=
    0.1, adds less than 1e-6 of the deflections of the fast modes (1e-4 m here): 1e-10 m.
    """
    equations = flexgen.derive(name)
    solution = flexgen.solve(equations)
    path = solution.trajectory
    machine = Machine(equations.model)
    claimed = next(
        figure.value for figure in solution.figures() if figure.key == "tool_error_max_m"
    )
    assert solution.status and claimed < 1e-8
    errors = []
    for factor in (1.0, 1.0001):
        moved = played_back(machine, path, factor)
        wanted = path.at(np.linspace(path.time[0], path.time[-1], len(moved)))["y_ref"]
        errors.append(
            float(np.abs(evaluate(equations.function("output"), moved)[0] - wanted).max())
        )
    assert errors[0] < 1.1 * claimed + 1e-10
    assert errors[1] > 100 * errors[0]  # a torque that is wrong by 1e-4 is seen


# --- planted bugs: each must be seen by the comparison -------------------------------------------


@pytest.mark.parametrize(
    ("pattern", "other"),
    [
        (r'(<fixed name="gear.q1" stiffness=")400000', r"\g<1>400001"),
        (r'(<fixed name="gear.q2"[^>]*damping=")(\d+)', r"\g<1>9\g<2>"),
        (r'(<joint name="q3"[^>]*stiffness=")150000', r"\g<1>150001"),
        (r'(<body name="arm3"[^>]*>\s*<joint[^>]*>\s*<inertial mass=")25"', r'\g<1>25.0001"'),
        (
            r'(<body name="rotor.m1"[^>]*>\s*<joint[^>]*>\s*<inertial[^>]*diaginertia=")[^"]*"',
            r'\g<1>1 1 1"',
        ),
    ],
)
def test_planted_bugs(pattern, other):
    model = flexgen.read("planar5_nmp")
    text = mjcf(model)
    planted, count = re.subn(pattern, other, text)
    assert count == 1 and difference(model, Machine(model)) < ACCELERATION
    assert difference(model, Machine(model, planted)) > 10 * ACCELERATION


# --- the file ------------------------------------------------------------------------------------


def test_the_file(tmp_path):
    path = flexgen.export_mujoco("planar5_nmp", tmp_path / "arm.xml").path
    text = path.read_text(encoding="utf-8")
    assert path == tmp_path / "arm.xml" and text == mjcf(flexgen.read("planar5_nmp"))
    root = ET.fromstring(text)
    assert [motor.get("name") for motor in root.iter("motor")] == ["m1", "m2"]
    assert not list(root.iter("equality"))
    m = mujoco.MjModel.from_xml_path(str(path))
    # a capsule for each link, from joint to joint, that neither weighs nor touches
    ends = [np.array(geom.get("fromto").split(), dtype=float) for geom in root.iter("geom")]
    places = [
        b.get("pos")
        for b in root.iter("body")
        if b.get("pos") and not b.get("name").startswith("rotor.")
    ]
    lengths = [np.linalg.norm(np.array(place.split(), dtype=float)) for place in places]
    assert {round(float(np.linalg.norm(end[3:] - end[:3])), 9) for end in ends} >= {
        round(x, 9) for x in lengths if x
    }
    assert len(ends) == 3 and all(
        g.get("contype") == g.get("conaffinity") == "0" for g in root.iter("geom")
    )
    assert m.neq == 0 and m.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    # stable where nothing is done about it: a second from home under the torques of the
    # equilibrium
    d = mujoco.MjData(m)
    mujoco.mj_resetDataKeyframe(m, d, 0)
    start = d.qpos.copy()
    for _ in range(round(0.05 / m.opt.timestep)):
        mujoco.mj_step(m, d)
    assert np.abs(d.qpos - start).max() < 1e-6


def test_names_that_mujoco_reserves():
    model = flexgen.read("planar5_nmp")
    names = ("world", "payload", "worldbody")
    elements = tuple(
        replace(element, name=name) for element, name in zip(model.elements, names, strict=True)
    )
    load = Body(3.0, (0.1, 0.0, 0.0), ((0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1)))
    odd = replace(model, elements=elements, payload=load)
    assert difference(odd, Machine(odd)) < ACCELERATION


@pytest.mark.parametrize("tilt", [1e-6, -1e-6, 1e-7])
def test_principal_axes_with_a_small_tilt(tilt, monkeypatch):
    """MuJoCo drops a tilt of up to 1e-6 rad against the axes of the body: 3e-8 of the
    accelerations here.
    """
    decompose = np.linalg.eigh

    def upright(tensor):
        """The decomposition whose axes are closest to those of the body; the signs are free."""
        moments, axes = decompose(tensor)
        if tensor.shape != (3, 3):  # a mass matrix
            return moments, axes
        near = np.abs(np.abs(axes) - np.eye(3)).max() < 0.1
        return moments, axes * np.sign(np.diag(axes)) if near else axes

    monkeypatch.setattr(np.linalg, "eigh", upright)
    model = with_friction(flexgen.read("manutec_r3"), "viscous")
    turn = np.array([[1.0, -tilt, 0.0], [tilt, 1.0, 0.0], [0.0, 0.0, 1.0]])
    inertia = 20 * turn @ np.diag([1.0, 4.0, 4.5]) @ turn.T
    elements = list(model.elements)
    elements[2] = replace(
        elements[2], body=replace(elements[2].body, inertia=tuple(map(tuple, inertia.tolist())))
    )
    tilted = replace(model, elements=tuple(elements))
    assert difference(tilted, Machine(tilted), 2) < ACCELERATION


def test_dry_friction_is_a_constraint():
    m = mujoco.MjModel.from_xml_string(mjcf(flexgen.read("manutec_r3"), "dry"))
    model = flexgen.read("manutec_r3")
    loss = {
        m.joint(int(j)).name: float(m.dof_frictionloss[m.jnt_dofadr[j]]) for j in range(m.njnt)
    }
    assert loss["rotor.m1"] == model.motors[0].friction.coulomb
    assert loss["q4"] == next(c.dof.friction.coulomb for c in model.coordinates if c.name == "q4")


def test_motors_behind_rigid_gears_are_friction_damping_and_armature_of_their_joint():
    """Power: r times the torque, r^2 times the damping and the inertia."""
    frictions = {
        "motor.m1.friction": {"coulomb": 0.5, "beta": 9.0, "viscous": 0.25},
        "motor.m1.ratio": -4.0,
    }
    own = {"element.upper.dof.q1.friction": {"coulomb": 3.0, "beta": 50.0, "viscous": 7.0}}
    model = flexgen.read("elbow@rigid", overrides=frictions | own)
    m = mujoco.MjModel.from_xml_string(mjcf(model, "dry"))
    at = m.jnt_dofadr[m.joint("q1").id]
    assert m.dof_frictionloss[at] == 3.0 + 4.0 * 0.5 and m.dof_damping[at] == 7.0 + 16.0 * 0.25
    assert m.dof_armature[at] == 16.0 * model.motors[0].inertia


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"motor.m1.friction": {"offset": 0.5}}, r"motor\.m1\.friction\.offset.*constant torque"),
        ({"element.arm3.body": {"mass": 1e-9}}, "an inertia of"),
    ],
)
def test_refusals_name_the_key(changes, words):
    with pytest.raises(ModelError, match=words) as found:
        mjcf(flexgen.read("planar5_nmp", overrides=changes))
    assert found.value.line == 0


def test_wrong_arguments(tmp_path):
    with pytest.raises(ArgumentError, match=r"ends in \.xml"):
        flexgen.export_mujoco("elbow", tmp_path / "arm.mjcf")
    with pytest.raises(ArgumentError, match="exact, viscous, dry"):
        flexgen.export_mujoco("elbow", tmp_path / "arm.xml", friction="coulomb")
    assert not list(tmp_path.iterdir())


def test_command_line(tmp_path, capsys):
    out = tmp_path / "arm.xml"
    assert main(["export", "mujoco", "elbow@payload", "--out", str(out)]) == 0
    assert f"wrote {out}: elbow@payload, 4 joints, 2 motors" in capsys.readouterr().out
    assert out.read_text() == mjcf(flexgen.read("elbow@payload"))
    assert main(["export", "mujoco", "manutec_r3", "--out", str(out)]) == 1
    assert "coulomb" in capsys.readouterr().err
    assert out.read_text() == mjcf(flexgen.read("elbow@payload"))  # the old file is still there
    assert (
        main(["export", "mujoco", "manutec_r3", "--friction", "viscous", "--out", str(out)]) == 0
    )
    assert main(["export"]) == 2


def test_an_inertia_that_no_body_can_have_is_refused():
    """Shares of a tensor move only across the axis of a joint: one that is too small along this
    axis stays.
    """
    model = flexgen.read("planar5_nmp")
    (dof,) = model.elements[0].dofs
    axes = np.linalg.svd(np.array([dof.axis]))[2]  # the axis of the joint first
    tensors = [axes.T @ np.diag([0.1, 5.0, 1.0]) @ axes, *[np.eye(3)] * (len(model.elements) - 1)]
    with pytest.raises(
        ModelError, match=r"element\.arm1\.body\.inertia: given principal moments 0\.1, 1, 5 "
    ) as found:
        regroup(model, tensors, [np.eye(3)] * len(model.elements))
    assert found.value.line == 0


def test_the_inertia_across_rotors_is_that_of_the_element_that_carries_them():
    motor = SimpleNamespace(carrier="arm1", axis=(0.0, 0.0, 1.0), inertia=4.0)
    writer = SimpleNamespace(drives=[SimpleNamespace(turning=None, motor=motor)])
    assert np.array_equal(_Writer._carried_inertia(writer, "arm1"), np.diag([2.0, 2.0, 0.0]))
    assert not _Writer._carried_inertia(writer, "arm2").any()
