"""The numeric mass matrix against that of the derived equations."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.inertia import mass_matrix

RNG = np.random.default_rng(6)


@pytest.mark.parametrize("name", ["elbow", "manutec_r3", "two_arm"])
def test_the_numeric_mass_matrix_is_that_of_the_equations(name: str) -> None:
    model = flexgen.read(name)
    q = RNG.uniform(-1, 1, model.n_a)
    M = np.array(derive(model).function("mass_matrix")(q))
    i_g = list(model.i_g)
    rigid = [j for j in range(model.n_m) if j not in model.i_m]
    rotors = np.diag([model.motors[j].inertia for j in rigid])
    M[np.ix_(i_g, i_g)] += model.eta[rigid].T @ rotors @ model.eta[rigid]  # of rigid gears
    assert_allclose(mass_matrix(model, q), M, atol=1e-10 * np.abs(M).max())
