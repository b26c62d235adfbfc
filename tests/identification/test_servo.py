"""Identification of a servo in a loop that is known: parameters, runs by recursions, deviations
by blocks, and records that are refused.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
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
from flexgen.identification.servo.identify import RecordedLoop
from flexgen.identification.servo.record import ServoRecord

H = 1e-3
ELBOW = flexgen.read("elbow")
ETA = np.diag([motor.ratio[0] for motor in ELBOW.motors])


def cascade(integral: float = 2.0) -> Cascade:
    return Cascade(np.array([20.0, 30.0]), np.array([5.0, 4.0]), np.array([integral, 0.0]))


SERVO = Servo(
    cascade(), speed_feedforward=0.5, reference_filter_s=0.0, sample_time=H, delay=2.3e-3
)


def moved(count: int = 130) -> ServoRecord:
    """A move of both joints that begins at rest, with angles that lag."""
    t = 2.0 + 4e-3 * np.arange(count)
    rise = np.clip((t - 2.1) / 0.3, 0.0, 1.0)
    command = np.outer(rise**2 * (3 - 2 * rise), [0.5, -0.3]) + np.array([0.2, 0.1])
    return ServoRecord(t, command, 0.98 * command + 0.05)


def loop_of(
    servo: Servo = SERVO, record: ServoRecord | None = None, interpolation: str = "linear"
) -> RecordedLoop:
    """The loop of a record, with parameters: logarithms of six gains, then three others."""
    given = record or moved()
    return RecordedLoop.begin(ELBOW, given, servo, interpolation, lambda line: None)


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
    fit = loop_of()
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


def test_a_search_begins_with_lower_gains_where_the_loop_is_unstable(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[np.ndarray] = []
    stable = [1]

    def run(self: RecordedLoop, p: np.ndarray) -> Any:
        tried.append(p)
        return (p, p) if len(tried) >= stable[0] else None

    monkeypatch.setattr(RecordedLoop, "run", run)
    fit = loop_of()
    first = np.log([20.0, 30.0, 5.0, 4.0, 2.0, 1.0])
    # a filter of four samples at least
    assert_allclose(fit.start(), [*first, 0.5, identify.delay_of_filter(4e-3, H), H])
    slow = loop_of(Servo(cascade(), reference_filter_s=9e-3, sample_time=H))
    assert slow.start()[7] == pytest.approx(identify.delay_of_filter(9e-3, H))
    assert_allclose(fit.start(2.5)[:5], first[:5] - np.log(2.5))
    tried.clear()
    stable[0] = 6
    assert_allclose(fit.start()[:6], first - 5 * np.log(1.5))
    tried.clear()
    stable[0] = 7
    text = "^identify_servo: the loop is unstable with the gains of the servo and with lower ones$"
    with pytest.raises(SolverError, match=text):
        fit.start()


@pytest.mark.parametrize("explained", [True, False])
def test_a_search_ends_at_the_least_squares_and_begins_again_where_more_is_left(
    explained: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of linear residuals; runs that are unstable are refused."""
    rng = np.random.default_rng(8)
    J = rng.normal(size=(60, 9))
    best = np.concatenate([np.log([20.0, 30.0, 5.0, 4.0, 2.0, 1.0]) + 0.1, [0.4, 6e-3, 2e-3]])
    J[:, 7:] *= 100.0
    noise = 0.01 * rng.normal(size=60)
    begun: list[float] = []
    start = RecordedLoop.start
    lines: list[str] = []

    def run(self: RecordedLoop, p: np.ndarray) -> Any:
        return None if np.abs(p - best).max() > 2.0 else (J @ (p - best) + noise, J)

    def result(self: RecordedLoop, *given: Any) -> Any:
        made = {"left": -begun[-1], "is_explained": explained, "ended": ""}
        return Made(given=given, begun=begun[-1], **made)

    def begin(self: RecordedLoop, lower: float = 1.0) -> np.ndarray:
        begun.append(lower)
        return start(self, lower)

    for name, value in (("run", run), ("result", result), ("start", begin)):
        monkeypatch.setattr(RecordedLoop, name, value)
    found: Any = flexgen.identify_servo("elbow", moved(), servo=SERVO, progress=lines.append)
    p, e, _, converged = found.given
    expected = best - np.linalg.lstsq(J, noise, rcond=None)[0]
    assert converged and (np.abs(p - expected) < 1e-3 * np.maximum(1.0, np.abs(J)[0])).all()
    assert_allclose(e, J @ (p - best) + noise)
    rms = 1e6 * np.sqrt(((J @ (start(loop_of()) - best) + noise) ** 2).mean())
    assert lines[0] == f"step 1: {rms:.3g} urad of the motors' angles unexplained"
    # the one that leaves least of them
    assert begun == ([1.0] if explained else [1.0, *identify.LOWER])
    assert found.begun == begun[-1]


@pytest.mark.parametrize(
    ("gain", "n", "block"), [(24.0, 1200, 50), (48.0, 1200, 25), (24.0, 300, 15), (0.0, 300, 15)]
)
def test_a_result_has_deviations_by_blocks_and_tells_what_is_noise(
    gain: float, n: int, block: int
) -> None:
    """Blocks six times as long as the slowest position loop remembers, twenty at least. White
    noise is what third differences show; a ten thousandth of the lag at least.
    """
    rng = np.random.default_rng(4)
    command = np.outer(np.linspace(0.0, 1.0, n), [1.0, 2.0])
    # zeros of the angles are not known
    angle = command - 0.02 * np.sin(np.arange(n) / 300)[:, None] + [0.3, -0.1]
    record = ServoRecord(5e-3 * np.arange(n), command, angle)
    feedback = Cascade(np.array([gain, 2 * gain]), np.ones(2), np.array([1.0, 0.0]))
    fit = loop_of(replace(SERVO, feedback=feedback), record)
    gains = [*np.maximum([gain, 2 * gain], 1.0), 1.0, 1.0, 1.0, 1.0]
    p = np.concatenate([np.log(gains), [0.9, 6e-3, 8e-3]])
    J = rng.normal(size=(2 * n, 9)) * [1.0, 1e3, 1e-3, 0.0, 1.0, 1.0, 1.0, 1e3, 1e3]
    slow = 5e-3 * np.cos(np.arange(n) / 500)
    e = np.stack([1e-3 * rng.normal(size=n) + slow, 0.0 * slow], axis=1)
    found = fit.result(p, e.ravel(), J, True)
    s = np.sqrt((e**2).mean())
    blocks = range(0, n, block)
    covariance = block_covariance((J / s).reshape(n, 2, 9), e / s, blocks, np.zeros((9, 9)))
    sd = np.sqrt(np.diag(covariance))
    assert_allclose(found.gain_sd.ravel(), sd[:6])
    assert found.gain_sd[1, 1] == 0.0 and found.common_sd["latency_s"] == pytest.approx(sd[8])
    assert found.common_sd["speed_feedforward"] == pytest.approx(sd[6])
    ends = [identify.filter_of_delay(max(6e-3 + k * sd[7], 0.0), H) for k in (-1, 0, 1)]
    of_filter = max(ends[1] - ends[0], ends[2] - ends[1])
    assert found.common_sd["reference_filter_s"] == pytest.approx(of_filter)
    assert (found.latency_s, found.converged, found.motors) == (8e-3, True, ("m1", "m2"))
    assert_allclose(found.unexplained, np.sqrt((e**2).mean(axis=0)))
    assert found.noise[0] == pytest.approx(1e-3, rel=0.15)
    lag = (command - angle) @ ETA
    lag = lag - lag[0]
    assert found.noise[1] == pytest.approx(1e-4 * np.sqrt((lag[:, 1] ** 2).mean()))
    assert found.explained == pytest.approx(1 - (e**2).sum() / (lag**2).sum())
    assert fit.result(p, 1e5 * e.ravel(), J, True).explained == 0.0


TIMES = 4e-3 * np.arange(400)


def rising(begin: float = 0.1) -> np.ndarray:
    return np.clip((TIMES - begin) / 0.5, 0.0, 1.0)[:, None] * [1.0, 0.5]


@pytest.mark.parametrize(
    ("command", "angle", "text"),
    [
        (0.5 * rising(), 2.495 * rising(), ""),
        (rising(0.0555), None, ""),
        (1.55 + rising(), None, ""),  # within the limits at its begin
        (rising()[:, :1], None, "given 1 joints, expected 2 as of elbow"),
        (
            rising() * [1.0, 0.0],
            None,
            "given commands that do not move q2, expected that every joint moves",
        ),
        (
            100.0 + rising() * [50.0, 1.0],
            None,
            "given commands of q1 from 100 to 150 rad, all beyond its limits, expected some "
            "within; the unit of its columns?",
        ),
        (
            0.5 * rising(),
            2.505 * rising(),
            "given angles of q1 that move 5.01 times as far as its commands, expected angles of "
            "the joint: those of the motor over the gear ratio, in the unit of the column",
        ),
        (
            rising(0.04),
            None,
            "given a command that moves within the first 50 ms, expected that it begins at rest",
        ),
    ],
)
def test_records_that_do_not_fit_a_robot_are_refused(
    command: np.ndarray, angle: np.ndarray | None, text: str
) -> None:
    q1 = "element.upper.dof.q1."
    robot = flexgen.read("elbow", overrides={q1 + "lower_deg": -90.0, q1 + "upper_deg": 90.0})
    record = ServoRecord(TIMES, command, command if angle is None else angle, "run.csv")
    if not text:
        identify.check_record(record, robot)
        return
    with pytest.raises(ArgumentError) as caught:
        identify.check_record(record, robot)
    assert str(caught.value) == f"run.csv: {text}"


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


def servo_angles(p: np.ndarray, fit: RecordedLoop) -> np.ndarray:
    """Angles of the motors at the instants of the record, by the recursions of a servo whose
    speeds are perfect; commands that are held act at samples, mixed between two.
    """
    record = fit.record
    k_p = np.exp(p[:2])
    (f, d, late) = p[6:]
    motors = record.command @ ETA
    if fit.interpolation == "linear":
        there = np.maximum(fit.time - late, record.time[0])
        r = np.stack([np.interp(there, record.time, column) for column in motors.T], axis=1)
    else:
        whole = int(late / H + 1e-9)
        part = late / H - whole
        sent = [motors[np.maximum(np.arange(517) - k, 0) // 4] for k in (whole, whole + 1)]
        r = (1.0 - part) * sent[0] + part * sent[1]
    share = 1.0 - d / (d + H)  # d = h (1 - a)/a
    q = filtered = last = motors[0]
    out = []
    for r_k in r:
        filtered = filtered + share * (r_k - filtered)
        q = (q / H + f * (filtered - last) / H + k_p * filtered) / (1 / H + k_p)
        last = filtered
        out.append(q)
    seen = np.array(out).T
    return np.stack([np.interp(record.time, fit.time, column) for column in seen], axis=1)


@pytest.mark.parametrize("interpolation", ["linear", "hold"])
def test_residuals_and_slopes_are_those_of_the_servo(
    interpolation: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their means are taken off, since zeros of the angles are not known; a loop that slips fast
    gets finer steps.
    """
    fit = loop_of(interpolation=interpolation)
    monkeypatch.setattr(identify, "ClosedLoop", Loop)
    p = np.concatenate([np.log([20.0, 30.0, 5.0, 4.0, 2.0, 1.0]), [0.6, 3e-3, 2.4e-3]])
    Loop.made.clear()
    ran = fit.run(p)
    assert ran is not None
    e, J = ran

    def residual(p: np.ndarray) -> np.ndarray:
        apart = servo_angles(p, fit) - fit.measured
        return np.asarray(apart - apart.mean(axis=0)).ravel()

    assert_allclose(e, residual(p), atol=1e-9)
    for k, h in enumerate([1e-4] * 7 + [1e-6, 1e-6]):
        change = h * (np.arange(9) == k)
        slope = (residual(p + change) - residual(p - change)) / (2 * h)
        assert_allclose(J[:, k], slope, atol=6e-3 * np.abs(slope).max() + 1e-9)
    (loop,) = Loop.made
    model, _, hardware, law, q_a, q_m, rate = loop.given
    assert (model, rate, loop.late, loop.asked) == (fit.robot, fit.rate, 2, None)
    assert (hardware.sample_s, hardware.delay_s) == (H, pytest.approx(0.3e-3))
    assert not hardware.torque_max_Nm
    assert_allclose(q_a, np.tile(fit.rest[0], (10, 1)))
    assert_allclose(q_m, np.tile(fit.record.command[0] @ ETA, (10, 1)))
    more = np.exp(1e-3)
    assert_allclose(
        law.position_gain[:3], [[20.0, 30.0], [20.0 * more, 30.0], [20.0, 30.0 * more]]
    )
    assert_allclose(law.speed_gain[[0, 3]], [[5.0, 4.0], [5.0 * more, 4.0]])
    for wrong, asked in ((2, [None, 28, 112]), (9, [None, 28, 112, 448])):
        Loop.made.clear()
        Loop.wrong[:] = [identify.TOO_LONG] * wrong
        assert (fit.run(p) is None) == (wrong == 9) and [x.asked for x in Loop.made] == asked
    Loop.wrong[:] = ["unstable"]
    assert fit.run(p) is None
    Loop.wrong.clear()


@pytest.mark.parametrize(("delay", "late"), [(0.0, 0.0), (2e-3, 0.0), (0.4e-3, 0.4e-3)])
def test_a_delay_is_whole_samples_and_a_rest(
    delay: float, late: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit = loop_of(Servo(cascade(), sample_time=H, delay=delay + 1e-13))
    monkeypatch.setattr(identify, "ClosedLoop", Loop)
    Loop.made.clear()
    fit.run(fit.start())
    assert Loop.made[0].given[2].delay_s == pytest.approx(late, abs=1e-12)
    assert Loop.made[0].late == round((delay - late) / H)


def test_a_fit_begins_at_rest_where_the_record_begins() -> None:
    """With the gains of a P-PI for one sample time and the delay, and angles that begin at the
    command.
    """
    robot = ELBOW
    t = 1.0 + 4e-3 * np.arange(251)
    command = np.outer(np.linspace(0.0, 1.0, 251) ** 2, [0.4, -0.6]) + np.array([0.2, 0.3])
    record = ServoRecord(t, command, command + 0.01 * t[:, None])
    servo = Servo(PPI(), sample_time=3e-3, delay=1e-3)
    fit = RecordedLoop.begin(robot, record, servo, "cubic", lambda line: None)
    eta = ETA
    assert_allclose(fit.time, 1.0 + 3e-3 * np.arange(334))
    assert_allclose(fit.measured, (command + 0.01 * (t - 1.0)[:, None]) @ eta)
    assert (fit.gears, fit.interpolation) == (None, "cubic")
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
        RecordedLoop.begin(robot, record, own, "linear", lambda line: None).cascade is own.feedback
    )


def fit_of(record: ServoRecord, explained: float = 1.0) -> ServoFit:
    numbers = np.array([1e-5, 1e-5])
    servo = Servo(cascade(), sample_time=H)
    rest = record, "linear", "arm"
    fixed = {}, numbers, numbers, explained, True, ("m1", "m2")
    return ServoFit(servo, 0.0, np.ones((3, 2)), *fixed, *rest)


def test_angles_that_repeat_while_the_command_moves_are_stated() -> None:
    t = 4e-3 * np.arange(301)
    # both rest at the ends; the second joint crosses each step in one sample
    command = np.column_stack([np.clip(t - 0.2, 0.0, 0.8), np.clip(2.0 * t - 0.4, 0.0, 1.6)])
    for step, repeated in ((0.0, 0.0), (6e-3, 1 / 3), (8e-3, 1 / 2)):
        angle = step * np.round(command / step) if step else command
        found = fit_of(ServoRecord(t, command, angle))
        assert found.repeated == pytest.approx(repeated, abs=0.01)
        said = "angles repeat in 50 % of the samples: finer angles, or a faster motion"
        assert ("repeat" in found.sentence()) == (step == 8e-3) == found.sentence().endswith(said)


@pytest.mark.parametrize(("explained", "used"), [(0.9, True), (0.8999, False), (0.2, False)])
def test_a_servo_that_explains_too_little_is_not_used(explained: float, used: bool) -> None:
    text = (
        f"the servo explains {100 * explained:.0f} % of the lag of the robot, expected 90 %: "
        "another structure"
    )
    problem = fit_of(moved(), explained).problem
    assert problem.startswith(text) != used and (problem == "") == used


@pytest.mark.parametrize(
    ("text", "line", "cells"), [("10,2", 3, 2), ("10,2,3,4", 3, 4), ("10,2,3\n20,1", 4, 2)]
)
def test_rows_of_a_record_have_a_cell_for_each_name(
    text: str, line: int, cells: int, tmp_path: Path
) -> None:
    """The line of a mistake is that of the file."""
    file = tmp_path / "record.csv"
    file.write_text(f"time_ms,q1_command_deg,q1_deg\n0,1,2\n{text}\n")
    said = rf"record\.csv:{line}: given {cells} cells, expected 3, one for each"
    with pytest.raises(ArgumentError, match=said):
        ServoRecord.read(file, ELBOW)
