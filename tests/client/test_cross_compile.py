"""Bits of the emitted C with every compiler, level and processor are equal; rounding differences
of the native build; code and stack for small machines.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import clients
import numpy as np
import pytest
from emitted import _folder, made, random_states, run, sources
from toolchain import needs_compiler, tools

from flexgen.codegen.build.generate import generate, generate_parts
from flexgen.model.reader import read
from flexgen.runtime import load

pytestmark = needs_compiler

M7 = "-mcpu=cortex-m7 -mfpu=fpv5-sp-d16 -mfloat-abi=hard".split()
# start and memory of the emulated board
MACHINE = Path(__file__).resolve().parents[1] / "support" / "cortex_m7"
SLOW = pytest.mark.slow
LIBRARIES = [
    ("planar5_nmp", "double"),
    pytest.param("abb_arm", "double", marks=SLOW),
    pytest.param("elbow", "single", marks=SLOW),
    ("four_mass", "single"),
]


def folder_of(name: str, precision: str) -> Path:
    """The folder with the sources of a library; these tests compile them with compilers and
    options of their own.
    """
    if precision == "double":
        return made(name).directory
    return generate(name, _folder() / f"{name}_single", precision=precision, build=False).directory


def states(name: str) -> dict[str, np.ndarray]:
    return random_states(read(name), clients.POINTS)


def missing(*tools: str) -> list[str]:
    return [tool for tool in tools if shutil.which(tool) is None]


def differences(folder: Path, a: bytes, b: bytes) -> list[str]:
    manifest = clients.manifest_of(folder)
    one = clients.results_of(manifest, a)
    two = clients.results_of(manifest, b)
    return [key for key in one if one[key].tobytes() != two[key].tobytes()]


# --- bits ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(("name", "precision"), LIBRARIES)
def test_every_target_gives_the_same_bits(name, precision, tmp_path):
    """Every function at random states, one by one and in batches of odd sizes (the program
    compares the two itself).
    """
    folder = folder_of(name, precision)
    given = clients.inputs_of(clients.manifest_of(folder), states(name))
    builds = [
        [cc, level, "-ffp-contract=off"]
        for cc in ("gcc", "clang")
        for level in ("-O0", "-O1", "-O2")
    ]
    builds.append(["gcc", "-O3", "-march=native", "-ffp-contract=off", "-fno-tree-vectorize"])
    builds.append(["gcc", "-O2", "-ffp-contract=off", f"-D{name.upper()}_NO_VECTORS"])
    builds.append(["aarch64-linux-gnu-gcc", "-O2", "-ffp-contract=off", "-static"])
    reference = b""
    compared = 0
    for k, words in enumerate(builds):
        emulator = ["qemu-aarch64"] if words[0].startswith("aarch64") else []
        if missing(words[0], *emulator):
            continue
        program = clients.built(folder, tmp_path / str(k), *words)
        answer = clients.answer([*emulator, str(program)], given, tmp_path)
        reference = reference or answer
        compared += 1
        assert answer == reference, (words, differences(folder, answer, reference))
    if compared < 2:
        pytest.skip("one compiler only; install the Debian package clang")


def test_planted_contraction_changes_the_bits(tmp_path):
    """The planted bug: with fused multiply-adds the bits are others, where the processor has
    them.
    """
    tools("aarch64-linux-gnu-gcc", "qemu-aarch64")
    folder = folder_of("planar5_nmp", "double")
    given = clients.inputs_of(clients.manifest_of(folder), states("planar5_nmp"))
    answers = []
    for contract in ("off", "fast"):
        program = clients.built(
            folder,
            tmp_path / contract,
            "aarch64-linux-gnu-gcc",
            "-O2",
            f"-ffp-contract={contract}",
            "-static",
            counts=(),
        )
        answers.append(clients.answer(["qemu-aarch64", str(program)], given, tmp_path))
    assert differences(folder, *answers)


@pytest.mark.parametrize("name", ["elbow", "four_mass"])
def test_a_cortex_m7_has_the_same_bits(name, tmp_path):
    """A bare machine without double precision, emulated: single precision, results through
    semihosting.
    """
    tools("arm-none-eabi-gcc", "qemu-system-arm", "gcc")
    folder = folder_of(name, "single")
    given = clients.inputs_of(clients.manifest_of(folder), states(name))
    board = [
        *M7,
        "--specs=rdimon.specs",
        "-T",
        str(MACHINE / "memory.ld"),
        str(MACHINE / "start.c"),
    ]
    program = clients.built(
        folder, tmp_path, "arm-none-eabi-gcc", *board, "-O2", "-ffp-contract=off", given=given
    )
    emulator = (
        "qemu-system-arm -M mps2-an500 -nographic -semihosting-config enable=on,target=native "
        "-kernel"
    ).split()
    answer = clients.answer([*emulator, str(program)], b"", tmp_path)
    here = clients.built(folder, tmp_path / "here", "gcc", "-O2", "-ffp-contract=off")
    assert answer == clients.answer([str(here)], given, tmp_path)


# --- the native build ----------------------------------------------------------------------------
OPERATIONS = re.compile(r"(\d+) operations")
STEP = 2.0**-30  # relative change of the inputs that tells how much the results amplify an error


@pytest.mark.parametrize(
    "name", ["planar5_nmp", "abb_arm", pytest.param("manutec_r3", marks=SLOW)]
)
def test_the_native_build_differs_by_rounding(name):
    """N operations that round otherwise: N eps times the result and what a relative error of the
    inputs becomes.
    """
    reproducible = load(made(name).directory)
    used = list(reproducible.functions)
    # without the solvers, which take longer to compile than all functions
    folder = _folder() / f"{name}_native"
    native = load(
        generate_parts(
            read(name), folder, used, (), native=True, progress=lambda text: None
        ).directory
    )
    x = states(name)
    rng = np.random.default_rng(3)
    moved = {
        key: value * (1 + STEP * rng.choice([-1.0, 1.0], size=value.shape))
        for key, value in x.items()
    }
    header = (made(name).directory / f"{name}.h").read_text(encoding="ascii")
    operations = [int(count) for count in OPERATIONS.findall(header)]
    for function, count in zip(reproducible.functions.values(), operations, strict=True):
        inputs = [x[port.name] for port in function.inputs]
        expected, given = (
            _flat(library.functions[function.name](*inputs)) for library in (reproducible, native)
        )
        shifted = _flat(function(*(moved[port.name] for port in function.inputs)))
        amplified = np.abs(shifted - expected).max(axis=1) / STEP
        bound = count * np.finfo(float).eps * (np.abs(expected).max(axis=1) + amplified)
        assert np.all(np.abs(given - expected).max(axis=1) <= bound), function.name


def _flat(results) -> np.ndarray:
    """All results of each point in one row."""
    arrays = results if isinstance(results, tuple) else (results,)
    return np.hstack([np.asarray(array).reshape(len(array), -1) for array in arrays])


# --- small machines ------------------------------------------------------------------------------
TARGETS = {
    "x86-64": ("gcc", []),
    "aarch64": ("aarch64-linux-gnu-gcc", []),
    "Cortex-M7": ("arm-none-eabi-gcc", M7),
}


@pytest.mark.parametrize("name", ["elbow", "four_mass", "manutec_r3"])
def test_single_precision_code_has_no_double_operations(name, tmp_path):
    tools("arm-none-eabi-gcc", "arm-none-eabi-nm")
    files = sources(folder_of(name, "single"))
    run(
        "arm-none-eabi-gcc",
        *M7,
        "-std=c99",
        "-O2",
        "-Wdouble-promotion",
        "-Werror",
        "-c",
        *files,
        folder=tmp_path,
    )
    needed = run("arm-none-eabi-nm", "-u", *sorted(tmp_path.glob("*.o")), folder=tmp_path)
    needed = {line.split()[-1] for line in needed.splitlines() if " U " in line}
    # the last one divides sizes, 64-bit integers
    allowed = {"memset", "memcpy", "memmove", "__aeabi_ldivmod"}
    assert {symbol for symbol in needed if not symbol.startswith(f"{name}_")} <= allowed


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize(
    ("name", "precision"),
    [("planar5_nmp", "double"), ("four_mass", "single"), ("manutec_r3", "single")],
)
def test_the_stack_of_the_header_is_sufficient(name, precision, target, tmp_path):
    """Stack of each function of a point as computed by the compiler, its callees included: at most
    the figure in the header.
    """
    compiler, flags = TARGETS[target]
    tools(compiler)
    if target == "Cortex-M7" and precision == "double":
        pytest.skip("a Cortex-M7 of single precision")
    folder = folder_of(name, precision)
    run(
        compiler,
        *flags,
        "-std=c99",
        "-O2",
        "-ffp-contract=off",
        "-fstack-usage",
        "-c",
        *clients.point_sources(folder),
        folder=tmp_path,
    )
    # lines of a comment
    manual = (folder / f"{name}.h").read_text(encoding="ascii").replace("\n * ", " ")
    pattern = (
        rf"stack of one point at most (\d+) bytes\s+\*/\s+\w+_API\s+{name}_status {name}_(\w+)\("
    )
    said = re.findall(pattern, manual)
    said = {function: int(size) for size, function in said}
    functions = clients.manifest_of(folder)["functions"]
    assert set(said) == {f["name"] for f in functions}
    used = {
        f["name"]: clients.stack_of_point(
            tmp_path / f"{name}_{f['name']}.su", f"{name}_{f['name']}"
        )
        for f in functions
    }
    assert all(used[function] <= said[function] for function in said), (used, said)
    assert max(used.values()) > 0


def test_the_board_has_a_linker_script_and_start_code_that_compiles():
    assert {path.name for path in MACHINE.iterdir()} == {"memory.ld", "start.c"}
    if not missing("arm-none-eabi-gcc"):
        subprocess.run(
            ["arm-none-eabi-gcc", *M7, "-fsyntax-only", "-Wall", str(MACHINE / "start.c")],
            check=True,
        )
