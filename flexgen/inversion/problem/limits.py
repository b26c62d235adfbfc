"""Inverse dynamics within limits: the smallest path deviation that keeps bounds on torque, speed
and deflection.

A quadratic program modifies the path, and the modified path is inverted. With coefficients c of a
smooth deviation d(t) from the path, splines of degree seven that may begin before the path and end
after it,

    min  mean |d|^2 / e^2 + rho mean |d''''|^2
    s.t.  |x_k(t_i) + sum_j dx_k/dc_j (t_i) dc_j| <= bound_k,

x: motor torques and their rates, motor speeds, deflections, torques of gears, speeds and
accelerations of joints and the tool, and edges of torque-speed curves. The Jacobian dx/dc is found
by differences of inversions of modified paths; splines whose responses do not overlap share one
inversion. Friction is not linear: it is added to the other torques at the speeds after the step.
The modified path is inverted again, and the next program starts from that motion. All this is
`invert_limited` of the emitted C, see ``flexgen/codegen/clib/invert_limited.c``; here it gets the
time before and after the path.

Source: J. Nocedal, S. Wright, Numerical Optimization, 2006, ch. 18 (sequential quadratic
programming).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import SolverError
from flexgen.dynamics.hysteresis.lugre import bristle_torques, motor_bristles
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.limit_use import uses_of_limits
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.dynamics.mechanics.statics import reach
from flexgen.inversion.judge.status import Status
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.problem.model_library import inversion_library
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import from_library, sample_force
from flexgen.model.friction import bristled_motors, memory_laws
from flexgen.runtime.inversion.limited_inversion import LimitsInfeasibleError
from flexgen.runtime.inversion.path_inversion import Inversion

KNOTS = 30  # intervals between knots of the deviation on the path
PER_KNOT = 2  # intervals of the mesh between knots, at least
SUPPORT = 8  # intervals between knots in which one spline is not zero
LATE = 0.5  # of the path's duration: how long after it the motion may end
UNKEPT = ("torque_rms", "thermal_time", "gear_torque_rms")  # effective values of a whole motion
# rad, and m for each meter of reach, at most m: largest deviation not reported as LIMITS_ACTIVE
NOTICED = 1e-6


class _Bounds:
    """Bounds of what `invert_limited` keeps."""

    def __init__(self, equations: Equations, limits: Limits) -> None:
        model = equations.model
        self.limits = limits.without(*UNKEPT)
        self.arguments = limits.for_library(model)  # of `Library.invert_limited`
        self.torque = self.arguments["torque_max"]
        self.deflection = self.arguments["deflection_max"]

    def are_kept(self, problem: InversionProblem, found: Inversion) -> bool:
        """Whether a motion keeps all of them."""
        time = found.period * np.arange(len(found.tau_m))
        uses = uses_of_limits(
            problem.equations.model,
            self.limits,
            lambda name: np.asarray(getattr(found, name)),
            time,
        )
        return all(use.part <= 1.0 for use in uses)

    def check_equilibrium(self, problem: InversionProblem) -> None:
        """SolverError where the arm cannot be held at an end of the path."""
        model = problem.equations.model
        path = problem.path
        for t, guess in ((0.0, path.q_start), (path.duration, None)):
            reduction = Reduction(problem.at_rest(t))
            if guess is None:
                ends = np.linspace(0.0, path.duration, 65)
                guess = reduction.follow(path, ends, reduction.start(path).q_a)[-1]
            equilibrium = reduction.equilibrium(path, t, guess)
            for j, motor in enumerate(model.motors):
                if not abs(equilibrium.tau_m[j]) <= self.torque[j]:
                    raise SolverError(
                        f"limits: motor {motor.name} needs {abs(equilibrium.tau_m[j]):.4g} N m "
                        "to hold the arm at rest at the ends of the path, its limit is "
                        f"{self.torque[j]:.4g} N m; raise it or choose another path"
                    )
            for i, bound in zip(model.i_e, self.deflection, strict=True):
                if not abs(equilibrium.q_a[i]) <= bound:
                    raise SolverError(
                        f"limits: coordinate {model.coordinates[i].name} is deflected by "
                        f"{abs(equilibrium.q_a[i]):.4g} at rest at the ends of the path, "
                        f"its limit is {bound:.4g}; raise it or choose another path"
                    )


def enforce_limits(
    problem: InversionProblem, unlimited: Inversion, samples_per_interval: int, tolerance: float
) -> MethodResult:
    """The result that keeps the limits: that of the path where no limit is active, else that of a
    modified path.

    Parameters
    ----------
    problem : InversionProblem
        With limits.
    unlimited : Inversion
        Of the path itself.
    samples_per_interval, tolerance : int, float
        Arguments of the inversion, see `flexgen.runtime.inversion.path_inversion.Inverter`.

    Raises
    ------
    SolverError
        The limits cannot be kept: in equilibrium at an end of the path, or within the duration of
        the motion.
    """
    assert problem.limits is not None
    bounds = _Bounds(problem.equations, problem.limits)
    robot = problem.equations.model
    memory = memory_laws(robot)
    if not memory and bounds.are_kept(problem, unlimited):
        return from_library(unlimited)
    bounds.check_equilibrium(problem)
    check_time("limits")
    problem.log("limits: finding the smallest path deviation")
    before, found = _modify_path(problem, bounds, unlimited, samples_per_interval, tolerance)
    if memory and not found.limits_active:
        return from_library(unlimited)
    result = from_library(found)
    pose = problem.path.pose
    if bristled_motors(robot):  # their torques are in those of the library with memory
        torques = bristle_torques(
            motor_bristles(robot), result.t, result.motors.v_m, result.motors.a_m
        )
        result = replace(result, tau_b=torques)
    meters = found.deviation_m
    angle = found.deviation_rad
    turns = pose or robot.output.has_angle
    size = f"{meters:.3g} m" + (f" and {angle:.3g} rad" if turns else "")
    off = max(meters / min(1.0, reach(problem.equations)), angle)
    return replace(
        result,
        t=result.t - before * found.period,
        preactuation=(before + found.n_pre) * found.period,
        status=Status.LIMITS_ACTIVE if off > NOTICED else Status.SOLVED,
        verdict=f"the limits are active: path deviation up to {size}, {found.programs} quadratic "
        "programs",
        details={
            **result.details,
            "deviation_max_m": meters,
            "deviation_max_rad": angle,
            "programs": found.programs,
        },
    )


def check_limits_at_rest(problem: InversionProblem) -> None:
    """SolverError where the limits do not let the arm rest at an end of the path; nothing where
    there are no limits.
    """
    if problem.limits is not None:
        _Bounds(problem.equations, problem.limits).check_equilibrium(problem)


def _modify_path(
    problem: InversionProblem,
    bounds: _Bounds,
    unlimited: Inversion,
    samples_per_interval: int,
    tolerance: float,
) -> tuple[int, Inversion]:
    """Number of samples before the path, and the inversion of the path that deviates least while
    the limits hold, with time before and after it in which it may move.

    Raises
    ------
    SolverError
        No deviation keeps the limits within the motion.
    """
    path = problem.path
    period = unlimited.period
    duration = problem.path.duration
    knot_samples = max(round(duration / KNOTS / period), PER_KNOT * samples_per_interval)
    spacing = knot_samples * period
    before = int(np.ceil((problem.windows[0] + SUPPORT * spacing) / period))
    after = int(np.ceil((LATE * duration + SUPPORT * spacing) / period))
    t = (np.arange(before + round(duration / period) + after + 1) - before) * period
    sample = path.sample(t)
    native = bool(problem.options.get("native", False))
    solvers = ("invert", "invert_limited", *(() if problem.force is None else ("force",)))
    library = inversion_library(
        problem.equations, "lq", solvers, native=native, memory=True, progress=problem.progress
    )
    try:
        found = library.invert_limited(
            Reduction(problem.equations).targets(sample),
            sample.derivative(1),
            sample.derivative(2),
            period=period,
            q_start=path.q_start,
            **bounds.arguments,
            force=sample_force(problem, t),
            knot_samples=knot_samples,
            n_pre=unlimited.n_pre,
            n_post=unlimited.n_post,
            samples_per_interval=samples_per_interval,
            tolerance=tolerance,
        )
    except LimitsInfeasibleError as error:
        raise SolverError(
            "limits: no path deviation keeps them within a motion that ends "
            f"{t[-1] - duration:.3g} s after the path: a bound is exceeded by "
            f"{error.excess:.2g} of its value; give the move more time or loosen the limits"
        ) from None
    return before, found
