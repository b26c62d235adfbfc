"""Which code computes: results of different code must never end up in one table."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import flexgen

NUMERICAL = ("casadi", "numpy", "scipy")  # their versions decide the last bits


@cache
def code_version() -> str:
    """Version of flexgen with a digest of its sources and of the packages that compute, the same in every process."""
    digest = hashlib.sha256()
    root = Path(flexgen.__file__).resolve().parent
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    for package in NUMERICAL:
        digest.update(f"{package} {_installed(package)}\n".encode())
    return f"{flexgen.__version__}+{digest.hexdigest()[:16]}"


def _installed(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
