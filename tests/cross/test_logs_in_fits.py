"""Logs with the quirks of recorders in `refine`, `calibrate` and `identify-servo`: the right
numbers, or the reason.

Numbers are those of the robots that made the logs. Poses are those of a closed form, which shares
no code with flexgen. A planted unit is seen.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from logs import GRAVITY, MODEL, write_csv
from toolchain import needs_compiler

import flexgen
from flexgen.base.spec import units
from flexgen.cli.main import main
from flexgen.identification.records.experiment_file import read_experiment
from flexgen.identification.records.recording_writer import RecordingWriter

TRACKER = """
[[sensor]]
name = "p"
type = "tracker"
unit = "m"
"""
ZEROS = np.array([0.012, -0.02])
SURE = 4.0  # standard deviations
POSE_NAMES = ["q1 rad", "q2 rad", "p_x m", "p_y m", "p_z m"]
POSES_REFUSED = {
    "rpm": "column 'q1 rpm': given 'rpm', a speed of rotation, expected an angle",
    "labels": "given no column of q2, expected one, q2_rad or q2_deg",
    "other tracker": "given no column of p_x, expected one, p_x_m or p_x_mm",
    "no header": "given numbers in the first line, expected the names of the columns",
    "no unit": "given no column of q1, expected one, .* 'q1' states no unit",
    "exchanged": "probably exchanged columns of q1 and q2",
    "degrees as rad": "probably joints in degrees, read as radians",
    "equal poses": "given 30 with 1 different commands, expected at least 5",
    "comma": "given 10 cells, expected 5, as line 1",
}
POSES = (
    "as it is", "degrees", "other units", "order", "names by option", "gap", "unseen",
    "other columns", "comments", *POSES_REFUSED,
)  # fmt: skip


def tips(commands: np.ndarray) -> np.ndarray:
    """The tool (n, 3) of the arm of `MODEL` at rest, with `ZEROS`: gears bend under gravity."""
    bent = np.zeros_like(commands)
    for _ in range(60):
        s = (commands + ZEROS + bent)[:, 0]
        r = (commands + ZEROS + bent).sum(axis=1)
        second = 12.0 * GRAVITY * 0.16 * np.sin(r)
        first = second + 12.0 * GRAVITY * 0.5 * np.sin(s) + 20.0 * GRAVITY * 0.22 * np.sin(s)
        bent = np.stack([first / 1.2e5, second / 1.5e4], axis=1)
    x = 0.5 * np.sin(s) + 0.4 * np.sin(r)
    return np.stack([x, 0.0 * x, 0.5 * np.cos(s) + 0.4 * np.cos(r)], axis=1)


def pose_log(quirk: str, folder: Path) -> tuple[Path, list[str] | None]:
    """A file of poses; the names of its columns, if it has none."""
    rng = np.random.default_rng(4)
    q = rng.uniform(-1.0, 1.0, (30, 2))
    q = np.tile(q[:1], (30, 1)) if quirk == "equal poses" else q
    values = np.hstack([q, tips(q) + 2e-5 * rng.normal(size=(30, 3))])
    names = list(POSE_NAMES)
    if quirk in ("degrees", "degrees as rad"):
        values[:, :2] = np.degrees(values[:, :2])
        names[:2] = ["q1_deg", "q2 [deg]"] if quirk == "degrees" else names[:2]
    if quirk == "other units":
        values *= [1e3, 0.5 / np.pi, 1e3, 1e2, 1e6]
        names = ["q1 mrad", "q2 rev", "p_x_mm", "p_y (cm)", "p_z um"]
    if quirk == "unseen":
        values[[3, 8], 2:] = np.nan
    if quirk == "exchanged":
        names[:2] = names[1::-1]
    changed = {"rpm": ("q1 rad", "q1 rpm"), "labels": ("q2", "q3"), "no unit": ("q1 rad", "q1")}
    old, new = changed.get(quirk, ("p_", "r_" if quirk == "other tracker" else "p_"))
    names = [name.replace(old, new) for name in names]
    order = [4, 1, 3, 0, 2] if quirk in ("order", "names by option") else range(5)
    columns = {names[k]: values[:, k] for k in order}
    if quirk == "other columns":
        columns = {"time": np.arange(30.0)} | columns | {"tool temperature": 20.0 + values[:, 0]}
    file = write_csv(folder / "poses.csv", columns, 15)
    lines = file.read_text().splitlines()
    if quirk in ("no header", "names by option"):
        lines = lines[1:]
    if quirk == "gap":
        lines = [*lines[:9], "", ",,,,", *lines[9:]]
    if quirk == "comments":
        lines = ["# made by hand", *lines]
    if quirk == "comma":
        lines[3] = lines[3].replace(".", ",")
    file.write_text("\n".join(lines) + "\n")
    return file, [names[k] for k in order] if quirk == "names by option" else None


@pytest.mark.parametrize("quirk", POSES)
def test_poses_give_the_zeros_or_the_reason(
    quirk: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "pl.toml").write_text(MODEL + TRACKER)
    file, names = pose_log(quirk, tmp_path)
    priors = flexgen.Priors(tracker=1e-5)
    given = {"free": ["zeros"], "priors": priors, "folds": 0, "columns": names}
    if quirk in POSES_REFUSED:
        with pytest.raises(flexgen.FlexgenError, match=POSES_REFUSED[quirk]):
            flexgen.calibrate(tmp_path / "pl.toml", file, **given)
        assert main(["calibrate", str(tmp_path / "pl.toml"), str(file), "--quiet"]) == 1
        assert re.search(POSES_REFUSED[quirk], capsys.readouterr().err)
        return
    found = flexgen.calibrate(tmp_path / "pl.toml", file, **given)
    # the frame of the measurement turns as the first joint does
    assert abs(found.values["q2.zero"] - ZEROS[1]) < SURE * found.sd["q2.zero"]
    assert found.sd["q2.zero"] < 2e-4 and found.determined["q2.zero"]
    assert not found.determined["q1.zero"]


def test_names_of_poses_by_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A column that is left out, and names without unit, which are in SI units."""
    (tmp_path / "pl.toml").write_text(MODEL + TRACKER)
    file, _ = pose_log("names by option", tmp_path)
    lines = file.read_text().splitlines()
    file.write_text("\n".join(f"{k},{line},done" for k, line in enumerate(lines)))
    words = ["calibrate", str(tmp_path / "pl.toml"), str(file), "--free", "zeros", "--folds", "0"]
    words += ["--prior", "tracker=1e-5", "--quiet"]
    assert main([*words, "--columns=-,p_z,q2,p_y,q1,p_x,-"]) == 0
    assert re.search(r"q2\.zero +0 +-0\.0(200|199|2)\d* ", capsys.readouterr().out)
    assert main([*words, "--columns=-,p_z,q2,p_y,q1,p_x"]) == 1
    assert "given 7 cells, expected 6, as the names" in capsys.readouterr().err


def test_a_planted_unit_is_seen_in_the_zeros(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pl.toml").write_text(MODEL + TRACKER)
    file, _ = pose_log("degrees", tmp_path)
    monkeypatch.setitem(units.FACTORS["rad"], "deg", 1.01 * np.pi / 180)
    priors = flexgen.Priors(tracker=1e-5)
    found = flexgen.calibrate(tmp_path / "pl.toml", file, free=["zeros"], priors=priors, folds=0)
    away = abs(found.values["q2.zero"] - ZEROS[1]) / found.sd["q2.zero"]
    assert away > SURE or np.nanmean(found.errors) > 20 * 2e-5


REFINE_REFUSED = {
    "rpm": r"given .rpm.",
    "currents": "constant: given nothing",
    "labels": "m9",
    "no header": "given numbers in the first line, expected the names of the columns",
}
REFINE = (
    "as it is", "jitter", "degrees", "other units", "currents with constants", "order", "gap",
    "names by option", *REFINE_REFUSED,
)  # fmt: skip
STIFFNESS = 6e6  # N m/rad, of the first gear of the robot that was measured; file: 7.5e6


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("raw")
    plan = flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10)
    key = "element.upper.dof.q1.gear.spring.stiffness"
    robot = flexgen.read("elbow", overrides={key: STIFFNESS})
    writer = RecordingWriter(folder, plan, flexgen.read("elbow"))
    flexgen.measure(plan, robot, raw=writer)
    return writer.finish()


def recorded(quirk: str, source: Path, folder: Path) -> Path:
    """The description of the recordings as CSV files with a quirk."""
    text = source.read_text().replace(".npz", ".csv")
    changes = {
        "degrees": [('unit = "rad"', 'unit = "deg"')],
        "rpm": [('unit = "rad"', 'unit = "rpm"')],
        "other units": [
            ('unit = "rad"', 'unit = "mrad"'), ('unit = "N m"', 'unit = "N cm"'),
            ('unit = "s"', 'unit = "ms"'),
        ],
        "currents": [('unit = "N m"', 'unit = "A"')],
        "currents with constants": [('unit = "N m"', 'unit = "A"\nconstant = 0.12')],
        "labels": [('motor = "m2"\nname = "tau', 'motor = "m9"\nname = "tau')],
    }.get(quirk, [])  # fmt: skip
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    factors = {
        "degrees": {"q": 180 / np.pi, "ref": 180 / np.pi},
        "other units": {"q": 1e3, "ref": 1e3, "tau": 1e2, "t": 1e3},
        "currents": {"tau": 1 / 0.12},
        "currents with constants": {"tau": 1 / 0.12},
    }.get(quirk, {})
    rng = np.random.default_rng(3)
    for file in source.parent.glob("*.npz"):
        with np.load(file) as arrays:
            columns = {name: arrays[name] for name in arrays.files}
        if quirk == "jitter":
            columns["t"] = columns["t"] + 2e-5 * rng.uniform(-1, 1, len(columns["t"]))
        columns = {n: x * factors.get(n.partition("_")[0], 1.0) for n, x in columns.items()}
        names = sorted(columns, reverse=quirk in ("order", "names by option"))
        rows = {name: columns[name] for name in names}
        if quirk == "gap":
            rows = {name: np.delete(x, slice(700, 800)) for name, x in rows.items()}
        out = write_csv(folder / f"{file.stem}.csv", rows, 15)
        if quirk in ("no header", "names by option"):
            out.write_text(out.read_text().partition("\n")[2])
    if quirk == "names by option":
        text = text.replace("\n[time]", f"columns = {names}\n\n[time]", 1)
    (folder / "log.toml").write_text(text)
    return folder / "log.toml"


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("quirk", REFINE)
def test_recordings_are_refined_or_refused(
    quirk: str, recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The stiffness of the robot that was measured, by `refine`."""
    file = recorded(quirk, recordings, tmp_path)
    if quirk in REFINE_REFUSED:
        with pytest.raises(flexgen.FlexgenError, match=REFINE_REFUSED[quirk]):
            read_experiment(file)
        words = ["identify", "elbow", "missing.npz", "--refine", str(file), "--quiet"]
        assert main(words) == 1
        return
    experiment = read_experiment(file)
    found = flexgen.identify("elbow", flexgen.frf(experiment), starts=1, progress=False)
    fine = flexgen.refine(found, experiment, progress=False)
    assert fine.values["q1.stiffness"] == pytest.approx(STIFFNESS, rel=2e-3)


SERVO_REFUSED = {
    "unequal steps": "given commands at unequal steps",
    "rpm": "column 'q1_command_rpm': given 'rpm', a speed of rotation, expected an angle",
    "labels": "given no column of q2_command, expected one, q2_command_rad or q2_command_deg",
    "no header": "given numbers in the first line, expected the names of the columns",
    "no unit": "given no column of q1_command, expected one, .* 'q1_command' states no unit",
}
SERVO = (
    "as it is", "jitter", "degrees", "other units", "order", "names by option", "other columns",
    *SERVO_REFUSED,
)  # fmt: skip


@pytest.fixture(scope="module")
def sent() -> tuple[np.ndarray, flexgen.ServoFit]:
    """Time, commands and angles of a robot whose servo is known, and the servo found from them."""
    run = flexgen.command_positions("elbow").today
    joints = np.linalg.inv(run.model.eta).T
    angles = [run.reference.motion["q_m"] @ joints, run.nominal.measured @ joints]
    values = np.column_stack([run.reference.time, *angles])
    record = flexgen.ServoRecord(values[:, 0], values[:, 1:3], values[:, 3:])
    return values, flexgen.identify_servo("elbow", record, progress=False)


def sent_log(quirk: str, values: np.ndarray, folder: Path) -> tuple[Path, list[str] | None]:
    """The file of a record; the names of its columns, if it has none."""
    rng = np.random.default_rng(6)
    values = values.copy()
    step = values[1, 0] - values[0, 0]
    if quirk == "jitter":
        values[:, 0] += 0.01 * step * rng.uniform(-1.0, 1.0, len(values))
    if quirk == "unequal steps":
        values = np.delete(values, slice(2, None, 7), axis=0)
    time, angle = {"degrees": ("s", "deg"), "other units": ("ms", "mrad")}.get(quirk, ("s", "rad"))
    angle = "rpm" if quirk == "rpm" else angle
    values[:, 0] /= units.FACTORS["s"][time]
    values[:, 1:] /= units.FACTORS["rad"].get(angle, 1.0)
    second = "q3" if quirk == "labels" else "q2"
    words = ["q1_command", f"{second}_command", "q1", second]
    names = [f"time_{time}", *(w if quirk == "no unit" else f"{w}_{angle}" for w in words)]
    order = [4, 2, 0, 3, 1] if quirk in ("order", "names by option") else range(5)
    columns = {names[k]: values[:, k] for k in order}
    if quirk == "other columns":
        columns |= {"temperature degC": 20.0 + values[:, 0]}
    file = write_csv(folder / "log.csv", columns, 15)
    if quirk in ("no header", "names by option"):
        file.write_text(file.read_text().partition("\n")[2])
    return file, [names[k] for k in order] if quirk == "names by option" else None


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("quirk", SERVO)
def test_servos_are_identified_or_refused(
    quirk: str, sent: tuple[np.ndarray, flexgen.ServoFit], tmp_path: Path
) -> None:
    """The gains of the servo that moved the robot, by `identify_servo`."""
    values, usual = sent
    file, names = sent_log(quirk, values, tmp_path)
    if quirk in SERVO_REFUSED:
        with pytest.raises(flexgen.FlexgenError, match=SERVO_REFUSED[quirk]):
            flexgen.identify_servo("elbow", file, columns=names, progress=False)
        assert main(["identify-servo", "elbow", str(file), "--quiet"]) == 1
        return
    found = flexgen.identify_servo("elbow", file, columns=names, progress=False)
    assert usual.explained > 0.999 and found.explained > 0.999
    for gains in ("position_gain", "speed_gain"):
        one, other = (getattr(fit.servo.feedback, gains) for fit in (found, usual))
        assert np.asarray(one) == pytest.approx(np.asarray(other), rel=0.01)


def test_recordings_name_the_variant_of_their_model(tmp_path: Path) -> None:
    """The description named the file alone: it was read as another robot."""
    variant = '\n[variant.heavy]\n[variant.heavy.set]\n"element.fore.body.mass" = 14.0\n'
    (tmp_path / "pl.toml").write_text(MODEL + variant)
    robot = flexgen.read(tmp_path / "pl.toml", "heavy")
    plan = flexgen.excite(robot, poses=[[0.5, -0.3]], period_s=1.0, lines=10)
    file = RecordingWriter(tmp_path / "raw", plan, robot).finish()
    name = re.search(r'model = "(.*)"', file.read_text())
    assert name and flexgen.read(name[1]).elements[1].body.mass == 14.0
