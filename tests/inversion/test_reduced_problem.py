"""The reduced problem: its kinematics, from afar, and a start that does not determine it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from inversion_cases import question
from numpy.testing import assert_allclose, assert_array_equal

from flexgen.base.errors import SolverError
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.paths.path import Path


def test_the_kinematics_are_closed_by_the_coordinates_that_have_motors() -> None:
    """From other deflections, which are kept."""
    problem = question("planar5_nmp")
    equations = problem.equations
    model = equations.model
    path = problem.path
    reduction = Reduction(equations)
    t = np.linspace(0.0, path.duration, 5)
    targets = reduction.targets(path.sample(t))
    start = np.tile(path.q_start, (5, 1)) + 0.05 * np.isin(np.arange(model.n_a), [0, *model.i_e])
    q = reduction.close(start, targets)
    y = np.array([np.array(equations.function("output")(x)).ravel() for x in q])
    assert_allclose(y, path.sample(t).y[:, :, 0], atol=1e-10)
    assert_array_equal(q[:, list(model.i_e)], start[:, list(model.i_e)])
    with pytest.raises(SolverError, match=r"no solution at sample 2 of 5, error .* the workspace"):
        reduction.close(start, targets + 9.0 * (np.arange(5) == 2)[:, None])


def test_a_singular_start_is_refused() -> None:
    equations = question("planar5_nmp").equations
    n = len(equations.model.i_g)
    joints = next(move for move in equations.model.moves if move.type == "joint")
    stretched = Path(equations, replace(joints, start=(0.0,) * n))
    with pytest.raises(SolverError, match="the output does not determine the actuated coord"):
        Reduction(equations).start(stretched)
