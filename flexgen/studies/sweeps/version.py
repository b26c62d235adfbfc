"""Version of the code: results of different code are never mixed in one table."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import flexgen.base.version
from flexgen.base.errors import BuildError
from flexgen.codegen.build.compiler import find_compiler

NUMERICAL = ("casadi", "numpy", "scipy")  # their versions affect the last bits
X86 = platform.machine().lower() in ("x86_64", "amd64")
SOURCES = (".py", ".c", ".h")  # of Python code and of C libraries


@cache
def code_version(native: bool = False) -> str:
    """Version of flexgen with a digest of everything that affects the results, the same in every
    process.

    The digest covers the sources, the numerical packages and the C compiler, without which
    ``auto`` takes other methods. ``native``: also the processor, since compiled code may use all
    its instructions.
    """
    digest = hashlib.sha256()
    root = Path(flexgen.__file__).resolve().parent
    for path in sorted(path for path in root.rglob("*") if path.suffix in SOURCES):
        digest.update(
            path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0"
        )
    for package in NUMERICAL:
        digest.update(f"{package} {find_version(package)}\n".encode())
    digest.update(f"compiler {_compiler(native)}\n".encode())
    return f"{flexgen.base.version.__version__}+{digest.hexdigest()[:16]}"


def wants_native(options: Mapping[str, Any]) -> bool:
    """Whether the options of a sweep request libraries compiled for this processor."""
    of_method = options.get("options")
    return isinstance(of_method, Mapping) and bool(of_method.get("native", False))


def find_version(package: str) -> str:
    """Version of an installed package; "unknown" where it is not installed as one."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _compiler(native: bool) -> str:
    """Identity of the compiler; "none" without one, "unusable" where $CC is not a working
    compiler.
    """
    try:
        # libraries for any instruction set give the same bits: workers on different processors can
        # share a sweep
        compiler = (
            find_compiler(native=True)
            if native
            else find_compiler(isa="x86-64" if X86 else "native")
        )
    except BuildError:  # the cases that need it report the reason
        return "unusable"
    return "none" if compiler is None else compiler.identity
