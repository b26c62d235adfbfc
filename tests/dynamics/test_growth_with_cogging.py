"""Growth of perturbations along a motion with cogging, against simulations of perturbed starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexgen
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.statics import equilibrium_at
from flexgen.simulation.verification import growth

SMALL = 1e-7  # rad
COGGING = {
    "motor.m1.cogging": {"harmonics": [12, 24], "cos": [0.3, 0.0], "sin": [0.0, 0.15]},
    "motor.m2.cogging": {"harmonics": [12], "cos": [0.3], "sin": [0.0]},
}


def test_the_growth_is_that_of_perturbed_starts_on_a_grid_that_resolves_the_cogging(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    equations = derive(flexgen.read("elbow", overrides=COGGING))
    data = flexgen.solve(equations, method="closed-form", ignore_limits=True).trajectory
    start = equilibrium_at(equations, data["q_a"][0])
    model = equations.model
    side = np.abs(model.eta).max(axis=1)

    def position(change: np.ndarray) -> np.ndarray:
        """Arm and motors, on the arm side (n, 4), of a start that is moved by ``change``."""
        moved = replace(start, q_a=start.q_a + change[:2], q_m=start.q_m + side * change[2:])
        run = flexgen.simulate(equations, data, start=moved, feedback="none", held=0.5)
        return np.hstack([run.trajectory["q_a"], run.trajectory["q_m"] / side])

    base = position(np.zeros(4))
    columns = [(position(SMALL * unit) - base) / SMALL for unit in np.eye(4)]
    norms = np.linalg.norm(np.stack(columns, axis=2), ord=2, axis=(1, 2))
    motion = growth.motion_in(data)
    along = growth.linearize_along(equations, motion)
    moving = len(motion.t[: along.at[-1]])
    found = growth.growth_along(along).movement
    assert found == pytest.approx(norms[: moving + 1].max(), rel=0.15)
    # planted: the grid of robots without cogging
    monkeypatch.setattr(growth, "MOST_HARMONIC", 0)
    coarse = growth.growth_along(growth.linearize_along(equations, motion)).movement
    assert coarse > 2 * found or coarse < found / 2
