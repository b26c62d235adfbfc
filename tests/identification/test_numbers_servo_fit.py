"""Identification of servos with the simulation replaced: searches of linear problems, deviations,
records, filters.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.gains import PPI
from flexgen.feedback.positions.servo import Servo
from flexgen.identification.estimator.covariance import block_covariance
from flexgen.identification.servo import identify
from flexgen.identification.servo.fit_result import ServoFit
from flexgen.identification.servo.record import ServoRecord

H = 1e-3


def cascade(integral: float = 2.0) -> Cascade:
    return Cascade(np.array([20.0, 30.0]), np.array([5.0, 4.0]), np.array([integral, 0.0]))


def made(**more: Any) -> Any:
    """A fit of two motors without a simulation; parameters: logarithms of six gains, then three
    others.
    """
    out = object.__new__(identify.RecordedLoop)
    servo = Servo(
        cascade(), speed_feedforward=0.5, reference_filter_s=0.0, sample_time=H, delay=2.3e-3
    )
    robot = Made(
        n_m=2, eta=np.diag([100.0, -50.0]), title="arm", motors=[Made(name="m1"), Made(name="m2")]
    )
    given = {"robot": robot, "servo": servo, "cascade": servo.feedback, "interpolation": "linear"}
    for name, value in (given | more).items():
        object.__setattr__(out, name, value)
    return out


@pytest.mark.parametrize("T", [2e-4, 1e-3, 7e-3])
def test_the_delay_of_a_filter_is_that_of_a_ramp(T: float) -> None:
    x = 0.0
    r = 0.0
    for _ in range(2000):
        r += 3.0 * H
        x += (1.0 - np.exp(-H / T)) * (r - x)
    assert identify.delay_of_filter(T, H) == pytest.approx((r - x) / 3.0, rel=1e-9)
    assert identify.filter_of_delay((r - x) / 3.0, H) == pytest.approx(T, rel=1e-9)
    assert identify.filter_of_delay(0.0, H) == 0.0


def test_parameters_are_logarithms_of_gains_and_numbers_within_bounds() -> None:
    fit = made()
    p = np.concatenate([np.log([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), [3.0, -1.0, 0.5]])
    assert fit.layout.gains == slice(0, 6) and fit.layout.size == 9
    assert_allclose(fit.first_gains, [[20.0, 30.0], [5.0, 4.0], [2.0, 0.0]])
    # a gain that is zero stays zero
    assert_allclose(fit.gains_of(p), [[1.0, 2.0], [3.0, 4.0], [5.0, 0.0]])
    assert_allclose(
        fit.gains_of(np.array([p, p + np.log(2.0)]))[1], [[2.0, 4.0], [6.0, 8.0], [10.0, 0.0]]
    )
    lower, upper = fit.bounds
    assert lower[6:].tolist() == [0.0] * 3 and upper[6:].tolist() == [2.0, 0.19, 0.2]
    assert np.isinf(lower[:6]).all() and np.isinf(upper[:6]).all()
    assert fit.units.tolist() == [1.0] * 7 + [10 * H] * 2
    servo = fit.servo_of(np.array([*p[:6], 0.7, 5e-3, 1e-3]))
    assert (servo.speed_feedforward, servo.sample_time) == (0.7, H)
    assert identify.delay_of_filter(servo.reference_filter_s, H) == pytest.approx(5e-3)
    law = fit._with_gains(np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]))
    assert_allclose(
        [law.position_gain, law.speed_gain, law.integral_gain], [[1, 2], [3, 4], [5, 6]]
    )
    assert fit._rest_of_delay == pytest.approx(0.3e-3)
    for delay, rest in ((0.0, 0.0), (2e-3, 0.0), (0.4e-3, 0.4e-3), (2e-3 + 1e-13, 0.0)):
        one = made(servo=Servo(cascade(), sample_time=H, delay=delay))
        assert one._rest_of_delay == pytest.approx(rest, abs=1e-15)


def test_a_search_begins_with_lower_gains_where_the_loop_is_unstable(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[np.ndarray] = []
    limits = [0]

    def run(self: Any, p: np.ndarray) -> Any:
        tried.append(p)
        return (p, p) if len(tried) > limits[0] else None

    monkeypatch.setattr(identify.RecordedLoop, "run", run)
    fit = made()
    p = fit.start()
    first = np.log([20.0, 30.0, 5.0, 4.0, 2.0, 1.0])
    assert_allclose(p[:6], first)
    # a filter of four samples at least
    assert_allclose(p[6:], [0.5, identify.delay_of_filter(4e-3, H), H])
    slow = made(servo=Servo(cascade(), reference_filter_s=9e-3, sample_time=H))
    assert slow.start()[7] == pytest.approx(identify.delay_of_filter(9e-3, H))
    assert_allclose(fit.start(2.5)[:5], first[:5] - np.log(2.5))
    limits[0] = 5
    tried.clear()
    assert_allclose(fit.start()[:6], first - 5 * np.log(1.5))
    assert len(tried) == 6
    limits[0] = 6
    tried.clear()
    with pytest.raises(SolverError) as caught:
        fit.start()
    text = "identify_servo: the loop is unstable with the gains of the servo and with lower ones"
    assert str(caught.value) == text


def test_a_search_of_a_linear_problem_ends_at_its_minimum(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs that are unstable are refused; where all are, the search does not end."""
    rng = np.random.default_rng(8)
    J = rng.normal(size=(60, 9))
    best = np.abs(0.1 * rng.normal(size=9))
    J[:, 7:] *= 100.0
    best[7:] /= 10.0
    noise = 0.01 * rng.normal(size=60)
    lines: list[str] = []
    limit = [9.0]

    def run(self: Any, p: np.ndarray) -> Any:
        return None if np.abs(p).max() > limit[0] else (J @ (p - best) + noise, J)

    monkeypatch.setattr(identify.RecordedLoop, "run", run)
    monkeypatch.setattr(identify.RecordedLoop, "result", lambda self, *given: given)
    search: Any = identify._search
    p, e, _, ended = search(made(), np.zeros(9), lines.append)
    expected = best - np.linalg.lstsq(J, noise, rcond=None)[0]
    assert ended and (np.abs(p - expected) < 1e-3 * np.maximum(1.0, np.abs(J)[0])).all()
    assert_allclose(e, J @ (p - best) + noise)
    rms = 1e6 * np.sqrt(((J @ -best + noise) ** 2).mean())
    assert lines[0] == f"step 1: {rms:.3g} urad of the motors' angles unexplained"
    limit[0] = 0.0
    p, _, _, ended = search(made(), np.zeros(9), lines.append)
    assert not ended and not p.any()


def test_a_search_begins_again_with_lower_gains_until_noise_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun: list[float] = []
    left = {1.0: 5.0, 1.5: 4.0, 2.5: 7.0}

    class Fit:
        @classmethod
        def begin(cls, *given: Any) -> Any:
            return cls()

        def start(self, lower: float = 1.0) -> float:
            begun.append(lower)
            if left[lower] < 0:
                raise SolverError("unstable")
            return lower

    monkeypatch.setattr(identify, "RecordedLoop", Fit)
    monkeypatch.setattr(identify, "check_record", lambda record, robot: None)
    monkeypatch.setattr(
        identify,
        "_search",
        lambda fit, p, tell: Made(left=left[p], is_explained=left[p] < 1.5, first=p),
    )
    zero = np.zeros((100, 2))
    record = ServoRecord(4e-3 * np.arange(100), zero, zero)
    assert flexgen.identify_servo("elbow", record).first == 1.5 and begun == [1.0, 1.5, 2.5]
    for changed, first, expected in (
        ({1.5: 1.0}, 1.5, [1.0, 1.5]),
        ({1.0: 1.0}, 1.0, [1.0]),
        ({1.5: -1.0}, 1.0, None),
    ):
        begun.clear()
        left |= {1.0: 5.0, 1.5: 4.0, 2.5: 7.0} | changed
        assert flexgen.identify_servo("elbow", record).first == first  # type: ignore[attr-defined]
        assert begun == (expected or [1.0, 1.5, 2.5])


@pytest.mark.parametrize(
    ("gain", "n", "block"), [(24.0, 1200, 50), (48.0, 1200, 25), (24.0, 300, 15), (0.0, 300, 15)]
)
def test_deviations_are_those_of_leaving_out_blocks(gain: float, n: int, block: int) -> None:
    """Six times as long as the slowest position loop remembers; twenty blocks at least."""
    rng = np.random.default_rng(4)
    feedback = Cascade(np.array([gain, 2 * gain]), np.ones(2), np.ones(2))
    p = np.log([*np.maximum([gain, 2 * gain], 1.0), 1.0, 1.0, 1.0, 1.0])
    record = Made(period=5e-3, time=5e-3 * np.arange(n))
    J = rng.normal(size=(2 * n, 4)) * [1.0, 1e3, 1e-3, 0.0]
    e = rng.normal(size=2 * n)
    blocks = range(0, n, block)
    s = np.sqrt((e**2).mean())
    rows = (J / s).reshape(n, 2, 4)
    errors = (e / s).reshape(n, 2)
    expected = block_covariance(rows, errors, blocks, np.zeros((4, 4)))
    found = made(record=record, cascade=feedback)._deviations(p, e, J)
    assert_allclose(found, np.sqrt(np.diag(expected)))
    assert found[3] == 0.0 and found[:3].all()


def test_a_result_tells_what_is_explained_and_what_is_noise() -> None:
    """White noise is what third differences show, over the square root of 20; a ten thousandth of
    the lag at least.
    """
    rng = np.random.default_rng(5)
    n = 4000
    command = np.outer(np.linspace(0.0, 1.0, n), [1.0, 2.0])
    # zeros of the angles are not known
    angle = command - 0.02 * np.sin(np.arange(n) / 300)[:, None] + [0.3, -0.1]
    record = ServoRecord(4e-3 * np.arange(n), command, angle)
    fit = made(record=record)
    sd = np.arange(1.0, 10.0) * 1e-3
    object.__setattr__(fit, "_deviations", lambda p, e, J: sd.copy())
    p = np.concatenate([np.log([20.0, 30.0, 5.0, 4.0, 2.0, 1.0]), [0.9, 6e-3, 8e-3]])
    slow = np.cos(np.arange(n) / 500)
    e = np.stack([1e-3 * rng.normal(size=n) + 5e-3 * slow, 0.0 * slow], axis=1)
    found = fit.result(p, e.ravel(), np.ones((2 * n, 9)), True)
    assert (found.latency_s, found.converged, found.motors, found.model) == (
        8e-3,
        True,
        ("m1", "m2"),
        "arm",
    )
    assert_allclose(found.gain_sd, sd[:6].reshape(3, 2))
    assert found.common_sd["speed_feedforward"] == 7e-3 and found.common_sd["latency_s"] == sd[8]
    ends = [identify.filter_of_delay(d, H) for d in (0.0, 6e-3, 14e-3)]
    assert found.common_sd["reference_filter_s"] == pytest.approx(
        max(ends[1] - ends[0], ends[2] - ends[1])
    )
    assert_allclose(found.unexplained, np.sqrt((e**2).mean(axis=0)))
    assert found.noise[0] == pytest.approx(1e-3, rel=0.05)
    lag = (command - angle) @ np.diag([100.0, -50.0])
    lag = lag - lag[0]
    assert found.noise[1] == pytest.approx(1e-4 * np.sqrt((lag[:, 1] ** 2).mean()))
    assert found.explained == pytest.approx(1 - (e**2).sum() / (lag**2).sum())
    assert fit.result(p, 1e5 * e.ravel(), np.ones((2 * n, 9)), True).explained == 0.0


def test_commands_with_a_latency_are_mixed_between_samples_where_they_are_held() -> None:
    t = 4e-3 * np.arange(40)
    time = H * np.arange(150)
    record = Made(time=t)
    steps = np.arange(40.0)
    held = made(record=record, time=time, interpolation="hold")
    for late, whole, part in ((0.0, 0, 0.0), (2e-3, 2, 0.0), (2.25e-3, 2, 0.25)):

        def sent(k: int) -> np.ndarray:
            return np.floor(np.maximum(np.arange(150) - k, 0) / 4)

        assert_allclose(
            held._late(late) @ steps, (1 - part) * sent(whole) + part * sent(whole + 1), atol=1e-9
        )
    lines = made(record=record, time=time)
    assert_allclose(
        lines._late(2.25e-3) @ steps, np.maximum(time - 2.25e-3, 0.0) / 4e-3, atol=1e-9
    )


def test_records_that_do_not_fit_a_robot_are_refused() -> None:
    limits = {
        f"element.{x}_deg": y
        for x, y in (("upper.dof.q1.lower", -90.0), ("upper.dof.q1.upper", 90.0))
    }
    robot = flexgen.read("elbow", overrides=limits)
    t = 4e-3 * np.arange(400)
    move = np.clip((t - 0.1) / 0.5, 0.0, 1.0)[:, None] * [1.0, 0.5]

    def record(command: np.ndarray, angle: np.ndarray | None = None) -> ServoRecord:
        return ServoRecord(t, command, command if angle is None else angle, "run.csv")

    still = move * [1.0, 0.0]
    beyond = 100.0 + move * [50.0, 0.5]
    early = np.clip((t - 0.04) / 0.5, 0.0, 1.0)[:, None] * [1.0, 0.5]
    identify.check_record(record(move, 4.99 * move), robot)
    identify.check_record(
        record(np.clip((t - 0.0555) / 0.5, 0.0, 1.0)[:, None] * [1.0, 0.5]), robot
    )
    identify.check_record(record(1.55 + move), robot)  # within at its begin
    rest = "expected that it begins at rest"
    for given, text in (
        (
            ServoRecord(t, move[:, :1], move[:, :1]),
            "record: given 1 joints, expected 2 as of elbow",
        ),
        (
            record(still),
            "run.csv: given commands that do not move q2, expected that every joint moves",
        ),
        (
            record(beyond),
            "run.csv: given commands of q1 from 100 to 150 rad, all beyond its limits, expected "
            "some within; the unit of its columns?",
        ),
        (
            record(move, 5.01 * move),
            "run.csv: given angles of q1 that move 5.01 times as far as its commands, expected "
            "angles of the joint: those of the motor over the gear ratio, in the unit of the "
            "column",
        ),
        (record(early), f"run.csv: given a command that moves within the first 50 ms, {rest}"),
    ):
        with pytest.raises(ArgumentError) as caught:
            identify.check_record(given, robot)
        assert str(caught.value) == text


class Loop:
    """A robot whose speed controller is perfect: its angles are what the cascade with full
    feedforward is sent.
    """

    made: ClassVar[list[Loop]] = []
    wrong: ClassVar[list[str]] = []

    def __init__(
        self, *given: Any, delay_samples: int, parameters: Any, steps: int | None
    ) -> None:
        self.given = given
        self.late = delay_samples
        self.parameters = parameters
        self.asked = steps
        self.steps = steps or 7
        self.failures = [Loop.wrong.pop(0) if Loop.wrong else "", ""]
        Loop.made.append(self)

    def hold(self, torque: np.ndarray) -> None:
        self.torque = torque

    def run(self, rows: np.ndarray, count: int, check: bool) -> Any:
        assert len(rows) == count and not check and (rows[:, :, 2:] == self.torque[0]).all()
        return Made(q_m=rows[:, :, :2])


def servo_angles(
    p: np.ndarray, time: np.ndarray, record: ServoRecord, eta: np.ndarray
) -> np.ndarray:
    """Angles of the motors at the instants of the record, by the recursions of a servo whose
    speeds are perfect.
    """
    k_p = np.exp(p[:2])
    (f, d, late) = p[6:]
    motors = record.command @ eta.T
    late_times = np.maximum(time - late, record.time[0])
    r = np.stack([np.interp(late_times, record.time, column) for column in motors.T], axis=1)
    share = 1.0 - d / (d + H)  # d = h (1 - a)/a
    q = motors[0]
    filtered = motors[0]
    last = motors[0]
    out = []
    for r_k in r:
        filtered = filtered + share * (r_k - filtered)
        q = (q / H + f * (filtered - last) / H + k_p * filtered) / (1 / H + k_p)
        last = filtered
        out.append(q)
    return np.stack([np.interp(record.time, time, column) for column in np.array(out).T], axis=1)


def test_residuals_and_slopes_are_those_of_the_servo(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their means are taken off, since zeros of the angles are not known; a loop that slips fast
    gets finer steps.
    """
    monkeypatch.setattr(identify, "ClosedLoop", Loop)
    t = 2.0 + 4e-3 * np.arange(130)
    rise = np.clip((t - 2.1) / 0.3, 0.0, 1.0)
    command = np.outer(rise**2 * (3 - 2 * rise), [0.5, -0.3]) + np.array([0.2, 0.1])
    record = ServoRecord(t, command, 0.98 * command + 0.05)
    robot = Made(n_m=2, n_a=2, eta=np.array([[100.0, 0.0], [20.0, -50.0]]))
    time = t[0] + H * np.arange(517)
    measured = (record.angle - record.angle[0] + command[0]) @ robot.eta.T
    rest = np.array([0.3, 0.4]), np.array([7.0, -8.0])
    fit = made(
        robot=robot,
        record=record,
        time=time,
        measured=measured,
        library="c",
        rest=rest,
        rate=50.0,
        gears="gears",
    )
    p = np.concatenate([np.log([20.0, 30.0, 5.0, 4.0, 2.0, 1.0]), [0.6, 3e-3, 2.4e-3]])
    Loop.made.clear()
    e, J = fit.run(p)

    def residual(p: np.ndarray) -> np.ndarray:
        apart = servo_angles(p, time, record, robot.eta) - measured
        return np.asarray(apart - apart.mean(axis=0)).ravel()

    assert_allclose(e, residual(p), atol=1e-9)
    steps = np.array([1e-4] * 6 + [1e-4, 1e-6, 1e-6])
    for k, h in enumerate(steps):
        change = h * (np.arange(9) == k)
        slope = (residual(p + change) - residual(p - change)) / (2 * h)
        assert_allclose(J[:, k], slope, atol=6e-3 * np.abs(slope).max() + 1e-9)
    (loop,) = Loop.made
    model, library, hardware, law, q_a, q_m, rate = loop.given
    assert (model, library, rate, loop.late, loop.asked, loop.parameters) == (
        robot,
        "c",
        50.0,
        2,
        None,
        "gears",
    )
    assert (hardware.sample_s, hardware.delay_s) == (
        H,
        pytest.approx(0.3e-3),
    ) and not hardware.torque_max_Nm
    assert_allclose(q_a, np.tile(rest[0], (10, 1)))
    assert_allclose(q_m, np.tile(command[0] @ robot.eta.T, (10, 1)))
    assert_allclose(
        law.position_gain[:3],
        np.array([[20.0, 30.0]] * 3) * [[1, 1], [np.exp(1e-3), 1], [1, np.exp(1e-3)]],
    )
    assert_allclose(law.speed_gain[[0, 3]], [[5.0, 4.0], [5.0 * np.exp(1e-3), 4.0]])
    Loop.made.clear()
    Loop.wrong[:] = [identify.TOO_LONG] * 2
    assert fit.run(p) is not None and [loop.asked for loop in Loop.made] == [None, 28, 112]
    Loop.made.clear()
    Loop.wrong[:] = [identify.TOO_LONG] * 9
    assert fit.run(p) is None and [loop.asked for loop in Loop.made] == [None, 28, 112, 448]
    Loop.wrong[:] = ["unstable"]
    assert fit.run(p) is None
    Loop.wrong.clear()


def test_a_fit_begins_at_rest_where_the_record_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the gains of a P-PI for one sample time and the delay, and angles that begin at the
    command.
    """
    monkeypatch.setattr(identify, "library_with", lambda model, functions: functions)
    robot = flexgen.read("elbow")
    t = 1.0 + 4e-3 * np.arange(251)
    command = np.outer(np.linspace(0.0, 1.0, 251) ** 2, [0.4, -0.6]) + np.array([0.2, 0.3])
    record = ServoRecord(t, command, command + 0.01 * t[:, None])
    servo = Servo(PPI(), sample_time=3e-3, delay=1e-3)
    fit = identify.RecordedLoop.begin(robot, record, servo, "cubic", lambda line: None)
    eta = np.diag([motor.ratio[0] for motor in robot.motors])
    assert_allclose(fit.time, 1.0 + 3e-3 * np.arange(334))
    assert_allclose(fit.measured, (command + 0.01 * (t - 1.0)[:, None]) @ eta)
    assert (fit.library, fit.gears, fit.interpolation) == (["forward_dynamics"], None, "cubic")
    weight = evaluate(derive(robot).function("gravity"), fit.rest[0][None])[0].ravel()
    # the motors carry the arm, which hangs in its springs
    assert_allclose(eta @ fit.rest[1], weight, rtol=1e-6)
    K = [dof.gear.spring.stiffness for element in robot.elements for dof in element.dofs]
    assert_allclose(command[0] - fit.rest[0], weight / K, rtol=1e-3)
    still = np.zeros((1, 2))
    motion = (fit.rest[0][None], still, still, command[:1] @ eta, still, still, still)
    expected = PPI().cascade(robot, 4e-3, motion)
    assert_allclose(fit.cascade.speed_gain, expected.speed_gain, rtol=1e-2)
    assert_allclose(fit.cascade.position_gain, expected.position_gain, rtol=1e-2)
    own = Servo(cascade(), sample_time=H)
    assert (
        identify.RecordedLoop.begin(robot, record, own, "linear", lambda line: None).cascade
        is own.feedback
    )


def test_angles_that_repeat_while_the_command_moves_are_stated() -> None:
    t = 4e-3 * np.arange(301)
    # both rest at the ends
    command = np.column_stack([np.clip(t - 0.2, 0.0, 0.8), np.clip(2.0 * t - 0.4, 0.0, 1.6)])

    def fit(step: float) -> ServoFit:
        record = ServoRecord(t, command, step * np.round(command / step) if step else command)
        numbers = np.array([1e-5, 1e-5])
        servo = Servo(cascade(), sample_time=H)
        return ServoFit(
            servo,
            0.0,
            np.ones((3, 2)),
            {},
            numbers,
            numbers,
            1.0,
            True,
            ("m1", "m2"),
            record,
            "linear",
            "arm",
        )

    assert fit(0.0).repeated == 0.0 and "repeat" not in fit(0.0).sentence()
    assert (
        fit(6e-3).repeated == pytest.approx(1 / 3, abs=0.01)
        and "repeat" not in fit(6e-3).sentence()
    )
    # the second joint crosses each step in one sample
    assert fit(8e-3).repeated == pytest.approx(1 / 2, abs=0.01)
    assert fit(8e-3).sentence() == (
        "servo identified, 100 % of the lag of the robot explained; angles repeat in 50 % of "
        "the samples: finer angles, or a faster motion"
    )
