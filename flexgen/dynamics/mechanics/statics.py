"""Static equilibrium of the robot, and the deflection of gears under a torque.

In equilibrium ``g_e(q_a) = tau_e(q_e)`` on the non-actuated rows, ``tau_g = g_g(q_a)`` on the
actuated ones, the motors follow from the springs of the gears, and, where the output is
prescribed, ``Gamma(q_a) = Z``: all solved together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.display import short_repr
from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.results import Result
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.dynamics.mechanics.motor_harmonics import friction_along, motor_stage

NEWTON_STEPS = 50
HOLD_STEPS = 60


@checked_result
@dataclass(frozen=True)
class Equilibrium(Result):
    """A static equilibrium: ``q_a`` (n_a), ``q_m``, ``tau_m`` (n_m, motor side), ``tau_g`` (n_g,
    arm side).

    Examples
    --------
    >>> from flexgen.dynamics.mechanics.statics import hold_joints
    >>> rest = hold_joints(flexgen.derive("elbow"), [0.5, -0.3])
    >>> rest.tau_g.round(1)  # N m
    array([-2582.9,  -850.6])
    """

    q_a: np.ndarray
    q_m: np.ndarray
    tau_m: np.ndarray
    tau_g: np.ndarray

    __repr__ = short_repr


def gear_damping(equations: Equations) -> np.ndarray:
    """Damping of the gears on the arm side, (n_g,) [N m s/rad]; zero for rigid gears."""
    return np.array([ratio**2 * gear.damping for gear, ratio in gears(equations.model)])


def gear_lag_times(equations: Equations) -> np.ndarray:
    """Time constants D / K with which the deflections of damped gears decay, (n_g,) [s]; zero for
    the others.

    K: the least stiffness of the spring, at zero or at a large deflection.
    """
    model = equations.model
    D = gear_damping(equations)
    far = evaluate(
        equations.function("gear_law"), np.stack([np.zeros(model.n_g), np.ones(model.n_g)])
    )[1]
    elastic = np.array([not gear.rigid for gear, _ in gears(model)])
    least = np.where(elastic, far.reshape(2, model.n_g).min(axis=0), 1.0)
    return np.where(elastic, D / np.maximum(least, 1e-300), 0.0)


def gear_deflection(equations: Equations, tau: np.ndarray) -> np.ndarray:
    """Static deflection ``eta^-1 q_m - q_g`` (n, n_g) of gears under arm-side torques ``tau`` (n,
    n_g); zero if rigid.

    Newton's method inside a bracket: springs are odd and monotonic, but some have kinks.
    """
    function = equations.function("gear_law")
    elastic = np.array([not gear.rigid for gear, _ in gears(equations.model)])
    target = np.where(elastic, tau, 0.0)
    _, slope0 = evaluate(function, np.zeros_like(target))
    high = np.where(
        elastic, 1e-9 + np.abs(target) / np.maximum(slope0.reshape(target.shape), 1e-6), 0.0
    )
    for _ in range(200):  # the bracket: |spring(high)| >= |target|
        short = elastic & (
            np.abs(evaluate(function, high)[0].reshape(target.shape)) < np.abs(target)
        )
        if not short.any():
            break
        high = np.where(short, 2 * high, high)
    lower = -high
    upper = high.copy()
    deflection = np.clip(target / np.maximum(slope0.reshape(target.shape), 1e-6), lower, upper)
    for _ in range(200):
        value, slope = (x.reshape(target.shape) for x in evaluate(function, deflection))
        error = value - target
        lower = np.where(error <= 0, deflection, lower)
        upper = np.where(error >= 0, deflection, upper)
        step = deflection - error / np.where(slope > 0, slope, 1.0)
        inside = (step >= lower) & (step <= upper) & (slope > 0)
        new = np.where(elastic, np.where(inside, step, (lower + upper) / 2), 0.0)
        done = np.abs(new - deflection) <= 4e-16 * np.abs(deflection) + 1e-300
        deflection = new
        if done.all():
            break
    return deflection


def reach(equations: Equations) -> float:
    """Length of the chain at home [m], from base to tool; 1 for a chain without extent, such as a
    drive train.
    """
    model = equations.model
    q = np.zeros(model.n_a)
    q[list(model.i_g)] = model.home
    corners = evaluate(equations.function("chain_points"), q)[0][0]
    # the first segment is the placement of the base and does not count
    length = float(np.linalg.norm(np.diff(corners[:, 1:], axis=1), axis=0).sum())
    return length if length > 0 else 1.0


def equilibrium_at(equations: Equations, q_a: np.ndarray) -> Equilibrium:
    """The equilibrium at ``q_a`` (n_a): motor angles and torques. The non-actuated rows must be in
    balance.
    """
    model = equations.model
    zero = np.zeros(model.n_a)
    load = evaluate(equations.function("inverse_dynamics"), q_a, zero, zero)[0][0]
    load = load - evaluate(equations.function("arm_forces"), q_a, zero)[0][0]
    tau_g = load[list(model.i_g)]
    theta = q_a[list(model.i_g)] + gear_deflection(equations, tau_g[None])[0]
    still = np.zeros((1, model.n_g))
    found = motor_stage(equations.function, model, [theta[None], still, still], tau_g[None])
    friction = friction_along(equations.function, model, np.zeros((1, model.n_m)), found.carried)[
        0
    ]
    tau_m = (found.carried + friction - found.cogging) / found.gain
    return Equilibrium(q_a, found.q_m[0], tau_m[0], tau_g)


def balance(equations: Equations) -> ca.SX:
    """Non-actuated rows of the equations at rest (n_e), in the symbol
    ``equations.lagrangian.chain.q_a`` [N m or N].
    """
    lag = equations.lagrangian
    model = equations.model
    rows = ca.gradient(lag.gravity, lag.chain.q_a) - lag.arm_forces
    static = ca.vertcat(ca.SX(0, 1), *[rows[i] for i in model.i_e]) - lag.tau_e
    return ca.substitute(static, lag.chain.v_a, ca.SX.zeros(model.n_a))


def hold_joints(
    equations: Equations, q_g: np.ndarray, q_e: np.ndarray | None = None
) -> Equilibrium:
    """Equilibrium with the actuated coordinates at ``q_g``; the others are searched from ``q_e``,
    default zero.
    """
    return make_holder(equations)(q_g, q_e)


def make_holder(
    equations: Equations,
) -> Callable[[np.ndarray, np.ndarray | None], Equilibrium]:
    """The function `hold_joints` of one robot, for many poses."""
    model = equations.model
    i_e = list(model.i_e)
    newton = None
    if i_e:
        symbol = equations.lagrangian.chain.q_a
        rows = balance(equations)
        newton = ca.Function(
            "equilibrium", [symbol], [rows, ca.densify(ca.jacobian(rows, symbol[i_e]))]
        )

    def hold(q_g: np.ndarray, q_e: np.ndarray | None = None) -> Equilibrium:
        """Equilibrium at the actuated coordinates ``q_g`` (n_g,); ``q_e`` (n_e,): guess of the
        other ones, 0 without one.
        """
        q = np.zeros(model.n_a)
        q[list(model.i_g)] = q_g
        if q_e is not None:
            q[i_e] = q_e
        if newton is not None:
            q[i_e] = solve_newton(
                newton, q, i_e, "static equilibrium of the non-actuated elements"
            )[i_e]
        return equilibrium_at(equations, q)

    return hold


def hold_output(equations: Equations, residual: ca.SX, q_start: np.ndarray) -> Equilibrium:
    """Equilibrium at a prescribed output.

    ``residual`` (n_m): zero where the output is right, in the symbol
    ``equations.lagrangian.chain.q_a``; ``q_start`` (n_a): where the search starts. SolverError
    where no equilibrium is found nearby.
    """
    symbol = equations.lagrangian.chain.q_a
    rows = ca.vertcat(residual, balance(equations)) if equations.model.n_e else residual
    newton = ca.Function("equilibrium", [symbol], [rows, ca.densify(ca.jacobian(rows, symbol))])
    return equilibrium_at(
        equations,
        solve_newton(
            newton,
            q_start,
            list(range(len(q_start))),
            "static equilibrium at the start of the path",
        ),
    )


def motor_balance(equations: Equations) -> ca.Function:
    """Rows ``(q_a, q_m) -> (n_a)`` that vanish at rest with the motors at ``q_m``, and their
    slopes in ``q_a``.
    """
    model = equations.model
    symbol = equations.lagrangian.chain.q_a
    q_m = ca.SX.sym("q_m", model.n_m)
    still = ca.DM.zeros(model.n_a)
    none = ca.DM.zeros(model.n_m)
    r_a, _ = equations.function("residual")(symbol, still, still, q_m, none, none, none)
    rows = ca.vertcat(r_a)
    theta = ca.solve(ca.DM(model.eta), q_m)
    for k, i in enumerate(model.i_g):
        dof = model.coordinates[i].dof
        if dof is not None and dof.gear is not None and dof.gear.rigid:
            rows[i] = symbol[i] - theta[k]
    return ca.Function("hold", [symbol, q_m], [rows, ca.densify(ca.jacobian(rows, symbol))])


def hold_motors(
    equations: Equations, q_m: np.ndarray, q_a: np.ndarray, newton: ca.Function | None = None
) -> Equilibrium:
    """Equilibrium with the motors held at ``q_m`` (n_m); Newton's method starts at ``q_a`` (n_a).

    ``newton``: `motor_balance`, for many calls. SolverError where there is no equilibrium nearby.
    """
    newton = motor_balance(equations) if newton is None else newton
    q = np.array(q_a, dtype=float)
    for _ in range(HOLD_STEPS):
        residual, jacobian = (np.array(x) for x in newton(q, q_m))
        try:
            step = np.linalg.solve(jacobian, -residual[:, 0])
        except np.linalg.LinAlgError:
            break
        q = q + step
        if np.abs(step).max() <= 1e-13 * (1 + np.abs(q).max()):
            return replace(equilibrium_at(equations, q), q_m=np.array(q_m, dtype=float))
    raise SolverError(
        "equilibrium with held motors: not found, the springs do not carry the arm at the start "
        "of the move; choose another start"
    )


def solve_newton(
    function: ca.Function, start: np.ndarray, free: list[int], what: str
) -> np.ndarray:
    """Solve ``rows(q) = 0`` for the entries ``free`` of q by Newton's method from ``start``,
    halving steps that do not help; rows are scaled by their derivatives.

    ``function``: q -> rows, their Jacobian in the free entries; ``what``: for the error.
    SolverError where it is singular or does not converge.
    """
    q = np.array(start, dtype=float)
    rows, jacobian = (np.array(x) for x in function(q))
    scale = np.maximum(np.abs(jacobian).max(axis=1), 1e-12)
    error = np.linalg.norm(rows[:, 0] / scale)
    if not np.isfinite(error):
        raise SolverError(
            f"{what}: given q_a = {np.round(q, 4).tolist()}, where the equations are not finite, "
            "as where a closed loop cannot close; choose another pose"
        )
    for _ in range(NEWTON_STEPS):
        try:
            step = np.linalg.solve(jacobian / scale[:, None], -rows[:, 0] / scale)
        except np.linalg.LinAlgError:
            raise SolverError(
                f"{what}: the equations are singular at q_a = {np.round(q, 4).tolist()}"
            ) from None
        length = 1.0
        while True:
            trial = q.copy()
            trial[free] += length * step
            rows, jacobian = (np.array(x) for x in function(trial))
            new = np.linalg.norm(rows[:, 0] / scale)
            if new < error or length < 1e-4 or new < 1e-14:
                break
            length /= 2
        q = trial
        error = new
        if np.linalg.norm(length * step) < 1e-13 * (1 + np.linalg.norm(q)):
            break
    if not error < 1e-9:
        raise SolverError(
            f"{what}: not found, residual {error:.2e} (coordinates, scaled), expected below "
            "1e-9; choose another pose"
        )
    return q
