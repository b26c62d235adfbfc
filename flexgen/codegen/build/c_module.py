"""Small C modules that are compiled when they are first used and kept in the user's cache."""

from __future__ import annotations

import ctypes
import hashlib
import os
import secrets
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path

from flexgen.base.errors import BuildError
from flexgen.codegen.build.compiler import NO_COMPILER, Compiler, find_compiler
from flexgen.codegen.build.object_cache import cache_folder, one_at_a_time
from flexgen.codegen.build.programs import Programs
from flexgen.runtime.files import load_verified, private_copy, read_library, verify_file
from flexgen.runtime.inversion.targets import library_suffix

_ADVICE = "remove it: it is compiled again when it is needed"
MOST = 256  # modules in the cache
LIMIT = 128 * 2**20  # and bytes of all of them


@lru_cache(maxsize=16)
def c_module(source: Path, option: str = "", *, native: bool = False) -> ctypes.CDLL:
    """The shared library of one C file of this package; ``option``: more flags; ``native``: for
    this processor.

    Raises
    ------
    BuildError
        There is no compiler, or it fails.
    """
    return load_module(
        compile_module(
            source.stem, source.read_text(encoding="ascii"), level=option, native=native
        )
    )


def load_module(path: Path) -> ctypes.CDLL:
    """Load a module that `compile_module` made, or found; BuildError where others could have
    changed it.
    """
    return load_verified(verify_file(path), advice=_ADVICE)


@contextmanager
def module_copy(path: Path) -> Iterator[str]:
    """The path of a private copy of such a module, for the loader of CasADi; it ends with the
    block.
    """
    with private_copy(path.name, read_library(verify_file(path), advice=_ADVICE)) as copy:
        yield copy


def compile_module(
    name: str,
    text: str,
    *,
    level: str = "",
    native: bool = False,
    before: Callable[[], None] | None = None,
) -> Path:
    """The path of the shared library of a C text: in the user's cache, or in a folder of this
    program.

    Parameters
    ----------
    name : str
        Of the file: letters, digits and underscores.
    text : str
    level : str
        More flags, such as ``"-O0"``; default: those of the C libraries.
    native : bool
        Compile for this processor: often faster, and the last digits depend on the processor.
    before : callable, optional
        Called before the compiler runs, not where the library is in the cache.

    Raises
    ------
    BuildError
        There is no compiler, or it fails.
    """
    compiler = find_compiler(native=native)
    if compiler is None:
        raise BuildError(NO_COMPILER)
    mark = hashlib.sha256("\0".join((compiler.identity, level, text)).encode()).hexdigest()[:32]
    root = cache_folder()
    kept = root / "modules" if root is not None else Path(_temporary().name)
    kept.mkdir(mode=0o700, exist_ok=True)
    made = kept / f"{name}-{mark}.{library_suffix()}"
    if _is_there(made):
        return made
    if before is not None:
        before()
    with one_at_a_time(kept, name):
        if not _is_there(made):
            _compile(name, text, made, compiler, level)
    _prune(kept, made)
    return made


def _is_there(made: Path) -> bool:
    """Whether a valid module is in the cache, which marks it as used; neither truncated nor
    writable by others.
    """
    with suppress(OSError, BuildError):
        read_library(made)
        os.utime(made)
        return True
    return False


@lru_cache(maxsize=1)
def _temporary() -> tempfile.TemporaryDirectory[str]:
    """A folder that is removed when the program ends."""
    return tempfile.TemporaryDirectory(prefix="flexgen-modules-")


def _compile(name: str, text: str, target: Path, compiler: Compiler, level: str) -> None:
    """Compile the C ``text`` of module ``name`` to the file ``target`` with the compiler's flags
    and those of ``level``, as ``"-O2"``.

    Written under a name of its own, then renamed: another process never finds half a file.
    BuildError with the first words of the compiler's message.
    """
    own = target.with_name(f".{secrets.token_hex(8)}{target.suffix}")
    flags = [*compiler.flags, *level.split(), "-shared", "-x", "c"]
    try:
        done = Programs().run([*compiler.command, *flags, "-o", str(own), "-", "-lm"], text)
        if done.returncode != 0:
            raise BuildError(f"the C compiler failed on {name}.c:\n  {done.stderr.strip()[:500]}")
        own.chmod(0o700)  # whatever the umask
        os.replace(own, target)
    finally:
        own.unlink(missing_ok=True)  # after an error or Ctrl-C


def _prune(folder: Path, newest: Path) -> None:
    """Remove the modules of ``folder`` that were used least lately, beyond `MOST` files or `LIMIT`
    bytes; ``newest`` stays, and one that a process has loaded stays in its memory.
    """
    entries = []
    for path in folder.glob(f"*.{library_suffix()}"):
        with suppress(OSError):
            facts = path.stat()
            entries.append((facts.st_mtime, facts.st_size, path))
    count = len(entries)
    total = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if count <= MOST and total <= LIMIT:
            break
        if path != newest:
            path.unlink(missing_ok=True)
            count = count - 1
            total = total - size
