"""The self-test program: its numbers come from Lagrange's equations, the library's from the
recursion.

It passes on every quick model, in both precisions, and fails where a number of the table is wrong,
arguments are swapped, or the library itself is wrong.
"""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest
from bristled import NUMBERS, bristled
from exports import PLAIN, library_object
from remembering import FORGETS, SLIPPING, compiled, remembering
from toolchain import STRICT, needs_compiler, tool

import flexgen
from flexgen.base.errors import ArgumentError, BuildError, SolverError
from flexgen.cli.main import main
from flexgen.codegen.build.source_folder import RECORD, write_folder


def program(
    folder: Path, library: Path, *flags: str, strict: bool = True
) -> subprocess.CompletedProcess[str]:
    """Compile the self-test and run it with a compiled library."""
    cc = tool("gcc")
    name = library.stem
    words = [*STRICT, "-O0"] if strict else PLAIN
    subprocess.run([cc, *words, *flags, "-c", f"{name}_selftest.c"], cwd=folder, check=True)
    subprocess.run(
        [cc, f"{name}_selftest.o", library, "-lm", "-o", "selftest"], cwd=folder, check=True
    )
    return subprocess.run(["./selftest"], cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The self-test of planar5_nmp."""
    folder = tmp_path_factory.mktemp("selftest")
    flexgen.export_selftest("planar5_nmp", folder)
    return folder


@needs_compiler
@pytest.mark.slow
def test_the_selftest_passes(exported):
    library, compiled = library_object("planar5_nmp")
    assert (exported / "planar5_nmp.c").read_text(encoding="ascii") == library.source
    run = program(exported, compiled)
    assert run.returncode == 0 and run.stdout.startswith("PASS"), run.stdout
    # three functions with more than one result less, 2 states each, and the streams
    assert int(re.search(r"(\d+) arrays, 0 wrong", run.stdout)[1]) > 2 * len(library.functions)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("name", ["elbow", "beam_arm", "four_mass"])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_the_selftest_passes_in_both_precisions(name, precision, tmp_path):
    flexgen.export_selftest(name, tmp_path, precision=precision)
    run = program(tmp_path, library_object(name, precision)[1])
    assert run.returncode == 0 and run.stdout.startswith("PASS"), run.stdout


@needs_compiler
@pytest.mark.slow
def test_a_robot_whose_output_is_a_pose_passes(tmp_path):
    flexgen.export_selftest("manutec_r3", tmp_path)
    run = program(tmp_path, library_object("manutec_r3")[1])
    assert run.returncode == 0 and run.stdout.startswith("PASS"), run.stdout


@needs_compiler
@pytest.mark.full
def test_a_robot_with_24_coordinates_passes(tmp_path):
    flexgen.export_selftest("manutec_r3_24", tmp_path, motion=False)
    run = program(tmp_path, library_object("manutec_r3_24")[1])
    assert run.returncode == 0 and run.stdout.startswith("PASS"), run.stdout


@pytest.mark.slow
@needs_compiler
def test_gears_and_motors_with_memory_pass_and_what_they_forget_is_seen(tmp_path):
    flexgen.export_selftest(remembering(), tmp_path)
    for forgets in ("", *FORGETS):
        lines = program(tmp_path, compiled(forgets)).stdout.splitlines()
        told = "FAIL stream_update.tau_m" if forgets else "PASS"
        assert lines[0].startswith(told) and lines[-1].startswith(told[:4]), (forgets, lines)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
def test_an_elastic_arm_with_memory_passes(precision, tmp_path):
    numbers = {motor: NUMBERS for motor in ("m1", "m2")}
    gears = {
        f"element.{joint}.gear.hysteresis": SLIPPING for joint in ("arm1.dof.q1", "arm2.dof.q2")
    }
    model = bristled("planar5_nmp", numbers, **gears)
    made = flexgen.export_selftest(model, tmp_path, precision=precision)
    command = [tool("gcc"), *PLAIN, "-c", "planar5_nmp.c"]
    subprocess.run(command, cwd=made.path, check=True)
    run = program(tmp_path, tmp_path / "planar5_nmp.o")
    assert run.returncode == 0 and run.stdout.startswith("PASS"), run.stdout


def planted(
    folder: Path, tmp_path: Path, file: str, pattern: str, change
) -> subprocess.CompletedProcess[str]:
    """Run the self-test with one change of its text, or of the library."""
    for path in folder.iterdir():
        if path.suffix in (".c", ".h"):
            (tmp_path / path.name).write_bytes(path.read_bytes())
    text = (tmp_path / file).read_text(encoding="ascii")
    assert re.search(pattern, text), pattern
    (tmp_path / file).write_text(re.sub(pattern, change, text, count=1), encoding="ascii")
    library = library_object("planar5_nmp")[1]
    if file == "planar5_nmp.c":
        subprocess.run([tool("gcc"), *PLAIN, "-c", file], cwd=tmp_path, check=True)
        library = tmp_path / "planar5_nmp.o"
    return program(tmp_path, library, strict=False)


CASES = "planar5_nmp_selftest_cases.h"


@needs_compiler
@pytest.mark.parametrize(
    ("pattern", "change", "where"),
    [
        # the seventh digit of the first number of a table
        (
            r"(expected_forward_dynamics_a_m\[2\]\[2\] = \{\s*\{-?\d*\.?\d{5})(\d)",
            lambda m: m[1] + str((int(m[2]) + 5) % 10),
            "forward_dynamics.a_m",
        ),
        (
            r"_inverse_dynamics\((\w+\[k\]), (\w+\[k\])",
            r"_inverse_dynamics(\2, \1",
            "inverse_dynamics.tau_a",
        ),
        (
            r"(rest_tau_m\[1\]\[2\] = \{\s*\{-?\d+\.\d{4})(\d)",
            lambda m: m[1] + str((int(m[2]) + 5) % 10),
            "at rest",
        ),
        (r"move_y\[k \+ 1\], move_dy", "move_y[k], move_dy", "stream_update.tau_m"),
    ],
)  # fmt: skip
def test_planted_errors_of_the_program_are_seen(exported, tmp_path, pattern, change, where):
    run = planted(exported, tmp_path, CASES, pattern, change)
    assert run.returncode == 1 and run.stdout.splitlines()[-1].startswith("FAIL")
    assert any(
        line.startswith("FAIL") and where in line for line in run.stdout.splitlines()[:-1]
    ), run.stdout


@needs_compiler
@pytest.mark.parametrize(
    ("pattern", "where"),
    [
        # the first entry of an array of several
        (r'(?=compare\(result, "(gravity)\.(\w+)")', "gravity"),
        (r'(?=compare_rows\(result, "stream_update.tau_m", (found)())', "stream_update.tau_m"),
    ],
)
def test_a_first_entry_that_is_not_a_number_is_seen(exported, tmp_path, pattern, where):
    def plant(found):
        array = found[1] if found[2] == "" else found[2]
        return f"{array}[0] = 0.0 / (double)(result->arrays < 0); "

    run = planted(exported, tmp_path, CASES, pattern, plant)
    lines = run.stdout.splitlines()
    assert run.returncode == 1 and lines[-1].startswith("FAIL") and "nan" in lines[-1], run.stdout
    assert any(line.startswith(f"FAIL {where}") for line in lines[:-1]), run.stdout


@needs_compiler
@pytest.mark.slow
def test_a_planted_error_of_the_library_is_seen(exported, tmp_path):
    """Gravity that is wrong by a part in 1e8, in one term."""
    run = planted(exported, tmp_path, "planar5_nmp.c", r"\b9\.81\d*\b", "9.8100001")
    assert run.returncode == 1 and "FAIL" in run.stdout


@needs_compiler
def test_the_selftest_is_a_function_for_other_programs(exported, tmp_path):
    flags = ["-DPLANAR5_NMP_SELFTEST_NO_MAIN", "-DPLANAR5_NMP_SELFTEST_NO_PRINT"]
    (tmp_path / "own.c").write_text(
        "int planar5_nmp_selftest(double *largest);\n"
        "int main(void) { double x = -1; return planar5_nmp_selftest(&x) == 0 && x > 0 && x < 1 "
        "? 0 : 1; }\n"
    )
    cc = tool("gcc")
    source = exported / "planar5_nmp_selftest.c"
    subprocess.run(
        [cc, *STRICT, "-O0", *flags, "-c", source, "-o", "test.o"], cwd=tmp_path, check=True
    )
    symbols = subprocess.run(
        [tool("nm"), "-u", "test.o"], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    assert not re.search(r"\b(printf|puts|malloc|calloc|fopen)\b", symbols.stdout)
    subprocess.run(
        [cc, "own.c", "test.o", library_object("planar5_nmp")[1], "-o", "own"],
        cwd=tmp_path,
        check=True,
    )
    subprocess.run(["./own"], cwd=tmp_path, check=True)


def test_the_bytes_are_the_same_and_changed_files_are_kept(tmp_path):
    first = flexgen.export_selftest("planar5_nmp", tmp_path / "a", motion=False)
    second = flexgen.export_selftest("planar5_nmp", tmp_path / "b", motion=False)
    assert [p.read_bytes() for p in first.files] == [p.read_bytes() for p in second.files]
    file = tmp_path / "a" / "planar5_nmp_selftest.c"
    file.write_text("mine\n")
    with pytest.raises(BuildError, match=r"changed since the export \(planar5_nmp_selftest.c\)"):
        flexgen.export_selftest("planar5_nmp", tmp_path / "a", motion=False)
    assert file.read_text() == "mine\n"
    flexgen.export_selftest("planar5_nmp", tmp_path / "a", motion=False, force=True)
    assert file.read_bytes() == (tmp_path / "b" / "planar5_nmp_selftest.c").read_bytes()


def test_folders_of_others_are_refused(tmp_path):
    (tmp_path / "planar5_nmp.c").write_text("mine\n")
    with pytest.raises(BuildError, match=r"flexgen did not write \(planar5_nmp.c\)"):
        flexgen.export_selftest("planar5_nmp", tmp_path, motion=False)
    assert [p.name for p in tmp_path.iterdir()] == ["planar5_nmp.c"]
    (tmp_path / "planar5_nmp.c").unlink()
    (tmp_path / "flexgen_export.json").write_text(
        '{"kind": "ros2", "name": "planar5_nmp", "files": {}}'
    )
    with pytest.raises(BuildError, match=r"the export ros2 of 'planar5_nmp'"):
        flexgen.export_selftest("planar5_nmp", tmp_path, motion=False)
    with pytest.raises(ArgumentError, match="expected the path of a folder"):
        flexgen.export_selftest("planar5_nmp", 3, motion=False)
    with pytest.raises(ArgumentError, match="given 3, expected a text or a path or a"):
        flexgen.export_selftest(3)


@pytest.mark.parametrize(
    "record",
    [
        '{"files": {}}',
        '{"kind": "selftest", "files": {}}',
        '{"kind": 3, "name": "planar5_nmp", "files": {}}',
        '{"kind": "selftest", "name": null, "files": {}}',
        '{"kind": "selftest", "name": "planar5_nmp", "files": {"a.c": 3}}',
        '{"kind": "selftest", "name": "planar5_nmp", "files": {"../a.c": "0"}}',
        "[" * 100_000,
        "[]",
    ],
)
def test_a_damaged_record_of_an_export_is_refused(tmp_path, record):
    (tmp_path / RECORD).write_text(record)
    with pytest.raises(
        BuildError, match=r"flexgen_export.json: given a file that flexgen did not write"
    ):
        write_folder(tmp_path, "selftest", "planar5_nmp", {"a.c": "1"})
    assert [p.name for p in tmp_path.iterdir()] == [RECORD]


def contents(folder: Path) -> dict[str, str | None]:
    """Text by path, None for folders."""
    return {
        p.relative_to(folder).as_posix(): p.read_text() if p.is_file() else None
        for p in folder.rglob("*")
    }


@pytest.mark.parametrize("place", ["b.c", "src/a.c", RECORD])
def test_folders_with_the_name_of_a_file_are_refused(tmp_path, place):
    write_folder(tmp_path, "mex", "arm", {"a.c": "old", "b.c": "old", "src/a.c": "old"})
    (tmp_path / place).unlink()
    (tmp_path / place / "mine").mkdir(parents=True)
    before = contents(tmp_path)
    with pytest.raises(BuildError, match=rf"given folders with the names of files \({place}\)"):
        write_folder(
            tmp_path, "mex", "arm", {"a.c": "new", "b.c": "new", "src/a.c": "new"}, force=True
        )
    assert contents(tmp_path) == before


@pytest.mark.parametrize("stop", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("last", [1, 2, 3, 4])
def test_a_folder_stays_as_it_was_where_writing_fails(tmp_path, monkeypatch, stop, last):
    """`os.replace` fails at each of the four files in turn."""
    write_folder(tmp_path, "mex", "arm", {"a.c": "old", "b.c": "old", "gone.c": "old"})
    before = contents(tmp_path)
    replace = os.replace
    calls = []

    def failing(source, target):
        calls.append(target)
        if len(calls) == last:
            raise stop
        replace(source, target)

    monkeypatch.setattr(os, "replace", failing)
    with pytest.raises(BuildError if isinstance(stop, OSError) else KeyboardInterrupt):
        write_folder(tmp_path, "mex", "arm", {"a.c": "new", "b.c": "new", "new/c.c": "new"})
    assert contents(tmp_path) == before
    monkeypatch.undo()
    write_folder(tmp_path, "mex", "arm", {"a.c": "new", "b.c": "new", "new/c.c": "new"})
    assert contents(tmp_path).keys() == {"a.c", "b.c", "new", "new/c.c", RECORD}


def test_a_file_in_the_place_of_a_folder_leaves_the_folder_as_it_was(tmp_path):
    write_folder(tmp_path, "mex", "arm", {"a.c": "old"})
    (tmp_path / "src").write_text("mine")
    before = contents(tmp_path)
    with pytest.raises(BuildError, match="cannot be written"):
        write_folder(tmp_path, "mex", "arm", {"a.c": "new", "src/b.c": "new"})
    assert contents(tmp_path) == before


def test_a_move_through_a_singular_pose_is_refused(monkeypatch, tmp_path):
    from flexgen.exports.c_code.selftest import motion

    monkeypatch.setattr(motion, "SINGULAR", 1e3)  # every pose counts as one
    with pytest.raises(SolverError, match=r"singular pose.*motion=False"):
        flexgen.export_selftest("planar5_nmp", tmp_path)


def test_the_command_line(tmp_path, capsys):
    assert (
        main(["export", "selftest", "planar5_nmp", "--out", str(tmp_path), "--no-motion", "-q"])
        == 0
    )
    assert "planar5_nmp_selftest.c" in capsys.readouterr().out
    assert (
        main(
            ["export", "selftest", "planar5_nmp", "--out", str(tmp_path), "--move", "nosuch", "-q"]
        )
        == 1
    )
    assert "nosuch" in capsys.readouterr().err
