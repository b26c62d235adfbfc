"""Counterbalances of a fit: harmonics that relieve a motor."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
from numpy.testing import assert_allclose

from flexgen.identification.rigid import counterbalances


def test_counterbalances_of_a_fit_relieve_the_motor() -> None:
    """Harmonics from the second on, times the largest ratio of the joint, with the other sign;
    others are kept.
    """
    file = ((1.0, 2.0), (3.0, 4.0), (5.0, 6.0), (7.0, 8.0))
    dofs = [Made(name="q1", counterbalance=file), Made(name="q2", counterbalance=())]
    coordinates = [Made(name="q1"), Made(name="q2")]
    eta = np.array([[10.0, 0.0], [-40.0, 20.0]])
    model: Any = Made(elements=[Made(dofs=dofs)], coordinates=coordinates, i_g=(0, 1), eta=eta)
    held = counterbalances.held_balances(model, {"q1": 2})
    assert held == {"q1": (file[0], (0.0, 0.0), (0.0, 0.0), file[3]), "q2": ()}
    friction = np.zeros((2, 8))
    friction[1, 4:] = 0.1, 0.2, 0.3, 0.4
    found = counterbalances.fitted_balances(model, {"q1": 2, "q2": 1}, friction)
    assert_allclose(found["q1"], [file[0], (4.0, 8.0), (12.0, 16.0), file[3]])
    assert_allclose(found["q2"], [(0.0, 0.0), (-2.0, -4.0)])
