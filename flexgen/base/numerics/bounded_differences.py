"""Quadratic programs of a sequence of samples whose first and second differences are bounded.

    min x'H x/2 + g'x,    |D_n x| <= b_n,    D_n: differences of order n = 1, 2

H is banded and positive definite. Solved by Mehrotra's interior point method. With D = (D_n/b_n),
the slacks s and the multipliers z of both sides, and W = z_u/s_u + z_l/s_l, a step solves

    [H  D'; D  -W^-1] (dx, dy) = (r, W^-1 e)

dy = W D dx - e removes a row: H + D'W D and r + D'e remain. Rows near their bounds have a W so
large that this sum loses H. They stay unknowns, each between its samples: the matrix is banded.
First-order methods (OSQP) need thousands of steps for second differences, since bounds of the
acceleration are 1e-4 of the samples.

Source: S. Mehrotra, SIAM Journal on Optimization 2 (4), 1992.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dsbmv
from scipy.linalg.lapack import dgbtrf, dgbtrs, dpbtrf, dpbtrs
from scipy.sparse import csc_matrix

DIFFERENCES = {1: [-1.0, 1.0], 2: [1.0, -2.0, 1.0]}
# 9 to 16 are usual.
STEPS = 60
# Multipliers at the start relative to the largest entry of g: 1 takes 8 % more steps, 1e-4 in some
# programs twice as many.
START = 0.01
# Complementarity relative to the largest entry of g, at which a search ends; 1e-15 leaves errors
# of 1e-7 of x.
ENDED = 1e-18
# Residual of the conditions of optimality, relative to the largest entry of g, of a solution;
# 1e-10 is usual at most.
SOLVED = 1e-8
# Relative excess of a bound that stays: rounding of differences that are 1e-7 of the samples.
EXCESS = 5e-10
# Share of the step to the next bound, at least. It approaches 1 with the complementarity, since a
# fixed one makes the last steps linear: 15 % more of them.
TO_BOUNDARY = 0.995
# Distance of that share from 1 over the complementarity, relative to the largest entry of g.
APPROACH = 100.0
# Least distance: rounding of a slack does not reach it.
CLOSEST = 1e-10
# Weight of a row, relative to the smallest diagonal entry of H, from which it stays an unknown: in
# a sum with a smaller one H keeps 4 of its 16 digits, enough for a step.
HEAVY = 1e12
# (dx, D dx, dy) from the right sides (r, e) of a step
_Solve = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
# (dx, dy of the rows that stay unknowns) from the right sides of both
_Inner = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


class _Program:
    """H as bands below its diagonal, g, D as differences and the inverse of their bounds."""

    def __init__(self, H: csc_matrix, g: np.ndarray, bounds: Mapping[int, np.ndarray]) -> None:
        k = len(g)
        self.g = np.asarray(g, float)
        self.scale = max(float(np.abs(self.g).max()), np.finfo(float).tiny)
        entries = H.tocoo()
        own = int(np.abs(entries.row - entries.col).max(initial=0))
        self.H = np.zeros((own + 1, k), order="F")
        for d in range(own + 1):
            self.H[d, : k - d] = H.diagonal(-d)
        # the bands of H + D'W D
        self.width = max(own, *bounds)
        self.heavy = HEAVY * float(self.H[0].min())
        self.inverse = 1.0 / np.concatenate(list(bounds.values()))
        self.rows: dict[int, slice] = {}
        middle = [np.arange(float(k))]
        begin = 0
        for n in bounds:
            self.rows[n] = slice(begin, begin + k - n)
            begin += k - n
            # a row of order n stands behind the middle of its samples
            middle.append(np.arange(k - n) + 0.6 * n)
        order = np.argsort(np.concatenate(middle), kind="stable")
        self.place = np.empty_like(order)
        self.place[order] = np.arange(len(order))

    def differences(self, x: np.ndarray) -> np.ndarray:
        """Differences relative to their bounds, D x."""
        found = np.empty(len(self.inverse))
        first = x[1:] - x[:-1]
        if 1 in self.rows:
            found[self.rows[1]] = first
        if 2 in self.rows:
            found[self.rows[2]] = first[1:] - first[:-1]
        found *= self.inverse
        return found

    def across(self, y: np.ndarray) -> np.ndarray:
        """Forces of multipliers on the samples, D'y."""
        scaled = y * self.inverse
        found = np.zeros(len(self.g))
        for n, rows in self.rows.items():
            own = scaled[rows]
            for i, c in enumerate(DIFFERENCES[n]):
                found[i : i + len(own)] += c * own
        return found

    def gradient(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """H x + g + D'y: zero at the solution."""
        own = dsbmv(len(self.H) - 1, 1.0, self.H, x, lower=1)
        return np.asarray(own + self.g + self.across(y))

    def bands(self, weight: np.ndarray) -> np.ndarray:
        """Bands below the diagonal of H + D_n' weight D_n."""
        found = np.zeros((self.width + 1, len(self.g)), order="F")
        found[: len(self.H)] = self.H
        for n, rows in self.rows.items():
            own = weight[rows]
            for i, first in enumerate(DIFFERENCES[n]):
                for j, second in enumerate(DIFFERENCES[n][: i + 1]):
                    found[i - j, j : j + len(own)] += (first * second) * own
        return found


def _factorize(p: _Program, W: np.ndarray) -> _Solve | None:
    """The function that solves the equations of a step with the weights W (m,) of the rows, or
    None if they are singular.

    Rows with a large weight are kept as unknowns, which keeps the matrix well-conditioned; the
    others are eliminated.
    """
    weight = W * p.inverse**2
    kept = np.flatnonzero(weight > p.heavy)
    weight[kept] = 0.0
    bands = p.bands(weight)
    inner = _indefinite(p, bands, kept, W[kept]) if kept.size else _positive(bands)
    if inner is None:
        return None

    def solve(r: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Change of the samples (k,), of their differences (m,) and of the multipliers (m,), for
        the residuals ``r`` (k,) of the gradient and ``e`` (m,) of the rows.
        """
        removed = e
        if kept.size:
            removed = e.copy()
            removed[kept] = 0.0
        dx, of_kept = inner(r + p.across(removed), e[kept])
        slope = p.differences(dx)
        dy = W * slope - e
        dy[kept] = of_kept
        return dx, slope, dy

    return solve


def _positive(bands: np.ndarray) -> _Inner | None:
    """Solution with no row kept."""
    factors, failed = dpbtrf(bands, lower=1, overwrite_ab=1)
    if failed:
        return None
    return lambda r, e: (dpbtrs(factors, r, lower=1, overwrite_b=1)[0], e)


def _indefinite(p: _Program, bands: np.ndarray, kept: np.ndarray, W: np.ndarray) -> _Inner | None:
    """The function that solves for the samples and for the rows ``kept``, by a banded LU
    decomposition in which each row stands between its samples; None if it is singular.

    ``bands``: lower bands of ``H + D'W D`` of the other rows; ``W``: weights of the kept ones.
    """
    k = len(p.g)
    there = np.zeros(len(p.place), dtype=int)
    there[p.place[:k]] = 1
    there[p.place[k + kept]] = 1
    order = np.cumsum(there) - 1
    x = order[p.place[:k]]
    y = order[p.place[k + kept]]
    # a row stands between its samples, whose distance is at most that of the samples that
    # H + D'W D couples
    span = min(p.width, k - 1)
    width = int((x[span:] - x[: k - span]).max())
    matrix = np.zeros((k + len(kept), 3 * width + 1))
    # LAPACK's entry of row i and column j is entries[i + column_x or column_y of j]
    entries = matrix.reshape(-1)
    column_x = 3 * width * x + 2 * width
    column_y = 3 * width * y + 2 * width
    entries[x + column_x] = bands[0]
    for d in range(1, len(bands)):
        band = bands[d, : k - d]
        entries[x[d:] + column_x[: k - d]] = band
        entries[x[: k - d] + column_x[d:]] = band
    inverse = p.inverse[kept]
    for n, rows in p.rows.items():
        own = slice(*np.searchsorted(kept, [rows.start, rows.stop]))
        row = y[own]
        for i, c in enumerate(DIFFERENCES[n]):
            sample = kept[own] - rows.start + i
            values = c * inverse[own]
            entries[row + column_x[sample]] = values
            entries[x[sample] + column_y[own]] = values
    entries[y + column_y] = -1.0 / W
    factors, pivots, failed = dgbtrf(matrix.T, width, width, overwrite_ab=1)
    if failed:
        return None

    def solve(r: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Samples (k,) and multipliers of the kept rows, for right-hand sides ``r`` (k,) and
        ``e``.
        """
        b = np.empty(len(matrix))
        b[x] = r
        b[y] = e / W
        found = dgbtrs(factors, width, width, b, pivots, overwrite_b=1)[0]
        return found[x], found[y]

    return solve


@dataclass
class _Point:
    """Samples, slacks and multipliers of both bounds, or a step of them.

    Rows of slacks and multipliers: the bound that is closer to be active, the other one.
    """

    x: np.ndarray
    s: np.ndarray
    z: np.ndarray

    def move(self, step: _Point, share: float) -> _Point:
        """Along a step, as far as slacks and multipliers stay positive."""
        primal = min(share * _longest(self.s, step.s), 1.0)
        dual = min(share * _longest(self.z, step.z), 1.0)
        return _Point(self.x + primal * step.x, self.s + primal * step.s, self.z + dual * step.z)

    @property
    def complementarity(self) -> float:
        """Mean of s z."""
        return float(np.vdot(self.s, self.z)) / self.s.size


def _longest(value: np.ndarray, step: np.ndarray) -> float:
    """Length of a step to the first zero of a value, infinite if there is none."""
    rate = float((step / value).min())
    return -1.0 / rate if rate < 0.0 else np.inf


def _closer_first(at: _Point, side: np.ndarray) -> None:
    """Exchange the bounds, in place, where the second one has become closer; side: 1 for upper."""
    other = np.flatnonzero(at.z[0] * at.s[1] < at.z[1] * at.s[0])
    if other.size:
        at.s[:, other] = at.s[::-1, other]
        at.z[:, other] = at.z[::-1, other]
        side[other] *= -1.0


@dataclass
class _Equations:
    """Equations of a step at a point, factorized: gradient, residual of the slacks, solution."""

    at: _Point
    side: np.ndarray
    gradient: np.ndarray
    missing: np.ndarray
    solve: _Solve

    def step(self, goal: np.ndarray | float) -> _Point:
        """Step to s z = goal, to first order.

        z = goal/s loses all digits at an active bound, where s is small: there the multiplier
        follows from dy, and s from it.
        """
        s = self.at.s
        z = self.at.z
        c = goal - s * z
        e = (c + z * self.missing) / s
        dx, slope, dy = self.solve(-self.gradient, self.side * (e[1] - e[0]))
        ds = np.empty_like(s)
        dz = np.empty_like(z)
        ds[1] = self.side * slope - self.missing[1]
        dz[1] = (c[1] - z[1] * ds[1]) / s[1]
        dz[0] = dz[1] + self.side * dy
        ds[0] = (c[0] - s[0] * dz[0]) / z[0]
        return _Point(dx, ds, dz)


def _equations(p: _Program, at: _Point, side: np.ndarray) -> _Equations | None:
    """Equations of a step, or None if they are singular."""
    ratio = at.z / at.s
    solve = _factorize(p, ratio[0] + ratio[1])
    if solve is None:
        return None
    slope = side * p.differences(at.x)
    missing = at.s - 1.0
    missing[0] += slope
    missing[1] -= slope
    return _Equations(at, side, p.gradient(at.x, side * (at.z[0] - at.z[1])), missing, solve)


def _search(p: _Program) -> tuple[_Point, np.ndarray]:
    """Mehrotra's predictor and corrector, until complementarity ends or a step has no result."""
    m = len(p.inverse)
    at = _Point(np.zeros(len(p.g)), np.ones((2, m)), np.full((2, m), START * p.scale))
    side = np.ones(m)
    for _ in range(STEPS):
        mu = at.complementarity
        if mu < ENDED * p.scale:
            break
        _closer_first(at, side)
        equations = _equations(p, at, side)
        if equations is None:
            break
        guess = equations.step(0.0)
        center = mu * (at.move(guess, 1.0).complementarity / mu) ** 3
        share = max(TO_BOUNDARY, 1.0 - max(APPROACH * mu / p.scale, CLOSEST))
        found = at.move(equations.step(center - guess.s * guess.z), share)
        # a sample that is not finite makes its slack so
        if not np.isfinite(found.complementarity):
            break
        at = found
    return at, side


def solve_bounded_differences(
    H: csc_matrix, g: np.ndarray, bounds: Mapping[int, np.ndarray]
) -> np.ndarray | None:
    """Solution x (k,) of the program, or None if none was found.

    Parameters
    ----------
    H : sparse matrix (k, k)
        Symmetric, positive definite, banded.
    g : array (k,)
    bounds : mapping of 1 and 2 to arrays (k - n,)
        b_n > 0.

    Notes
    -----
    The bounds hold to ``EXCESS``: x = 0 keeps them, so that a factor removes more than that. The
    conditions of optimality of the result are checked: the residual of the gradient, and
    complementarity.
    """
    kept = {n: np.asarray(bound, float) for n, bound in bounds.items()}
    if not all(np.isfinite(b).all() and (b > 0.0).all() for b in kept.values()):
        return None
    p = _Program(H, g, kept)
    at, side = _search(p)
    largest = float(np.abs(p.differences(at.x)).max())
    x = at.x / largest if largest > 1.0 + EXCESS else at.x
    residual = np.abs(p.gradient(x, side * (at.z[0] - at.z[1]))).max()
    slope = side * p.differences(x)
    complementarity = (np.array([1.0 - slope, 1.0 + slope]) * at.z).max()
    return x if max(residual, complementarity) < SOLVED * p.scale else None
