"""Forces of additional gear torques, and the friction that they change."""

from __future__ import annotations

import casadi as ca
import numpy as np
from gear_friction import loaded, torque
from numpy.testing import assert_allclose

import flexgen
from flexgen.dynamics.mechanics.equations import derive
from flexgen.simulation.integration import hysteretic_rate


def test_friction_changes_by_additional_gear_torques() -> None:
    """The friction with all of the load less that of the springs alone, by the equation of the
    documentation.
    """
    equations = derive(loaded("elbow", 35.0))
    model = equations.model
    lag = equations.lagrangian
    z = ca.SX.sym("z", model.n_g)
    state = [lag.chain.q_a, lag.chain.v_a, lag.q_m, lag.v_m]
    f = ca.Function("f", [*state, z], [hysteretic_rate.friction_changes(equations, z)])
    inner = ca.Function("load", state, [lag.tau_gm])
    q = np.array([0.3, -0.6])
    v = np.array([0.4, 0.9])
    q_m = model.eta @ q + 0.02
    v_m = model.eta @ v
    extra = np.array([300.0, -200.0])
    load = np.array(inner(q, v, q_m, v_m)).ravel()
    more = load + np.linalg.inv(model.eta).T @ extra
    expected = [torque(v_m[j], more[j], 35.0) - torque(v_m[j], load[j], 35.0) for j in range(2)]
    assert_allclose(np.array(f(q, v, q_m, v_m, extra)).ravel(), expected, rtol=1e-9)
    assert np.abs(expected).min() > 1e-3


def test_forces_of_additional_gear_torques_act_on_both_sides() -> None:
    model = flexgen.read("manutec_r3")
    z, q_m, tau = (
        ca.SX.sym(name, count)
        for name, count in (("z", model.n_g), ("q", model.n_m), ("t", model.n_m))
    )
    f = ca.Function("f", [z, q_m], [hysteretic_rate.generalized_force(model, z, q_m)])
    g = ca.Function("g", [tau], [hysteretic_rate.motor_force(model, tau)])
    x = np.array([1.0, -2.0, 3.0, 4.0, -5.0, 6.0])
    force = np.array(f(x, np.zeros(6))).ravel()
    assert_allclose(force[list(model.i_g)], x)
    assert_allclose(force[model.n_a :], -(np.linalg.inv(model.eta).T @ x)[list(model.i_m)])
    force = np.array(g(x)).ravel()
    assert_allclose(force[model.n_a :], x[list(model.i_m)])
    rigid = [j for j in range(model.n_m) if j not in model.i_m]
    assert_allclose(force[list(model.i_g)], model.eta[rigid].T @ x[rigid])
