"""Linear quadratic laws: gains and filters by SciPy's Riccati solver, laws as recursions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from law_cases import arm, at_rest, case_of
from numpy.testing import assert_allclose
from scipy.linalg import block_diag, expm, solve_discrete_are
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.laws.lq import LQG, regulator, torque_scale
from flexgen.feedback.laws.state_lq import LQ
from flexgen.feedback.loop.channels import channels_of
from flexgen.feedback.loop.noises import Noises
from flexgen.feedback.loop.sampled_model import PoseModel, PoseModels
from flexgen.feedback.sampled_plant import sample_model

pytestmark = needs_compiler
H = 1e-3


def gain_of(at: PoseModel, delay: float, rho: float, u_max: np.ndarray) -> np.ndarray:
    """The gain of the cost that the module states, in m, s and N m."""
    F, G = sample_model(at.A, at.B, H, delay)
    n = len(at.A) // 2
    Q = block_diag(at.W.T @ at.W, 1e-4 * at.W.T @ at.W, np.zeros((len(F) - 2 * n,) * 2)) / 1e-6
    Q += 1e-12 * np.trace(Q) / len(Q) * np.eye(len(Q))
    R = rho * np.diag(u_max**-2.0)
    P = solve_discrete_are(F, G, Q, R)
    return np.linalg.solve(R + G.T @ P @ G, G.T @ P @ F)


def with_limits(model: flexgen.RobotModel, *limits: float | None) -> flexgen.RobotModel:
    motors = [replace(m, torque_max=x) for m, x in zip(model.motors, limits, strict=True)]
    return replace(model, motors=tuple(motors))


@pytest.mark.parametrize(
    ("limits", "scale"),
    [((3.0, None, 7.0), [3.0, 7.0, 7.0]), ((None, None, None), [1.0, 1.0, 1.0])],
)
def test_torques_without_limit_have_the_scale_of_the_largest(
    limits: tuple[float | None, ...], scale: list[float]
) -> None:
    model = with_limits(arm(), *limits)
    assert torque_scale(model).tolist() == Noises(model).largest.tolist() == scale


def held(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Effect of an input that is held for a sample."""
    whole = np.zeros((len(A) + B.shape[1],) * 2)
    whole[: len(A)] = np.hstack([A, B])
    return expm(whole * H)[: len(A), len(A) :]


@pytest.mark.parametrize(
    ("name", "sensors", "delay", "force"),
    [("elbow", True, 1.4 * H, 50.0), ("elbow", False, 0.0, 50.0), ("beam_arm", True, H, None)],
)
def test_lqg_is_a_stationary_filter_and_the_regulator_on_its_estimate(
    name: str, sensors: bool, delay: float, force: float | None
) -> None:
    """Noises written out; of a robot below 50 kg the force on the tool is its mass times 1 m/s^2.
    Signals that are not used have no weight.
    """
    model = flexgen.read(name)
    if force is None:
        beams = [e.beam for e in model.elements if e.beam is not None]
        force = sum(e.body.mass for e in model.elements) + model.payload.mass
        force += sum(b.length * b.mass_per_length for b in beams)
    else:
        model = channels_of(model, "tool_accelerometer").model
    options = LQG(7.0, 2e-4, sensors, 0.03, 0.5)
    found = options.linear(model, H, delay, at_rest(model))
    at = PoseModels(model).at(at_rest(model))
    F, G = sample_model(at.A, at.B, H, delay)
    n_m = model.n_m
    n = len(at.A)
    size = len(F)
    u_max = torque_scale(model)
    gain = regulator(at, F, G, 7.0, u_max)
    expected = gain_of(at, delay, 7.0, u_max)
    assert_allclose(gain, expected, rtol=1e-5, atol=1e-6 * np.abs(gain).max())
    full = block_diag(F, np.eye(n_m))
    full[:n, size:] = held(at.A, at.B)
    Q = 1e-18 * np.eye(size + n_m)
    torque = held(at.A, at.B) * (0.03 * u_max)
    push = held(at.A, at.push) * force
    Q[:n, :n] += torque @ torque.T + push @ push.T
    Q[size:, size:] += np.diag((0.5 * u_max) ** 2 * H)
    C = np.hstack([at.C, np.zeros((len(at.C), size + n_m - n))])
    own = [10 * x if sensors else 1e9 for s in model.sensors for x in s.noises]
    R = np.diag(np.r_[[2e-4] * n_m, own] ** 2)
    P = solve_discrete_are(full.T, C.T, Q, R)
    M = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    A, B, C_law, D = (x[0] for x in found.matrices)
    rng = np.random.default_rng(2)
    z = rng.normal(size=size + n_m)
    y = rng.normal(size=len(at.C))
    estimate = z + M @ (y - C @ z)
    u = -np.hstack([gain, np.eye(n_m)]) @ estimate
    after = full @ estimate + np.vstack([G, np.zeros((n_m, n_m))]) @ u
    assert_allclose(C_law @ z - D @ y, u, atol=1e-4 * np.abs(u).max())
    assert_allclose(A @ z - B @ y, after, atol=1e-4 * np.abs(after).max())


@pytest.mark.parametrize(("exact", "delay"), [(True, 1.4 * H), (True, 0.0), (False, 2 * H)])
def test_state_feedback_is_a_recursion_in_angles_and_torques(exact: bool, delay: float) -> None:
    """u = K (x_ref - x, torques under way), K of the pose in the middle of its part; speeds are
    measured, or differences of two samples.
    """
    case = case_of(arm(), H, delay, exact_state=exact)
    motion = case.law_motion()
    law = LQ(rho=0.5).bound(motion)
    model = motion.model
    count = len(motion.reference.time)
    assert len(law.matrices[0]) <= 40 < count / (law.samples - 1)
    rng = np.random.default_rng(3)
    for part in (0, 20, 39):
        middle = min(part * law.samples + law.samples // 2, count - 1)
        at = PoseModels(model).at(motion.reference.points(np.array([middle])))
        K = gain_of(at, delay, 0.5, torque_scale(model))
        n = model.n_a + model.n_m
        A, B, C, D = (x[part] for x in law.matrices)
        z = np.zeros(len(A))
        before = np.zeros(n)
        late = (K.shape[1] - 2 * n) // model.n_m
        under_way = [np.zeros(model.n_m)] * late
        for e in rng.normal(size=(4, B.shape[1])):
            arms = e[motion.link_channels("LQ")] if not exact else None
            angles, speeds = read_state(e, motion, arms, before)
            u = K[:, :n] @ angles + K[:, n : 2 * n] @ speeds
            u = u - K[:, 2 * n :] @ np.ravel(under_way)
            assert_allclose(C @ z + D @ e, u, rtol=1e-4, atol=1e-5 * np.abs(u).max())
            z = A @ z + B @ e
            before = angles
            under_way = [*under_way[1:], u] if late else []


def read_state(
    e: np.ndarray, motion: Any, arms: np.ndarray | None, before: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Errors of arm and motor angles, and of their speeds."""
    n = motion.model.n_m
    if arms is not None:
        angles = np.r_[arms, e[:n]]
        return angles, (angles - before) / motion.sample_s
    q_a, v_a, q_m, v_m = e[-4 * n :].reshape(4, n)
    return np.r_[q_a, q_m], np.r_[v_a, v_m]


def test_laws_that_do_not_fit_are_refused() -> None:
    motion = case_of(arm(), H).law_motion()
    rigid = replace(motion, model=flexgen.read("elbow@rigid"))
    text = "controller LQ: given the model elbow with rigid gears, expected elastic ones"
    with pytest.raises(ArgumentError, match=text):
        LQ().bound(rigid)
    for name in ("rho", "encoder_noise", "torque_noise", "disturbance_rate"):
        with pytest.raises(ArgumentError, match=f"controller, {name}"):
            LQG(**{name: 0.0})
    assert (LQG().title, LQ(2e-3).title) == ("lqg", "LQ, rho 0.002")
