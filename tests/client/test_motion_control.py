"""The motion control system in C: its motion checked by other equations, another integrator and
Python's planner; its brake in every cycle of an update.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from emitted import library_of, made, run, sources
from hostile_client import SANITIZE, can_sanitize
from motion_control_program import EXAMPLE, PROGRAMS, planned
from toolchain import CC, STRICT, needs_compiler, tool

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.emission.path_header import path_header
from flexgen.simulation.simulate import simulate

pytestmark = needs_compiler
# intervals of 5 ms; the path begins when the first one has passed
HORIZON = {"planar5_nmp": 20, "manutec_r3_24": 29}
# cycles of an update of the stream; of braking: 2 (READY - PARTS - 1)
PARTS = 5
BRAKE = 48
# Largest torque from a contact on, in percent of that of the nominal run. A stop of this length
# takes torques of the size of those of the program: 117 to 120 measured with planar5_nmp. Samples
# that are 40 cycles old give 2000 and more.
TORQUE = 300.0
VARIABLES = {  # what the sweeps of a test set without compiling again
    "time": '-DCONTACT_TIME=atof(getenv("CONTACT_TIME"))',
    "failure": (
        'if (k == atoi(getenv("FAILURE"))) {\n        p->status = SIZE(BAD_ARGUMENT);\n    }\n    '
    ),
}


def build(
    name: str,
    folder: Path,
    library: Path,
    *flags: str,
    compiler: str = str(CC),
    linked: tuple[object, ...],
    example: Path = EXAMPLE,
) -> Path:
    path = planned(name)
    header = path_header(path.equations.model, path.move.name, path.table(), path.duration)
    (folder / f"{path.move.name}.h").write_text(header, encoding="ascii")
    includes = (f"-I{library}", f"-I{folder}", f"-I{example.with_suffix('') / name}")
    run(
        compiler,
        *STRICT,
        *flags,
        *includes,
        example,
        *linked,
        "-lm",
        "-o",
        "control",
        folder=folder,
    )
    return folder / "control"


def table(text: str) -> dict[str, list[float]]:
    """The figures of the runs."""
    rows = [line.split() for line in text.splitlines()]
    names = ("nominal", "saturated", "windup", "contact", "ignored")
    return {
        row[0]: [np.nan if x == "-" else float(x) for x in row[1:]]
        for row in rows
        if row and row[0] in names
    }


def check_runs(found: dict[str, list[float]]) -> None:
    """Columns: error, error at rest [um], limited cycles [%], integral.

    From the contact on: found, braked, stands [ms], way [mm], largest torque relative to that of
    the nominal run [%].
    """
    # um; 5 asked: rounding of the encoders, and the torques between samples
    assert found["nominal"][0] < 0.1
    saturated = found["saturated"]
    windup = found["windup"]
    assert saturated[2] > 5.0 and saturated[0] > 1000.0  # the limits do act
    # an integral part that is less than the limit has not wound up; the planted one has
    assert saturated[3] < 0.5 and windup[3] > 1.5 and windup[1] > 4.0 * saturated[1]
    contact = found["contact"]
    ignored = found["ignored"]
    assert 0 < contact[0] <= 20.0 and ignored[0] == contact[0]
    assert contact[1] == contact[0] + BRAKE and contact[4] < TORQUE
    assert contact[2] < 400.0 and np.isnan(ignored[1]) and ignored[2] > 4.0 * contact[2]
    assert contact[3] < 0.1 * ignored[3]


def check_motion(name: str, file: Path, tolerance: float) -> None:
    """The path of the planner in Python, the output of Lagrange's equations, and the motion of
    another integrator.
    """
    path = planned(name)
    motion = Trajectory.load(file)
    t = motion.time - 5e-3 * (HORIZON[name] - 1)
    sample = path.sample(t)
    assert path.duration < t[-1] < path.duration + 0.6
    # joint moves go through other code for the kinematics
    assert np.abs(motion["y_ref"] - sample.y[:, :, 0]).max() < 1e-12
    y = evaluate(path.equations.function("output"), motion["q_a"])[0].reshape(len(t), -1)
    assert np.linalg.norm(y - sample.y[:, :, 0], axis=1).max() < 1e-7
    if sample.R is not None:
        assert np.abs(motion["R_ref"] - sample.R.reshape(-1, 9)).max() < 1e-12
    again = simulate(path.equations, file)
    assert again.tool_error_max_m is not None and again.tool_error_max_m < 1e-7
    assert np.abs(again.trajectory["q_a"] - motion["q_a"]).max() < tolerance


@pytest.fixture(scope="module")
def planar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program for the planar arm, its trajectory and what it printed."""
    at = tmp_path_factory.mktemp("planar")
    folder = Path(made("planar5_nmp").directory)
    program = build("planar5_nmp", at, folder, "-O1", linked=(library_of(folder),))
    (at / "printed.txt").write_text(run(program, "motion.csv", 0, folder=at), encoding="ascii")
    return program


@pytest.mark.slow
def test_a_program_runs_on_its_plant(planar: Path) -> None:
    text = (planar.parent / "printed.txt").read_text(encoding="ascii")
    check_runs(table(text))
    assert "updates above the tolerance of the stream: 0" in text
    # RK4 with steps of 0.25 ms: order four, 2e-12 rad measured
    check_motion("planar5_nmp", planar.parent / "motion.csv", 1e-10)


@pytest.mark.slow
def test_a_plant_that_interpolates_held_torques_fails_the_test(
    planar: Path, tmp_path: Path
) -> None:
    """Planted: the meta data without the hold; and instants that are not those of the sample
    time.
    """
    text = (planar.parent / "motion.csv").read_text(encoding="ascii")
    (tmp_path / "curve.csv").write_text(text.replace('"hold": "zoh", ', ""), encoding="ascii")
    error = simulate("planar5_nmp", tmp_path / "curve.csv").tool_error_max_m
    assert error is not None and error > 1e-4
    (tmp_path / "other.csv").write_text(
        re.sub(r'"sample_time": [\d.e-]+', '"sample_time": 0.002', text), encoding="ascii"
    )
    with pytest.raises(ArgumentError, match="one sample time apart"):
        simulate("planar5_nmp", tmp_path / "other.csv")


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["gcc with sanitizers", "clang"])
def test_compilers_and_times(compiler: str, tmp_path: Path) -> None:
    flags = SANITIZE if "with" in compiler else ["-O2"]
    if "with" in compiler and not can_sanitize(tmp_path):
        pytest.skip("the compiler has no sanitizers")
    folder = Path(made("planar5_nmp").directory)
    found = tool(compiler.split()[0])
    program = build(
        "planar5_nmp", tmp_path, folder, *flags, compiler=found, linked=tuple(sources(folder))
    )
    text = run(program, "motion.csv", 5000, folder=tmp_path)
    check_runs(table(text))
    assert re.search(r"processor time: median [\d.]+ us, 99.99 % below [\d.]+ us, worst", text)


@pytest.mark.full
@pytest.mark.slow
def test_six_axes_with_24_degrees_of_freedom(tmp_path: Path) -> None:
    folder = Path(made("manutec_r3_24").directory)
    program = build("manutec_r3_24", tmp_path, folder, "-O2", linked=(library_of(folder),))
    text = run(program, "motion.csv", 0, folder=tmp_path)
    check_runs(table(text))
    # 1.1e-9 measured: RK4, and the growth of perturbations under gravity without feedback in 5 s
    check_motion("manutec_r3_24", tmp_path / "motion.csv", 1e-8)


@pytest.mark.slow
def test_a_file_that_cannot_be_written_is_refused(planar: Path, tmp_path: Path) -> None:
    answer = subprocess.run(
        [planar, "none/motion.csv"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert answer.returncode == 1 and "none/motion.csv cannot be written" in answer.stderr


def test_the_folder_has_a_robot_for_every_program() -> None:
    assert {path.parent.name for path in EXAMPLE.with_suffix("").glob("*/robot.h")} == set(
        PROGRAMS
    )
    for name in PROGRAMS:
        robot = flexgen.read(name)
        text = (EXAMPLE.with_suffix("") / name / "robot.h").read_text(encoding="ascii")
        actuated = re.search(r"actuated\[\] = \{([\d, ]+)\}", text)
        assert actuated is not None and tuple(map(int, actuated[1].split(","))) == tuple(robot.i_g)
        assert re.findall(r'"(\w+)\] (?:rad|m)"', text.split("motor_columns")[0]) == [
            c.name for c in robot.coordinates
        ]
        assert re.search(rf"INTERVALS = {HORIZON[name]}\b", text)


def planted(folder: Path, *changes: tuple[str, str, str]) -> Path:
    """The program for the planar arm from a copy of the example with changes: file, text, new
    text.
    """
    example = folder / EXAMPLE.name
    shutil.copy(EXAMPLE, example)
    shutil.copytree(EXAMPLE.with_suffix(""), example.with_suffix(""))
    for file, old, new in changes:
        text = (example.with_suffix("") / file).read_text(encoding="ascii")
        assert text.count(old) == 1
        (example.with_suffix("") / file).write_text(text.replace(old, new), encoding="ascii")
    library = Path(made("planar5_nmp").directory)
    linked = (library_of(library),)
    return build(
        "planar5_nmp", folder, library, "-O1", VARIABLES["time"], linked=linked, example=example
    )


def contacts(program: Path) -> list[subprocess.CompletedProcess[str]]:
    """Contacts in five cycles that follow each other, from 1 s on; half a cycle earlier, for the
    rounding.
    """
    found = []
    for i in range(PARTS):
        variables = os.environ | {"CONTACT_TIME": f"{0.9995 + 1e-3 * i}"}
        command = [program, "motion.csv", "0"]
        found.append(
            subprocess.run(
                command,
                cwd=program.parent,
                env=variables,
                capture_output=True,
                text=True,
                check=False,
            )
        )
    return found


LONG = ("controller.h", "BRAKE = 2 * (READY - PARTS - 1)", "BRAKE = 2 * (READY - 2)")
UNCHECKED = ("planner.h", "if (k < 0 || k < p->ready - RING || k + 1 >= p->ready)", "if (k < 0)")
UNWATCHED = ("controller.h", "if (c->monitors && c->state != OFF)", "if (c->monitors < 0)")
UNLIMITED = (
    "controller.h",
    "given->torque, torque_limit, 1.0)",
    "given->torque, torque_limit, 1e9)",
)


@pytest.mark.slow
def test_the_brake_has_its_samples_in_every_cycle(tmp_path: Path) -> None:
    """The cycles of an update have 27 to 31 samples left. Planted: a brake that needs 30 of
    them.
    """
    folders = [tmp_path / name for name in ("brake", "long", "unchecked")]
    for folder in folders:
        folder.mkdir()
    phases = []  # of the detection in an update
    for i, answer in enumerate(contacts(planted(folders[0]))):
        assert answer.returncode == 0, answer.stderr
        contact = table(answer.stdout)["contact"]
        assert contact[1] == contact[0] + BRAKE and contact[2] < 100.0 and contact[4] < TORQUE
        phases.append((PARTS * (HORIZON["planar5_nmp"] - 1) + 1000 + i + int(contact[0])) % PARTS)
    assert sorted(phases) == list(range(PARTS))
    for phase, answer in zip(phases, contacts(planted(folders[1], LONG)), strict=True):
        if phase in (0, 4):  # 30 samples and, after the update, 31
            assert answer.returncode == 0
        else:
            assert (
                answer.returncode == 1
                and "contact: the controller needs a sample that is not in" in answer.stderr
            )
    for phase, answer in zip(
        phases, contacts(planted(folders[2], LONG, UNCHECKED, UNWATCHED, UNLIMITED)), strict=True
    ):
        assert (table(answer.stdout)["contact"][4] > 3.0 * TORQUE) == (phase not in (0, 4))


@pytest.mark.slow
def test_the_brake_has_its_samples_where_the_planner_fails(tmp_path: Path) -> None:
    """In the last cycle of an update 26 samples are left: k to k + 25. Planted: a brake that is
    two cycles longer.
    """
    advance = (
        "static void advance_planner(planner *p, int64_t k)\n"
        "{\n"
        "    const int part = (int)(k % PARTS);\n"
        "    "
    )
    failing = ("planner.h", advance, advance + VARIABLES["failure"])
    standard = ("planner.h", "#include <string.h>", "#include <stdlib.h>\n#include <string.h>")
    longer = ("controller.h", LONG[1], "BRAKE = 2 * (READY - PARTS)")
    for name, changes in {
        "brake": (standard, failing),
        "longer": (standard, failing, longer),
    }.items():
        (tmp_path / name).mkdir()
        program = planted(tmp_path / name, *changes)
        for at in range(1000, 1000 + PARTS):
            answer = subprocess.run(
                [program, "motion.csv", "0"],
                cwd=program.parent,
                env=os.environ | {"FAILURE": str(at)},
                capture_output=True,
                text=True,
                check=False,
            )
            refused = "not in the buffer" in answer.stderr
            assert answer.returncode == 1 and answer.stderr.startswith("nominal: ")
            assert refused == (name == "longer" and at % PARTS == PARTS - 1)
            if name == "brake":
                motion = Trajectory.load(program.parent / "motion.csv")
                before, after = (
                    np.abs(part).max(axis=0) for part in np.split(motion["tau_m"], [at])
                )
                assert (after < 0.01 * TORQUE * before).all()
                assert (
                    np.ptp(motion["q_m"][-100:], axis=0).max()
                    < 1e-3 * np.ptp(motion["q_m"], axis=0).max()
                )
