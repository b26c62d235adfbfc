"""The controller of examples/motion_control under faults of its plant and its planner.

The faults are those of encoders, time, drives and limits, and of the planner. The plant has brakes
that act 50 ms after the flag of the controller. Each fault begins at 20 phases of the program. The
figures are those of the plant: speeds of its motors, not those that the controller measures.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest
from emitted import ROOT, library_of, made, run
from motion_control_program import EXAMPLE, PROGRAMS, planned
from toolchain import CC, STRICT, needs_compiler

import flexgen
from flexgen.codegen.emission.path_header import path_header

pytestmark = needs_compiler
FAULTS = ROOT / "tests" / "support" / "motion_control" / "faults.c"
BAD_ARGUMENT = -5
NO_STATUS = -1000
NOT_IN_BUFFER = -1000
BAD_READING = -1001
MISSED_CYCLES = -1002
BAD_TORQUE = -1003
FOLLOWING_ERROR = -1004
OVERSPEED = -1005
BAD_REFERENCE = -1006
LIMITED = -1007
COLLISION = -1008
DRIVE_FAULT = -1009
PHASES = 20
# Speed of a motor over its largest one of the run without a fault.
SPEED = 1.2
# An encoder or a drive that does not fit the arm shows in one of these, depending on the speed.
MISFIT = {BAD_READING, COLLISION, DRIVE_FAULT, FOLLOWING_ERROR}
# Faults and their statuses. 0: at some phases, mostly at rest, the fault has no effect.
EXPECTED = {
    "nan": {BAD_READING},
    "nan ever": {BAD_READING},
    "all nan": {BAD_READING},
    "stuck": MISFIT,
    "all stuck": MISFIT,
    "turn": {BAD_READING},
    "turn ever": {BAD_READING},
    "4 rad": {BAD_READING},
    "4 rad ever": {BAD_READING},
    "drift": {BAD_READING},
    "1 mrad": {DRIVE_FAULT},
    "0.01 rad": MISFIT,
    "sign flip": {BAD_READING},
    "sign from start": {BAD_READING},
    "double": MISFIT | {0},
    "bits": MISFIT,
    "swapped": {BAD_READING},
    "missed 1": {MISSED_CYCLES},
    "missed 5": {MISSED_CYCLES},
    "missed 50": {MISSED_CYCLES},
    "late cycle": MISFIT | {0},
    "twice": {MISSED_CYCLES},
    "k +1000": {MISSED_CYCLES},
    "k -1000": {MISSED_CYCLES},
    "k max": {MISSED_CYCLES},
    "k -1": {MISSED_CYCLES},
    "late 2": MISFIT | {0},
    "late 5": MISFIT,
    "late 20": MISFIT,
    "drive off": {DRIVE_FAULT, COLLISION, 0},
    "wires swapped": {DRIVE_FAULT, COLLISION},
    "blocked": MISFIT,
    "push": {DRIVE_FAULT, COLLISION, OVERSPEED, 0},
    "limits 0.6": {LIMITED},
    "limits 0": {BAD_ARGUMENT},
    "limits nan": {BAD_ARGUMENT},
    "planner refuses": {BAD_ARGUMENT},
    "clock +0.5": {BAD_REFERENCE, 0},
    "clock -0.5": {BAD_REFERENCE},
}
# Siblings of the 39.
MORE = {
    "polarity": {DRIVE_FAULT, COLLISION},
    "drives off": {DRIVE_FAULT, COLLISION},
    "inf": {BAD_READING},
    "huge": {BAD_READING},
    "limits negative": {BAD_ARGUMENT},
    "planner feedforward": {BAD_TORQUE},
    "planner not ready": {NOT_IN_BUFFER, BAD_REFERENCE, 0},
    "planner reference": {BAD_REFERENCE},
    "k min": {MISSED_CYCLES},
}
# Larger speeds, and their reason: a force that lasts moves motors that cannot hold it until the
# brakes act. 1000 N are 1.3 times the torque limit of motor 2 of planar5_nmp, 0.8 m away. The
# wrist of manutec_r3_24 is pushed with 150 N.
PUSHED = {"planar5_nmp": 1.25, "manutec_r3_24": 1.5}
PUSH = {"planar5_nmp": "1000.0", "manutec_r3_24": "150.0"}


@dataclass(frozen=True)
class Row:
    """A fault at a phase; see faults.c."""

    name: str
    phase: int
    status: int
    cycles: int
    finite: bool
    share: float
    speed: float
    end_torque: float
    end_speed: float
    brakes: bool


def compiled(folder: Path, name: str, changes: tuple[tuple[str, str, str], ...] = ()) -> Path:
    """The program of the faults with the controller of the example, or with changes.

    A change: file, text, new text.
    """
    example = folder / "example"
    shutil.copytree(EXAMPLE.with_suffix(""), example / "motion_control")
    for file, old, new in changes:
        at = example / "motion_control" / file
        text = at.read_text(encoding="ascii")
        assert text.count(old) == 1, old
        at.write_text(text.replace(old, new), encoding="ascii")
    path = planned(name)
    library = Path(made(name).directory)
    header = path_header(path.equations.model, path.move.name, path.table(), path.duration)
    (folder / f"{path.move.name}.h").write_text(header, encoding="ascii")
    includes = [f"-I{at}" for at in (library, folder, example, example / "motion_control" / name)]
    flags = [*STRICT, "-Wno-unused-function", "-O2", f"-DPUSH={PUSH[name]}"]
    linked = [FAULTS, library_of(library), "-lm", "-o", "faults"]
    run(CC, *flags, *includes, *linked, folder=folder)
    return folder / "faults"


@pytest.fixture(scope="module")
def planar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(tmp_path_factory.mktemp("faults"), "planar5_nmp")


@cache
def answer(program: Path, *words: str) -> str:
    return subprocess.run([program, *words], capture_output=True, text=True, check=True).stdout


def rows(program: Path, *words: str) -> list[Row]:
    found = []
    for line in answer(program, *words).splitlines():
        name, phase, status, cycles, finite, share, speed, torque, at_end, brakes = line.split(",")
        found.append(
            Row(
                name, int(phase), int(status), int(cycles), finite == "1", float(share),
                float(speed), float(torque), float(at_end), brakes == "1",
            )
        )  # fmt: skip
    return found


def complaints(found: list[Row], speeds: dict[str, float]) -> list[str]:
    """Errors of a controller that had these faults."""
    out = []
    for row in found:
        at = f"{row.name}, phase {row.phase}: "
        latest = (
            4 if row.name.startswith("clock") else 2
        )  # an update of the planner begins every 5 cycles
        if row.status not in (EXPECTED | MORE)[row.name]:
            out.append(f"{at}status {row.status}")
        if row.speed > speeds.get(row.name, SPEED):
            out.append(f"{at}speed {row.speed}")
        if not row.finite or row.share > 1.0 + 1e-9:
            out.append(f"{at}torque {row.share}")
        if row.status == 0:
            if row.end_speed > 0.2 or row.brakes:  # rad/s: the program ended at rest
                out.append(f"{at}moves at the end with {row.end_speed} rad/s")
        elif not row.brakes or row.end_torque > 0.0 or row.end_speed > 0.0:
            out.append(f"{at}torque {row.end_torque} N m, {row.end_speed} rad/s at the end")
        elif row.cycles > latest:
            out.append(f"{at}status after {row.cycles} cycles")
    return out


def check_faults(name: str, program: Path) -> None:
    found = rows(program)
    assert {row.name for row in found} == set(EXPECTED | MORE)
    once = {"limits 0.6", "limits 0", "limits nan", "limits negative"}
    assert len(found) == PHASES * (len(EXPECTED | MORE) - len(once)) + len(once)
    assert complaints(found, {"push": PUSHED[name]}) == []


def check_no_fault(program: Path) -> None:
    """Two thirds of each limit hold without a fault.

    Torque 5 % off, friction, noise, a load of 3 kg, a push of 100 N, and all of them.
    """
    lines = [line.split(",") for line in answer(program, "no fault").splitlines()]
    assert [line[0] for line in lines] == [
        "as the model",
        "torque 0.95",
        "torque 1.05",
        "friction",
        "noise",
        "3 kg",
        "push 100 N",
        "all",
    ]
    for name, status, *shares in lines:
        assert status == "0", name
        # following errors, sudden torque, residual; speed: the limit is 1.1 times the largest
        assert max(map(float, shares[:4])) < 0.75 and float(shares[4]) < 0.95, name


def test_the_39_faults_at_20_phases(planar: Path) -> None:
    assert len(EXPECTED) == 39
    check_faults("planar5_nmp", planar)


def test_robots_that_are_not_as_the_model_have_no_fault(planar: Path) -> None:
    check_no_fault(planar)


@pytest.mark.slow
def test_six_axes_under_faults(tmp_path: Path) -> None:
    program = compiled(tmp_path, "manutec_r3_24")
    check_faults("manutec_r3_24", program)
    check_no_fault(program)


UNWATCHED = ("controller.h", "c->has_antiwindup = c->reacts = c->monitors = 1;",
             "c->has_antiwindup = c->reacts = 1;")  # fmt: skip
FORGIVING = ("controller.h", "c->refused[j] = 1;", "c->refused[j] = measured[j] != measured[j];")
TIRELESS = ("controller.h", "c->state = share > 0.0 ? c->state : OFF;", "u[0] = c->torque_max[0];")
TRUSTING = ("controller.h", "if (!(limit[j] > 0.0)) {", "if (limit[j] < 0.0) {")
BLIND = ("planner.h", "p->status = BAD_REFERENCE;", "p->warnings += 1;")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "fault", "complaint"),
    [
        ((UNWATCHED,), "wires swapped", "speed"),
        ((UNWATCHED, FORGIVING), "drift", "speed"),
        ((TIRELESS,), "nan", "at the end"),
        ((TRUSTING,), "limits nan", "status"),
        ((BLIND,), "clock -0.5", "cycles"),
    ],
)
def test_planted_mistakes_are_found(
    changes: tuple[tuple[str, str, str], ...], fault: str, complaint: str, tmp_path: Path
) -> None:
    found = complaints(rows(compiled(tmp_path, "planar5_nmp", changes), fault), {})
    assert any(complaint in text for text in found)


def test_limits_are_those_of_the_model_files_and_of_the_programs() -> None:
    """Each motor has limits of torque, speed and residual.

    The torque limit is that of the model file, where it states any.
    """
    for name in PROGRAMS:
        text = (EXAMPLE.with_suffix("") / name / "robot.h").read_text(encoding="ascii")
        motors = flexgen.read(name).motors
        for kind in ("torque", "speed", "residual"):
            found = re.search(rf"{kind}_limit\[\] = \{{([^}}]+)\}}", text)
            assert found is not None
            limits = [float(x) for x in found[1].split(",")]
            assert len(limits) == len(motors) and min(limits) > 0
            if kind == "torque":
                given = zip(motors, limits, strict=True)
                assert all(m.torque_max in (None, limit) for m, limit in given)
