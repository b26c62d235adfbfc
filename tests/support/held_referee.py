"""The robot under torques that a controller holds: Pinocchio's equations and scipy's integrator,
from edge to edge.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from confirmation import output_error
from pinocchio_referee import PinocchioReferee
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

from flexgen.inversion.solution import Solution
from flexgen.simulation.integration.hold import TorqueCommand


def confirmed_error(solution: Solution, command: TorqueCommand, after: float) -> float:
    """Largest error of the output [m, rad] under a command, to the time ``after`` [s] after the
    last sample.
    """
    model = solution.model
    t = solution.trajectory
    pin = PinocchioReferee(model)
    n_a = model.n_a
    n = model.dof
    i_m = list(model.i_m)
    arrivals = command.time + command.delay
    values = command.values
    spline = make_interp_spline(arrivals, values, k=5)

    def applied(begin: float, end: float) -> Callable[[float], np.ndarray]:
        k = int(np.searchsorted(arrivals, (begin + end) / 2)) - 1
        if k + 1 == len(arrivals):
            return lambda _: values[-1]
        if command.hold == "linear":
            share = np.diff(values, axis=0)[k] / np.diff(arrivals)[k]
            return lambda s: values[k] + (s - arrivals[k]) * share
        return (lambda _: values[k]) if command.hold == "zoh" else spline

    time = np.append(t.time, t.time[-1] + np.linspace(0.0, after, 51)[1:])
    y_ref, R_ref = (
        np.append(t[key], np.repeat(t[key][-1:], 50, axis=0), axis=0)
        if key in t.channels
        else None
        for key in ("y_ref", "R_ref")
    )
    assert y_ref is not None
    edges = np.concatenate(
        [time[:1], arrivals[(arrivals > time[0]) & (arrivals < time[-1])], time[-1:]]
    )
    edges = edges[np.append(np.diff(edges) > 1e-9, True)]
    x = np.concatenate([t["q_a"][0], t["q_m"][0][i_m], np.zeros(n)])
    worst = 0.0
    for begin, end in itertools.pairwise(edges):
        tau = applied(begin, end)

        def rate(s: float, x: np.ndarray, tau: Callable[[float], np.ndarray] = tau) -> np.ndarray:
            q_m = np.zeros(model.n_m)
            v_m = np.zeros(model.n_m)
            q_m[i_m] = x[n_a:n]
            v_m[i_m] = x[n + n_a :]
            a_a, a_m = pin.forward_dynamics(x[:n_a], x[n : n + n_a], q_m, v_m, tau(s))
            return np.concatenate([x[n:], a_a, a_m[i_m]])

        at = np.flatnonzero((time > begin + 1e-9) & (time <= end + 1e-9))
        found = solve_ivp(
            rate, (begin, end), x, method="DOP853", rtol=1e-9, atol=1e-11, dense_output=True
        )
        if len(at):
            states = found.sol(np.minimum(time[at], end))
            worst = max(
                worst,
                float(
                    output_error(
                        pin, states[:n_a].T, y_ref[at], None if R_ref is None else R_ref[at]
                    ).max()
                ),
            )
        x = found.y[:, -1]
    return worst
