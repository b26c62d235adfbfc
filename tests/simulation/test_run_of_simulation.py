"""Laws, referees and refused input of `flexgen.simulation.run`."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from flexgen.dynamics.mechanics.equations import derive
from flexgen.simulation import run as runs
from flexgen.simulation.motor_feedback import MotorFeedback


def test_rates_with_and_without_feedback_have_the_derivatives_they_state() -> None:
    equations = derive("elbow")
    robot = equations.model
    n = robot.dof
    n_m = robot.n_m
    rng = np.random.default_rng(1)
    motors = MotorFeedback(
        rng.normal(size=(n_m, n)),
        np.array([3.0, 4.0]),
        np.array([0.2, 0.1]),
        np.array([5.0, 6.0]),
        {"position_hz": 0.5, "speed_hz": 3.0, "integral_hz": 0.1},
    )
    assert (
        motors.title
        == "P-PI motor feedback, continuous, position 0.5 Hz, speed 3 Hz, integral 0.1 Hz"
    )
    function = runs.rate_function(equations)
    u = rng.normal(size=n_m)
    for feedback in (None, motors):
        size = 2 * n + 2 + (n_m if feedback else 0)
        x = 0.1 * rng.normal(size=size)
        reference = np.concatenate([u, rng.normal(size=2 * n_m)]) if feedback else u
        rates = runs.rates_of(equations, function, None, lambda t, r=reference: r, feedback)
        if feedback:
            q = feedback.rows @ x[:n]
            v = feedback.rows @ x[n : 2 * n]
            w = reference[2 * n_m :] + feedback.position_gain * (reference[n_m : 2 * n_m] - q) - v
            torque = u + feedback.speed_gain * (w + feedback.integral_gain * x[2 * n + 2 :])
            assert_allclose(
                rates.rate(0.0, x),
                [*np.array(function(x[: 2 * n + 2], torque)).ravel(), *w],
                rtol=1e-12,
            )
        else:
            assert_array_equal(rates.rate(0.0, x), np.array(function(x, u)).ravel())
        h = 1e-5
        slope = np.stack(
            [
                (rates.rate(0.0, x + h * e) - rates.rate(0.0, x - h * e)) / (2 * h)
                for e in np.eye(size)
            ],
            axis=1,
        )
        found = rates.jacobian(0.0, x)
        observers = [2 * n, 2 * n + 1]
        assert not found[observers].any() and not found[:, observers].any()
        slope[observers] = slope[:, observers] = 0.0
        assert_allclose(found, slope, rtol=1e-5, atol=1e-6 * np.abs(slope).max())
