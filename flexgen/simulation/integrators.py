"""Integration of the equations of motion: explicit, and implicit where the problem is stiff.

The explicit Runge-Kutta method of order 8 needs steps as short as the fastest decaying part, also where that part has
decayed long ago: sharp friction of a light rotor makes it take millions of evaluations. Where it needs more than `RATE`
evaluations for each second of motion and `EACH` for each instant, LSODA continues from the state that was reached; it
changes by itself between Adams methods and backward differentiation formulas, whose steps follow the motion alone.

With a C compiler the explicit method and the right-hand side run in C, else in scipy and CasADi; the steps are the
same.

Source: E. Hairer, S. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 1993, sec. II.5 (DOP853);
L. Petzold, SIAM J. Sci. Stat. Comput. 4(1), 1983 (LSODA).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import DOP853, LSODA, OdeSolver
from scipy.interpolate import PPoly

from flexgen.deadline import check_time
from flexgen.errors import SolverError
from flexgen.simulation.compiled_rate import CompiledDop853, CompiledRate
from flexgen.simulation.motor_feedback import MotorFeedback

# a few minutes of the explicit method; a long motion may take LONG each second
EVALUATIONS = 5_000_000
LONG = 3e5
RATE = 1e6  # evaluations for each second of motion: above it the problem is stiff
# for each instant, where the torque has another piece: not stiff below it (a step takes twelve)
EACH = 60.0
BLOCK = 5_000  # evaluations over which the rate is measured
RTOL_STIFF, ATOL_STIFF = 1e-10, 1e-11  # below them the implicit method solves for rounding
EVALUATIONS_STIFF = 400_000  # about a minute of the implicit method
# least part of the motion within this number of evaluations of the implicit method
ADVANCE, PATIENCE = 1e-3, 100_000
EXPLICIT, IMPLICIT = "DOP853", "LSODA"


@dataclass(frozen=True)
class Rates:
    """The right-hand side ``x' = f(x, u(t))`` of the robot and its two observers, work and loss.

    ``rate(t, x)`` and ``jacobian(t, x)``: (n,) and (n, n), the rows and columns of the observers zero in the latter.
    ``compiled``: the rate of the robot in C, a function of state and torque; None: there is no compiler. ``given``:
    u(t). ``feedback``: motor feedback, whose integrals come last in the state; None: open loop.
    """

    rate: Callable[[float, np.ndarray], np.ndarray]
    jacobian: Callable[[float, np.ndarray], np.ndarray]
    compiled: CompiledRate | None
    given: PPoly
    feedback: MotorFeedback | None = None


@dataclass(frozen=True)
class Integration:
    """States at the instants (n, n_x), evaluations of the right-hand side, and the method that did the last step."""

    states: np.ndarray
    evaluations: int
    method: str


class _Scipy:
    """A method of scipy; attributes and ``advance`` as those of `CompiledDop853`."""

    def __init__(self, solver: OdeSolver, t: np.ndarray) -> None:
        self.solver, self.instants, self.failure = solver, t, ""

    @property
    def t(self) -> float:
        return float(self.solver.t)

    @property
    def y(self) -> np.ndarray:
        return np.asarray(self.solver.y)

    @property
    def nfev(self) -> int:
        return int(self.solver.nfev)

    def advance(self, out: np.ndarray, k: int, most: int) -> int:
        solver, t, until = self.solver, self.instants, self.nfev + most
        while k < len(t) and solver.nfev < until:
            message = solver.step()
            if solver.status == "failed" or not np.isfinite(solver.y).all():
                self.failure = message or "not finite"
                break
            dense = solver.dense_output()
            while k < len(t) and t[k] <= solver.t:
                out[k] = dense(t[k])
                k += 1
        return k


def integrate(
    loop: Rates,
    start: np.ndarray,
    t: np.ndarray,
    rtol: float,
    atol: np.ndarray,
    progress: Callable[[str], None] | None = None,
) -> Integration:
    """Integrate from ``start`` at ``t[0]`` to ``t[-1]``.

    Parameters
    ----------
    loop : Rates
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
    solver: CompiledDop853 | _Scipy = (
        _Scipy(DOP853(loop.rate, t[0], start, t[-1], rtol=rtol, atol=atol), t)
        if loop.compiled is None
        else CompiledDop853(loop.compiled, loop.given, t, start, rtol, atol, loop.feedback)
    )
    before, method, k, reported = 0, EXPLICIT, 1, time.perf_counter()
    mark, fast = (float(t[0]), 0), max(RATE, EACH / float(np.diff(t).mean()) if len(t) > 1 else 0.0)
    while k < len(t):
        check_time(f"simulation at t = {solver.t:.6g} of {t[-1]:.6g} s")
        k = solver.advance(out, k, BLOCK)
        if solver.failure:
            raise SolverError(
                f"simulation: failed at t = {solver.t:.6g} s ({solver.failure}); check the torque, and the numbers of "
                "the model with 'flexgen check' (flexgen.check)"
            )
        evaluations = before + solver.nfev
        if method == EXPLICIT and k < len(t):
            if solver.nfev - mark[1] > fast * (solver.t - mark[0]):
                before, method, mark = evaluations, IMPLICIT, (solver.t, 0)
                tight = {"rtol": max(rtol, RTOL_STIFF), "atol": np.maximum(atol, ATOL_STIFF)}
                solver = _Scipy(
                    LSODA(loop.rate, solver.t, solver.y.copy(), t[-1], jac=loop.jacobian, **tight),
                    t,
                )
            else:
                mark = (solver.t, solver.nfev)
        elif method == IMPLICIT:
            mark = _check_advance(solver, mark, t)
        if evaluations > max(EVALUATIONS, LONG * (t[-1] - t[0])):
            raise SolverError(
                f"simulation: stopped at t = {solver.t:.6g} of {t[-1]:.6g} s after {evaluations} evaluations; "
                "check the units of the trajectory, and the numbers of the model with 'flexgen check' (flexgen.check)"
            )
        if progress is not None and time.perf_counter() - reported > 1.0:
            reported = time.perf_counter()
            progress(
                f"simulation: t = {solver.t:7.3f} of {t[-1]:.3f} s, {evaluations} evaluations, {method}"
            )
    return Integration(out, before + solver.nfev, method)


def _check_advance(
    solver: CompiledDop853 | _Scipy, mark: tuple[float, int], t: np.ndarray
) -> tuple[float, int]:
    """SolverError where the implicit method does not advance; else instant and evaluations of the last check."""
    if solver.nfev - mark[1] < PATIENCE and solver.nfev < EVALUATIONS_STIFF:
        return mark
    if solver.nfev >= EVALUATIONS_STIFF or solver.t - mark[0] < ADVANCE * (t[-1] - t[0]):
        raise SolverError(
            f"simulation: stopped at t = {solver.t:.6g} of {t[-1]:.6g} s after {solver.nfev} evaluations of the "
            "implicit method: the equations of motion are stiff and their solution has steep layers; use a smaller "
            "beta of the friction, a larger rotor inertia, or a torque without jumps"
        )
    return solver.t, solver.nfev
