"""Numbers of flexgen/feedback/loop by other routes: SciPy's integrators, matrices by hand, sums
written out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag, expm
from scipy.signal import bilinear, cont2discrete, freqz

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.hysteresis.lugre import without_states
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.statics import hold_motors
from flexgen.feedback.loop import (
    case,
    closed_loop,
    control,
    hysteresis,
    margins,
    result,
    robots_in_c,
    robustness,
)
from flexgen.feedback.loop.channels import channels_of
from flexgen.feedback.loop.controller_files import system_controller
from flexgen.feedback.loop.controllers import Cascade, Linear, times
from flexgen.feedback.loop.gains import PID, PPI, motor_inertias
from flexgen.feedback.loop.hardware import DriveHardware, SensorChannels
from flexgen.feedback.loop.interface import Compiled, Measurement, Reference, Setup
from flexgen.feedback.loop.law_motion import LawMotion
from flexgen.feedback.loop.margins import LoopAtPose, as_linear, state_rows
from flexgen.feedback.loop.named_controllers import FeedforwardOnly
from flexgen.feedback.loop.noises import Noises
from flexgen.feedback.loop.plants import LocalDynamics, check_motion, plants_of
from flexgen.feedback.loop.reference import MotionReference, time_grid
from flexgen.feedback.loop.result import ControlRun, PlantRun
from flexgen.feedback.loop.sampled_model import PoseModel, PoseModels, elastic_gears
from flexgen.feedback.loop.timing import Timing
from flexgen.feedback.sampled_plant import hold_effects, sample_model
from flexgen.model.elements import BacklashSpring, Body, CubicSpring, LinearSpring, PiecewiseSpring
from flexgen.model.position_servo.filters import LowPass, Notch
from flexgen.simulation.environment.disturbances import Disturbance, disturbance_table, rows_of

CHANCE = np.random.default_rng(7)
A3 = CHANCE.normal(size=(3, 3))
B3 = CHANCE.normal(size=(3, 2))
H = 0.1


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.1, 0.17, 0.2, 0.3, 0.35])
def test_a_sampled_model_with_delay_is_the_solution_with_late_steps(delay: float) -> None:
    """Torques (k, 2) sent at the samples act ``delay`` later: exact solution piece by piece."""
    F, G = sample_model(A3, B3, H, delay)
    late = math.ceil(delay / H - 1e-9)
    assert F.shape == (3 + 2 * late, 3 + 2 * late) and G.shape == (3 + 2 * late, 2)
    sent = CHANCE.normal(size=(7, 2))
    z = np.zeros(len(F))
    x = np.zeros(3)

    def move(x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        whole = expm(np.block([[A3, (B3 @ u)[:, None]], [np.zeros((1, 4))]]) * h)
        return whole[:3, :3] @ x + whole[:3, 3]

    for k in range(7):
        whole = int(delay / H + 1e-9)
        rest = delay - whole * H
        if rest > 1e-9:
            x = move(x, sent[k - whole - 1] if k > whole else np.zeros(2), rest)
        x = move(x, sent[k - whole] if k >= whole else np.zeros(2), H - rest)
        z = F @ z + G @ sent[k]
        assert_allclose(z[:3], x, atol=1e-12)


def test_effects_of_a_hold_add_up_to_that_of_the_whole_interval() -> None:
    before, after = hold_effects(A3, B3, H, 0.03)
    whole = np.linalg.solve(A3, (expm(A3 * H) - np.eye(3)) @ B3)
    assert_allclose(before + after, whole, atol=1e-13)
    assert_allclose(after, np.linalg.solve(A3, (expm(A3 * 0.07) - np.eye(3)) @ B3), atol=1e-13)


def measured(q_m: np.ndarray, sensors: tuple[float, ...] = ()) -> Measurement:
    return Measurement(np.atleast_1d(q_m), np.array(sensors))


def planned(q_m: np.ndarray, tau_m: np.ndarray, sensors: tuple[float, ...] = ()) -> Reference:
    none = np.zeros(0)
    return Reference(np.atleast_1d(q_m), np.array(sensors), np.atleast_1d(tau_m), none, none, none)


def cascade() -> Cascade:
    filters = (LowPass(30.0), Notch(12.0, 0.05, 0.8))
    return Cascade(np.array([9.0, 4.0]), np.array([0.5, 2.0]), np.array([3.0, 0.0]), filters)


def test_a_cascade_as_matrices_has_the_torques_of_its_steps() -> None:
    """Random angles and references through both; the matrices see only their difference. A sensor
    is not used.
    """
    law = cascade()
    h = 2e-3
    law.begin(h).reset()
    linear = as_linear(law, h, 3)
    assert linear.order == 2 * (2 + 4)
    linear.reset()
    q = np.zeros((12, 2))
    q[1:] = CHANCE.normal(size=(11, 2))
    ref = np.zeros((12, 2))
    ref[1:] = CHANCE.normal(size=(11, 2))
    for k in range(12):
        tau = CHANCE.normal(size=2)
        y = measured(q[k], (5.0,))
        wanted = planned(ref[k], tau, (4.0,))
        assert_allclose(linear.step(k, y, wanted), law.step(k, y, wanted), rtol=1e-9, atol=1e-9)
    assert as_linear(object(), h, 3) is None
    given = Linear(
        np.eye(2)[None] * 0.5, np.ones((1, 2, 3)), np.ones((1, 2, 2)), np.ones((1, 2, 3))
    )
    assert as_linear(given, h, 3).A.shape == (2, 2)


def test_a_step_of_a_cascade_by_hand_and_its_limit() -> None:
    law = Cascade(np.array([10.0]), np.array([0.5]), np.array([4.0]), (), np.array([3.0]))
    law.begin(0.01).reset()

    def step(q: float, ref: float, tau: float = 0.0) -> float:
        return float(law.step(0, measured(np.array(q)), planned(np.array(ref), np.array(tau)))[0])

    assert step(0.0, 0.0, 1.0) == pytest.approx(1.0)
    w = 0.02 / 0.01 + 10 * (0.02 - 0.005) - 0.005 / 0.01
    assert step(0.005, 0.02) == pytest.approx(0.5 * (w + 4 * w * 0.01))
    second = (0.05 - 0.02) / 0.01 + 10 * (0.05 - 0.006) - 0.001 / 0.01
    total = w * 0.01 + second * 0.01
    # above the limit: 3
    assert step(0.006, 0.05, 2.0) == pytest.approx(2.0 + 0.5 * (second + 4 * total))
    third = 0.0 + 10 * (0.05 - 0.006)
    # the second was not summed
    assert step(0.006, 0.05) == pytest.approx(0.5 * (third + 4 * (w + third) * 0.01))
    law.reset()
    assert step(0.3, 0.3) == 0.0


def test_filters_keep_their_response_at_their_frequency() -> None:
    """Against SciPy's bilinear transform with the frequency warped."""
    for found, b, a, f in (
        (LowPass(30.0, 0.6).section(2e-3), [1.0], [1.0, 1.2, 1.0], 30.0),
        (Notch(12.0, 0.05, 0.8).section(2e-3), [1.0, 0.1, 1.0], [1.0, 1.6, 1.0], 12.0),
    ):
        warped = 2 / 2e-3 * np.tan(np.pi * f * 2e-3)
        scale = warped ** -np.arange(2.0, -1, -1)
        expected = bilinear(np.array(b) * scale[-len(b) :], np.array(a) * scale, 1 / 2e-3)
        assert_allclose(np.r_[found], np.r_[expected[0], expected[1][1:]], rtol=1e-10)
        response = freqz(found[:3], [1.0, *found[3:]], [2 * np.pi * f * 2e-3])[1][0]
        assert_allclose(response, np.polyval(b, 1j) / np.polyval(a, 1j), rtol=1e-10)
    for f in (0.0, 250.0, 300.0):
        with pytest.raises(
            ArgumentError, match=r"filter: given .* Hz, expected more than 0 and less than 250 Hz"
        ):
            LowPass(f).section(2e-3)


def test_parts_of_a_linear_controller_follow_each_other() -> None:
    A = np.array([[[0.5]], [[-0.2]]])
    B = np.array([[[1.0, 2.0]], [[0.0, 1.0]]])
    C = np.array([[[3.0]], [[4.0]]])
    D = np.array([[[1.0, 0.0]], [[0.0, 5.0]]])
    law = Linear(A, B, C, D, 2)
    law.reset()
    z = 0.0
    e = np.array([0.3, -0.7])
    for k in range(5):
        p = min(k // 2, 1)
        u = law.step(
            k, measured(np.array(1.0), (2.0,)), planned(np.array(1.3), np.array(7.0), (1.3,))
        )
        assert u == pytest.approx(7.0 + C[p, 0, 0] * z + D[p, 0] @ e)
        z = A[p, 0, 0] * z + B[p, 0] @ e
    assert_allclose(times(A3, np.array([1.0, -2.0, 0.5])), A3 @ [1.0, -2.0, 0.5])
    for text, given in (
        ("samples", {"samples": 0}),
        ("A: given", {"A": np.ones(3)}),
        ("D: given", {"D": np.nan * D}),
    ):
        with pytest.raises(ArgumentError, match=text):
            Linear(**{"A": A, "B": B, "C": C, "D": D, **given})


def test_a_compiled_controller_runs_in_the_same_thread_one_robot_after_another() -> None:
    """If it says nothing else, as controllers of a user do: they may not return."""
    found = Compiled(1, np.zeros((1, 8), np.uint8), 8, {}, None)
    assert (found.foreign, found.together) == (False, 0)


def test_gains_of_a_pid_are_those_of_its_cascade() -> None:
    k_p = np.array([10.0, 6.0])
    k_i = np.array([8.0, 0.0])
    k_d = np.array([2.0, 3.0])
    found = PID(k_p, k_i, k_d).cascade()
    assert_allclose(found.position_gain + found.integral_gain, k_p / k_d)
    assert_allclose(found.position_gain * found.integral_gain, k_i / k_d)
    assert_array_equal(found.speed_gain, k_d)
    assert np.all(found.position_gain >= found.integral_gain)
    with pytest.raises(
        ArgumentError, match=r"k_i: given \[13\.\], expected at most .* = \[12\.5\]"
    ):
        PID(np.array([10.0]), np.array([13.0]), np.array([2.0])).cascade()
    assert PID(np.array([10.0]), np.array([12.5]), np.array([2.0])).cascade().integral_gain == 2.5
    with pytest.raises(ArgumentError, match=r"k_d: given \[0\.\], expected gains > 0"):
        PID(np.array([1.0]), np.array([0.0]), np.array([0.0])).cascade()


def rest_of(model: object, q_a: np.ndarray | None = None) -> list[np.ndarray]:
    """One point of a motion at rest without torque."""
    q = np.full(model.n_a, 0.3) if q_a is None else q_a
    q_m = model.eta @ q[list(model.i_g)]
    zero_a = np.zeros((1, model.n_a))
    zero_m = np.zeros((1, model.n_m))
    return [q[None], zero_a, zero_a, q_m[None], zero_m, zero_m, zero_m]


def test_gains_by_frequencies() -> None:
    model = flexgen.read("elbow")
    motion = rest_of(model)
    stiff, soft = motor_inertias(model, motion)
    M = np.array(derive(model).function("mass_matrix")(motion[0][0]))
    back = np.linalg.inv(model.eta)
    rotor = np.array([m.inertia for m in model.motors])
    assert_allclose(stiff, np.diag(back.T @ M @ back) + rotor, rtol=1e-6)
    assert_allclose(soft, rotor, rtol=1e-6)
    found = PPI(2.0, 5.0, 0.5).cascade(model, 1e-3, motion)
    assert_allclose(found.position_gain, 4 * np.pi)
    assert_allclose(found.integral_gain, np.pi)
    assert_allclose(found.speed_gain, np.minimum(10 * np.pi * stiff, 0.3 * soft / 1e-3))
    assert_array_equal(found.torque_max, [m.torque_max or 0.0 for m in model.motors])
    assert_allclose(PPI(2.0, 1e5, 0.5).cascade(model, 0.5, motion).speed_gain, 0.6 * soft)
    assert PPI(1.0, 2.0, 3.0).frequencies(model, []) == {
        "position_hz": 1.0,
        "speed_hz": 2.0,
        "integral_hz": 3.0,
    }
    part = PPI(speed_hz=7.0).frequencies(model, motion)
    assert part["speed_hz"] == 7.0 and part["position_hz"] == pytest.approx(
        5 * part["integral_hz"]
    )
    for bad in ({"position_hz": -1.0}, {"speed_hz": 1.1e5}, {"filters": 3}):
        with pytest.raises(ArgumentError):
            PPI(**bad)
    PPI(0.0, 1e5)
    with pytest.raises(
        ArgumentError,
        match=r"motion: given arrays of shapes .*, expected finite q_a, v_a, a_a \(k, 2\)",
    ):
        check_motion(model, motion[:6])


def simple_loop(gain: float, delay: float = 0.0) -> LoopAtPose:
    """x' = u, u = -gain y, sampled with H: z = 1 - gain H."""
    none = np.zeros((1, 0))
    plant = PoseModel(
        np.zeros((1, 1)), np.ones((1, 1)), none, none, np.ones((1, 1)), none, none, none
    )
    law = Linear(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[gain]]))
    return LoopAtPose(plant, law, H, delay)


def test_margins_of_an_integrator_with_proportional_control() -> None:
    """Eigenvalue 1 - k h; stable up to k h = 2; with a delay d < h: z^2 - z (1 - k (h - d)) + k
    d.
    """
    loop = simple_loop(4.0)
    assert loop.largest_eigenvalue() == pytest.approx(0.6)
    assert loop.largest_eigenvalue(4.0) == pytest.approx(0.6)
    found = loop.margins()
    assert (
        found.stable
        and found.largest_eigenvalue == pytest.approx(0.6)
        and found.gain == pytest.approx(5.0, rel=1e-5)
    )
    k = 4.0
    d = 0.05
    assert loop.largest_eigenvalue(1.0, d) == pytest.approx(
        np.abs(np.roots([1, -(1 - k * (H - d)), k * d])).max()
    )
    assert simple_loop(4.0, d).largest_eigenvalue() == pytest.approx(
        loop.largest_eigenvalue(1.0, d)
    )
    # whole samples: z^(m+1) - z^m + k h; at the margin the rest is interpolated by the search
    # itself
    assert (
        loop.largest_eigenvalue(1.0, found.delay_s - 1e-4)
        < 1.0
        < loop.largest_eigenvalue(1.0, found.delay_s + 1e-4)
    )
    bad = simple_loop(21.0).margins()
    assert (bad.stable, bad.gain, bad.delay_s) == (
        False,
        0.0,
        0.0,
    ) and bad.largest_eigenvalue == pytest.approx(1.1)
    for arguments, text in (
        ((1.0, -1.0), "more_delay_s"),
        ((1.0, 25.61), r"expected 0 to 25\.6 s"),
        ((1e10,), "gain"),
    ):
        with pytest.raises(ArgumentError, match=text):
            loop.largest_eigenvalue(*arguments)
    assert "1 states of the robot, 0 of the controller, samples of 100 ms, delay 50 ms" in repr(
        simple_loop(1.0, 0.05)
    )


def test_the_response_of_a_loop_is_its_transfer_function() -> None:
    """Plant h/(z - 1), controller 2 + 3 * 0.5/(z - 0.2); the frequencies are spaced evenly in the
    logarithm.
    """
    none = np.zeros((1, 0))
    plant = PoseModel(
        np.zeros((1, 1)), np.ones((1, 1)), none, none, np.ones((1, 1)), none, none, none
    )
    law = Linear(np.array([[0.2]]), np.array([[0.5]]), np.array([[3.0]]), np.array([[2.0]]))
    found = LoopAtPose(plant, law, H, 0.0).response(0.1)
    assert_allclose(found.hz, np.geomspace(0.1, 4.99, 600))
    z = np.exp(2j * np.pi * found.hz * H)
    L = H / (z - 1) * (2 + 1.5 / (z - 0.2))
    assert_allclose(found.gains[:, 0], np.abs(L), rtol=1e-9)
    assert_allclose(found.nyquist, 1 + L, rtol=1e-9)
    two = np.eye(2)
    rest = np.zeros((2, 0))
    plant = PoseModel(
        np.zeros((2, 2)), np.array([[1.0, 0.5], [0.0, 2.0]]), rest, rest, two, rest, rest, rest
    )
    K = np.array([[2.0, -1.0], [0.5, 3.0]])
    law = Linear(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), K)
    both = LoopAtPose(plant, law, H, 0.0).response(0.1)
    L = K @ plant.B * (H / (np.exp(2j * np.pi * both.hz * H) - 1))[:, None, None]
    assert_allclose(both.gains, np.linalg.svd(L, compute_uv=False), rtol=1e-9)
    assert_allclose(both.nyquist, np.linalg.det(np.eye(2) + L), rtol=1e-9)
    late = simple_loop(2.0, 0.1).response(0.5)
    z = np.exp(2j * np.pi * late.hz * H)
    assert_allclose(late.nyquist, 1 + 2 * H / (z - 1) / z, rtol=1e-9)
    for low in (0.0, 5.0):
        with pytest.raises(ArgumentError, match=r"low_hz: given .*, expected 1e-06 to 4\.99 Hz"):
            simple_loop(1.0).response(low)


def test_the_largest_stable_value_is_found_by_bisection() -> None:
    asked: list[float] = []

    def stable(x: float) -> bool:
        asked.append(x)
        return x < 2.3

    assert margins._find_largest(stable, 1.0, [1.5, 2.0, 3.0, 4.0]) == pytest.approx(2.3, abs=2e-6)
    assert len(asked) == 3 + margins.BISECTIONS
    assert margins._find_largest(lambda x: True, 1.0, [2.0]) == np.inf
    assert margins._find_largest(lambda x: x < 1.2, 1.0, [2.0]) == pytest.approx(1.2, abs=1e-5)


def test_the_linear_model_of_a_pose_is_the_slope_of_the_accelerations() -> None:
    """A, B, forces on the arm and on the tool, output: by differences of `forward_dynamics` with
    sensors.
    """
    model = channels_of(flexgen.read("elbow"), ("tool_accelerometer", "tool_gyro")).model
    equations = derive(model)
    motion = rest_of(model)
    motion[1] = np.array([[0.4, -0.3]])
    motion[4] = (model.eta @ [0.4, -0.3])[None]
    found = PoseModels(model).at(motion)
    n = model.dof
    x0 = np.r_[motion[0][0], motion[3][0], motion[1][0], motion[4][0]]
    forward = equations.function("forward_dynamics")

    def rate(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        a, a_m = forward(x[:2], x[4:6], x[2:4], x[6:8], u)
        return np.r_[x[4:], np.array(a).ravel(), np.array(a_m).ravel()]

    for x, u, expected in ((np.eye(8), 0, found.A.T), (0, np.eye(2), found.B.T)):
        for k, row in enumerate(expected):
            dx = x[k] if np.ndim(x) else np.zeros(8)
            du = u[k] if np.ndim(u) else np.zeros(2)
            slope = (rate(x0 + 1e-5 * dx, 1e-5 * du) - rate(x0 - 1e-5 * dx, -1e-5 * du)) / 2e-5
            # at other angles the motion of this point is not an equilibrium: see the next
            if k >= 4 or np.ndim(u):
                assert_allclose(row, slope, rtol=2e-4, atol=2e-5 * np.abs(slope).max())
    assert_array_equal(found.C[:2], np.hstack([np.zeros((2, 2)), np.eye(2), np.zeros((2, 4))]))
    J = np.array(equations.function("jacobian")(motion[0][0]))[:3]
    M = np.array(equations.function("mass_matrix")(motion[0][0]))
    rotor = np.diag([m.inertia for m in model.motors])
    inverse = np.linalg.inv(block_diag(M, rotor))
    assert_allclose(found.push[n:], inverse @ np.r_[J.T, np.zeros((2, 3))], rtol=1e-8, atol=1e-12)
    assert_allclose(found.arm[n:, :2], inverse[:, :2], rtol=1e-8, atol=1e-12)
    pull = inverse[:, :2] - inverse[:, 2:] @ np.linalg.inv(model.eta).T
    assert_allclose(found.arm[n:, 2:], pull, rtol=1e-8, atol=1e-12)
    assert not found.arm[:n].any() and not found.push[:n].any() and elastic_gears(model) == [0, 1]
    assert_allclose(found.W[:, :2], J[["xyz".index(a) for a in model.output.axes]])
    assert not found.W[:, 2:].any()
    k = model.n_m
    by_q, by_v, by_a = (
        np.array(x) for x in equations.function("sensor_derivatives")(*[x[0] for x in motion[:3]])
    )
    rows = (
        np.hstack([by_q, np.zeros((len(by_q), 2)), by_v, np.zeros((len(by_q), 2))])
        + by_a @ found.A[n : n + 2]
    )
    assert_allclose(found.C[k:], rows, atol=1e-9)
    assert_allclose(found.D[k:], by_a @ found.B[n : n + 2], atol=1e-12)
    assert_allclose(found.D_arm[k:], by_a @ found.arm[n : n + 2], atol=1e-12)
    assert not found.D[:k].any() and not found.D_arm[:k].any()
    state = state_rows(model)
    assert_array_equal(state @ np.r_[1:5, 11:15.0], [1, 2, 11, 12, 3, 4, 13, 14])


def test_other_robots_rest_where_their_springs_hold_them() -> None:
    model = flexgen.read("planar5_nmp")
    made = plants_of(
        model,
        {"model": {}, "soft": {"stiffness": 0.8}, "loaded": {"payload": 2.0, "damping": 3.0}},
    )
    assert made.names == ("model", "soft", "loaded") and made.loads[:2] == ("", "")
    assert made.loads[2].startswith("+2 kg at ") and made.values.shape == (3, len(made.parameters))
    for p, column in zip(made.parameters, made.values.T, strict=True):
        factor = {"stiffness": (1, 0.8, 1), "damping": (1, 1, 3)}.get(
            p.name.split(".")[-1], (1, 1, 1)
        )
        expected = (
            np.array(factor) * p.value
            if p.name != "payload.mass"
            else p.value + np.array([0, 0, 2.0])
        )
        assert_allclose(column, expected)
    local = LocalDynamics(derive(model, tuple(p.name for p in made.parameters)))
    q_m = model.eta @ [0.2, 0.4]
    start = np.array([0.2, 0.4, *[0.0] * (model.n_a - 2)])
    q_a, tau = local.rest(q_m, made.values[1], start)
    residual = derive(model, tuple(p.name for p in made.parameters)).function("residual")
    still = np.zeros(model.n_a)
    none = np.zeros(model.n_m)
    r_a, r_m = residual(q_a, still, still, q_m, none, none, tau, made.values[1])
    assert np.abs(np.array(ca.vertcat(r_a, r_m))).max() < 1e-8
    for plant, text in (
        ({"stiffness": -0.1}, r"given the factor -0\.1, expected 0 to 100"),
        ({"stiffness": 101}, "given the factor 101"),
        ({"payload": -1e9}, "kg to add to the payload"),
        ({"payload": 1.1e5}, "expected .* to 100000 kg"),
        ({"stiffness": True}, "expected a number"),
    ):
        with pytest.raises(ArgumentError, match=text):
            plants_of(model, {"x": plant})
    plants_of(model, {"a": {"stiffness": 0}, "b": {"stiffness": 100}, "c": {"payload": 1e5}})
    motion = [np.tile(x, (1, 1)) for x in (q_a, still, still, q_m, none, none, tau)]
    M, D, K, _ = (x[0] for x in local.matrices(motion, made.values[1]))
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    assert local.largest_rate(motion, made.values[1]) == pytest.approx(
        np.abs(np.linalg.eigvals(A)).max(), rel=1e-6
    )


def test_the_fastest_rate_of_a_loop_with_states_by_hand() -> None:
    """Swings of springs with elements and bristles that stick, slips n |d'| K_h/W, slides |v| s0/F
    of the motors.
    """
    elements = [
        {"stiffness": 2e5, "lost_motion": 1e-4},
        {"stiffness": 1e5, "lost_motion": 4e-4, "exponent": 3.0},
    ]
    bristles = {
        "coulomb": 0.5,
        "static": 0.8,
        "stribeck_speed": 4.0,
        "stiffness": 800.0,
        "damping": 1.5,
    }
    other = bristles | {"coulomb": 0.9, "static": 1.1, "stiffness": 500.0}
    changes = {
        "element.upper.dof.q1.gear.hysteresis": elements,
        "motor.m1.lugre": bristles,
        "motor.m2.lugre": other,
    }
    model = flexgen.read("elbow", overrides=changes)
    (states,) = hysteresis.split_plants(model, plants_of(model, {"model": {}}))[1]
    plain = without_states(model)
    local = LocalDynamics(derive(plain))
    ratio = np.diag(model.eta)
    K = [dof.gear.spring.stiffness for element in model.elements for dof in element.dofs]
    q = np.array([0.2, 0.4])
    still = np.zeros((1, 2))
    points = [q[None], still, still, (model.eta @ q)[None], still, still, still]

    def rate(v_a: list[float], v_m: list[float]) -> float:
        motion = {"v_a": np.array([[0.0, 0.0], v_a]), "v_m": np.array([v_m, [0.0, 0.0]])}
        return hysteresis.largest_rate(local, points, motion, np.zeros(0), states)

    M, D, K_0, _ = (np.array(x[0]) for x in local.matrices(points, np.zeros(0)))
    gear = np.array([1.0, 0.0, -1.0 / ratio[0], 0.0])
    K_0 = K_0 + 3e5 * np.outer(gear, gear) + np.diag([0.0, 0.0, 800.0, 500.0])
    D = D + np.diag([0.0, 0.0, 1.5, 1.5])
    A = np.block(
        [[np.zeros((4, 4)), np.eye(4)], [-np.linalg.solve(M, K_0), -np.linalg.solve(M, D)]]
    )
    assert rate([0.0, 0.0], [0.0, 0.0]) == pytest.approx(
        np.abs(np.linalg.eigvals(A)).max(), rel=1e-6
    )
    W = np.array([1e-4, 4e-4]) * K[0] / 2
    slips = max(2e5 / W[0], 3.0 * 1e5 / W[1])
    assert rate([500.0, 0.0], [0.0, 0.0]) == pytest.approx(500.0 * slips)
    assert rate([0.0, 9e9], [0.0, 0.0]) == rate([0.0, 0.0], [0.0, 0.0])  # has no elements
    assert rate([0.0, 0.0], [1e3, 0.0]) == pytest.approx(1e3 * max(800.0 / 0.5, slips / ratio[0]))
    assert rate([0.0, 0.0], [0.0, 1e3]) == pytest.approx(1e3 * 500.0 / 0.9)


def test_accuracy_of_a_pose_takes_the_orientations_of_the_robots(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Errors are added to the reference; orientations are those of the joints; robots that failed
    are left out.
    """
    model = flexgen.read("elbow")
    equations = derive(model)
    q = np.array([[[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]], [[0.2, 0.2], [0.3, 0.3], [0.4, 0.7]]])
    runs = [
        SimpleNamespace(name=f"r{k}", failure="", q_a=x, error=np.full((3, 3), 0.01 * k))
        for k, x in enumerate(q)
    ]
    runs.append(SimpleNamespace(name="r2", failure="diverged", q_a=q[0], error=np.zeros((3, 3))))
    R = np.arange(27.0).reshape(3, 9)
    y = np.arange(9.0).reshape(3, 3)
    reference = SimpleNamespace(y_ref=y, R_ref=R, time=np.arange(3.0), path_end=1.5)
    seen: dict[str, object] = {}

    @dataclass(frozen=True)
    class Found:
        corner: int = 0

    def accuracy(*motion: object, **named: object) -> Found:
        seen.update(named | {"motion": motion})
        return Found()

    monkeypatch.setattr(result, "path_accuracy", accuracy)
    monkeypatch.setattr(result, "find_corners", lambda *_: "corners")
    monkeypatch.setattr(result, "corner_figures", lambda corners, *motion: {"corner": len(motion)})
    monkeypatch.setattr(result, "columns_in", lambda *_: [0, 2])
    made = SimpleNamespace(
        runs=runs,
        reference=reference,
        model=model,
        unit="m",
        solution=SimpleNamespace(move="line"),
    )
    assert ControlRun.accuracy(made, band=0.5).corner == 3  # type: ignore[arg-type]
    time, planned, attained, end = seen["motion"]  # type: ignore[misc]
    assert_array_equal(time, [0.0, 1.0, 2.0])
    assert end == 1.5 and (seen["robots"], seen["unit"], seen["band"]) == (("r0", "r1"), "m", 0.5)
    assert_array_equal(planned, y[:, [0, 2]])
    assert_allclose(attained, [y[:, [0, 2]], y[:, [0, 2]] + 0.01])
    given, turned = seen["orientations"]  # type: ignore[misc]
    assert_array_equal(given, R.reshape(3, 3, 3))
    forward = equations.function("forward_kinematics")
    assert_allclose(turned, [[np.array(forward(x)[1]) for x in each] for each in q], atol=1e-12)


def test_numbers_of_a_linear_controller_that_do_not_change_come_first() -> None:
    """Sizes, the count of samples and the address of the matrices; then states, which are zero."""
    A = np.zeros((2, 2, 2))
    B = np.zeros((2, 2, 3))
    C = np.zeros((2, 1, 2))
    D = np.ones((2, 1, 3))
    setup = Setup(q_m=np.zeros((4, 1)), sample_s=1e-3, n_a=2, n_y=3, n_ref=2)
    made = Linear(A, B, C, D, samples=7).compiled(setup)
    head = made.memory[:, : made.fixed].copy().view(np.int64)
    assert (
        made.fixed == 48
        and head[:, :5].tolist() == [[1, 3, 2, 2, 7]] * 4
        and (head[:, 5] != 0).all()
    )
    assert made.memory.shape == (4, 48 + 8 * (4 * 2 + 3 + 2)) and not made.memory[:, 48:].any()


def test_disturbances_as_functions_of_time() -> None:
    t = np.array([-1.0, 0.0, 0.5, 1.0, 1.999, 2.0, 3.0])
    cases = {
        Disturbance("step", "m1", 2.0, 0.5): [0, 0, 2, 2, 2, 2, 2],
        Disturbance("step", "m1", 2.0, 0.5, 1.5): [0, 0, 2, 2, 2, 0, 0],
        Disturbance("pulse", "m1", -1.0, 0.0, 1.0): [0, -1, -1, 0, 0, 0, 0],
        Disturbance("ramp", "m1", 4.0, 0.0, 2.0): [0, 0, 1, 2, 3.998, 4, 4],
    }
    for made, expected in cases.items():
        assert_allclose(made.values(t), expected, atol=1e-12)
    chirp = Disturbance("chirp", "m1", 3.0, 0.5, 1.5, (2.0, 8.0))
    growth = np.log(4.0) / 1.5
    s = t - 0.5
    expected = np.where(
        (s >= 0) & (t < 2), 3 * np.sin(2 * np.pi * 2.0 * (np.exp(growth * s) - 1) / growth), 0
    )
    assert_allclose(chirp.values(t), expected, atol=1e-9)
    assert [x.end_s for x in (*cases, chirp)] == [np.inf, 2.0, 1.0, np.inf, 2.0]
    noise = Disturbance("noise", "m1", 0.5, 0.0, 4.0, (10.0, 20.0))
    long = np.arange(0.0, 4.0, 1e-3)
    x = noise.values(long, 3)
    lines = 40
    f = 10 + 10 * (np.arange(lines) + 0.5) / lines
    phase = 2 * np.pi * np.random.default_rng(3).random(lines)
    assert_allclose(
        x,
        0.5 * np.sqrt(2 / lines) * np.sin(2 * np.pi * np.outer(long, f) + phase).sum(axis=1),
        atol=1e-10,
    )
    assert x.std() == pytest.approx(0.5, rel=0.2)
    assert Disturbance("noise", "m1", 1.0, 0.0, 0.01, (1.0, 2.0)).values(np.zeros(1), 3)[
        0
    ] == pytest.approx(np.sqrt(2) * np.sin(phase[0]))
    assert (
        len(np.unique(Disturbance("noise", "m1", 1.0, 0.0, 99.0, (1.0, 9.0)).values(long))) > 3000
    )


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (
            ("bump", "m1", 1.0),
            "given kind 'bump', expected one of step, pulse, ramp, chirp, noise",
        ),
        (("step", "m1", np.inf), "step on m1, size: given inf"),
        (("step", "m1", 1.0, np.nan), "start_s: given nan"),
        (("pulse", "m1", 1.0), "length_s: given none"),
        (("pulse", "m1", 1.0, 0.0, 0.0), r"length_s: given 0\.0, expected a time > 0"),
        (("step", "m1", 1.0, 0.0, np.inf), "length_s: given inf"),
        (("chirp", "m1", 1.0, 0.0, 1.0), "frequency_hz: given None, expected two increasing"),
        (("chirp", "m1", 1.0, 0.0, 1.0, (2.0, 2.0)), "expected two increasing"),
        (("noise", "m1", 1.0, 0.0, 1.0, (0.0, 2.0)), "expected two increasing"),
        (("noise", "m1", 1.0, 0.0, 1.0, (1.0, np.inf)), "expected two increasing"),
        (("ramp", "m1", 1.0, 0.0, 1.0, (1.0, 2.0)), "expected none for this kind"),
    ],
)
def test_wrong_disturbances(given: tuple, text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        Disturbance(*given)


def test_disturbances_of_robots_side_by_side() -> None:
    push = Disturbance("step", "tool.y", 5.0)
    twist = Disturbance("step", "m2", 1.0, 0.5)
    noise = Disturbance("noise", "m1", 1.0, 0.0, 1.0, (1.0, 9.0))
    t = np.array([0.25, 0.75])
    table = disturbance_table({0: (push,), 1: (twist, noise)}, ["m1", "m2"], t, 2, 4)
    assert table.shape == (2, 8, 2)
    assert_array_equal(table[:, 3, 0], [5, 5])
    assert_array_equal(table[:, 1, 1], [0, 1])
    assert_array_equal(table[:, 0, 1], noise.values(t, 5))
    assert np.count_nonzero(table) == 5
    assert disturbance_table({0: (push,), 1: (push,)}, ["m1"], t, 2).shape == (2, 7, 1)
    assert disturbance_table({0: (), 1: ()}, ["m1"], t, 2) is None
    assert [rows_of(x, ["a", "b"]) for x in ("b", "tool.x", "tool.rz")] == [1, 2, 7]
    with pytest.raises(ArgumentError, match="given the place 'c', expected one of a, b, tool"):
        rows_of("c", ["a", "b"])


def test_channels_by_name_with_their_noises() -> None:
    model = flexgen.read("elbow")
    own = replace(channels_of(model, "tool_accelerometer").model.sensors[0], name="acc")
    model, motors = replace(model, sensors=(own,)), [m.name for m in model.motors]
    found = channels_of(model, ("motors", own.name), {"motors": 2e-4, own.channels[0]: 0.7})
    assert found.names == (*motors, *own.channels) and found.index.tolist() == list(
        range(len(found.names))
    )
    assert_allclose(found.noise, [2e-4, 2e-4, 0.7, *[own.noise] * (len(own.channels) - 1)])
    found = channels_of(model, (own.channels[-1], motors[1]))
    assert found.index.tolist() == [2 + len(own.channels) - 1, 1] and found.model.sensors == (own,)
    assert found.noise.tolist() == [own.noise, 1e-4]
    assert channels_of(model, "motors", 3e-4).noise.tolist() == [3e-4, 3e-4]
    virtual = channels_of(model, ("tool_accelerometer", "tool_gyro", "link_encoders"))
    assert virtual.accelerating and not channels_of(model, ("tool_gyro", "motors")).accelerating
    assert virtual.noise.tolist() == [0.05] * 3 + [1e-3] * 3 + [
        1e-5
    ] * 2 and virtual.index.tolist() == list(range(2, 10))
    kinds = [(s.type, s.place, len(s.axes), s.unit, s.delay_s) for s in virtual.model.sensors]
    names = [c.name for c in model.coordinates]
    assert kinds == [
        ("accelerometer", "tool", 3, "m/s^2", 0.0),
        ("gyro", "tool", 3, "rad/s", 0.0),
        *[("link_encoder", name, 0, "rad", 0.0) for name in names],
    ]
    encoders = channels_of(model, "link_encoders", {"link_encoders": 4e-5})
    assert encoders.noise.tolist() == [4e-5] * 2
    late = replace(model, sensors=(replace(own, delay_s=1e-3),))
    for given, noise, text in (
        ((), None, r"outputs: given \(\), expected names: motors,"),
        ((1,), None, r"outputs: given \(1,\)"),
        (("motors", motors[0]), None, f"given '{motors[0]}' twice"),
        (("nothing",), None, "given 'nothing', expected one of motors"),
        (("motors",), {"x": 1.0}, "noise: given 'x', expected one of the outputs"),
        (("motors",), 0.0, f"noise of {motors[0]}: given 0.0"),
    ):
        with pytest.raises(ArgumentError, match=text):
            channels_of(model, given, noise)
    with pytest.raises(
        ArgumentError, match=r"given the sensor .* with delay_s = 0\.001, expected one without"
    ):
        channels_of(late, own.name)


def test_noises_relative_to_the_largest_torques() -> None:
    motors = [SimpleNamespace(torque_max=x) for x in (3.0, None, 7.0)]
    assert Noises(SimpleNamespace(motors=motors)).largest.tolist() == [3.0, 7.0, 7.0]
    assert Noises(SimpleNamespace(motors=motors[1:2])).largest.tolist() == [1.0]
    for bad, text in (
        ((0.0,), "torque_noise"),
        ((1.0, 0.0), "disturbance_rate"),
        ((1.0, 1.0, -1.0), "tool_force"),
    ):
        with pytest.raises(ArgumentError, match=text):
            Noises(SimpleNamespace(motors=motors), *bad)


def test_sensors_of_a_model_have_whole_delays_of_the_controller() -> None:
    one = SimpleNamespace(
        name="a", sample_s=None, delay_s=2e-3, noises=(0.5, 0.5), channels=("x", "y")
    )
    two = SimpleNamespace(name="b", sample_s=1e-3, delay_s=0.0, noises=(0.1,), channels=("z",))
    found = control._channels(SimpleNamespace(sensors=(one, two)), 1e-3)
    assert found.noise.tolist() == [0.5, 0.5, 0.1] and found.delay_samples.tolist() == [2, 2, 0]
    assert not found.bias.any() and not found.resolution.any()
    one.delay_s = 1.4e-3
    with pytest.raises(
        ArgumentError,
        match=r"sensor a: given delay_s = 0\.0014 s, expected a multiple of 0\.001 s",
    ):
        control._channels(SimpleNamespace(sensors=(one,)), 1e-3)
    with pytest.raises(
        ArgumentError, match=r"sensor b: given sample_s = 0\.001 s, expected 0\.002 s"
    ):
        control._channels(SimpleNamespace(sensors=(two,)), 2e-3)


def test_times_of_a_controller_and_disturbances_of_robots() -> None:
    case._check_times(1e-6, 0.0)
    case._check_times(1.0, 64.0)
    for bad in ((9e-7, 0.0), (1.1, 0.0), (1e-3, -1e-9), (1e-3, 0.0641)):
        with pytest.raises(ArgumentError, match=r"(sample_time|delay): given .*, expected"):
            case._check_times(*bad)
    step = Disturbance("step", "m1", 1.0)
    assert case._of_lanes([step], ("a", "b")) == {0: (step,), 1: (step,)}
    assert case._of_lanes({"b": [step]}, ("a", "b")) == {0: (), 1: (step,)}
    for bad, text in (
        ({"c": [step]}, "given plant 'c', expected one of a, b"),
        ([1], "objects of flexgen"),
        (5, "objects"),
    ):
        with pytest.raises(ArgumentError, match=text):
            case._of_lanes(bad, ("a", "b"))


def test_steps_of_the_integration_make_the_delay_whole() -> None:
    assert closed_loop.integration_steps(DriveHardware(1e-3), 900.0) == 1
    assert closed_loop.integration_steps(DriveHardware(1e-3), 3100.0) == 4
    assert closed_loop.integration_steps(DriveHardware(1e-3, 0.4e-3), 1900.0) == 5
    assert closed_loop.integration_steps(DriveHardware(1e-3, 0.5e-3), 2900.0) == 4
    n = closed_loop.integration_steps(DriveHardware(1e-3, 1e-3 / np.pi), 10.0)
    errors = [abs(round(k / np.pi) / k - 1 / np.pi) for k in range(1, 65)]
    assert n == 1 + int(np.argmin(errors))


def test_seeds_are_those_of_split_mix() -> None:
    """The published sequence of SplitMix64 for seed 1234567, whose state the first number
    shifts.
    """

    def numbers(state: int, count: int) -> list[int]:
        out = []
        mask = 2**64 - 1
        for _ in range(count):
            state = (state + 0x9E3779B97F4A7C15) & mask
            z = state
            z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
            z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
            out.append(z ^ (z >> 31))
        return out

    assert numbers(1234567, 3) == [6457827717110365317, 3203168211198807973, 9817491932198370423]
    start = (5 * 0x9E3779B97F4A7C15 + 0x2545F4914F6CDD1D) % 2**64
    assert robots_in_c.seeds_of(5, 2).ravel().tolist() == numbers(start, 8)


def test_timing_of_a_law() -> None:
    made = Timing(1e-3, 2.25e-3, True, True)
    assert (
        made.whole == 2
        and made.rest_s == pytest.approx(0.25e-3)
        and made.ahead_s == pytest.approx(2.75e-3)
    )
    assert [
        (k, pytest.approx(s)) for k, s in [(3, 0.25e-3), (2, 1e-3), (1, 1e-3)]
    ] == made.segments()
    whole = Timing(1e-3, 3e-3, True)
    assert (whole.whole, whole.rest_s) == (3, 0.0) and [k for k, _ in whole.segments()] == [
        3,
        2,
        1,
    ]
    assert (
        Timing(1e-3).ahead_s == 0.0
        and Timing(1e-3, 2e-3).segments() == []
        and Timing(1e-3).segments() == []
    )


def motion_of(t: np.ndarray) -> dict[str, np.ndarray]:
    return {
        "q_a": np.stack([t**3, 1 - t], axis=1),
        "v_a": np.stack([3 * t**2, -1 + 0 * t], axis=1),
        "a_a": np.stack([6 * t, 0 * t], axis=1),
        "q_m": np.stack([50 * t**3], axis=1),
        "v_m": np.stack([150 * t**2], axis=1),
        "a_m": np.stack([300 * t], axis=1),
        "tau_m": np.stack([2 * t], axis=1),
    }


def test_the_planned_motion_of_a_law_rests_outside_the_trajectory() -> None:
    t = np.linspace(0.2, 1.2, 101)
    channels = motion_of(t)
    ports = {name: Port(name, (x.shape[1],), "", "") for name, x in channels.items()}
    labels = {name: tuple(map(str, range(x.shape[1]))) for name, x in channels.items()}
    given = Trajectory(t, channels, ports, labels)
    time = np.array([0.0, 0.2, 0.5, 1.2, 1.4])
    made = LawMotion(
        flexgen.read("elbow"), None, given, SimpleNamespace(time=time), 0.01, 0.0, False, 30.0
    )
    found = made.arm(0.1)
    at = np.array([0.1, 0.3, 0.6, 1.3, 1.5])
    inside = np.clip(at, 0.2, 1.2)
    moving = (at >= 0.2) & (at <= 1.2)
    expected = [
        inside**3,
        *(np.where(moving, x, 0.0) for x in (3 * at**2, 6 * at, 6 + 0 * at, 0 * at)),
    ]
    assert_allclose(found[:, :, 0], np.stack(expected, axis=1), atol=1e-6)
    assert_allclose(
        found[:, :2, 1], np.stack([1 - inside, np.where(moving, -1.0, 0.0)], axis=1), atol=1e-9
    )
    q, v = made.motors()[:, :, 0].T
    assert_allclose(q, 50 * np.clip(time, 0.2, 1.2) ** 3, atol=1e-6)
    assert_allclose(v, np.where((time >= 0.2) & (time <= 1.2), 150 * time**2, 0), atol=1e-6)
    x = CHANCE.normal(size=(4, 3, 2))
    out = made.difference(x)
    assert_array_equal(out[:, ::2], x[:, ::2])
    assert_allclose(out[1:, 1], np.diff(x[:, 0], axis=0) / 0.01)
    assert not out[0, 1].any()
    assert replace(made, exact_state=True).difference(x) is x
    channels = 2 + sum(len(s.channels) for s in made.model.sensors)
    assert made.state_channel == -1 and replace(made, exact_state=True).state_channel == channels
    assert made.steps_per_s == 30.0 and replace(made, delay_s=0.02).timing(True) == Timing(
        0.01, 0.02, True, True
    )
    assert replace(made, exact_state=True).timing() == Timing(0.01, 0.0, False, False)
    assert replace(made, exact_state=True).link_channels("x") is None
    with pytest.raises(
        ArgumentError,
        match=r"controller x: given the model elbow without a sensor of type link_encoder",
    ):
        made.link_channels("x")
    encoders = channels_of(made.model, "link_encoders").model.sensors
    own = made.model.sensors
    both = replace(made, model=replace(made.model, sensors=(*own, *encoders)))
    at = 2 + sum(len(s.channels) for s in own)
    assert both.link_channels("x").tolist() == [at, at + 1]
    late = replace(
        made, model=replace(made.model, sensors=(replace(encoders[0], delay_s=0.1), encoders[1]))
    )
    with pytest.raises(
        ArgumentError,
        match=r"sensor link_.*: given delay_s = 0\.1 s, expected 0 s for a link encoder",
    ):
        late.link_channels("x")


def test_samples_around_a_motion_and_their_parts() -> None:
    time = time_grid(-0.1, 0.25, 0.1, 0.15, 0.2)
    assert_allclose(time, -0.1 + 0.1 * np.arange(-2, 7))
    motion = motion_of(time)
    made = MotionReference(
        time, motion, 9 + motion["tau_m"], np.ones((9, 3)), np.zeros((9, 2)), None, -0.1, 0.25, 0.2
    )
    for name, part in zip(
        ("q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m"), made.parts(4), strict=True
    ):
        assert_array_equal(part, motion[name][[2, 6, 8]])
    row = made.rows()[3]
    plain = [
        *motion["q_m"][3],
        1,
        1,
        1,
        *made.held[3],
        *motion["v_m"][3],
        *motion["q_a"][3],
        *motion["v_a"][3],
    ]
    assert_array_equal(row, plain)
    state = [*motion["q_a"][3], *motion["v_a"][3], *motion["q_m"][3], *motion["v_m"][3]]
    assert_array_equal(made.rows(True)[3], [*plain[:4], *state, *plain[4:]])
    with pytest.raises(
        ArgumentError,
        match=r"sample_time: given 1e-06 s, which makes 2000003 samples, expected 2000000",
    ):
        time_grid(0.0, 2.000001, 1e-6, 0.0, 0.0)


def run_of(**more: object) -> tuple[ControlRun, PlantRun]:
    """A run of a planar robot whose errors are given: 6 samples, motion from 0.1 to 0.4 s, path
    until 0.4 s.
    """
    time = 0.1 * np.arange(6)
    error = np.array([[1, 0], [3, 4], [0, -6], [0, 1], [2, 0], [1, 1.0]]) * 1e-3
    robot = PlantRun(
        "nominal",
        np.zeros((6, 2)),
        np.zeros((6, 2)),
        np.array([[1.0, -7.0]] * 6),
        error,
        None,
        3,
        "",
        np.zeros((6, 2)),
        np.zeros((6, 0)),
        "+1 kg",
    )
    robot = replace(robot, **more)
    still = {"y_ref": np.zeros((6, 2)), "R_ref": None}
    model = flexgen.read("elbow")
    reference = SimpleNamespace(time=time, begin=0.1, end=0.4, path_end=0.4, **still)
    made = object.__new__(ControlRun)
    fields = {
        "model": model,
        "solution": SimpleNamespace(move=SimpleNamespace(name="line", type="tool_line")),
        "controller": "mine",
        "law": FeedforwardOnly(),
        "reference": reference,
        "hardware": DriveHardware(1e-3, 2.5e-4),
        "delay_samples": 2,
        "runs": (robot,),
        "steps": 4,
        "wall_s": 0.5,
    }
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made, robot


def test_figures_of_a_run_by_hand() -> None:
    made, robot = run_of()
    found = made.figures(robot)
    assert found["error_max_m"] == pytest.approx(6e-3) and found["error_end_m"] == pytest.approx(
        math.sqrt(2) * 1e-3
    )
    assert found["static_error_start_m"] == pytest.approx(1e-3) and found["error_max_rad"] is None
    assert (
        found["torque_max_Nm"] == 7.0
        and found["saturated_samples"] == 3
        and found["load"] == "+1 kg"
    )
    share = np.clip(made.reference.time / 0.4, 0, 1)[:, None]
    static = (1 - share) * robot.error[0] + share * robot.error[5]
    dynamic = np.linalg.norm(robot.error - static, axis=1) * (made.reference.time >= 0.1)
    assert_allclose(made.dynamic(robot), dynamic)
    assert dynamic[0] == 0.0 and found["dynamic_error_max_m"] == pytest.approx(dynamic.max())
    assert (
        made.tool_error_max_m == pytest.approx(6e-3)
        and made.tool_error_max_rad is None
        and made.unit == "m"
    )
    assert made.delay_s == pytest.approx(2.25e-3) and made.status == "done" and made.worst is robot
    text = str(made).splitlines()
    assert text[0] == "elbow, move line: controller mine at 1 ms, delay 2.25 ms: done"
    assert "error up to 6 mm" in text[1] and text[1].endswith(
        "torque up to 7 N m, 3 samples at the torque limit, load +1 kg"
    )
    assert (
        len(text) == 2
        and repr(robot) == "<PlantRun nominal: 6 samples, error up to 0.006, 3 saturated>"
    )
    data = made.to_dict()
    assert (
        data["simulated_s"] == pytest.approx(0.5)
        and data["sample_time_s"] == 1e-3
        and data["integration_steps"] == 4
    )
    turned, other = run_of(turn=np.array([9.0, 0.1, 0.3, 0.2, 0.0, 0.0]))
    assert turned.figures(other)["turn_max_rad"] == turned.figures(other)["error_max_rad"] == 0.3
    failed, other = run_of(failure="not finite")
    assert failed.status.startswith("unstable: nominal: not finite; lower the gains")
    assert math.isnan(failed.figures(other)["error_max_m"])
    assert failed.figures(other)["error_max_rad"] is None and failed.worst is other
    assert failed.to_dict()["accuracy"] is None
    assert data["accuracy"]["pose_accuracy_m"] == pytest.approx(math.sqrt(2) * 1e-3)
    assert failed.to_dict()["plants"][0]["error_max_m"] is None and "  nominal: not finite" in str(
        failed
    )
    object.__setattr__(
        made, "runs", tuple(replace(robot, name=f"r{k}", saturated=0) for k in range(22))
    )
    assert (
        str(made).splitlines()[-1] == "  and 2 more robots in .runs"
        and len(str(made).splitlines()) == 22
    )
    with pytest.raises(ArgumentError, match="plant: given 'x', expected one of r0, r1"):
        made["x"]
    assert made["r3"].name == "r3"


def test_trajectories_of_a_run_have_names_and_units() -> None:
    made, robot = run_of()
    object.__setattr__(made.reference, "held", np.ones((6, 2)))
    found = made.trajectory()
    assert_array_equal(found["error"], robot.error)
    assert_array_equal(found["tau_ff"], 1.0)
    assert (
        found.ports["error"].unit == "m"
        and found.ports["q_a"].unit == "rad"
        and found.meta["plant"] == "nominal"
    )


def test_hardware_out_of_range() -> None:
    for given, text in (
        ({"sample_s": 0.0}, "sample_s"),
        ({"sample_s": np.inf}, "sample_s"),
        ({"delay_s": 5e-4}, "delay_s"),
        ({"delay_s": -1e-9}, "delay_s"),
        ({"encoder_noise_rad": -1.0}, "encoder_noise_rad"),
        ({"torque_noise_Nm": np.inf}, "torque_noise_Nm"),
        ({"encoder_resolution_rad": -1e-9}, "encoder_resolution_rad"),
        (
            {"torque_speed": (((0.0, 1.0), (5.0, 2.0)), ())},
            r"torque_speed: given \(\(0.0, 1.0\).*the torque falls",
        ),
        ({"torque_speed": ((), ((0.0, 1.0),))}, "torque_speed: given .*two or more points"),
    ):
        with pytest.raises(ArgumentError, match=text):
            DriveHardware(**given)
    model = flexgen.read("elbow")
    model = replace(
        model,
        motors=tuple(
            replace(m, torque_max=x) for m, x in zip(model.motors, (None, 4.0), strict=True)
        ),
    )
    assert DriveHardware.from_model(model, sample_s=1.0) == DriveHardware(
        1.0, torque_max_Nm=(0.0, 4.0)
    )
    curve = ((0.0, 4.0), (100.0, 3.0))
    model = replace(model, motors=(replace(model.motors[0], torque_speed=curve), model.motors[1]))
    assert DriveHardware.from_model(model).torque_speed == (curve, ())
    assert DriveHardware(torque_speed=[list(map(list, curve)), []]) == DriveHardware(
        torque_speed=(curve, ())
    )
    default = DriveHardware()
    assert (
        default.sample_s,
        default.delay_s,
        default.encoder_noise_rad,
        default.torque_noise_Nm,
    ) == (5e-4, 0, 0, 0)
    ideal = SensorChannels.ideal(3)
    assert not any(
        getattr(ideal, x).any() for x in ("noise", "bias", "resolution", "delay_samples")
    )
    SensorChannels(np.ones(1), -np.ones(1), np.zeros(1), np.zeros(1))
    for k in (0, 2, 3):
        parts = [np.zeros(1) for _ in range(4)]
        parts[k] = -np.ones(1)
        with pytest.raises(ArgumentError, match="expected 1 finite numbers >= 0"):
            SensorChannels(*parts)


@pytest.mark.parametrize("dt", [0, None, 0.1, True, 0.2])
def test_systems_of_python_control_are_sampled_by_the_trapezoidal_rule(dt: object) -> None:
    A = -np.eye(2) * [1, 3]
    B = np.ones((2, 3))
    C = np.array([[1.0, 2.0]])
    D = np.ones((1, 3))
    system = SimpleNamespace(A=A, B=B, C=C, D=D, dt=dt)
    if dt == 0.2:
        with pytest.raises(
            ArgumentError, match=r"given a system with dt = 0\.2 s, expected 0\.1 s or 0"
        ):
            system_controller(system, 0.1)
        return
    found = system_controller(system, 0.1)
    expected = (
        cont2discrete((A, B, C, D), 0.1, "bilinear")[:4] if dt in (0, None) else (A, B, C, D)
    )
    for x, y in zip((found.A, found.B, found.C, found.D), expected, strict=True):
        assert_allclose(x, y)
    none = system_controller(SimpleNamespace(A=np.zeros((0, 0)), B=[], C=[], D=2.0, dt=dt), 0.1)
    assert (
        none.A.shape == (0, 0)
        and none.B.shape == (0, 1)
        and none.C.shape == (1, 0)
        and none.D == 2.0
    )


def test_robots_with_other_springs_and_masses() -> None:
    plant = robustness.Plant("x", 1.5, 2.0)
    assert robustness._spring(LinearSpring(10.0), 1.5) == LinearSpring(15.0)
    assert robustness._spring(CubicSpring(10.0, 4.0), 1.5) == CubicSpring(15.0, 6.0)
    assert robustness._spring(BacklashSpring(10.0, 0.1, 0.01), 1.5) == BacklashSpring(
        15.0, 0.1, 0.01
    )
    assert robustness._spring(PiecewiseSpring(10.0, 20.0, 0.1), 1.5) == PiecewiseSpring(
        15.0, 30.0, 0.1
    )
    body = robustness._body(Body(2.0, (0.1, 0.2, 0.3), ((1, 2, 3), (2, 4, 5), (3, 5, 6))), 2.0)
    assert (
        body.mass == 4.0
        and body.com == (0.1, 0.2, 0.3)
        and body.inertia == ((2, 4, 6), (4, 8, 10), (6, 10, 12))
    )
    model = flexgen.read("beam_arm")
    changed = robustness.perturb(model, plant)
    for old, new in zip(model.elements, changed.elements, strict=True):
        assert new.body.mass == 2 * old.body.mass
        if old.beam is not None:
            assert new.beam.mass_per_length == 2 * old.beam.mass_per_length
            assert [b.stiffness for b in new.beam.bendings] == [
                1.5 * b.stiffness for b in old.beam.bendings
            ]
        for before, after in zip(old.dofs, new.dofs, strict=True):
            if before.gear is not None and before.gear.spring is not None:
                assert after.gear.spring.stiffness == 1.5 * before.gear.spring.stiffness
            if before.spring is not None:
                assert after.spring.stiffness == 1.5 * before.spring.stiffness
    assert changed.payload.mass == 2 * model.payload.mass and changed.motors == model.motors
    for bad in (
        robustness.Plant("x", stiffness=0.0),
        robustness.Plant("x", mass=-1.0),
        robustness.Plant("x", np.inf),
    ):
        with pytest.raises(
            ArgumentError, match=r"plant x: given (stiffness|mass) .*, expected a positive factor"
        ):
            robustness.perturb(model, bad)


@pytest.mark.parametrize("feedback", [False, True])
def test_the_simulation_of_another_robot_is_that_of_scipy(feedback: bool) -> None:
    """14 ms of a robot with other springs under torques that push it; feedback with the integrator
    of the speed lag.
    """
    model = flexgen.read("elbow")
    nominal = derive(model)
    robot = derive(robustness.perturb(model, robustness.Plant("soft", 0.8)))
    t = np.linspace(-0.004, 0.008, 21)
    q = np.tile([0.3, 0.5], (21, 1)) + np.outer(np.clip(t, 0, 1) ** 2, [2.0, -3.0])
    v = np.outer(np.clip(t, 0, 1), [4.0, -6.0])
    tau = 3.0 * np.stack([np.cos(40 * t), np.sin(40 * t)], axis=1)
    channels = {"q_a": q, "q_m": q @ model.eta.T, "v_m": v @ model.eta.T, "tau_m": tau}
    ports = {name: Port(name, (2,), "", "") for name in channels}
    given = Trajectory(t, channels, ports, dict.fromkeys(channels, ("1", "2")))
    wanted = np.array([[0.1, 0.2], [0.3, 0.1]])
    path = SimpleNamespace(
        duration=0.006,
        q_start=q[0],
        sample=lambda t: SimpleNamespace(y=np.tile(wanted[0], (len(t), 1))[..., None], R=None),
    )
    gains = (
        robustness._gains(nominal, path, robustness.Bandwidth(50.0, 20.0, 10.0))
        if feedback
        else None
    )
    if gains is not None:
        M = np.array(nominal.function("mass_matrix")(q[0]))
        back = np.linalg.inv(model.eta)
        inertia = np.diag(back.T @ M @ back) + [m.inertia for m in model.motors]
        assert_allclose(gains[0], 50 * inertia)
        assert gains[1:] == (20.0, 10.0)
    run = robustness._Run(robot, path, given, 0.01, gains)
    times, found, largest = run._integrate()
    assert_allclose(times, np.linspace(-0.004, 0.01, 8))
    held = hold_motors(robot, given["q_m"][0], q[0])
    start_tau = held.tau_m - tau[0] if feedback else np.zeros(2)
    seen = [0.0]

    def torque(t: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        inside = np.clip(t, -0.004, 0.008)
        u = 3.0 * np.array([np.cos(40 * inside), np.sin(40 * inside)])
        if gains is None:
            return u, np.zeros(2)
        ref = run.angle(inside)
        rate = run.angle(inside, 1) if t == inside else 0.0
        lag = rate + 20.0 * (ref - x[2:4]) - x[6:8]
        return u + gains[0] * lag + x[8:], gains[0] * 10.0 * lag

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        u, more = torque(t, x)
        seen[0] = max(seen[0], np.abs(u).max())
        a, a_m = robot.function("forward_dynamics")(x[:2], x[4:6], x[2:4], x[6:8], u)
        return np.r_[x[4:8], np.array(a).ravel(), np.array(a_m).ravel(), more]

    x0 = np.r_[held.q_a, held.q_m, np.zeros(4), start_tau]
    expected = solve_ivp(
        rate, (-0.004, 0.01), x0, method="DOP853", t_eval=times, rtol=1e-9, atol=1e-11
    ).y
    assert_allclose(found, expected[:2].T, atol=1e-7)
    along = max(np.abs(torque(t, x)[0]).max() for t, x in zip(times, expected.T, strict=True))
    assert 0.99 * along <= largest <= 2 * seen[0]
    row = run.figures()
    error = np.linalg.norm(
        np.array([np.array(nominal.function("output")(x)).ravel() for x in found]) - wanted[0],
        axis=1,
    )
    assert row["error_max_m"] == pytest.approx(error.max()) and row[
        "error_start_m"
    ] == pytest.approx(error[0])
    assert row["error_end_m"] == pytest.approx(error[np.searchsorted(times, 0.006 - 1e-12)])
    assert row["error_max_rad"] is None and row["torque_max_Nm"] == largest


def test_equilibria_with_held_motors() -> None:
    equations = flexgen.derive("planar5_nmp")
    model = equations.model
    q_m = model.eta @ [0.3, -0.2]
    found = hold_motors(equations, q_m, np.array([0.3, -0.2, *[0.0] * (model.n_a - 2)]))
    still = np.zeros(model.n_a)
    none = np.zeros(model.n_m)
    r_a, r_m = equations.function("residual")(
        found.q_a, still, still, q_m, none, none, found.tau_m
    )
    assert (
        np.abs(np.array(ca.vertcat(r_a, r_m))).max() < 1e-7
        and np.abs(found.q_a[:2] - [0.3, -0.2]).max() < 0.1
    )
    assert_array_equal(found.q_m, q_m)
    for names, control_name, text in (
        ((), "feedback", "solutions: given moves none, expected solutions of one move"),
        (("a", "b"), "feedback", "given moves a, b"),
        ((), "both", "controls: given 'both', expected feedforward or feedback"),
    ):
        solutions = {name: SimpleNamespace(move=SimpleNamespace(name=name)) for name in names}
        with pytest.raises(ArgumentError, match=text):
            robustness.compare_plants(equations, solutions, controls=(control_name,))
    with pytest.raises(
        ArgumentError, match="control: given 'x', expected feedforward or feedback"
    ):
        robustness.tool_errors(equations, equations, None, "x")
    names = [(p.name, p.stiffness, p.mass) for p in robustness.PLANTS]
    stiff = [(f"stiffness {x:+d} %", 1 + x / 100, 1) for x in (5, -5, 20, -20)]
    assert names == [("nominal", 1, 1), *stiff, ("mass +5 %", 1, 1.05), ("mass -5 %", 1, 0.95)]
    assert robustness.Bandwidth() == robustness.Bandwidth(125.66370614359172, 20.0, 10.0)


def test_a_run_that_fails_has_infinite_errors() -> None:
    run = object.__new__(robustness._Run)

    def fail() -> None:
        raise SolverError("x")

    run._integrate = fail
    assert set(run.figures().values()) == {np.inf} and len(run.figures()) == 9


@pytest.mark.parametrize("moments", [False, True])
def test_figures_of_a_force_are_largest_sizes_of_its_parts(moments: bool) -> None:
    made = object.__new__(ControlRun)
    force = np.zeros((3, 6))
    assumed = np.zeros((3, 6))
    force[:, :3] = [[3.0, 4.0, 12.0], [0.0, 0.0, 5.0], [1.0, 2.0, 2.0]]
    assumed[:, :3] = [[3.0, 4.0, 0.0], [0.0, 0.0, 5.0], [1.0, 2.0, 2.0]]
    if moments:
        force[1, 3:] = [0.0, 8.0, 6.0]
    reference = SimpleNamespace(motion={result.CHANNEL: assumed}, time=np.zeros(3))
    vars(made).update(force=force, reference=reference)
    found = {"force_max_N": 13.0, "assumed_force_max_N": 5.0, "force_error_max_N": 12.0}
    lines = [
        "force of the process up to 13 N, in the feedforward up to 5 N, difference up to 12 N"
    ]
    if moments:
        found |= {"force_max_Nm": 10.0, "assumed_force_max_Nm": 0.0, "force_error_max_Nm": 10.0}
        lines.append(
            "moment of the process up to 10 N m, in the feedforward up to 0 N m, difference up "
            "to 10 N m"
        )
    assert made.force_figures() == found and made.force_lines() == tuple(lines)
    vars(made).update(force=None)
    assert made.force_figures() == {} and made.force_lines() == ()
    vars(made).update(reference=SimpleNamespace(motion={}, time=np.zeros(4)))
    assert made.assumed_force.shape == (4, 6) and not made.assumed_force.any()


# --- loops that cannot be ------------------------------------------------------------------------
def test_a_loop_is_refused_where_its_numbers_do_not_fit() -> None:
    model = flexgen.read("elbow")
    library = SimpleNamespace(precision="double", sizes={"n_a": 2, "n_s": 3})
    usual: dict[str, object] = {
        "model": model,
        "library": library,
        "hardware": DriveHardware(1e-3),
        "controller": None,
        "q_a": np.zeros((3, 2)),
        "q_m": np.zeros((3, 2)),
        "rate": 1000.0,
    }
    single = SimpleNamespace(precision="single", sizes={"n_a": 2})
    other = SimpleNamespace(precision="double", sizes={"n_a": 5})
    for changes, text in (
        (
            {"q_a": np.zeros((2, 2))},
            r"q_a, q_m: given shapes \(2, 2\), \(3, 2\), expected \(lanes, 2\), \(lanes, 2\)",
        ),
        ({"q_m": np.zeros((3, 1))}, r"q_a, q_m: given shapes \(3, 2\), \(3, 1\), expected"),
        (
            {"library": single},
            "library: given namespace.*, expected one of elbow in double precision",
        ),
        (
            {"library": other},
            "library: given namespace.*, expected one of elbow in double precision",
        ),
        ({"delay_samples": -1}, "delay_samples: given -1, expected 0 to 64"),
        (
            {"delay_samples": np.array([0, 65, 1])},
            r"delay_samples: given array\(.*\), expected 0 to 64",
        ),
        ({"steps": 0}, "steps: given 0, expected a whole number from 1 to 1000"),
        ({"steps": 1001}, "steps: given 1001, expected a whole number from 1 to 1000"),
        (
            {"steps": 3, "rate": 7600.0},  # 2.53 steps in a time constant
            r"steps: 3 integration steps a sample of 0\.001 s, and the fastest eigenvalue is "
            r"7\.6e\+03 1/s: "
            "expected at most 1000 and a step below 2.5 over the eigenvalue; use a smaller "
            "sample time",
        ),
        ({"rate": 1.1e6}, r"steps: 1100 integration steps a sample of 0\.001 s, .* at most 1000"),
        (
            {"hardware": DriveHardware(1e-3, 0.4e-3), "steps": 2},
            (
                r"delay_s: given 0\.0004, expected a whole number of integration steps of "
                r"0\.0005 s; take a multiple"
            ),
        ),
        (
            {"hardware": DriveHardware(1e-3, 0.5022e-3), "steps": 2},
            r"delay_s: given 0\.0005022, expected a whole number of integration steps",
        ),
        ({"sensors": SensorChannels.ideal(2)}, "sensors: given 2 channels, expected 3"),
    ):
        with pytest.raises(ArgumentError, match=text):
            closed_loop.ClosedLoop(**{**usual, **changes})  # type: ignore[arg-type]

    class Stop(Exception):
        pass

    class Last:
        """The controller that is compiled once all of that is right."""

        def compiled(self, setup: Setup) -> None:
            raise Stop(setup.n_y)

    for changes, n_y in (
        ({}, 2),
        ({"delay_samples": 64, "steps": 3, "rate": 7400.0}, 2),
        ({"hardware": DriveHardware(1e-3, 0.5e-3), "steps": 2}, 2),
        ({"sensors": SensorChannels.ideal(3)}, 5),
        ({"sensors": SensorChannels.ideal(3), "exact_state": True}, 13),
    ):
        with pytest.raises(Stop, match=f"^{n_y}$"):
            closed_loop.ClosedLoop(**{**usual, "controller": Last(), **changes})


def test_disturbances_of_a_loop_have_a_row_for_each_step() -> None:
    loop: Any = object.__new__(closed_loop.ClosedLoop)
    loop.model = flexgen.read("elbow")
    loop.steps = 2
    loop.lanes = 3
    loop._robots = SimpleNamespace(pushed=0, disturbed=9)
    assert loop._disturb(None, 5) == () and loop._robots.disturbed == 0
    torques = np.zeros((10, 8, 1))
    torques[:, :2] = 1.0
    kept = loop._disturb(torques, 5)
    assert loop._robots.disturbed == 1 and any(np.array_equal(x, torques) for x in kept)
    loop._disturb(np.repeat(torques, 3, axis=2), 5)
    assert loop._robots.disturbed == 3
    for shape in ((10, 8), (9, 8, 1), (10, 7, 1), (10, 8, 2)):
        with pytest.raises(ArgumentError) as caught:
            loop._disturb(np.zeros(shape), 5)
        assert str(caught.value) == f"disturbances: given shape {shape}, expected (10, 8, 1 or 3)"
    with pytest.raises(
        ArgumentError, match="disturbances: given entries that are not finite, expected numbers"
    ):
        loop._disturb(np.where(np.arange(8)[None, :, None] == 1, np.nan, torques), 5)
    push = torques.copy()
    push[4, 7] = 1e-3
    with pytest.raises(
        ArgumentError, match="a force on the tool needs a library with forward_dynamics_tool_force"
    ):
        loop._disturb(push, 5)
    loop._robots.pushed = 1
    pushing = [x for x in loop._disturb(push, 5) if x.dtype == np.uint8]
    assert [x.tolist() for x in pushing] == [[0, 0, 0, 0, 1, 0, 0, 0, 0, 0]]
