"""Observers by other routes: the momentum of a detector, the model behind a gain, rank tests,
copies and messages.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import block_diag, expm, solve_discrete_are
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.channels import channels_of
from flexgen.feedback.loop.noises import Noises
from flexgen.feedback.loop.sampled_model import PoseModel
from flexgen.feedback.observers import constant_gain, design, extended_kalman
from flexgen.feedback.observers.collision import Detection

pytestmark = needs_compiler
H = 1e-3


def moved(model: Any, count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    t = H * np.arange(count)[:, None]
    q = np.array([0.3, -0.2]) + 0.2 * np.sin(np.array([21.0, 33.0]) * t) * np.array([1.0, 0.7])
    return q @ model.eta.T, 40.0 * np.cos(np.array([17.0, 11.0]) * t)


def residual_of(model: Any, q_m: np.ndarray, tau: np.ndarray, bandwidth: float) -> np.ndarray:
    """The residual sample by sample from the definition of the equations."""
    e = flexgen.derive(model)
    inverse = np.linalg.inv(model.eta)
    inertia = np.diag([m.inertia for m in model.motors])
    friction = e.function("motor_friction")
    r = []
    first = None
    total = np.zeros(2)
    before = None
    for k in range(len(q_m)):
        v_m = (q_m[k] - q_m[max(k - 1, 0)]) / H
        q = inverse @ q_m[k]
        v = inverse @ v_m
        M = np.array(e.function("mass_matrix")(q))
        bias = np.array(e.function("inverse_dynamics")(q, v, np.zeros(2))).ravel()
        p = inverse.T @ M @ v + inertia @ v_m
        first = p if first is None else first
        r.append(2 * np.pi * bandwidth * (p - first - total))
        change = (M - (M if before is None else before)) / H
        force = tau[k] - np.array(friction(v_m)).ravel() + inverse.T @ (change @ v - bias)
        total = total + H * (force + r[-1])
        before = M
    return np.array(r)


def test_a_detector_integrates_the_momentum_of_the_definition() -> None:
    """Shown to see: each sign, the first difference, the motor side, the bandwidth and the
    margin.
    """
    model = flexgen.read("elbow@rigid")
    detector = flexgen.CollisionDetector(model, H, 20.0)
    assert repr(detector) == f"<CollisionDetector {model.title}: samples of 1 ms, bandwidth 20 Hz>"
    q_m, tau = moved(model)
    expected = residual_of(model, q_m, tau, 20.0)
    free = detector.detect(q_m, tau)
    assert free.sample is None
    assert_allclose(free.residual, expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max())
    largest = np.abs(expected).max(axis=0)
    assert_allclose(
        detector.calibrate([(q_m[:20], tau[:20]), (q_m, tau)], 0.9), 0.9 * largest, rtol=1e-6
    )
    hit = detector.detect(q_m, tau).sample
    assert hit == np.flatnonzero((np.abs(expected) > 0.9 * largest).any(axis=1))[0]
    detector.calibrate([(q_m, tau)])
    assert_allclose(detector.thresholds, 1.2 * largest, rtol=1e-6)
    assert detector.detect(q_m, tau).sample is None
    detector.thresholds[:] = 1e-12
    late = np.vstack([q_m[:1], q_m[:1], q_m[:3]])
    still = (
        np.linalg.inv(model.eta).T
        @ np.array(flexgen.derive(model).function("gravity")(np.array([0.3, -0.2]))).ravel()
    )
    load = np.vstack([still, still, still, tau[:2]])
    assert detector.detect(late[:3], load[:3]).sample in (None, 1, 2)
    given = np.zeros((3, 2))
    for q, torque in (
        (given[:2], given[:2]),
        (given, given[:, :1]),
        (given[0], given[0]),
        (given[:, :1], given[:, :1]),
    ):
        with pytest.raises(
            ArgumentError, match=r"record: given shapes .*, expected \(n, 2\) twice"
        ):
            detector.detect(q, torque)
    assert detector.detect(given, given).residual.shape == (3, 2)
    for bad in (0.0, 100.0, -1.0, float("nan")):
        with pytest.raises(
            ArgumentError, match=r"bandwidth_hz: given .*, expected more than 0, below 100"
        ):
            flexgen.CollisionDetector(model, H, bad)


def linear(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, push: np.ndarray
) -> PoseModel:
    return PoseModel(
        A, B, push, np.zeros((len(A), 0)), C, D, np.zeros((len(C), 0)), np.zeros((0, len(A)))
    )


def pose(seed: int = 0) -> PoseModel:
    """A stable random linear model: 6 states, 2 motors, 2 outputs."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(6, 6)) - 4 * np.eye(6)
    B = rng.normal(size=(6, 2))
    C = rng.normal(size=(2, 6))
    return linear(A, B, C, 0.1 * rng.normal(size=(2, 2)), rng.normal(size=(6, 3)))


def test_the_stationary_gain_solves_the_riccati_equation_of_scipy() -> None:
    """Force on the tool and torques as white noise that is held, disturbances as a random walk."""
    at = pose()
    noises = Noises(flexgen.read("planar5_nmp"), 0.05, 1.3, 20.0)
    noise = np.array([0.02, 0.05])
    F, G, C, D, M = constant_gain.stationary(at, np.array([1, 0]), noise, noises, 0.01)
    whole = expm(0.01 * np.block([[at.A, at.B, at.push], [np.zeros((5, 11))]]))
    assert_allclose(F, whole[:6, :6], rtol=1e-9)
    assert_allclose(G, whole[:6, 6:8], rtol=1e-8)
    push = whole[:6, 8:] * 20.0
    largest = noises.largest
    Q = block_diag(
        G @ np.diag((0.05 * largest) ** 2) @ G.T + push @ push.T,
        np.diag((1.3 * largest) ** 2 * 0.01),
    )
    assert_allclose(design.process_noise(at, G, noises, 0.01), Q, rtol=1e-8)
    A = block_diag(F, np.eye(2))
    A[:6, 6:] = G
    H_ = np.hstack([at.C[[1, 0]], at.D[[1, 0]]])
    assert_allclose(np.hstack([C, D]), H_)
    P = solve_discrete_are(A.T, H_.T, Q, np.diag(noise**2))
    assert_allclose(
        M, P @ H_.T @ np.linalg.inv(H_ @ P @ H_.T + np.diag(noise**2)), rtol=1e-5, atol=1e-8
    )


def test_states_that_do_not_show_are_named() -> None:
    """Rank of ``(A - lambda; C)``: slow hidden modes are named, fast ones are allowed,
    disturbances count.
    """
    model = flexgen.read("planar5_nmp")
    n = model.dof
    channels = channels_of(model, "motors", None)
    noises = Noises(model, 0.05, 1.0, 0.0)
    names = design.state_names(channels.model, True)
    assert names == (
        "q1",
        "q2",
        "q3",
        "m1",
        "m2",
        "speed of q1",
        "speed of q2",
        "speed of q3",
        "speed of m1",
        "speed of m2",
        "disturbance of m1",
        "disturbance of m2",
    )
    assert design.state_names(channels.model, False) == names[:-2]
    C = np.zeros((2, 2 * n))
    C[0, model.n_a] = 1.0
    C[1, model.n_a + 1] = 1.0

    def check(rates: np.ndarray, B: np.ndarray, n_d: int) -> None:
        at = linear(np.diag(rates), B, C, np.zeros((2, 2)), np.zeros((2 * n, 3)))
        design.check_observable(at, channels, names, noises, n_d)

    fast = np.full(2 * n, -1.0)
    B = np.zeros((2 * n, 2))
    check(fast, B, 0)
    slow = fast.copy()
    slow[2] = -1e-4
    with pytest.raises(
        ArgumentError,
        match=r"outputs: given m1, m2, which do not determine q3; measure more, such as al",
    ):
        check(slow, B, 0)
    slow[2] = -2e-3
    check(slow, B, 0)
    slow[model.n_a] = 0.5  # grows, and shows
    check(slow, B, 0)
    with pytest.raises(
        ArgumentError,
        match=r"which do not determine disturbance of m1, disturbance of m2; measure",
    ):
        check(fast, B, 2)
    B[model.n_a, 0] = B[model.n_a + 1, 1] = 1.0
    check(fast, B, 2)
    none = fast.copy()
    none[[0, 1, 2, 5, 6, 7, 8, 9]] = 0.0
    with pytest.raises(ArgumentError, match=r"speed of m1, speed of m2; measure"):
        check(none, B, 0)
    with pytest.raises(ArgumentError, match=r"q1, .* speed of m2 and 2 more; measure"):
        check(none, np.zeros((2 * n, 2)), 2)


def test_arrays_of_observers_are_checked_and_aligned() -> None:
    for size in (1, 7, 64):
        memory = design.allocate_aligned(size)
        assert memory.shape == (size,) and memory.ctypes.data % 64 == 0 and not memory.any()
    assert design.vector("a", [1, 2], 2).tolist() == [1.0, 2.0]
    for bad in ([1.0], [1.0, np.nan], [[1.0, 2.0]]):
        with pytest.raises(
            ArgumentError, match=r"a: given shape .*, expected \(2,\), finite numbers"
        ):
            design.vector("a", bad, 2)
    assert design.record("y", np.ones((3, 2)), 3, 2).flags["C_CONTIGUOUS"]
    with pytest.raises(ArgumentError, match=r"y: given shape \(3, 2\), expected \(3, 3\)"):
        design.record("y", np.ones((3, 2)), 3, 3)


def test_a_filter_begins_at_rest_or_at_a_state() -> None:
    """Deviations of the start, covariances that are refused, motor angles from states, words and
    messages.
    """
    model = flexgen.read("planar5_nmp")
    ekf = flexgen.ExtendedKalmanFilter(model)
    n = model.dof
    n_a = model.n_a
    n_m = model.n_m
    assert (
        repr(ekf) == f"<ExtendedKalmanFilter {model.title}: 2 outputs, 12 states, samples of 1 ms>"
    )
    largest = ekf.noises.largest
    assert_allclose(
        np.sqrt(np.diag(ekf.covariance)), np.r_[np.full(n, 1e-3), np.full(n, 1e-2), 0.1 * largest]
    )
    e = flexgen.derive(model)
    q_m = model.eta @ np.array([0.2, 0.4])
    ekf.reset(q_m)
    z = ekf.state
    assert_allclose(z[n_a:n], q_m[list(model.i_m)])
    assert_allclose(z[n:], 0.0)
    torque = np.array(e.function("elastic_torque")(z[:n_a], np.zeros(n_a))).ravel()
    load = np.array(e.function("inverse_dynamics")(z[:n_a], np.zeros(n_a), np.zeros(n_a))).ravel()
    assert_allclose(load[list(model.i_e)], torque, atol=1e-6 * np.abs(load).max())
    given = np.arange(1.0, 13.0) / 10
    P = np.diag(np.linspace(1.0, 2.0, 12)) + 0.1
    ekf.reset(state=given, covariance=P)
    assert_allclose(ekf.state, given)
    assert_allclose(ekf.covariance, P)
    motion = ekf._at(given)
    assert_allclose(motion[0][0], given[:n_a])
    assert_allclose(motion[3][0], given[n_a:n])
    assert [x.shape for x in motion] == [(1, n_a)] * 3 + [(1, n_m)] * 4
    assert not any(x.any() for k, x in enumerate(motion) if k not in (0, 3))
    for bad, text in (
        (np.eye(3), r"covariance: given shape \(3, 3\), expected a symmetric matrix \(12, 12\)"),
        (P + np.triu(P, 1), "expected a symmetric matrix"),
        (
            np.diag(np.r_[0.0, np.ones(11)]),
            "given a matrix with a variance <= 0, expected a positive one",
        ),
        (np.eye(12) + 1.1 * (np.eye(12)[::-1]), "given a matrix with a variance <= 0"),
        (
            np.diag(10.0 ** np.arange(12))
            @ (np.eye(12) + 1.1 * np.eye(12)[::-1])
            @ np.diag(10.0 ** np.arange(12)),
            "<= 0",
        ),
    ):
        with pytest.raises(ArgumentError, match=text):
            ekf.reset(covariance=bad)
    rate = ekf._local.largest_rate(ekf._at_rest(model.eta @ np.array(model.home)), np.zeros(0))
    assert ekf._head.steps == max(1, np.ceil(rate * H / extended_kalman.STEP_TIMES_RATE))
    assert ekf._head.doublings == max(
        0, np.ceil(np.log2(rate * H / extended_kalman.TRANSITION_TIMES_RATE))
    )
    slow = extended_kalman.LARGEST_RATE / rate
    if slow < 1.0:
        with pytest.raises(
            ArgumentError,
            match=rf"sample_time: given .* s, and the fastest eigenvalue is {rate:.3g} 1/s",
        ):
            flexgen.ExtendedKalmanFilter(model, sample_time=1.01 * slow)
    for bad_time in (1.1, 9e-7, True):
        with pytest.raises(ArgumentError, match=r"sample_time: given .*, expected 1e-6 to 1 s"):
            flexgen.ExtendedKalmanFilter(model, sample_time=bad_time)


def test_torque_of_a_disturbance_is_in_the_estimate() -> None:
    """Signals of an estimate from its states, with and without disturbances."""
    model = flexgen.read("planar5_nmp")
    for with_them in (True, False):
        ekf = flexgen.ExtendedKalmanFilter(model, disturbances=with_them)
        n = model.dof
        n_a = model.n_a
        z = np.random.default_rng(0).normal(size=(4, len(ekf.states)))
        found = ekf._estimate(z, z + 1, z[:, :2], z[:, 0])
        assert_allclose(found.q_a, z[:, :n_a])
        assert_allclose(found.v_a, z[:, n : n + n_a])
        assert_allclose(found.q_m, z[:, n_a:n])
        assert_allclose(found.v_m, z[:, n + n_a : 2 * n])
        assert_allclose(found.disturbance, z[:, 2 * n :] if with_them else np.zeros((4, 2)))
        assert_allclose(found.deviation, z + 1)
        assert_allclose(found.normalized, z[:, 0])


def test_false_alarms_are_as_rare_as_the_number_of_runs_states(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Residuals of runs without contact, drawn at random with heavy tails, and no margin."""
    robot = flexgen.read("elbow")
    detector = flexgen.CollisionDetector(robot, 1e-3)
    assert detector.false_alarms == 1.0
    own = detector.detect
    rng = np.random.default_rng(0)
    draw = lambda: np.exp(rng.standard_normal((1, 2)))  # noqa: E731
    alarms = 0
    bound = 2 / 10
    for _ in range(2000):
        monkeypatch.setattr(detector, "detect", lambda q_m, tau_m: Detection(q_m, None))
        thresholds = detector.calibrate([(draw(), draw()) for _ in range(9)], margin=1.0)
        alarms += bool((draw() > thresholds).any())
    assert detector.false_alarms == pytest.approx(bound)
    # of motors that do not depend on each other
    assert alarms / 2000 == pytest.approx(1 - 0.9**2, abs=0.02)
    monkeypatch.setattr(detector, "detect", own)
    still = np.zeros((3, 2))
    assert own(still, still).false_alarms == pytest.approx(bound)
    monkeypatch.setattr(detector, "detect", lambda q_m, tau_m: Detection(q_m, None))
    detector.calibrate([(draw(), draw())] * 99, margin=0.9)
    assert detector.false_alarms == 1.0
