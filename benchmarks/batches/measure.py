"""Batches of all point functions against two loops of single calls: results kept, and not kept.

    python benchmarks/batches/measure.py [MODEL ...] [--quick]

For each function and number of points one program calls all in turn on one core. The loop that
keeps results does what the batch does: it copies the inputs of a point, calls the function and
copies its results to the structure of arrays, point by point, or 16 points at a time, whichever is
faster. The other loop reads 64 points in turn and writes all results to one place, so that both
stay in the cache: a controller that needs a result once. The table of minimum times, processor
time of the thread, goes to benchmarks/batches/batches.md, unless models are named. Compare the
ratios.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
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
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
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
#define STATES 64
#define BLOCKS %(blocks)d
#define SECONDS %(seconds)g
/* as many calls as take SECONDS, found in the first block */
#define BEST(best, calls, statement) do { for (;;) { \\
    const double began = now(); \\
    for (long r = 0; r < calls; ++r) { statement; } \\
    const double took = now() - began; \\
    if (took / (double)calls < best) { best = took / (double)calls; } \\
    if (took >= SECONDS) { break; } \\
    calls *= 2; } } while (0)

static double *work, *one;
"""


def sizes(ports: list[dict[str, Any]]) -> list[tuple[str, int]]:
    """Name and number of entries of each array."""
    return [(port["name"], prod(port["shape"])) for port in ports]


def body(name: str, function: dict[str, Any]) -> str:
    """The loop, and the function that times both for a number of points."""
    f = function["name"]
    inputs = sizes(function["inputs"])
    outputs = sizes(function["outputs"])
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
    there = "{x}[(size_t)i * n + first + k]"
    here = "tile_{x}[k * {s} + i]"
    gather_tile, scatter_tile = (
        " ".join(rows.format(s=s, copy=f"{to} = {of};".format(x=x, s=s)) for x, s in ports)
        for ports, to, of in ((inputs, here, there), (outputs, there, here))
    )
    total = sum(size for _, size in inputs)
    begins = [sum(size for _, size in inputs[:i]) for i in range(len(inputs))]
    given_alone = ", ".join(
        [*(f"point + {begin}" for begin in begins), *(f"one_{x}" for x, _ in outputs)]
    ) + (", one" if function["work"] else "")
    results = " ".join(f"static double one_{x}[{size}];" for x, size in outputs)
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

static __attribute__((noinline)) int alone_{f}(int n, const double *points)
{{
    int status = 0;
    {results}
    for (int k = 0; k < n; ++k) {{
        const double *point = points + (size_t)(k % STATES) * {total};
        status |= {name}_{f}({given_alone});
    }}
    return status;
}}

static void time_{f}(int n)
{{
    double loop = 1e9, tiles = 1e9, alone = 1e9, batch = 1e9;
    long loops = 1, tiled = 1, alones = 1, batches = 1;
    double *points = random_numbers(STATES * {total});
    {made}
    if (loop_{f}(n, {loop_names}) != 0 || {name}_{f}_batch(n, {names}, work) != 0) {{ exit(3); }}
    const int equal = {same};
    for (int k = 0; k < BLOCKS; ++k) {{
        BEST(loop, loops, loop_{f}(n, {loop_names}));
        BEST(tiles, tiled, tiles_{f}(n, {loop_names}));
        BEST(alone, alones, alone_{f}(n, points));
        BEST(batch, batches, {name}_{f}_batch(n, {names}, work));
    }}
    const double kept = loop < tiles ? loop : tiles;
    const double each = 1e9 / n;
    printf("{f} %d %.6g %.6g %.6g %d\\n", n, each * kept, each * alone, each * batch, equal);
    fflush(stdout);
    free(points); {free}
}}
"""


@dataclass(frozen=True)
class Row:
    """A function with a number of points: ns per point of both loops and of the batch."""

    model: str
    isa: str
    function: str
    points: int
    kept: float
    not_kept: float
    batch: float


def measure(model: str, folder: Path, quick: bool, isa: str) -> list[Row]:
    """All functions of a model, built for an instruction set."""
    made = flexgen.generate(model, folder / Path(model).stem, isa=isa)
    manifest = json.loads((made.directory / "manifest.json").read_text())
    name = manifest["name"]
    functions = manifest["functions"]
    text = PROGRAM.replace("NAME", name) % {"blocks": 7 if quick else 21, "seconds": 5e-4}
    calls = ""
    for function in functions:
        text += body(name, function)
        results = sum(size for _, size in sizes(function["outputs"]))
        counts = COUNTS if results * 4000 * 8 > BIG else (*COUNTS, MEMORY)
        calls += "".join(f"    time_{function['name']}({n});\n" for n in counts)
    text += (
        "\n"
        "int main(void)\n"
        "{\n"
        f"    work = memory({name}_batch_work());\n"
        f"    one = memory({name}_work() + 1);\n"
    )
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
        function_name, n, kept, not_kept, batch, equal = line.split()
        if equal != "1":
            raise SystemExit(f"{model}, {function_name}: batch and loop differ")
        times = float(kept), float(not_kept), float(batch)
        rows.append(Row(Path(model).stem, isa, function_name, int(n), *times))
    return rows


def worst(rows: list[Row], times: Callable[[Row], float]) -> str:
    """The smallest ratio of a loop's time to the batch's, with its function."""
    if not rows:
        return "-"
    row = min(rows, key=lambda each: times(each) / each.batch)
    return f"{times(row) / row.batch:.2f} ({row.function})"


def table(rows: list[Row], times: Callable[[Row], float]) -> str:
    """The smallest ratio of each model, instruction set and number of points."""
    counts = (*COUNTS, MEMORY)
    lines = [
        "| robot | instruction set | " + " | ".join(f"{n} points" for n in counts) + " |",
        "| --- | --- |" + " --- |" * len(counts),
    ]
    for model, isa in dict.fromkeys((row.model, row.isa) for row in rows):
        own = [row for row in rows if (row.model, row.isa) == (model, isa)]
        cells = [worst([row for row in own if row.points == n], times) for n in counts]
        lines.append(f"| `{model}` | {isa} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def page(rows: list[Row]) -> str:
    """Both tables, with what they compare."""
    version = subprocess.run([CC, "--version"], capture_output=True, text=True, check=True).stdout
    machine = f"{platform.machine()}, {os.cpu_count()} cores, one used"
    slower = [row for row in rows if row.kept < row.batch]
    found = ", ".join(f"{r.function} of {r.model}, {r.isa}, {r.points} points" for r in slower)
    return f"""# Batches against loops of single calls

`python benchmarks/batches/measure.py` writes this file. Time of a loop of single calls, divided by
the time of the batch: the smallest ratio over all point functions of the library, and its \
function.
Minimum processor times of one run in which all alternate; above 1 the batch is faster. Up to \
half a
vector of points, a batch calls the function for one point; its checks cost some nanoseconds more.

- machine: {machine}; default flags, instruction set as named
- compiler: {version.splitlines()[0]}

## Results kept

The loop writes the same arrays as the batch. This is the comparison that decides what to call for
many points. Slower as a batch, of {len(rows)} functions and numbers of points: {found or "none"}.

{table(rows, lambda row: row.kept)}

## Results not kept

The loop reads 64 points in turn and writes all results to one place, so that both stay in the
cache, while the batch reads and writes the arrays of all points. Where a point has hundreds of
results (derivatives), or few operations, moving them through memory can take longer than computing
them, and the ratio is below 1: it says what the arrays cost, not that a loop fills them faster.
benchmarks/peers.md compares in this way.

{table(rows, lambda row: row.not_kept)}
"""


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", nargs="*")
    parser.add_argument("--quick", action="store_true", help="fewer blocks")
    parser.add_argument("--isa", nargs="+", default=ISAS, help="instruction sets")
    args = parser.parse_args()
    rows = []
    for isa in args.isa:
        for model in args.models or MODELS:
            with tempfile.TemporaryDirectory() as made_in:
                for row in measure(model, Path(made_in), args.quick, isa):
                    rows.append(row)
                    ratios = f"{row.kept / row.batch:.2f}, {row.not_kept / row.batch:.2f}"
                    print(
                        *(row.model, row.isa, row.function, row.points),
                        f"{row.kept:.5g} {row.not_kept:.5g} {row.batch:.5g} ns, {ratios}",
                        file=sys.stderr,
                        flush=True,
                    )
    if args.models:
        print(page(rows))
    else:
        (HERE / "batches.md").write_text(page(rows))
