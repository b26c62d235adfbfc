"""Inverse dynamics as optimal control of the full model, with bounds on motor torque and speed.

Nothing is reduced. All coordinates y = (q_a, q_me) are collocated, the motor torques are unknowns,
the robot starts in equilibrium, and the tool tracks the path in the sense of least squares:

    min  mean |e(q_a) / e_0|^2 + rho mean |tau_m' T / tau_0|^2
         + sigma |y(end) - y_eq|^2 + sigma |y'(end)|^2 + sigma |(tau_m(end) - tau_eq) / tau_0|^2
    s.t. the equations of motion at the Gauss points,
         |tau_m| <= tau_max,  |v_m| <= v_max,  |q_e| <= deflection_max

The torque is continuous: it is collocated as the speed of further coordinates u, ``u' = tau_m``.
Five Gauss points an interval, one more than the index of the inverse problem: with fewer the
torque loses its order. The tracking error is a small fraction of ``e_0``, and larger where limits
are active.

Source: J. Betts, Practical Methods for Optimal Control, 2010, ch. 4.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from math import comb

import casadi as ca
import numpy as np
import scipy.sparse as sp
from scipy.interpolate import CubicSpline

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.numerics.nlp import BUILDING, NlpResult, NonlinearProgram, Progress, solve_nlp
from flexgen.base.numerics.tableaus import Tableau, gauss
from flexgen.base.numerics.transcription import Transcription
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.dynamics.mechanics.outputs import output_map
from flexgen.dynamics.mechanics.statics import equilibrium_at, reach
from flexgen.inversion.judge.status import Status
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.problem.motor_side import MotorMotion, gear_torques
from flexgen.inversion.problem.problem import ACCELERATION, InversionProblem
from flexgen.inversion.problem.reduced_problem import Motion, Reduction
from flexgen.model.abilities import obstacle
from flexgen.model.elements import RobotModel
from flexgen.paths.path import Path

STAGES = 5
ITERATIONS = 300  # of IPOPT, at most
SAMPLES = 10  # of an interval
ERROR = 1e-4  # e_0: the tool error that costs one, rad, and m for each meter of reach, at most m
SMOOTH = 1e-9  # rho: small, to smooth only what the path does not determine
# rho with limits: with less the torque chatters between them for a gain too small to measure
SMOOTH_LIMITED = 1e-3
NOTICED = 1e-2  # of e_0: tracking error above which an active bound is reported as LIMITS_ACTIVE
# sigma: at the end the robot rests and its torque may be held; the motion before does not change
END = 1e3
TOLERANCE = 1e-9
NEAR = 0.99  # of a bound: above it the bound is active


@dataclass(frozen=True)
class FullSolution:
    """Samples of motion and torque; ``limits_active``: a bound keeps the tool off the path."""

    t: np.ndarray
    motion: Motion
    motors: MotorMotion
    limits_active: bool
    nlp: NlpResult


def solve(problem: InversionProblem, h: float) -> MethodResult:
    """Solve by optimal control of the full model on intervals of 2 ``h`` [s]. No options."""
    problem.check_options("full")
    preactuation, nodes = problem.nodes(2 * h)
    found = collocate_full(
        problem.equations, problem.path, nodes, problem.limits, progress=problem.progress
    )
    motion = found.motion
    return MethodResult(
        found.t,
        motion.q,
        motion.v,
        motion.a,
        motion.tau_g[:, :, 0],
        found.motors,
        preactuation,
        status=Status.LIMITS_ACTIVE if found.limits_active else Status.SOLVED,
        verdict=found.nlp.status,
        iterations=found.nlp.iterations,
        intervals=len(nodes) - 1,
    )


def collocate_full(
    equations: Equations,
    path: Path,
    nodes: np.ndarray,
    limits: Limits | None = None,
    *,
    progress: Progress | None = None,
) -> FullSolution:
    """Solve the optimal control problem on a mesh.

    Parameters
    ----------
    equations : Equations
    path : Path
    nodes : array (N + 1,) [s]
    limits : Limits, optional
    progress : callable, optional
        Called with one line of text now and then.

    Raises
    ------
    SolverError
        IPOPT does not converge, or the arm cannot be held at an end of the path within the limits.
    """
    check_time(BUILDING)
    model = equations.model
    bounds = _Bounds.of(model, limits or Limits())
    mesh = Transcription(nodes, gauss(STAGES), model.dof + model.n_m, model.output.size)
    slow = _slow_motion(equations, path, mesh)
    _check_equilibrium(model, slow, bounds)
    scales = _Scales.of(equations, mesh, slow)
    guess = _guess(model, mesh, slow, bounds)
    check_time(BUILDING)
    rows, symbols, target, bernstein, upper = _instant(equations, mesh, bounds)
    x = ca.MX.sym("x", mesh.size)
    targets = slow.reduction.targets(path.sample(mesh.times)).T
    values = [*mesh.parameters, targets, np.tile(bernstein_rows(mesh.table), (mesh.N, 1)).T]
    g, jacobian, scale = mesh.constraints(
        x, rows, [*symbols, target, bernstein], values, scales.x, guess
    )
    check_time(BUILDING)
    upper_g = np.r_[np.tile(upper * scale, mesh.N * STAGES), np.zeros(2 * mesh.n * mesh.N)]
    weight, aim = _cost(model, mesh, slow, path.duration, bounds)
    cost = ca.dot(ca.DM(weight), (x - ca.DM(aim / scales.x)) ** 2) / 2
    hessian = ca.MX(ca.DM(sp.diags(weight).tocsc()))
    result = solve_nlp(
        NonlinearProgram(
            x=x,
            cost=cost,
            g=g,
            jacobian=jacobian,
            hessian=hessian,
            convex=True,
            lower=-upper_g,
            upper=upper_g,
        ),
        guess / scales.x,
        bounds_x=_bounds_of_unknowns(model, mesh, slow, scales, bounds),
        progress=progress,
        max_iterations=ITERATIONS,
        tolerance=TOLERANCE,
    )
    if not result.success:
        raise SolverError(
            f"method full: IPOPT ended with {result.status!r} after {result.iterations} "
            f"iterations, largest violation {result.violation:.2e}; give the move more time, "
            "loosen the limits or change --mesh"
        )
    return _samples(equations, mesh, result, scales.x, bounds)


@dataclass(frozen=True)
class _Bounds:
    """Bounds of motor torque (n_m), motor speed (n_m) and deflection (n_e); infinite where there
    is none.
    """

    torque: np.ndarray
    speed: np.ndarray
    deflection: np.ndarray

    @staticmethod
    def of(model: RobotModel, limits: Limits) -> _Bounds:
        return _Bounds(*limits.arrays(model.n_m), limits.deflections(model.n_e))

    @property
    def finite(self) -> list[int]:
        """Numbers of the finite ones: speeds, torques, deflections."""
        return np.flatnonzero(
            np.isfinite(np.r_[self.speed, self.torque, self.deflection])
        ).tolist()


@dataclass(frozen=True)
class _SlowMotion:
    """The quasi-static motion ``y`` (spline over time), and the equilibria ``ends`` and
    ``torques`` (2, n_m) of it.
    """

    reduction: Reduction
    ends: list[np.ndarray]
    torques: np.ndarray
    y: CubicSpline


@dataclass(frozen=True)
class _Scales:
    """Sizes of the unknowns: of a state, of the torques (n_m) and of all unknowns."""

    state: np.ndarray
    torque: np.ndarray
    x: np.ndarray

    @staticmethod
    def of(equations: Equations, mesh: Transcription, slow: _SlowMotion) -> _Scales:
        """Scales of states, torques and unknowns of the mesh: 1 rad or m at the arm, the gear
        ratio at motors, and torques by the inertia at a typical acceleration or by the
        equilibrium. ``slow``: the quasi-static motion.
        """
        model = equations.model
        n_a = model.n_a
        i_m = list(model.i_m)
        ratio = np.abs(model.eta).max(axis=1)
        inertia = np.array([m.inertia for m in model.motors])
        scale_y = np.r_[np.ones(n_a), ratio[i_m]]
        M = evaluate(equations.function("mass_matrix"), slow.y(mesh.nodes[:1])[:, :n_a])[
            0
        ].reshape(n_a, n_a)
        arm = np.diag(M)[list(model.i_g)]
        # a direct drive accelerates the arm, not its rotor
        turned = np.where(inertia > 0.0, inertia * ratio, np.abs(np.linalg.inv(model.eta)).T @ arm)
        tau_0 = np.maximum(np.abs(slow.torques).max(axis=0), 0.1 * turned * ACCELERATION)
        state = np.r_[scale_y, tau_0, scale_y, tau_0]  # u in N m s
        rate = np.r_[scale_y, tau_0] * ACCELERATION
        inner = np.r_[np.tile(rate, STAGES), np.ones(STAGES * model.output.size)]
        return _Scales(state, tau_0, np.r_[np.tile(state, mesh.N + 1), np.tile(inner, mesh.N)])


def _check_equilibrium(model: RobotModel, slow: _SlowMotion, bounds: _Bounds) -> None:
    """Refuse limits in which the arm cannot be held at an end of the path: SolverError with the
    motor or the coordinate, its need and its limit.
    """
    for j, motor in enumerate(model.motors):
        needed = float(np.abs(slow.torques[:, j]).max())
        if needed > bounds.torque[j]:
            raise SolverError(
                f"limits: motor {motor.name} needs {needed:.4g} N m to hold the arm at rest at "
                f"the ends of the path, its limit is {bounds.torque[j]:.4g} N m; raise the "
                "limit or choose another path"
            )
    for i, bound in zip(model.i_e, bounds.deflection, strict=True):
        needed = max(abs(end[i]) for end in slow.ends)
        if needed > bound:
            raise SolverError(
                f"limits: coordinate {model.coordinates[i].name} is deflected by {needed:.4g} "
                f"at rest at the ends of the path, its limit is {bound:.4g}; raise the limit or "
                "choose another path"
            )


def _guess(
    model: RobotModel, mesh: Transcription, slow: _SlowMotion, bounds: _Bounds
) -> np.ndarray:
    """The quasi-static motion ``slow`` as unknowns of the mesh, with torques between those at its
    ends, within the bounds.
    """
    n_m = model.n_m
    n_y = model.output.size
    torque = np.linspace(slow.torques[0], slow.torques[1], mesh.N + 1).clip(
        -bounds.torque, bounds.torque
    )
    states = np.hstack(
        [slow.y(mesh.nodes), np.zeros((mesh.N + 1, n_m)), slow.y(mesh.nodes, 1), torque]
    )
    still = np.zeros((len(mesh.times), n_m))
    return mesh.pack(
        states, np.hstack([slow.y(mesh.times, 2), still]), np.zeros((len(mesh.times), n_y))
    )


def _instant(
    equations: Equations, mesh: Transcription, bounds: _Bounds
) -> tuple[ca.SX, list[ca.SX], ca.SX, ca.SX, np.ndarray]:
    """Rows of one instant for the mesh.

    Returns
    -------
    rows : ca.SX
        Equations of motion, output error less its slack, and limited quantities.
    symbols : list of ca.SX
        Unknowns they depend on.
    target, bernstein : ca.SX
        Target of the output, and weights of Bernstein coefficients of the interval.
    upper : array
        Largest size of each row: 0 for equations.
    """
    model = equations.model
    n = model.dof
    n_a = model.n_a
    n_y = model.output.size
    z, row, h, (y, dy, ddy), e = mesh.instant()
    output = output_map(equations)
    target = ca.SX.sym("target", output.target.shape[0])
    symbols = ca.vertcat(equations.lagrangian.chain.q_a, output.target)
    error = ca.substitute(output.error, symbols, ca.vertcat(y[:n_a], target))
    residual = _instant_rows(equations, y, dy, ddy)
    scale_e = ERROR * min(1.0, reach(equations))
    # speeds, torques and deflections are polynomials on each interval: their Bernstein
    # coefficients are bounded, which bounds them everywhere and not at the Gauss points alone
    bernstein = ca.SX.sym("bernstein", 2 * STAGES + 1)
    rates = z[mesh.n : 2 * mesh.n]
    positions = z[: mesh.n] + h * bernstein[2 * STAGES] * rates
    for j in range(STAGES):
        acceleration = z[(2 + j) * mesh.n : (3 + j) * mesh.n]
        rates = rates + h * bernstein[j] * acceleration
        positions = positions + h**2 * bernstein[STAGES + j] * acceleration
    limited = ca.vertcat(_speeds(equations, rates), rates[n:], positions[list(model.i_e)])
    rows = ca.vertcat(residual, error - scale_e * e, limited[bounds.finite])
    upper = np.zeros(rows.shape[0])
    upper[n + n_y :] = np.r_[bounds.speed, bounds.torque, bounds.deflection][bounds.finite]
    return rows, [z, row, h], target, bernstein, upper


def _cost(
    model: RobotModel, mesh: Transcription, slow: _SlowMotion, duration: float, bounds: _Bounds
) -> tuple[np.ndarray, np.ndarray]:
    """Weights and targets of the unknowns; all terms of the cost are squares of unknowns: output
    error, second derivative of torques over the ``duration`` [s], and rest at the end.
    """
    n = model.dof
    n_m = model.n_m
    count = mesh.N * STAGES
    smooth = SMOOTH_LIMITED if bounds.finite else SMOOTH
    accelerations, errors = mesh.own
    weight = np.zeros(mesh.size)
    aim = np.zeros(mesh.size)
    weight[errors.ravel()] = 1.0 / count
    weight[accelerations[:, n:].ravel()] = smooth / count * (ACCELERATION * duration) ** 2
    last = np.arange(mesh.n_nodes - 2 * mesh.n, mesh.n_nodes)
    kept = np.r_[np.ones(n), np.zeros(n_m), np.ones(n), np.ones(n_m)]
    weight[last] = END * kept
    aim[last] = np.r_[slow.ends[1], np.zeros(n_m), np.zeros(n), slow.torques[1]]
    return weight, aim


def _bounds_of_unknowns(
    model: RobotModel, mesh: Transcription, slow: _SlowMotion, scales: _Scales, bounds: _Bounds
) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds of the unknowns: torques at the nodes, and equilibrium at the first
    one.
    """
    n = model.dof
    n_m = model.n_m
    lower = np.full(mesh.size, -np.inf)
    upper = np.full(mesh.size, np.inf)
    torques = np.arange(mesh.N + 1)[:, None] * 2 * mesh.n + 2 * mesh.n - n_m + np.arange(n_m)
    lower[torques] = -bounds.torque / scales.torque
    upper[torques] = bounds.torque / scales.torque
    first = np.r_[slow.ends[0], np.zeros(n_m), np.zeros(n), slow.torques[0]] / scales.state
    lower[: 2 * mesh.n] = upper[: 2 * mesh.n] = first
    return lower, upper


def _slow_motion(equations: Equations, path: Path, mesh: Transcription) -> _SlowMotion:
    """The quasi-static motion along the path."""
    model = equations.model
    # has the same equilibria, and can be reduced
    simple = dataclasses.replace(model, motor_coupling="simplified")
    reduction = Reduction(
        Equations(simple) if obstacle(model, "simplified coupling") is not None else equations
    )
    times = np.unique(np.concatenate([mesh.nodes, mesh.times]))
    arm = reduction.follow(path, times, reduction.start(path).q_a)
    ends = [equilibrium_at(equations, arm[0]), equilibrium_at(equations, arm[-1])]
    i_m = list(model.i_m)
    geared = (arm[:, list(model.i_g)] @ model.eta.T)[:, i_m]
    share = np.linspace(0, 1, len(times))[:, None]
    motors = (
        geared
        + (1 - share) * (ends[0].q_m[i_m] - geared[0])
        + share * (ends[1].q_m[i_m] - geared[-1])
    )
    states = [np.r_[e.q_a, e.q_m[i_m]] for e in ends]
    return _SlowMotion(
        reduction,
        states,
        np.array([e.tau_m for e in ends]),
        CubicSpline(times, np.hstack([arm, motors])),
    )


def _instant_rows(equations: Equations, y: ca.SX, dy: ca.SX, ddy: ca.SX) -> ca.SX:
    """Equations of motion (n) at one instant, from the unknowns (q_a, q_me, u) and two
    derivatives; u is the integral of the motor torques, so ``u'`` are these torques.
    """
    model = equations.model
    n = model.dof
    n_a = model.n_a
    n_m = model.n_m
    i_m = list(model.i_m)
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
    """Weights of the Bernstein coefficients of speed and position on an interval, from
    accelerations at its s points.

    Row i (of s; 2 s + 1 columns): for coefficient i + 1 of the speed, a polynomial of degree s,
    the weights of the accelerations; the same for coefficient i + 2 of the position, of degree s +
    1; and the weight of the first speed in it. A polynomial lies within the range of its
    coefficients. The coefficients left out are, up to the order of the method, the last ones of
    the interval before.
    """
    s = len(table.c)
    out = []
    for degree, first, weights in ((s, 1, 0), (s + 1, 2, 1)):
        theta = np.linspace(0.0, 1.0, degree + 1)
        basis = np.array(
            [
                [comb(degree, i) * x**i * (1 - x) ** (degree - i) for i in range(degree + 1)]
                for x in theta
            ]
        )
        out.append(np.linalg.solve(basis, table.weights(theta)[weights])[first:])
    return np.hstack([*out, np.arange(2, s + 2)[:, None] / (s + 1)])


def _samples(
    equations: Equations,
    mesh: Transcription,
    result: NlpResult,
    scale_x: np.ndarray,
    bounds: _Bounds,
) -> FullSolution:
    """Motion and torques on a grid `SAMPLES` times finer than the mesh, from the collocation
    polynomials of the ``result``.

    ``scale_x``: sizes of its unknowns. Limits count as active where a bound is reached and the
    output deviates.
    """
    model = equations.model
    n = model.dof
    n_a = model.n_a
    i_m = list(model.i_m)
    i_g = list(model.i_g)
    y, dy, ddy, w = mesh.unpack(result.x * scale_x)
    theta = np.arange(SAMPLES) / SAMPLES
    once, twice = mesh.table.weights(theta)
    h = mesh.h[:, None, None]
    levels = [
        y[:-1, None]
        + h * theta[:, None] * dy[:-1, None]
        + h**2 * np.einsum("pj,njk->npk", twice, ddy),
        dy[:-1, None] + h * np.einsum("pj,njk->npk", once, ddy),
        np.einsum("pj,njk->npk", mesh.table.lagrange(theta), ddy),
    ]
    ends = [
        y[-1:],
        dy[-1:],
        np.einsum("j,jk->k", mesh.table.lagrange(np.ones(1))[0], ddy[-1])[None],
    ]
    t = np.r_[(mesh.nodes[:-1, None] + mesh.h[:, None] * theta).ravel(), mesh.nodes[-1]]
    sampled = [
        np.vstack([level.reshape(-1, mesh.n), end])
        for level, end in zip(levels, ends, strict=True)
    ]
    arm = [level[:, :n_a] for level in sampled]
    motor = []
    for level in sampled:
        full = level[:, i_g] @ model.eta.T
        full[:, i_m] = level[:, n_a:n]
        motor.append(full)
    # IPOPT keeps bounds within its tolerance
    tau_m = np.clip(sampled[1][:, n:], -bounds.torque, bounds.torque)
    motors = MotorMotion(motor[0], motor[1], motor[2], tau_m)
    tau_g = np.zeros((len(t), len(i_g), 3))
    tau_g[:, :, 0] = gear_torques(equations, arm[0], arm[1], arm[2], motors)
    deflections = arm[0][:, list(model.i_e)]
    pairs = ((tau_m, bounds.torque), (motor[1], bounds.speed), (deflections, bounds.deflection))
    at_bound = any((np.abs(value) > NEAR * bound).any() for value, bound in pairs)
    limits_active = bool(at_bound and np.abs(w).max() > NOTICED)
    zero = np.zeros_like(arm[0])
    motion = Motion(arm[0], arm[1], arm[2], zero, zero, tau_g)
    return FullSolution(t, motion, motors, limits_active, result)
