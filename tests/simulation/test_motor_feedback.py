"""The default feedback of motors in a simulation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.testing import assert_allclose
from scipy.linalg import eigh

from flexgen.dynamics.mechanics.equations import derive
from flexgen.simulation.motor_feedback import default_feedback


def test_the_default_feedback_of_motors_is_below_the_lowest_locked_frequency() -> None:
    """A half, three times and a tenth of it; gravity changes it little. Speed gains by the inertia
    of stiff gears.
    """
    equations = derive("elbow")
    model = equations.model
    q = np.array([0.3, -0.4])
    found = default_feedback(equations, q, model.eta @ q, np.zeros(2))
    M = np.array(equations.function("mass_matrix")(q))
    springs: list[Any] = [element.dofs[0].gear for element in model.elements]
    K = np.diag([float(gear.spring.stiffness) for gear in springs])
    lowest = np.sqrt(eigh(K, M, eigvals_only=True)[0]) / (2 * np.pi)
    assert_allclose(found.position_gain, np.pi * lowest, rtol=1e-3)
    assert_allclose(found.integral_gain, 0.2 * np.pi * lowest, rtol=1e-3)
    back = np.linalg.inv(model.eta)
    inertia = np.diag(back.T @ M @ back) + [m.inertia for m in model.motors]
    assert_allclose(found.speed_gain, 6 * np.pi * lowest * inertia, rtol=1e-3)
    names = ["position_hz", "speed_hz", "integral_hz"]
    assert list(found.frequencies) == names
    assert_allclose(
        list(found.frequencies.values()), np.array([0.5, 3.0, 0.1]) * lowest, rtol=1e-3
    )
