"""Responses in large motions, corrected to those of small ones: against simulation in C, and in
closed form.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from identification_cases import poses_of, small_plan
from numpy.testing import assert_allclose
from scipy.special import jv
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.experiments.plan import default_free
from flexgen.identification.motions.motion_correction import correct_responses, obstacle
from flexgen.identification.responses import large_motions
from flexgen.identification.responses.large_motions import LargeMotions
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.residuals import Residuals

LITTLE = DriveHardware(5e-4, encoder_noise_rad=3e-6, torque_noise_Nm=1e-4)
SENSORS = [
    {
        "name": "acc",
        "type": "accelerometer",
        "element": "tool",
        "axes": ["x", "z"],
        "unit": "m/s^2",
    },
    {
        "name": "rate",
        "type": "gyro",
        "element": "tool",
        "axes": ["y"],
        "unit": "rad/s",
        "delay_s": 1e-3,
    },
    {"name": "seen", "type": "tracker", "position": [0.0, 0.05, 0.1], "axes": ["x"], "unit": "m"},
]


@cache
def measured(speed: float) -> Residuals:
    """A simulated experiment without noise, and the residuals of the robot itself."""
    model = flexgen.read("elbow", overrides={"sensor": SENSORS})
    plan = small_plan(model, poses_of(model, 2), speed_rms=speed, transients=3)
    data = flexgen.frf(flexgen.measure(plan, model, progress=False))
    return Residuals(ParameterVector(model, default_free(model)), data)


def away(residuals: Residuals, G: np.ndarray) -> np.ndarray:
    """Median relative difference from the responses in small motions, of each output."""
    small = measured(0.01)
    exact = correct_responses(small, small.vector.start)[0].G
    return np.median(
        (np.abs(G / exact - 1)).transpose(2, 0, 1, 3).reshape(exact.shape[2], -1), axis=1
    )


def left(speed: float) -> np.ndarray:
    """Median relative difference of each output after the correction for amplitude."""
    residuals = measured(speed)
    return away(residuals, correct_responses(residuals, residuals.vector.start)[0].G)


@needs_compiler
@pytest.mark.slow
def test_corrected_responses_of_a_simulation_are_those_of_small_motions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Planted: a correction of the wrong sign; without the motion between the lines; of drives
    that hardly hold.
    """
    residuals = measured(0.2)
    raw = residuals.data
    before = away(residuals, residuals.data.G)
    assert (before > 1e-6).all() and (left(0.2) < 0.05 * before).all()
    change = raw.G - correct_responses(residuals, residuals.vector.start)[0].G
    assert (away(residuals, raw.G + change) > 1.5 * before).all()
    with monkeypatch.context() as patched:
        patched.setattr(large_motions, "STEPS", 1)
        assert (left(0.2) > 0.3 * before).any()
    assert raw.gains is not None
    monkeypatch.setattr(residuals, "data", replace(raw, gains=0.1 * raw.gains))
    assert (left(0.2) > 0.3 * before).any()


@needs_compiler
@pytest.mark.slow
def test_what_is_left_falls_with_the_fourth_power_of_the_speed() -> None:
    assert (left(0.8) > 8 * left(0.4)).all()


def test_gravity_in_closed_form() -> None:
    """A joint moves by ``A cos t``: of ``a sin(q + A cos t)`` the part ``2 J_1(A) a cos q`` is at
    the line.

    The dynamic stiffness exchanges arm and motors, so that the motor angles show the torques that
    are not linear.
    """
    equations = derive("elbow")
    assert equations.model.dof == 4
    rest = np.array([0.5, -0.3, 0.0, 0.0])
    A = 0.3
    step = 1e-4
    gravity = equations.function("gravity")
    up, down = (float(gravity(rest[:2] + np.array([s, 0.0]))[0]) for s in (step, -step))
    exchange = np.broadcast_to(np.eye(4)[[2, 3, 0, 1]], (17, 4, 4)).astype(complex)
    linear = np.zeros((1, 4, 1), complex)
    linear[0, 0] = A
    found = LargeMotions(equations, np.zeros(0), [], lambda function: function).outputs(
        rest, np.array([8]), 1.0, exchange, 1e15 * exchange, linear
    )  # fmt: skip
    assert found[0, 0, 0] == pytest.approx(
        -(up - down) / (2 * step) * (2 * jv(1, A) - A), rel=1e-6
    )


@needs_compiler
@pytest.mark.slow
def test_parameters_and_their_deviations_in_large_motions() -> None:
    """Planted: responses that are not corrected. Gains that are not known make the deviations
    larger.

    Without noise, and without what the simulation of small motions differs from the linear model.
    """
    residuals = measured(0.4)
    small = measured(0.01)
    model = residuals.vector.model
    data = residuals.data
    exact = residuals.vector.start
    assert data.gains is not None
    data = replace(data, G=data.G - correct_responses(small, exact)[0].G + small.response(exact).G)
    found, plain, unsure = (
        flexgen.identify(model, responses, starts=1, floor=0.0, progress=False)
        for responses in (data, replace(data, torques=None), replace(data, gains=0 * data.gains))
    )
    deviations = np.sqrt(np.diag(found.formal_covariance))
    assert (np.abs(found.x - exact) < 2 * deviations).all()
    assert (np.abs(plain.x - exact) > 5 * deviations).all()
    shifts = np.abs(found.x - plain.x)
    assert deviations.max() == pytest.approx(0.1 * shifts.max(), rel=0.1)
    assert np.sqrt(np.diag(unsure.formal_covariance)).max() == pytest.approx(shifts.max(), rel=0.1)
    assert "not corrected for large motions" in plain.weak[-1] and not any(
        "large" in line for line in found.weak
    )


@pytest.fixture(scope="module")
def data() -> flexgen.Frf:
    """Responses of a short experiment."""
    model = flexgen.read("elbow")
    plan = small_plan(model, poses_of(model, 1), period_s=1.0, lines=10)
    return flexgen.frf(flexgen.measure(plan, model, progress=False))


@needs_compiler
def test_responses_that_cannot_be_corrected_have_a_reason(data: flexgen.Frf) -> None:
    assert data.torques is not None and not obstacle(data)
    assert "torques" in obstacle(replace(data, torques=None))
    assert "periods" in obstacle(replace(data, numbers=1_000_000 * data.numbers))


@needs_compiler
def test_noise_is_that_of_the_corrected_responses(data: flexgen.Frf) -> None:
    """``Y U^H`` changes with ``G U U^H``: planted, only G is corrected."""
    UU = np.eye(2) * np.ones((*data.G.shape[:2], 1, 1))
    data = replace(data, noise_UU=UU, noise_YU=data.G @ UU)
    residuals = Residuals(
        ParameterVector(flexgen.read("elbow"), default_free(flexgen.read("elbow"))), data
    )
    found, _ = correct_responses(residuals, residuals.vector.start)
    assert found.noise_YU is not None and np.allclose(
        found.noise_YU, found.G @ UU, rtol=1e-14, atol=0.0
    )
    assert not np.allclose(data.G, found.G, rtol=1e-9, atol=0.0)


@needs_compiler
def test_a_file_keeps_what_the_correction_needs(data: flexgen.Frf, tmp_path: Path) -> None:
    """And one whose arrays do not fit together is refused."""
    again = flexgen.Frf.load(data.save(tmp_path / "frf.npz"))
    assert all(
        np.array_equal(getattr(again, name), getattr(data, name))
        for name in ("torques", "numbers", "gains")
    )
    assert data.numbers is not None and data.torques is not None
    for wrong in (
        {"gains": None},
        {"numbers": -data.numbers},
        {"torques": data.torques[:, :, :1]},
        {"torques": 1e200 * data.torques},
    ):
        with pytest.raises(ArgumentError, match="torques"):
            flexgen.Frf.load(replace(data, **wrong).save(tmp_path / "wrong.npz"))


@pytest.mark.parametrize("channels", [[], [0]])
def test_large_motions_of_oscillators_follow_from_sums(
    channels: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two masses, a spring of `sin`, two steps by sums over 15 samples; a sensor of a product of
    three rates.
    """
    m = 0.5
    k = 8.0
    speed = 2.0
    lines = np.array([1, 3])
    rest = np.array([0.3, 0.1])
    q, v, a = (ca.SX.sym(name, 2) for name in ("q", "v", "a"))
    symbol = ca.SX.sym("m")
    force = k * ca.sin(q[0] - q[1])
    left = ca.vertcat(symbol * a[0] + force, a[1] + 3 * q[1] - force)
    equations: Any = Made(y=(q, v, a), left=left, symbols=symbol, model=Made(dof=2))
    monkeypatch.setattr(large_motions, "motor_rows", lambda model: np.array([[2.0, 1.0]]))
    monkeypatch.setattr(
        large_motions, "sensor_signals", lambda equations: ca.vertcat(v[0] ** 2 * a[1], q)
    )
    made = large_motions.LargeMotions(
        equations, np.array([m]), channels, lambda function: function
    )
    s = 1j * speed * np.arange(7)[:, None, None]
    K = k * np.cos(0.2) * np.array([[1, -1], [-1, 1]]) + np.diag([0, 3])
    Z = s**2 * np.diag([m, 1.0]) + 0.4 * s * np.eye(2) + K
    held = 0.1 * s * np.ones((2, 2))
    linear = np.array([[0.2 + 0.1j, 0.1], [-0.1j, 0.05j]])  # lines, coordinates
    found = made.outputs(rest, lines, speed, Z, held, linear[:, :, None])
    # samples, multiples
    turns = np.exp(1j * np.outer(np.arange(15) * 2 * np.pi / 15, np.arange(7)))

    def motion(Y: np.ndarray) -> list[np.ndarray]:
        return [np.real(turns @ x) for x in (Y, s[:, 0] * Y, s[:, 0] ** 2 * Y)]

    def spectrum(x: np.ndarray) -> np.ndarray:
        return np.asarray(turns.conj().T @ x) * 2 / 15

    def nonlinear(Y: np.ndarray) -> np.ndarray:
        x = motion(Y)[0] @ np.array([1, -1])
        return spectrum(np.outer(k * (np.sin(0.2 + x) - np.sin(0.2) - np.cos(0.2) * x), [1, -1]))

    Y = np.zeros((7, 2), complex)
    Y[lines] = linear
    N = nonlinear(Y)[:, :, None]
    Y = -np.linalg.solve(Z + held, N)[:, :, 0]
    Y[0] /= 2  # the mean has no second half
    Y[lines] = linear - np.linalg.solve(Z, N)[lines, :, 0]
    Y[lines] = linear - np.linalg.solve(Z, nonlinear(Y)[:, :, None])[lines, :, 0]
    expected = [Y[lines] @ [2.0, 1.0]]
    # not those of linear oscillators
    assert np.abs(linear @ [2.0, 1.0] - expected[0]).min() > 2e-4
    if channels:
        _, rates, accelerations = motion(Y)
        expected.append(spectrum(rates[:, 0] ** 2 * accelerations[:, 1])[lines])
    assert_allclose(found[:, :, 0], np.array(expected).T, atol=1e-12)
