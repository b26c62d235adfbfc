"""Rates of robots whose gears and motors have states: those of the closed loop are those of the
simulation.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.dynamics.hysteresis.lugre import without_states
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop import hysteresis
from flexgen.feedback.loop.plants import plants_of
from flexgen.simulation.integration.hysteretic_rate import hysteretic_rate

ELEMENTS = [
    {"stiffness": 2e5, "lost_motion": 1e-4},
    {"stiffness": 1e5, "lost_motion": 4e-4, "exponent": 3.0},
]
BRISTLES = {
    "coulomb": 0.5,
    "static": 0.8,
    "stribeck_speed": 4.0,
    "stiffness": 800.0,
    "damping": 1.5,
}


@pytest.mark.parametrize("bristled", [False, True])
def test_rates_of_a_loop_are_those_of_the_simulation(bristled: bool) -> None:
    """In the loop states are parts of the largest torques, and motors stand before the arm's
    speeds.
    """
    changes: dict[str, Any] = {"element.upper.dof.q1.gear.hysteresis": ELEMENTS}
    changes |= {"motor.m2.lugre": BRISTLES} if bristled else {}
    model = flexgen.read("elbow", overrides=changes)
    plants, (states,) = hysteresis.split_plants(model, plants_of(model, {"model": {}}))
    equations = derive(without_states(model))
    found = hysteresis._rate(equations, states.gears, bristled)
    rng = np.random.default_rng(4)
    q = rng.standard_normal(4) * 0.1
    v = rng.standard_normal(4)
    tau = rng.standard_normal(2)
    slip = np.concatenate([layer.slip for layer in states.gears])
    share = rng.uniform(-0.9, 0.9, 4) * (slip > 0)
    bent = np.array([0.0, 0.4]) * bristled
    numbers = [plants.values[0] if plants.parameters else np.zeros(0), states.numbers()]
    numbers += [states.of_motors()] if bristled else []
    x = np.concatenate([q[:2], v[:2], q[2:], v[2:], share, bent[: 2 * bristled]])
    rate = np.array(found(x, tau, np.concatenate(numbers))).ravel()
    inputs, outputs = hysteretic_rate(derive(model))
    function = ca.Function("rate", inputs, outputs)
    most = np.array([1.0, BRISTLES["static"]])
    z = np.concatenate([share * slip, *([bent * most] if bristled else [])])
    dx, dz, _ = (np.array(y).ravel() for y in function(np.concatenate([q, v]), z, tau))
    assert_allclose(
        rate[:8], np.concatenate([dx[:2], dx[4:6], dx[2:4], dx[6:]]), rtol=1e-9, atol=1e-9
    )
    scale = np.concatenate([np.where(slip > 0, slip, 1.0), *([most] if bristled else [])])
    assert_allclose(rate[8:], dz / scale, rtol=1e-9, atol=1e-12)
    assert np.abs(rate[8:]).max() > 1.0 and found.size1_in(0) == len(x)
