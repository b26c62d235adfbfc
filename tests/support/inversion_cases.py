"""Inputs of inverse dynamics: a sampled move for a loaded library, the problem of a model's first
move.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from flexgen.dynamics.mechanics.equations import derive
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.model.elements import LinearSpring, RobotModel
from flexgen.paths.path import Path

MODEL = "planar5_nmp"
PERIOD = 1e-3
EVERY = 5


@cache
def samples(name: str = MODEL) -> dict[str, np.ndarray]:
    """The model's first move, sampled."""
    path = Path(equations := derive(name), equations.model.move())
    t = np.arange(round(path.duration / PERIOD) + 1) * PERIOD
    sample = path.sample(t)
    return {
        "y": sample.y[:, :, 0],
        "dy": sample.derivative(1),
        "ddy": sample.derivative(2),
        "q_start": path.q_start,
    }


def given(**changes) -> dict:
    return {
        **samples(),
        "period": PERIOD,
        "n_pre": 100,
        "n_post": 100,
        "samples_per_interval": EVERY,
        **changes,
    }


def question(model: str | FilePath | RobotModel, **options: Any) -> InversionProblem:
    """The model's first move."""
    equations = derive(model)
    return InversionProblem(equations, Path(equations, equations.model.move()), **options)


def last_joint(model: RobotModel, stiffness: float, damping: float) -> RobotModel:
    """A planar arm with the spring and damper of its passive joint multiplied."""
    element = model.elements[2]
    dof = element.dofs[0]
    assert isinstance(dof.spring, LinearSpring)
    soft = replace(
        dof, spring=LinearSpring(dof.spring.stiffness * stiffness), damping=dof.damping * damping
    )
    return replace(model, elements=(*model.elements[:2], replace(element, dofs=(soft,))))
