"""Integration of the equations of motion: explicit, and implicit where the problem is stiff.

The explicit Runge-Kutta method of order 8 needs steps as short as the fastest decaying part, also where that part has
decayed long ago: sharp friction of a light rotor makes it take millions of evaluations. Where it needs more than `RATE`
evaluations for each second of motion, LSODA goes on from the state that was reached; it changes by itself between
Adams methods and backward differentiation formulas, whose steps follow the motion alone.

Source: E. Hairer, S. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 1993, sec. II.5 (DOP853);
L. Petzold, SIAM J. Sci. Stat. Comput. 4(1), 1983 (LSODA).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import DOP853, LSODA

from flexgen.deadline import check_time
from flexgen.errors import SolverError

EVALUATIONS = 5_000_000  # a few minutes of the explicit method
RATE = 1e6  # evaluations for each second of motion: above it the problem is stiff
BLOCK = 5_000  # evaluations over which the rate is measured
RTOL_STIFF, ATOL_STIFF = 1e-10, 1e-11  # below them the implicit method solves for rounding
EVALUATIONS_STIFF = 400_000  # about a minute of the implicit method
ADVANCE, PATIENCE = 1e-3, 100_000  # least part of the motion within this number of evaluations of the implicit method
EXPLICIT, IMPLICIT = "DOP853", "LSODA"


@dataclass(frozen=True)
class OpenLoop:
    """The right-hand side ``x' = f(t, x)`` of the robot and its two observers, work and loss, which come last.

    ``rate(t, x)`` and ``jacobian(t, x)``: (n,) and (n, n), the rows and columns of the observers zero in the latter.
    ``keep``: objects that must live as long as the functions.
    """

    rate: Callable[[float, np.ndarray], np.ndarray]
    jacobian: Callable[[float, np.ndarray], np.ndarray]
    keep: tuple[object, ...] = ()


@dataclass(frozen=True)
class Integration:
    """States at the instants (n, n_x), evaluations of the right-hand side, and the method that did the last step."""

    states: np.ndarray
    evaluations: int
    method: str


def integrate(
    loop: OpenLoop,
    start: np.ndarray,
    t: np.ndarray,
    rtol: float,
    atol: np.ndarray,
    progress: Callable[[str], None] | None = None,
) -> Integration:
    """Integrate from ``start`` at ``t[0]`` to ``t[-1]``.

    Parameters
    ----------
    loop : OpenLoop
    start : array (n_x,)
        State at ``t[0]``.
    t : array (n,) [s]
        Instants of the results.
    rtol : float
    atol : array (n_x,)
        Tolerances of the explicit method; the implicit one takes none below `RTOL_STIFF`, `ATOL_STIFF`.
    progress : callable, optional
        Called with one line of text about once a second.

    Raises
    ------
    SolverError
        The integration broke down, or needs too many evaluations.
    """
    out = np.empty((len(t), len(start)))
    out[0] = start
    solver = DOP853(loop.rate, t[0], start, t[-1], rtol=rtol, atol=atol)
    before, method, k, reported = 0, EXPLICIT, 1, time.perf_counter()
    mark = (float(t[0]), 0)
    while k < len(t):
        check_time(f"simulation at t = {solver.t:.6g} of {t[-1]:.6g} s")
        message = solver.step()
        if solver.status == "failed" or not np.isfinite(solver.y).all():
            raise SolverError(
                f"simulation: failed at t = {solver.t:.6g} s ({message or 'not finite'}); check torque and model"
            )
        dense = solver.dense_output()
        while k < len(t) and t[k] <= solver.t:
            out[k] = dense(t[k])
            k += 1
        evaluations = before + int(solver.nfev)
        if method == EXPLICIT and solver.nfev - mark[1] >= BLOCK and k < len(t):
            if solver.nfev - mark[1] > RATE * (solver.t - mark[0]):
                before, method, mark = evaluations, IMPLICIT, (float(solver.t), 0)
                tight = {"rtol": max(rtol, RTOL_STIFF), "atol": np.maximum(atol, ATOL_STIFF)}
                solver = LSODA(loop.rate, solver.t, solver.y, t[-1], jac=loop.jacobian, **tight)
            else:
                mark = (float(solver.t), int(solver.nfev))
        elif method == IMPLICIT:
            mark = _check_advance(solver, mark, t)
        if evaluations > EVALUATIONS:
            raise SolverError(
                f"simulation: stopped at t = {solver.t:.6g} of {t[-1]:.6g} s after {evaluations} evaluations; "
                "check the units of the trajectory and the stiffness of the model"
            )
        if progress is not None and time.perf_counter() - reported > 1.0:
            reported = time.perf_counter()
            progress(f"simulation: t = {solver.t:7.3f} of {t[-1]:.3f} s, {evaluations} evaluations, {method}")
    return Integration(out, before + int(solver.nfev), method)


def _check_advance(solver: LSODA, mark: tuple[float, int], t: np.ndarray) -> tuple[float, int]:
    """SolverError where the implicit method does not advance; else instant and evaluations of the last check."""
    if solver.nfev - mark[1] < PATIENCE and solver.nfev < EVALUATIONS_STIFF:
        return mark
    if solver.nfev >= EVALUATIONS_STIFF or solver.t - mark[0] < ADVANCE * (t[-1] - t[0]):
        raise SolverError(
            f"simulation: stopped at t = {solver.t:.6g} of {t[-1]:.6g} s after {solver.nfev} evaluations of the "
            "implicit method: the equations of motion are stiff and their solution has steep layers; use a smaller "
            "beta of the friction, a larger rotor inertia, or a torque without jumps"
        )
    return float(solver.t), int(solver.nfev)
