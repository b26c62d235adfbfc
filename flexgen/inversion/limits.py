"""Inverse dynamics within limits: the smallest path deviation that keeps bounds on torque, speed and deflection.

A quadratic program modifies the path, and the modified path is inverted. With coefficients c of a smooth deviation
d(t) from the path (`flexgen.inversion.path_deviation`), which may begin before the path and end after it,

    min  mean |d|^2 / e^2 + rho mean |d''''|^2    s.t.  |x_k(t_i) + sum_j dx_k/dc_j (t_i) dc_j| <= bound_k,

x: motor torques, motor speeds and deflections. The Jacobian dx/dc is found by differences of inversions of modified
paths; splines whose responses do not overlap share one inversion. Friction is not linear: it is added to the other
torques at the speeds after the step. The modified path is inverted again, and the next program starts from that motion.

Source: J. Nocedal, S. Wright, Numerical Optimization, 2006, ch. 18 (sequential quadratic programming).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from flexgen.deadline import check_time
from flexgen.errors import SolverError
from flexgen.inversion.bounds import Limits
from flexgen.inversion.method_result import MethodResult
from flexgen.inversion.path_deviation import SUPPORT, DeviationBasis, deviated_path
from flexgen.inversion.problem import DECAY, SETTLING, InversionProblem
from flexgen.inversion.reduced_problem import Reduction
from flexgen.inversion.sampling import from_library
from flexgen.inversion.status import Status
from flexgen.mechanics.equations import Equations
from flexgen.mechanics.statics import reach
from flexgen.numerics.evaluate import evaluate
from flexgen.numerics.quadratic_program import solve_program
from flexgen.runtime.library import Library
from flexgen.runtime.path_inversion import Inversion

KNOTS = 30  # intervals between knots on the path
PER_KNOT = 2  # intervals of the mesh between knots, at least
LATE = 0.5  # of the path's duration: how long after it the motion may end
CHORDS = 6  # programs until the friction agrees with the speeds after the step
ROUNDS = 8  # programs, each followed by an inversion
SLACK = 1e-3  # of a bound: largest violation of a result
MARGIN = 2e-4  # of a bound: distance that the programs keep from it
DECAYING = 5.0  # time constants of the zero dynamics until a response is negligible
PUSH = 1.0  # m/s^2, rad/s^2: acceleration of the deviations whose responses are computed
SMOOTH = 100.0  # rho, relative: cost of curvature of the shortest wave that the knots resolve
PER_SPLINE = 3  # rows in the program between two knots, and peaks
PRICE = 1e5  # cost of exceeding all bounds by 100 %; a deviation of 1 mm costs one
NEAR = 0.7  # of a bound: rows with smaller values are not in the program at first
SETTLED = 1e-2  # of the deviation: a program that changes it by less has converged
POOR = 0.3  # of a violation: where more is left after a step the Jacobian is computed again
HOPELESS = 0.9  # of a violation: where more is left with a new Jacobian the iteration ends
LEAST_SHARE = 0.2  # of a step
ROUGH = 100.0  # tolerance relative to that of the path itself: deviations are rougher, Jacobians need few digits
NOTICED = 1e-6  # m and rad: largest deviation that is not reported as LIMITS_ACTIVE


@dataclass(frozen=True)
class _Horizon:
    """The sampled path with time before and after it, and the arguments of its inversion."""

    library: Library
    path: tuple[np.ndarray, np.ndarray, np.ndarray]
    period: float
    before: int
    n_pre: int
    n_post: int
    samples_per_interval: int
    q_start: np.ndarray
    tolerance: float
    deviations: DeviationBasis

    def invert(self, c: np.ndarray) -> Inversion:
        """The inversion of the modified path with the coefficients ``c`` (count, n_y)."""
        deviation = (self.deviations.along(c), self.deviations.along(c, 1), self.deviations.along(c, 2))
        y, dy, ddy = deviated_path(*self.path, deviation)
        return self.library.invert(
            *(np.ascontiguousarray(x) for x in (y, dy, ddy)),
            period=self.period,
            q_start=self.q_start,
            n_pre=self.n_pre,
            n_post=self.n_post,
            samples_per_interval=self.samples_per_interval,
            tolerance=self.tolerance,
        )


class _Bounds:
    """Bounds of motor torques, motor speeds and deflections, scaled to the range -1 to 1.

    Friction changes its sign with the speed. So the torques are linearized without friction, and friction is added
    where the speeds are known.
    """

    def __init__(self, equations: Equations, limits: Limits) -> None:
        model = equations.model
        self.equations, self.n_m, self.i_e = equations, model.n_m, list(model.i_e)
        self.torque, self.speed = limits.arrays(model.n_m)
        self.deflection = limits.deflections(model.n_e)
        self.size = np.r_[self.torque, self.speed, self.deflection]
        self.any = bool(np.isfinite(self.size).any())

    def friction(self, v: np.ndarray) -> np.ndarray:
        """Of the motors at speeds (n, n_m) [N m]."""
        return evaluate(self.equations.function("motor_friction"), np.ascontiguousarray(v))[0].reshape(v.shape)

    def followed(self, found: Inversion) -> np.ndarray:
        """Torques without friction, speeds, deflections; (n, bounds)."""
        return np.hstack([found.tau_m - self.friction(found.v_m), found.v_m, found.q_a[:, self.i_e]])

    def values(self, followed: np.ndarray) -> np.ndarray:
        """Torques, speeds and deflections relative to their bounds, (n, bounds)."""
        x, n_m = followed.copy(), self.n_m
        x[:, :n_m] += self.friction(followed[:, n_m : 2 * n_m])
        return x / self.size

    def chords(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Secant slopes (n, n_m) of the friction between the speeds of two motions."""
        v, to = (x[:, self.n_m : 2 * self.n_m] for x in (before, after))
        least = 1e-4 * (1.0 + np.abs(v).max())
        apart = np.where(np.abs(to - v) < least, least, to - v)
        return (self.friction(v + apart) - self.friction(v)) / apart

    def check_equilibrium(self, problem: InversionProblem) -> None:
        """SolverError where the arm cannot be held at an end of the path."""
        model, path = problem.equations.model, problem.path
        reduction = Reduction(problem.equations)
        for t, guess in ((0.0, path.q_start), (path.duration, None)):
            if guess is None:
                ends = np.linspace(0.0, path.duration, 65)
                guess = reduction.follow(path, ends, reduction.start(path).q_a)[-1]
            equilibrium = reduction.equilibrium(path, t, guess)
            for j, motor in enumerate(model.motors):
                if not abs(equilibrium.tau_m[j]) <= self.torque[j]:
                    raise SolverError(
                        f"limits: motor {motor.name} needs {abs(equilibrium.tau_m[j]):.4g} N m to hold the arm at "
                        f"rest at the ends of the path, its limit is {self.torque[j]:.4g} N m; raise it or choose "
                        "another path"
                    )
            for i, bound in zip(model.i_e, self.deflection, strict=True):
                if not abs(equilibrium.q_a[i]) <= bound:
                    raise SolverError(
                        f"limits: coordinate {model.coordinates[i].name} is deflected by "
                        f"{abs(equilibrium.q_a[i]):.4g} at rest at the ends of the path, "
                        f"its limit is {bound:.4g}; raise it or choose another path"
                    )


def enforce_limits(
    problem: InversionProblem, unlimited: Inversion, library: Library, samples_per_interval: int, tolerance: float
) -> MethodResult:
    """The result that keeps the limits: that of the path where no limit is active, else that of a modified path.

    Parameters
    ----------
    problem : InversionProblem
        With limits.
    unlimited : Inversion
        Of the path itself.
    library : Library
        Of the model.
    samples_per_interval, tolerance : int, float
        Arguments of the inversion, see `flexgen.runtime.path_inversion.Inverter`.

    Raises
    ------
    SolverError
        The limits cannot be kept: in equilibrium at an end of the path, or within the duration of the motion.
    """
    assert problem.limits is not None
    bounds = _Bounds(problem.equations, problem.limits)
    if not bounds.any or np.abs(bounds.values(bounds.followed(unlimited))).max() <= 1.0:
        return from_library(unlimited)
    bounds.check_equilibrium(problem)
    horizon = _horizon(problem, unlimited, library, samples_per_interval, tolerance)
    c, found, rounds = _modify_path(problem, horizon, bounds)
    result = from_library(found)
    off = horizon.deviations.along(c)
    n_p = 3 if horizon.path[0].shape[1] > off.shape[1] else off.shape[1]
    meters = float(np.linalg.norm(off[:, :n_p], axis=1).max())
    angle = float(np.linalg.norm(off[:, n_p:], axis=1).max())
    size = f"{meters:.3g} m" + (f" and {angle:.3g} rad" if n_p < off.shape[1] else "")
    return replace(
        result,
        t=result.t - horizon.before * horizon.period,
        preactuation=(horizon.before + horizon.n_pre) * horizon.period,
        status=Status.LIMITS_ACTIVE if max(meters, angle) > NOTICED else Status.SOLVED,
        verdict=f"the limits are active: path deviation up to {size}, {rounds} quadratic programs",
        details={**result.details, "deviation_max_m": meters, "deviation_max_rad": angle, "programs": rounds},
    )


def check_limits_at_rest(problem: InversionProblem) -> None:
    """SolverError where the limits do not let the arm rest at an end of the path; nothing where there are no limits."""
    if problem.limits is not None:
        _Bounds(problem.equations, problem.limits).check_equilibrium(problem)


def _horizon(
    problem: InversionProblem, unlimited: Inversion, library: Library, samples_per_interval: int, tolerance: float
) -> _Horizon:
    """The path with time for deviations before it and after it."""
    path, period, duration = problem.path, unlimited.period, problem.path.duration
    n_pre, n_post = unlimited.n_pre, unlimited.n_post
    spacing = max(duration / KNOTS, PER_KNOT * samples_per_interval * period)
    before = int(np.ceil((problem.windows[0] + SUPPORT * spacing) / period))
    after = int(np.ceil((LATE * duration + SUPPORT * spacing) / period))
    steps = round(duration / period)
    t = (np.arange(before + steps + after + 1) - before) * period
    sample = path.sample(t)
    samples = (Reduction(problem.equations).targets(sample), sample.derivative(1), sample.derivative(2))
    count = int((t[-1] - t[0]) / spacing + 1e-9) - SUPPORT + 1
    deviations = DeviationBasis(t, t[0], spacing, count)
    return _Horizon(
        library,
        samples,
        period,
        before,
        n_pre,
        n_post,
        samples_per_interval,
        path.q_start,
        ROUGH * tolerance,
        deviations,
    )


def _modify_path(problem: InversionProblem, horizon: _Horizon, bounds: _Bounds) -> tuple[np.ndarray, Inversion, int]:
    """Coefficients of the deviation, the inversion of the modified path, and the number of programs."""
    deviations, n_y = horizon.deviations, horizon.path[1].shape[1]
    c = np.zeros((deviations.count, n_y))
    found = horizon.invert(c)
    followed = bounds.followed(found)
    jacobian, fresh = _jacobian(problem, horizon, bounds, c, followed), True
    worst = float(np.abs(bounds.values(followed)).max()) - 1.0
    for round_ in range(1, ROUNDS + 1):
        check_time(f"limits, program {round_}, bounds exceeded by up to {worst:.1e} of their values")
        step = _step(problem, horizon, bounds, c, followed, jacobian)
        share = 1.0
        while True:
            trial = horizon.invert(c + share * step)
            at = bounds.followed(trial)
            over = float(np.abs(bounds.values(at)).max()) - 1.0
            if over <= max(worst, SLACK) or share < LEAST_SHARE:
                break
            share /= 2
        c, found, followed = c + share * step, trial, at
        problem.log(f"limits: program {round_}: largest violation {max(over, 0.0):.1e} of a bound")
        settled = np.abs(step).max() <= SETTLED * np.abs(c).max() + NOTICED
        if over <= SLACK and (settled or worst <= SLACK):
            return c, found, round_
        if over > POOR * worst and over > SLACK:
            if fresh and over > HOPELESS * worst:
                worst = over
                break
            jacobian, fresh = _jacobian(problem, horizon, bounds, c, followed), True
        else:
            fresh = False
        worst = over
    if worst <= SLACK:
        return c, found, ROUNDS
    late = horizon.deviations.t[-1] - problem.path.duration
    raise SolverError(
        f"limits: no path deviation keeps them within a motion that ends {late:.3g} s after the path: a bound is "
        f"exceeded by {worst:.2g} of its value; give the move more time or loosen the limits"
    )


def _jacobian(
    problem: InversionProblem, horizon: _Horizon, bounds: _Bounds, c: np.ndarray, followed: np.ndarray
) -> sp.csr_matrix:
    """Jacobian (n bounds, count n_y) of the bounded quantities in the coefficients, sparse."""
    problem.log("limits: computing the Jacobian of the path deviation")
    deviations, n_y = horizon.deviations, c.shape[1]
    n, b = followed.shape
    preactuation, settling = problem.windows
    ahead, behind = DECAYING / DECAY * preactuation, DECAYING / SETTLING * settling
    half = SUPPORT / 2 * deviations.spacing
    apart = min(deviations.count, int(np.ceil((2 * half + ahead + behind) / deviations.spacing)))
    times = (np.arange(n) - horizon.n_pre - horizon.before) * horizon.period
    push = PUSH * deviations.spacing**2
    rows, columns, entries = [], [], []
    reaches = [
        (np.searchsorted(times, m - half - ahead), np.searchsorted(times, m + half + behind, side="right"))
        for m in deviations.middles
    ]
    for j in range(n_y):
        for color in range(apart):
            check_time("limits, Jacobian of the path deviation")
            pushed = c.copy()
            pushed[color::apart, j] += push
            change = (bounds.followed(horizon.invert(pushed)) - followed) / push
            for i in range(color, deviations.count, apart):
                begin, end = reaches[i]
                part = change[begin:end].ravel()
                rows.append(np.arange(begin * b, end * b))
                columns.append(np.full(part.size, i * n_y + j))
                entries.append(part)
    return sp.csr_matrix(
        (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))),
        shape=(n * b, deviations.count * n_y),
    )


def _step(
    problem: InversionProblem,
    horizon: _Horizon,
    bounds: _Bounds,
    c: np.ndarray,
    followed: np.ndarray,
    jacobian: sp.csr_matrix,
) -> np.ndarray:
    """The step (count, n_y) that keeps the linearized bounds, with the friction at the speeds after the step."""
    n_m, b = bounds.n_m, followed.shape[1]
    rows = np.arange(followed.size).reshape(followed.shape)
    after, best, least = followed, np.zeros_like(c), np.inf
    active = np.zeros((2, followed.size), dtype=bool)
    for _ in range(CHORDS):
        friction = np.zeros(followed.shape)
        friction[:, :n_m] = bounds.chords(followed, after)
        speeds = np.zeros(followed.shape, dtype=int)
        speeds[:, :n_m] = rows[:, n_m : 2 * n_m]
        A = jacobian + sp.diags(friction.ravel()) @ jacobian[speeds.ravel()]
        A = sp.diags(np.tile(1.0 / bounds.size, len(followed))) @ A
        step = _program(problem, horizon, c, bounds.values(followed), A.tocsr(), active)
        after = followed + (jacobian @ step.ravel()).reshape(-1, b)
        over = float(np.abs(bounds.values(after)).max()) - 1.0
        if over < least:
            best, least = step, over
        if over <= SLACK / 2:
            break
    return best


def _program(
    problem: InversionProblem,
    horizon: _Horizon,
    c: np.ndarray,
    values: np.ndarray,
    jacobian: sp.csr_matrix,
    active: np.ndarray,
) -> np.ndarray:
    """The step (count, n_y) of the quadratic program for values with this Jacobian.

    ``active`` (2, n bounds): upper and lower bounds that are in the program; those that a step exceeds are added.
    """
    deviations, (count, n_y) = horizon.deviations, c.shape
    unit = 1e-3 * min(1.0, reach(problem.equations))
    values_of, wave = deviations.basis[0], (deviations.spacing / np.pi) ** 4 * deviations.basis[4]
    gram = (values_of.T @ values_of + SMOOTH * wave.T @ wave) / len(values_of)
    gram *= count  # a coefficient of one costs about one
    H = sp.kron(sp.csc_matrix(gram), sp.eye(n_y), format="csc")
    x, A = values.ravel(), jacobian * unit
    gradient = H @ (c.ravel() / unit)
    grid = np.zeros(values.shape, dtype=bool)
    grid[:: max(1, int(deviations.spacing / horizon.period / PER_SPLINE))] = True
    first = (grid | _peaks(values)).ravel()
    active |= np.stack([(x > NEAR) & first, (x < -NEAR) & first])
    while True:
        upper, lower = active
        rows, at = sp.vstack([A[upper], -A[lower]], format="csr"), np.concatenate([x[upper], -x[lower]])
        step, over = _solved(H, gradient, rows, at)
        after = x + A @ step
        peaks = _peaks(after.reshape(values.shape)).ravel()
        broken = np.stack([after > 1.0 + over, after < -1.0 - over]) & peaks & ~active
        if not broken.any():
            return step.reshape(count, n_y) * unit
        active |= broken


def _solved(H: sp.csc_matrix, gradient: np.ndarray, A: sp.csr_matrix, x: np.ndarray) -> tuple[np.ndarray, float]:
    """Step d of ``min d H d / 2 + gradient d`` with ``x + A d <= 1``; or ``1 + s`` with the least s, and that s."""
    check_time("limits, quadratic program")
    room = 1.0 - MARGIN - x
    found = solve_program(H, gradient, A, room)
    if found is not None:
        return found, 0.0
    # No step keeps all: one more unknown, the largest violation, is minimized too.
    one = sp.csr_matrix(np.ones((1, 1)))
    found = solve_program(
        sp.block_diag([H, PRICE * one], format="csc"),
        np.r_[gradient, PRICE],
        sp.bmat([[A, -sp.csr_matrix(np.ones((len(x), 1)))], [None, -one]], format="csr"),
        np.r_[room, 0.0],
    )
    assert found is not None  # a violation that is large enough keeps all rows
    return found[:-1], max(float(found[-1]), 0.0)


def _peaks(values: np.ndarray) -> np.ndarray:
    """Where |values| (n, m) are local maxima, column by column."""
    size = np.abs(values)
    padded = np.pad(size, ((1, 1), (0, 0)))
    return (size >= padded[:-2]) & (size >= padded[2:])
