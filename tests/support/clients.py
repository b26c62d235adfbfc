"""A C program that calls every function of a library in every way and writes down the results,
made for the tests.

It reads the inputs of ``POINTS`` points (one function after the other, each array with its entries
of all points side by side), and writes the results in the same order. On the way it compares the
batches of odd sizes with the points, bit for bit, all in heap buffers of the exact size, aligned
to one number only, and calls every function wrongly.
"""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

COUNTS = (0, 1, 7, 8, 9, 17)
POINTS = 37

_HEAD = """\
#include "@_batch.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#include <fcntl.h>
#include <io.h>
#endif

typedef @_real real;

/* Room for n numbers in a block that ends behind them; its start is aligned to a number and not \
to two. */
static real *room(int n)
{
    char *block = malloc(((size_t)n + 1) * sizeof(real));
    if (block == NULL) {
        abort();
    }
    memset(block, 0x5a, ((size_t)n + 1) * sizeof(real));
    return (real *)block + 1;
}

static void clear(real *x)
{
    free(x - 1);
}

static void fail(const char *what, int n, int k)
{
    fprintf(stderr, "%s: n = %d, %d\\n", what, n, k);
    exit(1);
}

static int same(const real *a, const real *b, int n)
{
    return memcmp(a, b, (size_t)n * sizeof(real)) == 0;
}
"""


def manifest_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "manifest.json").read_text(encoding="utf-8"))


def size(port: dict[str, Any]) -> int:
    return int(np.prod(port["shape"]))


def inputs_of(manifest: dict[str, Any], states: dict[str, np.ndarray]) -> bytes:
    """The bytes that the program reads: of states of shape (POINTS, size), in the library's
    precision.
    """
    kind = np.float64 if manifest["precision"] == "double" else np.float32
    parts = []
    for f in manifest["functions"]:
        for port in given_ports(f):
            x = states[port["name"]].astype(kind).reshape(POINTS, size(port))
            parts.append(np.ascontiguousarray(x.T).tobytes())
    return b"".join(parts)


def given_ports(f: dict[str, Any]) -> list[dict[str, Any]]:
    """Inputs that each point has its own of: all but the parameters."""
    return [port for port in f["inputs"] if port["name"] != "parameters"]


def results_of(manifest: dict[str, Any], data: bytes) -> dict[str, np.ndarray]:
    """Results that the program wrote: per ``function.port`` an array (POINTS, size)."""
    kind = np.float64 if manifest["precision"] == "double" else np.float32
    all_of_it = np.frombuffer(data, dtype=kind)
    out = {}
    at = 0
    for f in manifest["functions"]:
        for port in f["outputs"]:
            n = size(port) * POINTS
            out[f"{f['name']}.{port['name']}"] = (
                all_of_it[at : at + n].reshape(size(port), POINTS).T
            )
            at += n
    assert at == len(all_of_it)
    return out


def program(
    manifest: dict[str, Any],
    counts: tuple[int, ...] = COUNTS,
    threads: int = 1,
    given: bytes | None = None,
) -> str:
    """The text of the program; ``given``: the inputs, where it cannot read them."""
    name = manifest["name"]
    functions = manifest["functions"]
    parts = ["#include <pthread.h>\n" * (threads > 1) + _HEAD.replace("@", name)]
    parts += [_function(name, f, counts) for f in functions]
    reads = sum(size(p) for f in functions for p in given_ports(f)) * POINTS
    writes = sum(size(p) for f in functions for p in f["outputs"]) * POINTS
    lines = []
    for f in functions:
        lines.append(f"    call_{f['name']}(in, out);")
        lines.append(f"    in += {sum(size(p) for p in given_ports(f)) * POINTS};")
        lines.append(f"    out += {sum(size(p) for p in f['outputs']) * POINTS};")
    calls = "\n".join(lines)
    if given is None:
        parts.append(f"static real given[{reads}];\n")
        read = f"fread(given, sizeof(real), {reads}, stdin) != {reads}"
    else:
        kind, word = (
            ("<u8", "unsigned long long")
            if manifest["precision"] == "double"
            else ("<u4", "unsigned int")
        )
        bits = ", ".join(f"0x{x:x}u" for x in np.frombuffer(given, dtype=kind))
        parts.append(
            f"static const union {{ {word} bits[{reads}]; real numbers[{reads}]; }} given_bits "
            f"= {{{{{bits}}}}};\n"
        )
        parts.append("#define given given_bits.numbers\n")
        read = f"sizeof given_bits != {reads} * sizeof(real)"
    parts.append(f"""\
static real results[{threads}][{writes}];

static void *all(void *result)
{{
    const real *in = given;
    real *out = result;
{calls}
    return in == given + {reads} && out == (real *)result + {writes} ? NULL : result;
}}

int main(void)
{{
#ifdef _WIN32
    _setmode(0, _O_BINARY);
    _setmode(1, _O_BINARY);
#endif
    if ({read}) {{
        return 2;
    }}
""")
    if threads == 1:
        parts.append("    all(results[0]);\n")
    else:
        parts.append(f"""\
    pthread_t threads[{threads}];
    for (int k = 0; k < {threads}; ++k) {{
        pthread_create(&threads[k], NULL, all, results[k]);
    }}
    for (int k = 0; k < {threads}; ++k) {{
        pthread_join(threads[k], NULL);
        if (!same(results[k], results[0], {writes})) {{
            fail("thread", k, 0);
        }}
    }}
""")
    parts.append(f"""\
    if (fwrite(results[0], sizeof(real), {writes}, stdout) != {writes} || fflush(stdout) != 0) {{
        return 3;
    }}
    {"return 0" if given is None else "_Exit(0)"}; /* a bare machine has nothing to return to */
}}
""")
    return "\n".join(parts)


def _function(name: str, f: dict[str, Any], counts: tuple[int, ...]) -> str:
    """The C function ``call_<function>(in, out)``."""
    inputs = given_ports(f)
    outputs = f["outputs"]
    # the parameters, where there are any
    shared = [port for port in f["inputs"] if port not in inputs]
    ports = [*inputs, *shared, *outputs]
    symbol = f"{name}_{f['name']}"
    NAME = name.upper()
    arguments = ", ".join(p["name"] for p in ports)
    one = f"{arguments}, work" if f["work"] else arguments
    per_in = sum(map(size, inputs))
    per_out = sum(map(size, outputs))

    def rooms(n: str) -> str:
        text = "".join(
            f"        real *{p['name']} = room({1 if p in shared else n} * {size(p)});\n"
            for p in ports
        )
        return text + f"        {name}_parameters(parameters);\n" * len(shared)

    clear = "".join(f"        clear({p['name']});\n" for p in ports) + "        clear(work);\n"

    def each(port_list: list[dict[str, Any]], body: str) -> str:
        text = ""
        at = 0
        for p in port_list:
            text += body.format(p=p["name"], s=size(p), at=at)
            at += size(p)
        return text

    fill = each(
        inputs,
        "            for (int i = 0; i < {s}; ++i) {{ {p}[i] = in[({at} + i) * POINTS + k]; }}\n",
    )
    keep = each(
        outputs,
        "            for (int i = 0; i < {s}; ++i) {{ out[({at} + i) * POINTS + k] = {p}[i]; }}\n",
    )
    fill_n = each(
        inputs,
        "                for (int i = 0; i < {s}; ++i) {{ {p}[i * n + k] = in[({at} + i) * "
        "POINTS + k % POINTS]; }}\n",
    )
    compare = each(
        outputs,
        "                for (int i = 0; i < {s}; ++i) {{\n"
        "                    if (!same(&{p}[i * n + k], &out[({at} + i) * POINTS + k % POINTS], "
        "1)) {{\n"
        '                        fail("' + f["name"] + '_batch, {p}", n, k);\n'
        "                    }}\n                }}\n",
    )
    nan_out = each(
        outputs,
        "                for (int i = 0; i < {s}; ++i) {{\n"
        '                    if ({p}[i] == {p}[i]) {{ fail("'
        + f["name"]
        + ': a number in {p}", bad, e); }}\n'
        "                }}\n",
    )
    wrong = each(
        [*inputs, *shared],
        "            for (int e = 0; e < {s}; ++e) {{\n"
        "                const real kept = {p}[e];\n"
        "                for (int bad = 0; bad < 3; ++bad) {{\n"
        "                {p}[e] = (real)(bad == 0 ? NAN : bad == 1 ? INFINITY : -INFINITY);\n"
        f"                if ({symbol}({one}) != {NAME}_INPUT_NOT_FINITE) {{{{\n"
        '                    fail("' + f["name"] + ': unnoticed in {p}", bad, e);\n'
        "                }}\n"
        + nan_out.replace("{", "{{").replace("}", "}}")
        + "                }}\n"
        "                {p}[e] = kept;\n            }}\n",
    )
    nulls = ""
    for k in range(len(ports) + 1):
        words = [
            "NULL" if i == k else word
            for i, word in enumerate([*(p["name"] for p in ports), "work"])
        ]
        single = words if f["work"] else words[:-1]
        if "NULL" in single:
            nulls += (
                f"        if ({symbol}({', '.join(single)}) != {NAME}_NULL_ARGUMENT) {{ "
                f'fail("{f["name"]}: null", 1, {k}); }}\n'
            )
        nulls += (
            f"        if ({symbol}_batch(1, {', '.join(words)}) != {NAME}_NULL_ARGUMENT) {{ "
            f'fail("{f["name"]}_batch: null", 1, {k}); }}\n'
        )
    return f"""\
#define POINTS {POINTS}
static void call_{f["name"]}(const real *in, real *out) /* {per_in} and {per_out} arrays of \
numbers */
{{
    static const int counts[] = {{{", ".join(map(str, counts))}}};
    {{
{rooms("1")}        real *work = room({NAME}_WORK);
        for (int k = 0; k < POINTS; ++k) {{
{fill}            if ({symbol}({one}) != {NAME}_OK) {{
                fail("{f["name"]}", 1, k);
            }}
{keep}            if (k > 0) {{
                continue;
            }}
{wrong}        }}
{nulls}        if ({symbol}_batch(-1, {arguments}, work) != {NAME}_BAD_COUNT) {{
            fail("{f["name"]}_batch", -1, 0);
        }}
        if ({name}_work() != {NAME}_WORK) {{
            fail("work", 1, 0);
        }}
{clear}    }}
    for (size_t c = 0; c < sizeof counts / sizeof counts[0]; ++c) {{
        const int n = counts[c];
{rooms("n")}        real *work = room({name}_batch_work());
        for (int k = 0; k < n; ++k) {{
{fill_n}        }}
        if ({symbol}_batch(n, {arguments}, work) != {NAME}_OK) {{
            fail("{f["name"]}_batch", n, 0);
        }}
        for (int k = 0; k < n; ++k) {{
{compare}        }}
        if (n > 1) {{ /* one point is wrong: the others are not touched */
            {inputs[0]["name"]}[{size(inputs[0]) - 1} * n + 1] = (real)NAN;
            if ({symbol}_batch(n, {arguments}, work) != {NAME}_INPUT_NOT_FINITE) {{
                fail("{f["name"]}_batch: unnoticed", n, 1);
            }}
            for (int k = 0; k < n; ++k) {{
                if (k == 1) {{
                    if ({outputs[0]["name"]}[k] == {outputs[0]["name"]}[k]) {{
                        fail("{f["name"]}_batch: a number", n, 1);
                    }}
                    continue;
                }}
{compare}            }}
        }}
{clear}    }}
}}
#undef POINTS
"""


def answer(command: list[str], given: bytes, folder: Path) -> bytes:
    """Standard output of the program, given its inputs."""
    done = subprocess.run(command, input=given, cwd=folder, capture_output=True, check=False)
    assert done.returncode == 0, (
        command,
        done.returncode,
        done.stderr.decode(errors="replace")[:4000],
    )
    return done.stdout


def point_sources(folder: Path) -> list[Path]:
    """The sources of the functions of a point, without those of whole paths, which take longer to
    compile.
    """
    manifest = manifest_of(folder)
    stems = [manifest["name"], *(f"{manifest['name']}_{f['name']}" for f in manifest["functions"])]
    return [folder / "src" / f"{stem}.c" for stem in sorted(stems)]


def built(folder: Path, work: Path, compiler: str, *flags: str, **options: Any) -> Path:
    """The program of a library's folder, compiled with the sources of its functions of a point."""
    work.mkdir(parents=True, exist_ok=True)
    (work / "client.c").write_text(program(manifest_of(folder), **options), encoding="ascii")
    files = [str(path) for path in point_sources(folder)]
    words = [
        compiler,
        "-std=c99",
        "-D_POSIX_C_SOURCE=200809L",
        *flags,
        f"-I{folder}",
        "client.c",
        *files,
    ]
    words += ["-pthread"] * (options.get("threads", 1) > 1)
    done = subprocess.run(
        [*words, "-lm", "-o", "client"], cwd=work, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, (words, done.stderr[:4000])
    return work / "client"


def stack_of_point(usage: Path, symbol: str) -> int:
    """Bytes of stack of the entry for one point, from what ``-fstack-usage`` wrote: its own and
    its deepest callee's.

    The functions of one point end in ``_1``; a piece of the mathematics is called by ``evaluate``,
    which the entry calls, and may call what the kernel keeps out of line.
    """
    sizes = {}
    for line in usage.read_text(encoding="ascii").splitlines():
        where, size, kind = line.split("\t")
        assert kind != "dynamic", line
        name = where.rpartition(":")[2].partition(".")[0]  # GCC adds .constprop to copies
        sizes[name] = max(int(size), sizes.get(name, 0))
    (failed,) = (name for name in sizes if name.endswith("_failed"))
    own = failed.removesuffix("failed")  # how the names of the function's pieces begin
    kernel = {name: size for name, size in sizes.items() if not name.startswith((own, symbol))}
    pieces = [
        size
        for name, size in sizes.items()
        if re.fullmatch(rf"{own}(evaluate_\w+|solve_\w+)_1", name)
    ]
    evaluate = sizes.get(f"{own}evaluate_1", 0)
    return sizes[symbol] + max(
        sizes[failed], evaluate + max(pieces, default=0) + max(kernel.values(), default=0)
    )
