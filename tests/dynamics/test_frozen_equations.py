"""Equations are frozen: a force, a memory or other elements make another object."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import flexgen
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations, model_digest
from flexgen.dynamics.mechanics.system import System

STATE = {"elbow": ([0.3, -0.4], [0.1, 0.2], [30.0, -40.0], [1.0, 2.0], [5.0, 3.0])}


@pytest.mark.parametrize("name", ["model", "force", "contact", "memory", "symbols", "other"])
def test_no_attribute_can_be_set(name: str) -> None:
    equations = Equations(flexgen.read("elbow"))
    with pytest.raises(FrozenInstanceError):
        setattr(equations, name, None)
    with pytest.raises(FrozenInstanceError):
        delattr(equations, name)


def accelerations(equations: Equations) -> np.ndarray:
    """Of the arm in a state of elbow."""
    return evaluate(equations.function("forward_dynamics"), *STATE["elbow"])[0].ravel()


def test_a_force_makes_another_object_and_leaves_the_first() -> None:
    """By the mass matrix of both motors and links: ``M_y (ddy - ddy_0) = J' f``."""
    equations = Equations(flexgen.read("elbow"))
    before = accelerations(equations)
    force = np.array([3.0, 0.0, -7.0, 0.0, 0.0, 0.0])
    pushed = equations.with_force(ca.SX(ca.DM(force)))
    assert pushed is not equations and equations.force is None and pushed.force is not None
    q = STATE["elbow"][0]
    M = evaluate(equations.function("mass_matrix"), q)[0].reshape(2, 2)
    step = 1e-6
    tip = [
        evaluate(equations.function("forward_kinematics"), np.add(q, sign * step * axis))[0]
        for axis in np.eye(2)
        for sign in (1.0, -1.0)
    ]
    J = np.stack([(tip[2 * k] - tip[2 * k + 1]).ravel() / (2 * step) for k in range(2)], axis=1)
    # elastic gears: the force reaches the motors only through the springs
    expected = np.linalg.solve(M, J.T @ force[:3])
    assert accelerations(pushed) - before == pytest.approx(expected, rel=1e-6)
    assert np.array_equal(accelerations(equations), before)


def test_forces_with_a_memory_leave_the_functions_of_the_first() -> None:
    """Also those that were built before; the copy has its own, and its own copies."""
    equations = Equations(flexgen.read("elbow"))
    before = accelerations(equations)
    assert equations.pushed is equations.pushed
    z = ca.SX.sym("memory", 1)
    force = ca.vertcat(z, ca.SX.zeros(equations.model.dof - 1))
    made = equations.with_memory(force, z)
    assert made.function("forward_dynamics").name_in(5) == "memory"
    assert equations.function("forward_dynamics").n_in() == 5
    assert made.pushed is not equations.pushed
    at_rest = evaluate(made.function("forward_dynamics"), *STATE["elbow"], [0.0])[0].ravel()
    assert np.array_equal(at_rest, before)
    moved = evaluate(made.function("forward_dynamics"), *STATE["elbow"], [4.0])[0].ravel()
    M = evaluate(equations.function("mass_matrix"), STATE["elbow"][0])[0].reshape(2, 2)
    assert moved - before == pytest.approx(np.linalg.solve(M, [4.0, 0.0]), rel=1e-9)


def test_a_planted_change_of_a_part_is_not_seen_by_built_functions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The reason for frozen equations: without it a force that is set later has no effect."""
    monkeypatch.setattr(System, "__setattr__", object.__setattr__)
    monkeypatch.setattr(Equations, "__setattr__", object.__setattr__)
    equations: Any = Equations(flexgen.read("elbow"))
    before = accelerations(equations)
    equations.force = ca.SX(ca.DM([3.0, 0.0, -7.0, 0.0, 0.0, 0.0]))
    assert np.array_equal(accelerations(equations), before)
    assert not np.array_equal(accelerations(equations.with_force(equations.force)), before)


def test_elements_keep_the_symbols() -> None:
    equations = Equations(flexgen.read("elbow"), ["payload"])
    heavier = [
        replace(element, body=replace(element.body, mass=2 * element.body.mass))
        for element in equations.with_symbols.elements
    ]
    made = equations.with_elements(heavier)
    assert made.symbols is equations.symbols and made.model is equations.model
    one, two = (
        evaluate(each.function("mass_matrix"), [0.3, -0.4], np.zeros(4))[0][0].ravel()
        for each in (equations, made)
    )
    assert (two > 1.2 * one).any()


def test_the_digest_of_a_model_follows_its_numbers() -> None:
    robot = flexgen.read("elbow")
    assert model_digest(robot) == model_digest(flexgen.read("elbow"))
    assert model_digest(robot) != model_digest(replace(robot, gravity=(0.0, 0.0, -9.0)))
