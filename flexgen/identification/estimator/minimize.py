"""Minimum of a problem of estimation: a trust region on the normal equations, within bounds.

The step s minimizes the quadratic model ``value + 2 g's + s'A s``, prior included, within a sphere
about x, from the eigenvalues of A; a number that would leave its bounds is set to the bound, and
the step of the others accounts for it. The sphere is that of the numbers themselves, which have
sizes near 1, as logarithms do, or that of their curvature, ``|D s|`` with ``D^2 = diag A``, for
numbers of different units.

Along a valley that bends, steps gain less than planned. From the first such step on, half the
acceleration is added,

    s_2 = -1/2 A^-1 J' W r'',      r'': second derivative of the residuals along s, by a difference

where it is small against s.

Source: J. Nocedal and S. Wright, Numerical Optimization, 2nd ed. 2006, ch. 4; M. Transtrum and J.
Sethna, arXiv:1201.5885 (acceleration along valleys).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flexgen.base.calls.deadline import best_known, check_time, is_over, keep_best
from flexgen.base.errors import SolverError
from flexgen.identification.estimator.problem import Linearization, Problem

# Radii of the sphere at first and at most, in the numbers, which mostly are logarithms: a factor
# of 1.6 and one of 20.
RADIUS = 0.5
LARGEST_RADIUS = 3.0
ITERATIONS = 100
# Distance to the minimum of the quadratic model, in standard deviations, where a search ends: far
# below what data tell.
DISTANCE_IN_SD = 1e-3
# Size of a step that is rounding, and of what is left to gain, as a part of the objective.
SMALL_STEP = 1e-9
SMALL_GAIN = 1e-9
# Standard deviations from the minimum of the quadratic model at which no step may lower the
# objective, and steps that are refused in a row there before a search ends: derivatives by
# differences are not more exact.
STUCK = 0.3
REFUSALS = 3
# Steps in a row that gain less than `Search.gain` before a search ends.
IDLE = 2
# Part of the planned gain from which on a step is taken; from and up to which the sphere grows and
# shrinks.
TAKEN = 1e-4
GOOD = 0.75
POOR = 0.25
# Mean square of residuals, with 1 for noise, from which on a model may be wrong; it is where so
# many steps gain less than this part: residuals that do not move any more.
WRONG = 10.0
FEW = 3
LITTLE = 0.006
# Part of a step over which its acceleration is measured, and the largest acceleration that is
# taken, as a part of the step.
PROBE = 0.1
BEND = 0.4
# Eigenvalues of a matrix over its largest one, below which they are rounding.
ROUNDING = 1e-14
# Relative error of the length of a step on the sphere.
ON_SPHERE = 0.05


@dataclass(frozen=True)
class Search:
    """Settings of a search.

    Parameters
    ----------
    distance : float
        It ends where the minimum of the quadratic model is nearer than this, in standard
        deviations.
    gain : float
        It ends where the quadratic model promises less than this part of the objective, or two
        steps in a row gain less.
    steps : int, optional
        At most; default: 100.
    count : int, optional
        Of the residuals: where their mean square exceeds 10, and steps gain little, the model is
        wrong, and the search ends.
    curvature : bool
        The sphere is that of the curvature, and the first one unlimited.
    refusals : int, optional
        It ends after so many refused steps in a row: where derivatives are not exact, shorter
        steps gain little.
    bends : bool
        Add accelerations; for problems that are stated by residuals.
    stage : str
        Name of the search in errors of time limits.
    tell : callable, optional
        Is given the number of each step and the problem there.
    """

    distance: float = DISTANCE_IN_SD
    gain: float = 0.0
    steps: int | None = None
    count: int | None = None
    curvature: bool = False
    refusals: int | None = None
    bends: bool = False
    stage: str = "identify"
    tell: Callable[[int, Linearization], None] | None = None


@dataclass(frozen=True)
class Minimum:
    """Result of a search.

    Parameters
    ----------
    x : array (n,)
    cost, objective : float
        Loss without and with the prior.
    A : array (n, n)
        J' W J, without the prior.
    iterations : int
    converged : bool
    at_bound : array (n,)
        Numbers that a bound holds.
    wrong : bool
        The model is wrong, see `Search`.
    """

    x: np.ndarray
    cost: float
    objective: float
    A: np.ndarray
    iterations: int
    converged: bool
    at_bound: np.ndarray
    wrong: bool = False


def minimize(problem: Problem, start: np.ndarray, search: Search | None = None) -> Minimum:
    """Minimize a problem from ``start`` (n,).

    Where the time of a fit is over, the result is the best step, with ``converged`` False.

    Raises
    ------
    SolverError
        The model has no solution at the start.

    Examples
    --------
    >>> import numpy as np
    >>> from flexgen.identification.estimator.minimize import minimize
    >>> from flexgen.identification.estimator.problem import Prior, Problem
    >>> free = np.full(2, np.inf)
    >>> valley = Problem(
    ...     lambda x: np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]),
    ...     lambda x: np.array([[-20 * x[0], 10.0], [-1.0, 0.0]]),
    ...     Prior.nothing(2),
    ...     (-free, free),
    ... )
    >>> print(minimize(valley, np.array([-1.2, 1.0])).x.round(4))
    [1. 1.]
    """
    chosen = Search() if search is None else search
    steps = ITERATIONS if chosen.steps is None else chosen.steps
    began = time.perf_counter()
    state = _State(problem, start, chosen)
    best_known(time.perf_counter() - began)
    with keep_best():
        for n in range(1, steps + 1):
            if is_over():
                break
            check_time(chosen.stage)
            state.iterations = n
            if chosen.tell is not None:
                chosen.tell(n, state.here)
            if state.take_step():
                break
    return state.minimum()


class _State:
    """A search: the problem where it is, and the sphere."""

    def __init__(self, problem: Problem, start: np.ndarray, search: Search) -> None:
        self.problem = problem
        self.search = search
        self.here = problem.linearize(np.clip(start, *problem.bounds))
        self.total = self.here.value + problem.prior.value(self.here.x)
        self.totals = [self.total]
        self.radius = np.inf if search.curvature else RADIUS
        self.largest = np.inf if search.curvature else LARGEST_RADIUS
        self.held = np.zeros(len(start), bool)
        self.size = np.zeros(len(start)) if search.curvature else np.ones(len(start))
        self.iterations = 0
        # steps in a row that were refused, and that gained little
        self.refused = 0
        self.idle = 0
        self.converged = False
        self.wrong = False
        # whether all steps gained what was planned; after one that did not, the way may bend
        self.straight = True

    def minimum(self) -> Minimum:
        """The result at the present x."""
        here = self.here
        return Minimum(
            here.x,
            here.value,
            self.total,
            here.matrix,
            self.iterations,
            self.converged,
            self.held,
            self.wrong,
        )

    def take_step(self) -> bool:
        """Try one step; whether the search has ended."""
        here = self.here
        prior = self.problem.prior
        lower, upper = self.problem.bounds
        slope = here.slope + prior.slope(here.x)
        matrix = here.matrix + prior.information
        self.held = ((here.x <= lower) & (slope > 0)) | ((here.x >= upper) & (slope < 0))
        free = ~self.held
        if not free.any():
            self.converged = True
            return True
        if self.search.curvature:
            # the largest so far: where one nearly vanishes on the way, steps would zigzag
            self.size = np.maximum(self.size, np.sqrt(np.diag(matrix)))
        size = np.where(self.size > 0.0, self.size, 1.0)
        model = _Quadratic(matrix, slope, size)
        step = model.step(free, self.radius, lower - here.x, upper - here.x)
        gain = model.gain(step)
        length = float(np.linalg.norm(size * step))
        left = model.left(free)
        enough = self.search.distance**2 + self.search.gain * self.total
        if left < enough or np.linalg.norm(step) < SMALL_STEP < self.radius:
            self.converged = True
            return True
        is_near = left < max(STUCK**2, SMALL_GAIN * self.total)
        most = self.search.refusals
        if most is not None and self.refused >= most:
            return True
        if self.radius < SMALL_STEP or (is_near and self.refused >= REFUSALS):
            # no step lowers the objective
            self.converged = is_near
            return True
        try:
            if self.search.bends and not self.straight:
                step = self._bend(model, step)
            # exactly at a bound where one is reached
            there = np.clip(here.x + step, lower, upper)
            new = here.cost(there)
        except SolverError:
            return self._refuse(length)
        before = here.value + prior.value(here.x)
        ratio = (before - new - prior.value(there)) / gain if gain > 0 else -1.0
        if not np.isfinite(ratio) or ratio < TAKEN:
            return self._refuse(length)
        little = before - new - prior.value(there) < self.search.gain * before
        self.idle = self.idle + 1 if little else 0
        return self._move(there, ratio, length)

    def _refuse(self, length: float) -> bool:
        """Stay, with a smaller sphere."""
        self.radius = length / 4
        self.straight = False
        self.refused += 1
        return False

    def _move(self, there: np.ndarray, ratio: float, length: float) -> bool:
        """Go to a point; whether the search has ended there."""
        # the sums first: a search that ends in them keeps the step before
        self.here = self.problem.linearize(there)
        self.total = self.here.value + self.problem.prior.value(there)
        self.totals.append(self.total)
        self.refused = 0
        self.straight = self.straight and ratio > GOOD
        if self._is_wrong():
            self.wrong = True
            return True
        if self.idle >= IDLE:
            self.converged = True
            return True
        if ratio > GOOD and length > 0.8 * self.radius:
            self.radius = min(2 * self.radius, self.largest)
        elif ratio < POOR:
            self.radius = length / 2
        return False

    def _is_wrong(self) -> bool:
        """Whether residuals are large, and the last steps gained little."""
        count = self.search.count
        totals = self.totals
        if count is None or self.here.value <= WRONG * count or len(totals) <= FEW:
            return False
        return totals[-1] > (1 - LITTLE) * totals[-1 - FEW]

    def _bend(self, model: _Quadratic, step: np.ndarray) -> np.ndarray:
        """The step with half the acceleration along it, where that is small."""
        moved = step != 0.0
        more = np.zeros(len(step))
        bend = bend_of(self.problem, self.here, step)[moved]
        more[moved] = -0.5 * np.linalg.solve(model.add_shift(moved), bend)
        small = np.linalg.norm(model.size * more) < BEND * np.linalg.norm(model.size * step)
        return step + more if small else step


def bend_of(problem: Problem, here: Linearization, step: np.ndarray) -> np.ndarray:
    """``J' W r''`` (n,), r'': second derivative of the residuals along a step, from a small part
    of it.

    Raises
    ------
    SolverError
        The model has no solution there.
    """
    there = here.roots * problem.residual(here.x + PROBE * step)
    change = (there - here.gaps) / PROBE
    return np.asarray(2.0 / PROBE * (change - here.rows @ step) @ here.rows)


class _Quadratic:
    """The quadratic model ``2 g's + s'A s``; ``size`` (n,): of the sphere
    ``|size s| <= radius``.
    """

    def __init__(self, matrix: np.ndarray, slope: np.ndarray, size: np.ndarray) -> None:
        self.matrix = matrix
        self.slope = slope
        self.size = size
        # what holds the last step on the sphere, added to A over the sizes
        self.shift = 0.0

    def gain(self, step: np.ndarray) -> float:
        """Decrease of the quadratic model by a step."""
        return -float(2 * self.slope @ step + step @ self.matrix @ step)

    def left(self, free: np.ndarray) -> float:
        """Decrease of the quadratic model at its minimum over the free numbers: the square of the
        distance in standard deviations.
        """
        inner = self.matrix[np.ix_(free, free)]
        size = self.size[free]
        slope = self.slope[free] / size
        scaled = inner / np.outer(size, size)
        return float(slope @ np.linalg.lstsq(scaled, slope, rcond=ROUNDING)[0])

    def add_shift(self, free: np.ndarray) -> np.ndarray:
        """The matrix of the free numbers plus the shift that kept the last step on the sphere."""
        inner = self.matrix[np.ix_(free, free)]
        return np.asarray(inner + np.diag(self.shift * self.size[free] ** 2))

    def step(
        self, free: np.ndarray, radius: float, least: np.ndarray, most: np.ndarray
    ) -> np.ndarray:
        """The minimum of the free numbers within the sphere and within ``least <= s <= most``."""
        step = np.zeros(len(self.slope))
        free = free.copy()
        while free.any():
            slope = self.slope[free] + self.matrix[np.ix_(free, ~free)] @ step[~free]
            size = self.size[free]
            inner = self.matrix[np.ix_(free, free)] / np.outer(size, size)
            step[free] = self._on_sphere(inner, slope / size, radius) / size
            leaving = free & ((step < least) | (step > most))
            if not leaving.any():
                break
            step[leaving] = np.clip(step, least, most)[leaving]
            free &= ~leaving
        return step

    def _on_sphere(self, A: np.ndarray, g: np.ndarray, radius: float) -> np.ndarray:
        """Minimum of ``2 g's + s'A s`` within ``|s| <= radius``."""
        values, vectors = np.linalg.eigh(A)
        values = np.maximum(values, ROUNDING * values[-1])
        along = vectors.T @ g
        step = -along / values
        self.shift = 0.0
        if np.linalg.norm(step) <= radius:
            return np.asarray(vectors @ step)
        low = 0.0
        high = float(np.linalg.norm(along)) / radius
        for _ in range(200):
            shift = (low * high) ** 0.5 if low > 0 else high * 1e-3
            step = -along / (values + shift)
            length = float(np.linalg.norm(step))
            if length > radius:
                low = shift
            else:
                high = shift
            self.shift = shift
            if abs(length - radius) < ON_SPHERE * radius or high - low < 1e-12 * high:
                break
            if low == 0.0 and high < 1e-300:
                break
        return np.asarray(vectors @ step)
