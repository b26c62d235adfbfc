"""Logs with the quirks of recorders: each reader gives the right numbers, or refuses with the
reason.

The logs follow from a closed form (`logs.Arm`). A planted wrong factor, a planted order of columns
and a planted interpolation by straight lines are seen.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from logs import CONSTANTS, COUNT, MODEL, QUIRKS, Arm, Log, quirky, write_csv

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.files import record_columns as columns
from flexgen.base.numerics import sampling
from flexgen.base.spec import units
from flexgen.base.spec.ports import Port
from flexgen.identification.records.description import read_description
from flexgen.identification.records.motor_record import read_motor_record

# Largest deviations of the range of each channel: of the spline, (2 f h)^6 of the fastest sine; of
# the filter against aliasing; of late stamps, whose scatter over the root of their number moves
# all times together.
CLOSE = 1e-5
BOUNDS = {"two rates": 2e-4, "repeated angles": 2e-4, "stamps that are late": 2e-3}
# a torque that is written four times, of which three are late
BOUNDS |= {"repeated torques": 0.03}
REFUSED = {
    "rpm": r"given '?\"?rpm|a speed of rotation, expected an angle",
    "currents": r"given a current in A, expected a torque .* constant|constant: given nothing",
    "labels": r"m3",
    "no header": r"given numbers in the first line, expected the names of the columns",
}
FEWER = ("two rates", "repeated angles", "gap")
Found = tuple[np.ndarray, np.ndarray, np.ndarray]


def columns_of(log: Log, style: str) -> list[str]:
    """Names of the columns: of trajectories, or words with a unit behind."""
    time, angle, torque = log.units
    torques = [torque, torque]
    if torque == "A" and log.constants:
        torques = [f"A ({constant} N m/A)" for constant in CONSTANTS]
    if style == "label":
        names = [f"time {time}", *(f"q_m[{m}] {angle}" for m in log.motors)]
        return names + [f"tau_m[{m}] {u}" for m, u in zip(log.motors, torques, strict=True)]
    names = [f"t {time}", f"q_m[{log.motors[0]}] {angle}", f"q_m[{log.motors[1]}] {angle}"]
    return names + [f"{m} {u}" for m, u in zip(log.motors, torques, strict=True)]


def written(folder: Path, log: Log, names: list[str]) -> Path:
    """The CSV file of a log."""
    file = write_csv(
        folder / "log.csv", {names[k]: log.values[:, k] for k in log.order}, digits=15
    )
    if not log.header:
        file.write_text(file.read_text().partition("\n")[2])
    return file


def by_table(style: str) -> Callable[[Path, Log, bool], Found]:
    """The reader of `identify_load` and `identify_gears`, of a CSV file."""

    def read(folder: Path, log: Log, named: bool) -> Found:
        names = columns_of(log, style)
        file = written(folder, log, names)
        given = [names[k] for k in log.order] if named else None
        data = read_motor_record(flexgen.read(folder / "pl.toml"), file, given).trajectory
        return data.time, data["q_m"], data["tau_m"]

    return read


def by_trajectory(folder: Path, log: Log, named: bool) -> Found:
    """The reader of a trajectory in memory, whose channels have one rate and labels."""
    if not log.header or np.isnan(log.values).any():
        pytest.skip("a trajectory has labels, and one rate")
    order = [k - 3 for k in log.order if k >= 3]  # of the torques
    labels = {"q_m": log.motors, "tau_m": tuple(log.motors[k] for k in order)}
    texts = columns_of(log, "label")
    stated = {k: texts[k].partition("] ")[2] for k in range(1, 5)}
    channel_units = {
        "q_m": (stated[1], stated[2]),
        "tau_m": tuple(stated[3 + k] for k in order),
    }
    channels = {"q_m": log.values[:, 1:3], "tau_m": log.values[:, [3 + k for k in order]]}
    ports = {
        name: Port(name, (2,), " or ".join(dict.fromkeys(channel_units[name])), "")
        for name in channels
    }
    time = log.values[:, 0] * units.FACTORS["s"][log.units[0]]
    if not (np.diff(time) > 0).all():
        pytest.skip("the times of a trajectory increase")
    given = flexgen.Trajectory(time, channels, ports, labels, units=channel_units)
    data = read_motor_record(flexgen.read(folder / "pl.toml"), given).trajectory
    return data.time, data["q_m"], data["tau_m"]


def described(folder: Path, log: Log, named: bool, more: str = "") -> Path:
    """The description of a log, with a unit in each table."""
    names = [f"c{k}" for k in range(5)]
    file = written(folder, log, names)
    time, angle, torque = log.units
    text = f'model = "pl.toml"\n{more}'
    if named:
        text += f"columns = {[names[k] for k in log.order]}\n"
    text += f'[time]\nname = "c0"\nunit = "{time}"\n'
    for j, motor in enumerate(log.motors):
        constant = f"constant = {CONSTANTS[j]}\n" if torque == "A" and log.constants else ""
        text += (
            f'[[angle]]\nmotor = "{motor}"\nname = "c{j + 1}"\nunit = "{angle}"\nside = "motor"\n'
        )
        text += f'[[torque]]\nmotor = "{motor}"\nname = "c{j + 3}"\nunit = "{torque}"\n'
        text += f'{constant}side = "motor"\n'
    (folder / "log.toml").write_text(text + f'[[recording]]\nfile = "{file.name}"\n')
    return folder / "log.toml"


def by_description(folder: Path, log: Log, named: bool) -> Found:
    """The reader of `identify --rigid`, `--segments`, `frf` and `refine`."""
    runs = [run for _, run in read_description(described(folder, log, named)).recordings]
    together = [[getattr(run, name) for run in runs] for name in ("t", "q_m", "tau_m")]
    return np.concatenate(together[0]), np.vstack(together[1]), np.vstack(together[2])


def by_described_record(folder: Path, log: Log, named: bool) -> Found:
    """The reader of `identify_load` and `identify_gears`, of a described recording."""
    file = described(folder, log, named)
    data = read_motor_record(flexgen.read(folder / "pl.toml"), file).trajectory
    return data.time, data["q_m"], data["tau_m"]


READERS = {
    "labels": by_table("label"),
    "words": by_table("word"),
    "trajectory": by_trajectory,
    "description": by_description,
    "described record": by_described_record,
}


def deviation(arm: Arm, found: Found, quirk: str) -> float:
    """Largest deviation from the truth, over the range of each channel."""
    time, q_m, tau_m = found
    truth = np.hstack([arm.motors(time), arm.torques(time)])
    away = np.abs(np.hstack([q_m, tau_m]) - truth)
    if quirk == "rest":  # a count and its noise are in the log
        away[:, :2] = np.maximum(away[:, :2] - 2 * COUNT, 0.0)
    return float((away / np.ptp(truth, axis=0)).max())


def arm_of(quirk: str) -> Arm:
    return Arm(rest=3.0 if quirk == "rest" else 0.0)


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("quirk", QUIRKS)
def test_logs_are_read_or_refused(quirk: str, reader: str, tmp_path: Path) -> None:
    (tmp_path / "pl.toml").write_text(MODEL)
    arm = arm_of(quirk)
    log = quirky(quirk, arm, 3.0 if "jitter" in quirk else 8.0)
    named = quirk == "names by option"
    if quirk in REFUSED:
        with pytest.raises(flexgen.FlexgenError, match=REFUSED[quirk]):
            READERS[reader](tmp_path, log, named)
        return
    found = READERS[reader](tmp_path, log, named)
    steps = np.diff(found[0])
    assert quirk == "gap" or np.ptp(steps) < 1e-6  # equal steps
    assert len(found[0]) > 0.5 * len(log.values) or quirk in FEWER
    assert deviation(arm, found, quirk) < BOUNDS.get(quirk, CLOSE)


@pytest.mark.parametrize(
    ("quirk", "reader", "place", "key", "value"),
    [
        ("degrees", "labels", units.FACTORS["rad"], "deg", 1.0),
        ("other units", "description", units.FACTORS["N m"], "N cm", 1.0),
        ("unequal steps", "labels", vars(sampling), "DEGREE", 1),
        ("unequal steps", "description", vars(sampling), "DEGREE", 1),
        ("two rates", "words", vars(sampling), "PASS", 0.02),
    ],
)
def test_planted_errors_are_seen(
    quirk: str, reader: str, place: dict, key: str, value: float, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """A wrong factor, straight lines between samples, a filter that takes away the motion."""
    (tmp_path / "pl.toml").write_text(MODEL)
    monkeypatch.setitem(place, key, value)
    if key == "PASS":
        monkeypatch.setattr(sampling, "STOP", 0.03)
    log = quirky(quirk, Arm(), 8.0)
    found = READERS[reader](tmp_path, log, False)
    assert deviation(Arm(), found, quirk) > 2 * BOUNDS.get(quirk, CLOSE)


def test_a_column_of_another_name_is_not_taken_by_its_place(tmp_path: Path) -> None:
    """The torques in the order m2, m1: each is that of its motor; a column twice is refused."""
    (tmp_path / "pl.toml").write_text(MODEL)
    robot = flexgen.read(tmp_path / "pl.toml")
    arm = Arm()
    t = 8e-3 * np.arange(300)
    q = arm.joints(t)
    tau = arm.torques(t)
    names = {"timestamp s": t, "m2 N m": tau[:, 1], "temperature degC": 20 + t, "m1_Nm": tau[:, 0]}
    file = write_csv(
        tmp_path / "a.csv", names | {"q2_deg": np.degrees(q[:, 1]), "q1 [rad]": q[:, 0]}
    )
    found = read_motor_record(robot, file).trajectory
    assert found["tau_m"] == pytest.approx(tau, abs=1e-8)
    assert found["q_m"] == pytest.approx(q * [100.0, 80.0], abs=1e-6)
    write_csv(file, names | {"q2_deg": q[:, 1], "q1 rad": q[:, 0], "q_m[m1] rad": q[:, 0]})
    with pytest.raises(ArgumentError, match="given angles of motors and of joints"):
        read_motor_record(robot, file)
    write_csv(file, names | {"tau_m[m2] N m": tau[:, 1]})
    with pytest.raises(
        ArgumentError, match=r"'m2 N m' and 'tau_m\[m2\] N m', expected one of tau_"
    ):
        read_motor_record(robot, file)
    write_csv(file, names | {"q2_deg": q[:, 1]})
    with pytest.raises(
        ArgumentError, match=r"a\.csv: given the columns .*, expected also q\[q1\] rad"
    ):
        read_motor_record(robot, file)


def test_columns_that_are_left_out_have_no_names(tmp_path: Path) -> None:
    """Two columns of text without a header, by the key of a description and by the option."""
    (tmp_path / "pl.toml").write_text(MODEL)
    log = quirky("no header", Arm(), 4.0)
    file = described(tmp_path, log, True)
    lines = (tmp_path / "log.csv").read_text().splitlines()
    (tmp_path / "log.csv").write_text("".join(f"0,{line},automatic\n" for line in lines))
    with pytest.raises(flexgen.FlexgenError, match="given 7 cells, expected 5"):
        read_description(file)
    text = file.read_text()
    file.write_text(text.replace("columns = [", "columns = ['-', ").replace("'c4']", "'c4', '-']"))
    assert len(read_description(file).recordings[0][1].t) == len(log.values)
    names = ["-", *columns_of(log, "label"), "-"]
    found = read_motor_record(flexgen.read(tmp_path / "pl.toml"), tmp_path / "log.csv", names)
    assert len(found.trajectory.time) == len(log.values)
    file.write_text(text.replace("'c3', 'c4'", "'c3', 'c3'"))
    with pytest.raises(
        flexgen.FlexgenError, match=r"columns: given .*, expected a list of different"
    ):
        read_description(file)


def test_positions_and_torques_in_two_files(tmp_path: Path) -> None:
    """1 kHz and 250 Hz, with clocks of their own; the same array twice is refused."""
    (tmp_path / "pl.toml").write_text(MODEL)
    arm = Arm()
    fast = 1e-3 * np.arange(6000)
    slow = 5e-4 + 4e-3 * np.arange(1490)
    q = arm.motors(fast)
    tau = arm.torques(slow)
    write_csv(tmp_path / "q.csv", {"t": fast, "a": q[:, 0], "b": q[:, 1]}, 15)
    write_csv(tmp_path / "tau.csv", {"t": slow, "c": tau[:, 0], "d": tau[:, 1]}, 15)
    text = 'model = "pl.toml"\n[time]\nname = "t"\nunit = "s"\n'
    for j, (angle, torque) in enumerate(("ac", "bd")):
        text += f'[[angle]]\nmotor = "m{j + 1}"\nname = "{angle}"\nunit = "rad"\nside = "motor"\n'
        text += (
            f'[[torque]]\nmotor = "m{j + 1}"\nname = "{torque}"\nunit = "N m"\nside = "motor"\n'
        )
    file = tmp_path / "two.toml"
    file.write_text(text + '[[recording]]\nfiles = ["q.csv", "tau.csv"]\n')
    found = read_description(file)
    (run,) = [run for _, run in found.recordings]
    assert deviation(arm, (run.t, run.q_m, run.tau_m), "") < BOUNDS["two rates"]
    assert run.sample_s == pytest.approx(4e-3) and "250 Hz, 1000 Hz" in found.notes[0]
    write_csv(tmp_path / "tau.csv", {"t": slow, "a": slow, "c": tau[:, 0], "d": tau[:, 1]})
    with pytest.raises(ArgumentError, match="given the channel 'a' in several files"):
        read_description(file)


def test_names_of_columns_state_their_unit() -> None:
    for text, parts in (
        ("q_m[m1] rad", ("q_m", "m1", "rad")),
        ("q1 [deg]", ("q1", None, "deg")),
        ("q1 (deg)", ("q1", None, "deg")),
        ("q1_command_deg", ("q1_command", None, "deg")),
        ("m0_x_mm", ("m0_x", None, "mm")),
        ("time_ms", ("time", None, "ms")),
        ("m1 A (0.12 N m/A)", ("m1", None, "A (0.12 N m/A)")),
        ("tau_m[m1] A (0.12 N m/A)", ("tau_m", "m1", "A (0.12 N m/A)")),
        ("q_m[m1]", ("q_m", "m1", "")),
        ("q1", ("q1", None, "")),
    ):
        found = columns.column_of(text)
        assert (found.name, found.label, found.unit) == parts
    for unit, si, factor in (
        ("Nm", "N m", 1.0), ("N·m", "N m", 1.0), ("N*cm", "N m", 1e-2), ("°", "rad", np.pi / 180),
        ("µs", "s", 1e-6), ("rpm", "rad/s", np.pi / 30), ("mA (2 N m/A)", "N m", 2e-3),
    ):  # fmt: skip
        assert units.conversion("", unit, si) == pytest.approx(factor, rel=1e-12)
    for unit, words in (
        ("furlong", "'furlong', an unknown unit, expected a length in m, mm"),
        ("rad", "'rad', an angle, expected a length"),
        ("A", "'A', a current, expected a length"),
    ):
        with pytest.raises(ArgumentError, match=words):
            units.conversion("x", unit, "m")
