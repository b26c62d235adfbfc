"""Figures of linear robots: two masses and a spring in closed form, and the elbow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import eigh

import flexgen
from flexgen.analysis import second_order
from flexgen.analysis.arm_linearization import arm_linearization
from flexgen.base.errors import ModelError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.linearization import check_inertia, second_order_matrices

TWO_MASS = Path(__file__).parents[1] / "support" / "robots" / "two_mass.toml"


def matrices(equations: Equations, q: list[float]) -> Any:
    """M, D, K and B at rest at a pose, motors at their angles."""
    model = equations.model
    q_g = np.array([q])
    zero = np.zeros((1, model.n_a))
    still = np.zeros((1, model.n_m))
    given = (q_g, zero, zero, q_g @ model.eta.T, still, still, still)
    found = evaluate(equations.function("residual_jacobians"), *given)
    return tuple(x[0] for x in second_order_matrices(*found))


def test_two_masses_and_a_spring() -> None:
    """``w^2 = k (1/m1 + 1/m2)`` free, ``k/m1`` with the motor locked; the motor moves both masses
    where the spring is stiff.
    """
    equations = derive(flexgen.read(TWO_MASS))
    model = equations.model
    load = 0.042  # kg m^2
    motor = 5e-3
    k = 50.0  # N m/rad
    M, D, K, B = matrices(equations, [0.3])
    assert_allclose(M, np.diag([load, motor]), atol=1e-15)
    assert_allclose(K, k * np.array([[1.0, -1.0], [-1.0, 1.0]]))
    assert not D.any()
    rows = second_order.motor_rows(model)
    assert_array_equal(rows, [[0.0, 1.0]])
    assert second_order.with_motors_locked(model) == [0]
    stiff, soft = second_order.motor_inertias(model, M, B, rows)
    assert_allclose([stiff[0], soft[0]], [load + motor, motor])
    locked = second_order.lowest_locked_hz(model, M, K)
    assert locked == pytest.approx(np.sqrt(k / load) / (2 * np.pi))
    free = np.sqrt(k * (1 / load + 1 / motor))
    both = second_order.largest_rate(np.stack([M, M]), np.stack([D, D]), np.stack([K, 4 * K]))
    assert both == pytest.approx(2 * free)
    damped = np.diag([1e4, 1.0])  # much faster than the spring
    rate = second_order.largest_rate(M[None], damped[None], K[None])
    assert rate == pytest.approx(1e4 / load, rel=1e-2)


def test_a_rigid_robot_has_nothing_that_moves_with_its_motors_locked() -> None:
    model = flexgen.read("elbow@rigid")
    M = np.eye(model.dof)
    assert_array_equal(second_order.motor_rows(model), model.eta)
    assert second_order.with_motors_locked(model) == []
    assert second_order.lowest_locked_hz(model, M, M) == 0.0


def test_matrices_of_a_robot_at_rest() -> None:
    """Of the elbow without gravity: springs and dampers between joints and motors."""
    equations = derive(flexgen.read("elbow", overrides={"gravity": [0.0, 0.0, 0.0]}))
    model = equations.model
    q = [0.2, 0.7]
    M, D, K, B = matrices(equations, q)
    gears: list[Any] = [element.dofs[0].gear for element in model.elements]
    k = np.diag([gear.spring.stiffness for gear in gears])
    d = np.diag([gear.damping for gear in gears])
    T = np.hstack([-np.eye(2), np.linalg.inv(model.eta)])
    assert_allclose(K, T.T @ k @ T, atol=1e-6)
    frictions: list[Any] = [e.dofs[0].friction for e in model.elements]
    frictions += [motor.friction for motor in model.motors]
    assert_allclose(D, T.T @ d @ T + np.diag([f.viscous for f in frictions]), atol=1e-9)
    arm = np.array(equations.function("mass_matrix")(q))
    motors = np.diag([motor.inertia for motor in model.motors])
    none = np.zeros((2, 2))
    assert_allclose(M, np.block([[arm, none], [none, motors]]))
    assert_allclose(B, np.vstack([none, np.eye(2)]))
    assert not np.signbit(B).any()
    locked = np.sqrt(eigh(k, arm, eigvals_only=True)[0]) / (2 * np.pi)
    assert second_order.lowest_locked_hz(model, M, K) == pytest.approx(locked)


@pytest.mark.parametrize(
    ("entries", "text"),
    [
        ((1.0, 1.0, 1.0, 1.0), ""),
        ((1e-12, 1e6, 1.0, 1e-9), ""),
        ((1.0, 1.0, 1.0, 0.0), r"elbow.*motor\.m2.*singular: m2 moves no inertia of its own"),
        ((0.0, 1.0, 1.0, 1.0), r"element\.upper.*: q1 moves no inertia"),
    ],
)
def test_a_coordinate_without_inertia_is_named(entries: Any, text: str) -> None:
    model = flexgen.read("elbow")
    M = np.stack([np.eye(4), np.diag(entries)])
    if not text:
        check_inertia(model, M)
        return
    with pytest.raises(ModelError, match=text):
        check_inertia(model, M)


@pytest.mark.parametrize(("gap", "good"), [(1e-13, True), (1e-15, False)])
def test_two_coordinates_about_one_line_are_refused(gap: float, good: bool) -> None:
    M = np.eye(4)
    M[0, 1] = M[1, 0] = 1.0 - gap
    if good:
        check_inertia(flexgen.read("elbow"), M)
        return
    with pytest.raises(ModelError, match="singular"):
        check_inertia(flexgen.read("elbow"), M)


def test_responses_are_those_of_the_state() -> None:
    """``C (j w - A)^-1 B`` of the state of positions and speeds."""
    linear = flexgen.analyze("elbow").linear
    A, B = linear.state_space()
    C = np.hstack([linear.C_m, 0.0 * linear.C_m])
    w = np.array([0.3, 20.0, 70.0, 400.0])
    expected = [C @ np.linalg.solve(1j * x * np.eye(len(A)) - A, B) for x in w]
    found = linear.response(w, linear.C_m)
    for one, other in zip(found, expected, strict=True):
        assert_allclose(one, other, rtol=1e-8, atol=1e-12 * np.abs(other).max())


def test_inertia_with_the_output_held_is_over_the_own_one() -> None:
    """``L R L' = A`` with ``L L'`` the inertia of the coordinates without motors; A is not
    symmetric where the output is not collocated.
    """
    equations = derive(flexgen.read("beam_arm"))
    q = np.random.default_rng(0).uniform(-0.5, 0.5, (1, equations.model.n_a))
    arm = arm_linearization(equations, q)
    i_e = list(equations.model.i_e)
    A = arm.inner()[0][0]
    L = np.linalg.cholesky(arm.M[0][np.ix_(i_e, i_e)])
    assert_allclose(L @ arm.relative_inertia()[0] @ L.T, A, atol=1e-12 * np.abs(A).max())
    assert np.abs(A - A.T).max() > 1e-3 * np.abs(A).max()
