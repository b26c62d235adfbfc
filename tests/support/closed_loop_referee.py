"""Errors of the output under a continuous P-PI feedback of the motors, by Pinocchio and scipy alone.

Torques, reference angles and reference speeds are splines of scipy through the samples, their last values held for
half a second. Only the gains are taken from flexgen.
"""

from __future__ import annotations

import numpy as np
from confirmation import output_error
from pinocchio_referee import PinocchioReferee
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

from flexgen.model.elements import RobotModel
from flexgen.trajectory import Trajectory

AFTER = 0.5  # s


def closed_loop_error(
    model: RobotModel, t: Trajectory, gains: tuple[np.ndarray, np.ndarray, np.ndarray], *, rtol: float = 1e-9
) -> float:
    """Largest error [m, rad] of the output; ``gains``: position [1/s], speed [N m s/rad], integral [1/s], (n_m,)."""
    pin = PinocchioReferee(model)
    n_a, n, n_m, i_m, i_g = model.n_a, model.dof, model.n_m, list(model.i_m), list(model.i_g)
    position, speed, integral = gains
    torque, angle, rate = (make_interp_spline(t.time, t[name], k=5) for name in ("tau_m", "q_m", "v_m"))
    end = t.time[-1]

    def derivative(instant: float, x: np.ndarray) -> np.ndarray:
        at, still = min(instant, end), instant > end
        q_a, v_a = x[:n_a], x[n : n + n_a]
        q_m, v_m = model.eta @ q_a[i_g], model.eta @ v_a[i_g]
        q_m[i_m], v_m[i_m] = x[n_a:n], x[n + n_a : 2 * n]
        w = (0.0 if still else rate(at)) - v_m + position * (angle(at) - q_m)
        u = torque(at) + speed * (w + integral * x[2 * n :])
        a_a, a_m = pin.forward_dynamics(q_a, v_a, q_m, v_m, u)
        return np.concatenate([x[n : 2 * n], a_a, a_m[i_m], w])

    x = np.concatenate([t["q_a"][0], t["q_m"][0][i_m], np.zeros(n + n_m)])
    worst, R_ref = 0.0, t.channels.get("R_ref")
    for time in (t.time, np.linspace(end, end + AFTER, 101)):
        found = solve_ivp(derivative, (time[0], time[-1]), x, "DOP853", time, rtol=rtol, atol=1e-11)
        assert found.success, found.message
        moving = time is t.time
        y = t["y_ref"] if moving else np.tile(t["y_ref"][-1], (len(time), 1))
        R = R_ref if R_ref is None or moving else np.tile(R_ref[-1], (len(time), 1))
        worst = max(worst, float(output_error(pin, np.ascontiguousarray(found.y[:n_a].T), y, R).max()))
        x = found.y[:, -1]
    return worst
