"""Residuals between samples: exact for motions that are polynomials of fifth order."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

import flexgen
from flexgen.simulation.verification.growth import Motion
from flexgen.simulation.verification.residual import midpoint_residual, residual_at


def test_states_between_samples_are_those_of_a_polynomial() -> None:
    """At uneven samples; torques that rise linearly."""
    equations = flexgen.derive("elbow")
    rng = np.random.default_rng(1)
    curves = [np.polynomial.Polynomial(rng.normal(size=6)) for _ in range(4)]
    torques = rng.normal(size=(2, 2))

    def motion(t: np.ndarray) -> Motion:
        q, v, a = (
            np.stack([c.deriv(k)(t) if k else c(t) for c in curves], axis=1) for k in range(3)
        )
        tau = torques[0] + t[:, None] * torques[1]
        return Motion(t, q[:, :2], v[:, :2], a[:, :2], q[:, 2:], v[:, 2:], a[:, 2:], tau)

    t = np.array([0.0, 0.3, 0.7, 1.2])
    expected = residual_at(equations, motion((t[1:] + t[:-1]) / 2))
    assert_allclose(midpoint_residual(equations, motion(t)), expected, rtol=1e-9)
