"""Inverse dynamics by index reduction: dummy derivatives, and the index-1 DAE integrated by
SUNDIALS (IDAS).

The states are the motion of the non-actuated coordinates and of the damped gears. The path enters
by its exact derivatives. All constraints and their derivatives are equations of the system, so
there is no drift; after the integration the other unknowns are computed again at every instant, to
rounding. Where the states chosen at the start become ill-conditioned, others are chosen and the
integration continues with them.

Measured (largest tool error of a move): planar5_mp 10 to 30 nm, manutec_r3 2 nm, elbow 0.1 um,
four_mass 0.2 um for the corner of its spring's second derivative. Where the structure does not
show the index (abb_arm) the method refuses.

Source: see `flexgen.inversion.comparison.dummy_derivatives`; A. Hindmarsh et al., ACM TOMS 31(3),
2005 (SUNDIALS).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexgen.base.calls.deadline import OutOfTime, check_time
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.dae.signature import structural_index
from flexgen.dynamics.dae.system import InverseDae
from flexgen.inversion.comparison.dummy_derivatives import Choice, DummyDerivatives
from flexgen.inversion.comparison.initial_value import (
    States,
    check_causal,
    dae_of,
    instants,
    result_of_states,
)
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.paths.path import Path

IDAS = "method reduced, integration by IDAS"  # a stage of the time limit
RTOL = 1e-11  # of IDAS
ATOL = 1e-13  # for states in rad or m
# where IDAS does not converge: relax the tolerance, then integrate a part of the horizon only, and
# choose other states divisor of the horizon, factor of the tolerance
RETRIES = ((1, 1.0), (1, 10.0), (8, 10.0), (8, 1000.0))
LOOSER = 1e6  # tolerance of the other unknowns relative to that of the states
STEPS = 5_000  # of IDAS between two instants, at most
POOR = 0.05  # quality of a choice of states below which others are chosen


@dataclass(frozen=True)
class Reduced:
    """``Y`` (n, size) at the instants; ``choices``: number of choices of states; ``freedom``:
    number of states.

    ``rtol``: the loosest tolerance that was used. ``steps``, ``iterations``: of IDAS, and of its
    Newton method.
    """

    Y: np.ndarray
    choices: int
    freedom: int
    rtol: float
    steps: int = 0
    iterations: int = 0


class _PathSignals(ca.Callback):
    """The target and its derivatives at an instant, for IDAS: (t) -> U (n_u, orders + 1)."""

    def __init__(self, dae: InverseDae, path: Path, orders: int) -> None:
        ca.Callback.__init__(self)
        self._read = lambda t: dae.targets(path.sample(np.array([t])), orders)[0]
        self._last = (np.nan, ca.DM())
        self._shape = (dae.n_u, orders + 1)
        self.construct("path", {})

    def get_n_in(self) -> int:
        return 1

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_out(self, _: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self._shape)

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(
        self, name: str, names_in: list[str], names_out: list[str], options: dict
    ) -> ca.Function:
        """Zero: IDAS differentiates in the unknowns at one instant, where the path is constant."""
        t = ca.MX.sym("t")
        U = ca.MX.sym("U", *self._shape)
        zero = ca.MX(self._shape[0] * self._shape[1], 1)
        return ca.Function(name, [t, U], [zero], names_in, names_out, options)

    def eval(self, arguments: list[ca.DM]) -> list[ca.DM]:
        """The path and its derivatives at an instant, for IDAS. At the end of the time limit NaN,
        with which IDAS fails; the caller checks the time again.
        """
        t = float(arguments[0])
        try:
            check_time(IDAS)
        # CasADi would print it: IDAS fails on NaN, and the caller checks again
        except (OutOfTime, KeyboardInterrupt):
            return [ca.DM.nan(*self._shape)]
        if t != self._last[0]:  # Newton's method needs the same instant several times
            self._last = (t, ca.DM(self._read(t)))
        return [self._last[1]]


def offsets(dae: InverseDae) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Offsets (c, d) of the signature method; ArgumentError for a structurally singular model."""
    report = structural_index(dae.equations)
    if report.index is None:
        raise ArgumentError(
            f"method reduced: the inverse dynamics of model {dae.model.name} is structurally "
            "singular: an output that no motor moves, or not as many outputs as motors"
        )
    return report.c, report.d


def integrate(
    dummies: DummyDerivatives, path: Path, t: np.ndarray, x_eq: np.ndarray, rtol: float = RTOL
) -> Reduced:
    """Integrate the index-1 DAE from equilibrium.

    Parameters
    ----------
    dummies : DummyDerivatives
    path : Path
    t : array (n,) [s]
        Equidistant instants; the robot is in equilibrium at the first one.
    x_eq : array (n_x,)
    rtol : float
        Relative tolerance of IDAS; the absolute one is a hundredth of it, in rad or m.

    Returns
    -------
    Reduced

    Raises
    ------
    SolverError
        IDAS does not converge, or no choice of states is possible.
    """
    dae = dummies.dae
    U = dae.targets(path.sample(t), dummies.orders)
    Y = np.zeros((len(t), dummies.size))
    Y[0] = dummies.at_rest(x_eq)
    choice = dummies.choose(Y[0], U[0])
    scale = dummies.scales(x_eq)
    Y[0], _ = dummies.consistent(choice, Y[0], U[0], scale)
    signals = _PathSignals(dae, path, dummies.orders)
    choices = 1
    k = 0
    loosest = rtol
    counts = np.zeros(2, dtype=int)
    while k < len(t) - 1:
        states, algebraic, used, spent = _states(
            dummies, choice, signals, scale, Y[k], t[k:], rtol
        )
        loosest = max(loosest, used)
        counts = counts + spent
        reached = k + len(states)
        for i in range(k + 1, reached + 1):
            check_time(f"method reduced at t = {t[i]:.4g} of {t[-1]:.4g} s")
            guess = Y[i - 1].copy()
            guess[list(choice.states)] = states[i - k - 1]
            guess[list(choice.algebraic)] = (
                algebraic[i - k - 1] if len(algebraic) else guess[list(choice.algebraic)]
            )
            try:
                Y[i], _ = dummies.consistent(choice, guess, U[i], scale)
                good = not choice.states or dummies.quality(choice, Y[i], U[i]) >= POOR
                better = choice if good else dummies.choose(Y[i], U[i])
            except SolverError as error:
                raise SolverError(f"method reduced: at t = {t[i]:.4g} s: {error}") from None
            if better != choice:
                choice = better
                choices = choices + 1
                reached = i
                break
        k = reached
    return Reduced(Y, choices, dummies.freedom, loosest, *counts.tolist())


def _states(
    dummies: DummyDerivatives,
    choice: Choice,
    signals: ca.Callback,
    scale: np.ndarray,
    Y: np.ndarray,
    t: np.ndarray,
    rtol: float,
) -> tuple[np.ndarray, np.ndarray, float, tuple[int, int]]:
    """Integrate with IDAS from t[0], where Y holds.

    Parameters
    ----------
    choice : Choice
        Which unknowns are states.
    signals : ca.Callback
        Path and derivatives at an instant.
    scale : array (size,)
        Sizes of the unknowns.
    t : array (k,) [s]
    rtol : float
        Relative tolerance; it is raised where IDAS does not converge.

    Returns
    -------
    states, others : array
        At the instants after t[0], or at the first of them where IDAS does not converge further.
    rtol : float
        As used.
    counts : (int, int)
        Steps, and Newton iterations.

    Raises
    ------
    SolverError
        IDAS fails with each tolerance.
    """
    # all unknowns follow from the path and its derivatives: there is nothing to integrate
    if not choice.states:
        return np.zeros((len(t) - 1, 0)), np.zeros((0, 0)), rtol, (0, 0)
    columns = (list(choice.states), list(choice.algebraic))
    # the other unknowns are computed again, and rounding would not allow the tolerance of the
    # states
    units = (scale[columns[0]], scale[columns[1]] * LOOSER)
    G = dummies.system(Y, signals(t[0]))[1].full() * scale
    rows = np.maximum(np.abs(G).max(axis=1), 1e-300)
    s = ca.MX.sym("s", len(columns[0]))
    z = ca.MX.sym("z", len(columns[1]))
    time = ca.MX.sym("t")
    ds, residual = dummies.index_one(choice)(
        s * ca.DM(units[0]), z * ca.DM(units[1]), signals(time)
    )
    system = {
        "x": s,
        "z": z,
        "t": time,
        "ode": ds / ca.DM(units[0]),
        "alg": residual / ca.DM(rows),
    }
    for part, factor in RETRIES:
        used = rtol * factor
        to = max(2, len(t) // part)
        options = {
            "reltol": used,
            "abstol": used * ATOL / RTOL,
            "max_num_steps": STEPS,
            "calc_ic": False,  # the initial values are consistent; rounding would disturb a search
            "init_xdot": (Y[list(choice.rates)] / units[0]).tolist(),
            "suppress_algebraic": True,
            "max_step_size": float(t[1] - t[0]),
            "disable_internal_warnings": True,
        }
        try:
            run = ca.integrator("reduced", "idas", system, float(t[0]), t[1:to].tolist(), options)
            out = run(x0=Y[columns[0]] / units[0], z0=Y[columns[1]] / units[1])
        except RuntimeError as error:  # Newton's iteration of IDAS does not converge near rounding
            check_time(IDAS)
            reason = str(error).strip().splitlines()[-1]
            continue
        spent = run.stats()
        counts = int(spent["nsteps"]), int(spent["nniters"])
        return out["xf"].full().T * units[0], out["zf"].full().T * units[1], used, counts
    raise SolverError(
        f"method reduced: IDAS failed after t = {t[0]:.4g} s with a tolerance of {used:.0e}: "
        f"{reason}; try lq or bdf"
    )


def solve(problem: InversionProblem, h: float) -> MethodResult:
    """Solve by index reduction and IDAS, sampled every millisecond or finer.

    Option ``rtol``: the relative tolerance (default 1e-11). IDAS chooses its steps; ``h`` bounds
    the sampling interval.
    """
    problem.check_options("reduced", "rtol")
    rtol = problem.options.get("rtol", RTOL)
    if not isinstance(rtol, float) or not 1e-13 <= rtol <= 1e-4:
        raise ArgumentError(
            f"options: method reduced was given rtol {rtol!r}, expected a float from 1e-13 to 1e-4"
        )
    check_causal(problem, "reduced")
    dae = dae_of(problem)
    dummies = DummyDerivatives(dae, *offsets(dae))
    x_eq = dae.pack(problem.equilibrium)
    try:
        dummies.choose(
            dummies.at_rest(x_eq), dae.targets(problem.path.sample(np.zeros(1)), dummies.orders)[0]
        )
    except SolverError as error:
        raise ArgumentError(
            f"method reduced does not apply to model {dae.model.name}: {error}"
        ) from None
    t = instants(problem, min(h, problem.step))
    found = integrate(dummies, problem.path, t, x_eq, rtol)
    x, dx = dummies.states_of(found.Y)
    return result_of_states(
        problem,
        dae,
        States(t, x, dx),
        iterations=found.iterations,
        intervals=found.steps or len(t) - 1,
        verdict="SUNDIALS IDAS",
        details={
            "states": found.freedom,
            "choices": found.choices,
            "differentiations": dummies.orders,
            "rtol": found.rtol,
        },
    )
