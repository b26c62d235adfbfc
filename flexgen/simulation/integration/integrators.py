"""Integration of the equations of motion: explicit, and implicit where the problem is stiff.

The explicit Runge-Kutta method of order 8 needs steps as short as the fastest decaying part, also
where that part has decayed long ago: sharp friction of a light rotor makes it take millions of
evaluations. Where it needs more than `RATE` evaluations for each second of motion and `EACH` for
each instant, and the fastest mode decays,
LSODA continues from the state that was reached; it changes by itself between Adams methods and
backward differentiation formulas, whose steps follow the motion alone. Where the fastest mode
oscillates, as with a very stiff gear without damping, it does not decay, and the explicit method
stays.

With a C compiler the explicit method and the right-hand side run in C, else in scipy and CasADi;
the steps are the same.

Source: E. Hairer, S. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 1993, sec.
II.5 (DOP853); L. Petzold, SIAM J. Sci. Stat. Comput. 4(1), 1983 (LSODA).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import DOP853, LSODA, OdeSolver
from scipy.interpolate import PPoly

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import SolverError
from flexgen.simulation.integration.compiled_rate import CompiledDop853, CompiledRate
from flexgen.simulation.motor_feedback import MotorFeedback

if TYPE_CHECKING:
    from flexgen.model.elements import RobotModel
    from flexgen.simulation.integration.fastest_mode import Mode

# a few minutes of the explicit method; a long motion may take LONG each second
EVALUATIONS = 5_000_000
LONG = 3e5
# evaluations for each radian of the fastest mode where that oscillates: the explicit method
# follows it with twenty. It needs more where its errors of rounding are above the tolerance
EACH_TURN = 400.0
RATE = 1e6  # evaluations for each second of motion: above it the problem is stiff
# for each instant, where the torque has another piece: not stiff below it (a step takes twelve)
EACH = 60.0
BLOCK = 5_000  # evaluations over which the rate is measured
# below them the implicit method solves for rounding
RTOL_STIFF = 1e-10
ATOL_STIFF = 1e-11
EVALUATIONS_STIFF = 400_000  # about a minute of the implicit method
# least part of the motion within this number of evaluations of the implicit method
ADVANCE = 1e-3
PATIENCE = 100_000
# 1/s: a mode that decays faster has a step below 1e-9 s in a motion of seconds, where rounding
# ends the implicit method
FASTEST = 1e9
# 1/s: the implicit method takes minutes for each second of a faster oscillation
FASTEST_TURN = 1e4
EXPLICIT = "DOP853"
IMPLICIT = "LSODA"


@dataclass(frozen=True)
class Rates:
    """The right-hand side ``x' = f(x, u(t))`` of the robot and its two observers, work and loss.

    ``rate(t, x)`` and ``jacobian(t, x)``: (n,) and (n, n), the rows and columns of the observers
    zero in the latter. ``compiled``: the rate of the robot in C, a function of state and torque;
    None: there is no compiler. ``given``: u(t). ``feedback``: motor feedback, whose integrals come
    last in the state; None: open loop.
    ``model``: the robot, for reasons that name its parts.
    """

    rate: Callable[[float, np.ndarray], np.ndarray]
    jacobian: Callable[[float, np.ndarray], np.ndarray]
    compiled: CompiledRate | None
    given: PPoly
    feedback: MotorFeedback | None = None
    model: RobotModel | None = None

    def fastest(self, t: float, x: np.ndarray) -> Mode | None:
        """The fastest mode at the instant t [s] and the state x; None without a model, and where
        the state is not finite.
        """
        from flexgen.simulation.integration.fastest_mode import fastest_mode

        if self.model is None or not np.isfinite(x).all():
            return None
        A = self.jacobian(t, x)
        return fastest_mode(self.model, A) if np.isfinite(A).all() else None

    def why(self, t: float, x: np.ndarray) -> str:
        """Reason why the steps of an integrator are short at a state; empty: not known."""
        from flexgen.simulation.integration.fastest_mode import mode_text

        mode = self.fastest(t, x)
        if mode is None or self.model is None:
            return ""
        return mode_text(self.model, mode)


@dataclass(frozen=True)
class Integration:
    """States at the instants (n, n_x), evaluations of the right-hand side, and the method that did
    the last step.
    """

    states: np.ndarray
    evaluations: int
    method: str


class ScipySteps:
    """A method of scipy; attributes and ``advance`` as those of `CompiledDop853`."""

    def __init__(self, solver: OdeSolver, t: np.ndarray) -> None:
        self.solver = solver
        self.instants = t
        self.failure = ""

    @property
    def t(self) -> float:
        """Instant that is reached [s]."""
        return float(self.solver.t)

    @property
    def y(self) -> np.ndarray:
        """State at this instant."""
        return np.asarray(self.solver.y)

    @property
    def nfev(self) -> int:
        """Number of evaluations of the rates."""
        return int(self.solver.nfev)

    def advance(self, out: np.ndarray, k: int, most: int) -> int:
        """Step for ``most`` evaluations; states at the instants from number ``k`` on go to ``out``
        (instants, n); returns the new k.
        """
        solver = self.solver
        t = self.instants
        until = self.nfev + most
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


class _Later:
    """The explicit method in C, whose first result is a later row."""

    def __init__(self, solver: CompiledDop853, first: int) -> None:
        self._solver = solver
        self._first = first

    @property
    def t(self) -> float:
        return self._solver.t

    @property
    def y(self) -> np.ndarray:
        return self._solver.y

    @property
    def nfev(self) -> int:
        return self._solver.nfev

    @property
    def failure(self) -> str:
        return self._solver.failure

    def advance(self, out: np.ndarray, k: int, most: int) -> int:
        return self._solver.advance(out[self._first :], k - self._first, most) + self._first


_Solver = CompiledDop853 | ScipySteps | _Later


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
        Tolerances of the explicit method; the implicit one takes none below `RTOL_STIFF`,
        `ATOL_STIFF`.
    progress : callable, optional
        Called with one line of text about once a second.

    Raises
    ------
    SolverError
        The integration broke down, or needs too many evaluations.
    """
    out = np.empty((len(t), len(start)))
    out[0] = start
    solver = _explicit(loop, t, 1, start, (rtol, atol))
    before = 0
    method = EXPLICIT
    k = 1
    reported = time.perf_counter()
    mark = (float(t[0]), 0)
    fast = max(RATE, EACH / float(np.diff(t).mean()) if len(t) > 1 else 0.0)
    most = max(EVALUATIONS, LONG * (t[-1] - t[0]))
    while k < len(t):
        check_time(f"simulation at t = {solver.t:.6g} of {t[-1]:.6g} s")
        k = solver.advance(out, k, BLOCK)
        if solver.failure:
            raise SolverError(_failure_text(loop, solver))
        evaluations = before + solver.nfev
        if method == EXPLICIT and k < len(t):
            if solver.nfev - mark[1] > fast * (solver.t - mark[0]):
                before = evaluations
                mark = (solver.t, 0)
                turns = _oscillation(loop, solver, fast)
                tight = max(rtol, RTOL_STIFF), np.maximum(atol, ATOL_STIFF)
                if turns:
                    fast = turns
                    most = max(most, before + fast * (t[-1] - solver.t))
                    solver = _explicit(loop, np.r_[solver.t, t[k:]], k, solver.y.copy(), tight)
                else:
                    solver = _implicit(loop, solver, t, tight)
                    method = IMPLICIT
            else:
                mark = (solver.t, solver.nfev)
        elif method == IMPLICIT:
            mark = _check_advance(solver, mark, t, loop.why)
        if evaluations > most:
            why = loop.why(solver.t, solver.y)
            raise SolverError(
                f"simulation: stopped at t = {solver.t:.6g} of {t[-1]:.6g} s after {evaluations} "
                f"evaluations{': ' * bool(why)}{why}; check the units of the trajectory, and the "
                "numbers of the model with 'flexgen check' (flexgen.check)"
            )
        if progress is not None and time.perf_counter() - reported > 1.0:
            reported = time.perf_counter()
            progress(
                f"simulation: t = {solver.t:7.3f} of {t[-1]:.3f} s, {evaluations} evaluations, "
                f"{method}"
            )
    return Integration(out, before + solver.nfev, method)


def _explicit(
    loop: Rates, t: np.ndarray, k: int, start: np.ndarray, tolerances: tuple[float, np.ndarray]
) -> _Solver:
    """The explicit method (DOP853), in C where the rate is compiled, from ``start`` at ``t[0]``.

    ``t[1:]`` are the instants of the results k, k + 1, ...; those before row k are known already.
    ``tolerances``: relative, and absolute of each state.
    """
    rtol, atol = tolerances
    if loop.compiled is None:
        given = np.r_[np.full(k, t[0]), t[1:]]
        return ScipySteps(DOP853(loop.rate, t[0], start, t[-1], rtol=rtol, atol=atol), given)
    made = CompiledDop853(loop.compiled, loop.given, t, start, rtol, atol, loop.feedback)
    return made if k == 1 else _Later(made, k - 1)


def _implicit(
    loop: Rates, solver: _Solver, t: np.ndarray, tolerances: tuple[float, np.ndarray]
) -> ScipySteps:
    """The implicit method LSODA from the state that another one has reached, until t[-1] [s]."""
    rtol, atol = tolerances
    start = solver.y.copy()
    made = LSODA(loop.rate, solver.t, start, t[-1], jac=loop.jacobian, rtol=rtol, atol=atol)
    return ScipySteps(made, t)


def _oscillation(loop: Rates, solver: _Solver, fast: float) -> float:
    """Evaluations a second [1/s] that the explicit method may need to follow the fastest mode.

    0 where that mode decays. ``fast``: those that it has needed. SolverError where it follows no
    fast mode, and none follows a faster decay.
    """
    mode = loop.fastest(solver.t, solver.y)
    if mode is None:
        return 0.0
    most = max(EACH_TURN * abs(mode.value), 2.0 * RATE)
    if mode.oscillates and fast < most:
        return most
    if abs(mode.value) > (FASTEST_TURN if mode.oscillates else FASTEST):
        raise SolverError(f"simulation: {loop.why(solver.t, solver.y)}")
    return 0.0


def _failure_text(loop: Rates, solver: _Solver) -> str:
    """Why an integration broke down, with the fastest mode where it is known."""
    why = loop.why(solver.t, solver.y)
    head = f"simulation: failed at t = {solver.t:.6g} s ({solver.failure})"
    advice = "check the torque, and the numbers of the model with 'flexgen check' (flexgen.check)"
    return f"{head}: {why}; {advice}" if why else f"{head}; {advice}"


def _check_advance(
    solver: _Solver, mark: tuple[float, int], t: np.ndarray, why: Callable[..., str] | None = None
) -> tuple[float, int]:
    """Refuse an implicit method that does not advance, with the cause by ``why``.

    ``mark``: instant [s] and evaluations at the last check; returns those of this one, or the same
    ones where it is too early to judge.
    """
    if solver.nfev - mark[1] < PATIENCE and solver.nfev < EVALUATIONS_STIFF:
        return mark
    if solver.nfev >= EVALUATIONS_STIFF or solver.t - mark[0] < ADVANCE * (t[-1] - t[0]):
        cause = "" if why is None else why(solver.t, solver.y)
        raise SolverError(
            f"simulation: stopped at t = {solver.t:.6g} of {t[-1]:.6g} s after {solver.nfev} "
            "evaluations of the implicit method: the equations of motion are stiff and their "
            f"solution has steep layers{': ' * bool(cause)}{cause}"
        )
    return solver.t, solver.nfev
