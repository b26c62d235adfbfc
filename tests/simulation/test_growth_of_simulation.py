"""Laws, referees and refused input of `flexgen.simulation.verification.growth`."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose
from scipy.linalg import expm

from flexgen.dynamics.mechanics.equations import derive
from flexgen.simulation.verification import growth


def test_growth_of_perturbations_is_that_of_the_exponential() -> None:
    """Products of the steps of a robot at rest; the grid has 50 intervals at least."""
    equations = derive("four_mass")
    n_a = equations.model.n_a
    n_m = equations.model.n_m
    n = equations.model.dof
    t = np.linspace(0.0, 0.1, 201)
    arm = np.zeros((201, n_a))
    motors = np.zeros((201, n_m))
    along = growth.linearize_along(
        equations, growth.Motion(t, arm, arm, arm, motors, motors, motors, motors)
    )
    steps = expm(along.means * along.lengths[:, None, None])
    assert steps.shape == (50, 2 * n, 2 * n) and along.rest == 0.0
    state = np.array(
        equations.function("linearize")(arm[0], arm[0], motors[0], motors[0], motors[0])[0]
    )
    scale = np.ones(2 * n)
    scale[n_a:n] = scale[n + n_a :] = np.abs(equations.model.eta).max(axis=1)[
        list(equations.model.i_m)
    ]
    product = np.linalg.multi_dot(list(steps[::-1]))
    expected = expm(0.1 * state) * scale / scale[:, None]
    assert_allclose(product, expected, atol=1e-9 * np.abs(expected).max())
