"""Inverse dynamics by integration of the regularized DAE of Kunkel and Mehrmann: Radau IIA with
three stages.

    Z1' F(X_i, X_i', u_i) = 0,      F_mu(X_i, Y_i, U_i) = 0,
    X_i' = (1/h) sum_j (A^-1)_ij (X_j - x_k)

at the stages i, with the derivatives Y_i = (x', ..., x^(mu+1)) of the array as auxiliary unknowns:
at the solution the second line is ``Z2' F_mu = 0``. Matrices and Jacobians are computed once a
step, at the end of the step that a Taylor expansion predicts; Newton's iteration with them
converges linearly. The last stage is the next state, so every constraint, hidden ones included,
holds at every instant. Order 5.

Measured with steps of 1 ms (largest tool error of a move): planar5_mp and elbow 2 nm, manutec_r3
0.2 nm, abb_arm 0.1 urad; four_mass 0.4 um, for the corner of its spring's second derivative.

Source: P. Kunkel, V. Mehrmann, Differential-Algebraic Equations, 2006, ch. 6; E. Hairer, G.
Wanner, Solving Ordinary Differential Equations II, 1996, IV.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.tableaus import Tableau, radau
from flexgen.dynamics.dae.signature import structural_index
from flexgen.dynamics.dae.system import InverseDae
from flexgen.inversion.comparison.initial_value import (
    States,
    check_causal,
    dae_of,
    instants,
    result_of_states,
)
from flexgen.inversion.comparison.strangeness_free import Split, StrangenessFree
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.paths.path import Path

STAGES = 3
ITERATIONS = 30
HIGHEST = 5  # order of the array, at most: a path has five derivatives
TOLERANCE = 1e-14  # of Newton's correction, in units of the scales
STALLED = 1e-8  # a smaller correction that no longer decreases is rounding


@dataclass(frozen=True)
class Regular:
    """States ``x`` and their rates ``dx`` (n, n_x); ``iterations`` in all; ``gap``: the smallest
    on the path.
    """

    x: np.ndarray
    dx: np.ndarray
    iterations: int
    gap: float


def integrate(
    system: StrangenessFree,
    path: Path,
    t: np.ndarray,
    x_eq: np.ndarray,
    table: Tableau | None = None,
) -> Regular:
    """Integrate the regularized DAE from equilibrium.

    Parameters
    ----------
    system : StrangenessFree
    path : Path
    t : array (n,) [s]
        Instants, one for each step; the robot is in equilibrium at the first one.
    x_eq : array (n_x,)
    table : Tableau, optional
        A stiffly accurate collocation method; default: Radau IIA with three stages.

    Returns
    -------
    Regular

    Raises
    ------
    SolverError
        Newton's iteration does not converge, or a rank changes; the text names the instant.
    """
    table = table or radau(STAGES)
    dae = system.dae
    mu = system.mu
    n = system.n
    s = len(table.c)
    inverse = np.linalg.inv(table.A)
    start = np.zeros((n, mu + 2))
    start[:, 0] = x_eq
    U0 = dae.targets(path.sample(t[:1]), mu)[0]
    point = system.consistent(start, U0)
    times = (t[:-1, None] + np.diff(t)[:, None] * table.c).ravel()
    U = dae.targets(path.sample(times), mu).reshape(len(t) - 1, s, dae.n_u, mu + 1)
    x = np.empty((len(t), n))
    dx = np.zeros((len(t), n))
    x[0] = point[:, 0]
    dx[0] = point[:, 1]
    iterations = 0
    gap = np.inf
    for k in range(len(t) - 1):
        check_time(f"method kunkel-mehrmann at t = {t[k]:.4g} of {t[-1]:.4g} s")
        h = float(t[k + 1] - t[k])
        stages = [_taylor(point, c * h) for c in table.c]
        try:
            split = system.split(stages[-1], U[k, -1])
            gap = min(gap, split.gap)
            count = _newton(system, split, stages, x[k], U[k], inverse / h)
        except (SolverError, np.linalg.LinAlgError) as error:
            raise SolverError(
                f"method kunkel-mehrmann: at t = {t[k + 1]:.4g} s: {error}; try a finer --mesh, "
                "or a path without a singular pose"
            ) from None
        iterations += count
        point = stages[-1]
        x[k + 1] = point[:, 0]
        dx[k + 1] = point[:, 1]
    return Regular(x, dx, iterations, gap)


def _taylor(point: np.ndarray, step: float) -> np.ndarray:
    """Taylor expansion of x and its derivatives (n_x, mu + 2) over a step."""
    orders = point.shape[1]
    powers = np.array([step**k / factorial(k) for k in range(orders)])
    return np.stack([point[:, k:] @ powers[: orders - k] for k in range(orders)], axis=1)


def _newton(
    system: StrangenessFree,
    split: Split,
    stages: list[np.ndarray],
    x: np.ndarray,
    U: np.ndarray,
    rates: np.ndarray,
) -> int:
    """Simplified Newton iteration on the stages of a step, in place; returns the number of
    iterations.

    Parameters
    ----------
    split : Split
        The regularized system at the begin of the step; its matrices are kept.
    stages : list of arrays (n_x, mu + 2)
        Unknowns and their derivatives at each stage.
    x : array (n_x,)
        Unknowns at the begin of the step.
    U : array
        Path and derivatives at each stage.
    rates : array (s, s) [1/s]
        Inverse of the tableau over the length of the step.

    Raises
    ------
    SolverError
        It does not converge.
    """
    n = system.n
    s = len(stages)
    unit = system.unit
    Z1 = split.Z1
    Z2 = split.Z2
    N = split.N
    A = split.A
    E = split.E
    d = Z1.shape[1]
    # E belongs to x' in units of x times the rate
    moving = Z1.T @ A
    held = Z2.T @ N
    turning = Z1.T @ E / system.rate
    matrix = np.zeros((s * n, s * n))
    for i in range(s):
        here = slice(i * n, i * n + d)
        matrix[i * n + d : (i + 1) * n, i * n : (i + 1) * n] = held
        for j in range(s):
            matrix[here, j * n : (j + 1) * n] = rates[i, j] * turning
        matrix[here, i * n : (i + 1) * n] += moving
    row = np.maximum(np.abs(matrix).max(axis=1), 1e-300)
    factors = lu_factor(matrix / row[:, None])
    before = np.inf
    for iteration in range(1, ITERATIONS + 1):
        arrays = [system.rows(stage, u) for stage, u in zip(stages, U, strict=True)]
        differences = np.array([stage[:, 0] - x for stage in stages])
        rhs = np.zeros((s, n))
        for i in range(s):
            rhs[i, :d] = Z1.T @ system.motion(stages[i][:, 0], rates[i] @ differences, U[i, :, 0])
            rhs[i, d:] = Z2.T @ arrays[i]
        step = lu_solve(factors, -rhs.ravel() / row).reshape(s, n)
        for i in range(s):
            stages[i][:, 0] += unit * step[i]
            w = split.solve(arrays[i] + N @ step[i])
            stages[i][:, 1:] += system.units[:, 1:] * w.reshape(system.mu + 1, n).T
        size = float(np.abs(step).max())
        if not np.isfinite(size):
            break
        if size <= TOLERANCE or (size < STALLED and size > 0.3 * before):
            return iteration
        before = size
    raise SolverError(
        f"Newton's iteration did not converge, last correction {size:.1e} of the unknowns' sizes"
    )


def regularize(dae: InverseDae, x_eq: np.ndarray, highest: int = HIGHEST) -> StrangenessFree:
    """The regularized DAE with the smallest array that satisfies the hypothesis, from the
    structural index upwards.

    ArgumentError where the structure is singular, SolverError where no order up to ``highest``
    does.
    """
    index = structural_index(dae.equations).index
    if index is None:
        raise ArgumentError(
            f"method kunkel-mehrmann: the inverse dynamics of model {dae.model.name} is "
            "structurally singular: an output that no motor moves, or not as many outputs as "
            "motors"
        )
    failed = None
    for mu in range(index - 1, max(index, highest + 1)):
        system = StrangenessFree(dae, mu, x_eq)
        try:
            if system.d >= 0:
                return system
        except SolverError as error:
            failed = error
    raise SolverError(f"method kunkel-mehrmann: {failed}; choose another start or use lq")


def solve(problem: InversionProblem, h: float) -> MethodResult:
    """Solve by the regularized DAE, in steps of a fifth of ``h`` [s], at most a millisecond. No
    options.
    """
    problem.check_options("kunkel-mehrmann")
    check_causal(problem, "kunkel-mehrmann")
    dae = dae_of(problem)
    x_eq = dae.pack(problem.equilibrium)
    system = regularize(dae, x_eq)
    t = instants(problem, min(h / 5, problem.step))
    found = integrate(system, problem.path, t, x_eq)
    return result_of_states(
        problem,
        dae,
        States(t, found.x, found.dx),
        iterations=found.iterations,
        verdict="Radau IIA, 3 stages",
        details={
            "mu": system.mu,
            "a": system.a,
            "d": system.d,
            "gap": found.gap,
            "step_s": float(t[1] - t[0]),
        },
    )
