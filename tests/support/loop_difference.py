"""Difference of two robots with closed loops, at states around home."""

from __future__ import annotations

import numpy as np

import flexgen
from tests.support.linkages import home_of


def loop_difference(
    found: flexgen.RobotModel, expected: flexgen.RobotModel, shift: bool = False
) -> float:
    """Largest relative difference of the accelerations at 20 states around home.

    ``shift``: the coordinates of ``found`` are zero at home.
    """
    rng = np.random.default_rng(3)
    one = flexgen.derive(found).function("forward_dynamics")
    two = flexgen.derive(expected).function("forward_dynamics")
    start = home_of(expected)
    scale = np.array([1.0 if c.unit == "rad" else 1e-3 for c in expected.coordinates])
    worst = 0.0
    for _ in range(20):
        q = start + 0.2 * scale * rng.uniform(-1.0, 1.0, start.size)
        v = 2.0 * scale * rng.uniform(-1.0, 1.0, start.size)
        tau = rng.uniform(-5.0, 5.0, expected.n_m)
        q_m, v_m = (
            expected.eta @ x[list(expected.i_g)] + rng.uniform(-0.1, 0.1, expected.n_m)
            for x in (q, v)
        )
        a, b = (
            np.concatenate([np.array(x).ravel() for x in f(at, v, q_m, v_m, tau)])
            for f, at in ((one, q - start if shift else q), (two, q))
        )
        worst = max(worst, float(np.abs(a - b).max() / np.abs(b).max()))
    return worst
