"""The kernel's sine and cosine, exp and tanh against the mathematical library's, in one run.

    python benchmarks/kernel.py [COMPILER ...]

prints ns per call and how many times faster than the library the kernel is. A latency is a chain
of calls, each of which needs the result of the one before, as one evaluation of a robot does; the
rest is what follows without waiting. Compare the ratios, not the times.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from flexgen.codegen.emission.clib_files import kernel_files

FLAGS = ("-O2", "-O2 -mavx2", "-O2 -march=native")
ANGLES = (1, 6, 18)

PROGRAM = """\
#define _GNU_SOURCE
#include "robot_kernel.h"
#include <stdio.h>
#include <time.h>

#define CALLS 2000
#define SEPARATE static __attribute__((noinline))

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

typedef void function(const double *q, double *y);

static double time_of(function *f, int chained, int per)
{
    double q[64], y[64], best = 1e9;
    for (int i = 0; i < 64; ++i) { q[i] = y[i] = 0.1 + 0.01 * i; }
    for (int k = 0; k < 200; ++k) {
        const double began = now();
        for (int i = 0; i < CALLS; ++i) { f(q, chained ? q : y); }
        const double ended = (now() - began) / CALLS / per;
        if (ended < best) { best = ended; }
    }
    return best;
}

static void row(const char *name, function *own, function *library, int per)
{
    printf("%-26s", name);
    for (int chained = 1; chained >= 0; --chained) {
        const double a = time_of(own, chained, per), b = time_of(library, chained, per);
        printf("%8.1f%8.1f%8.1f", a, b, b / a);
    }
    printf("\\n");
}

SEPARATE void own_tanh(const double *q, double *y) { y[0] = tanh_1(q[0]); }
SEPARATE void library_tanh(const double *q, double *y) { y[0] = tanh(q[0]); }
SEPARATE void own_exp(const double *q, double *y) { y[0] = exp_1(-q[0]); }
SEPARATE void library_exp(const double *q, double *y) { y[0] = exp(-q[0]); }
SEPARATE void own_tanh_lanes(const double *q, double *y) { store_v(y, tanh_v(load_v(q))); }
SEPARATE void own_exp_lanes(const double *q, double *y) { store_v(y, exp_v(-load_v(q))); }
"""


def sines(n: int) -> str:
    """Two functions of n angles that are sums, as a robot's are; results that need all sines and
    cosines.
    """
    angles = " ".join(f"x[{i}] = q[{(5 * i + 2) % n}] + {0.1 * i + 0.05:.2f};" for i in range(n))
    uses = " ".join(f"y[{i}] = 0.5 * s[{i}] + 0.25 * c[{n - 1 - i}];" for i in range(n))
    calls = " ".join(f"sincos(x[{i}], s + {i}, c + {i});" for i in range(n))
    arrays = f"double x[PADDED({n})], s[PADDED({n})], c[PADDED({n})];"
    zeros = f"for (int i = {n}; i < (int)PADDED({n}); ++i) {{ x[i] = 0.0; }}"
    heads = [
        f"SEPARATE void {name}_{n}(const double *q, double *y)" for name in ("own", "library")
    ]
    own = f"{heads[0]} {{ {arrays} {angles} {zeros} sincos_1(x, s, c, {n}); {uses} }}\n"
    return own + f"{heads[1]} {{ {arrays} {angles} {calls} {uses} }}\n"


def program() -> str:
    """The text of the program that prints one table."""
    rows = [f'row("sin and cos of {n}", own_{n}, library_{n}, 1);' for n in ANGLES]
    rows += [f'row("{f}", own_{f}, library_{f}, 1);' for f in ("tanh", "exp")]
    # lanes: the library's time is that of one number, so that both columns are per number
    main = "int main(void)\n{\n    " + "\n    ".join(rows)
    for f in ("tanh", "exp"):
        main += f'\n    printf("%-26s%8s%8s%8s%8.2f\\n", "{f} in lanes, per number", "", "", "", '
        main += f"time_of(own_{f}_lanes, 0, LANES));"
    return PROGRAM + "".join(map(sines, ANGLES)) + main + "\n    return 0;\n}\n"


def main() -> None:
    """Compile and run with every compiler and set of flags."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in kernel_files("robot", "double").items():
            (folder / file).write_text(text, encoding="ascii")
        (folder / "robot.h").write_text("typedef double robot_real;\n", encoding="ascii")
        (folder / "main.c").write_text(program(), encoding="ascii")
        for compiler in sys.argv[1:] or ["gcc"]:
            for flags in FLAGS:
                command = [
                    compiler,
                    *flags.split(),
                    "-ffp-contract=off",
                    "main.c",
                    "-o",
                    "program",
                    "-lm",
                ]
                subprocess.run(command, cwd=folder, check=True)
                print(
                    "\n"
                    f"{compiler} {flags}   ns: latency own, library, ratio; without waiting "
                    "own, library, ratio"
                )
                print(
                    subprocess.run(
                        [folder / "program"], capture_output=True, text=True, check=True
                    ).stdout,
                    end="",
                )


if __name__ == "__main__":
    main()
