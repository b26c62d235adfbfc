"""The private header of the emitted C under every compiler: silent, the same bits, no library, no
other precision.
"""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from kernel_constants import ERRORS
from kernel_program import (
    COMPILER,
    OWN_OF_ONE,
    OWN_OF_TWO,
    STRICT,
    TYPES,
    angles,
    applied,
    both,
    compiled,
    error,
    needs_compiler,
    needs_long_double,
    program,
    same_bits,
    widths,
    written,
)
from toolchain import tools

LEVELS = ("-O0", "-O1", "-O2", "-O3")


def inputs(precision: str) -> dict[str, np.ndarray]:
    """Arguments for every function that is ours."""
    dtype = TYPES[precision]
    special = [0.0, -0.0, np.inf, -np.inf, np.nan, 1e30, -1e30, 1e-40, 710.0, -746.0, 88.8, -103.5]
    x = np.concatenate([np.array(special, dtype), *(v[:400] for v in angles(precision).values())])
    spread = np.concatenate([x, np.random.default_rng(5).uniform(-100, 100, 500).astype(dtype)])
    pairs = np.array([spread, spread[::-1]])
    return {name: spread for name in ("sincos", "sincos_few", *OWN_OF_ONE)} | {
        name: pairs for name in ("select", *OWN_OF_TWO)
    }


@cache
def expected(precision: str) -> dict[str, np.ndarray]:
    return applied(program(precision), precision, inputs(precision))


def check(precision: str, path: Path, under: tuple[str, ...] = ()) -> None:
    given = inputs(precision)
    got = applied(path, precision, given, under)
    for name, y in got.items():
        assert same_bits(y, expected(precision)[name]), name
        if name != "sincos_few":
            assert same_bits(y[0], y[1]), name
    few = np.arange(given["sincos"].size) % 32 < 6
    assert same_bits(got["sincos_few"][0][:, few], got["sincos"][0][:, few])
    assert same_bits(got["sincos_few"][1], got["sincos"][1])


@needs_compiler
@both
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_same_bits_from_every_compiler(precision, compiler):
    tools(compiler)
    folder = written(precision)
    for level, width in zip(LEVELS, widths().values(), strict=False):
        check(precision, compiled(compiler, (level, *width, *STRICT), folder))


@needs_compiler
@pytest.mark.slow
@both
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_same_bits_from_every_compiler_level_and_width(precision, compiler):
    tools(compiler)
    folder = written(precision)
    for level in LEVELS:
        for width in widths().values():
            check(precision, compiled(compiler, (level, *width, *STRICT), folder))


@needs_compiler
@both
def test_same_bits_on_aarch64(precision):
    tools("aarch64-linux-gnu-gcc", "qemu-aarch64")
    path = compiled("aarch64-linux-gnu-gcc", ("-O2", "-static"), written(precision))
    check(precision, path, ("qemu-aarch64",))


@needs_compiler
@needs_long_double
@both
def test_contracted_products_stay_exact(precision):
    assert COMPILER is not None
    path = compiled(COMPILER, ("-O2", "-march=native", "-ffp-contract=fast"), written(precision))
    wide = np.longdouble if precision == "double" else np.float64
    x = angles(precision)["range"]
    (s, c), _ = applied(path, precision, {"sincos": x})["sincos"]
    assert error(s, np.sin(x.astype(wide))) <= ERRORS["sincos"]
    assert error(c, np.cos(x.astype(wide))) <= ERRORS["sincos"]


@needs_compiler
@both
@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_strict_compilers_of_cpp_are_silent(precision, compiler):
    tools(compiler)
    check(precision, compiled(compiler, ("-O1", *STRICT), written(precision)))
    compiled(compiler, ("-fsyntax-only", *STRICT, *widths()["number"]), written(precision))


@needs_compiler
def test_fast_mathematics_is_refused():
    assert COMPILER is not None
    command = [COMPILER, "-ffast-math", "-fsyntax-only", "main.c"]
    answer = subprocess.run(
        command, cwd=written("double"), capture_output=True, text=True, check=False
    )
    assert answer.returncode != 0 and "compile without -ffast-math" in answer.stderr


OWN_ONLY = """\
#include "robot_kernel.h"
void all(const real *x, real *y);
void all(const real *x, real *y)
{
    sincos_1(x, y, y + 32, 6);
    sincos_v((const lanes *)x, (lanes *)y, (lanes *)(y + 32), 1);
    store_v(y, exp_v(load_v(x)) + tanh_v(load_v(x)) + floor_v(load_v(x)) + fmin_v(load_v(x), \
load_v(x + 1)));
    y[0] = exp_1(x[0]) + tanh_1(x[0]) + ceil_1(x[0]) + fmax_1(x[0], x[1]) + sin_1(x[0]) + \
cos_1(x[1]) + sign_1(x[2]);
}
"""


def undefined(compiler: str, flags: list[str], folder: Path) -> set[str]:
    """The symbols that the functions of our own need from elsewhere."""
    (folder / "own.c").write_text(OWN_ONLY, encoding="ascii")
    subprocess.run(
        [compiler, "-std=c99", *flags, "-c", "own.c", "-o", "own.o"], cwd=folder, check=True
    )
    answer = subprocess.run(
        ["nm", "-u", "own.o"], cwd=folder, capture_output=True, text=True, check=True
    )
    return {line.split()[-1] for line in answer.stdout.splitlines()} - {"_GLOBAL_OFFSET_TABLE_"}


@needs_compiler
@both
def test_own_functions_need_no_library(precision):
    assert COMPILER is not None
    for level in ("-O0", "-O2"):
        for width in widths().values():
            assert undefined(COMPILER, [level, *width], written(precision)) == set()


def test_single_precision_needs_no_double():
    tools("arm-none-eabi-gcc")
    processor = (
        "-mcpu=cortex-m7 -mfpu=fpv5-sp-d16 -mfloat-abi=hard -mthumb -ffreestanding -O2".split()
    )
    assert undefined("arm-none-eabi-gcc", processor, written("single")) == set()
    assert any(
        "__aeabi_d" in name
        for name in undefined("arm-none-eabi-gcc", processor, written("double"))
    )
