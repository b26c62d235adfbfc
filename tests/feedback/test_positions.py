"""Position servos and the positions that are sent to them: the servo sample by sample, SciPy's
interpolations and solvers, limits, and results.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from law_cases import solution_of
from numpy.testing import assert_allclose
from scipy.interpolate import CubicHermiteSpline, CubicSpline, interp1d
from scipy.optimize import minimize, nnls
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.reference import hold_torques
from flexgen.feedback.positions.inverse import holding_offset, invert_servo
from flexgen.feedback.positions.reference import with_positions
from flexgen.feedback.positions.result import PositionCommands
from flexgen.feedback.positions.samples import basis, fit_samples, fit_within
from flexgen.feedback.positions.servo import Servo, filter_reference, servo_of
from flexgen.model.position_servo.filters import LowPass, Notch

pytestmark = needs_compiler
H = 1e-3
ELBOW = flexgen.read("elbow")


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


def test_gains_and_filters_without_inverse_are_refused() -> None:
    q, torque = motion(20)
    law = Cascade(np.array([20.0, 0.0]), np.ones(2), np.ones(2))
    text = r"servo, position_gain: given \[20\.  0\.\], expected numbers > 0"
    with pytest.raises(ArgumentError, match=text):
        invert_servo(Servo(law, sample_time=H), law, torque, q)
    blind = Notch(1e-4, 0.0, 1.0)
    law = gains(1.0, filters=(blind,))
    with pytest.raises(ArgumentError, match="with a zero at z = 1, expected one that passes a co"):
        invert_servo(Servo(law, sample_time=H), law, torque, q)


@pytest.mark.parametrize("filters", [(Notch(60.0, 0.3, 0.8),), (LowPass(80.0), Notch(40.0))])
def test_filters_of_the_torque_are_inverted(filters: tuple[Any, ...]) -> None:
    """The filters section by section, after the servo; they are inverted as far as rounding and
    roughness allow.
    """
    law = gains(8.0, filters=filters)
    q, torque = motion(400)
    servo = Servo(law, sample_time=H)
    u = servo_torque(servo, law, invert_servo(servo, law, torque, q), q)
    for own in filters:
        b0, b1, b2, a1, a2 = own.section(H)
        out = np.zeros_like(u)
        for k in range(len(u)):
            past = [
                (u[k - i] if k >= i else 0 * u[0], out[k - i] if k >= i else 0 * u[0])
                for i in (1, 2)
            ]
            out[k] = b0 * u[k] + b1 * past[0][0] + b2 * past[1][0]
            out[k] -= a1 * past[0][1] + a2 * past[1][1]
        u = out
    assert_allclose(u, torque - torque[0], atol=1e-3 * np.abs(torque - torque[0]).max())


@pytest.mark.parametrize("feedforward", [0.0, 0.85])
def test_a_reference_makes_a_full_feedforward_that_of_the_servo(feedforward: float) -> None:
    law = gains(8.0)
    q, _ = motion()
    servo = Servo(law, feedforward, 4e-3, H)
    full = Servo(law, 1.0, 0.0, H)
    r = q + 1e-3 * np.sin(np.arange(len(q)) / 9)[:, None]
    used = filter_reference(servo, r, law.position_gain)
    assert_allclose(
        servo_torque(full, law, used, q), servo_torque(servo, law, r, q), rtol=0, atol=1e-8
    )


def test_samples_that_cannot_keep_their_limits_are_refused() -> None:
    """A limit of speed and one of acceleration that is not a number of joint 2."""
    time = np.linspace(0.0, 1.0, 21)
    B = basis(time, np.linspace(0.0, 1.0, 6), "linear")
    r = np.stack([time, time], axis=1)
    found = fit_within(B, r, 0.2, (np.array([0.5, 2.0]), None))
    assert_allclose(np.diff(found, axis=0) / 0.2, np.tile([0.5, 1.0], (5, 1)), atol=1e-6)
    text = (
        r"limits: no samples of joint 2 keep speed nan and acceleration 50 \(SI units, joint side"
    )
    with pytest.raises(SolverError, match=text):
        fit_within(B, r, 0.2, (np.array([2.0, np.nan]), np.array([100.0, 50.0])))


def test_what_a_user_gives_is_a_servo(tmp_path: Path) -> None:
    """A servo, its feedback, the name ppi, a file, or that of the model."""
    law = gains(8.0)
    servo = Servo(law, 0.5, sample_time=H)
    assert servo_of(servo, ELBOW) is servo and servo_of(law, ELBOW) == Servo(law)
    ppi = flexgen.PPI(2.0, 5.0, 0.5)
    assert servo_of(ppi, ELBOW).feedback is ppi
    assert servo_of("ppi", ELBOW) == servo_of(None, ELBOW) == Servo(flexgen.PPI())
    file = tmp_path / "servo.toml"
    file.write_text('type = "ppi"\nposition_hz = 2.0\nspeed_feedforward = 0.25\n')
    assert servo_of(str(file), ELBOW) == Servo(flexgen.PPI(position_hz=2.0), 0.25)
    for wrong in ("pi", 3, Path("servo.csv")):
        with pytest.raises(
            ArgumentError, match=r"servo: given .*, expected a flexgen.Servo, Casc"
        ):
            servo_of(wrong, ELBOW)


def test_positions_of_a_solution_make_the_servo_send_its_torques() -> None:
    """From the reference of the samples of the servo: the torques of the solution, held, in
    addition to the holding offset of a motor without integral part.
    """
    table = {"type": "cascade", "position_gain": [20.0, 31.0], "speed_gain": [5.0, 0.7]}
    table |= {"integral_gain": [0.0, 4.0], "sample_time": H, "speed_feedforward": 0.5}
    model = flexgen.read("elbow", overrides={"servo": table})
    solution = solution_of(model)
    found = with_positions(solution).trajectory
    servo = servo_of(None, model)
    law = servo.feedback
    assert isinstance(law, Cascade)
    t = found.time
    time = t[0] + H * np.arange(int((t[-1] - t[0]) / H))
    r = CubicSpline(t, found["command_m"])(time) - holding_offset(law, found["tau_m"][0])
    q = found.at(time)["q_m"]
    sent = servo_torque(servo, law, r, q)
    held = hold_torques(found, time, H, 0.0) - found["tau_m"][0]
    assert_allclose(sent[5:-5], held[5:-5], atol=2e-2 * np.abs(held).max())
    assert_allclose(found["command_g"] @ model.eta.T, found["command_m"])
    with pytest.raises(ArgumentError, match=r"elbow without a servo, expected a table .servo. in"):
        with_positions(solution_of(ELBOW))


# --- the positions -------------------------------------------------------------------------------
def commands(**options: Any) -> PositionCommands:
    return flexgen.command_positions(ELBOW, solution=solution_of(ELBOW), progress=False, **options)


@pytest.fixture(scope="module")
def free() -> PositionCommands:
    return commands(plants={"soft": {"stiffness": 0.8}})


def test_limits_that_commands_reach_are_named(free: PositionCommands) -> None:
    """Those that the free positions exceed, and those that others make them reach."""
    speed = np.abs(free.speed).max(axis=0)
    acceleration = np.abs(free.acceleration).max(axis=0)
    wide = commands(speed=1.01 * speed, acceleration=1.01 * acceleration)
    assert wide.active == () and np.array_equal(wide.joint, free.joint)
    bound = acceleration * [9.0, 0.97]
    found = commands(speed=speed * [0.97, 1.5], acceleration=bound)
    assert found.active[:2] == ("speed of q1", "acceleration of q2")
    assert (np.abs(found.speed).max(axis=0) <= speed * [0.97 + 1e-9, 1.5]).all()
    assert (np.abs(found.acceleration).max(axis=0) <= bound * (1 + 1e-9)).all()
    reached = np.abs(found.acceleration).max(axis=0) >= (1 - 1e-4) * bound
    assert ("acceleration of q1" in found.active) == reached[0]
    assert found.status == f"limits active: {', '.join(found.active)}"


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"speed": [1.0]}, "speed: given .*, expected 2 numbers > 0, one for each joint"),
        ({"speed": [1.0, 0.0]}, "speed: given .*, expected 2 numbers > 0"),
        ({"acceleration": [1.0, np.inf]}, "acceleration: given .*, expected 2 numbers > 0"),
        ({"period": 4.9e-4}, r"period: given 0.00049, expected from 0.0005 s, the sample time of"),
        ({"period": 0.1001}, "period: given 0.1001, .*to 0.1 s"),
        ({"period": "fast"}, "period: given 'fast', expected from"),
    ],
)
def test_wrong_limits_and_periods_are_refused(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        commands(**given)


def test_positions_are_saved_in_the_units_of_a_robot(
    free: PositionCommands, tmp_path: Path
) -> None:
    """Degrees and millimeters, or SI units; here the second joint is made to slide."""
    found = replace(free, units=("rad", "m"), time=free.time - 0.5)
    rows = np.loadtxt(found.save(tmp_path / "a.csv"), delimiter=",", skiprows=1)
    assert (tmp_path / "a.csv").read_text().startswith("time_s,q1_deg,q2_mm\n")
    assert_allclose(rows[:, 0], found.time, rtol=1e-8)
    assert_allclose(rows[:, 1:], found.joint * [180 / np.pi, 1e3], rtol=1e-10)
    rows = np.loadtxt(found.save(tmp_path / "b.csv", "rad"), delimiter=",", skiprows=1)
    assert (tmp_path / "b.csv").read_text().startswith("time_s,q1_rad,q2_m\n")
    assert_allclose(rows[:, 1:], found.joint, rtol=1e-10)
    assert_allclose(found.joint, found.motor @ np.linalg.inv(ELBOW.eta).T)
    assert_allclose(found.speed * found.period, np.diff(found.joint, axis=0))
    assert_allclose(found.acceleration * found.period, np.diff(found.speed, axis=0), atol=1e-12)
    again = flexgen.Trajectory.load(found.save(tmp_path / "c.npz"))
    assert np.array_equal(again["command_m"], found.motor) and again.meta["kind"] == (
        "position commands"
    )
    assert np.array_equal(again["command_g"], found.joint)
    assert again.labels["command_m"] == ("m1", "m2") and again.labels["command_g"] == ("q1", "q2")
    data = json.loads(found.save(tmp_path / "d.json").read_text())
    assert (data["model"], data["move"], data["status"]) == ("elbow", "line", "solved")
    assert data["joint"] == found.joint.tolist() and data["samples"] == len(found.time)
    assert data["before"] == pytest.approx(-found.time[0], abs=1e-12)
    assert data["tool_error_max_m"] == found.run.tool_error_max_m
    assert data["today_error_max_m"] == found.today.tool_error_max_m
    soft = found.run.figures(found.run["soft"])["error_max_m"]
    assert data["soft.tool_error_max_m"] == soft > 10 * data["tool_error_max_m"]


def test_positions_in_words(free: PositionCommands) -> None:
    lines = str(free).splitlines()
    assert lines[0] == "elbow, move line: solved" and f"  positions: {len(free.time)}" in lines
    for joint, own in zip(lines[-2:], (0, 1), strict=True):
        speed = np.abs(free.speed[:, own]).max()
        acceleration = np.abs(free.acceleration[:, own]).max()
        words = f"{speed:.3g} rad/s, {acceleration:.3g} rad/s^2"
        assert joint == f"  q{own + 1}, commanded up to: {words}"


def changed(made: PositionCommands, **changes: Any) -> PositionCommands:
    nominal = replace(made.run.nominal, **changes)
    return replace(made, run=replace(made.run, runs=(nominal, *made.run.runs[1:])))


def test_positions_of_an_unstable_loop_are_not_sent(free: PositionCommands) -> None:
    """It is looked for where the error is not below half of that of the planned angles, and counts
    where it grows a thousandfold over the motion.
    """
    today = free.today.nominal
    wrong = changed(free, error=0.49 * today.error), changed(free, error=0.51 * today.error)

    def with_gains(made: PositionCommands, factor: float) -> PositionCommands:
        law = replace(made.run.law, position_gain=factor * made.run.law.position_gain)
        return replace(made, run=replace(made.run, law=law))

    assert wrong[1].status == "solved"
    assert with_gains(wrong[0], 100.0).status == "solved"
    bad = with_gains(wrong[1], 100.0)
    where, loop = next(
        (name, loop) for name, loop in bad.run.loops().items() if loop.largest_eigenvalue() > 1.01
    )
    assert bad.status == (
        "failed: the loop of servo and robot is unstable, eigenvalue "
        f"{loop.largest_eigenvalue():.5g} in the {where} of the motion"
    )


def test_positions_that_cannot_be_sent_say_why(free: PositionCommands) -> None:
    assert changed(free, saturated=3).problem == "3 samples at the torque limit"
    failed = changed(free, failure="it fell", saturated=3)
    assert failed.status == "failed: it fell"
    limited = replace(free, active=("speed of q1",))
    assert limited.status == "limits active: speed of q1" and limited.problem == ""
    solution = replace(free.run.solution, status=flexgen.Status.LIMITS_ACTIVE)
    limited = replace(limited, run=replace(free.run, solution=solution))
    assert limited.status == "limits active: those of the solution, speed of q1"
