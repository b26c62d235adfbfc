"""Batches of all point functions against a loop of single calls that writes the same arrays.

    python benchmarks/batches/measure.py [MODEL ...] [--quick]

For each function and number of points one program calls both in turn on one core. The loop copies the inputs of a
point, calls the function and copies its results to the structure of arrays, as a caller without a batch would: point
by point, or 16 points at a time, whichever is faster. The table of minimum times goes to benchmarks/batches/batches.md,
unless models are named. Compare the ratios.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from math import prod
from pathlib import Path
from typing import Any

import flexgen

HERE = Path(__file__).resolve().parent
ROBOTS = HERE.parents[1] / "tests" / "support" / "robots"
CC = os.environ.get("CC", "cc")
ISAS = ("native", "x86-64-v3", "x86-64")  # instruction sets of the default build
MODELS = ("planar5_nmp", "manutec_r3_24", "manutec_r3_30", str(ROBOTS / "ur5_elastic.toml"))
COUNTS = (8, 200, 4000, 4096)  # the last a power of two, where all arrays use the same cache sets
MEMORY = 30000  # points, of functions with few results: beyond the cache
BIG = 4 << 20  # bytes of results of 4000 points

PROGRAM = """\
#define _POSIX_C_SOURCE 200809L
#include "NAME_batch.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double *memory(size_t reals)
{
    double *x = aligned_alloc(64, (reals * sizeof(double) + 63) / 64 * 64);
    if (x == NULL) { exit(2); }
    memset(x, 0, reals * sizeof(double));
    return x;
}

static double *random_numbers(size_t reals)
{
    double *x = memory(reals);
    static unsigned long long state = 88172645463325252ULL;
    for (size_t i = 0; i < reals; ++i) {
        state ^= state << 13; state ^= state >> 7; state ^= state << 17;
        x[i] = (double)(state >> 11) / 9007199254740992.0 - 0.5;
    }
    return x;
}

#define TILE 16
#define BLOCKS %(blocks)d
#define SECONDS %(seconds)g
#define BEST(best, statement) do { const double began = now(); long r = 0; \\
    do { statement; ++r; } while (now() - began < SECONDS); \\
    const double took = (now() - began) / (double)r; if (took < best) { best = took; } } while (0)

static double *work, *one;
"""


def sizes(ports: list[dict[str, Any]]) -> list[tuple[str, int]]:
    """Name and number of entries of each array."""
    return [(port["name"], prod(port["shape"])) for port in ports]


def body(name: str, function: dict[str, Any]) -> str:
    """The loop, and the function that times both for a number of points."""
    f = function["name"]
    inputs, outputs = sizes(function["inputs"]), sizes(function["outputs"])
    arrays = [*inputs, *outputs]
    arguments = (
        ", ".join(f"const double *{x}" for x, _ in inputs)
        + ", "
        + ", ".join(f"double *{x}" for x, _ in outputs)
    )
    names = ", ".join(x for x, _ in arrays)
    points = " ".join(f"double one_{x}[{size}];" for x, size in arrays)
    gather = " ".join(
        f"for (int i = 0; i < {s}; ++i) {{ one_{x}[i] = {x}[(size_t)i * n + k]; }}"
        for x, s in inputs
    )
    scatter = " ".join(
        f"for (int i = 0; i < {s}; ++i) {{ {x}[(size_t)i * n + k] = one_{x}[i]; }}"
        for x, s in outputs
    )
    given = ", ".join(f"one_{x}" for x, _ in arrays) + (", one" if function["work"] else "")
    tiles = ", ".join(f"tile_{x}[TILE * {size}]" for x, size in arrays)
    given_tile = ", ".join(f"tile_{x} + k * {size}" for x, size in arrays) + (
        ", one" if function["work"] else ""
    )
    rows = "for (int i = 0; i < {s}; ++i) {{ for (int k = 0; k < count; ++k) {{ {copy} }} }}"
    there, here = "{x}[(size_t)i * n + first + k]", "tile_{x}[k * {s} + i]"
    gather_tile, scatter_tile = (
        " ".join(rows.format(s=s, copy=f"{to} = {of};".format(x=x, s=s)) for x, s in ports)
        for ports, to, of in ((inputs, here, there), (outputs, there, here))
    )
    made = " ".join(f"double *{x} = random_numbers({s} * (size_t)n);" for x, s in inputs)
    made += " ".join(
        f"double *{x} = memory({s} * (size_t)n), *{x}_loop = memory({s} * (size_t)n);"
        for x, s in outputs
    )
    loop_names = ", ".join([*(x for x, _ in inputs), *(f"{x}_loop" for x, _ in outputs)])
    same = " && ".join(
        f"memcmp({x}, {x}_loop, {s} * (size_t)n * sizeof(double)) == 0" for x, s in outputs
    )
    free = " ".join(f"free({x});" for x, _ in inputs) + " ".join(
        f"free({x}); free({x}_loop);" for x, _ in outputs
    )
    return f"""
static __attribute__((noinline)) int loop_{f}(int n, {arguments})
{{
    int status = 0;
    {points}
    for (int k = 0; k < n; ++k) {{ {gather} status |= {name}_{f}({given}); {scatter} }}
    return status;
}}

static __attribute__((noinline)) int tiles_{f}(int n, {arguments})
{{
    int status = 0;
    static double {tiles};
    for (int first = 0; first < n; first += TILE) {{
        const int count = n - first < TILE ? n - first : TILE;
        {gather_tile}
        for (int k = 0; k < count; ++k) {{ status |= {name}_{f}({given_tile}); }}
        {scatter_tile}
    }}
    return status;
}}

static void time_{f}(int n)
{{
    double loop = 1e9, tiles = 1e9, batch = 1e9;
    {made}
    if (loop_{f}(n, {loop_names}) != 0 || {name}_{f}_batch(n, {names}, work) != 0) {{ exit(3); }}
    const int equal = {same};
    for (int k = 0; k < BLOCKS; ++k) {{
        BEST(loop, loop_{f}(n, {loop_names}));
        BEST(tiles, tiles_{f}(n, {loop_names}));
        BEST(batch, {name}_{f}_batch(n, {names}, work));
    }}
    printf("{f} %d %.6g %.6g %.6g %d\\n", n, 1e9 * loop / n, 1e9 * tiles / n, 1e9 * batch / n, equal);
    fflush(stdout);
    {free}
}}
"""


def measure(model: str, folder: Path, quick: bool, isa: str) -> list[tuple[str, int, float, float]]:
    """Function, number of points, ns per point of the loop and of the batch, for all functions of a model."""
    made = flexgen.generate(model, folder / Path(model).stem, isa=isa)
    manifest = json.loads((made.directory / "manifest.json").read_text())
    name, functions = manifest["name"], manifest["functions"]
    text = PROGRAM.replace("NAME", name) % {"blocks": 7 if quick else 31, "seconds": 2e-3}
    calls = ""
    for function in functions:
        text += body(name, function)
        results = sum(size for _, size in sizes(function["outputs"]))
        counts = COUNTS if results * 4000 * 8 > BIG else (*COUNTS, MEMORY)
        calls += "".join(f"    time_{function['name']}({n});\n" for n in counts)
    text += f"\nint main(void)\n{{\n    work = memory({name}_batch_work());\n    one = memory({name}_work() + 1);\n"
    text += f"{calls}    return 0;\n}}\n"
    source = made.directory / "batches.c"
    source.write_text(text)
    program = made.directory / "batches"
    library = next(made.directory.glob("*.a"))
    flags = ["-std=c11", "-O2", "-march=native", "-ffp-contract=off", "-fno-tree-vectorize"]
    command = [
        CC,
        *flags,
        f"-I{made.directory}",
        str(source),
        str(library),
        "-lm",
        "-o",
        str(program),
    ]
    subprocess.run(command, check=True)
    ran = subprocess.run([str(program)], check=True, capture_output=True, text=True)
    rows = []
    for line in ran.stdout.splitlines():
        function_name, n, loop, tiles, batch, equal = line.split()
        if equal != "1":
            raise SystemExit(f"{model}, {function_name}: batch and loop differ")
        rows.append((function_name, int(n), min(float(loop), float(tiles)), float(batch)))
    return rows


def table(rows: list[tuple[str, str, str, int, float, float]]) -> str:
    """The smallest ratio of each model, instruction set and number of points, with its function."""
    counts = (*COUNTS, MEMORY)
    lines = [
        "# Batches against loops of single calls",
        "",
        "`python benchmarks/batches/measure.py` writes this file. Time of a loop of single calls that writes the same",
        "arrays, divided by the time of the batch: the smallest ratio over all point functions of the library, and its",
        "function. Minimum times of one run in which both alternate; above 1 the batch is faster. Up to half a vector",
        "of points, a batch calls the function for one point; its checks cost some nanoseconds more than a loop.",
        "",
        f"- machine: {platform.machine()}, {os.cpu_count()} cores, one used; default flags, instruction set as named",
        f"- compiler: {subprocess.run([CC, '--version'], capture_output=True, text=True).stdout.splitlines()[0]}",
        "",
        "| robot | instruction set | " + " | ".join(f"{n} points" for n in counts) + " |",
        "| --- | --- |" + " --- |" * len(counts),
    ]
    for model, isa in dict.fromkeys(row[:2] for row in rows):
        cells = []
        for n in counts:
            found = [
                (loop / batch, f)
                for m, i, f, k, loop, batch in rows
                if (m, i, k) == (model, isa, n)
            ]
            ratio, function = min(found)
            cells.append(f"{ratio:.2f} ({function})")
        lines.append(f"| `{model}` | {isa} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", nargs="*")
    parser.add_argument("--quick", action="store_true", help="fewer blocks")
    args = parser.parse_args()
    rows = []
    for isa in ISAS:
        for model in args.models or MODELS:
            with tempfile.TemporaryDirectory() as folder:
                for row in measure(model, Path(folder), args.quick, isa):
                    rows.append((Path(model).stem, isa, *row))
                    print(
                        *rows[-1][:4],
                        f"{row[2]:.1f} {row[3]:.1f} ns, {row[2] / row[3]:.2f}",
                        file=sys.stderr,
                        flush=True,
                    )
    if args.models:
        print(table(rows))
    else:
        (HERE / "batches.md").write_text(table(rows))
