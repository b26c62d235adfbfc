"""Accelerations of robots with closed loops against own equations with multipliers."""

from __future__ import annotations

import numpy as np

import flexgen
from flexgen.model.format.closure import closed_values
from tests.support.linkages import home_of
from tests.support.multipliers import Multipliers

SPREAD = {"rad": 0.2, "m": 3e-3}


def worst_of(model: flexgen.RobotModel, count: int, spread: float = 1.0) -> float:
    """Largest relative difference of the accelerations at drawn states."""
    own = Multipliers(model)
    equations = flexgen.derive(model)
    forward = equations.function("forward_dynamics")
    rng = np.random.default_rng(7)
    home = home_of(model)
    scale = np.array([SPREAD[c.unit] * (1.0 if c.actuated else 0.1) for c in model.coordinates])
    worst = 0.0
    for _ in range(count):
        q = home + spread * scale * rng.uniform(-1.0, 1.0, model.n_a)
        v = rng.uniform(-2.0, 2.0, model.n_a) * scale / scale.max()
        near = closed_values(model, q)
        at = own.close(q, np.array([near[name] for name in own.passive]) + 1e-3)
        q_m = model.eta @ q[list(model.i_g)] + rng.uniform(-0.1, 0.1, model.n_m)
        v_m = model.eta @ v[list(model.i_g)] + rng.uniform(-1.0, 1.0, model.n_m)
        tau = rng.uniform(-5.0, 5.0, model.n_m)
        expected = own.motion(at, v, q_m, v_m, tau)
        found = [np.array(x).ravel() for x in forward(q, v, q_m, v_m, tau)]
        for a, b in zip(found, expected, strict=True):
            worst = max(worst, float(np.abs(a - b).max() / np.abs(b).max()))
    return worst
