"""A small library written by hand with the interface that flexgen emits: what the loader meets can
be chosen freely.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from toolchain import CC

from flexgen.codegen.emission.interface import ABI_VERSION, STATUSES
from flexgen.runtime.identity import FORMAT

PORTS = {"q_a": [2], "K": [2, 2], "parameters": [2], "s": [2], "S": [2, 3]}
FUNCTIONS = {"twist": ("q_a K parameters", "s S"), "square": ("q_a", "s")}
VALUES = (2.0, 0.25)  # of the parameters, exact in single precision
DIGEST = "d" * 64

_SOURCE = """
#include <math.h>
#include <stddef.h>

typedef REAL real;

static int finite(const real *x, int size, int n)
{
    for (int i = 0; i < size; ++i) {
        if (!isfinite(x[i * (ptrdiff_t)n])) {
            return 0;
        }
    }
    return 1;
}

static void spoil(real *x, int size, int n)
{
    for (int i = 0; i < size; ++i) {
        x[i * (ptrdiff_t)n] = (real)NAN;
    }
}

int NAME(square_batch)(int n, const real *q, real *s, real *work)
{
    int first = 0;
    if (n < 0 || !q || !s || !work) {
        return n < 0 ? -4 : -1;
    }
    for (int k = 0; k < n; ++k) {
        int status = finite(q + k, 2, n) ? 0 : -2;
        for (ptrdiff_t i = 0; i < 2; ++i) {
            s[i * n + k] = q[i * n + k] * q[i * n + k];
        }
        status = status == 0 && !finite(s + k, 2, n) ? -3 : status;
        if (status) {
            spoil(s + k, 2, n);
        }
        first = first == 0 ? status : first;
    }
    return first;
}

int NAME(twist_batch)(int n, const real *q, const real *K, const real *p, real *s, real *S, real \
*work)
{
    int first = 0;
    if (n < 0 || !q || !K || !p || !s || !S || !work) {
        return n < 0 ? -4 : -1;
    }
    for (int k = 0; k < n; ++k) {
        int status = finite(q + k, 2, n) && finite(K + k, 4, n) && finite(p, 2, 1) ? 0 : -2;
        for (ptrdiff_t r = 0; r < 2; ++r) {
            s[r * n + k] = p[0] * q[r * n + k] + p[1] * (K[r * n + k] * q[k] + K[(r + 2) * n + k] \
* q[n + k]);
            for (ptrdiff_t c = 0; c < 3; ++c) {
                S[(r + 2 * c) * n + k] = s[r * n + k] * (real)(c + 1) + K[(r + 2 * (c % 2)) * n + \
k];
            }
        }
        status = status == 0 && !(finite(s + k, 2, n) && finite(S + k, 6, n)) ? -3 : status;
        if (status) {
            spoil(s + k, 2, n);
            spoil(S + k, 6, n);
        }
        first = first == 0 ? status : first;
    }
    return first;
}

int NAME(square)(const real *q, real *s)
{
    real work[3];
    return NAME(square_batch)(1, q, s, work);
}
int NAME(twist)(const real *q, const real *K, const real *p, real *s, real *S, real *work)
{
    return NAME(twist_batch)(1, q, K, p, s, S, work);
}
int NAME(work)(void) { return 1; }
int NAME(batch_work)(void) { return 3; }
int NAME(abi_version)(void) { return ABI; }
int NAME(sizeof_real)(void) { return (int)sizeof(real); }
int NAME(sizeof_int)(void) { return SIZEOF_INT; }
int NAME(n_a)(void) { return 2; }
int NAME(n_p)(void) { return 2; }
const char *NAME(digest)(void) { return DIGEST; }
const char *NAME(interface)(void) { return INTERFACE; }
void NAME(parameters)(real *p)
{
    p[0] = (real)2;
    p[1] = (real)0.25;
}
"""


def interface() -> str:
    """SHA-256 of the functions' names and shapes."""

    def listed(ports: str) -> str:
        return "".join(f"{port}[{','.join(map(str, PORTS[port]))}]" for port in ports.split())

    lines = [
        f"{f}({listed(inputs)})({listed(outputs)})\n" for f, (inputs, outputs) in FUNCTIONS.items()
    ]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def twist(q_a, K, parameters=VALUES) -> tuple[np.ndarray, np.ndarray]:
    """Reference of the function ``twist``, at one point or at many."""
    q_a = np.asarray(q_a, float)
    K = np.asarray(K, float)
    s = parameters[0] * q_a + parameters[1] * (K @ q_a[..., None])[..., 0]
    return s, s[..., None] * np.array([1.0, 2.0, 3.0]) + K[..., [0, 1, 0]]


@cache
def _scratch() -> Path:
    folder = tempfile.mkdtemp(prefix="flexgen-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


@cache
def compiled(
    real: str = "double",
    abi: int = ABI_VERSION,
    sizeof_int: str = "(int)sizeof(int)",
    digest: str = DIGEST,
    name: str = "hand",
) -> bytes:
    """Content of the shared library that says this of itself."""
    key = hashlib.sha256(repr((real, abi, sizeof_int, digest, name)).encode()).hexdigest()[:16]
    source = _scratch() / f"{key}.c"
    library = _scratch() / f"{key}.so"
    texts = [f"#define REAL {real}", f"#define ABI {abi}", f"#define SIZEOF_INT {sizeof_int}"]
    texts += [
        f'#define DIGEST "{digest}"',
        f'#define INTERFACE "{interface()}"',
        f"#define NAME(f) {name}_##f",
    ]
    source.write_text("\n".join([*texts, _SOURCE]))
    assert CC is not None
    flags = ["-std=c99", "-O1", "-ffp-contract=off", "-fPIC", "-shared"]
    subprocess.run([CC, *flags, str(source), "-o", str(library), "-lm"], check=True)
    return library.read_bytes()


def install(folder: Path, content: bytes, *, name: str = "hand", **changes: Any) -> Path:
    """Put a library with its manifest into a folder, as flexgen does; ``changes`` replace what the
    manifest says.
    """
    folder.mkdir(exist_ok=True)
    sha256 = hashlib.sha256(content).hexdigest()
    file = f"lib{name}-{sha256[:16]}.{'dylib' if sys.platform == 'darwin' else 'so'}"
    (folder / file).write_bytes(content)

    def described(ports: str) -> list[dict[str, Any]]:
        return [
            {"name": port, "shape": PORTS[port], "unit": "1", "doc": "a port"}
            for port in ports.split()
        ]

    manifest = {
        "format": FORMAT,
        "name": name,
        "abi_version": ABI_VERSION,
        "precision": "double",
        "model_digest": DIGEST,
        "sizes": {"n_a": 2, "n_p": 2},
        "coordinates": [{"name": "one", "unit": "rad"}, {"name": "two", "unit": "rad"}],
        "motors": [],
        "states": [],
        "parameters": [
            {"name": "first", "value": 2.0, "unit": "1"},
            {"name": "second", "value": 0.25, "unit": "1"},
        ],
        "statuses": [vars(status) for status in STATUSES],
        "functions": [
            {
                "name": f,
                "work": f == "twist",
                "summary": f,
                "equation": "",
                "inputs": described(inputs),
                "outputs": described(outputs),
            }
            for f, (inputs, outputs) in FUNCTIONS.items()
        ],
        "build": {"library": file, "sha256": sha256},
        **changes,
    }
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder
