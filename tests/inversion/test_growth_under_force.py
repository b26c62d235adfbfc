"""Growth of perturbations under a process force, against the flow of perturbed simulations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

import flexgen
from flexgen.base.numerics.evaluate import evaluate

HELD = 0.5  # s: the last torque is held in the verification
SMALL = 1e-6  # rad: central differences of the flow, error about 1e-6 of the growth


def flow_growth(model, solution, force: np.ndarray) -> float:
    """Largest norm over time of d(positions)/d(first positions), motors on the arm side."""
    equations = flexgen.derive(model)
    rate = equations.function("forward_dynamics_tool_force")
    path = solution.trajectory
    torque = make_interp_spline(path.time, path["tau_m"], k=5)
    n_a = model.n_a
    i_m = list(model.i_m)
    side = np.ones(model.dof)
    side[n_a:] = np.abs(model.eta).max(axis=1)[i_m]
    start = np.concatenate([path["q_a"][0], path["q_m"][0][i_m]])
    motors = path["q_m"][0].copy()

    def slope(t, x):
        y, v = np.split(x.reshape(2 * model.dof, -1), 2)
        out = np.zeros_like(x.reshape(2 * model.dof, -1))
        out[: model.dof] = v
        q_m = np.tile(motors, (y.shape[1], 1))
        v_m = np.zeros_like(q_m)
        q_m[:, i_m] = y[n_a:].T
        v_m[:, i_m] = v[n_a:].T
        a_a, a_m, _ = evaluate(
            rate, y[:n_a].T, v[:n_a].T, q_m, v_m, torque(min(t, path.time[-1])), force
        )
        out[model.dof :] = np.hstack([a_a, a_m[:, i_m]]).T
        return out.ravel()

    both = []
    for sign in (1.0, -1.0):
        y = start[:, None] + sign * SMALL * np.diag(side)
        x = np.vstack([y, np.zeros_like(y)])
        run = solve_ivp(
            slope,
            (path.time[0], path.time[-1] + HELD),
            x.ravel(),
            "DOP853",
            t_eval=np.linspace(path.time[0], path.time[-1] + HELD, 80),
            rtol=1e-9,
            atol=1e-11,
        )
        both.append(run.y.reshape(2 * model.dof, model.dof, -1)[: model.dof])
    change = (both[0] - both[1]) / (2 * SMALL) / side[:, None, None]
    return max(float(np.linalg.norm(change[:, :, k], 2)) for k in range(change.shape[2]))


@pytest.mark.slow
@pytest.mark.parametrize("size", [-2000.0, 2000.0])
def test_growth_knows_the_stiffness_of_a_force_on_the_tool(size):
    """A push along an outstretched arm is an inverted pendulum's weight; a pull holds it."""
    model = flexgen.read("planar5_nmp")
    force = np.array([size, 0.0, 0.0])
    solution = flexgen.solve(model, "joints", force=lambda t: np.tile(force, (len(t), 1)))
    own = flow_growth(model, solution, np.r_[force, 0.0, 0.0, 0.0])
    without = flexgen.solve(model, "joints").simulation.growth_whole
    assert solution.simulation.growth_whole == pytest.approx(max(own, 1.0), rel=0.1)
    # planted: the growth without the force is another one
    assert abs(without - own) > 0.3 * own
