"""Errors of robots that differ from the model: predicted, and by the nonlinear loop of
`flexgen.control`.
"""

from __future__ import annotations

import numpy as np

import flexgen
from flexgen.studies.tolerances.response import linearize, response
from flexgen.studies.tolerances.sources import sources_of

SAMPLE_S = 2.5e-4


def in_the_loop(
    found: flexgen.Prediction,
    changes: list[dict[str, float]],
    solution: flexgen.Solution | None = None,
) -> np.ndarray:
    """Largest errors [m] of robots whose numbers are multiplied by these factors; ``solution``:
    other torques.
    """
    gains = found.feedback
    plants = {f"r{k}": robot for k, robot in enumerate(changes)}
    run = flexgen.control(
        found.solution.model,
        found.solution.move,
        controller=flexgen.Cascade(gains.position_gain, gains.speed_gain, gains.integral_gain),
        plants=plants,
        solution=solution or found.solution,
        torque_limits=False,
        sample_time=SAMPLE_S,
        progress=False,
    )
    inside = (run.reference.time >= found.time[0]) & (run.reference.time <= found.time[-1])
    return np.array([np.linalg.norm(run[name].error[inside], axis=1).max() for name in plants])


class Drawn:
    """Robots of a prediction that are drawn here."""

    def __init__(self, found: flexgen.Prediction, robots: int = 4) -> None:
        model = found.solution.model
        assert model.uncertainty is not None
        self.sources = sources_of(model, model.uncertainty)
        self.along = linearize(flexgen.derive(model), found.solution.trajectory, self.sources)
        self.errors = self.sources.errors(
            np.random.default_rng(7).standard_normal((robots, self.sources.root.shape[1]))
        )

    @property
    def changes(self) -> list[dict[str, float]]:
        """Factors on their numbers by name."""
        own = list(zip(self.sources.parameters, self.sources.owner, strict=True))
        return [{p.name: 1.0 + float(x[k]) for p, k in own} for x in self.errors]

    def predicted(self) -> np.ndarray:
        """Their largest errors [m]."""
        return np.asarray(
            np.linalg.norm(response(self.along, self.errors).error, axis=2).max(axis=0)
        )
