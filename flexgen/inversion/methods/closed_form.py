"""Inverse dynamics in closed form, for models without non-actuated coordinates.

The motion of the arm follows from the path and its derivatives at each instant,

    Gamma(q) = Z,   W v = Z',   W a + W' v = Z'',  ...,      tau_g = M(q) a + c(q, v) + g(q)

and the motors follow from the gear torques (`flexgen.inversion.problem.motor_side`). Where the
path gives the torque kinks, its samples do not have the impulse of the torque, and the robot
drifts;
derivatives of the gear torques by differences over the samples, also before the path, have it.
After the path the arm rests while the deflections of damped gears decay, with the time constant
D / K; the last sample is the equilibrium.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexgen.base.calls.progress import EVERY, tell_every
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.statics import equilibrium_at
from flexgen.inversion.judge.settling import slow_gears
from flexgen.inversion.methods.method_result import MethodResult, with_motors
from flexgen.inversion.problem.motor_side import MotorMotion
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import differentiate
from flexgen.model.abilities import obstacle

SAMPLES = 200_000  # at most


def solve(problem: InversionProblem, h: float) -> MethodResult:
    """Solve in closed form at each sample; ``h`` is not used. No options."""
    problem.check_options("closed-form")
    equations = problem.equations
    path = problem.path
    if (reason := obstacle(equations.model, "closed form")) is not None:
        raise ArgumentError(f"method closed-form: {reason}; use lq")
    t, n_post = instants(path.duration, problem.sampling, problem.gear_settling)
    step = t[1] - t[0]
    kinks = problem.smoothness.has_kinks
    n_pre = int(np.ceil(problem.windows[0] / step)) if kinks else 0
    t = np.r_[-step * np.arange(n_pre, 0, -1), t]
    sample = path.sample(t)
    reduction = moving = Reduction(equations)
    if problem.force is not None:
        moving = Reduction(equations.pushed, problem.force.jets(t))
    if sample.q_g is not None:
        motion = moving.joint_motion(sample.q_g)
    else:
        q = reduction.close(
            reduction.follow(path, t, reduction.start(path).q_a), reduction.targets(sample)
        )
        tell = tell_every(EVERY, lambda line: problem.log(f"closed form: {line}"))
        found, _ = moving.motion(sample, q, np.zeros((len(t), 0)), tell)
        if found is None:
            raise SolverError(
                f"move {path.move.name}: the path passes a singular pose; choose another path"
            )
        motion = found
    motion = replace(motion, tau_g=differentiate(motion.tau_g[:, :, 0], step)) if kinks else motion
    result = with_motors(equations, t, motion, preactuation=n_pre * step)
    end = problem.at_rest(path.duration)
    return (
        replace(_append_equilibrium(end, result), warnings=slow_gears(problem))
        if n_post
        else result
    )


def instants(duration: float, step: float, settling: float) -> tuple[np.ndarray, int]:
    """Instants [s] at most ``step`` apart from the start of a path to ``settling`` after it, and
    their number after it.

    All intervals are equal, and the end of the path is one of the instants.
    """
    n = int(min(np.ceil(duration / step), SAMPLES))
    n_post = int(min(np.ceil(settling * n / duration), SAMPLES))
    return np.r_[
        np.linspace(0.0, duration, n + 1), duration + duration / n * np.arange(1, n_post + 1)
    ], n_post


def _append_equilibrium(equations: Equations, result: MethodResult) -> MethodResult:
    """The result with the equilibrium as its last sample."""
    end = equilibrium_at(equations, result.q[-1])
    motors = result.motors
    last = {"q_m": end.q_m, "v_m": 0.0, "a_m": 0.0, "tau_m": end.tau_m}
    arrays = {name: getattr(motors, name).copy() for name in last}
    for name, value in last.items():
        arrays[name][-1] = value
    return replace(result, motors=MotorMotion(**arrays))
