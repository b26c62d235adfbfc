"""Quirks of logs of commands, poses and trajectories: the right numbers, or the reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from logs import MODEL, Arm, write_csv

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.spec import units

TRACKER = """
[[sensor]]
name = "m0"
type = "tracker"
unit = "m"
"""
CLOSE = 1e-5  # of the range
SERVO_REFUSED = {
    "unequal steps": "given commands at unequal steps of 10 to 12 ms, expected the equal st",
    "rpm": "column 'q1_command_rpm': given 'rpm', a speed of rotation, expected an angle",
    "labels": "given no column of q2_command, expected one, q2_command_rad or q2_command_deg",
    "no header": "given numbers in the first line, expected the names of the columns",
    "no unit": "given no column of q1_command, expected one, .* 'q1_command' states no unit",
}
SERVO_QUIRKS = (
    "as it is", "jitter of 20 us", "stamps that are late", "two rates", "degrees", "ms and rev",
    "gap", "rest", "order", "names by option", *SERVO_REFUSED,
)  # fmt: skip


def servo_log(quirk: str, folder: Path) -> tuple[Path, list[str] | None, Arm]:
    """A log of commands and of angles 20 ms later; the names of its columns, if it has none."""
    rng = np.random.default_rng(2)
    arm = Arm(rest=2.0)
    t = 8e-3 * np.arange(1500)
    if quirk in ("jitter of 20 us", "two rates"):
        t = 2e-3 * np.arange(6000)
    if quirk == "unequal steps":
        t = np.cumsum(rng.choice([0.010, 0.012], size=1100))
    values = np.column_stack([t, arm.joints(t), arm.joints(t - 0.02)])
    if quirk == "jitter of 20 us":
        values[:, 0] += rng.uniform(-6e-5, 6e-5, len(t))
    if quirk == "stamps that are late":
        values[:, 0] += rng.normal(size=len(t)) * 1e-3
    if quirk == "two rates":
        values[np.arange(len(t)) % 4 != 0, 1:3] = np.nan
    if quirk == "gap":
        values = np.delete(values, slice(1200, 1300), axis=0)
    if quirk == "rest":
        values[:, 3:] = 2e-5 * np.round(values[:, 3:] / 2e-5 + 0.3 * rng.normal(size=(len(t), 2)))
    time, angle = {"degrees": ("s", "deg"), "ms and rev": ("ms", "rev")}.get(quirk, ("s", "rad"))
    angle = {"rpm": "rpm"}.get(quirk, angle)
    values[:, 0] /= units.FACTORS["s"][time]
    values[:, 1:] /= units.FACTORS["rad"].get(angle, 1.0)
    second = "q3" if quirk == "labels" else "q2"
    words = ["q1_command", f"{second}_command", "q1", second]
    names = [f"time_{time}", *(w if quirk == "no unit" else f"{w}_{angle}" for w in words)]
    order = [4, 2, 0, 3, 1] if quirk in ("order", "rpm", "names by option") else range(5)
    file = write_csv(folder / "log.csv", {names[k]: values[:, k] for k in order}, 15)
    if quirk in ("no header", "names by option"):
        file.write_text(file.read_text().partition("\n")[2])
    return file, [names[k] for k in order] if quirk == "names by option" else None, arm


def servo_deviation(folder: Path, quirk: str) -> float:
    """Largest deviation of commands and angles from the truth, over their range."""
    file, names, arm = servo_log(quirk, folder)
    found = flexgen.ServoRecord.read(file, flexgen.read(folder / "pl.toml"), names)
    truth = np.hstack([arm.joints(found.time), arm.joints(found.time - 0.02)])
    away = np.abs(np.hstack([found.command, found.angle]) - truth)
    if quirk == "rest":
        away[:, 2:] = np.maximum(away[:, 2:] - 4e-5, 0.0)
    return float((away / np.ptp(truth, axis=0)).max())


@pytest.mark.parametrize("quirk", SERVO_QUIRKS)
def test_logs_of_a_servo_are_read_or_refused(quirk: str, tmp_path: Path) -> None:
    (tmp_path / "pl.toml").write_text(MODEL)
    if quirk in SERVO_REFUSED:
        with pytest.raises(ArgumentError, match=SERVO_REFUSED[quirk]):
            servo_deviation(tmp_path, quirk)
        return
    assert servo_deviation(tmp_path, quirk) < (1e-3 if "late" in quirk else CLOSE)
    file, names, _ = servo_log(quirk, tmp_path)
    found = flexgen.ServoRecord.read(file, flexgen.read(tmp_path / "pl.toml"), names)
    if quirk == "gap":
        assert found.time[-1] == pytest.approx(9.592) and "before its first gap" in found.notes[-1]
    if quirk == "two rates":
        assert found.period == pytest.approx(8e-3)


def test_a_planted_factor_is_seen_in_logs_of_a_servo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pl.toml").write_text(MODEL)
    servo_log("degrees", tmp_path)
    assert servo_deviation(tmp_path, "degrees") < CLOSE
    kept = units.FACTORS["rad"]["deg"]
    file, _, arm = servo_log("degrees", tmp_path)
    monkeypatch.setitem(units.FACTORS["rad"], "deg", 1.01 * kept)
    found = flexgen.ServoRecord.read(file, flexgen.read(tmp_path / "pl.toml"))
    assert np.abs(found.command - arm.joints(found.time)).max() > 100 * CLOSE


def test_static_poses_have_units_and_labels(tmp_path: Path) -> None:
    """Columns in any order and unit; other units and labels are refused with the column."""
    (tmp_path / "pl.toml").write_text(MODEL + TRACKER)
    robot = flexgen.read(tmp_path / "pl.toml")
    rng = np.random.default_rng(1)
    q = rng.uniform(-1, 1, (9, 2))
    p = rng.uniform(-1, 1, (9, 3))
    columns = {
        "m0_z_mm": 1e3 * p[:, 2],
        "q2 [deg]": np.degrees(q[:, 1]),
        "note": np.arange(9.0),
        "m0_x_m": p[:, 0],
        "m0_y (um)": 1e6 * p[:, 1],
        "q1_mrad": 1e3 * q[:, 0],
    }
    found = flexgen.StaticPoses.read(write_csv(tmp_path / "a.csv", columns, 15), robot)
    assert found.commands == pytest.approx(q, abs=1e-12)
    assert found.positions[:, 0] == pytest.approx(p, abs=1e-12)
    for old, new, words in (
        ("q1_mrad", "q1_gon", "column 'q1_gon': given 'gon', an unknown unit, expected an angle"),
        ("q1_mrad", "q1_mm", "column 'q1_mm': given 'mm', a length, expected an angle"),
        (
            "q1_mrad",
            "q1",
            "given no column of q1, expected one, .*: the column 'q1' states no unit",
        ),
        ("q1_mrad", "q3_mrad", "given no column of q1, expected one, q1_rad or q1_deg"),
        ("m0_x_m", "m1_x_m", "given no column of m0_x, expected one, m0_x_m or m0_x_mm"),
        ("note", "m0_z_m", "given two columns of m0_z, expected one"),
    ):
        given = {name.replace(old, new): x for name, x in columns.items()}
        with pytest.raises(ArgumentError, match=rf"a\.csv:1: {words}"):
            flexgen.StaticPoses.read(write_csv(tmp_path / "a.csv", given), robot)
    file = tmp_path / "a.csv"
    file.write_text(file.read_text().partition("\n")[2])
    with pytest.raises(ArgumentError, match=r"a\.csv:1: given numbers in the first line"):
        flexgen.StaticPoses.read(file, robot)


@pytest.fixture
def solved() -> flexgen.Trajectory:
    return flexgen.solve("elbow", verify=False).trajectory


def renamed(solved: flexgen.Trajectory, changes: dict[str, tuple[str, float]]) -> list[str]:
    """The lines of a CSV file with other units: beginning of a name -> unit and factor."""
    lines = Path(solved.save("motion.csv")).read_text().splitlines()
    header = lines[1].split(",")
    rows = [line.split(",") for line in lines[2:-1]]
    for k, name in enumerate(header):
        for start, (unit, factor) in changes.items():
            if name.startswith(start):
                header[k] = f"{name.partition(' ')[0]} {unit}"
                for row in rows:
                    row[k] = repr(float(row[k]) / factor)
    order = [0, *range(len(header) - 1, 0, -1)]  # channels and columns in reverse
    table = [",".join(row[k] for k in order) for row in (header, *rows)]
    return [lines[0], *table, lines[-1]]


def test_trajectories_are_simulated_in_any_unit_and_order(
    solved: flexgen.Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    usual = flexgen.simulate("elbow", solved).tool_error_max_m
    changes = {
        "time": ("ms", 1e-3),
        "q_a": ("deg", np.pi / 180),
        "q_m": ("rev", 2 * np.pi),
        "tau_m": ("kN m", 1e3),
        "y_ref": ("mm", 1e-3),
    }
    Path("other.csv").write_text("\n".join(renamed(solved, changes)) + "\n")
    found = flexgen.simulate("elbow", "other.csv").tool_error_max_m
    assert found == pytest.approx(usual, abs=1e-10)
    for channel, unit, words in (
        ("tau_m", "A", "tau_m, column m2: given a current in A, expected a torque"),
        ("q_m", "rpm", "q_m, column m2: given 'rpm', a speed of rotation, expected an angle"),
        ("y_ref", "inch", "y_ref, column z: given 'inch', an unknown unit, expected a length"),
    ):
        Path("other.csv").write_text("\n".join(renamed(solved, {channel: (unit, 1.0)})) + "\n")
        with pytest.raises(ArgumentError, match=f"trajectory channel {words}"):
            flexgen.simulate("elbow", "other.csv")


def test_sensors_are_computed_in_any_unit_and_order(
    solved: flexgen.Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    joint = {"name": "torque1", "type": "joint_torque", "coordinate": "q1", "unit": "N m"}
    robot = flexgen.read("elbow", overrides={"sensor": [joint]})
    usual = flexgen.sense(robot, solved)["y_s"]
    degree = np.pi / 180
    changes = {"q_a": ("deg", degree), "v_a": ("deg/s", degree), "a_a": ("deg/s^2", degree)}
    Path("other.csv").write_text("\n".join(renamed(solved, changes)) + "\n")
    found = flexgen.sense(robot, flexgen.Trajectory.load("other.csv"))["y_s"]
    assert found == pytest.approx(usual, rel=1e-9, abs=1e-9 * np.abs(usual).max())
    Path("other.csv").write_text("\n".join(renamed(solved, {"v_a": ("rad", 1.0)})) + "\n")
    with pytest.raises(
        ArgumentError, match="motion channel v_a, column q2: given 'rad', an angle"
    ):
        flexgen.sense(robot, flexgen.Trajectory.load("other.csv"))


def test_growth_and_pictures_are_those_of_si_units(
    solved: flexgen.Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The speeds decide on the growth of errors, the angles on the picture."""
    monkeypatch.chdir(tmp_path)
    degree = np.pi / 180
    changes = {"v_a": ("deg/s", degree), "a_a": ("deg/s^2", degree), "v_m": ("rpm", 6 * degree)}
    Path("other.csv").write_text("\n".join(renamed(solved, changes)) + "\n")
    usual, found = (flexgen.simulate("elbow", x).growth for x in (solved, "other.csv"))
    assert found == pytest.approx(usual, rel=1e-6)
    loaded = flexgen.Trajectory.load("other.csv")
    monkeypatch.setitem(units.FACTORS["rad/s"], "deg/s", 20.0 * degree)
    assert flexgen.simulate("elbow", loaded).growth != pytest.approx(usual, rel=1e-3)
    Path("other.csv").write_text("\n".join(renamed(solved, {"q_a": ("rpm", 1.0)})) + "\n")
    with pytest.raises(ArgumentError, match="view channel q_a, column q2: given 'rpm', a speed"):
        flexgen.view(flexgen.Trajectory.load("other.csv"), "a.html", model="elbow")
