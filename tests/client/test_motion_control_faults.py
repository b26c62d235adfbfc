"""The controller of examples/motion_control under faults of encoders, cycles and buffers."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
from emitted import ROOT, library_of, made, run
from motion_control_program import EXAMPLE, PROGRAMS, planned
from toolchain import CC, STRICT, needs_compiler

import flexgen
from flexgen.codegen.path_header import path_header

pytestmark = needs_compiler
NAME = "planar5_nmp"
FAULTS = ROOT / "tests" / "support" / "motion_control" / "faults.c"
BAD_READING, MISSED_CYCLES, BAD_TORQUE, NOT_IN_BUFFER, AT_LIMIT = -1001, -1002, -1003, -1000, 1000


def compiled(folder: Path) -> Path:
    """The program of the faults with the controller of the example."""
    path, library = planned(NAME), Path(made(NAME).directory)
    header = path_header(path.equations.model, path.move.name, path.table(), path.duration)
    (folder / f"{path.move.name}.h").write_text(header, encoding="ascii")
    includes = [
        f"-I{at}" for at in (library, folder, EXAMPLE.parent, EXAMPLE.with_suffix("") / NAME)
    ]
    run(
        CC,
        *STRICT,
        "-Wno-unused-function",
        "-O1",
        *includes,
        FAULTS,
        library_of(library),
        "-lm",
        "-o",
        "faults",
        folder=folder,
    )
    return folder / "faults"


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(tmp_path_factory.mktemp("faults"))


def figures(program: Path, fault: str) -> list[float]:
    """Cycles to the status, status, finite, share of the torque limits, step of the reference, speed at the end."""
    answer = subprocess.run([program, fault], capture_output=True, text=True, check=True)
    return [float(x) for x in answer.stdout.split()]


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("nan", BAD_READING),
        ("nan for ever", BAD_READING),
        ("inf", BAD_READING),
        ("huge", BAD_READING),
        ("wrap", BAD_READING),
        ("late", NOT_IN_BUFFER),
        ("feedforward", BAD_TORQUE),
        ("missed", MISSED_CYCLES),
        ("missed one", MISSED_CYCLES),
        ("repeated", MISSED_CYCLES),
        ("push", AT_LIMIT),
    ],
)
def test_a_fault_is_reported_at_once_and_torques_stay_finite_and_limited(
    program: Path, fault: str, expected: int
) -> None:
    """A cycle moves the reference by 0.104 rad at most; an old sample of the buffer by 0.26 rad and more."""
    cycles, status, finite, share, step, speed = figures(program, fault)
    assert status == expected and finite == 1 and share <= 1.0
    assert 0 <= cycles < 2
    assert step < 0.105
    # those have no measurement of a motor any more, or no stand
    if fault not in ("push", "nan for ever", "huge"):
        assert speed < 0.02


def test_without_a_fault_there_is_no_status(program: Path) -> None:
    cycles, status, finite, share, step, _ = figures(program, "none")
    assert cycles == -1 and status == 0 and finite == 1 and share < 0.8 and 0.1 < step < 0.105


def test_the_torque_limits_are_those_of_the_model_files() -> None:
    """Each motor has one; the model file's, where it states any."""
    for name in PROGRAMS:
        text = (EXAMPLE.with_suffix("") / name / "robot.h").read_text(encoding="ascii")
        found = re.search(r"torque_limit\[\] = \{([^}]+)\}", text)
        assert found is not None
        limits = [float(x) for x in found[1].split(",")]
        motors = flexgen.read(name).motors
        assert len(limits) == len(motors) and min(limits) > 0
        assert all(m.torque_max in (None, limit) for m, limit in zip(motors, limits, strict=True))
