"""The open loop of a robot under a torque, integrated over one window after another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np
from scipy.interpolate import PPoly

from flexgen.mechanics.equations import Equations
from flexgen.numerics.evaluate import evaluate
from flexgen.simulation.compiled_rate import CompiledRate, compiled_rate
from flexgen.simulation.integrators import EXPLICIT, OpenLoop, integrate

TorqueInput = Callable[[float, float], PPoly]

ATOL_WORK = 1e-9  # J: work and loss are observers, they must not drive the step size below what the motion needs


@dataclass(frozen=True)
class Run:
    """An integration over all windows.

    Attributes
    ----------
    states : array (n, n_x)
        (q_a, q_me, v_a, v_me, work, loss) at the instants; where windows meet, those at the end of the earlier one.
        Work and loss begin at zero in each window.
    start_energy : array (n,) [J]
        Energy at the start of the window of each instant.
    gap : float [rad or m]
        Largest distance of a coordinate between the end of a window and the start of the next.
    evaluations : int
    integrator : str
        The method of scipy; the implicit one if any window needed it.
    """

    states: np.ndarray
    start_energy: np.ndarray
    gap: float
    evaluations: int
    integrator: str


def run_windows(
    equations: Equations,
    t: np.ndarray,
    torque: TorqueInput,
    starts: Sequence[tuple[int, np.ndarray | None]],
    rtol: float,
    atol: float,
    progress: Callable[[str], None] | None,
) -> Run:
    """Integrate each window to the start of the next.

    Parameters
    ----------
    equations : Equations
    t : array (n,) [s]
        Instants of the results.
    torque : callable
        Motor torques (n_m,) as a piecewise polynomial of the instant in a window, from the start and the end of the
        window.
    starts : sequence of (int, array)
        Sample at which a window begins, and the state (q_a, q_me, v_a, v_me) that it begins with; None: the integrator
        starts again from the state that was reached, where the torque jumps or has a corner.
    rtol, atol : float
        Tolerances of the integrator.
    progress : callable, optional
    """
    robot = equations.model
    n = robot.dof
    side = np.ones(n)  # of the motors: rad at the motor for each rad at the arm
    side[robot.n_a :] = np.abs(robot.eta).max(axis=1)[list(robot.i_m)]
    function, in_c = _rates(equations, progress)
    tolerances = np.concatenate([np.full(2 * n, atol), np.full(2, ATOL_WORK)])
    states, start_energy = np.empty((len(t), 2 * n + 2)), np.empty(len(t))
    gap, evaluations, integrator = 0.0, 0, EXPLICIT
    ends = [first for first, _ in starts[1:]] + [len(t) - 1]
    for (first, start), last in zip(starts, ends, strict=True):
        loop = open_loop(equations, function, in_c, torque(t[first], t[last]))
        begin = states[first].copy() if start is None else np.concatenate([start, np.zeros(2)])
        found = integrate(loop, begin, t[first : last + 1], rtol, tolerances, progress)
        own = slice(first + (first > 0), last + 1)
        if first > 0:
            gap = max(gap, float((np.abs(states[first] - begin)[:n] / side).max()))
        states[own] = found.states[own.start - first :]
        start_energy[own] = start_energy[first] if start is None else _energy(equations, begin)
        evaluations += found.evaluations
        integrator = found.method if found.method != EXPLICIT else integrator
    return Run(states, start_energy, gap, evaluations, integrator)


def open_loop(equations: Equations, function: ca.Function, in_c: CompiledRate | None, torque: PPoly) -> OpenLoop:
    """The open loop with the states (q_a, q_me, v_a, v_me, work, loss).

    ``function``, ``in_c``: its rate as a CasADi function of state and torque, and the same in C.
    """
    robot = equations.model
    n_a, n, i_m = robot.n_a, robot.dof, list(robot.i_m)
    motors, speeds = np.zeros(robot.n_m), np.zeros(robot.n_m)

    def rate(instant: float, x: np.ndarray) -> np.ndarray:
        return np.asarray(function(x, torque(instant)), float).ravel()

    def jacobian(instant: float, x: np.ndarray) -> np.ndarray:
        motors[i_m], speeds[i_m] = x[n_a:n], x[n + n_a : 2 * n]
        A, _ = equations.function("linearize")(x[:n_a], x[n : n + n_a], motors, speeds, torque(instant))
        return np.pad(np.array(A), (0, 2))

    return OpenLoop(rate, jacobian, in_c, torque)


_Known = WeakKeyDictionary[Equations, tuple[ca.Function, CompiledRate | None]]
_known: _Known = WeakKeyDictionary()


def _rates(equations: Equations, progress: Callable[[str], None] | None) -> tuple[ca.Function, CompiledRate | None]:
    """The rate of a robot as a CasADi function, and in C."""
    if equations not in _known:
        function = _rate(equations)
        in_c = compiled_rate(function, progress)
        _known[equations] = function if in_c is None else in_c.function, in_c
    return _known[equations]


def _rate(equations: Equations) -> ca.Function:
    """The derivative of (q_a, q_me, v_a, v_me, work, loss) as a function of this state and the torque."""
    robot = equations.model
    n_a, n = robot.n_a, robot.dof
    x, torque = ca.SX.sym("x", 2 * n + 2), ca.SX.sym("tau_m", robot.n_m)
    motors, speeds = ca.SX.zeros(robot.n_m), ca.SX.zeros(robot.n_m)
    for k, j in enumerate(robot.i_m):
        motors[j], speeds[j] = x[n_a + k], x[n + n_a + k]
    power = equations.function("power")(x[:n_a], x[n : n + n_a], motors, speeds, torque)
    rates = ca.vertcat(equations.function("state_rate")(x[: 2 * n], torque), *power)
    return ca.Function("rate", [x, torque], [ca.cse(rates)])


def _energy(equations: Equations, x: np.ndarray) -> float:
    """Kinetic and potential energy of a state [J]."""
    robot = equations.model
    n_a, n, i_m, i_g = robot.n_a, robot.dof, list(robot.i_m), list(robot.i_g)
    q_m, v_m = robot.eta @ x[:n_a][i_g], robot.eta @ x[n : n + n_a][i_g]
    q_m[i_m], v_m[i_m] = x[n_a:n], x[n + n_a : 2 * n]
    parts = evaluate(equations.function("energy"), x[:n_a], x[n : n + n_a], q_m, v_m)
    return float(parts[0].item() + parts[1].item())
