"""Frequency responses of sampled drives, against the exact discretization of the linear model;
fits to slow drives.
"""

from __future__ import annotations

import numpy as np
import pytest
from identification_cases import poses_of
from scipy.linalg import expm

import flexgen
from flexgen.dynamics.mechanics.parameters import select, with_values
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.response_inputs import Drive


def sampled_response(
    local: LocalModel, q_m: np.ndarray, w: np.ndarray, T: float, late: float
) -> np.ndarray:
    """``(j w)^2 C (z - A_d)^-1 (B_0 + B_1/z)``: from torques that are held from ``late`` after a
    sample on.
    """
    M, D, K, B = (x[0] for x in local.matrices(local.values, q_m))
    n = len(M)
    m = B.shape[1]
    A = np.zeros((2 * n + m, 2 * n + m))
    A[:n, n : 2 * n] = np.eye(n)
    A[n : 2 * n] = np.linalg.solve(M, np.hstack([-K, -D, B]))
    # with the torque before, and with the new one
    parts = [expm(A * part)[: 2 * n] for part in (late, T - late)]
    before, after = ((x[:, : 2 * n], x[:, 2 * n :]) for x in parts)
    z = np.exp(1j * w * T)[:, None, None]
    forced = after[0] @ before[1] / z + after[1]
    X = np.linalg.solve(z * np.eye(2 * n) - after[0] @ before[0], forced)
    return np.asarray((1j * w[:, None, None]) ** 2 * (local.motor_rows @ X[:, :n]))


@pytest.mark.parametrize("part", [0.0, 0.3])
@pytest.mark.parametrize("name", ["elbow", "planar5_nmp", "manutec_r3_18"])
def test_responses_of_held_torques_are_those_of_samples(name: str, part: float) -> None:
    """At a fifth of the sample rate and below; a response without images is percents off."""
    local = LocalModel(flexgen.read(name), ["stiffness"])
    q_m = poses_of(local.model, 1, spread=0.2) @ local.model.eta.T
    M, _, K, _ = (x[0] for x in local.matrices(local.values, q_m))
    # three samples a period
    T = 2 * np.pi / (3 * np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).real.max()))
    w = np.linspace(0.02, 0.2, 40) * 2 * np.pi / T
    exact = sampled_response(local, q_m, w, T, part * T)
    size = np.abs(exact).max(axis=(1, 2))

    def away(drive: Drive) -> float:
        found = local.response(local.values, q_m, w, drive, derivatives=False).G[0]
        return float((np.abs(found - exact).max(axis=(1, 2)) / size).max())

    assert away(Drive(T, part * T)) < 1e-3
    assert away(Drive(T, part * T, has_images=False)) > 3e-3


@pytest.mark.slow
@pytest.mark.parametrize("sample_s", [2e-3, 4e-3])
def test_a_right_robot_with_slow_drives_is_fitted(sample_s: float) -> None:
    """It was one: torques held for 2 ms have images of some percent of a small response."""
    hardware = flexgen.DriveHardware(
        sample_s=sample_s, encoder_noise_rad=1e-5, torque_noise_Nm=0.02
    )
    model = flexgen.read("planar5_nmp")
    factors = {"q1.stiffness": 1.1, "q2.stiffness": 0.87, "q3.stiffness": 0.9, "q2.damping": 1.15}
    true = with_values(
        model, {p.name: p.value * factors.get(p.name, 1.0) for p in select(model, list(factors))}
    )
    plan = flexgen.excite(
        model, poses=4, lines=40, period_s=2.0, speed_rms=0.03, hardware=hardware
    )
    found = flexgen.identify(model, flexgen.frf(flexgen.measure(plan, true)))
    assert found.status == "fitted"
