"""The power that goes into frictions with a state."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from gear_friction import loaded

import flexgen
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.simulation.integration.hysteretic_rate import memory_of


@pytest.mark.parametrize("bristles", [False, True])
def test_the_power_of_memories_is_what_their_forces_take(bristles: bool) -> None:
    """Forces times speeds of the motion, for gears whose hysteresis changes the friction of the
    motors too.
    """
    model = loaded("elbow", lost_motion=1e-3)
    if bristles:
        law = {
            "coulomb": 0.5,
            "static": 0.8,
            "stribeck_speed": 4.0,
            "stiffness": 800.0,
            "damping": 1.5,
        }
        model = flexgen.read("elbow", overrides={"motor.m2.lugre": law})
    equations = Equations(model)
    made = memory_of(equations)
    lag = equations.lagrangian
    (y, dy, _) = equations.y
    inputs = [y, dy, made.z]
    found = ca.Function(
        "power", inputs, [made.taken, ca.dot(made.forces, dy)], {"allow_free": True}
    )
    assert not found.free_sx(), lag
    rng = np.random.default_rng(2)
    for _ in range(4):
        taken, given = (float(x) for x in found(*(rng.standard_normal(x.numel()) for x in inputs)))
        assert taken == pytest.approx(-given, rel=1e-10) and abs(taken) > 1e-3
