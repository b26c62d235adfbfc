"""Which code computes: results of different code must never end up in one table."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import flexgen
from flexgen.build.compiler import find_compiler
from flexgen.errors import BuildError

NUMERICAL = ("casadi", "numpy", "osqp", "scipy")  # their versions decide the last bits
SOURCES = (".py", ".c", ".h")  # what runs, and what it makes C libraries of


@cache
def code_version(native: bool = False) -> str:
    """Version of flexgen with a digest of all that computes, the same in every process.

    The digest is of the sources, of the packages that compute and of the C compiler: without one ``auto`` takes another
    method and the inverse dynamics go another way. ``native``: of the processor as well, as compiled code may use all
    that it has.
    """
    digest = hashlib.sha256()
    root = Path(flexgen.__file__).resolve().parent
    for path in sorted(path for path in root.rglob("*") if path.suffix in SOURCES):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    for package in NUMERICAL:
        digest.update(f"{package} {_installed(package)}\n".encode())
    digest.update(f"compiler {_compiler(native)}\n".encode())
    return f"{flexgen.__version__}+{digest.hexdigest()[:16]}"


def wants_native(options: Mapping[str, Any]) -> bool:
    """Whether the options of a sweep have libraries compiled for the processor at hand."""
    told = options.get("options")
    return isinstance(told, Mapping) and bool(told.get("native", False))


def _installed(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _compiler(native: bool) -> str:
    """What the compiled code depends on; "none" without a compiler, "unusable" where $CC names no good one."""
    try:
        compiler = find_compiler(native=native)
    except BuildError:  # the cases that need it say why
        return "unusable"
    return "none" if compiler is None else compiler.identity
