"""Acceleration, jerk and torque of arms with elastic joints, against the integrated equations of
motion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from law_cases import arm
from scipy.integrate import solve_ivp
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.laws.study import ARM
from flexgen.model.abilities import obstacle
from flexgen.model.elements import BacklashSpring

# s, of the differences: their error is STEP^6 times an eighth derivative, rounding 1e-13 / STEP^2
STEP = 2.5e-4
# second and first derivative by central differences of order six
SECOND = np.array([2.0, -27.0, 270.0, -490.0, 270.0, -27.0, 2.0]) / 180.0
FIRST = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0


def states(model, count=3):
    rng = np.random.default_rng(5)
    for _ in range(count):
        q = rng.uniform(-1, 1, 3)
        v = rng.uniform(-1, 1, 3)
        deflection = 3e-3 * rng.standard_normal(3)
        rate = 3e-2 * rng.standard_normal(3)
        yield q, v, model.eta @ (q + deflection), model.eta @ (v + rate), rng.uniform(-5, 5, 3)


def flow(model, q, v, q_m, v_m, tau):
    """Accelerations at seven instants around the state under a constant torque, by a tight
    integration.
    """
    f = derive(model).function("forward_dynamics")

    def rate(t, x):
        a_a, a_m = f(x[:3], x[3:6], x[6:9], x[9:], tau)
        return np.concatenate([x[3:6], a_a.full().ravel(), x[9:], a_m.full().ravel()])

    x = np.concatenate([q, v, q_m, v_m])
    out = []
    for k in range(-3, 4):
        if k:
            found = solve_ivp(rate, (0, k * STEP), x, method="DOP853", rtol=1e-13, atol=1e-14)
            out.append(rate(0, found.y[:, -1])[3:6])
        else:
            out.append(rate(0, x)[3:6])
    return np.array(out)


MODELS = {
    "linear springs": dict(damped=False),
    "cubic springs, friction of the arm": dict(damped=False, cubic=1.0, drag=1.0),
}


@pytest.mark.parametrize("name", MODELS)
def test_motion_and_torque_are_derivatives_along_the_equations_of_motion(name):
    model = arm(**MODELS[name])
    equations = derive(model)
    motion, torque = (equations.function(f"flexible_joint_{x}") for x in ("motion", "torque"))
    for q, v, q_m, v_m, tau in states(model):
        samples = flow(model, q, v, q_m, v_m, tau)
        a, j = (x.full().ravel() for x in motion(q, v, q_m, v_m))
        jerk = FIRST @ samples / STEP
        fourth = SECOND @ samples / STEP**2
        # the differences are of order six: halving STEP divides these errors, up to 6e-6 here, by
        # 64
        assert np.allclose(a, samples[3], rtol=1e-12)
        assert np.allclose(j, jerk, rtol=0, atol=2e-5 * np.abs(jerk).max())
        found = torque(q, v, a, j, fourth, q_m, v_m).full().ravel()
        assert np.allclose(found, tau, rtol=0, atol=2e-5 * np.abs(tau).max())


@pytest.mark.parametrize("left_out", ["jerk", "speed", "acceleration"])
def test_a_planted_bug_in_the_second_derivative_is_seen(left_out):
    """Terms of T1'' left out: the torque differs from that of the equations by ten times the
    tolerance.
    """
    model = arm(damped=False)
    equations = derive(model)
    motion, torque = (equations.function(f"flexible_joint_{x}") for x in ("motion", "torque"))
    q, v, q_m, v_m, tau = next(states(model))
    samples = flow(model, q, v, q_m, v_m, tau)
    a, j = (x.full().ravel() for x in motion(q, v, q_m, v_m))
    fourth = SECOND @ samples / STEP**2
    given = {"speed": v, "acceleration": a, "jerk": j}
    given[left_out] = 0.0 * given[left_out]
    found = (
        torque(q, given["speed"], given["acceleration"], given["jerk"], fourth, q_m, v_m)
        .full()
        .ravel()
    )
    assert np.abs(found - tau).max() > 2e-4 * np.abs(tau).max()


@needs_compiler
def test_the_emitted_functions_are_those_of_the_equations():
    model = arm()
    names = ("flexible_joint_motion", "flexible_joint_torque")
    library = library_with(model, names)
    equations = derive(model)
    for q, v, q_m, v_m, tau in states(model):
        a, j = library.flexible_joint_motion(q, v, q_m, v_m)
        expected = [x.full().ravel() for x in equations.function(names[0])(q, v, q_m, v_m)]
        assert np.allclose(a, expected[0], rtol=1e-11) and np.allclose(j, expected[1], rtol=1e-10)
        found = library.flexible_joint_torque(q, v, a, j, 10 * tau, q_m, v_m)
        assert np.allclose(
            found,
            equations.function(names[1])(q, v, a, j, 10 * tau, q_m, v_m).full().ravel(),
            rtol=1e-9,
        )


def test_stiff_springs_are_the_rigid_robot():
    """With 1e4 of the stiffness the torque is M a + c + g + J_m eta^2 a + friction: the rest falls
    as 1/K.
    """
    rng = np.random.default_rng(2)
    q, v, a, j, s = rng.uniform(-1, 1, (5, 3))
    differences = []
    for stiffness in (1.0, 1e4):
        model = arm(stiffness=stiffness)
        equations = derive(model)
        T = equations.function("inverse_dynamics")(q, v, a).full().ravel()
        K = np.diag(equations.function("gear_law")(np.zeros(3))[1].full().ravel())
        q_m = model.eta @ (q + T / np.diag(K))
        v_m = model.eta @ v
        found = equations.function("flexible_joint_torque")(q, v, a, j, s, q_m, v_m).full().ravel()
        inertia = np.array([m.inertia for m in model.motors])
        friction = equations.function("motor_friction")(v_m).full().ravel()
        rigid = np.linalg.solve(model.eta.T, T) + inertia * (model.eta @ a) + friction
        differences.append(np.abs(found - rigid).max())
    assert differences[0] > 1e-5
    # rounding of q_m: 1e-3
    assert differences[1] == pytest.approx(1e-4 * differences[0], rel=1e-2)


def test_the_three_axis_arm_is_the_manutec_with_a_locked_wrist():
    arm3 = flexgen.read(ARM)
    whole = flexgen.read("manutec_r3")
    for q in ([0.0, 0.35, 1.2], [-1.0, -0.4, 0.7], [2.0, 1.0, -1.5]):
        six = np.array([*q, 0.0, np.radians(60.0), 0.0])
        for name in ("mass_matrix", "gravity"):
            small, large = (derive(m).function(name) for m in (arm3, whole))
            expected = large(six).full()[:3, :3]
            assert np.allclose(small(np.array(q)).full(), expected, rtol=1e-12, atol=1e-11)
        p = derive(arm3).function("forward_kinematics")(np.array(q))[0].full()
        assert np.allclose(
            p, derive(whole).function("forward_kinematics")(six)[0].full(), atol=1e-13
        )


def test_other_models_are_refused_with_the_reason():
    assert obstacle(flexgen.read("elbow"), "elastic joints") is None
    assert "coordinates without motor (q3)" in obstacle(
        flexgen.read("planar5_nmp"), "elastic joints"
    )
    assert "a rigid gear in q4" in obstacle(flexgen.read("manutec_r3"), "elastic joints")
    loose = arm()
    (dof,) = loose.elements[0].dofs
    gap = replace(dof, gear=replace(dof.gear, spring=BacklashSpring(40.0, 1e-3, 1e-4)))
    loose = replace(loose, elements=(replace(loose.elements[0], dofs=(gap,)), *loose.elements[1:]))
    assert "a spring in q1 without stiffness somewhere" in obstacle(loose, "elastic joints")
    with pytest.raises(ArgumentError, match="coordinates without motor"):
        flexgen.generate(
            "planar5_nmp", "nowhere", functions=["flexible_joint_torque"], build=False
        )
