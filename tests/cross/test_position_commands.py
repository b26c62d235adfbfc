"""Positions that are sent to a robot with servos, against MuJoCo and a servo of this file that
shares no code.

The table for the interface is read from its CSV file; the servo interpolates it, filters it and
controls the motors of the exported robot; MuJoCo moves that robot between two samples of the
servo.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured_numbers import check_numbers
from numpy.testing import assert_allclose
from scipy.interpolate import CubicSpline
from servo_in_mujoco import GAINS, PLAIN, TABLE, InMujoco, OwnServo, robot_of, with_servo

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.inversion.judge.status import Status


def position_at(time: np.ndarray, rows: np.ndarray, t: float, interpolation: str) -> np.ndarray:
    """The position between two rows of a table; at rest before and after it."""
    x = (t - time[0]) / (time[1] - time[0])
    if x <= 0.0 or x >= len(time) - 1 - 1e-9:
        return rows[0 if x <= 0.0 else -1]
    j = int(x + 1e-9)
    x = max(x - j, 0.0)
    if interpolation == "hold":
        return rows[j]
    if interpolation == "linear":
        return (1 - x) * rows[j] + x * rows[j + 1]
    a, b, c, d = (rows[min(max(k, 0), len(rows) - 1)] for k in range(j - 1, j + 3))
    m0 = (c - a) / 2
    m1 = (d - b) / 2
    return (
        (2 * x**3 - 3 * x**2 + 1) * b
        + (x**3 - 2 * x**2 + x) * m0
        + (3 * x**2 - 2 * x**3) * c
        + (x**3 - x**2) * m1
    )


def read_table(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Time [s] and joints [rad] of a table in degrees."""
    rows = list(csv.reader(file.read_text().splitlines()))
    assert rows[0][0] == "time_s" and all(name.endswith("_deg") for name in rows[0][1:])
    values = np.array(rows[1:], float)
    return values[:, 0], np.deg2rad(values[:, 1:])


def servo_of(found: flexgen.PositionCommands, gains: flexgen.Cascade, **changes) -> OwnServo:
    hold = found.run.reference.held[0]
    start = found.run.solution.trajectory["q_m"][0]
    k = [
        np.asarray(x, float) for x in (gains.position_gain, gains.speed_gain, gains.integral_gain)
    ]
    own = OwnServo(*k, hold, start, found.servo.speed_feedforward, found.servo.reference_filter_s)
    return replace(own, **changes)


def error_in_mujoco(
    found: flexgen.PositionCommands, folder: Path, late: float = 0.0, **changes
) -> float:
    """Largest distance [m] of the tool from the path, of a robot that is sent the table; ``late``:
    it begins later.
    """
    time, joints = read_table(found.save(folder / "positions.csv"))
    return error_with(found, time + late, joints, **changes)


def error_with(
    found: flexgen.PositionCommands, time: np.ndarray, joints: np.ndarray, **changes
) -> float:
    model = found.run.model
    path = found.run.solution.trajectory
    servo = servo_of(found, found.run.law, **changes)
    robot = InMujoco(model, path["q_a"][0], path["q_m"][0])
    first = min(float(path.time[0]), float(time[0])) - 0.02
    first = servo.h * np.floor(first / servo.h)  # positions begin to act at samples of the servo
    rows = joints @ model.eta.T
    t, arm, _ = robot.follow(
        servo,
        lambda at: position_at(time, rows, at, found.interpolation),
        first,
        path.time[-1] + 0.3,
    )
    y = evaluate(flexgen.derive(model).function("output"), arm)[0].reshape(len(t), -1)
    wanted = path.at(np.clip(t, path.time[0], path.time[-1]))["y_ref"]
    return float(np.linalg.norm((y - wanted)[:, :2], axis=1).max())


@pytest.fixture(scope="module")
def solved() -> dict[str, flexgen.Solution]:
    return {
        name: flexgen.solve(robot_of(name), progress=False) for name in ("elbow", "planar5_nmp")
    }


@pytest.mark.parametrize("name", ["elbow", "planar5_nmp"])
def test_mujoco_under_the_table_follows_the_path(solved, tmp_path, name):
    """Interpolation by straight lines each 4 ms; planted: gains and start of the table that are
    wrong.
    """
    found = flexgen.command_positions(robot_of(name), solution=solved[name], progress=False)
    assert (
        found.status == "solved" and found.tool_error_max_m < 2e-6 < 1e-4 < found.today_error_max_m
    )
    assert error_in_mujoco(found, tmp_path) < 2e-6
    gains = found.run.law
    assert error_in_mujoco(found, tmp_path, k_p=1.1 * np.asarray(gains.position_gain)) > 1e-5
    assert error_in_mujoco(found, tmp_path, late=5e-4) > 1e-5
    assert error_in_mujoco(found, tmp_path, feedforward=0.9) > 1e-4


@pytest.mark.parametrize("interpolation", ["cubic", "hold"])
def test_other_interpolations_and_servos_in_mujoco(solved, tmp_path, interpolation):
    servo = flexgen.Servo(
        flexgen.PPI(position_hz=4.0), speed_feedforward=0.3, reference_filter_s=0.004
    )
    period = 0.008 if interpolation == "cubic" else 0.001
    found = flexgen.command_positions(
        robot_of("planar5_nmp"), solution=solved["planar5_nmp"], servo=servo, period=period,
        interpolation=interpolation, progress=False,
    )  # fmt: skip
    stated = found.tool_error_max_m
    assert stated < (1e-7 if interpolation == "cubic" else 1e-4)
    assert error_in_mujoco(found, tmp_path) == pytest.approx(stated, rel=0.1, abs=1e-7)
    assert error_in_mujoco(found, tmp_path, filter_s=0.0) > 1e-3  # planted: without the filter


def test_positions_begin_to_act_at_samples_of_the_servo(tmp_path):
    """A motion that begins between two samples of the servo, which is sent steps at its
    samples.
    """
    robot = flexgen.read("planar5_nmp", overrides={"move.line.duration": 0.50331})
    found = flexgen.command_positions(robot, period=1e-3, interpolation="hold", progress=False)
    begin = found.run.solution.trajectory.time[0] / found.servo.sample_time
    assert abs(begin - round(begin)) > 0.01
    assert found.tool_error_max_m < 2e-6
    assert error_in_mujoco(found, tmp_path) < 2e-6


def test_limits_that_others_make_the_positions_reach_are_named(solved):
    """The accelerations of the table without limits are below their bound, of the one with less
    speed they are not.
    """
    free = flexgen.command_positions("planar5_nmp", solution=solved["planar5_nmp"], progress=False)
    speed, acceleration = (
        np.abs(np.diff(free.joint, n=n, axis=0)).max(axis=0) / 4e-3**n for n in (1, 2)
    )
    bounds = {"speed": 0.9 * speed, "acceleration": 1.02 * acceleration}
    found = flexgen.command_positions(
        "planar5_nmp", solution=solved["planar5_nmp"], **bounds, progress=False
    )
    reached = np.abs(np.diff(found.joint, n=2, axis=0)).max(axis=0) / 4e-3**2
    assert_allclose(reached, bounds["acceleration"], rtol=1e-5)
    assert found.active == (
        "speed of q1",
        "speed of q2",
        "acceleration of q1",
        "acceleration of q2",
    )


def test_a_servo_without_integral_part_holds_the_arm_by_an_offset(solved, tmp_path):
    found = flexgen.command_positions(
        robot_of("planar5_nmp"),
        solution=solved["planar5_nmp"],
        servo=flexgen.PPI(integral_hz=0.0),
        progress=False,
    )
    gains = found.run.law
    hold = found.run.reference.held[0]
    offset = found.motor[0] - solved["planar5_nmp"].trajectory["q_m"][0]
    np.testing.assert_allclose(
        offset, hold / (gains.position_gain * gains.speed_gain), atol=1e-7
    )  # the table begins 1e-9 rad from rest, joint side
    time, joints = read_table(found.save(tmp_path / "positions.csv"))
    # the servo is at rest with the offset, without bias
    start = solved["planar5_nmp"].trajectory["q_m"][0] + offset
    with_offset = servo_of(found, gains, hold=np.zeros(len(hold)), start=start)
    with_offset.angle = start - offset
    assert error_with(found, time, joints - offset @ np.linalg.inv(found.run.model.eta).T) < 2e-6
    model = found.run.model
    robot = InMujoco(model, solved["planar5_nmp"].trajectory["q_a"][0], start - offset)
    _, arm, _ = robot.follow(with_offset, lambda t: start, 0.0, 0.2)
    assert np.abs(arm[-1] - arm[0]).max() < 1e-9


@pytest.mark.full
def test_mujoco_of_six_axes_under_the_table(tmp_path):
    """The first 0.6 s of its move."""
    robot = robot_of("manutec_r3_18")
    found = flexgen.command_positions(robot, progress=False)
    assert found.tool_error_max_m < 2e-6
    assert error_in_mujoco(found, tmp_path) < 2e-6


@pytest.mark.slow
@pytest.mark.parametrize("delay", [1.07e-3, 1.3e-3])
def test_an_unstable_servo_is_not_solved(solved, delay):
    """Its deviations grow by 1e13 and more in the motion, until the numbers are not finite; with 1
    ms it is stable.
    """
    gains = flexgen.Cascade((30.0, 25.0), (4.0, 1.0), (6.0, 6.0))
    for late, words in (
        (delay, "failed: the loop of servo and robot is unstable"),
        (1e-3, "solved"),
    ):
        found = flexgen.command_positions(
            robot_of("planar5_nmp"),
            solution=solved["planar5_nmp"],
            servo=flexgen.Servo(gains, delay=late),
            progress=False,
        )
        assert found.status.startswith(words)


def test_limits_of_the_commands_are_kept_and_their_cost_is_stated(solved):
    given = {"solution": solved["planar5_nmp"], "progress": False}
    free = flexgen.command_positions(robot_of("planar5_nmp"), **given)
    speed = np.abs(free.speed).max(axis=0)
    acceleration = np.abs(free.acceleration).max(axis=0)
    same = flexgen.command_positions(robot_of("planar5_nmp"), speed=1.01 * speed, **given)
    assert same.active == () and np.array_equal(same.joint, free.joint)
    found = flexgen.command_positions(
        robot_of("planar5_nmp"), acceleration=0.8 * acceleration, **given
    )
    assert found.active == (
        "acceleration of q1",
        "acceleration of q2",
    ) and found.status.startswith("limits active")
    assert (np.abs(found.acceleration) <= 0.8 * acceleration * (1 + 1e-6)).all()
    assert found.tool_error_max_m > 10 * free.tool_error_max_m


def test_limits_of_a_solution_are_limits_of_its_positions(solved):
    """Whose error has the distance by which the limits moved the tool off its path."""
    limited = replace(solved["planar5_nmp"], status=Status.LIMITS_ACTIVE)
    found = flexgen.command_positions(robot_of("planar5_nmp"), solution=limited, progress=False)
    assert found.status == "limits active: those of the solution" and found.active == ()


def test_errors_of_other_robots_are_stated(solved):
    given = {
        "solution": solved["planar5_nmp"],
        "plants": {"soft": {"stiffness": 0.9}},
        "progress": False,
    }
    found = flexgen.command_positions(robot_of("planar5_nmp"), **given)
    assert (
        found.to_dict()["soft.tool_error_max_m"]
        == found.run.distance(found.run["soft"]).max()
        > 1e-5
    )
    assert "tool error of soft: " in str(found)


def test_filters_of_the_torque_are_inverted(solved):
    """A low pass has zeros at z = -1: the least squares over the motion inverts them."""
    servo = flexgen.Servo(flexgen.PPI(filters=(flexgen.LowPass(300.0), flexgen.Notch(60.0))))
    found = flexgen.command_positions(
        robot_of("planar5_nmp"), solution=solved["planar5_nmp"], servo=servo, progress=False
    )
    assert found.tool_error_max_m < 2e-6


# --- identification ------------------------------------------------------------------------------


def recorded(
    model: flexgen.RobotModel,
    servo: OwnServo,
    q_a: np.ndarray,
    seconds: float,
    latency: float,
    folder: Path,
) -> Path:
    """A CSV file of commands each 4 ms and measured joints, of a robot in MuJoCo; noise of the
    motors 1e-4 rad.
    """
    rng = np.random.default_rng(3)
    t = 4e-3 * np.arange(round(seconds / 4e-3))
    r = np.clip((t - 0.1) / 0.5, 0.0, 1.0)
    window = r**3 * (10 - 15 * r + 6 * r**2)
    home = np.linalg.solve(model.eta, servo.start)
    moved = np.zeros((len(t), model.n_g))
    for j in range(model.n_g):
        for hz in rng.uniform(0.3, 4.0, 12):
            moved[:, j] += (
                0.08 * rng.normal() / hz * np.sin(2 * np.pi * hz * t + rng.uniform(0, 6.28))
            )
    command = home + window[:, None] * moved
    robot = InMujoco(model, q_a, servo.start)
    rows = command @ model.eta.T
    at, _, motors = robot.follow(
        servo, lambda s: position_at(t + latency, rows, s, "linear"), 0.0, seconds
    )
    motors = motors + 1e-4 * rng.standard_normal(motors.shape)
    angle = np.array([np.interp(t, at, x) for x in motors.T]).T @ np.linalg.inv(model.eta).T
    names = [model.coordinates[i].name for i in model.i_g]
    head = [
        "time_ms",
        *(f"{name}_command_deg" for name in names),
        *(f"{name}_deg" for name in names),
    ]
    table = np.column_stack([1e3 * t, np.rad2deg(command), np.rad2deg(angle)])
    file = folder / "record.csv"
    file.write_text(
        "\n".join([",".join(head), *(",".join(f"{x:.10g}" for x in row) for row in table)]) + "\n"
    )
    return file


@pytest.mark.slow
def test_a_servo_identified_from_ten_seconds_leaves_five_percent(solved, tmp_path):
    """Its gains are 0.75 to 1.4 of those where the search begins; the record comes from MuJoCo."""
    model = robot_of("planar5_nmp")
    path = solved["planar5_nmp"].trajectory
    usual = flexgen.command_positions(model, solution=solved["planar5_nmp"], progress=False)
    k = [
        np.asarray(x)
        for x in (
            usual.run.law.position_gain,
            usual.run.law.speed_gain,
            usual.run.law.integral_gain,
        )
    ]
    true = {
        "k_p": k[0] * [0.75, 1.3],
        "k_v": k[1] * [1.4, 0.8],
        "k_i": k[2] * [1.2, 0.9],
        "feedforward": 0.85,
        "filter_s": 2.5e-3,
    }
    servo = servo_of(usual, usual.run.law, **true)
    fit = flexgen.identify_servo(
        model, recorded(model, servo, path["q_a"][0], 10.0, 3e-3, tmp_path), progress=False
    )
    assert fit.problem == "" and fit.latency_s == pytest.approx(3e-3, abs=1e-4)
    for gain, sd, wanted in zip(
        ("position_gain", "speed_gain", "integral_gain"),
        fit.gain_sd,
        list(true.values())[:3],
        strict=True,
    ):
        error = np.asarray(getattr(fit.servo.feedback, gain)) / wanted - 1
        assert (np.abs(error) < 0.02).all() and (np.abs(error) < 5 * sd + 2e-3).all()
    read = flexgen.Servo.read(fit.save(tmp_path / "servo.toml"))
    found = flexgen.command_positions(
        model, solution=solved["planar5_nmp"], servo=read, progress=False
    )
    today = flexgen.solve(model, progress=False).trajectory
    edges = 4e-3 * np.arange(int(today.time[-1] / 4e-3) + 2)
    angles = (
        today.at(np.clip(edges, today.time[0], today.time[-1]))["q_m"] @ np.linalg.inv(model.eta).T
    )
    before = error_with(usual, edges, angles, **true)
    assert error_in_mujoco(found, tmp_path, **{**true}) < 0.05 * before
    assert error_in_mujoco(usual, tmp_path, **true) > 0.05 * before  # without identification


@pytest.mark.slow
def test_a_servo_of_another_structure_is_said_not_to_fit(solved, tmp_path):
    """Commands that are not what the robot was sent: of another motion."""
    model = robot_of("planar5_nmp")
    path = solved["planar5_nmp"].trajectory
    usual = flexgen.command_positions(model, solution=solved["planar5_nmp"], progress=False)
    servo = servo_of(usual, usual.run.law)
    file = recorded(model, servo, path["q_a"][0], 4.0, 0.0, tmp_path)
    record = flexgen.ServoRecord.read(file, model)
    wrong = flexgen.ServoRecord(
        record.time, record.command, record.angle[:1] + 0.3 * np.sin(9 * record.time)[:, None]
    )
    assert "another structure" in flexgen.identify_servo(model, wrong, progress=False).problem


@pytest.mark.slow
def test_logs_of_a_servo_with_quirks_have_its_gains(solved, tmp_path):
    """Late stamps, revolutions, another order, names by option, a gap at the end."""
    model = robot_of("planar5_nmp")
    path = solved["planar5_nmp"].trajectory
    usual = flexgen.command_positions(model, solution=solved["planar5_nmp"], progress=False)
    servo = servo_of(usual, usual.run.law)
    file = recorded(model, servo, path["q_a"][0], 6.0, 0.0, tmp_path)
    plain = flexgen.identify_servo(model, file, progress=False)
    head, *rows = (line.split(",") for line in file.read_text().splitlines())
    values = np.array(rows, dtype=float)
    rng = np.random.default_rng(6)
    late = values.copy()
    late[:, 0] += 0.4 * rng.normal(size=len(late))  # ms
    late[:, 1:] /= 360.0
    late = np.delete(late, slice(1400, 1450), axis=0)
    order = [3, 1, 0, 4, 2]
    names = [head[k].replace("deg", "rev") for k in order]
    lines = [",".join(f"{x:.12g}" for x in row[order]) for row in late]
    file.write_text("\n".join(lines) + "\n")
    found = flexgen.identify_servo(model, file, columns=names, progress=False)
    assert any("time stamps scatter" in note for note in found.record.notes)
    assert any("before its first gap" in note for note in found.record.notes)
    gains, before = (
        np.array([x.servo.feedback.position_gain, x.servo.feedback.speed_gain])
        for x in (found, plain)
    )
    deviations = np.hypot(found.gain_sd[:2], plain.gain_sd[:2])  # relative
    assert (np.abs(gains / before - 1) < 4 * deviations).all() and (deviations < 1e-3).all()


# --- bad input -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"period": 1e-4}, "period: given 0.0001, expected from 0.0005 s"),
        ({"servo": "lqg"}, "servo: given 'lqg', expected"),
        ({"interpolation": "spline"}, "interpolation"),
        ({"speed": [1.0]}, "speed: given"),
        ({"servo": flexgen.Cascade([0.0, 1.0], [1.0, 1.0], [1.0, 1.0])}, "position_gain: given"),
    ],
)
def test_bad_arguments_of_commands(solved, given, message):
    with pytest.raises(ArgumentError, match=message):
        flexgen.command_positions("elbow", solution=solved["elbow"], progress=False, **given)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            "t,q1_deg\n0,1\n",
            r"record.csv:1: given the column 't' without a unit, expected 't s' or",
        ),
        ("clock,q1_deg\n0,1\n", r"given the columns clock, q1_deg, expected time_s or time_ms"),
        (
            "time_s,q1_command_deg,q1_deg\n0,1,1\n",
            (
                r"record.csv:1: given no column of q2_command, expected one, q2_command_rad or "
                r"q2_comm"
            ),
        ),
        (
            "time_s,q1_command_gon,q1_deg\n0,1,1\n",
            r"csv:1: column 'q1_command_gon': given 'gon', an unknown unit, expected an angle",
        ),
        (
            "time_s,q1_command_mm,q1_deg\n0,1,1\n",
            r"column 'q1_command_mm': given 'mm', a length, expected an angle in rad, mrad",
        ),
        (
            "time_s,q1_command_deg,q2_command_deg,q1_deg,q2_deg\n0,1,x,1,1\n",
            r"record.csv:2: q2_command_deg: given 'x'",
        ),
        (
            "time_s,q1_command_deg,q2_command_deg,q1_deg,q2_deg\n0,1,1,1,1\n",
            r"given 1 rows, expected 100",
        ),
        (
            "time_s,q1_command_deg,q2_command_deg,q1_deg,q2_deg\n0,1,1,1,nan\n",
            r"record.csv:2: q2_deg: given 'nan'",
        ),
        (
            "time_s,q1_command_deg,q2_command_deg,q1_deg,q2_deg\n0,1,1,1,5,1\n",
            r":2: given 6 cells, expected 5,",
        ),
        (
            "time_s;q1_command_deg;q1_deg\n0;1,5;1\n",
            r"record.csv:1: given 'time_s;q1_command_deg;q1_deg', expected commas between the col",
        ),
    ],
)
def test_bad_records(tmp_path, lines, message):
    file = tmp_path / "record.csv"
    file.write_text(lines)
    with pytest.raises(ArgumentError, match=message):
        flexgen.identify_servo("elbow", file, progress=False)


def test_records_that_do_not_move_or_begin_in_motion():
    t = 4e-3 * np.arange(200)
    still = np.zeros((200, 2))
    with pytest.raises(ArgumentError, match="do not move q1, q2"):
        flexgen.identify_servo("elbow", flexgen.ServoRecord(t, still, still), progress=False)
    moving = np.sin(t)[:, None] * [1.0, 1.0]
    with pytest.raises(ArgumentError, match="begins at rest"):
        flexgen.identify_servo("elbow", flexgen.ServoRecord(t, moving, moving), progress=False)
    with pytest.raises(
        ArgumentError, match=r"in time at row 102, 0.104 s after the row before, .* rows, 0.004 s"
    ):
        flexgen.ServoRecord(np.where(t > 0.4, t + 0.1, t), still, still)
    with pytest.raises(ArgumentError, match=r"given 4 s between two rows.*column time_ms"):
        flexgen.ServoRecord(1000.0 * t, still, still)


def test_records_in_other_units_are_refused():
    """Degrees in columns of radians, and angles of motors, which begin at rest."""
    t = 4e-3 * np.arange(200)
    ratios = np.ravel([m.ratio for m in flexgen.read("planar5_nmp").motors])
    moved = np.array([0.3, -1.1]) + 0.1 * np.clip(t - 0.2, 0.0, 1.0)[:, None] ** 2 * [1.0, 1.0]
    with pytest.raises(
        ArgumentError, match="given angles of q1 that move 100 times as far as its commands"
    ):
        flexgen.identify_servo(
            "planar5_nmp", flexgen.ServoRecord(t, moved, ratios * moved), progress=False
        )
    degrees = flexgen.ServoRecord(t, np.rad2deg(moved), np.rad2deg(moved))
    limits = {
        f"element.arm1.dof.q1.{key}": value
        for key, value in (("lower_deg", -90.0), ("upper_deg", 90.0))
    }
    with pytest.raises(
        ArgumentError, match=r"given commands of q1 from 17.19 to .* rad, all beyond its limits"
    ):
        flexgen.identify_servo(
            flexgen.read("planar5_nmp", overrides=limits), degrees, progress=False
        )


# --- the servo of a model file -------------------------------------------------------------------


def test_a_robot_carries_its_servo(tmp_path):
    """The table of the model, the file of the servo, and an argument, which overrides the
    table.
    """
    given = {"move": "line", "progress": False}
    file = tmp_path / "servo.toml"
    file.write_text(TABLE)
    robot = with_servo(tmp_path, TABLE)
    found = flexgen.command_positions(robot, **given)
    assert np.array_equal(
        found.joint, flexgen.command_positions("planar5_nmp", servo=str(file), **given).joint
    )
    assert found.tool_error_max_m < 2e-6
    check_numbers("commands", 1e-5, joint=found.joint, figures=found.to_dict())
    usual = flexgen.command_positions("planar5_nmp", **given)
    assert np.array_equal(
        flexgen.command_positions(robot, servo="ppi", **given).joint, usual.joint
    )
    assert found.run.law.position_gain[0] == 30.0 != usual.run.law.position_gain[0]
    proposed = with_servo(tmp_path, 'type = "ppi"\n')
    assert np.array_equal(flexgen.command_positions(proposed, **given).joint, usual.joint)


@pytest.mark.slow
def test_columns_of_positions_drive_mujoco(tmp_path):
    """Planted: a delay of one sample of the servo, and a model whose speed gains are exchanged."""
    servo = flexgen.read(with_servo(tmp_path, PLAIN)).servo
    robot = replace(robot_of("planar5_nmp"), servo=servo)
    found = flexgen.solve(robot, command="position", progress=False)
    path = found.trajectory
    given = flexgen.command_positions(robot, solution=found, progress=False)
    np.testing.assert_allclose(path["command_g"] @ robot.eta.T, path["command_m"], rtol=1e-12)
    assert path.labels["command_g"] == ("q1", "q2") and "command_m" in flexgen.Trajectory.load(
        path.save(tmp_path / "x.csv")
    )
    ticks = given.run.reference.time
    inside = (ticks >= path.time[0]) & (ticks <= path.time[-1])
    reference = CubicSpline(path.time, path["command_m"])
    gains = given.run.law

    def error(late: float = 0.0, **changes) -> float:
        own = replace(
            OwnServo(*GAINS, given.run.reference.held[0], path["q_m"][0], 0.8, 0.003), **changes
        )
        arm = InMujoco(robot, path["q_a"][0], path["q_m"][0])
        command = lambda t: reference(np.clip(t - late, path.time[0], path.time[-1]))  # noqa: E731
        t, q_a, _ = arm.follow(own, command, ticks[inside][0], ticks[inside][-1])
        y = evaluate(flexgen.derive(robot).function("output"), q_a)[0].reshape(len(t), -1)
        return float(np.linalg.norm((y - path.at(t)["y_ref"])[:, :2], axis=1).max())

    assert [gains.position_gain, gains.speed_gain, gains.integral_gain] == [
        pytest.approx(x) for x in GAINS
    ]
    assert error() < 1e-6
    assert error(late=5e-4) > 2e-5
    assert error(k_v=GAINS[1][::-1]) > 1e-4


def test_columns_of_a_model_without_servo_are_refused():
    with pytest.raises(
        ArgumentError,
        match=r'command: given "position" for the model elbow without a servo, expected',
    ):
        flexgen.solve("elbow", command="position", progress=False)
    plain, other = (
        flexgen.solve("elbow", progress=False, **x).trajectory for x in ({}, {"command": "torque"})
    )
    assert (
        all(np.array_equal(plain[name], other[name]) for name in plain.channels)
        and "command_m" not in plain
    )


@pytest.mark.slow
def test_identification_begins_with_the_servo_of_the_model(tmp_path):
    robot = flexgen.read(
        with_servo(tmp_path, TABLE.replace("delay = 0.0005", "sample_time = 0.001"))
    )
    run = flexgen.command_positions(robot, progress=False).today
    joints = np.linalg.inv(run.model.eta).T
    record = flexgen.ServoRecord(
        run.reference.time, run.reference.motion["q_m"] @ joints, run.nominal.measured @ joints
    )
    found = flexgen.identify_servo(robot, record, progress=False)
    assert found.servo.sample_time == 0.001 and len(found.servo.feedback.filters) == 2
    gains = [
        getattr(found.servo.feedback, f"{kind}_gain") for kind in ("position", "speed", "integral")
    ]
    assert_allclose(gains, GAINS, rtol=1e-6)
    assert found.unexplained.max() < 1e-9 and found.latency_s < 1e-9


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "[30.0, 25.0]",
            "[30.0]",
            r"servo.position_gain: given \[30.0\], expected a list of 2 numbers",
        ),
        (
            "[1.5, 0.4]",
            "[1.5, 0.0]",
            r"servo.speed_gain: given \[1.5, 0.0\], expected numbers > 0",
        ),
        (
            "[6.0, 6.0]",
            "[6.0, -6.0]",
            r"servo.integral_gain: .* a zero 1/\(1 \+ k_i h\) > 1, and its inverse is unstable",
        ),
        ('"cascade"', '"linear"', r"servo.type: given \"linear\", expected one of cascade, ppi"),
        ("delay", "late", r"servo.late"),
        (
            "speed_feedforward = 0.8",
            "speed_feedforward = 2.8",
            r"servo.speed_feedforward: given 2.8",
        ),
    ],
)
def test_wrong_tables_of_servos(tmp_path, old, new, message):
    with pytest.raises(ModelError, match=message):
        flexgen.read(with_servo(tmp_path, TABLE.replace(old, new)))
