"""Quadratic programs of a sequence of samples whose first and second differences are bounded.

    min x'H x/2 + g'x,    |D_n x| <= b_n,    D_n: differences of order n = 1, 2

H is banded and positive definite. Solved by Mehrotra's interior point method. With D = (D_n/b_n),
the slacks s and the multipliers z of both sides, and W = z_u/s_u + z_l/s_l, a step solves

    [H  D'; D  -W^-1] (dx, dy) = (r, -W^-1 e)

The unknowns in the order of the samples give a banded matrix. The smaller one, H + D'W D, is worse:
W becomes so large that its sum with H loses H. First-order methods (OSQP) need thousands of steps
for second differences, since bounds of the acceleration are 1e-4 of the samples.

Source: S. Mehrotra, SIAM Journal on Optimization 2 (4), 1992.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dgbtrf, dgbtrs
from scipy.sparse import csc_matrix, csr_matrix, diags_array, vstack

DIFFERENCES = {1: [-1.0, 1.0], 2: [1.0, -2.0, 1.0]}
# 12 to 22 are usual.
STEPS = 60
# Complementarity relative to the largest entry of g, at which a search ends; 1e-15 leaves errors of
# 1e-7 of x.
ENDED = 1e-18
# Residual of the conditions of optimality, relative to the largest entry of g, of a solution; 1e-10
# is usual at most.
SOLVED = 1e-8
# Relative excess of a bound that stays: rounding of differences that are 1e-7 of the samples.
EXCESS = 5e-10
# Share of the step to the next bound.
TO_BOUNDARY = 0.995
# Upper bounds, lower bounds: rows of s and z.
SIDES = np.array([[1.0], [-1.0]])
_Solve = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


class _Program:
    """H, g and D, and the banded matrix of a step, without W."""

    def __init__(self, H: csc_matrix, g: np.ndarray, bounds: Mapping[int, np.ndarray]) -> None:
        k = len(g)
        scaled = [
            diags_array(1.0 / bound)
            @ diags_array(DIFFERENCES[n], offsets=range(n + 1), shape=(k - n, k))
            for n, bound in bounds.items()
        ]
        self.H = csr_matrix(H)
        self.g = np.asarray(g, float)
        self.D = csr_matrix(vstack(scaled))
        self.across = csr_matrix(self.D.T)
        self.scale = max(float(np.abs(self.g).max()), np.finfo(float).tiny)
        # a row of order n stands behind the middle of its samples
        middle = [np.arange(k - n) + 0.6 * n for n in bounds]
        order = np.argsort(np.concatenate([np.arange(k), *middle]), kind="stable")
        self.place = np.empty_like(order)
        self.place[order] = np.arange(len(order))
        entries = self.H.tocoo()
        links = self.D.tocoo()
        x, y = self.place[:k], self.place[k:]
        row = np.concatenate([x[entries.row], y[links.row], x[links.col]])
        column = np.concatenate([x[entries.col], x[links.col], y[links.row]])
        self.width = int(np.abs(row - column).max())
        self.bands = np.zeros((3 * self.width + 1, len(order)), order="F")
        self.bands[2 * self.width + row - column, column] = np.concatenate(
            [entries.data, links.data, links.data]
        )

    def factorize(self, W: np.ndarray) -> _Solve | None:
        """Solution (dx, dy) of the equations of a step, a function of both right sides."""
        k = len(self.g)
        bands = self.bands.copy(order="F")
        bands[2 * self.width, self.place[k:]] = -1.0 / W
        factors, pivots, failed = dgbtrf(bands, self.width, self.width, overwrite_ab=1)
        if failed:
            return None

        def solve(r: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            b = np.empty(len(self.place))
            b[self.place] = np.concatenate([r, e])
            found = dgbtrs(factors, self.width, self.width, b, pivots)[0][self.place]
            return found[:k], found[k:]

        return solve

    def gradient(self, x: np.ndarray, z: np.ndarray) -> np.ndarray:
        """H x + g + D'(z_u - z_l): zero at the solution."""
        return np.asarray(self.H @ x + self.g + self.across @ (z[0] - z[1]))


@dataclass
class _Point:
    """Samples, slacks and multipliers, or a step of them."""

    x: np.ndarray
    s: np.ndarray
    z: np.ndarray

    def move(self, step: _Point, share: float) -> _Point:
        """Along a step, as far as slacks and multipliers stay positive."""
        primal = min(share * _longest(self.s, step.s), 1.0)
        dual = min(share * _longest(self.z, step.z), 1.0)
        return _Point(self.x + primal * step.x, self.s + primal * step.s, self.z + dual * step.z)


def _longest(value: np.ndarray, step: np.ndarray) -> float:
    """Length of a step to the first zero of a value, infinite if there is none."""
    rate = float((-step / value).max())
    return 1.0 / rate if rate > 0.0 else np.inf


@dataclass
class _Equations:
    """Equations of a step at a point, factorized: gradient, residual of the slacks, solution."""

    at: _Point
    gradient: np.ndarray
    missing: np.ndarray
    W: np.ndarray
    solve: _Solve

    def step(self, p: _Program, goal: np.ndarray | float) -> _Point:
        """Step to s z = goal, to first order.

        z = goal/s loses all digits at an active bound, where s is small: there the multiplier
        follows from dy, and s from it.
        """
        s, z = self.at.s, self.at.z
        c = goal - s * z
        e = (c + z * self.missing) / s
        dx, dy = self.solve(-self.gradient, (e[1] - e[0]) / self.W)
        ds = -self.missing - SIDES * (p.D @ dx)
        dz = (c - z * ds) / s
        upper = z[0] * s[1] > z[1] * s[0]
        dz = np.array([np.where(upper, dy + dz[1], dz[0]), np.where(upper, dz[1], dz[0] - dy)])
        of_multiplier = (c - s * dz) / z
        return _Point(dx, np.where(np.array([upper, ~upper]), of_multiplier, ds), dz)


def _equations(p: _Program, at: _Point) -> _Equations | None:
    """Equations of a step, or None if they are singular."""
    W = (at.z / at.s).sum(axis=0)
    solve = p.factorize(W)
    if solve is None:
        return None
    missing = SIDES * (p.D @ at.x) + at.s - 1.0
    return _Equations(at, p.gradient(at.x, at.z), missing, W, solve)


def _search(p: _Program) -> _Point:
    """Mehrotra's predictor and corrector, until complementarity ends or a step has no result."""
    m = p.D.shape[0]
    at = _Point(np.zeros(len(p.g)), np.ones((2, m)), np.full((2, m), p.scale))
    for _ in range(STEPS):
        mu = float((at.s * at.z).mean())
        if mu < ENDED * p.scale:
            break
        equations = _equations(p, at)
        if equations is None:
            break
        guess = equations.step(p, 0.0)
        reached = at.move(guess, 1.0)
        center = mu * (float((reached.s * reached.z).mean()) / mu) ** 3
        found = at.move(equations.step(p, center - guess.s * guess.z), TO_BOUNDARY)
        if not all(np.isfinite(part).all() for part in (found.x, found.s, found.z)):
            break
        at = found
    return at


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
    at = _search(p)
    largest = float(np.abs(p.D @ at.x).max())
    x = at.x / largest if largest > 1.0 + EXCESS else at.x
    residual = np.abs(p.gradient(x, at.z)).max()
    complementarity = ((1.0 - SIDES * (p.D @ x)) * at.z).max()
    return x if max(residual, complementarity) < SOLVED * p.scale else None
