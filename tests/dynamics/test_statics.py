"""Equilibria of a robot with everything that stores or takes energy, and errors of poses."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import SolverError
from flexgen.dynamics.mechanics import outputs, statics
from flexgen.dynamics.mechanics.equations import Equations


@pytest.mark.parametrize("name", ["kr300_efjm", "beam_arm", "planar5_nmp"])
@pytest.mark.parametrize("start", [None, 0.3])
def test_an_equilibrium_stays_at_rest_under_its_torques(name: str, start: float | None) -> None:
    """Forward dynamics at the equilibrium, from a start far away: gravity, frictions at rest, soft
    joints, counterbalance, payload.
    """
    offset = {"planar5_nmp": {"motor.m1.friction.offset": 0.3}, "kr300_efjm": {}, "beam_arm": {}}
    tilted = flexgen.read(name, overrides={"gravity": [0.0, -3.0, -9.0], **offset[name]})
    equations = Equations(tilted)
    model = equations.model
    i_g = list(model.i_g)
    q_g = np.linspace(0.4, -0.7, model.n_g)
    guess = None if start is None else start * np.ones(model.n_e)
    found = statics.hold_joints(equations, q_g, guess)
    accelerations = equations.function("forward_dynamics")(
        found.q_a, 0 * found.q_a, found.q_m, 0 * found.q_m, found.tau_m
    )
    assert max(np.abs(np.array(a)).max() for a in accelerations) < 1e-8
    assert_allclose(found.q_a[i_g], q_g)
    assert not model.n_e or np.abs(found.q_a[list(model.i_e)]).max() > 1e-4
    deflection = np.linalg.solve(model.eta, found.q_m) - found.q_a[i_g]
    torque = np.array(equations.function("gear_law")(deflection)[0])
    assert_allclose(torque.ravel(), found.tau_g, rtol=1e-9, atol=1e-9 * np.abs(found.tau_g).max())


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
