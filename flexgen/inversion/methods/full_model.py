"""Inverse dynamics as optimal control of the full model, with bounds on motor torque and speed.

Nothing is reduced: all coordinates y = (q_a, q_me) are collocated, the motor torques are unknowns, the machine starts
exactly at rest, and the tool follows as well as it can:

    min  mean |e(q_a) / e_0|^2 + rho mean |tau_m' T / tau_0|^2 + sigma |y(end) - rest|^2 + sigma |y'(end)|^2
    s.t. the equations of motion at the Gauss points,  |tau_m| <= tau_max,  |v_m| <= v_max,  |q_e| <= bend

The torque is continuous: it is collocated as the speed of further coordinates u, ``u' = tau_m``. Five Gauss points an
interval, one more than the index of the inverse problem: with fewer the torque loses its order. The path is followed to
a small fraction of ``e_0``, not exactly; where limits bite, by as much as they allow.

Source: J. Betts, Practical Methods for Optimal Control, 2010, ch. 4.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from math import comb
from numbers import Real

import casadi as ca
import numpy as np
import scipy.sparse as sp
from scipy.interpolate import CubicSpline

from flexgen.errors import ArgumentError, SolverError
from flexgen.inversion.methods.collocation import ACCELERATION
from flexgen.inversion.motor_side import MotorMotion, gear_torques
from flexgen.inversion.reduced_problem import Motion, Reduction
from flexgen.mechanics.equations import Equations
from flexgen.mechanics.outputs import output_map
from flexgen.mechanics.statics import at_rest, reach
from flexgen.model.elements import RobotModel
from flexgen.numerics.evaluate import evaluate
from flexgen.numerics.nlp import NlpResult, Progress, solve_nlp
from flexgen.numerics.tableaus import Tableau, gauss
from flexgen.numerics.transcription import Transcription
from flexgen.paths.path import Path

STAGES = 5
PARTS = 10  # samples an interval
ERROR = 1e-4  # e_0: the tool error that costs one, rad, and m for each metre of reach, at most m
SMOOTH = 1e-9  # rho: small, for the torque shall follow the path and only what the path leaves open shall be smooth
SMOOTH_LIMITED = 1e-3  # rho with limits: with less the torque chatters between them for a gain too small to measure
NOTICED = 1e-2  # of e_0: a tool that is farther from its path is kept off it by the limits
END = 1e-3  # sigma: enough to pick the motion that does not blow up at the end, too little to bend it before
TOLERANCE = 1e-9
NEAR = 0.99  # of a bound: from there on it is thought to act


@dataclass(frozen=True)
class Limits:
    """Bounds on motor torque [N m] and speed [rad/s], motor side, one entry a motor; None: no bounds of that kind.

    ``deflection`` [rad or m]: bounds on the non-actuated coordinates, one entry each in chain order. `limits_for` takes
    one number for all.
    """

    torque: tuple[float, ...] | None = None
    speed: tuple[float, ...] | None = None
    deflection: tuple[float, ...] | None = None

    def arrays(self, n_m: int) -> tuple[np.ndarray, np.ndarray]:
        """Torque and speed bounds (n_m,), infinite where there is none; ArgumentError where they do not fit."""
        return _bounds("torque", self.torque, n_m), _bounds("speed", self.speed, n_m)

    def deflections(self, n_e: int) -> np.ndarray:
        """Bounds of the non-actuated coordinates (n_e,), infinite where there is none."""
        return _bounds("deflection", self.deflection, n_e)


def limits_for(
    model: RobotModel,
    *,
    torque: float | Sequence[float] | None = None,
    speed: float | Sequence[float] | None = None,
    deflection: float | Sequence[float] | None = None,
) -> Limits:
    """The `Limits` of a model from one number for all motors (or non-actuated coordinates), or from one for each."""
    sizes = {"torque": model.n_m, "speed": model.n_m, "deflection": model.n_e}
    out = {}
    for name, values in (("torque", torque), ("speed", speed), ("deflection", deflection)):
        if values is not None:
            each = (values,) * sizes[name] if isinstance(values, Real) else values
            out[name] = tuple(float(x) for x in _bounds(name, each, sizes[name]))  # type: ignore[arg-type]
    return Limits(**out)


def _bounds(name: str, values: Sequence[float] | None, size: int) -> np.ndarray:
    if values is None:
        return np.full(size, np.inf)
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if array.shape != (size,) or not (array > 0).all():
        raise ArgumentError(f"limits: given {name} {values}, expected {size} positive numbers")
    return array


def limits_from_model(model: RobotModel) -> Limits:
    """The limits stated in the model file; ArgumentError where it states none."""
    torque = tuple(np.inf if m.torque_max is None else m.torque_max for m in model.motors)
    speed = tuple(np.inf if m.speed_max is None else m.speed_max for m in model.motors)
    if np.isinf([*torque, *speed]).all():
        raise ArgumentError(f"limits: model {model.name} states none; add torque_max or speed_max to its motors")
    return Limits(torque, speed)


@dataclass(frozen=True)
class FullSolution:
    """Samples of motion and torque; ``limited``: a bound keeps the tool off the path."""

    t: np.ndarray
    motion: Motion
    drives: MotorMotion
    limited: bool
    nlp: NlpResult


def collocate_full(
    equations: Equations,
    path: Path,
    nodes: np.ndarray,
    limits: Limits | None = None,
    *,
    progress: Progress | None = None,
    max_iterations: int = 300,
) -> FullSolution:
    """Solve the full problem on the mesh ``nodes`` [s]. SolverError where IPOPT does not converge."""
    model = equations.model
    n, n_a, n_m, n_y, i_m = model.dof, model.n_a, model.n_m, model.output.size, list(model.i_m)
    limits = limits or Limits()
    torque_max, speed_max = limits.arrays(n_m)
    bend_max = limits.deflections(model.n_e)
    mesh = Transcription(nodes, gauss(STAGES), n + n_m, n_y)
    reduction, y_rest, tau_rest, slow = _slow_motion(equations, path, mesh)
    for j, motor in enumerate(model.motors):
        needed = float(np.abs(tau_rest[:, j]).max())
        if needed > torque_max[j]:
            raise SolverError(
                f"limits: motor {motor.name} needs {needed:.4g} N m to hold the arm at rest at the ends of the path, "
                f"its limit is {torque_max[j]:.4g} N m"
            )
    for i, bound in zip(model.i_e, bend_max, strict=True):
        needed = max(abs(rest[i]) for rest in y_rest)
        if needed > bound:
            raise SolverError(
                f"limits: coordinate {model.coordinates[i].name} is deflected by {needed:.4g} at rest at the ends of "
                f"the path, its limit is {bound:.4g}"
            )
    sample = path.sample(mesh.times)

    ratio, inertia = np.abs(model.eta).max(axis=1), np.array([m.inertia for m in model.motors])
    scale_y = np.r_[np.ones(n_a), ratio[i_m]]
    M = evaluate(equations.function("mass_matrix"), slow(nodes[:1])[:, :n_a])[0].reshape(n_a, n_a)
    arm = np.diag(M)[list(model.i_g)]
    turned = np.where(
        inertia > 0.0, inertia * ratio, np.abs(np.linalg.inv(model.eta)).T @ arm
    )  # a direct drive: the arm
    tau_0 = np.maximum(np.abs(tau_rest).max(axis=0), 0.1 * turned * ACCELERATION)
    scale_state = np.r_[scale_y, tau_0, scale_y, tau_0]  # u in N m s
    scale_rate = np.r_[scale_y, tau_0] * ACCELERATION
    scale_x = np.r_[
        np.tile(scale_state, mesh.N + 1), np.tile(np.r_[np.tile(scale_rate, STAGES), np.ones(STAGES * n_y)], mesh.N)
    ]
    torque = np.linspace(tau_rest[0], tau_rest[1], mesh.N + 1).clip(-torque_max, torque_max)
    states = np.hstack([slow(nodes), np.zeros((mesh.N + 1, n_m)), slow(nodes, 1), torque])
    still = np.zeros((len(mesh.times), n_m))
    guess = mesh.pack(states, np.hstack([slow(mesh.times, 2), still]), np.zeros((len(mesh.times), n_y)))

    z, row, h, (y, dy, ddy), e = mesh.instant()
    place = output_map(equations)
    target = ca.SX.sym("target", place.target.shape[0])
    symbols = ca.vertcat(equations.lagrangian.chain.q_a, place.target)
    error = ca.substitute(place.error, symbols, ca.vertcat(y[:n_a], target))
    residual = _instant_rows(equations, y, dy, ddy)
    scale_e = ERROR * min(1.0, reach(equations))
    # speeds, torques and deflections are polynomials on each interval: their Bernstein coefficients are bounded, which
    # bounds them everywhere and not at the Gauss points alone
    bernstein = ca.SX.sym("bernstein", 2 * STAGES + 1)
    rates = z[mesh.n : 2 * mesh.n]
    places = z[: mesh.n] + h * bernstein[2 * STAGES] * rates
    for j in range(STAGES):
        acceleration = z[(2 + j) * mesh.n : (3 + j) * mesh.n]
        rates = rates + h * bernstein[j] * acceleration
        places = places + h**2 * bernstein[STAGES + j] * acceleration
    bounds = np.r_[speed_max, torque_max, bend_max]
    bounded = np.flatnonzero(np.isfinite(bounds)).tolist()
    limited = ca.vertcat(_speeds(equations, rates), rates[n:], places[list(model.i_e)])
    rows = ca.vertcat(residual, error - scale_e * e, limited[bounded])
    x = ca.MX.sym("x", mesh.size)
    values = [*mesh.parameters, reduction.targets(sample).T, np.tile(bernstein_rows(mesh.table), (mesh.N, 1)).T]
    g, jacobian, scale = mesh.constraints(x, rows, [z, row, h, target, bernstein], values, scale_x, guess)
    upper = np.zeros(rows.shape[0])
    upper[n + n_y :] = bounds[bounded]
    upper_g = np.r_[np.tile(upper * scale, mesh.N * STAGES), np.zeros(2 * mesh.n * mesh.N)]

    # all terms of the cost are squares of unknowns: a diagonal holds all of it
    count = mesh.N * STAGES
    smooth = SMOOTH_LIMITED if bounded else SMOOTH
    accelerations, errors = mesh.own
    weight, aim = np.zeros(mesh.size), np.zeros(mesh.size)
    weight[errors.ravel()] = 1.0 / count
    weight[accelerations[:, n:].ravel()] = smooth / count * (ACCELERATION * path.duration) ** 2
    last = np.arange(mesh.n_nodes - 2 * mesh.n, mesh.n_nodes)
    goal = np.r_[y_rest[1], np.zeros(n_m), np.zeros(n), tau_rest[1]]
    kept = np.r_[np.ones(n), np.zeros(n_m), np.ones(n), np.zeros(n_m)]
    weight[last], aim[last] = END * kept, goal
    cost = ca.dot(ca.DM(weight), (x - ca.DM(aim / scale_x)) ** 2) / 2
    H = ca.DM(sp.diags(weight).tocsc())

    lower_x, upper_x = np.full(mesh.size, -np.inf), np.full(mesh.size, np.inf)
    nodes_tau = np.arange(mesh.N + 1)[:, None] * 2 * mesh.n + 2 * mesh.n - n_m + np.arange(n_m)
    lower_x[nodes_tau], upper_x[nodes_tau] = -torque_max / tau_0, torque_max / tau_0
    first = np.r_[y_rest[0], np.zeros(n_m), np.zeros(n), tau_rest[0]] / scale_state
    lower_x[: 2 * mesh.n] = upper_x[: 2 * mesh.n] = first
    result = solve_nlp(
        x,
        cost,
        g,
        jacobian,
        ca.MX(H),
        guess / scale_x,
        bounds_x=(lower_x, upper_x),
        bounds_g=(-upper_g, upper_g),
        progress=progress,
        max_iterations=max_iterations,
        tolerance=TOLERANCE,
    )
    if not result.success:
        raise SolverError(
            f"full collocation: IPOPT ended with {result.status!r} after {result.iterations} iterations, largest "
            f"violation {result.violation:.2e}; give the move more time, loosen the limits or change the --mesh"
        )
    return _samples(equations, mesh, result, scale_x, torque_max, speed_max, bend_max)


def _slow_motion(
    equations: Equations, path: Path, mesh: Transcription
) -> tuple[Reduction, list[np.ndarray], np.ndarray, CubicSpline]:
    """Where to start: quasi-static motion of y as a spline, rest (y, torque) at both ends."""
    model = equations.model
    simple = dataclasses.replace(model, motor_coupling="simplified")  # rest is the same, and it can be reduced
    reduction = Reduction(Equations(simple) if model.motor_coupling == "complete" else equations)
    times = np.unique(np.concatenate([mesh.nodes, mesh.times]))
    arm = reduction.follow(path, times, reduction.start(path).q_a)
    ends = [at_rest(equations, arm[0]), at_rest(equations, arm[-1])]
    i_m = list(model.i_m)
    geared = (arm[:, list(model.i_g)] @ model.eta.T)[:, i_m]
    share = np.linspace(0, 1, len(times))[:, None]
    motors = geared + (1 - share) * (ends[0].q_m[i_m] - geared[0]) + share * (ends[1].q_m[i_m] - geared[-1])
    y_rest = [np.r_[e.q_a, e.q_m[i_m]] for e in ends]
    return reduction, y_rest, np.array([e.tau_m for e in ends]), CubicSpline(times, np.hstack([arm, motors]))


def _instant_rows(equations: Equations, y: ca.SX, dy: ca.SX, ddy: ca.SX) -> ca.SX:
    """Equations of motion (n) at one instant, from (q_a, q_me, u) and their derivatives."""
    model = equations.model
    n, n_a, n_m, i_m = model.dof, model.n_a, model.n_m, list(model.i_m)
    q_m, v_m, a_m = (ca.SX.zeros(n_m) for _ in range(3))
    for full, part in ((q_m, y), (v_m, dy), (a_m, ddy)):
        for k, j in enumerate(i_m):
            full[j] = part[n_a + k]
    r_a, r_m = equations.function("residual")(y[:n_a], dy[:n_a], ddy[:n_a], q_m, v_m, a_m, dy[n:])
    return ca.vertcat(r_a, *[r_m[j] for j in i_m])


def _speeds(equations: Equations, rates: ca.SX) -> ca.SX:
    """Motor speeds (n_m) from the rates of (q_a, q_me, u); linear in them."""
    model = equations.model
    geared = ca.mtimes(ca.SX(ca.DM(model.eta)), rates[list(model.i_g)])
    at = {j: model.n_a + k for k, j in enumerate(model.i_m)}
    return ca.vertcat(*[rates[at[j]] if j in at else geared[j] for j in range(model.n_m)])


def bernstein_rows(table: Tableau) -> np.ndarray:
    """What makes Bernstein coefficients of speeds and places on an interval from accelerations at its s points.

    Row i (of s; 2 s + 1 columns): for the coefficient i + 1 of the speed, a polynomial of degree s, the shares of the
    accelerations; the same for the coefficient i + 2 of the place, of degree s + 1; and the share of the first speed
    in that. A polynomial lies within the range of its coefficients. Those left out are, or nearly are, the last ones of
    the interval before.
    """
    s = len(table.c)
    out = []
    for degree, first, weights in ((s, 1, 0), (s + 1, 2, 1)):
        theta = np.linspace(0.0, 1.0, degree + 1)
        basis = np.array([[comb(degree, i) * x**i * (1 - x) ** (degree - i) for i in range(degree + 1)] for x in theta])
        out.append(np.linalg.solve(basis, table.weights(theta)[weights])[first:])
    return np.hstack([*out, np.arange(2, s + 2)[:, None] / (s + 1)])


def _samples(
    equations: Equations,
    mesh: Transcription,
    result: NlpResult,
    scale_x: np.ndarray,
    torque_max: np.ndarray,
    speed_max: np.ndarray,
    bend_max: np.ndarray,
) -> FullSolution:
    """Motion and torques on a grid ``PARTS`` times finer than the mesh, from the collocation polynomials."""
    model = equations.model
    n, n_a, i_m, i_g = model.dof, model.n_a, list(model.i_m), list(model.i_g)
    y, dy, ddy, w = mesh.unpack(result.x * scale_x)
    theta = np.arange(PARTS) / PARTS
    once, twice = mesh.table.weights(theta)
    h = mesh.h[:, None, None]
    levels = [
        y[:-1, None] + h * theta[:, None] * dy[:-1, None] + h**2 * np.einsum("pj,njk->npk", twice, ddy),
        dy[:-1, None] + h * np.einsum("pj,njk->npk", once, ddy),
        np.einsum("pj,njk->npk", mesh.table.lagrange(theta), ddy),
    ]
    ends = [y[-1:], dy[-1:], np.einsum("j,jk->k", mesh.table.lagrange(np.ones(1))[0], ddy[-1])[None]]
    t = np.r_[(mesh.nodes[:-1, None] + mesh.h[:, None] * theta).ravel(), mesh.nodes[-1]]
    sampled = [np.vstack([level.reshape(-1, mesh.n), end]) for level, end in zip(levels, ends, strict=True)]
    arm = [level[:, :n_a] for level in sampled]
    motor = []
    for level in sampled:
        full = level[:, i_g] @ model.eta.T
        full[:, i_m] = level[:, n_a:n]
        motor.append(full)
    # IPOPT keeps bounds to its tolerance
    tau_m = np.clip(sampled[1][:, n:], -torque_max, torque_max)
    drives = MotorMotion(motor[0], motor[1], motor[2], tau_m)
    tau_g = np.zeros((len(t), len(i_g), 3))
    tau_g[:, :, 0] = gear_torques(equations, arm[0], arm[1], arm[2], drives)
    bends = arm[0][:, list(model.i_e)]
    pairs = ((tau_m, torque_max), (motor[1], speed_max), (bends, bend_max))
    at_bound = any((np.abs(value) > NEAR * bound).any() for value, bound in pairs)
    limited = bool(at_bound and np.abs(w).max() > NOTICED)
    zero = np.zeros_like(arm[0])
    motion = Motion(arm[0], arm[1], arm[2], zero, zero, tau_g)
    return FullSolution(t, motion, drives, limited, result)
