"""The library as a product: packages that find it, strict compilers, examples that run."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import clients
import numpy as np
import pytest
from emitted import ROOT, SMALL, _folder, library_of, made, random_states, run, sources
from toolchain import CC, STRICT, STRICT_CPP, needs_compiler, tool

from flexgen.codegen.build.compiler import REPRODUCIBLE
from flexgen.codegen.build.generate import generate
from flexgen.codegen.emission.emit import symbols
from flexgen.codegen.emission.spec import library_spec
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.reader import read
from flexgen.runtime import load

pytestmark = needs_compiler

# constants are folded in another order; the mass matrix amplifies that by its condition
PARAMETER_ROUNDING = 1e-10
# What a freestanding compiler may call by itself; the functions need nothing else of the C
# library.
BY_ITSELF = {"memset", "memcpy", "memmove"}


@cache
def written(name: str, precision: str) -> Path:
    """The folder of a library that is not compiled; not to be changed."""
    return generate(
        name, _folder() / f"{name}_{precision}", precision=precision, build=False
    ).directory


# --- packages ------------------------------------------------------------------------------------
CONSUMER = """\
#include "elbow.h"
#include <stdio.h>

int main(void)
{
    const elbow_real q[ELBOW_NA] = {0};
    elbow_real g[ELBOW_NA];
    const int status = elbow_gravity(q, g);
    printf("%d %s\\n", status, elbow_digest());
    return status;
}
"""
CONSUMER_CMAKE = """\
cmake_minimum_required(VERSION 3.14)
project(consumer LANGUAGES C)
find_package(elbow 6.0 CONFIG REQUIRED)
add_executable(consumer consumer.c)
target_link_libraries(consumer PRIVATE flexgen::elbow)
"""


@pytest.fixture
def consumer(tmp_path):
    """A folder with a space in its name and a program that wants the library."""
    folder = tmp_path / "the consumer"
    folder.mkdir()
    (folder / "consumer.c").write_text(CONSUMER)
    (folder / "CMakeLists.txt").write_text(CONSUMER_CMAKE)
    return folder


def answered(program: Path, **environment: str) -> None:
    answer = subprocess.run(
        [program], capture_output=True, text=True, check=True, env={**os.environ, **environment}
    )
    assert answer.stdout.split() == ["0", library_spec(derive("elbow"), ["gravity"]).digest]


@pytest.mark.slow
@pytest.mark.parametrize("shared", ["OFF", "ON"])
def test_cmake_and_pkg_config_find_what_was_installed(consumer, shared):
    cmake = tool("cmake")
    folder = made("elbow").directory
    there = consumer / "in stalled"
    run(cmake, "-S", folder, "-B", "library", f"-DBUILD_SHARED_LIBS={shared}", folder=consumer)
    flags = (consumer / "library/CMakeFiles/flexgen_elbow.dir/flags.make").read_text()
    assert all(flag in flags for flag in REPRODUCIBLE)
    # it compiles in a third of the time
    run(cmake, "library", "-DCMAKE_BUILD_TYPE=Debug", folder=consumer)
    run(cmake, "--build", "library", folder=consumer)
    run(cmake, "--install", "library", "--prefix", there, folder=consumer)
    assert sorted(path.name for path in (there / "include").iterdir()) == [
        "elbow.h",
        "elbow_batch.h",
        "elbow_inversion.h",
    ]
    run(cmake, "-S", ".", "-B", "build", f"-DCMAKE_PREFIX_PATH={there}", folder=consumer)
    run(cmake, "--build", "build", folder=consumer)
    answered(consumer / "build" / "consumer")
    linked(consumer, next(there.rglob("pkgconfig")))
    answered(consumer / "linked", LD_LIBRARY_PATH=str(next(there.rglob("libelbow.*")).parent))


def linked(consumer: Path, where: Path) -> None:
    """Link the consumer as pkg-config says."""
    environment = {**os.environ, "PKG_CONFIG_PATH": str(where)}
    command = [tool("pkg-config"), "--cflags", "--libs", "elbow"]
    words = subprocess.run(
        command, capture_output=True, text=True, check=True, env=environment
    ).stdout
    subprocess.run(
        f"{CC} consumer.c {words.strip()} -o linked", shell=True, cwd=consumer, check=True
    )


def test_pkg_config_finds_the_library_where_it_was_generated(consumer):
    folder = shutil.copytree(made("elbow").directory, consumer / "the library")
    linked(consumer, folder)
    library_of(folder).unlink()
    answered(consumer / "linked")  # the static library is in it


def test_cmake_takes_the_other_options(tmp_path):
    cmake = tool("cmake")
    folder = made("elbow").directory
    run(cmake, "-S", folder, "-B", "b", "-DELBOW_NATIVE=ON", "-DELBOW_OPENMP=ON", folder=tmp_path)
    flags = (tmp_path / "b/CMakeFiles/flexgen_elbow.dir/flags.make").read_text()
    assert "-march=native" in flags and "-fopenmp" in flags and "-ffp-contract=off" not in flags
    unrolled = " ".join(line for line in flags.splitlines() if "-funroll-loops" in line)
    assert {name for name in ("inversion", "bias") if f"elbow_{name}.c" in unrolled} == {
        "inversion"
    }
    run(cmake, "-S", folder, "-B", "d", "-DCMAKE_BUILD_TYPE=Debug", folder=tmp_path)
    flags = (tmp_path / "d/CMakeFiles/flexgen_elbow.dir/flags.make").read_text()
    assert "-O2" not in flags and "-ffp-contract=off" in flags and "-funroll-loops" not in flags
    run(cmake, "-S", folder, "-B", "s", "-DCMAKE_BUILD_TYPE=MinSizeRel", folder=tmp_path)
    assert (
        "-funroll-loops"
        not in (tmp_path / "s/CMakeFiles/flexgen_elbow.dir/flags.make").read_text()
    )


@pytest.mark.slow
def test_a_plain_compiler_call_is_enough(tmp_path):
    run(
        CC,
        made("elbow").directory / "example.c",
        *sources(made("elbow").directory),
        "-lm",
        "-o",
        "example",
        folder=tmp_path,
    )
    assert "gravity: success" in run(tmp_path / "example", folder=tmp_path)


@pytest.mark.slow
def test_bytes_depend_on_no_folder(tmp_path, monkeypatch):
    functions = ["mass_matrix", "inverse_dynamics"]
    first = generate("elbow", tmp_path / "first", functions=functions)
    monkeypatch.setenv("FLEXGEN_CACHE", "")
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    monkeypatch.chdir(folder)
    again = generate("elbow", functions=functions)
    assert [path.name for path in again.files] == [path.name for path in first.files]
    for a, b in zip(again.files, first.files, strict=True):
        assert a.read_bytes() == b.read_bytes(), a.name
        assert (
            str(tmp_path).encode() not in a.read_bytes()
            and str(ROOT).encode() not in a.read_bytes()
        )


# --- symbols and warnings ------------------------------------------------------------------------
@pytest.mark.parametrize("level", ["-O0", "-O2"])
@pytest.mark.parametrize("compiler", ["gcc", pytest.param("clang", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", SMALL)
def test_the_library_exports_its_functions_and_needs_libc_only(name, compiler, level, tmp_path):
    nm = tool("nm")
    compiler = tool(compiler)
    run(
        compiler,
        "-std=c99",
        level,
        "-fvisibility=hidden",
        "-fPIC",
        "-c",
        *sources(made(name).directory),
        folder=tmp_path,
    )
    listed = run(nm, "-g", *sorted(tmp_path.glob("*.o")), folder=tmp_path).splitlines()
    defined = {line.split()[-1] for line in listed if re.search(r" [A-TV-Z] ", line)}
    assert defined == set(symbols(library_spec(derive(name))))
    headers = "".join(
        path.read_text(encoding="ascii") for path in made(name).directory.glob("*.h")
    )
    assert all(f"{symbol}(" in headers for symbol in defined)
    needed = (
        {line.split()[-1] for line in listed if " U " in line}
        - defined
        - {"_GLOBAL_OFFSET_TABLE_"}
    )
    assert needed <= BY_ITSELF
    assert all(word in headers for word in needed)


def test_the_static_library_has_the_same_symbols():
    folder = made("elbow").directory
    listed = run(tool("nm"), "-g", "--defined-only", folder / "libelbow.a", folder=folder)
    defined = {line.split()[-1] for line in listed.splitlines() if re.search(r" [A-TV-Z] ", line)}
    assert defined == set(symbols(library_spec(derive("elbow"))))


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_sources_compile_without_warnings(compiler, precision, tmp_path):
    for name in (
        "planar5_nmp",
        "elbow",
        *(("four_mass", "abb_arm") if precision == "double" else ()),
    ):
        folder = written(name, precision)
        run(
            tool(compiler),
            *STRICT,
            "-fsyntax-only",
            folder / "example.c",
            *sources(folder),
            folder=tmp_path,
        )
        if name == "elbow":  # some warnings need the optimiser
            run(
                tool(compiler),
                *STRICT,
                "-O2",
                "-c",
                folder / "example.c",
                *sources(folder),
                folder=tmp_path,
            )


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_sources_compile_as_cpp(compiler, tmp_path):
    for folder in (written("four_mass", "double"), written("elbow", "single")):
        run(tool(compiler), *STRICT_CPP, "-fsyntax-only", *sources(folder), folder=tmp_path)
        # the example names members
        newer = [*STRICT_CPP, "-std=c++20", "-Wno-missing-field-initializers"]
        run(tool(compiler), *newer, "-fsyntax-only", folder / "example.c", folder=tmp_path)


# --- calls of every kind -------------------------------------------------------------------------
def given(name: str, folder: Path) -> bytes:
    return clients.inputs_of(
        clients.manifest_of(folder), random_states(read(name), clients.POINTS)
    )


def has_sanitizer(compiler: str, flag: str, tmp_path: Path) -> None:
    (tmp_path / "probe.c").write_text("int main(void) { return 0; }\n")
    answer = subprocess.run(
        [compiler, flag, "probe.c", "-o", "probe"], cwd=tmp_path, capture_output=True, check=False
    )
    if answer.returncode != 0:
        pytest.skip(f"{compiler} has no {flag}; install the Debian package gcc")


SANITIZED = [("planar5_nmp", "double"), ("four_mass", "single"), ("elbow", "single")]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "precision"), SANITIZED)
def test_a_run_under_sanitizers_reports_nothing(name, precision, tmp_path):
    """Every function and its batch in odd numbers, exact and ill-aligned buffers, wrong calls,
    entries not finite.
    """
    gcc = tool("gcc")
    flags = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    has_sanitizer(gcc, flags[0], tmp_path)
    folder = written(name, precision)
    program = clients.built(folder, tmp_path, gcc, "-O0", "-g", "-ffp-contract=off", *flags)
    checked = clients.answer([str(program)], given(name, folder), tmp_path)
    plain = clients.built(folder, tmp_path / "plain", gcc, "-O2", "-ffp-contract=off")
    assert clients.answer([str(plain)], given(name, folder), tmp_path) == checked


@pytest.mark.full
def test_parameters_are_shared_by_all_points(tmp_path):
    """With the values of the model file as arguments: the same calls, and the results of the
    library without them.
    """
    gcc = tool("gcc")
    plain = made("elbow").directory
    has_sanitizer(gcc, "-fsanitize=address", tmp_path)
    folder = generate(
        "elbow", tmp_path / "with", parameters=["stiffness", "payload"], build=False
    ).directory
    assert any(
        port["name"] == "parameters"
        for f in clients.manifest_of(folder)["functions"]
        for port in f["inputs"]
    )
    data = given("elbow", folder)
    results = []
    for k, where in enumerate((folder, plain)):
        program = clients.built(
            where,
            tmp_path / str(k),
            gcc,
            "-O0",
            "-ffp-contract=off",
            "-fsanitize=address,undefined",
        )
        answer = clients.answer([str(program)], data, tmp_path)
        results.append(clients.results_of(clients.manifest_of(where), answer))
    for key, expected in results[1].items():
        scale = np.abs(expected).max(axis=1, keepdims=True) + np.abs(expected).max() * 1e-3
        assert np.all(np.abs(results[0][key] - expected) <= PARAMETER_ROUNDING * scale), key


@pytest.mark.slow
def test_sanitizers_find_a_planted_overflow(tmp_path):
    gcc = tool("gcc")
    has_sanitizer(gcc, "-fsanitize=address", tmp_path)
    folder = Path(shutil.copytree(made("elbow").directory, tmp_path / "elbow"))
    header = folder / "elbow_batch.h"
    text = header.read_text()
    # counted for vectors of eight, and this compiler uses two: an eighth is too little everywhere
    short = re.sub(r"(BATCH_WORK) (\d+)", lambda m: f"{m[1]} {int(m[2]) // 8}", text)
    assert short != text
    header.write_text(short)
    program = clients.built(folder, tmp_path, gcc, "-O0", "-fsanitize=address")
    answer = subprocess.run(
        [program], input=given("elbow", folder), capture_output=True, check=False
    )
    assert answer.returncode != 0 and b"heap-buffer-overflow" in answer.stderr


@pytest.mark.slow
def test_threads_do_not_disturb_each_other(tmp_path):
    gcc = tool("gcc")
    folder = made("elbow").directory
    has_sanitizer(gcc, "-fsanitize=thread", tmp_path)
    data = given("elbow", folder)
    alone = clients.built(folder, tmp_path / "alone", gcc, "-O0", "-ffp-contract=off")
    program = clients.built(
        folder, tmp_path, gcc, "-O0", "-g", "-ffp-contract=off", "-fsanitize=thread", threads=4
    )
    assert clients.answer([str(program)], data, tmp_path) == clients.answer(
        [str(alone)], data, tmp_path
    )


@pytest.mark.slow
def test_openmp_gives_the_same_bits(tmp_path):
    gcc = tool("gcc")
    folder = made("planar5_nmp").directory
    has_sanitizer(gcc, "-fopenmp", tmp_path)
    data = given("planar5_nmp", folder)
    alone = clients.built(folder, tmp_path / "alone", gcc, "-O0", "-ffp-contract=off")
    many = clients.built(
        folder, tmp_path, gcc, "-O0", "-ffp-contract=off", "-fopenmp", counts=(0, 1, 17, 300)
    )
    assert clients.answer([str(many)], data, tmp_path) == clients.answer(
        [str(alone)], data, tmp_path
    )


# --- examples ------------------------------------------------------------------------------------
@pytest.mark.slow
def test_the_controller_runs_at_one_kilohertz_against_the_library(tmp_path):
    folder = made("planar5_nmp").directory
    files = [ROOT / "examples" / "controller.c", *sources(folder)]
    run(CC, *STRICT, "-O0", f"-I{folder}", *files, "-lm", "-o", "controller", folder=tmp_path)
    lines = run(tmp_path / "controller", folder=tmp_path).splitlines()
    assert all(line.endswith(" mm") for line in lines)
    alone, fed = (float(line.split()[-2]) for line in lines)
    assert 5.0 < alone < 50.0 and 0.0 < fed < alone / 5.0


@pytest.mark.full
def test_two_models_live_in_one_cpp_program(tmp_path):
    cpp = shutil.which("c++") or tool("g++")
    folders = [made(name).directory for name in ("planar5_nmp", "elbow")]
    run(
        CC,
        "-std=c99",
        "-O1",
        "-c",
        *(path for folder in folders for path in sources(folder)),
        folder=tmp_path,
    )
    includes = [f"-I{folder}" for folder in folders]
    words = [
        cpp,
        "-std=c++17",
        "-Wall",
        "-Wextra",
        "-Wpedantic",
        "-Wconversion",
        "-Werror",
        *includes,
    ]
    run(
        *words,
        ROOT / "examples/two_models.cpp",
        *sorted(tmp_path.glob("*.o")),
        "-lm",
        "-o",
        "two",
        folder=tmp_path,
    )
    lines = run(tmp_path / "two", folder=tmp_path).splitlines()
    assert [line.split()[0] for line in lines] == ["planar5_nmp"] * 3 + ["elbow"] * 2
    angles = np.linspace(-np.pi, np.pi, 51)
    expected = []
    for folder in folders:
        library = load(folder)
        q = np.zeros((51 * 51, library.sizes["n_a"]))
        q[:, 0] = np.tile(angles, 51)
        q[:, 1] = np.repeat(angles, 51)
        expected += list(np.abs(library.gravity(q)).max(axis=0))
    # printed with two decimals
    assert np.allclose([float(line.split()[6]) for line in lines], expected, atol=0.006)
