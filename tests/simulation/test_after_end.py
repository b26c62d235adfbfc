"""Laws, referees and refused input of `flexgen.simulation.after_end`."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
from numpy.testing import assert_allclose
from scipy.linalg import expm

from flexgen.simulation import after_end

A = np.array([[0.0, 1.0], [-4.0, -0.3]])


def test_the_motion_after_the_end_is_that_of_the_linearization() -> None:
    f = np.array([0.3, -0.1])
    x = np.array([1.0, 2.0])
    found: Any = Made(
        last=x, rates=Made(jacobian=lambda t, at: A * (t == 4.0), rate=lambda t, at: f * (at == x))
    )
    for held in (0.0, 0.5, 2.0, 3.0):
        states = after_end.errors_after_end(found, 4.0, held)
        assert states.shape == (64, 2)
        for k in (0, 31, 63):
            s = max(2.0 - held, 0.0) * (k + 1) / 64
            assert_allclose(
                states[k], x + np.linalg.solve(A, (expm(A * s) - np.eye(2)) @ f), atol=1e-12
            )
