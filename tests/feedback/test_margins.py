"""Loops at poses: closed forms of margins and responses; linear models by differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from law_cases import at_rest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import block_diag

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.channels import channels_of
from flexgen.feedback.loop.controllers import Linear
from flexgen.feedback.loop.margins import LoopAtPose, as_linear, state_rows
from flexgen.feedback.loop.sampled_model import PoseModel, PoseModels, elastic_gears

H = 0.1


def loop_of(B: np.ndarray, law: Linear, delay: float = 0.0) -> LoopAtPose:
    """``x' = B u``, ``y = x`` under a law."""
    n = len(B)
    none = np.zeros((n, 0))
    plant = PoseModel(np.zeros((n, n)), B, none, none, np.eye(n), none, none, none)
    return LoopAtPose(plant, law, H, delay)


def gain_of(D: np.ndarray) -> Linear:
    n = len(D)
    return Linear(np.zeros((0, 0)), np.zeros((0, n)), np.zeros((n, 0)), D)


def integrator(gain: float, delay: float = 0.0) -> LoopAtPose:
    return loop_of(np.ones((1, 1)), gain_of(np.array([[gain]])), delay)


@pytest.mark.parametrize(("delay", "critical"), [(0.0, 2.0), (H, 1.0)])
def test_margins_of_an_integrator(delay: float, critical: float) -> None:
    """``z - 1 + k h``, one sample late ``z^2 - z + k h``: at the gain margin |z| is one, at the
    angle pi or pi/3. A lag turns the loop gain by its angle; just before the largest delay the
    loop is stable.
    """
    k = 4.0
    loop = integrator(k, delay)
    found = loop.margins()
    assert found.stable and found.gain == pytest.approx(critical / (k * H), rel=1e-5)
    assert found.gain_hz == pytest.approx((0.5 if not delay else 1 / 6) / H, rel=1e-4)
    assert found.gain_db == pytest.approx(20 * np.log10(found.gain))
    z = np.exp(2j * np.pi * found.phase_hz * H)
    L = k * H / (z - 1) / (z if delay else 1.0)
    assert_allclose(L * np.exp(-1j * np.radians(found.phase_deg)), -1.0, rtol=1e-3)
    sizes = [loop.largest_eigenvalue(1.0, found.delay_s + d) for d in (-1e-4, 1e-4)]
    assert sizes[0] < 1.0 < sizes[1]
    unstable = integrator(1.05 * critical / H, delay).margins()
    assert (unstable.stable, unstable.gain, unstable.delay_s) == (False, 0.0, 0.0)
    assert unstable.largest_eigenvalue > 1.0 and unstable.to_dict()["gain_db"] is None


def test_a_part_of_a_sample_late_is_a_quadratic_equation() -> None:
    """``z^2 - z (1 - k (h - d)) + k d``."""
    k = 4.0
    d = 0.05
    expected = np.abs(np.roots([1, -(1 - k * (H - d)), k * d])).max()
    assert integrator(k).largest_eigenvalue(1.0, d) == pytest.approx(expected)
    assert integrator(2.0, d).largest_eigenvalue(2.0) == pytest.approx(expected)
    text = "1 states of the robot, 0 of the controller, samples of 100 ms, delay 50 ms"
    assert text in repr(integrator(1.0, 0.05))


def test_a_loop_that_is_always_stable_has_no_margin() -> None:
    """A plant that decays fast under a weak gain."""
    loop = integrator(1e-9)
    loop.model.A[:] = -1e3
    found = loop.margins()
    assert found.stable and found.gain == found.delay_s == np.inf and np.isnan(found.gain_hz)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda loop: loop.largest_eigenvalue(1.0, -1.0), "more_delay_s: given -1.0, expected 0"),
        (lambda loop: loop.largest_eigenvalue(1.0, 25.61), r"expected 0 to 25\.6 s"),
        (lambda loop: loop.largest_eigenvalue(1e10), "gain: given"),
        (lambda loop: loop.response(0.0), r"low_hz: given 0.0, expected 1e-06 to 4\.99 Hz"),
        (lambda loop: loop.response(5.0), r"low_hz: given 5.0, expected 1e-06 to 4\.99 Hz"),
    ],
)
def test_arguments_out_of_range_are_refused(
    call: Callable[[LoopAtPose], object], text: str
) -> None:
    with pytest.raises(ArgumentError, match=text):
        call(integrator(1.0))


def test_the_response_of_a_loop_is_its_transfer_function() -> None:
    """A controller with a state, two channels, and a late one; frequencies evenly in the
    logarithm.
    """
    law = Linear(*(np.array([[x]]) for x in (0.2, 0.5, 3.0, 2.0)))
    found = loop_of(np.ones((1, 1)), law).response(0.1)
    assert_allclose(found.hz, np.geomspace(0.1, 4.99, 600))
    z = np.exp(2j * np.pi * found.hz * H)
    L = H / (z - 1) * (2 + 1.5 / (z - 0.2))
    assert_allclose(found.gains[:, 0], np.abs(L), rtol=1e-9)
    assert_allclose(found.nyquist, 1 + L, rtol=1e-9)
    assert_allclose(integrator(2.0, H).response(0.1).nyquist, 1 + 2 * H / (z - 1) / z, rtol=1e-9)
    B = np.array([[1.0, 0.5], [0.0, 2.0]])
    K = np.array([[2.0, -1.0], [0.5, 3.0]])
    both = loop_of(B, gain_of(K)).response(0.1)
    L = K @ B * (H / (z - 1))[:, None, None]
    assert_allclose(both.gains, np.linalg.svd(L, compute_uv=False), rtol=1e-9)
    assert_allclose(both.nyquist, np.linalg.det(np.eye(2) + L), rtol=1e-9)


def test_laws_as_matrices_are_their_first_part() -> None:
    assert as_linear(object(), H, 3) is None
    parts = Linear(*(np.array([[[x]], [[9.0]]]) for x in (0.2, 0.5, 3.0, 2.0)))
    found = as_linear(parts, H, 1)
    assert found is not None and found.A.tolist() == [[0.2]] and found.D.tolist() == [[2.0]]


def test_the_linear_model_of_a_pose_is_the_slope_of_the_accelerations() -> None:
    """A, B, forces on arm, gears and tool, signals of sensors: by differences of the equations and
    from the mass matrix.
    """
    model = channels_of(flexgen.read("elbow"), ("tool_accelerometer", "tool_gyro")).model
    equations = derive(model)
    motion = at_rest(model, [0.3, 0.3])
    v = np.array([0.4, -0.3])
    motion[1] = v[None]
    motion[4] = (model.eta @ v)[None]
    x0 = np.r_[motion[0][0], motion[3][0], v, model.eta @ v]
    forward = equations.function("forward_dynamics")
    signals = equations.function("sensors")

    def rates(z: np.ndarray) -> np.ndarray:
        x = x0 + z[:8]
        tau = motion[6][0] + z[8:]
        a, a_m = forward(x[:2], x[4:6], x[2:4], x[6:8], tau)
        y = np.array(signals(x[:2], x[4:6], a)).ravel()
        return np.r_[x[4:], np.array(a).ravel(), np.array(a_m).ravel(), x[2:4], y]

    # the point of a moving robot has its acceleration
    moves = forward(motion[0][0], v, motion[3][0], model.eta @ v, motion[6][0])
    motion[2], motion[5] = (np.array(y).reshape(1, 2) for y in moves)
    found = PoseModels(model).at(motion)
    slopes = np.array([(rates(z) - rates(-z)) / 2e-5 for z in 1e-5 * np.eye(10)]).T
    whole = np.block([[found.A, found.B], [found.C, found.D]])
    scale = np.abs(slopes).max(axis=1, keepdims=True)
    assert (np.abs(whole - slopes) <= 2e-4 * scale).all()
    J = np.array(equations.function("jacobian")(motion[0][0]))[:3]
    M = np.array(equations.function("mass_matrix")(motion[0][0]))
    inverse = np.linalg.inv(block_diag(M, np.diag([m.inertia for m in model.motors])))
    assert_allclose(found.push[4:], inverse @ np.r_[J.T, np.zeros((2, 3))], rtol=1e-8, atol=1e-12)
    gears = inverse[:, :2] - inverse[:, 2:] @ np.linalg.inv(model.eta).T
    assert_allclose(found.arm[4:], np.hstack([inverse[:, :2], gears]), rtol=1e-8, atol=1e-12)
    assert not found.arm[:4].any() and not found.push[:4].any() and elastic_gears(model) == [0, 1]
    _, _, by_a = equations.function("sensor_derivatives")(*(x[0] for x in motion[:3]))
    assert_allclose(found.D_arm[2:], np.array(by_a) @ found.arm[4:6], atol=1e-12)
    assert_allclose(found.W[:, :2], J[["xyz".index(a) for a in model.output.axes]])
    assert not found.W[:, 2:].any() and not found.D_arm[:2].any()
    state = state_rows(model)
    assert_array_equal(state @ np.r_[1:5, 11:15.0], [1, 2, 11, 12, 3, 4, 13, 14])
