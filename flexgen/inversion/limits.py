"""Inverse dynamics within limits: the path is bent as little as torque, speed and deflection bounds ask for.

The inversion stays exact; a quadratic program chooses what is inverted. With coefficients c of a smooth deviation d(t)
from the path (`flexgen.solvers.bends`), of motion that may begin before the path and end after it,

    min  mean |d|^2 / e^2 + rho mean |d''''|^2    s.t.  |x_k(t_i) + sum_j dx_k/dc_j (t_i) dc_j| <= bound_k,

x: motor torques, motor speeds and deflections. The slopes dx/dc are differences of inversions of bent paths, several
splines in one where their responses do not meet: they know of springs, dampers and zero dynamics what the model knows.
Friction is no straight line: it is added to the other torques at the speeds that the step leads to. The bent path is
inverted again, and what the program missed is corrected by the next one, from the new motion.

Source: B. Stellato et al., Mathematical Programming Computation 12, 2020 (OSQP); J. Nocedal, S. Wright, Numerical
Optimization, 2006, ch. 18 (sequential quadratic programming).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import osqp
import scipy.sparse as sp

from flexgen.errors import SolverError
from flexgen.inversion.bounds import Limits
from flexgen.inversion.method_result import MethodResult
from flexgen.inversion.path_deviation import SUPPORT, DeviationBasis, bent
from flexgen.inversion.problem import DECAY, SETTLE, InversionProblem
from flexgen.inversion.reduced_problem import Reduction
from flexgen.inversion.sampling import from_library
from flexgen.inversion.status import Status
from flexgen.mechanics.equations import Equations
from flexgen.mechanics.statics import reach
from flexgen.numerics.evaluate import evaluate
from flexgen.runtime.library import Library
from flexgen.runtime.path_inversion import Inversion

KNOTS = 30  # intervals between knots on the path
PER_KNOT = 2  # intervals of the mesh between knots, at least
LATE = 0.5  # of the path's duration: how long after it the motion may end
CHORDS = 6  # programs until the friction is that of the speeds they lead to
ROUNDS = 8  # programs, each followed by an inversion
SLACK = 1e-3  # of a bound: what is left of violations between its corrections
MARGIN = 2e-4  # of a bound: what the programs keep away from it
FADING = 5.0  # time constants of the zero dynamics until a response is thought to be over
PUSH = 1.0  # m/s^2, rad/s^2: of the bends whose responses are measured
SMOOTH = 100.0  # rho, relative: what a wave of the shortest length that the knots carry costs beside its size
CLOSE = 1e-5  # what OSQP may leave of violations and of its gradient
PER_SPLINE = 3  # rows in the program between two knots, and peaks
PRICE = 1e5  # of passing all bounds by their own size, where 1 mm costs one
PROGRAM_STEPS = 10_000
SEEN = 0.7  # of a bound: rows whose values stay below after the last step are not in the program
SETTLED = 1e-2  # of the bend: programs that change it by less have found it
POOR = 0.3  # of a violation: where more is left after a step the slopes are measured again
HOPELESS = 0.9  # where that does not help either
LEAST_SHARE = 0.2  # of a step
ROUGH = 100.0  # times the tolerance of the exact inversion: bends are rougher than paths, and slopes need few digits
NOTICED = 1e-6  # m and rad: a tool that is farther from its path is kept off it by the limits


@dataclass(frozen=True)
class _Horizon:
    """The path with room before and after it: sampled, and how it is inverted."""

    library: Library
    path: tuple[np.ndarray, np.ndarray, np.ndarray]
    period: float
    before: int
    lead: int
    tail: int
    every: int
    q_start: np.ndarray
    tolerance: float
    bends: DeviationBasis

    def invert(self, c: np.ndarray) -> Inversion:
        """The inversion of the path that is bent by the coefficients ``c`` (count, n_y)."""
        place, rate, rate2 = bent(*self.path, tuple(self.bends.along(c, k) for k in range(3)))  # type: ignore[arg-type]
        return self.library.invert(
            *(np.ascontiguousarray(x) for x in (place, rate, rate2)),
            period=self.period,
            q_start=self.q_start,
            n_pre=self.lead,
            n_post=self.tail,
            samples_per_interval=self.every,
            tolerance=self.tolerance,
        )


class _Bounds:
    """What is bounded: motor torques, motor speeds and deflections, as numbers that shall stay between -1 and 1.

    Friction that changes its sign with the speed is no straight line. So the torques are followed without it, as what
    bends change nearly in proportion, and it is added where the speeds are known.
    """

    def __init__(self, equations: Equations, limits: Limits) -> None:
        model = equations.model
        self.equations, self.n_m, self.i_e = equations, model.n_m, list(model.i_e)
        self.torque, self.speed = limits.arrays(model.n_m)
        self.bend = limits.deflections(model.n_e)
        self.size = np.r_[self.torque, self.speed, self.bend]
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
        """Slopes (n, n_m) of the friction between the speeds of two motions."""
        v, to = (x[:, self.n_m : 2 * self.n_m] for x in (before, after))
        least = 1e-4 * (1.0 + np.abs(v).max())
        apart = np.where(np.abs(to - v) < least, least, to - v)
        return (self.friction(v + apart) - self.friction(v)) / apart

    def refuse_rest(self, problem: InversionProblem) -> None:
        """SolverError where the arm cannot be held at an end of the path."""
        model, path = problem.equations.model, problem.path
        reduction = Reduction(problem.equations)
        for t, guess in ((0.0, path.q_start), (path.duration, None)):
            if guess is None:
                ends = np.linspace(0.0, path.duration, 65)
                guess = reduction.follow(path, ends, reduction.start(path).q_a)[-1]
            rest = reduction.rest(path, t, guess)
            for j, motor in enumerate(model.motors):
                if not abs(rest.tau_m[j]) <= self.torque[j]:
                    raise SolverError(
                        f"limits: motor {motor.name} needs {abs(rest.tau_m[j]):.4g} N m to hold the arm at rest at the "
                        f"ends of the path, its limit is {self.torque[j]:.4g} N m"
                    )
            for i, bound in zip(model.i_e, self.bend, strict=True):
                if not abs(rest.q_a[i]) <= bound:
                    raise SolverError(
                        f"limits: coordinate {model.coordinates[i].name} is deflected by {abs(rest.q_a[i]):.4g} at "
                        f"rest at the ends of the path, its limit is {bound:.4g}"
                    )


def enforce_limits(
    problem: InversionProblem, exact: Inversion, library: Library, every: int, tolerance: float
) -> MethodResult:
    """The answer that keeps the limits: the exact one, where they are wide enough, else that of a bent path.

    Parameters
    ----------
    problem : InversionProblem
        With limits.
    exact : Inversion
        Of the path itself.
    library : Library
        Of the model.
    every, tolerance : int, float
        How the paths are inverted, see `flexgen.runtime.path_inversion.Inverter`.

    Raises
    ------
    SolverError
        Where the limits cannot be kept: at rest, or within the time that the motion has.
    """
    assert problem.limits is not None
    bounds = _Bounds(problem.equations, problem.limits)
    if not bounds.any or np.abs(bounds.values(bounds.followed(exact))).max() <= 1.0:
        return from_library(exact)
    bounds.refuse_rest(problem)
    horizon = _horizon(problem, exact, library, every, tolerance)
    c, found, rounds = _bent_until_kept(problem, horizon, bounds)
    answer = from_library(found)
    off = horizon.bends.along(c)
    n_p = 3 if horizon.path[0].shape[1] > off.shape[1] else off.shape[1]
    metres = float(np.linalg.norm(off[:, :n_p], axis=1).max())
    angle = float(np.linalg.norm(off[:, n_p:], axis=1).max())
    told = f"{metres:.3g} m" + (f" and {angle:.3g} rad" if n_p < off.shape[1] else "")
    return replace(
        answer,
        t=answer.t - horizon.before * horizon.period,
        preactuation=(horizon.before + horizon.lead) * horizon.period,
        status=Status.LIMITS_ACTIVE if max(metres, angle) > NOTICED else Status.SOLVED,
        verdict=f"the limits bend the path by up to {told}, found in {rounds} quadratic programs",
        details={**answer.details, "bend_max_m": metres, "bend_max_rad": angle, "programs": rounds},
    )


def _horizon(problem: InversionProblem, exact: Inversion, library: Library, every: int, tolerance: float) -> _Horizon:
    """The path with room for bends before it and after it."""
    path, period, duration = problem.path, exact.period, problem.path.duration
    lead, tail = exact.n_pre, exact.n_post
    spacing = max(duration / KNOTS, PER_KNOT * every * period)
    before = int(np.ceil((problem.windows[0] + SUPPORT * spacing) / period))
    after = int(np.ceil((LATE * duration + SUPPORT * spacing) / period))
    steps = round(duration / period)
    t = (np.arange(before + steps + after + 1) - before) * period
    sample = path.sample(t)
    samples = (Reduction(problem.equations).targets(sample), sample.rates(1), sample.rates(2))
    count = int((t[-1] - t[0]) / spacing + 1e-9) - SUPPORT + 1
    bends = DeviationBasis(t, t[0], spacing, count)
    return _Horizon(library, samples, period, before, lead, tail, every, path.q_start, ROUGH * tolerance, bends)


def _bent_until_kept(
    problem: InversionProblem, horizon: _Horizon, bounds: _Bounds
) -> tuple[np.ndarray, Inversion, int]:
    """Coefficients of the bends, the inversion of the bent path, and how many programs that took."""
    bends, n_y = horizon.bends, horizon.path[1].shape[1]
    c = np.zeros((bends.count, n_y))
    found = horizon.invert(c)
    followed = bounds.followed(found)
    slopes, fresh = _slopes(problem, horizon, bounds, c, followed), True
    worst = float(np.abs(bounds.values(followed)).max()) - 1.0
    for round_ in range(1, ROUNDS + 1):
        step = _step(problem, horizon, bounds, c, followed, slopes)
        share = 1.0
        while True:
            trial = horizon.invert(c + share * step)
            at = bounds.followed(trial)
            over = float(np.abs(bounds.values(at)).max()) - 1.0
            if over <= max(worst, SLACK) or share < LEAST_SHARE:
                break
            share /= 2
        c, found, followed = c + share * step, trial, at
        problem.tell(f"limits: program {round_}: bounds kept but for {max(over, 0.0):.1e} of them")
        settled = np.abs(step).max() <= SETTLED * np.abs(c).max() + NOTICED
        if over <= SLACK and (settled or worst <= SLACK):
            return c, found, round_
        if over > POOR * worst and over > SLACK:
            if fresh and over > HOPELESS * worst:
                worst = over
                break
            slopes, fresh = _slopes(problem, horizon, bounds, c, followed), True
        else:
            fresh = False
        worst = over
    if worst <= SLACK:
        return c, found, ROUNDS
    late = horizon.bends.t[-1] - problem.path.duration
    raise SolverError(
        f"limits: found no bend of the path, with a motion that ends {late:.3g} s after it, that keeps them: a bound "
        f"is still passed by {worst:.2g} of its value; give the move more time or loosen the limits"
    )


def _slopes(
    problem: InversionProblem, horizon: _Horizon, bounds: _Bounds, c: np.ndarray, followed: np.ndarray
) -> sp.csr_matrix:
    """What a unit of each coefficient changes in what is followed, (n bounds, count n_y), sparse."""
    problem.tell("limits: measuring what bends of the path change")
    bends, n_y = horizon.bends, c.shape[1]
    n, b = followed.shape
    lead, settle = problem.windows
    ahead, behind = FADING / DECAY * lead, FADING / SETTLE * settle
    half = SUPPORT / 2 * bends.spacing
    apart = min(bends.count, int(np.ceil((2 * half + ahead + behind) / bends.spacing)))
    times = (np.arange(n) - horizon.lead - horizon.before) * horizon.period
    push = PUSH * bends.spacing**2
    rows, columns, entries = [], [], []
    reaches = [
        (np.searchsorted(times, m - half - ahead), np.searchsorted(times, m + half + behind, side="right"))
        for m in bends.middles
    ]
    for j in range(n_y):
        for colour in range(apart):
            pushed = c.copy()
            pushed[colour::apart, j] += push
            change = (bounds.followed(horizon.invert(pushed)) - followed) / push
            for i in range(colour, bends.count, apart):
                begin, end = reaches[i]
                part = change[begin:end].ravel()
                rows.append(np.arange(begin * b, end * b))
                columns.append(np.full(part.size, i * n_y + j))
                entries.append(part)
    return sp.csr_matrix(
        (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))), shape=(n * b, bends.count * n_y)
    )


def _step(
    problem: InversionProblem,
    horizon: _Horizon,
    bounds: _Bounds,
    c: np.ndarray,
    followed: np.ndarray,
    slopes: sp.csr_matrix,
) -> np.ndarray:
    """The step (count, n_y) that keeps the bounds as far as the slopes tell, with the friction that it leads to."""
    n_m, b = bounds.n_m, followed.shape[1]
    rows = np.arange(followed.size).reshape(followed.shape)
    after, best, least = followed, np.zeros_like(c), np.inf
    for _ in range(CHORDS):
        friction = np.zeros(followed.shape)
        friction[:, :n_m] = bounds.chords(followed, after)
        speeds = np.zeros(followed.shape, dtype=int)
        speeds[:, :n_m] = rows[:, n_m : 2 * n_m]
        A = slopes + sp.diags(friction.ravel()) @ slopes[speeds.ravel()]
        A = sp.diags(np.tile(1.0 / bounds.size, len(followed))) @ A
        step = _program(problem, horizon, c, bounds.values(followed), A.tocsr())
        after = followed + (slopes @ step.ravel()).reshape(-1, b)
        over = float(np.abs(bounds.values(after)).max()) - 1.0
        if over < least:
            best, least = step, over
        if over <= SLACK / 2:
            break
    return best


def _program(
    problem: InversionProblem, horizon: _Horizon, c: np.ndarray, values: np.ndarray, slopes: sp.csr_matrix
) -> np.ndarray:
    """The step (count, n_y) of the quadratic program for values with these slopes."""
    bends, (count, n_y) = horizon.bends, c.shape
    unit = 1e-3 * min(1.0, reach(problem.equations))
    values_of, wave = bends.basis[0], (bends.spacing / np.pi) ** 4 * bends.basis[4]
    gram = (values_of.T @ values_of + SMOOTH * wave.T @ wave) / len(values_of)
    gram *= count  # a coefficient of one costs about one
    H = sp.kron(sp.csc_matrix(gram), sp.eye(n_y), format="csc")
    x, A = values.ravel(), slopes * unit
    gradient = H @ (c.ravel() / unit)
    grid = np.zeros(values.shape, dtype=bool)
    grid[:: max(1, int(bends.spacing / horizon.period / PER_SPLINE))] = True
    seen = (np.abs(x) > SEEN) & (grid | _peaks(values)).ravel()
    while True:  # most rows never matter: those that a step would break come in with the next try
        step, over = _solved(H, gradient, A[seen], x[seen])
        at = x + A @ step
        broken = (np.abs(at) > 1.0 + over) & _peaks(at.reshape(values.shape)).ravel() & ~seen
        if not broken.any():
            return step.reshape(count, n_y) * unit
        seen |= broken


def _solved(H: sp.csc_matrix, gradient: np.ndarray, A: sp.csr_matrix, x: np.ndarray) -> tuple[np.ndarray, float]:
    """Step d of ``min d H d / 2 + gradient d`` with ``|x + A d| <= 1``; or ``1 + s`` with the least s, and that s."""
    room = 1.0 - MARGIN
    try:
        return _osqp(H, gradient, A.tocsc(), -room - x, room - x), 0.0
    except SolverError:  # no step keeps them all: one more unknown, by how much they are passed, as small as can be
        extra = sp.csr_matrix(np.ones((len(x), 1)))
        rows = sp.bmat([[A, extra], [A, -extra], [None, sp.csr_matrix([[1.0]])]], format="csc")
        free = np.full(len(x), np.inf)
        found = _osqp(
            sp.block_diag([H, sp.csc_matrix([[PRICE]])], format="csc"),
            np.r_[gradient, PRICE],
            rows,
            np.r_[-room - x, -free, 0.0],
            np.r_[free, room - x, np.inf],
        )
        return found[:-1], max(float(found[-1]), 0.0)


def _osqp(H: sp.csc_matrix, gradient: np.ndarray, A: sp.csc_matrix, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """``min x H x / 2 + gradient x`` with ``low <= A x <= high``; SolverError where OSQP finds none."""
    solver = osqp.OSQP()
    solver.setup(
        sp.triu(H, format="csc"),
        gradient,
        A,
        low,
        high,
        verbose=False,
        eps_abs=CLOSE,
        eps_rel=CLOSE,
        max_iter=PROGRAM_STEPS,
        polishing=True,
        check_dualgap=False,
    )
    result = solver.solve(raise_error=False)
    if result.info.status not in ("solved", "solved inaccurate") or not np.isfinite(result.x).all():
        raise SolverError(
            f"limits: OSQP ended with {result.info.status!r}; give the move more time or loosen the limits"
        )
    return result.x


def _peaks(values: np.ndarray) -> np.ndarray:
    """Where |values| (n, m) are not less than the ones before and after, column by column."""
    size = np.abs(values)
    padded = np.pad(size, ((1, 1), (0, 0)))
    return (size >= padded[:-2]) & (size >= padded[2:])
