"""Time scaling until all limits hold; bisection where the excess decreases slowly."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import SolverError

KEPT = 4e-4  # relative excess of a limit that is kept
# limits of a whole motion, not of each instant
MEANS = ("torque_rms", "thermal_time", "gear_torque_rms")
# steps before they grow, factor of each later one, steps at most
PLAIN = 20
GROWTH = 1.5
ROUNDS = 200
CLOSER = 1e-4  # of the duration: steps of the bisection, at last
SLOWEST = 30.0  # times the duration, at most
LEAST = 3e-4  # excess that gives the smallest step


def slow_down(
    x: list[np.ndarray],
    excess: Callable[[list[np.ndarray]], np.ndarray],
    slower: Callable[[list[np.ndarray], np.ndarray], list[np.ndarray]],
    kept: float,
) -> tuple[list[np.ndarray] | None, list[tuple[float, float]]]:
    """Slow time laws down by steps as small as the excess; after several steps that do not
    suffice, by growing steps and bisection.

    Parameters
    ----------
    x : list of arrays
        Of each motion its duration [s] and coefficients.
    excess, slower : callable
        Excess of the limits of each motion, relative; time laws slowed down by a part of some
        excesses.
    kept : float
        Largest excess that is left.

    Returns
    -------
    found : list of arrays or None
        None: a limit is exceeded at `SLOWEST` times the duration, or the motion has no
        inversion.
    over : list of tuple
        Durations [s] and largest excesses that were tried by steps.
    """
    over: list[tuple[float, float]] = []
    low = x
    first = _duration(x)

    def measure(x: list[np.ndarray]) -> np.ndarray:
        check_time("fastest")
        try:
            return excess(x)
        except SolverError:
            return np.full(len(x), np.inf)

    for k in range(ROUNDS):
        each = measure(x)
        over.append((_duration(x), float(each.max())))
        if over[-1][1] <= kept:
            break
        if not np.isfinite(over[-1][1]) or _duration(x) > SLOWEST * first:
            return None, over
        grown = np.minimum(np.maximum(each, LEAST) * GROWTH ** max(k - PLAIN, 0), 1.0)
        low = x
        x = slower(x, np.where(each > 0, np.maximum(each, grown), each))
    else:
        return None, over
    while k > PLAIN and _duration(x) - _duration(low) > CLOSER * _duration(x):
        middle = [(a + b) / 2 for a, b in zip(low, x, strict=True)]
        low, x = (low, middle) if float(measure(middle).max()) <= kept else (middle, x)
    return x, over


def in_words(over: list[tuple[float, float]], means: bool) -> str:
    """Sentence on the excess of the limits at the durations that were tried; ``means``: the limits
    are means, which depend on the whole time law.

    The excess at infinite duration (statics) is extrapolated in the inverse of the duration.
    """
    (before, more), (longest, least) = over[-2:] if len(over) > 1 else over * 2
    shown = False
    if not means and np.isfinite(least) and longest > SLOWEST * over[0][0]:
        shown = least - max(more - least, 0.0) * before / (longest - before) > KEPT
    speeds = "at any speed" if shown else f"at the speeds that were tried, up to {longest:.4g} s"
    return (
        f"{speeds}; increase them: {'holding the robot' if shown else 'it'} needs "
        f"{1 + least:.6g} of a limit"
    )


def _duration(x: list[np.ndarray]) -> float:
    return sum(float(part[0]) for part in x)
