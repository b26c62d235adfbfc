"""Code size, stack and instructions of the emitted functions on small processors, and the effect
of compiler flags.

    python benchmarks/sizes.py [MODEL ...]

prints the tables and, for its own choice of models, writes them to benchmarks/sizes.md. Code and
stack are the compiler's figures at the reproducible flags, instructions are counted by an emulator
(QEMU, one instruction at a time) over one call for one point; those three do not depend on the
machine at hand. The times of the last table do: compare them with each other only. A compiler or
an emulator that is missing leaves its columns empty.
"""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexgen.codegen.build.compiler import REPRODUCIBLE
from flexgen.codegen.build.generate import generate
from flexgen.dynamics.mechanics.signatures import INVERSION

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "support"))

from clients import stack_of_point  # noqa: E402

MODELS = ("planar5_nmp", "tests/support/robots/ur5.toml", "manutec_r3_efjm")
BOARD = ROOT / "tests" / "support" / "cortex_m7"
# instructions of one call: those of a program with so many calls, less those of a program with one
CALLS = 3
POINTS = 500  # of a batch


@dataclass(frozen=True)
class Target:
    """A machine: its compiler, its precision, and how a program runs on it one instruction at a
    time.
    """

    name: str
    precision: str
    compiler: tuple[str, ...]
    link: tuple[str, ...]
    emulator: tuple[str, ...]


M7 = ("-mcpu=cortex-m7", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard")
TARGETS = (
    Target("x86-64", "double", ("gcc",), ("-static",), ("qemu-x86_64",)),
    Target("aarch64", "double", ("aarch64-linux-gnu-gcc",), ("-static",), ("qemu-aarch64",)),
    Target(
        "Cortex-M7",
        "single",
        ("arm-none-eabi-gcc", *M7),
        ("--specs=rdimon.specs", "-T", str(BOARD / "memory.ld"), str(BOARD / "start.c")),
        tuple(
            (
                "qemu-system-arm -M mps2-an500 -nographic -semihosting-config "
                "enable=on,target=native -kernel"
            ).split()
        ),
    ),
)
FLAGS = (
    ("gcc", "-O1", "-ffp-contract=off"),
    ("gcc", "-O2", "-ffp-contract=off"),
    ("gcc", "-O2", "-ffp-contract=off", "-fno-tree-vectorize"),
    ("gcc", "-O3", "-ffp-contract=off", "-fno-tree-vectorize"),
    ("gcc", "-O3", "-march=native", "-ffp-contract=fast"),
    ("clang", "-O2", "-ffp-contract=off"),
    ("clang", "-O3", "-march=native", "-ffp-contract=fast"),
)
TIMED = ("inverse_dynamics", "mass_matrix", "forward_dynamics", "linearize")


def run(*command: object, folder: Path) -> str:
    """Run a program; what it prints."""
    words = [str(word) for word in command]
    answer = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    if answer.returncode != 0:
        raise RuntimeError(f"{' '.join(words)}:\n{answer.stderr[:2000]}")
    return answer.stdout


def manifest_of(folder: Path) -> dict[str, Any]:
    """The description of a library."""
    return json.loads((folder / "manifest.json").read_text(encoding="utf-8"))


def entries(port: dict[str, Any]) -> int:
    """Numbers in an array of one point."""
    count = 1
    for extent in port["shape"]:
        count *= extent
    return count


def table(head: list[str], rows: list[list[str]]) -> str:
    """Rows as a table in Markdown."""
    lines = [
        "| " + " | ".join(row) + " |"
        for row in (head, ["---"] + ["---:"] * (len(head) - 1), *rows)
    ]
    return "\n".join(lines) + "\n"


INTRODUCTION = """\
# Size and cost of the emitted functions

Written by `python benchmarks/sizes.py`. Code: the whole file of a function, that is the entries \
for one point and for
many with the mathematics of both. Stack and instructions: of the entry for one point, its \
callees included;
instructions are counted by an emulator over one call. All at the reproducible flags. A dash: no \
compiler or emulator
was available. The last table is about streams in single precision on the same emulated Cortex-M7.
"""

# --- code, stack, instructions -------------------------------------------------------------------


def costs(folder: Path, target: Target) -> dict[str, tuple[str, str, str]]:
    """Bytes of code, bytes of stack and instructions of every function on a machine."""
    manifest = manifest_of(folder)
    out = {}
    for f in manifest["functions"]:
        out[f["name"]] = ("-", "-", "-")
        if shutil.which(target.compiler[0]) is None:
            continue
        with tempfile.TemporaryDirectory() as work:
            symbol = f"{manifest['name']}_{f['name']}"
            source = folder / "src" / f"{symbol}.c"
            run(
                *target.compiler,
                *REPRODUCIBLE,
                "-fstack-usage",
                f"-I{folder}",
                "-c",
                source,
                "-o",
                "f.o",
                folder=Path(work),
            )
            sections = run("size", "f.o", folder=Path(work)).splitlines()[1].split()
            stack = stack_of_point(Path(work) / "f.su", symbol)
            count = instructions(folder, manifest, f, target, Path(work))
            out[f["name"]] = (sections[0], str(stack), count)
    return out


def instructions(
    folder: Path, manifest: dict[str, Any], f: dict[str, Any], target: Target, work: Path
) -> str:
    """Instructions of one call for one point, its inputs moderate."""
    if shutil.which(target.emulator[0]) is None:
        return "-"
    (work / "call.c").write_text(program(manifest, f), encoding="ascii")
    counts = []
    for calls in (1, CALLS):
        words = [
            *target.compiler,
            *REPRODUCIBLE,
            f"-DCALLS={calls}",
            f"-I{folder}",
            "call.c",
            "f.o",
            *target.link,
        ]
        run(*words, "-lm", "-o", "call", folder=work)
        emulator = [
            target.emulator[0],
            "-singlestep",
            "-d",
            "nochain,exec",
            "-D",
            "log",
            *target.emulator[1:],
        ]
        run(*emulator, work / "call", folder=work)
        with (work / "log").open(encoding="ascii", errors="replace") as log:
            counts.append(sum(1 for line in log if line.startswith("Trace ")))
    return str((counts[1] - counts[0]) // (CALLS - 1))


def program(manifest: dict[str, Any], f: dict[str, Any]) -> str:
    """A program that calls a function CALLS times."""
    name = manifest["name"]
    lines = [f'#include "{name}.h"', "#include <stdlib.h>"]
    for p in (*f["inputs"], *f["outputs"]):
        values = ", ".join(f"(({name}_real){0.1 + 0.03 * i:.2f})" for i in range(entries(p)))
        given = f" = {{{values}}}" if p in f["inputs"] else ""
        lines.append(f"static {name}_real port_{p['name']}[{entries(p)}]{given};")
    arguments = ", ".join(
        [*(f"port_{p['name']}" for p in (*f["inputs"], *f["outputs"])), *["work"] * f["work"]]
    )
    lines += [
        f"static {name}_real work[{name.upper()}_WORK];",
        "int main(void)",
        "{",
        "    volatile int status = 0;",
        "    for (int k = 0; k < CALLS; ++k) {",
        f"        status = {name}_{f['name']}({arguments});",
        "    }",
        "    _Exit(status);",
        "}",
    ]
    return "\n".join(lines) + "\n"


def small_machines(model: str, base: Path) -> str:
    """The table of one model."""
    columns = {}
    for target in TARGETS:
        made = generate(model, base / target.precision, precision=target.precision, build=False)
        columns[target.name] = costs(made.directory, target)
    head = ["function"]
    for target in TARGETS:
        head += [f"{target.name} {target.precision}: code B", "stack B", "instructions"]
    rows = [
        [name, *(figure for target in TARGETS for figure in columns[target.name][name])]
        for name in made.functions
    ]
    sums = ["all"]
    for target in TARGETS:
        figures = [columns[target.name][name] for name in made.functions]
        sums += [_sum([figure[0] for figure in figures]), "", ""]
    return table(head, [*rows, sums])


def _sum(texts: list[str]) -> str:
    return "-" if "-" in texts else str(sum(map(int, texts)))


# --- streams -------------------------------------------------------------------------------------
STREAM_TEXT = """\
A horizon of 20 intervals of 5 ms, a move of 0.3 s and the rest after it. Code: the stream and \
what it calls.
Memory: of the stream. Instructions: of one update, on average and at most.
"""
STREAMS = ("planar5_nmp", "manutec_r3", "tests/support/robots/ur5_elastic.toml")
INTERVALS = 20  # of the horizon
SAMPLES = (1, 5)  # results per update
STREAM_PROGRAM = """\
#include "@_inversion.h"
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

/* The system timer counts down at 25 MHz; the emulator needs a nanosecond for each instruction: \
40 per count. */
static volatile uint32_t *const timer = (volatile uint32_t *)0xE000E010u;

enum { MOVE = 60 };

int main(void)
{
    @_real y[$_NT], next[$_NT], dy[$_NY] = {0}, ddy[$_NY] = {0};
    const @_stream_options options = {
        .intervals = %INTERVALS, .samples_per_interval = %SAMPLES, .period = 0.005f, .tolerance = \
1e-3f};
    @_motion motion = {NULL};
    @_stream_info info;
    const int64_t size = @_stream_work(&options);
    const @_stream stream = {.memory = malloc((size_t)size * sizeof(@_real)), .size = size};
    uint32_t sum = 0, most = 0;
    int status = stream.memory == NULL ? -1 : home_output(y);
    timer[1] = 0xFFFFFFu;
    timer[2] = 0;
    timer[0] = 5u;
    status = status == 0 ? @_stream_start(&stream, &options, y, @_home_q_a) : status;
    for (int k = 1; k <= 2 * MOVE && status >= 0; ++k) { /* a move of 0.02 m along the first \
output */
        const float s = k < MOVE ? (float)k / MOVE : 1.0f, T = 0.005f * MOVE;
        uint32_t before, count;
        for (int i = 0; i < $_NT; ++i) {
            next[i] = y[i];
        }
        next[0] += 0.02f * s * s * s * (10.0f + s * (-15.0f + 6.0f * s));
        dy[0] = 0.02f / T * 30.0f * s * s * (1.0f + s * (-2.0f + s));
        ddy[0] = 0.02f / (T * T) * 60.0f * s * (1.0f + s * (-3.0f + 2.0f * s));
        before = timer[2];
        status = @_stream_update(&stream, next, dy, ddy, &motion, &info);
        count = (before - timer[2]) & 0xFFFFFFu;
        sum += count / (2 * MOVE);
        most = count > most ? count : most;
    }
    printf("%d %lu %lu %lu\\n", status, 40ul * sum, 40ul * most, (unsigned long)size * \
sizeof(@_real));
    _Exit(0);
}
"""


def streams(base: Path) -> str:
    """Instructions of an update of a stream on a Cortex-M7, on average and at most over a move."""
    target = TARGETS[-1]
    head = [
        "stream",
        "intervals",
        "samples per update",
        "code kB",
        "memory kB",
        "instructions, mean",
        "at most",
    ]
    rows = []
    for model in STREAMS:
        name = Path(model).stem
        folder = generate(model, base / "stream" / name, precision="single", build=False).directory
        for samples in SAMPLES:
            figures = ["-"] * 4
            if shutil.which(target.compiler[0]) and shutil.which(target.emulator[0]):
                figures = stream_costs(folder, name, samples, target)
            rows.append([name, str(INTERVALS), str(samples), *figures])
    return table(head, rows)


def stream_costs(folder: Path, name: str, samples: int, target: Target) -> list[str]:
    """Code and memory in kB, instructions of an update on average and at most."""
    example = (folder / "example.c").read_text(encoding="ascii")
    start = example.rindex("static", 0, example.index("home_output"))
    home = example[start : example.index("\n}\n", start) + 3]
    text = STREAM_PROGRAM.replace("@", name).replace("$", name.upper())
    text = text.replace("%INTERVALS", str(INTERVALS)).replace("%SAMPLES", str(samples))
    text = text.replace("int main(void)", f"{home}\nint main(void)")
    used = (f"src/{name}_{f}.c" for f in ("inversion", "forward_kinematics", *INVERSION))
    sources = [folder / file for file in (f"src/{name}.c", *used) if (folder / file).exists()]
    with tempfile.TemporaryDirectory() as work:
        (Path(work) / "stream.c").write_text(text, encoding="ascii")
        options = (*REPRODUCIBLE, f"-D{name.upper()}_WITHOUT_INVERT", f"-I{folder}")
        run(*target.compiler, *options, "-c", *sources, folder=Path(work))
        objects = sorted(Path(work).glob("*.o"))
        code = int(run("size", "-t", *objects, folder=Path(work)).splitlines()[-1].split()[0])
        run(
            *target.compiler,
            *options,
            "stream.c",
            *objects,
            *target.link,
            "-lm",
            "-o",
            "stream",
            folder=Path(work),
        )
        timed = (target.emulator[0], "-icount", "shift=0", *target.emulator[1:])
        status, mean, most, memory = run(*timed, Path(work) / "stream", folder=Path(work)).split()
    if int(status) < 0:
        raise RuntimeError(f"{name}: the stream failed with status {status}")
    return [f"{code / 1000:.0f}", f"{int(memory) / 1000:.0f}", f"{int(mean):,}", f"{int(most):,}"]


# --- flags ---------------------------------------------------------------------------------------

TIMER = """\
#define _POSIX_C_SOURCE 199309L
#include "@_batch.h"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static @_real *filled(int n)
{
    @_real *x = malloc((size_t)n * sizeof *x);
    for (int i = 0; i < n; ++i) {
        x[i] = (@_real)(rand() / (RAND_MAX + 1.0) - 0.5);
    }
    return x;
}

int main(void)
{
"""


def timer(manifest: dict[str, Any]) -> str:
    """A program that prints the nanoseconds per point of the functions in `TIMED`, one by one and
    in a batch.
    """
    name = manifest["name"]
    text = TIMER.replace("@", name)
    for f in manifest["functions"]:
        if f["name"] not in TIMED:
            continue
        ports = [*f["inputs"], *f["outputs"]]
        call = f"{name}_{f['name']}"
        arguments = ", ".join(f"port_{p['name']}" for p in ports)
        work = ", work" if f["work"] else ""
        text += "    {\n        double one = 1.0, many = 1.0, start;\n"
        text += "".join(
            f"        {name}_real *port_{p['name']} = filled({entries(p)} * {POINTS});\n"
            for p in ports
        )
        text += f"""\
        {name}_real *work = filled({name.upper()}_BATCH_WORK + {name.upper()}_WORK);
        for (int r = 0; r < 60; ++r) {{
            start = now();
            for (int k = 0; k < 100; ++k) {{
                {call}({arguments}{work});
            }}
            one = now() - start < one ? now() - start : one;
            start = now();
            {call}_batch({POINTS}, {arguments}, work);
            many = now() - start < many ? now() - start : many;
        }}
        printf("{f["name"]} %.1f %.1f\\n", 1e9 * one / 100, 1e9 * many / {POINTS});
    }}
"""
    return text + "    return 0;\n}\n"


def flags(model: str, base: Path) -> str:
    """Time to compile, size, and run time relative to that of the reproducible flags."""
    folder = generate(model, base / "flags", build=False).directory
    manifest = manifest_of(folder)
    sources = sorted((folder / "src").glob("*.c"))
    measured: dict[tuple[str, ...], tuple[float, int, dict[str, tuple[float, float]]]] = {}
    for words in FLAGS:
        if shutil.which(words[0]) is None:
            continue
        with tempfile.TemporaryDirectory() as work:
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            run(
                words[0],
                "-std=c99",
                *words[1:],
                "-fno-math-errno",
                f"-I{folder}",
                "-c",
                *sources,
                folder=Path(work),
            )
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            spent = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
            objects = sorted(Path(work).glob("*.o"))
            size = int(run("size", "-t", *objects, folder=Path(work)).splitlines()[-1].split()[0])
            (Path(work) / "timer.c").write_text(timer(manifest), encoding="ascii")
            run(
                "cc",
                "-std=c99",
                "-O2",
                f"-I{folder}",
                "timer.c",
                *objects,
                "-lm",
                "-o",
                "timer",
                folder=Path(work),
            )
            lines = [
                line.split() for line in run(Path(work) / "timer", folder=Path(work)).splitlines()
            ]
            measured[words] = (
                spent,
                size,
                {line[0]: (float(line[1]), float(line[2])) for line in lines},
            )
    chosen = next(
        words
        for words in measured
        if set(words[1:]) <= set(REPRODUCIBLE) and "-fno-tree-vectorize" in words
    )
    reference = measured[chosen][2]
    rows = []
    for words, (spent, size, times) in measured.items():
        ratios = [f"{times[f][i] / reference[f][i]:.2f}" for f in TIMED for i in (0, 1)]
        rows.append([f"`{' '.join(words)}`", f"{spent:.1f}", str(size // 1000), *ratios])
    head = [
        "flags",
        "compile s",
        "code kB",
        *(f"{f}{what}" for f in TIMED for what in ("", ", batch")),
    ]
    return table(head, rows)


def main(models: list[str]) -> None:
    """Print, and write where the models are the usual ones."""
    parts = [INTRODUCTION]
    with tempfile.TemporaryDirectory() as base:
        for model in models or MODELS:
            parts.append(
                f"## {Path(model).stem}\n\n{small_machines(model, Path(base) / Path(model).stem)}"
            )
        last = (models or MODELS)[-1]
        parts.append(
            (
                f"## Flags, {Path(last).stem}\n"
                "\n"
                "Run times relative to those of the flags that `flexgen generate` uses.\n"
                "\n"
            )
            + flags(last, Path(base))
        )
        parts.append(
            "## Streams on a Cortex-M7 in single precision\n"
            "\n"
            f"{STREAM_TEXT}\n"
            f"{streams(Path(base))}"
        )
    text = "\n".join(parts)
    print(text)
    if not models:
        (ROOT / "benchmarks" / "sizes.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
