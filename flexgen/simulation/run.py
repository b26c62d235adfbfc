"""A robot under a torque, alone or with motor feedback, integrated along a time grid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np
from scipy.interpolate import PPoly

from flexgen.base.calls.deadline import check_time
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.model.friction import memory_laws
from flexgen.simulation.integration.compiled_rate import CompiledRate, compiled_rate
from flexgen.simulation.integration.integrators import EXPLICIT, Rates, integrate
from flexgen.simulation.motor_feedback import MotorFeedback

Input = Callable[[float, float], PPoly]

ATOL = 1e-12  # rad or m, and their rates
ATOL_SHARE = 0.1  # of a relative tolerance below 1e-11
# J: work and loss are observers, they must not drive the step size below what the motion needs
ATOL_WORK = 1e-9
ATOL_SLIP = 1e-10  # of the torque at which a hysteresis slips
ATOL_INTEGRAL = 1e-9  # rad, motor side: of the integral part of the feedback


@dataclass(frozen=True)
class Run:
    """States (q_a, q_me, v_a, v_me, work, loss) at the instants, (n, n_x), then those of
    `hysteretic_rate`.

    ``last``: the last one with the integrals of the feedback; ``rates``: the right-hand side
    there; ``integrator``: the implicit method if any part needed it; ``tolerances``: relative and
    absolute ones.
    """

    states: np.ndarray
    last: np.ndarray
    rates: Rates
    evaluations: int
    integrator: str
    tolerances: tuple[float, np.ndarray] | None = None


def run(
    equations: Equations,
    t: np.ndarray,
    given: Input,
    start: np.ndarray,
    corners: Sequence[int],
    rtol: float,
    feedback: MotorFeedback | None,
    progress: Callable[[str], None] | None,
) -> Run:
    """Integrate from the start to the last instant.

    Parameters
    ----------
    equations : Equations
    t : array (n,) [s]
        Instants of the results.
    given : callable
        Motor torques (n_m,), with feedback also the motors' reference angles and speeds (3 n_m,),
        with a force on the tool that and zeros without feedback (3 n_m + 6,), as a piecewise
        polynomial of the instant, from the start and the end of a part without corners.
    start : array (2 n,)
        State (q_a, q_me, v_a, v_me).
    corners : sequence of int
        Instants at which the torque jumps or has a corner: integration starts again there.
    rtol : float
        Relative tolerance of the integrator; the absolute one is `ATOL`, or a tenth of it.
    feedback : MotorFeedback or None
    progress : callable, optional
    """
    robot = equations.model
    n = robot.dof
    integrals = 0 if feedback is None else robot.n_m
    function, in_c = _rates(equations, progress)
    slip = np.zeros(0)
    if memory_laws(robot):
        from flexgen.simulation.integration.hysteretic_rate import slip_torques

        slip = slip_torques(robot)
    parts = [
        np.full(2 * n, min(ATOL, ATOL_SHARE * rtol)),
        np.full(2, ATOL_WORK),
        np.maximum(ATOL_SLIP * slip, 1e-12),
        np.full(integrals, ATOL_INTEGRAL),
    ]
    tolerances = np.concatenate(parts)
    states = np.empty((len(t), len(tolerances)))
    states[0] = np.concatenate([start, np.zeros(2 + len(slip) + integrals)])
    evaluations = 0
    integrator = EXPLICIT
    ends = [0, *corners, len(t) - 1]
    for first, last in pairwise(ends):
        rates = rates_of(equations, function, in_c, given(t[first], t[last]), feedback)
        found = integrate(
            rates, states[first].copy(), t[first : last + 1], rtol, tolerances, progress
        )
        states[first + 1 : last + 1] = found.states[1:]
        evaluations += found.evaluations
        integrator = found.method if found.method != EXPLICIT else integrator
    own = states[:, : 2 * n + 2 + len(slip)]
    return Run(own, states[-1], rates, evaluations, integrator, (rtol, tolerances))


def rates_of(
    equations: Equations,
    function: ca.Function,
    in_c: CompiledRate | None,
    given: PPoly,
    feedback: MotorFeedback | None,
) -> Rates:
    """The right-hand side with the states (q_a, q_me, v_a, v_me, work, loss, torques with states,
    integrals of the feedback), and its Jacobian.

    ``function``, ``in_c``: the rate without feedback as a CasADi function of state and input, and
    the same in C; ``given``: inputs over time: motor torques, with feedback its references, and
    the force on the tool.
    """
    robot = equations.model
    n_a = robot.n_a
    n = robot.dof
    n_m = robot.n_m
    i_m = list(robot.i_m)
    motors = np.zeros(n_m)
    speeds = np.zeros(n_m)
    pushed = equations.force is not None
    own = function.size1_in(0)  # of the robot

    def rate(instant: float, x: np.ndarray) -> np.ndarray:
        """The rate of the state x at an instant [s]."""
        u = given(instant)
        if feedback is None:
            return np.asarray(function(x, u), float).ravel()
        more, w = feedback.torque(x, x[own:], u[n_m : 3 * n_m])
        applied = np.concatenate([u[:n_m] + more, u[n_m:]]) if pushed else u[:n_m] + more
        return np.concatenate([np.asarray(function(x[:own], applied), float).ravel(), w])

    def jacobian(instant: float, x: np.ndarray) -> np.ndarray:
        """The derivative of the rate in the state; work and loss, which nothing depends on, are
        left out.
        """
        motors[i_m] = x[n_a:n]
        speeds[i_m] = x[n + n_a : 2 * n]
        u = given(instant)
        tau = (
            u[:n_m]
            if feedback is None
            else u[:n_m] + feedback.torque(x, x[own:], u[n_m : 3 * n_m])[0]
        )
        state = (x[:n_a], x[n : n + n_a], motors, speeds, tau, u[3 * n_m :])
        # has a force only where the directions of the tool's motion turn
        linear = equations.function("linearize")
        A, B = (np.array(each) for each in linear(*state[: linear.n_in()]))
        out = np.zeros((len(x), len(x)))
        out[: 2 * n, : 2 * n] = A
        # torques of hysteresis and bristles, a wall
        if own > 2 * n + 2 or equations.contact is not None:
            out[:own, :own] = np.array(
                _jacobian(equations)(x[:own], np.concatenate([tau, u[n_m:]]) if pushed else tau)
            )
        if feedback is not None:
            in_torque, in_w = feedback.state_feedback()
            out[: 2 * n, : 2 * n] += B @ in_torque
            out[: 2 * n, own:] = B * (feedback.speed_gain * feedback.integral_gain)
            out[own:, : 2 * n] = in_w
        return out

    return Rates(rate, jacobian, in_c, given, feedback, robot)


_Known = WeakKeyDictionary[Equations, tuple[ca.Function, CompiledRate | None]]
_known: _Known = WeakKeyDictionary()


def _rates(
    equations: Equations, progress: Callable[[str], None] | None
) -> tuple[ca.Function, CompiledRate | None]:
    """The rate of a robot as a CasADi function, and in C."""
    check_time("equations of the simulation")
    if equations not in _known:
        function = rate_function(equations)
        in_c = compiled_rate(function, progress)
        _known[equations] = function if in_c is None else in_c.function, in_c
    return _known[equations]


def rate_function(equations: Equations) -> ca.Function:
    """The derivative of (q_a, q_me, v_a, v_me, work, loss) as a function of this state and the
    torque.

    Torques of hysteresis and bristles are states too, and the power that goes into these counts as
    lost.
    """
    robot = equations.model
    n_a = robot.n_a
    n = robot.dof
    n_m = robot.n_m
    pushed = equations.force is not None  # the force is behind the references of a feedback
    remembers = bool(memory_laws(robot))
    held = 0
    if remembers:
        from flexgen.simulation.integration.hysteretic_rate import hysteretic_rate

        inputs, outputs = hysteretic_rate(equations)
        held = inputs[1].numel()
    x = ca.SX.sym("x", 2 * n + 2 + held)
    given = ca.SX.sym("tau_m", 3 * n_m + 6 if pushed else n_m)
    torque, more = (given[:n_m], [given[3 * n_m :]]) if pushed else (given, [])
    if equations.contact is not None:
        more = [more[0] + equations.contact(x[:n_a], x[n : n + n_a])]
    motors = ca.SX.zeros(robot.n_m)
    speeds = ca.SX.zeros(robot.n_m)
    for k, j in enumerate(robot.i_m):
        motors[j] = x[n_a + k]
        speeds[j] = x[n + n_a + k]
    power = equations.function("power")(x[:n_a], x[n : n + n_a], motors, speeds, torque, *more)
    if remembers:
        dx, dz, taken = ca.Function("rate", inputs, outputs)(
            x[: 2 * n], x[2 * n + 2 :], torque, *more
        )
        rates = ca.vertcat(dx, power[0], power[1] + taken, dz)
    else:
        rates = ca.vertcat(equations.function("state_rate")(x[: 2 * n], torque, *more), *power)
    return ca.Function("rate", [x, given], [ca.cse(rates)])


_jacobians: WeakKeyDictionary[Equations, ca.Function] = WeakKeyDictionary()


def _jacobian(equations: Equations) -> ca.Function:
    """The derivative of `rate_function` in the state."""
    if equations not in _jacobians:
        rate = rate_function(equations)
        x = ca.SX.sym("x", rate.size1_in(0))
        u = ca.SX.sym("u", rate.size1_in(1))
        _jacobians[equations] = ca.Function(
            "jacobian", [x, u], [ca.densify(ca.jacobian(rate(x, u), x))]
        )
    return _jacobians[equations]
