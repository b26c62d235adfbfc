"""Nonlinear programs, solved by IPOPT through CasADi, with the status that IPOPT reports."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from flexgen.base.calls.deadline import UNLIMITED, OutOfTime, check_time, is_late, time_left

Progress = Callable[[str], None]

BUILDING = "IPOPT, building the nonlinear program"
# The status of IPOPT where its own clock ends the iterations.
OUT_OF_TIME = "Maximum_WallTime_Exceeded"

WARM = 1e-6  # barrier and distance from bounds where IPOPT starts near a solution
# A Hessian that is known to be positive semidefinite needs no check of the inertia, which rounding
# makes wrong where hardly anything holds a direction: IPOPT then adds to the Hessian, and its
# steps are far too short.
CONVEX = {"ipopt.neg_curv_test_tol": 1e-30, "ipopt.neg_curv_test_reg": "yes"}
TOLERANCE = 1e-10  # on scaled constraints: an error of 1e-10 rad is 0.1 nm a meter away


@dataclass(frozen=True)
class NlpResult:
    """Result of IPOPT: its ``status``, whether that is a success, iterations, largest violation,
    x.

    ``g``: values of the constraints; ``multipliers``: of the bounds of x and of g, for a warm
    start.
    """

    status: str
    success: bool
    iterations: int
    violation: float
    x: np.ndarray
    g: np.ndarray
    multipliers: tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class NonlinearProgram:
    """Minimize ``cost`` over x, subject to ``lower <= g <= upper``.

    ``jacobian``: of g, where it is known, else by coloring; ``hessian``: of the Lagrangian (upper
    triangle) where an approximation serves, or a function of the multipliers of cost and
    constraints that gives it, else exact; ``convex``: it is positive semidefinite, see `CONVEX`;
    ``gradient``: of the cost, else by differentiation.
    """

    x: ca.MX
    cost: ca.MX
    g: ca.MX
    jacobian: ca.MX | None = None
    hessian: ca.MX | Callable[[ca.MX, ca.MX], ca.MX] | None = None
    gradient: ca.MX | None = None
    convex: bool = False
    lower: np.ndarray | float = 0.0
    upper: np.ndarray | float = 0.0


class _Watch(ca.Callback):
    """Reports each iteration to a progress function, and ends the iterations with the time
    limit.
    """

    def __init__(
        self, n_x: int, lower: np.ndarray, upper: np.ndarray, progress: Progress | None
    ) -> None:
        ca.Callback.__init__(self)
        self.n_x = n_x
        self.n_g = len(lower)
        self.progress = progress
        self.lower = lower
        self.upper = upper
        self.count = 0
        self.began = time.perf_counter()
        self.construct("watch", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        sizes = {"f": 1, "x": self.n_x, "lam_x": self.n_x, "g": self.n_g, "lam_g": self.n_g}
        return ca.Sparsity.dense(sizes.get(ca.nlpsol_out(i), 0), 1)

    def eval(self, arg: list[ca.DM]) -> list[int]:
        """Called by IPOPT after each iteration: print a line; 1, at the end of the time limit,
        ends it.
        """
        if is_late("iteration of IPOPT"):
            return [1]
        if self.progress is None:
            return [0]
        at = {ca.nlpsol_out(i): value for i, value in enumerate(arg)}
        violation = _violation(np.array(at["g"]).ravel(), self.lower, self.upper)
        elapsed = time.perf_counter() - self.began
        self.progress(
            f"IPOPT iteration {self.count:3d}: cost {float(at['f']):10.3e}, constraints "
            f"{violation:9.2e}, {elapsed:6.1f} s"
        )
        self.count += 1
        return [0]


def _violation(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> float:
    return float(np.max(np.maximum(np.maximum(lower - values, values - upper), 0.0), initial=0.0))


def _options(max_iterations: int, tolerance: float, optimality: float) -> dict[str, Any]:
    """Options of IPOPT; ``tolerance``: of the constraints, ``optimality``: of the conditions of a
    minimum.
    """
    return {
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": max_iterations,
        "ipopt.tol": optimality,
        "ipopt.constr_viol_tol": tolerance,
        "ipopt.acceptable_iter": 0,
        "ipopt.nlp_scaling_method": "none",
        "ipopt.linear_solver": "mumps",
        "ipopt.mumps_mem_percent": 200,
        "error_on_fail": False,
        "no_nlp_grad": True,  # not needed here, and compiled functions have no such derivatives
    }


def solve_nlp(
    program: NonlinearProgram,
    guess: np.ndarray,
    *,
    multipliers: tuple[np.ndarray, np.ndarray] | None = None,
    bounds_x: tuple[np.ndarray, np.ndarray] | None = None,
    progress: Progress | None = None,
    max_iterations: int = 200,
    tolerance: float = TOLERANCE,
    optimality: float | None = None,
) -> NlpResult:
    """Solve a program from a ``guess`` (n_x,), with x in ``bounds_x``, lower and upper (n_x,).

    ``multipliers``: of bounds and constraints, of a solution nearby, whose x is the guess.
    ``tolerance``: of the constraints; ``optimality``: of the conditions of a minimum, default the
    same. The success that IPOPT reports is checked with the constraints.

    OutOfTime where a time limit ends first, see `flexgen.base.calls.deadline`.
    """
    check_time(BUILDING)
    x = program.x
    cost = program.cost
    g = program.g
    jacobian = program.jacobian
    hessian = program.hessian
    n_g = g.shape[0]
    options = _options(max_iterations, tolerance, optimality or tolerance)
    p = ca.MX.sym("p", 0)
    if jacobian is not None:
        options["jac_g"] = ca.Function("nlp_jac_g", [x, p], [g, jacobian])
    if hessian is not None:
        lam_f = ca.MX.sym("lam_f")
        lam_g = ca.MX.sym("lam_g", n_g)
        of_lagrangian = hessian(lam_f, lam_g) if callable(hessian) else lam_f * ca.triu(hessian)
        options["hess_lag"] = ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [of_lagrangian])
    if program.convex:
        options |= CONVEX
    if program.gradient is not None:
        options["grad_f"] = ca.Function("nlp_grad_f", [x, p], [cost, program.gradient])
    if multipliers is not None:
        near = {"warm_start_init_point": "yes", "mu_init": WARM, "warm_start_bound_push": WARM}
        near |= {"warm_start_mult_bound_push": WARM, "warm_start_slack_bound_push": WARM}
        options |= {f"ipopt.{name}": value for name, value in near.items()}
    lower, upper = (np.broadcast_to(bound, n_g) for bound in (program.lower, program.upper))
    left = time_left()
    # kept until the end: CasADi does not hold it
    watch = None
    if progress is not None or left < UNLIMITED:
        watch = _Watch(x.shape[0], lower, upper, progress)
        options["iteration_callback"] = watch
    options["ipopt.max_wall_time"] = left
    solver = ca.nlpsol("nlp", "ipopt", {"x": x, "f": cost, "g": g, "p": p}, options)
    check_time(BUILDING)
    arguments: dict[str, Any] = {"x0": guess, "lbg": lower, "ubg": upper}
    if bounds_x is not None:
        arguments["lbx"], arguments["ubx"] = bounds_x
    if multipliers is not None:
        arguments["lam_x0"], arguments["lam_g0"] = multipliers
    try:
        answer = solver(**arguments)
    except Exception:  # CasADi reports Ctrl-C as an error of its own
        check_time("IPOPT")
        raise
    stats = solver.stats()
    violation = _violation(np.array(answer["g"]).ravel(), lower, upper)
    # the success that IPOPT reports is checked: the constraints have to hold
    success = (
        bool(stats["success"]) and violation <= 100 * tolerance and bool(np.isfinite(violation))
    )
    if not success:
        stage = f"IPOPT, iteration {int(stats['iter_count'])}, largest violation {violation:.2e}"
        check_time(stage)
        if stats["return_status"] == OUT_OF_TIME:
            raise OutOfTime(stage)
    return NlpResult(
        status=str(stats["return_status"]),
        success=success,
        iterations=int(stats["iter_count"]),
        violation=violation,
        x=np.array(answer["x"]).ravel(),
        g=np.array(answer["g"]).ravel(),
        multipliers=(np.array(answer["lam_x"]).ravel(), np.array(answer["lam_g"]).ravel()),
    )
