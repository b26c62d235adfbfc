"""Residuals of motions with a memory: its torques are those of the law, or those of the motion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bristled import NUMBERS, bristled
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.hysteresis.hysteresis import gear_layers, torque_along
from flexgen.dynamics.hysteresis.lugre import bristle_torques, motor_bristles
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.simulation.verification.growth import Motion
from flexgen.simulation.verification.residual import midpoint_residual, residual_at

T = np.linspace(0.0, 0.5, 201)
ELEMENT = {"stiffness": 2e5, "lost_motion": 1e-4}


def hysteretic() -> Equations:
    key = "element.upper.dof.q1.gear.hysteresis"
    return derive(flexgen.read("elbow", overrides={key: ELEMENT}))


def with_bristles() -> Equations:
    return derive(bristled("elbow", {"m1": NUMBERS, "m2": NUMBERS}))


def waves(size: float, n: int) -> tuple[np.ndarray, ...]:
    """Sines and their two derivatives, (201, n) each."""
    w = 9.0 * (np.arange(n) + 1.0)
    at = np.multiply.outer(T, w)
    return size * np.sin(at), size * w * np.cos(at), -size * w**2 * np.sin(at)


def motion(equations: Equations) -> Motion:
    """Sines of the joints, and motors a little off."""
    eta = equations.model.eta
    arm = waves(0.2, 2)
    motors = [(x + y) @ eta.T for x, y in zip(arm, waves(2e-4, 2), strict=True)]
    tau = 50.0 * np.cos(np.multiply.outer(T, [20.0, 35.0]))
    return Motion(T, *arm, *motors, tau)


def law_of(equations: Equations, given: Motion) -> dict[str, np.ndarray]:
    """The torques of the memory along a motion."""
    model = equations.model
    if model.motors[0].lugre is not None:
        bristles = motor_bristles(model)
        return {"tau_b": bristle_torques(bristles, given.t, given.v_m, given.a_m)}
    deflection = given.q_m @ np.linalg.inv(model.eta).T - given.q_a
    return {"tau_h": torque_along(gear_layers(model), deflection)}


@pytest.mark.parametrize("made", [hysteretic, with_bristles])
def test_torques_of_a_memory_follow_from_the_motion(made: Any) -> None:
    """Those that the motion has are taken as they are; others change the residual."""
    equations = made()
    given = motion(equations)
    own = law_of(equations, given)
    (name,) = own
    found = midpoint_residual(equations, given)
    assert_allclose(midpoint_residual(equations, replace(given, **own)), found, rtol=1e-12)
    twice = midpoint_residual(equations, replace(given, **{name: 2 * own[name]}))
    assert np.abs(twice - found).max() > 0.1


@pytest.mark.parametrize("made", [hysteretic, with_bristles])
def test_torques_of_a_memory_act_on_arm_and_motors(made: Any) -> None:
    """Gears push the arm and, over the ratio, the motor back; bristles brake the motor."""
    equations = made()
    given = motion(equations)
    own = law_of(equations, given)
    z = next(iter(own.values()))
    parts = (given.q_a, given.v_a, given.a_a, given.q_m, given.v_m, given.a_m, given.tau_m)
    plain = evaluate(equations.function("residual"), *parts)
    r_a, r_m = (x.reshape(len(T), -1) for x in plain)
    eta = np.diag(equations.model.eta)
    added = (-z, z / eta) if "tau_h" in own else (0 * r_a, z)
    found = residual_at(equations, replace(given, **own))
    assert_allclose(found, np.hstack([r_a + added[0], r_m + added[1]]), rtol=1e-9, atol=1e-9)


def test_midpoints_are_those_of_the_quintic_of_each_interval() -> None:
    """A polynomial of degree five is met exactly; the residual is that of its own torque."""
    equations = derive("elbow")
    powers = np.array([0.1, -0.4, 0.9, 0.5, -2.0, 1.5])
    t = np.linspace(0.0, 1.0, 9)

    def at(instants: np.ndarray) -> list[np.ndarray]:
        rows = [np.polynomial.Polynomial(powers).deriv(k)(instants) for k in (1, 2)]
        first = np.polynomial.Polynomial(powers)(instants)
        return [np.stack([x, -0.5 * x], axis=1) for x in (first, *rows)]

    eta = equations.model.eta
    arm = at(t)
    motors = [x @ eta.T for x in arm]
    middle = (t[1:] + t[:-1]) / 2
    half = at(middle)
    zero = np.zeros((len(t), 2))
    found = midpoint_residual(equations, Motion(t, *arm, *motors, zero))
    expected = residual_at(equations, Motion(middle, *half, *(x @ eta.T for x in half), zero[1:]))
    assert_allclose(found, expected, rtol=1e-7, atol=1e-6 * np.abs(expected).max())
