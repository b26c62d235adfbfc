"""The smoother along a motion: filter and smoother of the textbook on models at its poses."""

from __future__ import annotations

import numpy as np
import pytest
from law_cases import at_rest
from numpy.testing import assert_allclose
from scipy.linalg import block_diag, expm, solve_discrete_are

import flexgen
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.channels import Channels, channels_of
from flexgen.feedback.loop.reference import MOTION, MotionReference
from flexgen.feedback.loop.sampled_model import PoseModels, elastic_gears
from flexgen.planning.learning.smoother import PathSmoother, acting

H = 4e-3
COUNT = 60  # two samples of each of thirty parts


def moving(model: flexgen.RobotModel) -> MotionReference:
    """A motion whose arm accelerates from rest."""
    time = H * np.arange(COUNT) - 0.1
    point = dict(zip(MOTION, at_rest(model), strict=True))
    motion = {name: np.repeat(x, COUNT, axis=0) for name, x in point.items()}
    swing = np.sin(np.arange(COUNT) / 9.0)[:, None] * (time > 0)[:, None]
    motion["a_a"] = motion["a_a"] + swing * np.linspace(2.0, -1.0, model.n_a)
    none = np.zeros((COUNT, 2))
    return MotionReference(time, motion, none, none, none, None, 0.0, time[-1], time[-1])


def pieces(channels: Channels, reference: MotionReference, k: int) -> tuple[np.ndarray, ...]:
    """F, G, C, D, Q and R at a sample: disturbances of the motors and forces that fade in 0.3 s,
    in units of their sizes.
    """
    model = channels.model
    at = PoseModels(model).at([x[k : k + 1] for x in (reference.motion[n] for n in MOTION)])
    function = derive(model).function("inverse_dynamics").map(COUNT)
    m = reference.motion
    tau = np.array(function(m["q_a"].T, m["v_a"].T, m["a_a"].T)).T
    change = np.abs(tau - tau[0]).max(axis=0)
    change = np.maximum(change, 1e-3 * change.max())
    geared = elastic_gears(model)
    share = np.where(np.isin(np.arange(model.n_a), geared), 0.02, 0.2)
    force = np.concatenate([share * change, 0.2 * change[geared]])
    limits = np.array([motor.torque_max or 0.0 for motor in model.motors])
    largest = np.where(limits > 0, limits, max(limits.max(), 1.0))
    n = len(at.A)
    inputs = np.hstack([at.B * largest, at.arm * force])
    more = inputs.shape[1]
    n_m = model.n_m
    held = expm(H * np.block([[at.A, inputs], [np.zeros((more, n + more))]]))[:n]
    fade = np.r_[np.ones(n_m), np.full(more - n_m, np.exp(-H / 0.3))]
    F = np.vstack([held, np.hstack([np.zeros((more, n)), np.diag(fade)])])
    G = np.vstack([held[:, n : n + n_m] / largest, np.zeros((more, n_m))])
    C = np.hstack([at.C, at.D * largest, at.D_arm * force])[channels.index]
    noisy = held[:, n : n + n_m] * 1e-3
    walk = np.r_[np.full(n_m, 0.1**2 * H), 1 - fade[n_m:] ** 2]
    Q = block_diag(noisy @ noisy.T, np.diag(walk))
    return F, G, C, at.D[channels.index], Q, np.diag(channels.noise**2)


@pytest.mark.parametrize("name", ["elbow", "planar5_nmp"])
def test_deviations_are_those_of_a_filter_and_a_smoother(name: str) -> None:
    """Stationary gains at the middle of each part; the mean of half a second before the motion is
    taken off.
    """
    channels = channels_of(flexgen.read(name), ("m2", "tool_accelerometer", "m1"))
    model = channels.model
    reference = moving(model)
    made = PathSmoother(channels, reference, H)
    assert made.samples == 2
    rng = np.random.default_rng(3)
    dy = rng.normal(size=(COUNT, 5)) * channels.noise + 0.1
    du = rng.normal(size=(COUNT, model.n_m))
    begin = int(np.searchsorted(reference.time, 0.0))
    y = dy - dy[:begin].mean(axis=0)
    u = du - du[:begin].mean(axis=0)
    z = 0.0
    before = []
    after = []
    back = []
    for k in range(COUNT):
        F, G, C, D, Q, R = pieces(channels, reference, min(2 * (k // 2) + 1, COUNT - 1))
        P = solve_discrete_are(F.T, C.T, Q, R)
        gain = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        z = (F @ z if k else np.zeros(len(F))) + G @ u[k]
        before.append(z)
        z = z + gain @ (y[k] - C @ z - D @ u[k])
        after.append(z)
        kept = np.eye(len(F)) - gain @ C
        back.append(kept @ P @ F.T @ np.linalg.pinv(P, rcond=1e-18))
    for k in range(COUNT - 2, -1, -1):
        after[k] = after[k] + back[k + 1] @ (after[k + 1] - before[k + 1])
    expected = np.array(after)[:, : model.n_a]
    found = made.deviation(dy, du)
    assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_torques_that_acted_are_those_sent_late() -> None:
    sent = np.array([[1.0], [2.0], [4.0], [8.0], [16.0]])
    assert_allclose(acting(sent, 0, 0.0)[:, 0], [1, 1, 2, 4, 8])
    assert_allclose(acting(sent, 1, 0.25)[:, 0], [1, 1, 1, 0.75 * 2 + 0.25, 0.75 * 4 + 0.25 * 2])
