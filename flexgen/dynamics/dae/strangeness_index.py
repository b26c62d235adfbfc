"""Strangeness index and the numbers a, d, v of the inverse dynamics, from ranks of the derivative
array.

At a point of the derivative array F_mu = 0, with M = dF_mu/d(x', ..., x^(mu+1)) and N = dF_mu/dx,
of m equations for n unknowns:

    Z2' M = 0,   a = rank Z2' N,   T2 spans the null space of Z2' N,   d = rank F_x' T2
    v = corank [N M] of order mu less that of order mu - 1

The strangeness index is the smallest mu with ``a + d + v = m``: then a equations determine a
unknowns at each instant, d are differential equations, v are redundant, and ``n - a - d`` unknowns
are free.

Null spaces are not computed, since their rounding errors would blur the ranks behind them.
Eliminating M from the left shows that

    a = rank [N M] - rank M,      d = rank [N M; F_x' 0] - rank [N M]

where every entry is exact but for rounding. Each rank comes with the gap in the singular values
that it rests on; a rank without a clear gap is not accepted, and the verdict is "undecided".

Source: P. Kunkel, V. Mehrmann, Differential-Algebraic Equations, EMS 2006, section 4.3 (the
hypothesis).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.dae.signature import structural_index
from flexgen.dynamics.dae.system import InverseDae
from flexgen.dynamics.dae.taylor_array import (
    Scales,
    TaylorArray,
    choose_scales,
    consistent,
    derivative_array,
)
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.dynamics.mechanics.quasistatic import OutputPath
from flexgen.dynamics.mechanics.statics import Equilibrium, hold_joints
from flexgen.model.abilities import obstacle

ZERO = 1e-14  # of the largest: a singular value below it is zero; rounding leaves 1e-16
CLEAR = 1e-11  # of the largest: above it one is not zero; between the two nothing is decided
FLOOR = 2.2e-16  # rounding: lower bound of a singular value in a ratio
UNITS = (0.3, 0.1, 1.0)  # of time, in units of the springs' own
HIGHEST = 8  # strangeness index up to which is searched


@dataclass(frozen=True)
class Rank:
    """A rank and the singular values on either side of it, relative to the largest.

    ``below``: 0 where the rank is full. ``gap``: their ratio; ``decided``: whether none lies in
    between.
    """

    matrix: str
    rank: int
    above: float
    below: float
    gap: float
    decided: bool


def decide_rank(matrices: Sequence[np.ndarray], name: str = "") -> Rank:
    """The rank of a matrix that is given in several scalings of its rows and columns, entries near
    one.

    A singular value is nonzero if it is so in one scaling, and zero only if it is so in all.
    """
    best = Rank(name, 0, 1.0, 0.0, 1 / FLOOR, True)
    possible = 0
    for matrix in matrices:
        if not matrix.any():
            continue
        values = np.linalg.svd(matrix, compute_uv=False)
        relative = values / values[0]
        rank = int(np.sum(relative > CLEAR))
        possible = max(possible, int(np.sum(relative > ZERO)))
        below = float(relative[rank]) if rank < len(relative) else 0.0
        gap = float(relative[rank - 1]) / max(below, FLOOR)
        if rank > best.rank or (rank == best.rank and gap > best.gap):
            best = Rank(name, rank, float(relative[rank - 1]), below, gap, True)
    return replace(best, decided=possible == best.rank)


@dataclass(frozen=True)
class KunkelMehrmann:
    """Characteristic numbers of F(t, x, x') = 0 at one point.

    Parameters
    ----------
    verdict : str
        ``"regular"`` (as many equations as unknowns, none free, none void), ``"free"`` (some
        unknowns are not determined or some equations are redundant), ``"undecided"`` (a rank has
        no clear gap) or ``"not found"`` (up to the highest order tried).
    mu, a, d, v : int or None
        Strangeness index; numbers of algebraic, differential and void equations. None without a
        verdict.
    n, m : int
        Numbers of unknowns and of equations.
    ranks : tuple of Rank
        All decisions at that mu, or those of the order at which it failed.
    """

    verdict: str
    n: int
    m: int
    mu: int | None = None
    a: int | None = None
    d: int | None = None
    v: int | None = None
    ranks: tuple[Rank, ...] = field(default=(), repr=False)

    @property
    def differential_index(self) -> int | None:
        """mu + 1 with algebraic equations, else mu."""
        return None if self.mu is None else self.mu + 1 if self.a else self.mu

    @property
    def path_smoothness(self) -> int | None:
        """Number of continuous derivatives of the path that a continuous torque needs."""
        return None if self.differential_index is None else max(self.differential_index - 1, 0)

    @property
    def gap(self) -> float | None:
        """The smallest ratio of singular values that a rank rests on."""
        return min((rank.gap for rank in self.ranks), default=None)

    def to_dict(self) -> dict[str, Any]:
        """As JSON types."""
        weakest = min(self.ranks, key=lambda rank: rank.gap, default=None)
        return {
            "verdict": self.verdict,
            "unknowns": self.n,
            "equations": self.m,
            "mu": self.mu,
            "a": self.a,
            "d": self.d,
            "v": self.v,
            "differential_index": self.differential_index,
            "path_smoothness": self.path_smoothness,
            "gap": self.gap,
            "singular_value_above": weakest.above if weakest else None,
            "singular_value_below": weakest.below if weakest else None,
        }


def definitions(F_x: np.ndarray, F_dx: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Equations that only name a derivative, ``c x_j' + e x_k = 0`` with constants: their rows, j
    and k.

    ``F_x``, ``F_dx`` (K + 1, m, n): series of the Jacobians; constant where only the first term is
    not zero.
    """
    there = (F_x != 0).any(axis=0)
    slope = (F_dx != 0).any(axis=0)
    constant = ~(F_x[1:] != 0).any(axis=(0, 2)) & ~(F_dx[1:] != 0).any(axis=(0, 2))
    rows = np.flatnonzero(constant & (there.sum(axis=1) == 1) & (slope.sum(axis=1) == 1))
    y = np.argmax(slope[rows], axis=1)
    u = np.argmax(there[rows], axis=1)
    kept = ~np.isin(u, y)  # of a chain of them only the end
    return rows[kept], y[kept], u[kept]


def without_definitions(
    array: np.ndarray, m: int, n: int, named: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> np.ndarray:
    """A derivative array of m equations for n unknowns after an elimination with the equations
    that `definitions` found.

    Their rows go, and with each of them the column of a derivative: every rank that is asked for
    falls by the same number. About half of the rows remain.
    """
    rows, y, u = named
    out = array.copy()
    orders = len(array) // m
    for i in range(orders):
        place = i * m + rows
        pivot = (i + 1) * n + y
        other = i * n + u
        out[:, other] -= out[:, pivot] * (out[place, other] / out[place, pivot])
    gone = np.concatenate([i * m + rows for i in range(orders)])
    columns = np.concatenate([(i + 1) * n + y for i in range(orders)])
    return np.delete(np.delete(out, gone, axis=0), columns, axis=1)


def characterize(F_x: np.ndarray, F_dx: np.ndarray, scales: Scales) -> KunkelMehrmann:
    """The characteristic numbers mu, a, d, v of a DAE from the series of its Jacobians at a point,
    (K + 1, m, n) each; mu up to K.

    The first order of the derivative array is taken whose numbers of algebraic, differential and
    redundant equations add up to m. Ranks do not depend on the unit of time, but their gaps do:
    several are looked at.
    """
    m, n = F_x.shape[1:]
    units = [choose_scales(F_x[0], F_dx[0], scales.time * factor, scales.x) for factor in UNITS]
    named = definitions(F_x, F_dx)
    scaled = [F_dx[0] * unit.rows[:, None] * unit.x / unit.time for unit in units]
    void = 0
    ranks: tuple[Rank, ...] = ()
    for mu in range(len(F_x)):
        arrays = [
            without_definitions(derivative_array(F_x, F_dx, mu, unit), m, n, named)
            for unit in units
        ]
        # columns of x itself, then of its derivatives
        first = arrays[0].shape[1] - (mu + 1) * (n - len(named[0]))
        below = np.zeros((m, arrays[0].shape[1] - n))
        joined = [
            np.vstack([array, np.hstack([rate, below])])
            for array, rate in zip(arrays, scaled, strict=True)
        ]
        ranks = (
            decide_rank([array[:, first:] for array in arrays], f"M of order {mu}"),
            decide_rank(arrays, f"[N M] of order {mu}"),
            decide_rank(joined, f"[N M; F_x' 0] of order {mu}"),
        )
        if not all(rank.decided for rank in ranks):
            return KunkelMehrmann("undecided", n, m, ranks=ranks)
        higher, whole, both = (rank.rank for rank in ranks)
        corank = len(arrays[0]) - whole
        a = whole - higher
        d = both - whole
        v = corank - void
        void = corank
        if a + d + v == m:
            verdict = "regular" if v == 0 and a + d == n else "free"
            return KunkelMehrmann(verdict, n, m, mu, a, d, v, ranks)
    return KunkelMehrmann("not found", n, m, ranks=ranks)


def kunkel_mehrmann_at_rest(
    equations: Equations, rest: Equilibrium | None = None, highest: int = HIGHEST
) -> KunkelMehrmann:
    """The characteristic numbers of a model's inverse dynamics at rest, a point of the derivative
    array of any order.

    Parameters
    ----------
    equations : Equations
    rest : Equilibrium, optional
        Default: at the model's home pose.
    highest : int
        Strangeness index up to which is searched.
    """
    dae = InverseDae(equations)
    series = TaylorArray(dae)
    x = np.zeros((1, highest + 2, dae.n_x))
    x[0, 0] = dae.pack(rest or hold_joints(equations, np.array(equations.model.home)))
    F_x, F_dx = series.jacobians(x)
    return characterize(F_x[0], F_dx[0], series.scales(x[0, 0]))


def kunkel_mehrmann(
    equations: Equations,
    reference: OutputPath,
    times: Sequence[float] | None = None,
    highest: int = HIGHEST,
) -> tuple[KunkelMehrmann, ...]:
    """The characteristic numbers at points along a solution of the inverse dynamics.

    Parameters
    ----------
    equations : Equations
    reference : OutputPath
        The path, with derivatives; those that it does not know count as zero.
    times : sequence of k numbers [s], optional
        Rising instants; default: 0.23, 0.53 and 0.81 of the path.
    highest : int
        Strangeness index up to which is searched.

    Returns
    -------
    tuple of k KunkelMehrmann

    Raises
    ------
    ArgumentError
        Instants that do not rise.
    SolverError
        No consistent point was found.
    """
    instants = (
        np.array([0.23, 0.53, 0.81]) * reference.duration
        if times is None
        else np.asarray(times, dtype=float)
    )
    if (
        instants.ndim != 1
        or not len(instants)
        or not np.isfinite(instants).all()
        or (np.diff(instants) <= 0).any()
    ):
        raise ArgumentError(f"times: given {times!r}, expected rising instants in s")
    series = TaylorArray(InverseDae(equations))
    order = min(highest, structural_index(equations).index or 4)
    while True:
        x, scales = consistent(series, reference, instants, order)
        F_x, F_dx = series.jacobians(x)
        found = tuple(characterize(F_x[k], F_dx[k], scales[k]) for k in range(len(instants)))
        if order == highest or not any(result.verdict == "not found" for result in found):
            return found
        order += 1


def rule(equations: Equations) -> tuple[int, int, int] | None:
    """Strangeness index, a and d expected from the kinds of gears alone, at regular poses.

    A damped gear adds 4 to a and 1 to d (its deflection is a state), an undamped one adds 5 and a
    rigid one 3 to a; a non-actuated coordinate adds 2 to d. The strangeness index is 4 with
    undamped gears, else 3 with damped ones, else 2. Where the inertia A of the zero dynamics is
    singular some of the ``2 n_e`` motions are missing: d is always the number of finite zeros, and
    ``a = n - d``.

    None for complete motor coupling, and where outputs and motors differ in number.
    """
    model = equations.model
    parts = ("reduced problem", "simplified coupling")
    if any(obstacle(model, part) is not None for part in parts):
        return None
    kinds = [gear for gear, _ in gears(model)]
    rigid = sum(gear.rigid for gear in kinds)
    damped = sum(not gear.rigid and gear.damping > 0 for gear in kinds)
    undamped = len(kinds) - rigid - damped
    mu = 4 if undamped else 3 if damped else 2
    return mu, 4 * damped + 5 * undamped + 3 * rigid, damped + 2 * model.n_e
