"""The end of a solution: at equilibrium, where the motion after the path has decayed.

After the path the output rests and the torques follow the motion of the stable zeros until it has
decayed. The last sample is the equilibrium, whose torque a controller holds from there on. The
remaining motion moves the tool: by about the displacement of the output that the deflections still
make, and by the velocity that they have, over the time that the torque is held. Joints whose
torque is held keep their momentum: their mean velocity is that of D v_e, even where the output
does not depend on the deflections, as where the joints are the output.

    size(t) = max over t' >= t and X in {W_e, D} of  max(|X (q_e - q_e,end)|, T_HELD |X v_e|),
    dy/dt = W v_a
    D = W_g M_gg^-1 M_ge - W_e

Deflections of damped gears decay with D / K; the last sample is not before their
`InversionProblem.gear_settling`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from flexgen.base.calls.deadline import check_time
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.output_columns import output_units
from flexgen.dynamics.mechanics.statics import Equilibrium, equilibrium_at, gear_lag_times
from flexgen.inversion.judge.undamped import describe_swing
from flexgen.inversion.problem.problem import HELD, LAGS, LONGEST_SETTLING, InversionProblem
from flexgen.inversion.problem.sampling import SAMPLES

if TYPE_CHECKING:
    from flexgen.runtime.inversion.path_inversion import Inversion

SETTLED = 1e-3  # of the accuracy: largest residual motion at the end
NOTED = 1e-2  # of the accuracy: residual motion at the end from which a warning is given
SHORTEST = 0.05  # s after the path
LONGEST_DECAY = 200.0  # s after the path, where vibrations decay slowly
MARGIN = 1.1  # of the time of their decay
REDUCED = 0.1  # of the motion, at most, is left where more time is taken


def invert_until_settled(
    problem: InversionProblem, invert: Callable[[int], Inversion], n_post: int
) -> tuple[Inversion, tuple[str, ...]]:
    """The inversion until nothing moves any more after the path, to equilibrium, and warnings.

    Where the motion has not decayed, it is computed again with the time that it needs by the
    slowest zero at the end of the path, at most ``LONGEST_DECAY``; not where it would still move
    the output by more than the accuracy then.

    Parameters
    ----------
    problem : InversionProblem
    invert : callable
        The inversion with a number of samples after the path.
    n_post : int
        Samples of ``problem.windows`` after the path.

    Returns
    -------
    Inversion
        With ``n_post`` of the samples that are kept; the last one is the equilibrium.
    tuple of str
        A warning where the motion has not decayed at the last sample.
    """
    while True:
        check_time(f"inversion until {n_post} samples after the path")
        found = invert(n_post)
        if found.n_post == 0:
            return found, ()
        end = equilibrium_at(problem.at_rest(problem.path.duration), found.q_a[-1])
        if problem.equations.model.n_e == 0:
            return _cut(found, found.n_post, end), slow_gears(problem)
        size = _measure_remaining(problem, found, end)
        moving = np.flatnonzero(size > SETTLED * problem.accuracy)
        last = int(moving[-1]) + 1 if len(moving) else 0
        if last < len(size):
            fewest = min(
                found.n_post, int(np.ceil(max(SHORTEST, problem.gear_settling) / found.period))
            )
            return _cut(found, max(last + 1, fewest), end), slow_gears(problem)
        if size[-1] > NOTED * problem.accuracy and problem.undamped is not None and problem.swings:
            period = 1 / problem.undamped.frequencies_hz[0]
            shown = min(max(HELD, period), LONGEST_SETTLING)
            if found.n_post * found.period < shown - found.period:
                n_post = int(np.ceil(shown / found.period))
                continue
            return found, (
                describe_swing(problem.undamped, problem.equations.model, found),
                *slow_gears(problem),
            )
        if problem.windows[1] < LONGEST_SETTLING or size[-1] <= NOTED * problem.accuracy:
            # the motion of all stable zeros has decayed by exp(-SETTLING), or nearly: what is left
            # is rounding, or the ripple of a mesh that does not resolve the fastest of them
            return fade_to_equilibrium(problem, found, end), slow_gears(problem)
        decay = _slowest_decay(problem)
        after = n_post * found.period
        longest = min(LONGEST_DECAY, (SAMPLES - len(found.q_a) + n_post) * found.period)
        longer = min(
            after + MARGIN * decay * np.log(size[-1] / (SETTLED * problem.accuracy)), longest
        )
        left = np.exp((after - longer) / decay)
        if left > REDUCED or left * size[-1] > problem.accuracy:
            units = sorted(set(output_units(problem.equations.model)))
            return found, (
                f"the motion has not decayed {after:.3g} s after the path: the deflections "
                f"still move the output by about {size[-1]:.1e} {' or '.join(units)}, with a "
                f"time constant of {decay:.3g} s; the simulated error covers {HELD:g} s with "
                "the last torque held; damp the springs that are not actuated, or excite them "
                "less by a slower or smoother move",
            )
        problem.log(
            f"vibrations decay with {decay:.3g} s: inverting until {longer:.3g} s after the path"
        )
        n_post = int(longer / found.period)


def _slowest_decay(problem: InversionProblem) -> float:
    """Time constant of the slowest zero at the end of the path that is not unstable [s]; infinite:
    it is undamped.
    """
    from flexgen.analysis.zero_dynamics.zeros import ON_AXIS

    zeros = problem.zeros[-1][1]
    damping = -zeros.real[zeros.real <= ON_AXIS * np.abs(zeros)]
    return float(1 / damping.min()) if len(damping) and damping.min() > 0 else np.inf


def slow_gears(problem: InversionProblem) -> tuple[str, ...]:
    """A warning where the deflection of a damped gear has not decayed at the last sample."""
    lag = float(gear_lag_times(problem.equations).max(initial=0.0))
    if LAGS * lag <= problem.gear_settling:
        return ()
    return (
        f"the deflection of a damped gear decays with D/K = {lag:.3g} s and has not decayed "
        f"{problem.gear_settling:g} s after the path; the simulated error covers {HELD:g} s "
        "with the last torque held; check the stiffness and the damping of the gear",
    )


def _measure_remaining(
    problem: InversionProblem, found: Inversion, end: Equilibrium
) -> np.ndarray:
    """Bound (n_post,) of what the motion after the path still does to the output, from each sample
    to the end [m or rad].

    It is the largest of the deflections from the equilibrium ``end`` and of their speeds times
    `HELD` [s], as seen by the output with held and with free joints.
    """
    equations = problem.equations
    model = problem.equations.model
    i_g = list(model.i_g)
    i_e = list(model.i_e)
    target = np.zeros(model.output.target_size)
    W = evaluate(
        equations.function("output_constraint"), found.q_a[-1], 0.0 * found.q_a[-1], target
    )[1]
    W = W.reshape(-1, model.n_a)
    M = evaluate(equations.function("mass_matrix"), found.q_a[-1])[0].reshape(model.n_a, model.n_a)
    drift = W[:, i_g] @ np.linalg.solve(M[np.ix_(i_g, i_g)], M[np.ix_(i_g, i_e)]) - W[:, i_e]
    after = slice(len(found.q_a) - found.n_post, None)
    deflections = found.q_a[after][:, i_e] - end.q_a[i_e]
    speeds = HELD * found.v_a[after][:, i_e]
    sizes = [
        np.linalg.norm(x @ X.T, axis=1) for X in (W[:, i_e], drift) for x in (deflections, speeds)
    ]
    size = np.max(sizes, axis=0)
    return np.maximum.accumulate(size[::-1])[::-1]


def fade_to_equilibrium(
    problem: InversionProblem, found: Inversion, end: Equilibrium
) -> Inversion:
    """The inversion with deviations from the equilibrium that fade out in the second half of the
    time after the path.

    ``x -> x_end + w (x - x_end)`` with a polynomial w(t) from 1 to 0; the torque has the inertia
    of the rotors in it: ``tau_m -> tau_end + w (tau_m - tau_end) + J_m (2 w' v_m + w'' (q_m -
    q_end))``.
    """
    n = max(2, found.n_post // 2)
    u = np.linspace(0.0, 1.0, n)[:, None]
    # three derivatives are zero at both ends
    fade = np.polynomial.Polynomial([1, 0, 0, 0, -35, 84, -70, 20])
    w, dw, ddw = (fade.deriv(k)(u) / ((n - 1) * found.period) ** k for k in range(3))
    arrays = {
        name: getattr(found, name).copy()
        for name in ("q_a", "v_a", "a_a", "tau_g", "q_m", "v_m", "tau_m")
    }
    q_a, v_a, a_a, tau_g, q_m, v_m, tau_m = (x[-n:] for x in arrays.values())  # views
    inertia = np.array([motor.inertia for motor in problem.equations.model.motors])
    tau_m[:] = (
        end.tau_m + w * (tau_m - end.tau_m) + inertia * (2 * dw * v_m + ddw * (q_m - end.q_m))
    )
    tau_g[:] = end.tau_g + w * (tau_g - end.tau_g)
    a_a[:] = w * a_a + 2 * dw * v_a + ddw * (q_a - end.q_a)
    for q, v, last in ((q_a, v_a, end.q_a), (q_m, v_m, end.q_m)):
        v[:] = w * v + dw * (q - last)
        q[:] = last + w * (q - last)
    return replace(found, **arrays)


def _cut(found: Inversion, n_post: int, end: Equilibrium) -> Inversion:
    """The inversion with the first ``n_post`` samples after the path, the last one replaced by the
    equilibrium.
    """
    keep = len(found.q_a) - found.n_post + n_post
    last = {
        "q_a": end.q_a,
        "v_a": 0.0,
        "a_a": 0.0,
        "tau_g": end.tau_g,
        "q_m": end.q_m,
        "v_m": 0.0,
        "tau_m": end.tau_m,
    }
    arrays = {name: getattr(found, name)[:keep].copy() for name in last}
    for name, value in last.items():
        arrays[name][-1] = value
    return replace(found, **arrays, n_post=n_post)
