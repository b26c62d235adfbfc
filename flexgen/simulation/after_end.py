"""The motion after the end of a simulation, the last torque held, predicted by the linearization
about the last state.

    x(t) = x_e + d(t),     d' = A d + f(x_e, u_e),     d(0) = 0

A robot without brakes rests in an unstable equilibrium: the remaining motion grows. The prediction
holds as long as the deviations are small. Frictions and gears with a state are simulated instead:
their bristles creep and give way, which no linearization about one state shows.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from flexgen.base.errors import SolverError
from flexgen.simulation.integration.integrators import integrate
from flexgen.simulation.result import AFTER
from flexgen.simulation.run import Run

STEPS = 64


def errors_after_end(found: Run, end: float, held: float) -> np.ndarray:
    """States (`STEPS`, n_x) from the end of a simulation to `AFTER` after the end of the
    trajectory.

    ``end``: the last instant of the simulation [s]; ``held``: how much of the time is over there.
    """
    x = found.last
    n = len(x)
    affine = np.zeros((n + 1, n + 1))
    affine[:n, :n] = found.rates.jacobian(end, x)
    affine[:n, n] = found.rates.rate(end, x)
    step = expm(affine * max(AFTER - held, 0.0) / STEPS)
    change = np.append(np.zeros(n), 1.0)
    out = np.empty((STEPS, n))
    for k in range(STEPS):
        change = step @ change
        out[k] = x + change[:n]
    return out


def simulate_after_end(found: Run, end: float, held: float) -> np.ndarray:
    """States (`STEPS`, n) of the motion after the simulated end, until `AFTER` [s] after it, by
    simulation of the nonlinear equations; ``held`` [s] of this time are simulated already.

    By the linear prediction where an integrator does not follow the equations.
    """
    if found.tolerances is None or held >= AFTER:
        return errors_after_end(found, end, held)
    t = end + np.linspace(0.0, AFTER - held, STEPS + 1)
    try:
        states = integrate(found.rates, found.last.copy(), t, *found.tolerances).states
    except SolverError:
        return errors_after_end(found, end, held)
    return states[1:]
