"""Agreement of a loaded C library with the equations of its model."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations

CALLS = 2000  # that are timed


def compare_library(
    library: Any, equations: Equations, trajectory: Trajectory
) -> dict[str, float]:
    """Compare the inverse dynamics of a loaded library with the equations along a trajectory.

    Returns
    -------
    dict
        ``difference_Nm``: the largest [N m, or N]; ``call_us``: time of one call from Python [us].
    """
    arguments = [trajectory[channel] for channel in ("q_a", "v_a", "a_a")]
    from_c = library.inverse_dynamics(*arguments)
    expected = evaluate(equations.function("inverse_dynamics"), *arguments)[0].reshape(
        from_c.shape
    )
    first = [np.ascontiguousarray(x[0]) for x in arguments]
    began = time.perf_counter()
    for _ in range(CALLS):
        library.inverse_dynamics(*first)
    spent = time.perf_counter() - began
    return {
        "difference_Nm": float(np.abs(from_c - expected).max()),
        "call_us": 1e6 * spent / CALLS,
    }
