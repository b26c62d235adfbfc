"""Residuals between samples: exact for motions that are polynomials of fifth order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from gear_friction import loaded, torque
from numpy.testing import assert_allclose

import flexgen
from flexgen.dynamics.mechanics.equations import derive
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


def test_a_hysteresis_loads_springs_and_frictions() -> None:
    """Its torque z is taken from the arm, and z/n added to the motors, with the friction under the
    larger load.
    """
    plain = loaded("elbow")
    n = np.diag(plain.eta)
    bend = np.array([1e-4, -2e-4])

    def motion(t: np.ndarray) -> Motion:
        q = np.stack([0.3 * t**2, -0.2 * t**3], axis=1)
        v = np.stack([0.6 * t, -0.6 * t**2], axis=1)
        a = np.stack([0.6 + 0 * t, -1.2 * t], axis=1)
        return Motion(t, q, v, a, (q + bend) * n, v * n, a * n, np.zeros((len(t), 2)))

    def loop(t: np.ndarray) -> np.ndarray:
        return np.stack([200.0 + 100 * t, -50.0 + 0 * t], axis=1)

    t = np.linspace(0.0, 0.5, 7)
    middle = (t[:-1] + t[1:]) / 2
    z = loop(middle)
    hysteretic = derive(loaded("elbow", lost_motion=1e-3))
    found = midpoint_residual(hysteretic, replace(motion(t), tau_h=loop(t)))
    without = midpoint_residual(derive(plain), motion(t))
    gears = [dof.gear for e in plain.elements for dof in e.dofs if dof.gear is not None]
    load = np.array([gear.spring.stiffness for gear in gears if gear.spring]) * bend / n
    speed = motion(middle).v_m
    more = torque(speed, load + z / n) - torque(speed, load + 0 * z)
    assert_allclose(found[:, :2] - without[:, :2], -z, rtol=1e-9)
    assert_allclose(found[:, 2:] - without[:, 2:], z / n + more, rtol=1e-6)
    assert np.abs(more).max() > 1e-3
