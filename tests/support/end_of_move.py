"""Errors of the output from the start of a trajectory to 0.5 s after its end, by Pinocchio and scipy alone.

The motor torques are a quintic spline through the samples; after the last sample its torque is held. Nothing of
the solvers or of the verification is used.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from confirmation import output_error
from pinocchio_referee import PinocchioReferee
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

from flexgen.model.elements import RobotModel
from flexgen.trajectory import Trajectory

AFTER = 0.5  # s
RTOL, ATOL = 1e-10, 1e-12


def errors(
    model: RobotModel, t: Trajectory, after: float = AFTER, rtol: float = RTOL, atol: float = ATOL
) -> tuple[float, float]:
    """Largest error [m, rad] of the output along the trajectory, and while the last torque is held."""
    pin = PinocchioReferee(model)
    n_a, i_m = model.n_a, list(model.i_m)
    start = np.concatenate([t["q_a"][0], t["q_m"][0][i_m], np.zeros(model.dof)])
    along = _integrated(pin, make_interp_spline(t.time, t["tau_m"], k=5), start, t.time, rtol, atol)
    held = _integrated(pin, lambda instant: t["tau_m"][-1], along[-1], np.linspace(0.0, after, 501), rtol, atol)
    R_ref = t.channels.get("R_ref")
    last_y = np.tile(t["y_ref"][-1], (len(held), 1))
    last_R = None if R_ref is None else np.tile(R_ref[-1], (len(held), 1))
    return (
        float(output_error(pin, along[:, :n_a], t["y_ref"], R_ref).max()),
        float(output_error(pin, held[:, :n_a], last_y, last_R).max()),
    )


def _integrated(
    pin: PinocchioReferee,
    torque: Callable[[float], np.ndarray],
    start: np.ndarray,
    t: np.ndarray,
    rtol: float,
    atol: float,
) -> np.ndarray:
    """States (q_a, q_me, v_a, v_me) at the instants, (n, 2 dof)."""
    model = pin.model
    n_a, i_m = model.n_a, list(model.i_m)

    def rate(instant: float, x: np.ndarray) -> np.ndarray:
        q_m, v_m = np.zeros(model.n_m), np.zeros(model.n_m)
        q_m[i_m], v_m[i_m] = x[n_a : model.dof], x[model.dof + n_a :]
        v_a = x[model.dof : model.dof + n_a]
        a_a, a_m = pin.forward_dynamics(x[:n_a], v_a, q_m, v_m, torque(instant))
        return np.concatenate([x[model.dof :], a_a, a_m[i_m]])

    found = solve_ivp(rate, (t[0], t[-1]), start, method="DOP853", rtol=rtol, atol=atol, t_eval=t)
    assert found.success, found.message
    return found.y.T
