"""Random robots before two outside referees: MuJoCo and Pinocchio.

Whatever flexgen computes of the mechanics is compared on random robots, on each of its routes:
Lagrange's equations (`Equations.function`) and the recursive code of
`flexgen.codegen.recursion.functions`. A sample of robots always runs; a thousand run under the
marker ``full``. Bugs planted in flexgen's robots and answers must be seen by each referee.
"""

from __future__ import annotations

import sysconfig
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase
from random_robots import Case, cases, is_linear, state, text_of
from referee import random_model
from robot_checks import (
    ACCELERATION,
    SLOPE,
    TORQUE,
    Found,
    PinocchioReferee,
    check_mujoco,
    check_pinocchio,
    check_robot,
    close,
    fast_function,
)
from seeded_draws import on_draws

from flexgen.base.errors import FlexgenError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.elements import (
    Body,
    Dof,
    Element,
    Friction,
    Gear,
    LinearSpring,
    Motor,
    Output,
    Placement,
    RobotModel,
)
from flexgen.model.reader import read

HERE = Path(__file__).parents[1] / "support"
ROBOTS = Path(
    sysconfig.get_paths()["purelib"], "cmeel.prefix", "share", "example-robot-data", "robots"
)
# robots of each kind
SAMPLE = 5
FULL = 250
needs_pinocchio = pytest.mark.skipif(
    PinocchioReferee is None, reason="no pin; run: make setup-test"
)
KINDS = [
    pytest.param(2 * k + i, linear, coupling, id=f"{'linear' if linear else 'any'}-{coupling}")
    for k, linear in enumerate((True, False))
    for i, coupling in enumerate(("simplified", "complete"))
]


def on_robots(check: Callable[[Case], None], count: int, start: int, **fixed) -> None:
    """A check of that many random robots, the same ones every time."""
    on_draws(check, cases(**fixed), count, start, (Phase.generate, Phase.shrink))


# --- the comparisons -----------------------------------------------------------------------------


@pytest.mark.parametrize(("start", "linear", "coupling"), KINDS)
def test_functions_of_a_sample_of_random_robots_agree(start, linear, coupling):
    on_robots(check_robot, SAMPLE, start, linear=linear, coupling=coupling)


@pytest.mark.full
@pytest.mark.parametrize(("start", "linear", "coupling"), KINDS)
def test_functions_of_all_random_robots_agree(start, linear, coupling):
    on_robots(check_robot, FULL, 100 + start, linear=linear, coupling=coupling)


@pytest.mark.slow
def test_the_sample_covers_every_kind_of_element():
    """The agreement above is worth what its robots contain."""
    models: list[RobotModel] = []
    for parameters in KINDS:
        start, linear, coupling = parameters.values
        on_robots(
            lambda case: models.append(case.model), SAMPLE, start, linear=linear, coupling=coupling
        )
    dofs = [c.dof for model in models for c in model.coordinates]
    gears = [dof.gear for dof in dofs if dof.gear is not None]
    elements = [element for model in models for element in model.elements]
    places = [place for element in elements for place in (element.origin, element.link)]
    whole = [np.array_equal(np.abs(p.rotation), np.round(np.abs(p.rotation))) for p in places]
    assert {dof.type for dof in dofs if dof.actuated} == {
        dof.type for dof in dofs if not dof.actuated
    }
    assert {gear.rigid for gear in gears} == {True, False} and {gear.side for gear in gears} == {
        "arm",
        "motor",
    }
    assert len({type(dof.spring or dof.gear.spring) for dof in dofs}) == 6  # five springs and none
    assert {max(map(abs, dof.axis)) == 1.0 for dof in dofs} == {True, False}
    assert {element.body == Body() for element in elements} == {True, False}
    assert (
        any(not element.dofs for element in elements)
        and max(len(element.dofs) for element in elements) > 2
    )
    assert any(p.rotation == Placement().rotation for p in places) and any(
        p == Placement() for p in places
    )
    assert any(
        w and p.rotation != Placement().rotation for w, p in zip(whole, places, strict=True)
    ) and not all(whole)
    assert any(len(motor.drives) == 2 for model in models for motor in model.motors)
    assert any(motor.inertia == 0.0 for model in models for motor in model.motors)
    assert any(e.body.rotational_drag for e in elements) and any(
        dof.friction.stribeck for dof in dofs
    )
    assert max(model.n_a for model in models) > 12 and {1, 6} <= {model.n_g for model in models}


@pytest.mark.slow
def test_a_random_robot_is_read_from_its_file(tmp_path):
    """A model file is read as the robot that was written: Pinocchio's and MuJoCo's is the
    original.
    """

    def check(case: Case) -> None:
        path = tmp_path / "random.toml"
        path.write_text(text_of(case.model), encoding="utf-8")
        found = Found(derive(read(path)))
        check_mujoco(found, case)
        if PinocchioReferee is not None:
            check_pinocchio(found, case)

    on_robots(check, SAMPLE, 50)


def test_one_motor_behind_a_rigid_gear():
    """No motor has a coordinate of its own then; CasADi's empty index into a single entry is 1
    by 0.
    """
    gear = Gear(rigid=True)
    body = Body(2.0, (0.3, 0.1, 0.0), ((0.1, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.3)))
    turn = Dof("turn", "rotation", (0.0, 1.0, 0.0), gear=gear)
    bend = Dof("bend", "rotation", (0.0, 0.0, 1.0), spring=LinearSpring(1e3))
    model = RobotModel(
        name="single",
        description="",
        source="",
        gravity=(0.0, 0.0, -9.81),
        base=Placement(),
        elements=(Element("one", (turn,), body=body), Element("two", (bend,), body=body)),
        motors=(Motor("m", 1e-3, ("turn",), (10.0,)),),
        tool=Placement((0.5, 0.0, 0.0)),
        payload=Body(),
        output=Output("tool_position", "x"),
        home=(0.0,),
        moves=(),
    )
    alone = replace(model, elements=model.elements[:1])
    for robot in (alone, model):
        check_robot(Case(robot, (state(robot, np.random.default_rng(1), "anywhere"),), True))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["parallel", "chain"])
def test_robots_that_failed_before_agree(name):
    """Random robots on which an earlier version of the recursive route lost all digits; one in a
    hundred did that.
    """
    model = read(HERE / "drawn" / f"{name}.toml")
    rng = np.random.default_rng(6)
    check_robot(
        Case(
            model,
            tuple(state(model, rng, pose) for pose in ("anywhere", "square")),
            is_linear(model),
        )
    )


# --- known robots --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ur5", "ur5_elastic", "panda"])
def test_functions_of_public_robots_agree(name):
    """Overlays on URDF files; tests of the URDF reader hold them against the files themselves."""
    try:
        model = read(HERE / "robots" / f"{name}.toml")
    except FlexgenError as error:
        if "example-robot-data" not in str(error):
            raise
        pytest.skip("no example-robot-data; run: make setup-test")
    rng = np.random.default_rng(3)
    states = tuple(state(model, rng, pose) for pose in ("anywhere", "anywhere", "square"))
    check_robot(Case(model, states, is_linear(model)))


@needs_pinocchio
@pytest.mark.parametrize(
    ("name", "file", "locked"),
    [
        ("ur5", "ur_description/urdf/ur5_robot.urdf", []),
        (
            "panda",
            "panda_description/urdf/panda.urdf",
            ["panda_finger_joint1", "panda_finger_joint2"],
        ),
    ],
)
def test_known_robots_move_as_pinocchio_reads_them(name, file, locked):
    """Accelerations and slopes of torques against Pinocchio's own reading of the URDF file."""
    import pinocchio as pin

    if not (ROBOTS / file).is_file():
        pytest.skip("no example-robot-data; run: make setup-test")
    whole = pin.buildModelFromUrdf(str(ROBOTS / file))
    peer = pin.buildReducedModel(
        whole, [whole.getJointId(joint) for joint in locked], pin.neutral(whole)
    )
    data = peer.createData()
    rng = np.random.default_rng(5)
    model = read(HERE / "robots" / f"{name}.toml")
    assert [c.name for c in model.coordinates] == list(peer.names)[1:] and not model.i_m
    found = Found(derive(model))
    for _ in range(5):
        s = state(model, rng, "anywhere")
        tau = model.eta.T @ (
            s.tau_m - [m.friction.viscous * w for m, w in zip(model.motors, s.v_m, strict=True)]
        )
        tau = tau - [
            c.dof.friction.viscous * w for c, w in zip(model.coordinates, s.v_a, strict=True)
        ]
        got = found("forward_dynamics", *s.x, s.tau_m)[0]
        close("accelerations", got, pin.aba(peer, data, s.q_a, s.v_a, tau), ACCELERATION)
        torque = found("inverse_dynamics", s.q_a, s.v_a, s.a_a)[0]
        close("torques", torque, pin.rnea(peer, data, s.q_a, s.v_a, s.a_a), TORQUE)
        pin.computeRNEADerivatives(peer, data, s.q_a, s.v_a, s.a_a)
        by_q, by_v, _ = found("inverse_dynamics_derivatives", s.q_a, s.v_a, s.a_a)
        close("slopes over q", by_q, data.dtau_dq, SLOPE)
        close("slopes over v", by_v, data.dtau_dv, SLOPE)


# --- controls ------------------------------------------------------------------------------------


def tame(model: RobotModel) -> RobotModel:
    """The model with linear springs and viscous friction only."""

    def linear(spring):
        return spring and LinearSpring(getattr(spring, "stiffness", 0.0) or spring.high)

    def dof(d):
        gear = d.gear and replace(d.gear, spring=linear(d.gear.spring))
        return replace(
            d, gear=gear, spring=linear(d.spring), friction=Friction(d.friction.viscous)
        )

    def body(b):
        return replace(b, rotational_drag=0.0)

    elements = tuple(
        replace(e, dofs=tuple(map(dof, e.dofs)), body=body(e.body)) for e in model.elements
    )
    motors = tuple(replace(m, friction=Friction(m.friction.viscous)) for m in model.motors)
    return replace(model, elements=elements, motors=motors, payload=body(model.payload))


def change(model: RobotModel, k: int, **changed) -> RobotModel:
    """The model with another element k."""
    elements = list(model.elements)
    elements[k] = replace(elements[k], **changed)
    return replace(model, elements=tuple(elements))


def flipped_placement(model: RobotModel) -> RobotModel:
    """A rotation the wrong way round."""
    origin = model.elements[2].origin
    return change(
        model, 2, origin=replace(origin, rotation=tuple(zip(*origin.rotation, strict=True)))
    )


def flipped_offset(model: RobotModel) -> RobotModel:
    """An offset with the sign of one entry wrong."""
    x, y, z = model.elements[3].origin.position
    return change(model, 3, origin=replace(model.elements[3].origin, position=(x, -y, z)))


def flipped_product(model: RobotModel) -> RobotModel:
    """A product of inertia with the wrong sign."""
    inertia = np.array(model.elements[0].body.inertia)
    inertia[0, 1] = -inertia[0, 1]
    inertia[1, 0] = -inertia[1, 0]
    return change(
        model, 3, body=replace(model.elements[3].body, inertia=tuple(map(tuple, inertia)))
    )


def flipped_axis(model: RobotModel) -> RobotModel:
    """A joint that turns the other way."""
    first, *rest = model.elements[2].dofs
    return change(model, 2, dofs=(replace(first, axis=tuple(-x for x in first.axis)), *rest))


def flipped_gear(model: RobotModel) -> RobotModel:
    """The spring between a rotor and its joint with the wrong sign."""
    first, *rest = model.elements[0].dofs
    gear = replace(first.gear, spring=LinearSpring(-first.gear.spring.stiffness))
    return change(model, 0, dofs=(replace(first, gear=gear), *rest))


def flipped_spring(model: RobotModel) -> RobotModel:
    """The spring of an elastic joint with the wrong sign."""
    first, second = model.elements[0].dofs
    return change(
        model, 0, dofs=(first, replace(second, spring=LinearSpring(-second.spring.stiffness)))
    )


def flipped_rotor(model: RobotModel) -> RobotModel:
    """A rotor whose axis points the other way: felt only through its carrier."""
    motors = [
        replace(m, axis=tuple(-x for x in m.axis)) if m.carrier == "two" else m
        for m in model.motors
    ]
    return replace(model, motors=tuple(motors))


def flipped_ratio(model: RobotModel) -> RobotModel:
    """A coupled motor with one of its ratios of the wrong sign."""
    first, *rest = model.motors
    return replace(model, motors=(replace(first, ratio=(first.ratio[0], -first.ratio[1])), *rest))


def flipped_coriolis(found: Found, results: list[np.ndarray], q_a, v_a, *rest) -> list[np.ndarray]:
    """One centripetal force with the wrong sign."""
    function = found.equations.function
    c = np.array((function("bias")(q_a, v_a) - function("gravity")(q_a)).full())
    c[:-1] = 0.0
    return [results[0] - 2 * c]


CHECKS = [
    pytest.param(check_mujoco, id="mujoco"),
    pytest.param(check_pinocchio, id="pinocchio", marks=needs_pinocchio),
]
BUGS = [
    flipped_placement,
    flipped_offset,
    flipped_product,
    flipped_axis,
    flipped_gear,
    flipped_spring,
    flipped_rotor,
    flipped_ratio,
]


@cache
def control() -> Case:
    """A robot with everything that a bug can be planted in: five motors with elastic gears that
    ride on the arm.
    """
    model = tame(random_model(4, "complete", "elastic"))
    rng = np.random.default_rng(4)
    return Case(
        model, tuple(state(model, rng, pose) for pose in ("anywhere", "square")), is_linear(model)
    )


@pytest.mark.parametrize("check", CHECKS)
def test_the_control_agrees_without_bugs(check):
    assert control().linear
    check(Found(derive(control().model)), control())


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.__name__)
def test_planted_signs_are_seen(bug, check):
    with pytest.raises(AssertionError):
        check(Found(derive(bug(control().model))), control())


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("name", ["inverse_dynamics", "bias"])
def test_a_planted_coriolis_sign_is_seen(name, check):
    with pytest.raises(AssertionError):
        check(Found(derive(control().model), planted={name: flipped_coriolis}), control())


@needs_pinocchio
@pytest.mark.parametrize(
    "name",
    "jacobian_dot rotor_torque arm_forward_dynamics inverse_dynamics_derivatives "
    "arm_residual_jacobians residual_jacobians linearize energy state_rate".split(),
)
def test_planted_errors_are_seen_by_pinocchio(name):
    def bug(found, results, *arguments):
        return [results[0] * (1 + 1e-8), *results[1:]]

    with pytest.raises(AssertionError):
        check_pinocchio(Found(derive(control().model), planted={name: bug}), control())


@pytest.mark.skipif(fast_function is None, reason="there is no recursive route")
def test_the_recursive_route_is_taken():
    """`Found` would not tell: where there is no recursive function it asks Lagrange's
    equations.
    """
    equations = derive(tame(random_model(0, "simplified", "elastic")))
    assert all(
        fast_function(equations, name) is not None
        for name in ("mass_matrix", "inverse_dynamics", "bias")
    )
