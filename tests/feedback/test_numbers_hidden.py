"""Parts that robots of other quick tests do not have: damped gears, harmonics, laws of others,
files of servos.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.spec.fourier import FourierSum
from flexgen.dynamics.hysteresis import hysteresis_law
from flexgen.dynamics.mechanics import motor_harmonics
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.limit_use import LimitUse
from flexgen.feedback.loop import robustness
from flexgen.feedback.positions.samples import basis, fit_within
from flexgen.identification.servo.fit_result import ServoFit
from flexgen.inversion.problem import motor_side, problem
from flexgen.runtime.streams import stream
from flexgen.simulation.environment.sense import encoder_error
from flexgen.studies.tolerances.in_loop import error_text
from flexgen.views.reports.identification_texts import plan_text


# --- damped gears --------------------------------------------------------------------------------
def test_a_polynomial_of_fifth_degree_is_between_its_ends() -> None:
    rng = np.random.default_rng(3)
    c = rng.standard_normal((6, 2))
    h = 0.3
    at = np.array([0.0, 0.155, 0.6, 1.0])
    powers = np.arange(6)
    k = np.arange(6.0)

    def value(t: float) -> np.ndarray:
        slopes = [1.0, k, k * (k - 1)]
        return np.array(
            [
                (s * np.where(powers >= m, t ** (np.maximum(powers - m, 0)), 0.0)) @ c
                for m, s in enumerate(slopes)
            ]
        ).T

    found = motor_side._hermite(at, h, value(1.0), value(1.0 + h))
    assert_allclose(found, [value(1.0 + h * x)[:, 0] for x in at], rtol=1e-12)


def test_deflections_of_damped_gears_follow_their_torque_late() -> None:
    """``D p' + k p = a + b t`` of two gears: a closed form; and a stiffening one against fine
    steps of Heun.
    """
    k = np.array([50.0, 20.0])
    D = np.array([2.0, 5.0])
    t = np.array([0.0, 0.005, 0.015, 0.02])
    x = ca.SX.sym("p", 2)
    linear = ca.Function("spring", [x], [ca.DM(k) * x, ca.DM(k)])
    a = np.array([1.0, -2.0])
    b = np.array([30.0, 4.0])
    tau = np.stack([a + b * t[:, None], np.tile(b, (4, 1)), np.zeros((4, 2))], axis=2)
    start = np.array([0.1, 0.2])
    found = motor_side._integrate_deflections(linear, D, t, tau, start)
    late = (a - b * D / k) / k
    expected = late + b / k * t[:, None] + (start - late) * np.exp(-k / D * t[:, None])
    assert_allclose(found, expected, rtol=1e-6)
    bent = ca.Function("spring", [x], [ca.DM(k) * x + 300 * x**3, ca.DM(k) + 900 * x**2])
    found = motor_side._integrate_deflections(bent, D, t, tau, start)
    p = start
    step = 1e-5

    def rate(p: np.ndarray, at: float) -> np.ndarray:
        return (a + b * at - k * p - 300 * p**3) / D

    for n in range(500):
        half = p + step * rate(p, n * step)
        p = (p + half + step * rate(half, (n + 1) * step)) / 2
    assert_allclose(found[1], p, rtol=1e-6)


@pytest.mark.parametrize(("damping", "late"), [(3e4, True), (0.5, False), (0.0, False)])
def test_deflections_and_their_rates_follow_rising_torques(damping: float, late: bool) -> None:
    """``D p' + K p = a + b t`` from the deflection at rest; where D is tiny, to first order in
    D/K.
    """
    gear = (
        {"element.upper.dof.q1.gear.damping": damping}
        if damping
        else {"element.upper.dof.q1.gear.damping": 0.0}
    )
    model = flexgen.read("elbow", overrides=gear | {"element.fore.dof.q2.gear.damping": 0.0})
    springs: Any = [
        dof.gear.spring
        for element in model.elements
        for dof in element.dofs
        if dof.gear is not None
    ]
    K = springs[0].stiffness
    t = np.linspace(0.0, 0.2, 41)
    a = np.array([1e3, -50.0])
    b = np.array([4e4, 20.0])
    tau = np.stack([a + b * t[:, None], np.tile(b, (41, 1)), np.zeros((41, 2))], axis=2)
    p, dp, ddp = motor_side.deflections(derive(model), t, tau)
    assert_allclose(p[:, 1], (a[1] + b[1] * t) / springs[1].stiffness, rtol=1e-12)
    assert_allclose(dp[:, 1], b[1] / springs[1].stiffness, rtol=1e-12)
    assert_allclose(ddp[:, 1], 0.0, atol=1e-15)
    follow = (a[0] + b[0] * t - b[0] * damping / K) / K
    if not late:
        assert_allclose(p[:, 0], follow, rtol=1e-12)
        assert_allclose(dp[:, 0], b[0] / K, rtol=1e-9)
        return
    gone = np.exp(-K / damping * t)
    lag = b[0] * damping / K**2
    assert_allclose(p[:, 0], follow + lag * gone, rtol=1e-9)
    assert_allclose(dp[:, 0], b[0] / K - lag * K / damping * gone, rtol=1e-6, atol=1e-9)
    assert_allclose(ddp[:, 0], lag * (K / damping) ** 2 * gone, rtol=1e-6, atol=1e-6)


def test_graded_nodes_end_where_they_reach_the_time_before_the_path() -> None:
    """Intervals of 1/4 and 3/8 are 5/8 s; for a little more there is a third one, and all are
    scaled.
    """
    found: Any = problem._graded_nodes(0.625, 9.0, 0.25)
    assert_allclose(found, [-0.625, -0.25, 0.0])
    found = problem._graded_nodes(0.626, 9.0, 0.25)
    assert_allclose(found, -np.array([1.1875, 0.625, 0.25, 0.0]) * 0.626 / 1.1875)


@pytest.mark.parametrize("pushed", [False, True])
def test_samples_of_a_stream_that_starts_in_motion(pushed: bool) -> None:
    """As many as its horizon and those before it; a force has three columns for each output."""
    entries = Made(interface=Made(limits={"STREAM_MORE_SAMPLES": 3}), real=np.dtype(float))
    own: Any = Made(intervals=4, _entries=entries, _sizes={"n_t": 3, "n_y": 2})
    y = np.ones((7, 3))
    dy = np.ones((7, 2))
    force = np.ones((7, 6))
    found = stream.Stream._samples(own, y, dy, 2 * dy, force if pushed else None)
    assert {name: x.shape for name, x in found.items()} == {
        "y": (7, 3),
        "dy": (7, 2),
        "ddy": (7, 2),
    } | ({"force": (7, 6)} if pushed else {})
    for wrong in ((y[:6], dy, dy, None), (y, y, dy, None), (y, dy, dy, np.ones((7, 2)))):
        with pytest.raises(ArgumentError, match=r"^stream"):
            stream.Stream._samples(own, *wrong)


# --- harmonics -----------------------------------------------------------------------------------
def test_what_an_encoder_shows_is_a_fourier_sum() -> None:
    given = FourierSum((1, 3), (1e-3, 2e-3), (-4e-3, 5e-3))
    q = np.array([0.2, -1.1])
    expected = 1e-3 * np.cos(q) + 2e-3 * np.cos(3 * q) - 4e-3 * np.sin(q) + 5e-3 * np.sin(3 * q)
    assert_allclose(encoder_error(given, q), expected, rtol=1e-14)


@pytest.mark.parametrize("ratio", [1.0, -80.0])
def test_steps_to_a_motor_angle_reach_it(ratio: float) -> None:
    """Fixed points, then Newton's method, of ``q - n e(q) = w``: so many steps leave no error, one
    less leaves some.
    """
    error = FourierSum((1, 4), (1e-3, 0.0), (0.0, 5e-4))
    fixed, newton = motor_harmonics._steps(error, ratio)

    def left(steps: int) -> float:
        q = w = np.linspace(0.0, 6.2, 50)
        for step in range(steps):
            e = 1e-3 * np.cos(q) + 5e-4 * np.sin(4 * q)
            slope = -1e-3 * np.sin(q) + 2e-3 * np.cos(4 * q)
            q = w + ratio * e if step < fixed else q - (q - ratio * e - w) / (1 - ratio * slope)
        return float(np.abs(q - ratio * (1e-3 * np.cos(q) + 5e-4 * np.sin(4 * q)) - w).max())

    assert fixed >= 1 and left(fixed + newton) < 1e-13 < left(fixed + newton - 2)
    symbol = ca.SX.sym("c")
    assert motor_harmonics._steps(Made(cos=(symbol,), sin=(0.0,), harmonics=(2, 4)), 9.0) == (
        motor_harmonics._steps(
            Made(cos=(0.0,), sin=(0.0,), harmonics=(1,), bound=lambda k: (0.25, 0.5, 2.0)[k]), 1.0
        )  # type: ignore[arg-type]
    )


# --- hysteresis of other packages ----------------------------------------------------------------
@dataclass(frozen=True)
class Quadratic:
    """A law of another package."""

    def slope(self, y: Any) -> Any:
        return 1.0 - 0.5 * y - 0.5 * y**2


def test_the_rate_of_another_law_is_that_of_its_slope_in_either_direction() -> None:
    law: Any = Quadratic()
    for rate, expected in (
        (2.0, 2 * (1 - 0.25 - 0.125)),
        (-3.0, -3 * (1 + 0.25 - 0.125)),
        (0.0, 0.0),
    ):
        assert_allclose(hysteresis_law.law_rate(law, rate, 2.0, 4.0), expected, rtol=1e-15)


# --- results as texts ----------------------------------------------------------------------------
def test_errors_of_drawn_robots_in_words() -> None:
    found = {"robots": 64, "failed": 0, "error_m": 1.5e-3, "error_rad": None}
    assert (
        error_text(found)
        == "error <= 1.5 mm of 61 of 64 robots drawn from [uncertainty], without disturbances"
    )
    found |= {"failed": 2, "error_m": None, "without_delay": True}
    words = (
        "61 of 64 robots drawn from [uncertainty], without disturbances and delays, 2 of them "
        "stopped early"
    )
    assert error_text(found) == f"error not known of {words}"
    both = error_text(found | {"error_m": 2e-6, "error_rad": 1e-3})
    assert both.startswith("error <= 2 um and <= ") and both.count("<=") == 2


def test_the_use_of_a_limit_in_words() -> None:
    use = LimitUse("torque", "m1", "N m", 1.0504, 21.00823, 20.0, 0.12345)
    assert str(use) == "torque of m1: 21.01 N m at 0.123 s, 105.0 % of its limit 20 N m"
    assert use.warning() == "m1: torque 21.01 N m exceeds its limit 20 N m"
    mean = LimitUse("effective torque", "m1", "N m", 0.5, 10.0, 20.0, None)
    assert str(mean) == "effective torque of m1: 10 N m, 50.0 % of its limit 20 N m"


def test_a_plan_in_words() -> None:
    plan: Any = Made(
        joints=lambda robot: np.array([[0.5, -0.25], [1.0, 2.0]]),
        poses=[0, 1],
        realizations=3,
        experiments=2,
        lines=[4, 5, 6],
        frequencies=np.array([1.5, 2.0, 40.0]),
        duration_s=75.0,
        predicted={"q1.stiffness": 0.0125},
    )
    lines = plan_text(plan, flexgen.read("elbow")).splitlines()
    assert lines[:2] == [
        "elbow: 2 poses, 6 experiments each, 3 lines from 1.5 to 40 Hz",
        "time of the robot: 75 s",
    ]
    rows = [line.split() for line in lines]
    assert (
        ["1", "0.5", "-0.25"] in rows
        and ["2", "1", "2"] in rows
        and rows[-1] == ["q1.stiffness", "1.25"]
    )


# --- servos --------------------------------------------------------------------------------------
def test_an_identified_servo_is_read_as_it_was_written(tmp_path: Path) -> None:
    gains = {"position_gain": [20.0, 30.0], "speed_gain": [0.5, 0.25], "integral_gain": [4.0, 0.0]}
    filters = (flexgen.LowPass(90.0), flexgen.Notch(30.0, 0.2, 0.5))
    cascade = flexgen.Cascade(**{key: np.array(x) for key, x in gains.items()}, filters=filters)
    servo = flexgen.Servo(
        cascade, sample_time=5e-4, delay=2.5e-4, speed_feedforward=0.75, reference_filter_s=3e-3
    )
    save: Any = ServoFit.save
    fit = Made(servo=servo, model="elbow@soft", record=Made(source="/a/b/day.csv"), ended="")
    read = flexgen.Servo.read(save(fit, tmp_path / "servo.toml"))
    for name in ("sample_time", "delay", "speed_feedforward", "reference_filter_s"):
        assert getattr(read, name) == getattr(servo, name)
    for name, values in gains.items():
        assert_allclose(getattr(read.feedback, name), values)
    assert getattr(read.feedback, "filters", None) == filters
    text = (tmp_path / "servo.toml").read_text()
    assert text.startswith(
        'description = "servo of elbow@soft, identified from day.csv"\ntype = "cascade"\n'
    )
    fit.record.source = ""
    assert 'identified from a record"' in save(fit, tmp_path / "servo.toml").read_text()


def test_samples_that_cannot_keep_their_limits_are_refused() -> None:
    """A limit of speed and one of acceleration that is not a number of joint 2."""
    time = np.linspace(0.0, 1.0, 21)
    B = basis(time, np.linspace(0.0, 1.0, 6), "linear")
    r = np.stack([time, time], axis=1)
    found = fit_within(B, r, 0.2, (np.array([0.5, 2.0]), None))
    assert_allclose(np.diff(found, axis=0) / 0.2, np.tile([0.5, 1.0], (5, 1)), atol=1e-6)
    with pytest.raises(SolverError) as refused:
        fit_within(B, r, 0.2, (np.array([2.0, np.nan]), np.array([100.0, 50.0])))
    assert str(refused.value) == (
        "limits: no samples of joint 2 keep speed nan and acceleration 50 (SI units, joint "
        "side); increase them"
    )


# --- errors of a tool ----------------------------------------------------------------------------
def test_the_error_of_an_orientation_is_its_sine_about_the_axis() -> None:
    """A tool that is turned by 0.3 about an axis, and 2 mm off along y."""
    axis = np.array([1.0, 2.0, -2.0]) / 3
    angle = 0.3
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    c = np.cos(0.7)
    s = np.sin(0.7)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    q = ca.SX.sym("q", 2)
    functions = {
        "output": ca.Function("output", [q], [ca.vertcat(1.0, 2.002, 3.0) + 0 * q[0]]),
        "forward_kinematics": ca.Function(
            "f", [q], [ca.SX.zeros(3), ca.SX(ca.DM(turn @ R)) + 0 * q[1]]
        ),
    }
    equations: Any = Made(
        function=functions.__getitem__, model=Made(output=Made(type="tool_pose"))
    )
    path: Any = Made(sample=lambda t: Made(y=np.array([[[1.0], [2.0], [3.0]]]), R=R[None]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(robustness, "output_units", lambda model: ("m", "m", "m"))
        found = robustness.output_errors(equations, path, np.zeros(1), np.zeros((1, 2)))
    assert_allclose(found["m"], [[0.0, 2e-3, 0.0]], atol=1e-12)
    assert_allclose(found["rad"], np.sin(angle) * axis[None], atol=1e-14)
