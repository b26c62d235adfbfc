"""Inverse dynamics by constant-step BDF on the original high-index DAE, without index reduction.

    F(x_k, x_k', u(t_k)) = 0,      x_k' = (1/h) sum_j c_j x_(k-j)

The integration starts in equilibrium, where all earlier x are equal. The step is constant: after a
change the torque, which is the third or fourth derivative of the path, would have an error in some
steps that does not decrease with h. The torque of order 1 lags by about one step; Richardson's
extrapolation ``(2^p x(h/2) - x(h)) / (2^p - 1)`` removes the leading error. Rounding enters the
torque as eps / h^(index - 1), which bounds what small steps can gain.

Measured with steps of 1 ms (planar5_mp, four_mass, elbow, manutec_r3; largest tool error of a
move): order 1 2 mm, extrapolated 5 um; order 2 10 um (in 2.5 s of joint motion 0.2 mm), order 3
0.2 um (1 um), order 4 0.1 um. A light arm that turns by many radians (abb_arm, 10 rad) has 1e-5 to
1e-4 rad, due to rounding.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 1996, sec. VII.3; K.
Brenan, S. Campbell, L. Petzold, Numerical Solution of Initial-Value Problems in
Differential-Algebraic Equations, 1996, ch. 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.dae.system import InverseDae
from flexgen.inversion.comparison.initial_value import (
    States,
    check_causal,
    dae_of,
    instants,
    result_of_states,
    zeros_along,
)
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.paths.path import Path

COEFFICIENTS = {
    1: (1.0, -1.0),
    2: (3 / 2, -2.0, 1 / 2),
    3: (11 / 6, -3.0, 3 / 2, -1 / 3),
    4: (25 / 12, -4.0, 3.0, -4 / 3, 1 / 4),
}
ITERATIONS = 15
TOLERANCE = 1e-13  # rad or m: of the last Newton correction of a coordinate
ROUNDING = 1e-9  # of the roots of a characteristic polynomial
STALLED = 1e-8  # a smaller correction that no longer decreases is rounding


@dataclass(frozen=True)
class Marched:
    """States ``x`` and their rates ``dx`` (n, n_x) at the instants ``t`` (n,) [s]; ``iterations``
    of Newton in all.
    """

    t: np.ndarray
    x: np.ndarray
    dx: np.ndarray
    iterations: int


def march(
    dae: InverseDae,
    path: Path,
    t: np.ndarray,
    x_eq: np.ndarray,
    order: int = 1,
    coefficients: dict[int, tuple[float, ...]] | None = None,
) -> Marched:
    """Integrate the DAE from equilibrium by BDF of a fixed order.

    Parameters
    ----------
    dae : InverseDae
    path : Path
    t : array (n,) [s]
        Equidistant instants; the robot is in equilibrium at and before the first one.
    x_eq : array (n_x,)
    order : int
        1 to 4.
    coefficients : dict, optional
        Of the formulas by order, newest first; default: `COEFFICIENTS`.

    Returns
    -------
    Marched

    Raises
    ------
    SolverError
        Newton's method did not converge; the text names the instant.
    """
    c = np.array((coefficients or COEFFICIENTS)[order])
    h = float(t[-1] - t[0]) / (len(t) - 1)
    n = dae.n
    u = dae.targets(path.sample(t), 0)[:, :, 0]
    size, torque, _ = dae.scales(x_eq)
    column = np.concatenate([size, size / h, torque / h**2])
    x = np.tile(x_eq, (len(t), 1))
    dx = np.zeros((len(t), dae.n_x))
    iterations = 0
    for k in range(1, len(t)):
        check_time(f"method bdf at t = {t[k]:.4g} of {t[-1]:.4g} s")
        past = sum((c[j] * x[max(k - j, 0)] for j in range(1, order + 1)), np.zeros(dae.n_x))
        new = 2 * x[k - 1] - x[max(k - 2, 0)]
        before = np.inf
        for _ in range(ITERATIONS):
            F, A, E = (z.full() for z in dae.rows(new, (c[0] * new + past) / h, u[k]))
            J = (A + c[0] / h * E) * column
            row = np.maximum(np.abs(J).max(axis=1), 1e-300)
            try:
                step = np.linalg.solve(J / row[:, None], -F[:, 0] / row)
            except np.linalg.LinAlgError:
                raise SolverError(
                    f"method bdf: the equations are singular at t = {t[k]:.4g} s, a singular "
                    "pose; choose another path"
                ) from None
            new = new + column * step
            iterations += 1
            change = float(np.abs(step[:n]).max())
            if not np.isfinite(change):
                break
            if (change <= TOLERANCE and before <= STALLED) or (
                change <= STALLED and change > 0.3 * before
            ):
                break
            before = change
        if not change <= STALLED:
            raise SolverError(
                f"method bdf: Newton's method does not converge at t = {t[k]:.4g} s, last "
                f"correction {change:.1e} rad or m; try a finer --mesh, or a path inside the "
                "workspace without a singular pose"
            )
        x[k] = new
        dx[k] = (c[0] * new + past) / h
    return Marched(t, x, dx, iterations)


def extrapolate(
    dae: InverseDae, path: Path, t: np.ndarray, x_eq: np.ndarray, order: int = 1
) -> Marched:
    """`march` with steps h and h/2, and Richardson's extrapolation at the instants t: one order
    more.
    """
    coarse = march(dae, path, t, x_eq, order)
    fine = march(dae, path, np.linspace(t[0], t[-1], 2 * len(t) - 1), x_eq, order)
    factor = 2.0**order
    x, dx = (
        (factor * a[::2] - b) / (factor - 1) for a, b in ((fine.x, coarse.x), (fine.dx, coarse.dx))
    )
    return Marched(t, x, dx, coarse.iterations + fine.iterations)


def stable_order(zeros: np.ndarray, h: float) -> int:
    """3, or 2 where a zero dynamics with these zeros [1/s] is too lightly damped for order 3 at
    the step h.
    """
    c = np.array(COEFFICIENTS[3])
    for zero in zeros:
        polynomial = c.astype(complex)
        polynomial[0] -= zero * h
        if np.abs(np.roots(polynomial)).max() > 1 + ROUNDING:
            return 2
    return 3


def solve(problem: InversionProblem, h: float) -> MethodResult:
    """Solve by BDF.

    Options: ``order`` 1 to 4 (default: 3, or 2 where 3 is not stable), ``richardson`` (default
    False). The step is a fifth of ``h``, at most a millisecond.
    """
    problem.check_options("bdf", "order", "richardson")
    order = problem.options.get("order")
    richardson = problem.options.get("richardson", False)
    if order is not None and (order not in COEFFICIENTS or isinstance(order, bool)):
        raise ArgumentError(
            f"options: method bdf was given order {order!r}, expected 1, 2, 3 or 4"
        )
    if not isinstance(richardson, bool):
        raise ArgumentError(
            f"options: method bdf was given richardson {richardson!r}, expected True or False"
        )
    check_causal(problem, "bdf", differentiates=False)
    dae = dae_of(problem)
    t = instants(problem, min(h / 5, problem.step))
    if order is None:
        order = stable_order(zeros_along(problem), float(t[1] - t[0]))
    run = extrapolate if richardson else march
    found = run(dae, problem.path, t, dae.pack(problem.equilibrium), order)
    return result_of_states(
        problem,
        dae,
        States(t, found.x, found.dx),
        iterations=found.iterations,
        verdict=f"BDF of order {order}" + (", extrapolated" if richardson else ""),
        details={"order": order, "richardson": richardson, "step_s": float(t[1] - t[0])},
    )
