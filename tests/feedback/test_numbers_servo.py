"""Position servos by other routes: the servo sample by sample, interpolations of scipy, a program
by scipy's solver.
"""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import CubicHermiteSpline, interp1d
from scipy.optimize import minimize, nnls

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.positions.inverse import holding_offset, invert_servo
from flexgen.feedback.positions.result import PositionCommands
from flexgen.feedback.positions.samples import basis, fit_samples, fit_within
from flexgen.feedback.positions.servo import Servo
from flexgen.model.position_servo.filters import Notch

H = 1e-3


def gains(integral: float, **others: object) -> Cascade:
    return Cascade(
        np.array([20.0, 31.0]),
        np.array([5.0, 0.7]),
        np.array([integral, 0.5 * integral]),
        **others,
    )  # type: ignore[arg-type]


def servo_torque(servo: Servo, law: Cascade, r: np.ndarray, q: np.ndarray) -> np.ndarray:
    """The textbook's servo, one sample after the other, at rest before the first one."""
    share = 1.0 - np.exp(-H / servo.reference_filter_s) if servo.reference_filter_s else 1.0
    filtered = r[0].copy()
    before = r[0].copy()
    last = q[0]
    total = 0.0
    out = []
    for r_k, q_k in zip(r, q, strict=True):
        filtered = filtered + share * (r_k - filtered)
        w = (
            servo.speed_feedforward * (filtered - before) / H
            + law.position_gain * (filtered - q_k)
            - (q_k - last) / H
        )
        total = total + H * w
        out.append(law.speed_gain * (w + law.integral_gain * total))
        before = filtered
        last = q_k
    return np.array(out)


def motion(n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Angles and torques of two motors that rest at both ends."""
    x = np.linspace(0.0, 1.0, n)[:, None]
    window = (x * (1 - x)) ** 4 * 256
    return 0.7 + window * np.sin(9 * x + [0.0, 1.0]), 3.0 + window * np.cos(17 * x + [0.3, 2.0])


@pytest.mark.parametrize("integral", [0.0, 8.0])
@pytest.mark.parametrize("feedforward", [0.0, 0.85, 1.0])
@pytest.mark.parametrize("filter_s", [0.0, 4e-3])
def test_the_inverse_of_a_servo_makes_it_send_the_torque(
    integral: float, feedforward: float, filter_s: float
) -> None:
    law = gains(integral)
    (q, torque) = motion()
    servo = Servo(law, speed_feedforward=feedforward, reference_filter_s=filter_s, sample_time=H)
    r = invert_servo(servo, law, torque, q)
    assert_allclose(r[0], q[0], rtol=0, atol=1e-12)
    assert_allclose(servo_torque(servo, law, r, q), torque - torque[0], rtol=0, atol=1e-9)
    wrong = Servo(
        law, speed_feedforward=feedforward, reference_filter_s=filter_s + 2e-3, sample_time=H
    )
    assert np.abs(servo_torque(wrong, law, r, q) - (torque - torque[0])).max() > 1e-2


def test_an_unstable_inverse_is_refused_with_its_zero() -> None:
    """The zero is where the transfer function from the reference to the torque vanishes."""
    q, torque = motion(20)
    law = Cascade(np.array([20.0, 31.0]), np.array([5.0, 0.7]), np.array([1.0, -30.0]))
    zero = np.roots([1.0 + law.integral_gain[1] * H, -1.0])[0]
    with pytest.raises(
        ArgumentError,
        match=rf"= {zero:.6g} is not within the unit circle, so its inverse is unstable",
    ):
        invert_servo(Servo(law, sample_time=H), law, torque, q)


def test_gains_and_filters_without_inverse_are_refused() -> None:
    q, torque = motion(20)
    law = Cascade(np.array([20.0, 0.0]), np.ones(2), np.ones(2))
    with pytest.raises(
        ArgumentError, match=r"servo, position_gain: given \[20\.  0\.\], expected numbers > 0"
    ):
        invert_servo(Servo(law, sample_time=H), law, torque, q)
    law = gains(1.0, filters=(Notch(60.0),))
    assert np.isfinite(invert_servo(Servo(law, sample_time=H), law, torque, q)).all()


def test_a_motor_without_integral_part_needs_an_offset_to_hold() -> None:
    law = Cascade(np.array([20.0, 30.0]), np.array([5.0, 0.5]), np.array([1.0, 0.0]))
    assert_allclose(holding_offset(law, np.array([7.0, 6.0])), [0.0, 6.0 / 15.0])


@pytest.mark.parametrize("interpolation", ["hold", "linear", "cubic"])
def test_interpolations_are_those_of_scipy(interpolation: str) -> None:
    edges = 0.3 + 4e-3 * np.arange(12)
    time = np.linspace(edges[0], edges[-1], 178)
    c = np.random.default_rng(4).standard_normal((12, 2))
    ends = np.concatenate([c[:1], c, c[-1:]])
    expected = {
        "hold": lambda: interp1d(edges, c, kind="previous", axis=0)(time),
        "linear": lambda: interp1d(edges, c, axis=0)(time),
        "cubic": lambda: CubicHermiteSpline(edges, c, (ends[2:] - ends[:-2]) / 8e-3)(time),
    }[interpolation]()
    B = basis(time, edges, interpolation)
    assert_allclose(B @ c, expected, atol=1e-9)
    assert_allclose(fit_samples(B, B @ c), c, atol=1e-8)


def test_each_sample_of_a_long_table_acts_at_its_own_instant() -> None:
    """As often as the servo has samples: rounding of one period must not add up."""
    time = 5e-4 * np.arange(-4200, 14000)
    B = basis(time, time, "hold")
    assert_allclose(B @ time, time, atol=1e-9)


@pytest.mark.parametrize("part", [0.9, 0.4, 0.02])
def test_a_long_table_keeps_a_limit_of_acceleration(part: float) -> None:
    """A search of first order does not end: differences are 1e-4 of the samples, as those of a
    move of 1.2 s.
    """
    T = 4e-3
    n = 600
    time = T / 8 * np.arange(8 * n + 1)
    s = np.clip((time - 0.6) / 1.2, 0.0, 1.0)
    r = 48.0 * (s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3))[:, None]
    B = basis(time, T * np.arange(n + 1), "linear")
    free = fit_samples(B, r)
    bound = part * np.abs(np.diff(free[:, 0], 2)).max() / T**2
    found = fit_within(B, r, T, (None, np.array([bound])))[:, 0]
    assert np.abs(np.diff(found, 2)).max() <= (1 + 1e-7) * bound * T**2
    reached = np.abs(np.abs(np.diff(found, 2)) / T**2 - bound) < 1e-4 * bound
    gradient = 2 * np.asarray(B.T @ (B @ found - r[:, 0]))
    D = np.diff(np.eye(n + 1), 2, axis=0)[reached] * np.sign(np.diff(found, 2)[reached])[:, None]
    _, left = nnls(D.T, -gradient, maxiter=100_000)  # of the conditions of Karush, Kuhn and Tucker
    assert reached.any() and left < 0.01 * np.linalg.norm(gradient)


def test_samples_within_limits_are_those_of_another_solver() -> None:
    T = 4e-3
    edges = T * np.arange(20)
    time = np.linspace(0.0, edges[-1], 300)
    B = basis(time, edges, "linear")
    r = (0.02 * np.sin(2 * np.pi * time / edges[-1]) ** 3)[:, None]
    free = fit_samples(B, r)
    speed = np.abs(np.diff(free[:, 0])).max() / T
    acceleration = np.abs(np.diff(free[:, 0], 2)).max() / T**2
    assert_allclose(fit_within(B, r, T, (np.array([1.1 * speed]), None)), free, atol=1e-7)
    bound = 0.8 * acceleration * T**2
    found = fit_within(B, r, T, (None, np.array([0.8 * acceleration])))
    assert np.abs(np.diff(found[:, 0], 2)).max() <= bound
    D = np.diff(np.eye(20), 2, axis=0)
    kept = {
        "type": "ineq",
        "fun": lambda c: np.concatenate([bound - D @ c, bound + D @ c]) / bound,
    }
    other = minimize(
        lambda c: 1e4 * np.sum((B @ c - r[:, 0]) ** 2),
        free[:, 0],
        constraints=kept,
        options={"maxiter": 500},
        tol=1e-14,
    )
    cost = [np.sum((B @ c - r[:, 0]) ** 2) for c in (found[:, 0], other.x)]
    assert cost[0] <= cost[1] * (1 + 1e-4)


# --- the positions -------------------------------------------------------------------------------
def positions(
    eigenvalue: float = 0.9, saturated: int = 0, failure: str = "", **changes: Any
) -> PositionCommands:
    """Three positions of the elbow, the second joint made to slide, with runs that were made
    up.
    """
    model = flexgen.read("elbow")
    solution = Made(status=flexgen.Status.SOLVED, move=Made(name="line"))
    loops = {
        "begin": Made(largest_eigenvalue=lambda: 0.5),
        "end": Made(largest_eigenvalue=lambda: eigenvalue),
    }
    run = Made(
        model=model,
        solution=solution,
        nominal=Made(saturated=saturated, failure=failure),
        runs=[Made(name="nominal"), Made(name="soft")],
        figures=lambda run: {"error_max_m": 3e-4, "error_max_rad": None},
        tool_error_max_m=1e-4,
        tool_error_max_rad=None,
        loops=lambda: loops,
        reference=Made(time=np.zeros(1000)),
    )
    fields: dict[str, Any] = {
        "time": np.array([-0.5, -0.496, -0.492]),
        "motor": np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 7.0]]),
        "joint": np.array([[0.5, 0.125], [0.502, 0.126], [0.501, 0.128]]),
        "joints": ("q1", "s"),
        "units": ("rad", "m"),
        "period": 0.004,
        "interpolation": "linear",
        "servo": Made(),
        "run": run,
        "today": Made(tool_error_max_m=1e-3, tool_error_max_rad=None),
        "active": (),
    }
    made = object.__new__(PositionCommands)
    vars(made).update(fields | changes)
    return made


def test_positions_are_saved_in_the_units_of_a_robot(tmp_path: Path) -> None:
    found = positions()
    assert_allclose(found.speed, [[0.5, 0.25], [-0.25, 0.5]])
    assert_allclose(found.acceleration, [[-187.5, 62.5]])
    lines = found.save(tmp_path / "a.csv").read_text().splitlines()
    assert lines[0] == "time_s,q1_deg,s_mm" and len(lines) == 4
    assert (
        lines[1] == "-0.5,28.6478897565,125"
        and lines[3].startswith("-0.492,")
        and lines[3].endswith(",128")
    )
    lines = found.save(tmp_path / "b.csv", "rad").read_text().splitlines()
    assert lines[:2] == ["time_s,q1_rad,s_m", "-0.5,0.5,0.125"]
    again = flexgen.Trajectory.load(found.save(tmp_path / "c.npz"))
    assert_allclose(again.time, found.time)
    assert_allclose(again["command_m"], found.motor)
    assert_allclose(again["command_g"], found.joint)
    assert again.labels["command_m"] == ("m1", "m2") and again.labels["command_g"] == ("q1", "q2")
    assert again.meta == {"model": "elbow", "kind": "position commands", "interpolation": "linear"}
    data = json.loads(found.save(tmp_path / "d.json").read_text())
    assert (data["model"], data["move"], data["status"]) == ("elbow", "line", "solved")
    assert data["joint"] == found.joint.tolist() and data["before"] == 0.5 and data["samples"] == 3
    assert (
        data["tool_error_max_m"] == 1e-4
        and data["today_error_max_m"] == 1e-3
        and data["soft.tool_error_max_m"] == 3e-4
    )


def test_positions_of_an_unstable_loop_are_not_sent() -> None:
    """It is looked for where the error is not much smaller than that of the planned angles: here
    not below half.
    """
    worse = {"today": Made(tool_error_max_m=1.9e-4, tool_error_max_rad=None)}
    grows = np.exp(np.log(1e3) / 1000)  # a thousandfold over the motion
    assert positions(grows * 1.001).status == "solved"
    assert positions(grows * 0.999, **worse).status == "solved"
    text = (
        "failed: the loop of servo and robot is unstable, eigenvalue {:.5g} in the end of the "
        "motion"
    )
    assert positions(grows * 1.001, **worse).status == text.format(grows * 1.001)
    assert positions(saturated=3).problem == "3 samples at the torque limit"
    assert positions(failure="it fell", saturated=3).problem == "it fell"
    limited = positions(active=("speed of q1",))
    assert limited.status == "limits active: speed of q1" and limited.problem == ""
    limited.run.solution.status = flexgen.Status.LIMITS_ACTIVE
    assert limited.status == "limits active: those of the solution, speed of q1"
