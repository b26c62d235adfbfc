"""The discrete Riccati equation: its residual, and a pair that cannot be stabilized."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import solve_discrete_are

from flexgen.base.errors import SolverError
from flexgen.base.numerics.riccati import riccati


def test_the_riccati_equation_holds_and_a_hopeless_one_is_reported() -> None:
    F = np.array([[1.1, 0.2], [0.0, 0.9]])
    G = np.array([[0.0], [1.0]])
    Q = np.diag([1.0, 2.0])
    R = np.array([[0.5]])
    assert_allclose(riccati(F, G, Q, R), solve_discrete_are(F, G, Q, R), rtol=1e-14)
    with pytest.raises(SolverError, match="use other weights, or other sensors"):
        riccati(np.diag([2.0, 3.0]), np.zeros((2, 1)), Q, R)
