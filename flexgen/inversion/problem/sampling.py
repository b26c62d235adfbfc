"""Arguments and results of the inversion in C: the sampling grid, samples of the path, and the
method result.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.problem.motor_side import MotorMotion
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.model.elements import LinearSpring
from flexgen.paths.path import Path

if TYPE_CHECKING:
    from flexgen.runtime.inversion.path_inversion import Inversion

SAMPLES = 900_000  # at most
SAMPLED = 4  # samples of the torque in each interval of a program's mesh, at least
# s: the longest interval; samples of each with a force, under which motors reverse
COARSEST = 1e-2
PER_INTERVAL = 8


def grid(problem: InversionProblem, h: float) -> tuple[int, float, int, int, int]:
    """Grid of an inversion in C with intervals of about ``h`` [s].

    Returns
    -------
    samples : int
        On the path, with both ends.
    period : float [s]
    samples_per_interval : int
    before, after : int
        Samples before and after the path.

    Raises
    ------
    ArgumentError
        The mesh makes more samples than the inversion takes.
    """
    duration = problem.path.duration
    before, after = problem.windows
    refined = min(h / COARSEST, 1.0)
    step = problem.step
    if problem.mesh is None and problem.limits is None:
        # motions of a program may be short; that of other paths is sampled finer on a refined mesh
        step = min(step, h / (SAMPLED if len(problem.path.segments) > 1 else PER_INTERVAL))
        h = min(h, max(problem.resolving, problem.step))
    if problem.force is not None:
        if problem.mesh is None:  # finer with the mesh that is asked for
            h = min(h, problem.force.resolving * refined)
        step = min(problem.sampling, h / PER_INTERVAL)
    if problem.preview is not None:
        before = float(problem.preview)
    gears = [
        c.dof.gear
        for c in problem.equations.model.coordinates
        if c.dof is not None and c.dof.gear is not None
    ]
    linear = all(gear.rigid or isinstance(gear.spring, LinearSpring) for gear in gears)
    # where a gear's stiffness changes, its deflection is less smooth
    step = step if linear else step / 2
    steps = int(np.ceil(duration / min(step, h) - 1e-9))
    whole = (duration + before + after) / duration
    if whole * steps > SAMPLES:
        coarser = int(SAMPLES / whole)
        if coarser < 1 or duration / coarser > h:
            raise ArgumentError(
                f"mesh: given {h:.3g} s, which makes {whole * duration / h:.3g} intervals over "
                f"{whole * duration:.3g} s, expected at most {SAMPLES}; take a coarser --mesh, "
                "a shorter --preview or a shorter move"
            )
        steps = coarser
    period = duration / steps
    samples_per_interval = max(1, round(h / period))
    return (
        steps + 1,
        period,
        samples_per_interval,
        int(np.ceil(before / period - 1e-9)),
        int(np.ceil(after / period - 1e-9)),
    )


def samples(
    reduction: Reduction, path: Path, period: float, n: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Output (n, n_t) and its first two time derivatives (n, n_y) at n samples of a path."""
    sample = path.sample_orders(np.arange(n) * period, 3)
    return tuple(
        np.ascontiguousarray(x)
        for x in (reduction.targets(sample), sample.derivative(1), sample.derivative(2))
    )  # type: ignore[return-value]


def sample_force(problem: InversionProblem, t: np.ndarray) -> np.ndarray | None:
    """Force on the output and two derivatives (n, 3 n_y) at instants (n,) [s] of a path; None
    where there is none.
    """
    return None if problem.force is None else problem.force.on_output(problem.equations.model, t)


def from_library(found: Inversion, warnings: tuple[str, ...] = ()) -> MethodResult:
    """The method result of an inversion in C; motor accelerations by differences, for plots and
    residuals.

    SolverError where a torque is not finite.
    """
    t = found.t
    step = t[1] - t[0]
    if not np.isfinite(found.tau_m).all():
        raise SolverError(
            "the library returned torques that are not finite; try another --mesh or a smoother "
            "move"
        )
    return MethodResult(
        t,
        found.q_a,
        found.v_a,
        found.a_a,
        found.tau_g,
        MotorMotion(found.q_m, found.v_m, time_derivative(found.v_m, step), found.tau_m),
        preactuation=found.n_pre * found.period,
        iterations=found.iterations,
        intervals=found.intervals,
        details={
            "residual": found.residual,
            "residual_at_samples": found.residual_at_samples,
            "converged": found.converged,
            "kinematic_mismatch": found.kinematic_mismatch,
            **({"torque_error": found.torque_error} if np.isfinite(found.torque_error) else {}),
        },
        warnings=warnings,
    )


def time_derivative(x: np.ndarray, step: float) -> np.ndarray:
    """Time derivative of samples (n, m) by central differences of order six; constant before and
    after.
    """
    later, earlier = _neighbors(x)
    one, two, three = (b - a for a, b in zip(earlier, later, strict=True))
    return (45 * one - 9 * two + three) / (60 * step)


def second_time_derivative(x: np.ndarray, step: float) -> np.ndarray:
    """Second time derivative of samples (n, m) by central differences of order six; constant
    before and after.
    """
    later, earlier = _neighbors(x)
    one, two, three = (a + b - 2 * x for a, b in zip(earlier, later, strict=True))
    return (270 * one - 27 * two + 2 * three) / (180 * step**2)


def differentiate(x: np.ndarray, step: float, *, settled: bool = False) -> np.ndarray:
    """Samples (n, m) with these two derivatives, (n, m, 3); ``settled``: the last one rests, after
    a small jump.
    """
    moving = x[: len(x) - settled]
    for _ in range(4 * settled):  # the motion before the jump, continued by parabolas
        moving = np.concatenate([moving, 3 * (moving[-1:] - moving[-2:-1]) + moving[-3:-2]])
    found = np.stack(
        [f(moving, step)[: len(x)] for f in (time_derivative, second_time_derivative)], axis=2
    )
    found[len(x) - settled :] = 0.0
    return np.concatenate([x[:, :, None], found], axis=2)


def _neighbors(x: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The samples one, two and three later, and earlier; constant before and after."""
    padded = np.concatenate([np.repeat(x[:1], 3, axis=0), x, np.repeat(x[-1:], 3, axis=0)])
    later, earlier = (
        [padded[3 + s * k : len(padded) - 3 + s * k] for k in (1, 2, 3)] for s in (1, -1)
    )
    return later, earlier
