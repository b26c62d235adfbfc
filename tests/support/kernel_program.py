"""A C program around the kernel: it reads numbers, applies one of the kernel's functions and
writes the results.
"""

from __future__ import annotations

import atexit
import math
import os
import platform
import shutil
import subprocess
import tempfile
from functools import cache
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from kernel_constants import PRECISIONS

from flexgen.codegen.emission.clib_files import kernel_files

NAME = "robot"
TYPES = {"double": np.float64, "single": np.float32}
C_TYPES = {"double": "double", "single": "float"}
BITS = {"double": np.uint64, "single": np.uint32}
STRICT = (
    "-pedantic -Wall -Wextra -Wconversion -Wsign-conversion -Wshadow -Wdouble-promotion "
    "-Wunused -Werror"
).split()

OWN_OF_ONE = "exp tanh sin cos fabs floor ceil sign not".split()
OWN_OF_TWO = "copysign fmin fmax lt le eq ne and or if_else_zero".split()
LIBM_OF_ONE = "sqrt log expm1 log1p erf tan asin acos atan sinh cosh asinh acosh atanh".split()
LIBM_OF_TWO = "atan2 pow fmod remainder hypot".split()

# Reads numbers, a multiple of 32; writes the results of the form for one number, then those of the
# form for vectors.
_PROGRAM = """\
#include "robot_kernel.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define OF_ONE(f) \\
    if (!strcmp(name, #f)) { \\
        for (int i = 0; i < n; ++i) { y[i] = f##_1(x[i]); } \\
        for (int i = 0; i < n; i += LANES) { store_v(y + n + i, f##_v(load_v(x + i))); } \\
        length = 2 * n; \\
    }
#define OF_TWO(f) \\
    if (!strcmp(name, #f)) { \\
        const int h = n / 2; \\
        for (int i = 0; i < h; ++i) { y[i] = f##_1(x[i], x[h + i]); } \\
        for (int i = 0; i < h; i += LANES) { store_v(y + h + i, f##_v(load_v(x + i), load_v(x + h \
+ i))); } \\
        length = 2 * h; \\
    }

static real mixed(const real x)
{
    return TWO_AND_A_HALF * x + splat_1(1);
}

static int apply(const char *name, const real *x, real *y, const int n)
{
    int length = 0;
    if (!strcmp(name, "sincos")) { /* by numbers, sine then cosine; by vectors */
        for (int i = 0; i < n; ++i) { sine_cosine_1(x[i], y + i, y + n + i); }
        sincos_1(x, y + 2 * n, y + 3 * n, n);
        length = 4 * n;
    }
    if (!strcmp(name, "sincos_few")) { /* six by six, and by vectors of angles */
        for (int i = 0; i + 31 < n; i += 32) {
            real few[PADDED(6)], s[PADDED(6)], c[PADDED(6)];
            for (int k = 0; k < (int)PADDED(6); ++k) { few[k] = k < 6 ? x[i + k] : splat_1(0); }
            sincos_1(few, s, c, 6);
            for (int k = 0; k < 6; ++k) { y[i + k] = s[k]; y[n + i + k] = c[k]; }
            for (int k = 6; k < 32; ++k) { y[i + k] = y[n + i + k] = splat_1(0); }
        }
        sincos_v((const lanes *)x, (lanes *)(y + 2 * n), (lanes *)(y + 3 * n), n / LANES);
        length = 4 * n;
    }
    if (!strcmp(name, "select")) {
        const int h = n / 2;
        for (int i = 0; i < h; ++i) { y[i] = select_1(x[i], x[h + i], mixed(x[h + i])); }
        for (int i = 0; i < h; i += LANES) {
            const lanes a = load_v(x + h + i);
            store_v(y + h + i, select_v(load_v(x + i), a, TWO_AND_A_HALF * a + splat_v(1)));
        }
        length = 2 * h;
    }
    FUNCTIONS
    return length;
}

static int run(const char *name, const int n)
{
    const size_t size = sizeof(real) * (size_t)n;
    real *x = (real *)malloc(size);
    real *y = (real *)malloc(4 * size);
    int length = 0;
    if (x && y && fread(x, sizeof(real), (size_t)n, stdin) == (size_t)n) {
        length = apply(name, x, y, n);
        if (length > 0 && fwrite(y, sizeof(real), (size_t)length, stdout) != (size_t)length) { \
length = 0; }
    }
    free(x);
    free(y);
    return length > 0;
}

int main(int argc, char **argv)
{
    for (int i = 1; i + 1 < argc; i += 2) {
        if (!run(argv[i], atoi(argv[i + 1]))) { return 1; }
    }
    return 0;
}
"""

_numbers = count()


@cache
def _folder() -> Path:
    folder = tempfile.mkdtemp(prefix="flexgen-kernel-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def written(precision: str, edits: tuple[tuple[str, str], ...] = ()) -> Path:
    """A folder with the headers and ``main.c``; every edit is a text of the kernel and its
    replacement.
    """
    folder = _folder() / f"{precision}{next(_numbers)}"
    folder.mkdir()
    texts = kernel_files(NAME, precision)
    for old, new in edits:
        assert any(old in text for text in texts.values()), f"the kernel has no {old!r}"
        texts = {file: text.replace(old, new) for file, text in texts.items()}
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="ascii")
    guard = "#ifndef ROBOT_H\n#define ROBOT_H\n%s\n#endif\n"
    (folder / f"{NAME}.h").write_text(
        guard % f"typedef {C_TYPES[precision]} {NAME}_real;", encoding="ascii"
    )
    calls = [f"OF_ONE({f})" for f in OWN_OF_ONE + LIBM_OF_ONE] + [
        f"OF_TWO({f})" for f in OWN_OF_TWO + LIBM_OF_TWO
    ]
    program = _PROGRAM.replace("FUNCTIONS", "\n    ".join(calls))
    program = program.replace("TWO_AND_A_HALF", "2.5f" if precision == "single" else "2.5")
    (folder / "main.c").write_text(program, encoding="ascii")
    return folder


def compiled(compiler: str, flags: tuple[str, ...], folder: Path) -> Path:
    """The program; the test fails with the compiler's words where there are any."""
    program = folder / f"program{next(_numbers)}"
    language = ["-std=c++17"] if "++" in compiler else ["-std=c99"]
    source = ["-x", "c++", "main.c"] if "++" in compiler else ["main.c"]
    command = [compiler, *language, "-ffp-contract=off", *flags, *source]
    if "-fsyntax-only" not in flags:
        command += ["-o", str(program), "-lm"]
    answer = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert answer.returncode == 0 and not answer.stderr, (
        " ".join(command) + "\n" + answer.stderr[:4000]
    )
    return program


def applied(
    program: Path, precision: str, inputs: dict[str, np.ndarray], under: tuple[str, ...] = ()
) -> dict[str, np.ndarray]:
    """The results of one or more functions, in one call of the program.

    Parameters
    ----------
    program : Path
        What ``compiled`` gave.
    precision : str
        ``double`` or ``single``.
    inputs : dict of str to array
        For every function its arguments, shape (n,) or (2, n).
    under : tuple of str
        An emulator.

    Returns
    -------
    dict of str to array
        For every function the results by numbers and by vectors, shape (2, n); for ``sincos`` (2,
        2, n).
    """
    arguments: list[str] = []
    blob = b""
    sizes = []
    for name, x in inputs.items():
        flat = np.atleast_2d(np.asarray(x, TYPES[precision]))
        padded = np.zeros((flat.shape[0], -(-flat.shape[1] // 32) * 32), TYPES[precision])
        padded[:, : flat.shape[1]] = flat
        arguments += [name, str(padded.size)]
        blob += padded.tobytes()
        forms = (2, 2) if name.startswith("sincos") else (2,)
        sizes.append((*forms, padded.shape[1], flat.shape[1]))
    answer = subprocess.run(
        [*under, str(program), *arguments], input=blob, capture_output=True, check=True
    )
    y = np.frombuffer(answer.stdout, TYPES[precision])
    out: dict[str, np.ndarray] = {}
    for name, (*forms, length, n) in zip(inputs, sizes, strict=True):
        size = int(np.prod(forms)) * length
        out[name] = y[:size].reshape(*forms, length)[..., :n]
        y = y[size:]
    assert y.size == 0
    return out


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two arrays hold the same bits; every NaN counts as the same."""
    pattern = np.uint64 if a.dtype == np.float64 else np.uint32
    return bool(np.all((a.view(pattern) == b.view(pattern)) | (np.isnan(a) & np.isnan(b))))


def widths() -> dict[str, tuple[str, ...]]:
    """Flags for every width of vector that this processor can run."""
    flags: dict[str, tuple[str, ...]] = {"number": (f"-D{NAME.upper()}_NO_VECTORS",), "16": ()}
    path = Path("/proc/cpuinfo")
    known = path.read_text().split() if path.exists() and platform.machine() == "x86_64" else []
    if "avx" in known:
        flags["32"] = ("-mavx",)
    if "avx512f" in known:
        flags["64"] = ("-mavx512f",)
    return flags


COMPILERS = [
    name
    for name in ("gcc", "clang", "g++", "clang++")
    if os.name == "posix" and shutil.which(name)
]
COMPILER = next((name for name in COMPILERS if "+" not in name), None)
needs_compiler = pytest.mark.skipif(
    COMPILER is None, reason="neither gcc nor clang; install the Debian package gcc"
)
needs_long_double = pytest.mark.skipif(
    np.finfo(np.longdouble).nmant < 60, reason="long double is double here"
)
both = pytest.mark.parametrize("precision", ["double", "single"])
POINTS = 100_000


@cache
def program(precision: str, edits: tuple[tuple[str, str], ...] = ()) -> Path:
    """The program with the widest vectors of this processor."""
    assert COMPILER is not None
    return compiled(COMPILER, ("-O1", *list(widths().values())[-1]), written(precision, edits))


def error(y: np.ndarray, exact: np.ndarray) -> float:
    """The largest error in units of the last place of the exact value."""
    place = np.spacing(np.abs(exact.astype(y.dtype))).astype(exact.dtype)
    return float(np.max(np.abs(y.astype(exact.dtype) - exact) / place))


def angles(precision: str) -> dict[str, np.ndarray]:
    """[rad] a few turns, the whole range, and small angles down to the smallest numbers."""
    rng = np.random.default_rng(7)
    limit = PRECISIONS[precision].angle
    lowest = float(np.log10(np.finfo(TYPES[precision]).smallest_subnormal))
    sets = {
        "turns": rng.uniform(-2.0 * np.pi, 2.0 * np.pi, POINTS),
        "range": rng.uniform(-limit, limit, POINTS),
        "powers": rng.choice([-1.0, 1.0], POINTS)
        * 10.0 ** rng.uniform(-8.0, math.log10(limit), POINTS),
        "tiny": 10.0 ** rng.uniform(lowest, -3.0, 1000),
    }
    return {name: x.astype(TYPES[precision]) for name, x in sets.items()}
