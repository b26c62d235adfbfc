"""Sampled linear models, their regulators and filters: against fine steps, sweeps and
recursions.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from flexgen.base.errors import SolverError
from flexgen.base.numerics.riccati import riccati
from flexgen.feedback.loop.controllers import Cascade, Linear
from flexgen.feedback.loop.interface import Measurement, Reference
from flexgen.feedback.loop.margins import LoopAtPose, as_linear
from flexgen.feedback.loop.sampled_model import PoseModel
from flexgen.feedback.sampled_plant import hold_effects, sample_model, sampled_plant
from flexgen.model.position_servo.filters import LowPass, Notch

H = 1e-3


def oscillator() -> tuple[np.ndarray, np.ndarray]:
    """Two masses, a spring and a damper, two torques."""
    M = np.diag([1.0, 2.0])
    K = 400.0 * np.array([[1, -1], [-1, 1]])
    D = 0.5 * np.array([[1, -1], [-1, 1]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    return A, np.vstack([np.zeros((2, 2)), np.linalg.inv(M)])


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 1.3, 2.0, 3.75])
def test_delays_are_states(delay):
    """Random torques through the sampled model, and in a hundred steps a sample with the delay
    itself.
    """
    A, B = oscillator()
    F, G = sample_model(A, B, H, delay * H)
    rng = np.random.default_rng(0)
    parts = 100
    u = rng.standard_normal((40, 2))
    x = np.zeros(len(F))
    fine = np.zeros(4)
    phi = expm(A * H / parts)
    gamma = hold_effects(A, B, H / parts, 0.0)[1]
    for k in range(40):
        assert np.allclose(x[:4], fine, atol=1e-12)
        x = F @ x + G @ u[k]
        for step in range(parts):
            sent = int(np.floor((k * parts + step - round(delay * parts)) / parts))
            fine = phi @ fine + gamma @ (u[sent] if sent >= 0 else np.zeros(2))


def test_no_solution_is_an_error():
    with pytest.raises(SolverError, match="Riccati equation has no solution"):
        riccati(np.diag([2.0, 0.5]), np.array([[0.0], [1.0]]), np.eye(2), np.eye(1))


def test_a_cascade_is_its_linear_form():
    """Random errors through both, filters and integral parts included."""
    law = Cascade(
        np.array([10.0, 20.0]),
        np.array([3.0, 2.0]),
        np.array([1.0, 4.0]),
        (LowPass(60.0, 0.7), Notch(25.0, 0.2, 0.8)),
    )
    linear = as_linear(law.begin(H), H, 2)
    assert linear is not None
    law.reset()
    linear.reset()
    rng = np.random.default_rng(0)
    none = np.zeros(0)
    still = np.zeros(2)
    for k in range(100):
        q = rng.standard_normal(2) if k else still
        y = Measurement(q, none)
        ref = Reference(still, none, still, still, none, none)
        assert np.allclose(law.step(k, y, ref), linear.step(k, y, ref), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("delay", [0.0, 0.4, 1.0, 1.7, 2.0])
def test_outputs_with_feedthrough_and_late_sensors_are_those_of_the_exact_motion(
    delay: float,
) -> None:
    """Torques held from sample to sample, exact pieces in between; the torque that acts when a
    sample is taken.
    """
    rng = np.random.default_rng(3)
    h = 0.1
    n = 3
    steps = 40
    A, B, C, D = (rng.normal(size=size) for size in ((n, n), (n, 2), (3, n), (3, 2)))
    late = np.array([0, 2, 1])
    F, G, Y = sampled_plant(A - 2 * np.eye(n), B, C, D, h, delay * h, late)
    u = rng.normal(size=(steps, 2))
    x = np.zeros(len(F))
    found = []
    for torque in u:
        found.append(Y @ x)
        x = F @ x + G @ torque
    fine = 10
    state = np.zeros(n)
    shown = []
    E = expm(np.block([[A - 2 * np.eye(n), B], [np.zeros((2, n + 2))]]) * h / fine)
    for k in range(steps * fine):
        if k % fine == 0:
            # a piece that has ended acts no more
            before = int(np.ceil(k - fine * delay - 1e-9)) - 1
            shown.append(C @ state + D @ (u[before // fine] if before >= 0 else np.zeros(2)))
        now = int(np.floor(k - fine * delay + 1e-9))
        state = E[:n, :n] @ state + E[:n, n:] @ (u[now // fine] if now >= 0 else np.zeros(2))
    for k in range(3, steps):
        expected = [shown[k - late[i]][i] for i in range(3)]
        assert found[k] == pytest.approx(expected, abs=1e-12)


def test_a_late_sensor_takes_the_margin_of_its_loop() -> None:
    """u = -k y, y' = u shown two samples late: z^3 - z^2 + k h = 0 is stable below k h = 0.618."""
    plant = PoseModel(*(np.array([[x]]) for x in (0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0)))
    law = Linear(*(np.array([[[x]]]) for x in (0.0, 0.0, 0.0, 1.0)))
    margins = [LoopAtPose(plant, law, 0.1, 0.0, np.array([late])).margins() for late in (0, 2)]
    assert [x.gain for x in margins] == pytest.approx([20.0, 6.18034], rel=1e-4)
