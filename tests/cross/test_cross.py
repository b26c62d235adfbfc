"""Independent routes to the same numbers: Lagrange's equations against Newton-Euler and against
MuJoCo.

On every model of the collection and on synthetic chains that use everything the model format
knows; sign errors planted in the answers are seen by both referees. The referees are also held
against each other, rotors included.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from mujoco_referee import NO_BEAMS, MujocoReferee
from planted_bugs import ANGULAR, scaled, wrong_coriolis, wrong_gravity
from referee import (
    ALL_MODELS,
    Answers,
    Referee,
    answers,
    assert_close,
    model_of,
    random_model,
    random_state,
)

from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.elements import BacklashSpring, RobotModel

TORQUE = 1e-11  # of the largest torque: rounding along chains of some ten bodies, in another order
OUTSIDE = 1e-11  # the same, through MuJoCo's quaternions
MOTION = 1e-12  # poses and velocities of size one
# of the largest acceleration, through mass matrices with condition numbers up to 1e5
ACCELERATION = 1e-9
STATES = 20


@cache
def states(name: str):
    rng = np.random.default_rng(7)
    return [random_state(model_of(name), rng, speed=2.0) for _ in range(STATES)]


def skip_loops(model: RobotModel) -> None:
    """Neither program knows closed loops as joints."""
    if model.loops:
        pytest.skip("loops have a referee of their own: tests/support/multipliers.py")


@cache
def referee(name: str) -> Referee:
    skip_loops(model_of(name))
    return Referee(model_of(name))


@cache
def outside(name: str, rotors: bool = False) -> MujocoReferee:
    if any(element.beam is not None for element in model_of(name).elements):
        pytest.skip(NO_BEAMS)
    skip_loops(model_of(name))
    return MujocoReferee(model_of(name), rotors)


def check_newton_euler(a: Answers, name: str) -> None:
    """Inverse dynamics, bias, gravity and mass matrix against the recursion."""
    judge = referee(name)
    for s in states(name):
        zero = 0 * s.q_a
        expected = judge.inverse_dynamics(s.q_a, s.v_a, s.a_a)
        scale = np.abs(expected).max()
        assert_close(a.inverse_dynamics(s.q_a, s.v_a, s.a_a), expected, TORQUE)
        assert_close(
            a.bias(s.q_a, s.v_a), judge.inverse_dynamics(s.q_a, s.v_a, zero), TORQUE, scale
        )
        assert_close(a.gravity(s.q_a), judge.gravity(s.q_a), TORQUE, scale)
        assert_close(a.mass_matrix(s.q_a), judge.mass_matrix(s.q_a), TORQUE)


def check_mujoco(a: Answers, name: str) -> None:
    """Inverse dynamics, bias, mass matrix and the tool's pose against MuJoCo."""
    judge = outside(name)
    for s in states(name):
        expected = judge.inverse_dynamics(s.q_a, s.v_a, s.a_a)
        assert_close(a.inverse_dynamics(s.q_a, s.v_a, s.a_a), expected, OUTSIDE)
        assert_close(
            a.bias(s.q_a, s.v_a), judge.bias(s.q_a, s.v_a), OUTSIDE, np.abs(expected).max()
        )
        assert_close(a.mass_matrix(s.q_a), judge.mass_matrix(s.q_a), OUTSIDE)
        for found, pose in zip(a.forward_kinematics(s.q_a), judge.tool(s.q_a), strict=True):
            assert_close(found.ravel(), pose.ravel(), MOTION, 1 + np.abs(pose).max())


def check_kinematics(a: Answers, name: str) -> None:
    """Tool pose, ``J v`` and ``J a + dJ v`` against the recursion's pose, twist and
    acceleration.
    """
    judge = referee(name)
    for s in states(name):
        for found, pose in zip(a.forward_kinematics(s.q_a), judge.tool(s.q_a), strict=True):
            assert_close(found.ravel(), pose.ravel(), MOTION, 1 + np.abs(pose).max())
        J = a.jacobian(s.q_a)
        twist = judge.twist(s.q_a, s.v_a)
        acceleration = judge.acceleration(s.q_a, s.v_a, s.a_a)
        assert_close(J @ s.v_a, twist, MOTION, 1 + np.abs(twist).max())
        dJ = a.jacobian_dot(s.q_a, s.v_a)
        assert_close(J @ s.a_a + dJ @ s.v_a, acceleration, MOTION, 1 + np.abs(acceleration).max())


def check_full_model(a: Answers, name: str) -> None:
    """Gear torques and accelerations of the whole machine against the recursion's."""
    judge = referee(name)
    if model_of(name).lines:
        pytest.skip("lines have laws of their own: tests/dynamics/test_lines.py")
    for s in states(name):
        gear = judge.gear_torque(*s.x)
        # a stiff spring sees the rounding of its motor's position: 1e-15 of stiffness times
        # position counts as well
        stretched = judge.gear_torque(s.q_a, s.v_a, 1.001 * s.q_m, s.v_m) - gear
        scale = np.abs(gear).max() + 0.1 * np.abs(stretched).max()
        assert_close(a.gear_torque(*s.x), gear, TORQUE, scale)
        for found, expected in zip(
            a.forward_dynamics(*s.x, s.tau_m), judge.forward_dynamics(*s.x, s.tau_m), strict=True
        ):
            assert_close(found, expected, ACCELERATION)


CHECKS = (check_newton_euler, check_mujoco, check_kinematics, check_full_model)


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__[6:])
@pytest.mark.parametrize("name", ALL_MODELS)
def test_functions_agree_with_the_reference_of_another_program(name, check):
    check(answers(name), name)


@pytest.mark.parametrize("name", ALL_MODELS)
def test_referees_agree_on_rotors(name):
    """Newton-Euler with spinning rotors is MuJoCo with rotors as bodies on hinges of their own."""
    judge = referee(name)
    witness = outside(name, rotors=True)
    rng = np.random.default_rng(8)
    for s in states(name):
        a_m = rng.uniform(-1, 1, len(s.q_m)) * (1 + np.abs(s.v_m))
        expected = np.concatenate(judge.sweep(s.q_a, s.v_a, s.a_a, s.v_m, a_m)[:2])
        found = witness.inverse_dynamics(
            np.concatenate([s.q_a, s.q_m]),
            np.concatenate([s.v_a, s.v_m]),
            np.concatenate([s.a_a, a_m]),
        )
        assert_close(found, expected, OUTSIDE)


# --- more synthetic chains -----------------------------------------------------------------------

MORE = [
    (seed, coupling, gears, beam)
    for seed, (coupling, gears, beam) in enumerate(
        [
            ("simplified", "elastic", False),
            ("simplified", "mixed", True),
            ("simplified", "rigid", True),
            ("complete", "elastic", True),
            ("complete", "mixed", False),
            ("complete", "rigid", True),
            ("complete", "elastic", False),
            ("simplified", "elastic", True),
        ],
        start=100,
    )
]


@pytest.mark.parametrize(("seed", "coupling", "gears", "beam"), MORE)
def test_functions_of_many_synthetic_chains_agree(seed, coupling, gears, beam):
    model = random_model(seed, coupling, gears, beam)
    a = Answers(derive(model))
    judge = Referee(model)
    rng = np.random.default_rng(seed)
    for _ in range(4):
        s = random_state(model, rng, speed=3.0)
        tau = judge.inverse_dynamics(s.q_a, s.v_a, s.a_a)
        assert_close(a.inverse_dynamics(s.q_a, s.v_a, s.a_a), tau, TORQUE)
        for found, expected in zip(
            a.forward_dynamics(*s.x, s.tau_m), judge.forward_dynamics(*s.x, s.tau_m), strict=True
        ):
            assert_close(found, expected, ACCELERATION)


def test_synthetic_chains_cover_every_kind_of_element():
    """The agreement above is worth what the chains contain."""
    models: list[RobotModel] = [random_model(*case) for case in MORE]
    dofs = [c.dof for model in models for c in model.coordinates if c.dof is not None]
    gears = [dof.gear for dof in dofs if dof.gear is not None]
    springs = [x.spring for x in (*dofs, *gears) if x.spring is not None]
    assert {dof.type for dof in dofs if dof.actuated} == {"rotation", "translation"}
    assert {dof.type for dof in dofs if not dof.actuated} == {"rotation", "translation"}
    assert {gear.side for gear in gears if not gear.rigid} == {"arm", "motor"}
    assert len({type(spring) for spring in springs}) == 5
    assert len({type(gear.spring) for gear in gears if not gear.rigid and gear.side == "arm"}) == 5
    assert any(isinstance(gear.spring, BacklashSpring) for gear in gears)
    assert any(dof.friction.stribeck and dof.friction.offset for dof in dofs)


# --- controls ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "check", [check_newton_euler, check_mujoco], ids=lambda check: check.__name__[6:]
)
@pytest.mark.parametrize("bug", [wrong_coriolis, wrong_gravity], ids=lambda bug: bug.__name__)
def test_planted_signs_are_seen(bug, check):
    name = "synthetic_elastic"
    with pytest.raises(AssertionError):
        check(bug(answers(name), model_of(name)), name)


@pytest.mark.parametrize("bug", [wrong_coriolis], ids=lambda bug: bug.__name__)
def test_planted_signs_are_seen_in_the_full_model(bug):
    name = "synthetic_elastic"
    with pytest.raises(AssertionError):
        check_full_model(bug(answers(name), model_of(name)), name)


@pytest.mark.parametrize(
    "bug",
    [scaled("jacobian", ANGULAR), scaled("jacobian_dot", -1.0)],
    ids=lambda bug: bug.__name__,
)
def test_planted_jacobians_are_seen(bug):
    name = "synthetic_elastic"
    with pytest.raises(AssertionError):
        check_kinematics(bug(answers(name), model_of(name)), name)


def test_missing_spin_of_rotors_is_seen():
    """The simplified coupling in place of the complete one."""
    name = "synthetic_spinning"
    model = model_of(name)
    plain = random_model(4, "simplified", "elastic")
    other = Answers(derive(plain))
    with pytest.raises(AssertionError):
        check_full_model(answers(name).but(forward_dynamics=other.forward_dynamics), name)
    assert plain.n_a == model.n_a
