"""Verbs that read records, on logs with the quirks of recorders: numbers within their deviations,
or the reason.

The logs follow from a closed form (`logs.Arm`), which shares no code with flexgen. A planted unit
is seen.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from logs import CONSTANTS, MODEL, QUIRKS, Arm, Log, quirky, write_csv

import flexgen
from flexgen.base.spec import units
from flexgen.cli.main import main
from flexgen.identification.records.experiment_file import read_experiment
from flexgen.identification.rigid.rigid_file import identify_bodies

pytestmark = pytest.mark.slow

LOAD = Arm(load=2.6)
SURE = 4.0  # standard deviations
REFUSED = {
    "rpm": "speed of rotation, expected an angle|unit: given .rpm.",
    "currents": "given a current in A, expected a torque|constant: given nothing",
    "labels": "m3",
    "no header": "given numbers in the first line, expected the names of the columns",
}


def names_of(log: Log) -> list[str]:
    """Names of the columns with labels and units."""
    time, angle, torque = log.units
    torques = [torque, torque]
    if torque == "A" and log.constants:
        torques = [f"A ({constant} N m/A)" for constant in CONSTANTS]
    names = [f"time {time}", *(f"q_m[{m}] {angle}" for m in log.motors)]
    return names + [f"tau_m[{m}] {u}" for m, u in zip(log.motors, torques, strict=True)]


def written(folder: Path, log: Log) -> tuple[Path, list[str]]:
    """The file of a log, and the names of its columns in their order."""
    names = names_of(log)
    file = write_csv(folder / "log.csv", {names[k]: log.values[:, k] for k in log.order}, 12)
    if not log.header:
        file.write_text(file.read_text().partition("\n")[2])
    return file, [names[k] for k in log.order]


def arm_of(quirk: str) -> Arm:
    return Arm(LOAD.load, rest=3.0 if quirk == "rest" else 0.0)


@pytest.mark.parametrize("quirk", QUIRKS)
def test_loads_of_logs(quirk: str, tmp_path: Path) -> None:
    """Mass and center of mass within four standard deviations, or the reason."""
    (tmp_path / "pl.toml").write_text(MODEL)
    file, names = written(tmp_path, quirky(quirk, arm_of(quirk)))
    given = {"columns": names} if quirk == "names by option" else {}
    if quirk in REFUSED:
        with pytest.raises(flexgen.FlexgenError, match=REFUSED[quirk]):
            flexgen.identify_load(tmp_path / "pl.toml", file, **given)
        assert main(["identify-load", str(tmp_path / "pl.toml"), str(file), "--quiet"]) == 1
        return
    load = flexgen.identify_load(tmp_path / "pl.toml", file, **given)
    assert load.mass == pytest.approx(2.6, abs=SURE * load.mass_sd) and load.mass_sd < 0.1
    for axis, truth in ((0, LOAD.x), (2, LOAD.z)):
        assert load.com[axis] == pytest.approx(truth, abs=SURE * load.com_sd[axis])
        assert load.com_sd[axis] < 0.03
    notes = {"gap": "gap of 0.968 s from 3.992 to 4.96 s", "unequal steps": "steps of 10 to 12 ms"}
    assert notes.get(quirk, "") in " ".join(load.notes)


def test_a_planted_unit_is_seen_in_the_load(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pl.toml").write_text(MODEL)
    file, _ = written(tmp_path, quirky("other units", LOAD))
    monkeypatch.setitem(units.FACTORS["N m"], "N cm", 1.02e-2)
    load = flexgen.identify_load(tmp_path / "pl.toml", file)
    assert abs(load.mass - 2.6) > SURE * load.mass_sd


def described(folder: Path, log: Log, named: bool, more: str = "") -> Path:
    """The description of a log."""
    names = [f"c{k}" for k in range(5)]
    file = write_csv(folder / "log.csv", {names[k]: log.values[:, k] for k in log.order}, 12)
    if not log.header:
        file.write_text(file.read_text().partition("\n")[2])
    time, angle, torque = log.units
    text = f'model = "pl.toml"\nhold = "none"\n{more}'
    text += f"columns = {[names[k] for k in log.order]}\n" * named
    text += f'[time]\nname = "c0"\nunit = "{time}"\n'
    for j, motor in enumerate(log.motors):
        constant = f"constant = {CONSTANTS[j]}\n" if torque == "A" and log.constants else ""
        text += (
            f'[[angle]]\nmotor = "{motor}"\nname = "c{j + 1}"\nunit = "{angle}"\nside = "motor"\n'
        )
        text += f'[[torque]]\nmotor = "{motor}"\nname = "c{j + 3}"\nunit = "{torque}"\n'
        text += f'{constant}side = "motor"\n'
    (folder / "log.toml").write_text(text + '[[recording]]\nfile = "log.csv"\n')
    return folder / "log.toml"


@pytest.mark.parametrize("quirk", QUIRKS)
def test_bodies_of_logs(quirk: str, tmp_path: Path) -> None:
    """`identify --rigid`: first moment of the fore arm and the load."""
    (tmp_path / "pl.toml").write_text(MODEL)
    file = described(tmp_path, quirky(quirk, arm_of(quirk)), quirk == "names by option")
    robot = flexgen.read(tmp_path / "pl.toml")
    if quirk in REFUSED:
        with pytest.raises(flexgen.FlexgenError, match=REFUSED[quirk]):
            identify_bodies(robot, file, progress=False)
        words = ["identify", str(tmp_path / "pl.toml"), str(file), "--rigid", "--quiet"]
        assert main(words) == 1
        return
    found = identify_bodies(robot, file, progress=False)
    numbers = found.numbers
    assert found.fit.status.has_deviations, found.fit.status
    assert numbers["fore.mass"] * numbers["fore.com_z"] == pytest.approx(
        12.0 * 0.16 + 2.6 * 0.45, rel=5e-3
    )
    assert numbers["m1.viscous"] == pytest.approx(5e-4, rel=0.05)


@pytest.mark.parametrize(
    "quirk", ["as it is", "stamps that are late", "unequal steps", "two rates", "gap", "order"]
)
def test_motions_of_logs(quirk: str, tmp_path: Path) -> None:
    """`identify --segments`: the inertia of a rotor."""
    (tmp_path / "pl.toml").write_text(MODEL.replace("inertia = 1e-4", "inertia = 1.2e-4"))
    log = quirky(quirk, Arm(), 8.0)
    file = described(tmp_path, log, False)
    found = flexgen.fit_motion(None, file, free=["m2.inertia"], segment_s=0.5, progress=False)
    assert found.values["m2.inertia"] == pytest.approx(1e-4, rel=0.02)


def test_recordings_with_a_gap_in_each_pair_of_periods_are_refused(tmp_path: Path) -> None:
    """`test_recordings` reads whole periods next to a gap; here are fewer than two of them."""
    (tmp_path / "pl.toml").write_text(MODEL)
    file = described(tmp_path, quirky("gap", Arm(), 8.0), False, "period_s = 3.0\n")
    out = str(tmp_path / "frf.npz")
    with pytest.raises(flexgen.FlexgenError, match=r"gap of 0\.968 s"):
        read_experiment(file)
    assert main(["frf", str(file), "--out", out, "--quiet"]) == 1


@pytest.mark.parametrize("quirk", [quirk for quirk in QUIRKS if quirk not in REFUSED])
def test_gears_of_logs(quirk: str, tmp_path: Path) -> None:
    """`identify_gears`: the inertia of a rotor that the model has wrong."""
    text = MODEL.replace("inertia = 1e-4", "inertia = 1.2e-4")
    text = text.replace("damping = 1.0", "damping = 50.0").replace(
        "damping = 0.1", "damping = 5.0"
    )
    (tmp_path / "pl.toml").write_text(text)
    end = 12.0 if "jitter" in quirk else 30.0
    file, names = written(tmp_path, quirky(quirk, Arm(rest=3.0 * (quirk == "rest")), end))
    given = {"columns": names} if quirk == "names by option" else {}
    found = flexgen.identify_gears(
        tmp_path / "pl.toml", file, hysteresis=False, free=["m2.inertia"], progress=False, **given
    )
    assert found.values["m2.inertia"] == pytest.approx(1e-4, rel=2e-3)


def test_gears_refuse_what_no_motor_has(tmp_path: Path) -> None:
    (tmp_path / "pl.toml").write_text(MODEL)
    for quirk, words in REFUSED.items():
        file, _ = written(tmp_path, quirky(quirk, Arm(), 4.0))
        with pytest.raises(flexgen.FlexgenError, match=words):
            flexgen.identify_gears(tmp_path / "pl.toml", file, hysteresis=False, progress=False)


@pytest.fixture
def arm_log(tmp_path: Path) -> Path:
    """As of a controller of an arm: four decimals, unequal steps, joints and currents."""
    rng = np.random.default_rng(11)
    t = 40.0 * rng.uniform() + np.cumsum(rng.choice([0.008, 0.010, 0.012, 0.016], size=2600))
    current = LOAD.torques(t) / CONSTANTS + 0.01 * rng.normal(size=(len(t), 2))
    columns = {"timestamp": t + 86400.0}
    columns |= {f"actual_q_{k}": LOAD.motors(t)[:, k] / (100.0, 80.0)[k] for k in (0, 1)}
    columns |= {f"actual_current_{k}": current[:, k] for k in (0, 1)}
    rows = np.stack(list(columns.values()), axis=1)
    lines = [",".join(columns), *(",".join(f"{x:.4f}" for x in row) for row in rows)]
    (tmp_path / "arm.csv").write_text("\n".join(lines) + "\n")
    text = 'model = "pl.toml"\n[time]\nname = "timestamp"\nunit = "s"\n'
    for k in (0, 1):
        text += (
            f'[[angle]]\nmotor = "m{k + 1}"\nname = "actual_q_{k}"\nunit = "rad"\nside = "arm"\n'
        )
        text += f'[[torque]]\nmotor = "m{k + 1}"\nname = "actual_current_{k}"\nunit = "A"\n'
        text += f'constant = {CONSTANTS[k]}\nside = "motor"\n'
    (tmp_path / "arm.toml").write_text(text + '[[recording]]\nfile = "arm.csv"\n')
    (tmp_path / "pl.toml").write_text(MODEL)
    return tmp_path / "arm.toml"


def test_a_log_of_four_decimals_and_unequal_steps(arm_log: Path) -> None:
    load = flexgen.identify_load(arm_log.with_name("pl.toml"), arm_log)
    assert load.mass == pytest.approx(2.6, abs=SURE * load.mass_sd) and load.mass_sd < 0.2
    assert "steps of 8 to 16 ms" in load.notes[0]
    found = identify_bodies(flexgen.read(arm_log.with_name("pl.toml")), arm_log, progress=False)
    first = found.numbers["fore.mass"] * found.numbers["fore.com_z"]
    assert found.fit.status.has_deviations
    assert first == pytest.approx(12.0 * 0.16 + 2.6 * 0.45, rel=0.02)
