"""Small hand-written C modules that are compiled when they are first used and kept in the user's cache."""

from __future__ import annotations

import ctypes
import hashlib
import os
import secrets
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path

from flexgen.build.compiler import Compiler, find_compiler
from flexgen.build.object_cache import cache_folder
from flexgen.errors import BuildError


@lru_cache(maxsize=16)
def c_module(source: Path) -> ctypes.CDLL:
    """The shared library of one C file of this package.

    Raises
    ------
    BuildError
        There is no compiler, or it fails.
    """
    compiler = find_compiler()
    if compiler is None:
        raise BuildError("C compiler: given none, expected cc, gcc or clang on the PATH; install gcc")
    text = source.read_bytes()
    mark = hashlib.sha256(compiler.identity.encode() + b"\0" + text).hexdigest()[:32]
    root = cache_folder()
    if root is None:
        with tempfile.TemporaryDirectory() as folder:
            return ctypes.CDLL(str(_compiled(source, Path(folder) / f"{source.stem}.so", compiler)))
    kept = root / "modules"
    kept.mkdir(mode=0o700, exist_ok=True)
    made = kept / f"{source.stem}-{mark}.so"
    if not made.exists():
        _compiled(source, made, compiler)
    return ctypes.CDLL(str(made))


def _compiled(source: Path, target: Path, compiler: Compiler) -> Path:
    """Compile to a name of its own, then rename: another process never finds half a file."""
    own = target.with_name(f".{secrets.token_hex(8)}.so")
    command = [*compiler.command, *compiler.flags, "-shared", "-o", str(own), str(source), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode != 0:
        raise BuildError(f"the C compiler failed on {source.name}:\n  {done.stderr.strip()[:500]}")
    os.replace(own, target)
    return target
