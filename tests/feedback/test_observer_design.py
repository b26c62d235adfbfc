"""Designs of observers: stationary gains by SciPy, states that no output shows, starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
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
from flexgen.feedback.observers import constant_gain, design

pytestmark = needs_compiler
PLANAR = flexgen.read("planar5_nmp")
TWO_MASS = flexgen.read(str(Path(__file__).parents[1] / "support" / "robots" / "two_mass.toml"))


def linear(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, push: np.ndarray
) -> PoseModel:
    return PoseModel(
        A, B, push, np.zeros((len(A), 0)), C, D, np.zeros((len(C), 0)), np.zeros((0, len(A)))
    )


def test_the_stationary_gain_solves_the_riccati_equation_of_scipy() -> None:
    """Of a stable random model: force on the tool and torques as white noise that is held,
    disturbances as a random walk.
    """
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 6)) - 4 * np.eye(6)
    B = rng.normal(size=(6, 2))
    push = rng.normal(size=(6, 3))
    at = linear(A, B, rng.normal(size=(2, 6)), 0.1 * rng.normal(size=(2, 2)), push)
    noises = Noises(PLANAR, 0.05, 1.3, 20.0)
    noise = np.array([0.02, 0.05])
    F, G, C, D, M = constant_gain.stationary(at, np.array([1, 0]), noise, noises, 0.01)
    whole = expm(0.01 * np.block([[A, B, push], [np.zeros((5, 11))]]))
    assert_allclose(np.hstack([F, G]), whole[:6, :8], rtol=1e-8)
    held = whole[:6, 8:] * 20.0
    torque = G * (0.05 * noises.largest)
    walk = np.diag((1.3 * noises.largest) ** 2 * 0.01)
    Q = block_diag(torque @ torque.T + held @ held.T, walk)
    assert_allclose(design.process_noise(at, G, noises, 0.01), Q, rtol=1e-8)
    rows = np.hstack([at.C[[1, 0]], at.D[[1, 0]]])
    assert_allclose(np.hstack([C, D]), rows)
    transition = block_diag(F, np.eye(2))
    transition[:6, 6:] = G
    R = np.diag(noise**2)
    P = solve_discrete_are(transition.T, rows.T, Q, R)
    gain = P @ rows.T @ np.linalg.inv(rows @ P @ rows.T + R)
    assert_allclose(M, gain, rtol=1e-5, atol=1e-8)


def test_states_have_names() -> None:
    y = ("q1", "q2", "q3", "m1", "m2")
    speeds = tuple(f"speed of {name}" for name in y)
    assert design.state_names(PLANAR, False) == (*y, *speeds)
    own = ("disturbance of m1", "disturbance of m2")
    assert design.state_names(PLANAR, True) == (*y, *speeds, *own)


def check(
    *outputs: list[float], torques: int = 1, A: np.ndarray | None = None, **springs: float
) -> None:
    """Arm and motor of mass 1: a spring and a damper between them, a spring from the arm to the
    ground.
    """
    k = springs.get("stiffness", 50.0)
    d = springs.get("damping", 0.1)
    K = np.array([[k + springs.get("ground", 0.0), -k], [-k, k]])
    D = d * np.array([[1.0, -1.0], [-1.0, 1.0]])
    own = np.block([[np.zeros((2, 2)), np.eye(2)], [-K, -D]]) if A is None else A
    C = np.array(outputs)
    B = np.array([[0.0], [0.0], [0.0], [1.0]])
    at = linear(own, B, C, np.zeros((len(C), 1)), np.zeros((4, 3)))
    names = tuple(f"y{k}" for k in range(len(C)))
    channels = replace(channels_of(TWO_MASS, "motors"), names=names, index=np.arange(len(C)))
    states = design.state_names(TWO_MASS, torques > 0)
    design.check_observable(at, channels, states, Noises(TWO_MASS), torques)


ARM, MOTOR, ARM_SPEED, MOTOR_SPEED = np.eye(4).tolist()


def test_a_motor_angle_determines_the_arm_behind_its_spring() -> None:
    check(MOTOR)
    check(MOTOR, ground=30.0)
    check(ARM)
    check(MOTOR, [0.0] * 4)  # another output that shows nothing
    check(MOTOR, torques=0)


@pytest.mark.parametrize(
    ("call", "hidden"),
    [
        (lambda: check(MOTOR, stiffness=0.0, damping=0.0), "y0, which do not determine q1;"),
        (lambda: check(ARM_SPEED, MOTOR_SPEED, torques=0), "y0, y1, .* determine q1, m1;"),
        (
            lambda: check(ARM_SPEED, MOTOR_SPEED, ground=30.0),
            "which do not determine q1, m1, disturbance of m1; measure more, such as all motor",
        ),
    ],
)
def test_states_that_no_output_shows_are_named(call: Callable[[], None], hidden: str) -> None:
    """An arm without a spring; places where speeds alone are seen; a torque that a spring to the
    ground hides.
    """
    with pytest.raises(ArgumentError, match=f"^outputs: given .*{hidden}"):
        call()


def test_what_decays_by_itself_need_not_be_seen() -> None:
    """An arm that its own spring and damper bring to rest, without a connection to the motor."""
    A = np.zeros((4, 4))
    A[:2, 2:] = np.eye(2)
    A[2, 0] = -400.0
    A[2, 2] = -30.0
    check(MOTOR, A=A)
    A[2, 2] = 0.0
    with pytest.raises(ArgumentError, match="which do not determine q1, speed of q1; measure"):
        check(MOTOR, A=A)


def test_eight_hidden_states_are_named_and_the_others_counted() -> None:
    n = 2 * PLANAR.dof
    at = linear(np.zeros((n, n)), np.zeros((n, 2)), np.eye(2, n), np.zeros((2, 2)), np.eye(n, 3))
    states = design.state_names(PLANAR, True)
    with pytest.raises(ArgumentError, match=r"q3, .*speed of m2 and 2 more; measure"):
        noises = Noises(PLANAR)
        design.check_observable(at, channels_of(PLANAR, "motors"), states, noises, 2)


def test_arrays_of_observers_are_checked_and_aligned() -> None:
    for size in (1, 7, 64):
        memory = design.allocate_aligned(size)
        assert memory.shape == (size,) and memory.ctypes.data % 64 == 0 and not memory.any()
    assert design.vector("x", [1, 2], 2).tolist() == [1.0, 2.0]
    assert design.record("y", [[1, 2]], 1, 2).flags["C_CONTIGUOUS"]
    for wrong in ([1.0], [[1.0, 2.0]], [1.0, np.inf]):
        with pytest.raises(ArgumentError, match=r"^x: given shape .*, expected \(2,\), finite"):
            design.vector("x", wrong, 2)
    with pytest.raises(ArgumentError, match=r"^y: given shape \(2,\), expected \(1, 2\)$"):
        design.record("y", [1.0, 2.0], 1, 2)


def test_a_filter_begins_at_rest_or_at_a_state() -> None:
    """Deviations of the start, an arm that its springs hold, or what is given."""
    ekf = flexgen.ExtendedKalmanFilter(PLANAR)
    n = PLANAR.dof
    n_a = PLANAR.n_a
    text = f"<ExtendedKalmanFilter {PLANAR.title}: 2 outputs, 12 states, samples of 1 ms>"
    assert repr(ekf) == text
    start = np.r_[np.full(n, 1e-3), np.full(n, 1e-2), 0.1 * ekf.noises.largest]
    assert_allclose(np.sqrt(np.diag(ekf.covariance)), start)
    e = flexgen.derive(PLANAR)
    q_m = PLANAR.eta @ np.array([0.2, 0.4])
    ekf.reset(q_m)
    z = ekf.state
    assert_allclose(z[n_a:n], q_m)
    assert_allclose(z[n:], 0.0)
    still = np.zeros(n_a)
    torque = np.array(e.function("elastic_torque")(z[:n_a], still)).ravel()
    load = np.array(e.function("inverse_dynamics")(z[:n_a], still, still)).ravel()
    assert_allclose(load[list(PLANAR.i_e)], torque, atol=1e-6 * np.abs(load).max())
    given = np.arange(1.0, 13.0) / 10
    P = np.diag(np.linspace(1.0, 2.0, 12)) + 0.1
    ekf.reset(state=given, covariance=P)
    assert_allclose(ekf.state, given)
    assert_allclose(ekf.covariance, P)


D = np.diag(10.0 ** np.arange(12))
CROSS = np.eye(12) + 1.1 * np.eye(12)[::-1]


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (np.eye(3), r"covariance: given shape \(3, 3\), expected a symmetric matrix \(12, 12\)"),
        (np.eye(12) + np.eye(12, k=1), "expected a symmetric matrix"),
        (np.diag(np.r_[0.0, np.ones(11)]), "given a matrix with a variance <= 0, expected a pos"),
        (CROSS, "given a matrix with a variance <= 0"),
        (D @ CROSS @ D, "given a matrix with a variance <= 0"),
    ],
)
def test_invalid_covariances_are_refused(wrong: np.ndarray, text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        flexgen.ExtendedKalmanFilter(PLANAR).reset(covariance=wrong)


@pytest.mark.parametrize("sample_time", [1.1, 9e-7, True])
def test_sample_times_of_a_filter_are_refused(sample_time: Any) -> None:
    with pytest.raises(ArgumentError, match=r"sample_time: given .*, expected 1e-6 to 1 s"):
        flexgen.ExtendedKalmanFilter(PLANAR, sample_time=sample_time)


@pytest.mark.parametrize("disturbances", [True, False])
def test_estimates_are_parts_of_the_state(disturbances: bool) -> None:
    """Also motors behind elastic gears; without disturbances these are zero."""
    ekf = flexgen.ExtendedKalmanFilter(PLANAR, disturbances=disturbances)
    n = PLANAR.dof
    n_a = PLANAR.n_a
    z = 0.1 * np.random.default_rng(0).normal(size=len(ekf.states))
    ekf.reset(state=z)
    found = ekf.step(PLANAR.eta @ np.array(PLANAR.home), np.zeros(2))
    z = ekf.state
    assert_allclose(np.r_[found.q_a, found.q_m], z[:n])
    assert_allclose(np.r_[found.v_a, found.v_m], z[n : 2 * n])
    assert_allclose(found.disturbance, z[2 * n :] if disturbances else np.zeros(2))
    assert_allclose(found.deviation, np.sqrt(np.diag(ekf.covariance)))
    assert len(found.q_a) == n_a
