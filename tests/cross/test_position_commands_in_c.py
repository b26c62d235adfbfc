"""Positions to send in the emitted C: whole paths and streams against the servo of textbooks,
MuJoCo, and Python.

Samples for an interface by a solver that shares no code. Planted errors: an integral part that is
not carried from sample to sample, a delay of a sample, gains in another order.
"""

from __future__ import annotations

import copy
import ctypes
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from servo_in_mujoco import GAINS, PLAIN, InMujoco, OwnServo, robot_of, sampled, with_servo
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.emission import clib_files
from flexgen.feedback.positions.inverse import invert_servo
from flexgen.feedback.positions.samples import basis, fit_samples
from flexgen.feedback.positions.servo import servo_of
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples
from flexgen.runtime.library import Library

pytestmark = needs_compiler
H = 5e-4  # s, of the servo
# of the torques of a servo with filters: the series of their inverse ends, plans of a stream
# change
FILTERED = 1e-5
PERIOD = 5e-3  # of a stream: update
EACH = 10  # samples
INTERVALS = 100  # horizon
NAMES = ("command_m", "command_g", "tau_m", "q_m", "q_a")
FILTERS = """
notch = [{ frequency_hz = 60.0 }, { frequency_hz = 110.0, zero_damping = 0.05, pole_damping = 0.5 \
}]
low_pass = [{ frequency_hz = 400.0, damping = 0.9 }, { frequency_hz = 700.0 }]
"""
SECTIONS = (
    sampled([1.0, 0.2, 1.0], [1.0, 1.4, 1.0], 60.0, H),
    sampled([1.0, 0.1, 1.0], [1.0, 1.0, 1.0], 110.0, H),
    sampled([0.0, 0.0, 1.0], [1.0, 1.8, 1.0], 400.0, H),
    sampled([0.0, 0.0, 1.0], [1.0, 1.4, 1.0], 700.0, H),
)
PLANTED_IN_FILTERS = {
    "a sample later": ("at = k + i - FILTER_BEFORE", "at = k + i - FILTER_BEFORE - 1"),
    "memory of a notch": ("z[1] = z[0];", "z[1] = x;"),
    "no samples before an interval": ("sent + (each + i) * NM : tau", "sent : tau"),
}
PLANTED = {
    "integral part": ("sum[j] = (sum[j] + (w", "sum[j] = (0.0 * sum[j] + (w"),
    "delay": ("reference[j] = (filtered[j]", "reference[j] = (before"),
    "order": (
        "copy(o->speed_gain, NM, c + SERVO_GAINS + NM)",
        "copy(o->speed_gain, 1, c + SERVO_GAINS + 2 * NM - 1)",
    ),
}


def library_of(model: flexgen.RobotModel, folder: Path) -> Library:
    return flexgen.load(flexgen.generate(model, folder / "library", parts=["position"]).directory)


def samples_of(
    model: flexgen.RobotModel, period: float, after: int = 0
) -> tuple[Any, list[np.ndarray]]:
    """A move and samples of its output with two derivatives, at rest after it."""
    move = flexgen.plan(model)
    n = round(move.duration / period) + 1
    rows = [
        np.vstack([x, np.tile(x[-1:], (after, 1))])
        for x in samples(Reduction(flexgen.derive(model)), move, period, n)
    ]
    for x in rows[1:]:
        x[n - 1 :] = 0.0
    return move, rows


def inverted(model: flexgen.RobotModel, library: Library, **more: Any) -> Any:
    move, path = samples_of(model, H)
    given = {
        "period": H,
        "q_start": move.q_start,
        "n_pre": 400,
        "n_post": 1200,
        "samples_per_interval": 10,
    }
    return library.invert(*path, **given, servo=True, **more)


def streamed(model: flexgen.RobotModel, library: Library, **more: Any) -> SimpleNamespace:
    """All intervals of a stream along the move, and after it."""
    move, (y, dy, ddy) = samples_of(model, PERIOD, INTERVALS + 60)
    given = {"period": PERIOD, "intervals": INTERVALS, "samples_per_interval": EACH, "servo": True}
    stream = library.stream(y[0], move.q_start, **given, **more)
    found = []
    for k in range(1, len(y)):
        if k == 130:
            stream = copy.copy(stream)  # its memory holds the whole state
        found.append(stream.update(y[k], dy[k], ddy[k]))
    rows = {name: np.vstack([getattr(x, name) for x in found]) for name in NAMES}
    return SimpleNamespace(t=H * np.arange(len(found) * EACH) - (INTERVALS - 1) * PERIOD, **rows)


def miss(found: Any, **servo: Any) -> float:
    """Largest difference of the torques that the servo of textbooks sends from those to send,
    relative.
    """
    members = {"feedforward": 0.8, "filter_s": 0.003, "h": H} | servo
    own = OwnServo(*GAINS, found.tau_m[0], found.q_m[0], **members)
    sent = np.array([own.torque(r, q) for r, q in zip(found.command_m, found.q_m, strict=True)])
    return float(np.abs(sent - found.tau_m).max() / np.abs(found.tau_m).max())


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> tuple[flexgen.RobotModel, Library]:
    folder = tmp_path_factory.mktemp("position")
    model = replace(robot_of("planar5_nmp"), servo=flexgen.read(with_servo(folder, PLAIN)).servo)
    return model, library_of(model, folder)


# --- the servo -----------------------------------------------------------------------------------


@pytest.mark.parametrize("find", [inverted, streamed], ids=["whole path", "stream"])
def test_the_servo_of_textbooks_sends_the_torques(robot: Any, find: Callable[..., Any]) -> None:
    """And the inverse in Python has the same numbers."""
    model, library = robot
    found = find(model, library)
    assert np.abs(found.tau_m - found.tau_m[0]).max() > 1.0
    assert miss(found) < 1e-9
    assert miss(found, filter_s=0.0) > 1e-2
    servo = servo_of(None, model)
    expected = invert_servo(servo, servo.feedback, found.tau_m, found.q_m)
    np.testing.assert_allclose(found.command_m, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.command_g @ model.eta.T, found.command_m, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTED)
def test_planted_errors_are_found(
    robot: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    texts = clib_files.read_clib()
    (old, new) = PLANTED[name]
    assert texts["servo.h"].count(old) == 1
    wrong = texts | {"servo.h": texts["servo.h"].replace(old, new)}
    monkeypatch.setattr(clib_files, "read_clib", lambda: wrong)
    model = robot[0]
    library = library_of(model, tmp_path)
    assert not miss(inverted(model, library)) < 1e-4
    assert not miss(streamed(model, library)) < 1e-4


@pytest.mark.parametrize("feedforward", [0.0, 1.0])
@pytest.mark.parametrize("filter_s", [0.0, 0.004])
@pytest.mark.parametrize("integral", [0.0, 9.0])
def test_other_servos_at_run_time(
    robot: Any, feedforward: float, filter_s: float, integral: float
) -> None:
    """A motor without an integral part holds the arm by an offset of its reference."""
    model, library = robot
    own = [np.array([20.0, 40.0]), np.array([3.0, 0.6]), np.array([integral, 2.0])]
    members = dict(zip(("position_gain", "speed_gain", "integral_gain"), own, strict=True))
    late = {"speed_feedforward": feedforward, "reference_filter": filter_s, "delay": 1.5 * H}
    move, path = samples_of(model, H)
    given = {
        "period": H,
        "q_start": move.q_start,
        "n_pre": 400,
        "n_post": 1200,
        "samples_per_interval": 10,
    }
    found = library.invert(*path, **given, servo=members | late)
    hold = library.invert(*path, **given).tau_m[0]
    offset = np.where(own[2] > 0.0, 0.0, hold / (own[0] * own[1]))
    servo = OwnServo(*own, hold, found.q_m[0], feedforward, filter_s, H)
    sent = np.array(
        [servo.torque(r - offset, q) for r, q in zip(found.command_m, found.q_m, strict=True)]
    )
    np.testing.assert_allclose(sent, found.tau_m, rtol=0, atol=1e-8)


def test_a_solution_has_the_same_columns(robot: Any) -> None:
    """The torques of both come from other interpolations of the motion."""
    model, library = robot
    found = inverted(model, library)
    path = flexgen.solve(model, command="position", progress=False).trajectory
    inside = (found.t >= path.time[0]) & (found.t <= path.time[-1])
    wanted = path.at(found.t[inside])["command_m"]
    np.testing.assert_allclose(found.command_m[inside], wanted, rtol=0, atol=1e-6)


def test_results_without_a_servo_are_those_of_other_libraries(robot: Any, tmp_path: Path) -> None:
    model, library = robot
    other = flexgen.load(flexgen.generate(model, tmp_path / "plain").directory)
    move, path = samples_of(model, H)
    given = {"period": H, "q_start": move.q_start, "n_pre": 400, "n_post": 800, "hold": "zoh"}
    one, two = (x.invert(*path, **given) for x in (library, other))
    assert one.command_m is None and all(
        np.array_equal(getattr(one, x), getattr(two, x)) for x in ("q_m", "tau_m")
    )
    assert np.array_equal(one.tau_m, library.invert(*path, **given, servo=True).tau_m)


@pytest.mark.parametrize("which", ["robot", "filtering"])
def test_memory_of_a_stream_is_that_of_its_macro(
    request: pytest.FixtureRequest, which: str
) -> None:
    """With the largest delay of a hold; the macro of the public header is a bound that is not far
    away.
    """
    _, library = request.getfixturevalue(which)
    text = (library.directory / "planar5_nmp_inversion.h").read_text()
    found = re.search(r"STREAM_SIZE\(.*\) *\\\n *\((.*)\)\n", text)
    assert found is not None
    constant, per_interval, per_sample = map(int, re.findall(r"INT64_C\((\d+)\)", found[1]))
    assert library.streams is not None
    options = library.streams.structs["stream_options"](
        period=1e-3, tolerance=1e-6, hold=2, delay=4.0
    )
    for options.intervals, options.samples_per_interval in (
        (1, 1),
        (1, 7),
        (10, 5),
        (100, 20),
        (513, 2),
    ):
        needed = int(library.streams.work(ctypes.byref(options)))
        bound = (
            constant + per_interval * options.intervals + per_sample * options.samples_per_interval
        )
        assert needed <= bound <= 1.15 * needed + 2500


# --- filters of the torque -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def filtering(tmp_path_factory: pytest.TempPathFactory) -> tuple[flexgen.RobotModel, Library]:
    folder = tmp_path_factory.mktemp("filters")
    model = replace(
        robot_of("planar5_nmp"), servo=flexgen.read(with_servo(folder, PLAIN + FILTERS)).servo
    )
    return model, library_of(model, folder)


@pytest.mark.parametrize("find", [inverted, streamed], ids=["whole path", "stream"])
def test_a_servo_that_filters_its_torque_sends_the_torques(
    filtering: Any, find: Callable[..., Any]
) -> None:
    model, library = filtering
    found = find(model, library)
    assert miss(found, filters=SECTIONS) < FILTERED
    assert miss(found) > 1e-2 and miss(found, filters=SECTIONS[:3]) > 1e-3
    np.testing.assert_allclose(found.command_g @ model.eta.T, found.command_m, rtol=0, atol=1e-9)


@pytest.mark.parametrize("find", [inverted, streamed], ids=["whole path", "stream"])
def test_mujoco_with_filters_of_the_torque_follows_the_path(
    filtering: Any, find: Callable[..., Any]
) -> None:
    model, library = filtering
    found = find(model, library)
    assert error_in_mujoco(model, found, filters=SECTIONS) < 2e-6
    assert error_in_mujoco(model, found) > 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTED_IN_FILTERS)
def test_planted_errors_of_filters_are_found(
    filtering: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    texts = clib_files.read_clib()
    (old, new) = PLANTED_IN_FILTERS[name]
    file = "stream_update.h" if "each" in old else "servo.h"
    assert texts[file].count(old) == 1
    wrong = texts | {file: texts[file].replace(old, new)}
    monkeypatch.setattr(clib_files, "read_clib", lambda: wrong)
    library = library_of(filtering[0], tmp_path)
    assert not miss(streamed(filtering[0], library), filters=SECTIONS) < 1e-4


def test_filters_hold_for_the_sample_time_of_the_model_file(filtering: Any) -> None:
    model, library = filtering
    move, path = samples_of(model, 1e-3)
    with pytest.raises(ArgumentError, match="out of range"):
        library.invert(
            *path, period=1e-3, q_start=move.q_start, n_pre=400, servo={"sample_time": 1e-3}
        )


# --- the robot -----------------------------------------------------------------------------------


def error_in_mujoco(
    model: flexgen.RobotModel, found: Any, delay: int = 0, **changes: Any
) -> float:
    """Largest distance [m] of the tool from the path, of a robot that gets a command at each
    sample of its servo.
    """
    # at rest
    t = found.t
    hold = found.tau_m[0]
    servo = OwnServo(
        *changes.pop("gains", GAINS), hold, found.q_m[0], 0.8, 0.003, H, changes.pop("filters", ())
    )
    arm = InMujoco(model, found.q_a[0], found.q_m[0])
    rows = np.vstack([found.command_m[:1]] * (delay + 1) + [found.command_m])[1:]
    at, q_a, _ = arm.follow(
        servo, lambda s: rows[round((s - t[0]) / H)], t[0], t[0] + H * (len(t) - 1)
    )
    y = evaluate(flexgen.derive(model).function("output"), q_a)[0].reshape(len(at), -1)
    move = flexgen.plan(model)
    wanted = move.sample(np.clip(at, 0.0, move.duration)).y[:, :, 0]
    width = 3 if model.output.type == "tool_pose" else wanted.shape[1]
    return float(np.linalg.norm((y - wanted)[:, :width], axis=1).max())


@pytest.mark.parametrize("find", [inverted, streamed], ids=["whole path", "stream"])
def test_mujoco_with_the_commands_of_c_follows_the_path(
    robot: Any, find: Callable[..., Any]
) -> None:
    model, library = robot
    found = find(model, library)
    assert error_in_mujoco(model, found) < 2e-6
    assert error_in_mujoco(model, found, delay=1) > 2e-5
    assert error_in_mujoco(model, found, gains=(GAINS[0], GAINS[1][::-1], GAINS[2])) > 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("filters", ["", FILTERS], ids=["plain", "filters"])
def test_mujoco_with_commands_in_single_precision_follows_the_path(
    tmp_path: Path, filters: str
) -> None:
    """0.5 to 0.7 um measured; planted: positions with three digits."""
    model = replace(
        robot_of("planar5_nmp"), servo=flexgen.read(with_servo(tmp_path, PLAIN + filters)).servo
    )
    library = flexgen.load(
        flexgen.generate(model, tmp_path / "s", parts=["position"], precision="single").directory
    )
    own: dict[str, Any] = {"filters": SECTIONS} if filters else {}
    for found in (inverted(model, library), streamed(model, library)):
        exact = SimpleNamespace(
            t=found.t, **{name: np.asarray(getattr(found, name), float) for name in NAMES}
        )
        assert found.command_m.dtype == np.float32 and error_in_mujoco(model, exact, **own) < 2e-6
        exact.command_m = exact.command_m.astype(np.float16).astype(float)
        assert error_in_mujoco(model, exact, **own) > 1e-5
    if not filters:
        assert error_of_table(model, library) < 2e-6 and error_of_windows(model, library, 8) < 2e-6


@pytest.mark.full
def test_mujoco_of_six_axes_with_the_commands_of_c(tmp_path: Path) -> None:
    usual = flexgen.command_positions(robot_of("manutec_r3_18"), progress=False)
    gains = [
        np.asarray(getattr(usual.run.law, x))
        for x in ("position_gain", "speed_gain", "integral_gain")
    ]
    rows = zip(("position_gain", "speed_gain", "integral_gain"), gains, strict=True)
    table = 'type = "cascade"\nspeed_feedforward = 0.8\nreference_filter_s = 0.003\n'
    table += "".join(f"{name} = {list(map(float, x))}\n" for name, x in rows)
    model = replace(
        robot_of("manutec_r3_18"),
        servo=flexgen.read(with_servo(tmp_path, table, "manutec_r3_18")).servo,
    )
    library = library_of(model, tmp_path)
    found = inverted(model, library)
    assert error_in_mujoco(model, found, gains=gains) < 2e-6
    assert error_in_mujoco(model, found, gains=gains, delay=1) > 1e-5
    assert error_of_table(model, library, gains) < 2e-6
    assert error_in_mujoco(model, streamed(model, library), gains=gains) < 2e-6
    assert error_of_windows(model, library, 8, gains) < 2e-6


# --- what there is not ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("", r"'position', but model planar5_nmp has no table \[servo\]"),
        (
            f"[servo]\n{PLAIN}\nnotch = [{{ frequency_hz = 60, zero_damping = 0.0 }}]\n",
            "has zeros without damping: its inverse is unstable",
        ),
    ],
)
def test_servos_that_c_does_not_have(tmp_path: Path, table: str, message: str) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(Path(flexgen.read("planar5_nmp").file).read_text() + "\n" + table)
    with pytest.raises(ArgumentError, match=message):
        flexgen.generate(file, tmp_path / "library", parts=["position"])


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"servo": {"speed_gain": [-1.0, 1.0]}}, "out of range"),
        ({"servo": {"integral_gain": [-1.0, 1.0]}}, "out of range"),
        ({"servo": {"position_gain": [float("nan"), 1.0]}}, "out of range"),
        ({"servo": {"speed_feedforward": 2.5}}, "out of range"),
        (
            {"servo": {"position_gain": [1.0]}},
            r"servo position_gain: given shape \(1,\), expected \(2\)",
        ),
        ({"servo": {"gain": 1.0}}, "servo: given 'gain', expected one of position_gain"),
        ({"servo": "ppi"}, "servo: given 'ppi', expected True or a mapping"),
        (
            {"servo": {"sample_time": 1e-3}},
            "period: given samples of the results 0.0005 s apart, expected 0.001 s",
        ),
        ({"servo": True, "hold": "linear"}, "hold: given 'linear' .* expected its own"),
        ({"servo": {"delay": 5 * H}}, "out of range"),
    ],
)
def test_servos_that_do_not_fit(robot: Any, more: dict[str, Any], message: str) -> None:
    model, library = robot
    move, path = samples_of(model, H)
    with pytest.raises(ArgumentError, match=message):
        library.invert(*path, period=H, q_start=move.q_start, n_pre=400, n_post=100, **more)


@pytest.mark.slow
def test_streams_in_motion_and_libraries_without_positions_take_no_servo(
    robot: Any, tmp_path: Path
) -> None:
    model, library = robot
    move, (y, dy, ddy) = samples_of(model, PERIOD)
    given: dict[str, Any] = {
        "period": PERIOD,
        "intervals": 20,
        "samples_per_interval": EACH,
        "servo": True,
    }
    with pytest.raises(ArgumentError, match="given a stream in motion, expected one at rest"):
        library.stream(y[:36], move.q_start, dy=dy[:36], ddy=ddy[:36], **given)
    plain = flexgen.load(flexgen.generate("elbow", tmp_path / "elbow").directory)
    with pytest.raises(
        ArgumentError, match=r"servo: given to a library without positions, .*parts=\['position'\]"
    ):
        plain.stream(np.zeros(2), np.zeros(2), **given)


def test_other_libraries_have_no_trace_of_it() -> None:
    for name, text in clib_files.read_clib().items():
        words = ("POSITION", "servo", "command_")
        assert name in ("servo.h", "position_samples.c") or not any(
            word in clib_files.render(text, "arm") for word in words
        ), name
    assert "give_commands" in clib_files.render(
        clib_files.read_clib()["whole_path.h"], "arm", parts=["POSITION"]
    )


# --- samples for an interface --------------------------------------------------------------------


@pytest.mark.parametrize("interpolation", ["hold", "linear", "cubic"])
@pytest.mark.parametrize("period", [H, 4e-3, 7.5e-3])
def test_samples_for_an_interface_are_those_of_python(
    robot: Any, interpolation: Any, period: float
) -> None:
    """By the sparse solver of SciPy and a basis that a test compares with its interpolations; the
    last is not whole.
    """
    model, library = robot
    found = inverted(model, library)
    positions = library.invert.positions(found, period=period, interpolation=interpolation)
    edges = found.t[0] + period * np.arange(len(positions))
    assert edges[-1] <= found.t[-1] + 1e-9 < edges[-1] + period
    B = basis(found.t, edges, interpolation)
    np.testing.assert_allclose(positions, fit_samples(B, found.command_g), rtol=0, atol=1e-9)
    off = np.abs(B @ positions - found.command_g).max()
    least = np.abs(
        B @ (positions + 1e-4 * np.sin(np.arange(len(positions)))[:, None]) - found.command_g
    ).max()
    assert off < least


def error_of_table(
    model: flexgen.RobotModel, library: Library, gains: Any = GAINS, late: float = 0.0
) -> float:
    """Largest distance [m] of the tool in MuJoCo, whose servo interpolates positions every 4 ms by
    straight lines.
    """
    move, path = samples_of(model, H)
    given = {"period": H, "q_start": move.q_start, "n_pre": 400, "samples_per_interval": 10}
    found = library.invert(*path, **given, n_post=6000, servo=True)
    rows = library.invert.positions(found, period=4e-3) @ model.eta.T
    times = found.t[0] + late + 4e-3 * np.arange(len(rows))
    commands = np.stack([np.interp(found.t, times, x) for x in rows.T], axis=1)
    until = found.t <= move.duration + 0.3
    cut = {name: getattr(found, name)[until] for name in ("t", "tau_m", "q_m", "q_a")}
    return error_in_mujoco(model, SimpleNamespace(**cut, command_m=commands[until]), gains=gains)


def test_mujoco_with_a_table_of_c_follows_the_path(robot: Any) -> None:
    model, library = robot
    assert error_of_table(model, library) < 2e-6
    assert error_of_table(model, library, late=H) > 1e-5


def error_of_windows(
    model: flexgen.RobotModel, library: Library, sides: int, gains: Any = GAINS, off: int = 0
) -> float:
    """Largest distance [m] of the tool in MuJoCo with the positions of a stream: each is in the
    middle of a window of ``sides`` positions on either side.
    """
    found = streamed(model, library)
    each = round(4e-3 / H)
    rest = np.tile(found.command_g[:1], (sides * each, 1))
    commands = np.vstack([rest, found.command_g])
    count = (len(commands) - 1) // each - 2 * sides
    windows = (commands[j * each : (j + 2 * sides) * each + 1] for j in range(count))
    rows = (
        np.array([library.invert.positions(x, period=4e-3)[sides + off] for x in windows])
        @ model.eta.T
    )
    n = (count - 1) * each
    sent = np.stack(
        [np.interp(found.t[:n], found.t[0] + 4e-3 * np.arange(count), x) for x in rows.T], axis=1
    )
    cut = {name: getattr(found, name)[:n] for name in ("t", "tau_m", "q_m", "q_a")}
    return error_in_mujoco(model, SimpleNamespace(**cut, command_m=sent), gains=gains)


@pytest.mark.slow
def test_mujoco_with_windows_of_a_stream_follows_the_path(robot: Any) -> None:
    model, library = robot
    assert error_of_windows(model, library, 8) < 2e-8
    assert 2e-8 < error_of_windows(model, library, 4) < 1e-7
    assert error_of_windows(model, library, 8, off=1) > 1e-5


def test_wrong_interfaces(robot: Any) -> None:
    model, library = robot
    found = inverted(model, library)
    for given, message in (
        ({"period": 1.1e-3}, "expected a multiple of 0.0005 s"),
        ({"period": 1e-4}, "expected a multiple of 0.0005 s"),
        (
            {"period": 4e-3, "interpolation": "spline"},
            "given the interpolation 'spline', expected hold, linear, cubic",
        ),
    ):
        with pytest.raises(ArgumentError, match=message):
            library.invert.positions(found, **given)
    with pytest.raises(ArgumentError, match="without commands, expected one with servo=True"):
        library.invert.positions(replace(found, command_g=None), period=4e-3)
    for commands in (found.command_g[:1], found.command_g[:, :1], found.command_g[0]):
        with pytest.raises(ArgumentError, match=r"given commands of shape .*, expected \(n, 2\)"):
            library.invert.positions(commands, period=4e-3)
