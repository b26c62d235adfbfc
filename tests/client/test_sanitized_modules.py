"""Modules in C that Python loads: loop, controllers, observers, integrator; sanitizers and
threads.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import casadi as ca
import pytest
from emitted import run
from hostile_client import can_sanitize
from toolchain import CC, needs_compiler, tool

import flexgen.runtime.files
from flexgen.codegen.build.lanes_module import lanes_text

pytestmark = needs_compiler
PROGRAM = Path(__file__).parents[1] / "support" / "programs" / "sanitized_modules.py"
SOURCE = Path(flexgen.runtime.files.__file__).parents[1]
MODULES = [
    "simulation/integration/segments.c",
    "feedback/loop/closed_loop.c",
    "feedback/observers/collision.c",
    "feedback/laws/model_laws.c",
    "feedback/observers/constant_gain.c",
    "feedback/observers/extended_kalman.c",
    "simulation/integration/dop853.c",
]
SHIM = """#define _GNU_SOURCE
#include <dlfcn.h>
/* CasADi opens its plug-ins with RTLD_DEEPBIND, which the runtime of the sanitizers refuses. */
void *dlopen(const char *file, int flags)
{
    static void *(*next)(const char *, int);
    if (next == 0) {
        *(void **)&next = dlsym(RTLD_NEXT, "dlopen");
    }
    return next(file, flags & ~RTLD_DEEPBIND);
}
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs LD_PRELOAD")
@pytest.mark.parametrize("planted", [False, True])
def test_sanitizers_are_silent_for_loop_controllers_observers_and_poses(tmp_path, planted):
    gcc = tool("gcc")
    if not can_sanitize(tmp_path):
        pytest.skip("the compiler has no sanitizers; install the Debian package gcc")
    (tmp_path / "shim.c").write_text(SHIM)
    run(gcc, "-shared", "-fPIC", "-o", "shim.so", "shim.c", "-ldl", folder=tmp_path)
    runtimes = [
        run(gcc, f"-print-file-name={name}.so", folder=tmp_path).strip()
        for name in ("libasan", "libubsan")
    ]
    environment = {
        **os.environ,
        "LD_PRELOAD": " ".join([str(tmp_path / "shim.so"), *runtimes]),
        "ASAN_OPTIONS": (
            "detect_leaks=0:verify_asan_link_order=0:malloc_context_size=1:quarantine_size_mb=8"
        ),
        # of the libraries, which are not those under sanitizers: these have -O1
        "CC": f"{gcc} -O0",
    }
    command = [sys.executable, str(PROGRAM), str(tmp_path / "library"), *["planted"] * planted]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env=environment, timeout=900
    )
    if planted:
        found = "heap-buffer-overflow" in done.stderr or "runtime error" in done.stderr
        assert done.returncode != 0 and found and "no error was found" not in done.stdout
    else:
        assert done.returncode == 0 and "no error was found" in done.stdout, done.stderr[-3000:]


def writable(symbols: str) -> list[str]:
    """Names of variables in what ``nm`` lists."""
    return re.findall(r" [bBdDC] (\w+)", symbols)


def test_modules_have_no_variables_that_threads_could_share(tmp_path):
    """Object files without writable static data: two threads share only the arguments that the
    caller gives to both.
    """
    found = sorted(
        str(path.relative_to(SOURCE)) for path in SOURCE.rglob("*.c") if "clib" not in path.parts
    )
    assert set(MODULES) <= set(found)
    given = [ca.SX.sym(name) for name in "xup"]
    functions = {
        name: ca.Function(name.lower(), given, [ca.sin(given[0])]) for name in ("RATE", "OUTPUT")
    }
    for k, name in enumerate(MODULES):
        path = SOURCE / name
        if (
            name == "simulation/integration/segments.c"
        ):  # with functions, which are written in front of it
            (tmp_path / "whole.c").write_text(lanes_text(functions, path.read_text()))
            path = tmp_path / "whole.c"
        run(CC, "-std=c99", "-O1", "-c", f"-I{path.parent}", path, "-o", f"{k}.o", folder=tmp_path)
        assert writable(run("nm", f"{k}.o", folder=tmp_path)) == [], name
    (tmp_path / "bad.c").write_text("int next(void) { static int k; return ++k; }\n")
    run(CC, "-O0", "-c", "bad.c", "-o", "bad.o", folder=tmp_path)
    # the planted variable
    assert len(writable(run("nm", "bad.o", folder=tmp_path).replace("k.", "k_"))) == 1
