"""Common parts of the initial-value methods: where they apply, their instants, and results from
states of the DAE.

They integrate forward in time from equilibrium, so the zero dynamics has to be stable: with an
unstable zero z an error grows like exp(z t).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.dae.system import InverseDae
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.problem.motor_side import MotorMotion, gear_torques
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.model.abilities import obstacle

STEPS = 200_000  # at most


def check_causal(problem: InversionProblem, method: str, differentiates: bool = True) -> None:
    """ArgumentError where an initial-value method does not apply; the text gives the reason and
    the method to use.

    ``differentiates``: the method differentiates the equations of motion.
    """
    model = problem.equations.model
    reason = obstacle(model, "reduced problem")
    if reason is not None:
        raise ArgumentError(f"method {method}: {reason}; use full")
    reason = obstacle(model, "simplified coupling")
    if reason is not None:
        raise ArgumentError(f"method {method}: {reason}; use lq, bvp or full")
    reason = obstacle(model, "differentiated equations") if differentiates else None
    if reason is not None:
        raise ArgumentError(f"method {method}: {reason}; use bdf or full")
    zero = problem.unstable_zero
    if zero is None:
        return
    value = f"{zero.value.real:+.4g}" + (
        f" +- {abs(zero.value.imag):.4g}i" if zero.value.imag else ""
    )
    raise ArgumentError(
        f"method {method}: the zero dynamics of model {model.name} along move "
        f"{problem.path.move.name} is unstable, with a zero at {value} 1/s at t = {zero.t:.4g} "
        "s, and a motion that is integrated from the start diverges; expected a stable zero "
        "dynamics; use lq, bvp or collocation"
    )


def zeros_along(problem: InversionProblem) -> np.ndarray:
    """Zeros of the output [1/s] at all poses of the path where the problem has them."""
    found = [zeros for _, zeros in problem.zeros]
    return np.concatenate(found) if found else np.zeros(0)


def dae_of(problem: InversionProblem) -> InverseDae:
    """The DAE of a problem; where all coordinates are actuated, a joint move prescribes the
    coordinates.
    """
    joints = problem.equations.model.n_e == 0 and problem.path.sample(np.zeros(1)).q_g is not None
    return InverseDae(problem.equations, joints)


def instants(problem: InversionProblem, step: float) -> np.ndarray:
    """Equidistant instants from the start, or a preview before it, to the end of the settling
    time.

    The ends of the path are among them; ``step`` [s] is the largest distance.
    """
    duration = problem.path.duration
    on_path = max(1, int(np.ceil(duration / step - 1e-9)))
    h = duration / on_path
    before = int(np.ceil((problem.preview or 0.0) / h - 1e-9))
    after = int(np.ceil(problem.windows[1] / h))
    if before + on_path + after > STEPS:
        raise ArgumentError(
            f"mesh: given steps of {h:.3g} s, which makes {before + on_path + after}, expected "
            f"at most {STEPS}; take a coarser --mesh or a shorter move"
        )
    return h * np.arange(-before, on_path + after + 1)


@dataclass(frozen=True, eq=False)
class States:
    """States of a DAE at instants: ``t`` (n,) [s], ``x`` and its derivative ``dx`` (n, n_x)."""

    t: np.ndarray
    x: np.ndarray
    dx: np.ndarray


def result_of_states(
    problem: InversionProblem,
    dae: InverseDae,
    states: States,
    *,
    iterations: int,
    verdict: str,
    details: Mapping[str, Any],
    intervals: int | None = None,
) -> MethodResult:
    """The method result of states of a DAE.

    Parameters
    ----------
    states : States
        Instants, states x and their rates.
    iterations : int
    verdict : str
        Name of the integrator, for reports and errors.
    details : mapping
    intervals : int, optional
        Of the mesh of the solver, where it is not that of the instants.

    Raises
    ------
    SolverError
        The motion is not finite.
    """
    t = states.t
    x = states.x
    dx = states.dx
    if not (np.isfinite(x).all() and np.isfinite(dx).all()):
        raise SolverError(
            f"{verdict}: the motion is not finite; take a finer --mesh or a smoother move"
        )
    model = problem.equations.model
    n = dae.n
    state = dae.unpack(x)
    i_g = list(model.i_g)
    i_m = list(model.i_m)
    a = dx[:, n : n + model.n_a]
    a_m = a[:, i_g] @ model.eta.T
    a_m[:, i_m] = dx[:, n + model.n_a : 2 * n]
    motors = MotorMotion(state["q_m"], state["v_m"], a_m, state["tau_m"])
    return MethodResult(
        t,
        state["q_a"],
        state["v_a"],
        a,
        gear_torques(problem.equations, state["q_a"], state["v_a"], a, motors),
        motors,
        preactuation=float(max(0.0, -t[0])),
        verdict=verdict,
        iterations=iterations,
        intervals=len(t) - 1 if intervals is None else intervals,
        details=dict(details),
    )
