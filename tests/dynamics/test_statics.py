"""Equilibria of a robot with everything that stores or takes energy, and errors of poses."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import SolverError
from flexgen.dynamics.mechanics import outputs, statics
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.model.elements import Body, Friction, RobotModel

PAYLOAD = Body(0.7, (0.05, 0.02, 0.1), ((0.02, 0.0, 0.0), (0.0, 0.03, 0.0), (0.0, 0.0, 0.01)), 0.2)


def loaded() -> RobotModel:
    """Payload, drag, frictions of joints and motors, counterbalances, soft joints."""
    robot = flexgen.read("planar5_nmp")
    elements = []
    for k, element in enumerate(robot.elements):
        friction = Friction(viscous=0.3, coulomb=0.5, beta=3.0, offset=0.2 + k)
        counterbalance = ((4.0, -2.0), (1.0, 3.0))
        dofs = tuple(
            replace(dof, friction=friction, counterbalance=counterbalance) for dof in element.dofs
        )
        body = replace(element.body, rotational_drag=0.4 + 0.1 * k)
        elements.append(replace(element, dofs=dofs, body=body))
    friction = Friction(viscous=0.01, coulomb=0.1, beta=4.0, offset=0.3)
    return replace(
        robot,
        elements=tuple(elements),
        motors=tuple(replace(motor, friction=friction) for motor in robot.motors),
        payload=PAYLOAD,
        gravity=(0.0, -3.0, -9.0),
    )


@pytest.mark.parametrize("start", [None, 0.3])
def test_an_equilibrium_stays_at_rest_under_its_torques(start: float | None) -> None:
    """Forward dynamics at the equilibrium, from a start far away: gravity, frictions at rest, soft
    joints, payload.
    """
    equations = Equations(loaded())
    model = equations.model
    i_g = list(model.i_g)
    guess = None if start is None else start * np.ones(model.n_e)
    found = statics.hold_joints(equations, np.array([0.4, -0.7]), guess)
    accelerations = equations.function("forward_dynamics")(
        found.q_a, 0 * found.q_a, found.q_m, 0 * found.q_m, found.tau_m
    )
    assert max(np.abs(np.array(a)).max() for a in accelerations) < 1e-8
    assert_allclose(found.q_a[i_g], [0.4, -0.7])
    assert np.abs(found.q_a[list(model.i_e)]).min() > 1e-4
    deflection = np.linalg.solve(model.eta, found.q_m) - found.q_a[i_g]
    torque = np.array(equations.function("gear_law")(deflection)[0])
    assert_allclose(torque.ravel(), found.tau_g, rtol=1e-9)


def test_an_equilibrium_of_small_torques_is_as_accurate() -> None:
    """Rows of 1e-9 N m: without their scale anything would be one."""
    q = ca.SX.sym("q", 2)
    start = np.array([1.2, 0.9])

    def solve(first: ca.SX, second: ca.SX) -> np.ndarray:
        rows = ca.vertcat(first, second)
        function = ca.Function("rows", [q], [rows, ca.jacobian(rows, q)])
        return statics.solve_newton(function, start, [0, 1], "pose")

    found = solve(1e-9 * (q[0] ** 2 - 2 * q[1]), 1e3 * (q[1] - 1))
    assert_allclose(found, [np.sqrt(2), 1.0], rtol=1e-12)
    with pytest.raises(SolverError, match=r"pose: not found, residual .* expected below 1e-9"):
        solve(1e-12 * (q[0] ** 2 + 1), q[1] - 1)


def test_a_pose_error_is_the_sine_of_the_angle_about_its_axis() -> None:
    R = Rotation.random(random_state=1)
    E = Rotation.from_rotvec([0.2, -0.3, 0.4])
    place, target = np.random.default_rng(1).normal(size=(2, 3))
    symbols = [ca.SX.sym("p", 3), ca.SX.sym("R", 3, 3), ca.SX.sym("t", 12)]
    error = ca.Function("error", symbols, [outputs.pose_error(*symbols)])
    angle = np.linalg.norm(E.as_rotvec())
    found = error(place, (E * R).as_matrix(), np.r_[target, R.as_matrix().T.ravel()])
    expected = [*(place - target), *(np.sin(angle) / angle * E.as_rotvec())]
    assert_allclose(np.array(found).ravel(), expected, atol=1e-12)
