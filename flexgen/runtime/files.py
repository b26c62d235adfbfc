"""Files that are loaded as code: no other user may have changed them, and what is loaded is what
was verified.

All code that flexgen loads comes through here: libraries of models, modules in the user's cache,
controllers of a user.

What is refused, on systems with POSIX permissions: a folder, manifest or library that every user
may write, or that belongs to neither the user nor root; the same for all folders above them, where
a folder that every user may write needs its sticky bit; a manifest or library that is a symbolic
link or no regular file. A group may write: groups are chosen, and where the umask is 002 every
user is alone in one. A process with the rights of the user can load anything.

What is loaded is a private copy of the content that was verified: on Linux in memory, without a
name in any folder. So no process can replace the file between the check and the load.
"""

from __future__ import annotations

import ctypes
import hashlib
import itertools
import os
import stat
import struct
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from flexgen.base.errors import BuildError

AGAIN = "generate it again with flexgen.generate(..., force=True)"

_FLAGS = sum(
    getattr(os, flag, 0)
    for flag in ("O_RDONLY", "O_CLOEXEC", "O_NOFOLLOW", "O_NONBLOCK", "O_BINARY")
)
_POSIX = os.name == "posix"
_ELF_SYSTEM = _POSIX and sys.platform != "darwin"
_ELF = b"\x7fELF"
# by the digest of the content; a library stays in memory until the process ends
LOADED: dict[str, ctypes.CDLL] = {}
_LOCK = threading.Lock()
_COUNTER = itertools.count()
_PT_LOAD = 1
_ET_DYN = 3


def verify_folder(folder: Path) -> Path:
    """The folder without symbolic links; BuildError where others could change what it holds."""
    resolved = folder.resolve()
    _refuse_others(resolved, resolved.stat())
    for above in resolved.parents:
        found = above.stat()
        mode = found.st_mode
        if _POSIX and found.st_uid not in (0, os.geteuid()):
            raise BuildError(
                f"{above}: given a folder of the owner {found.st_uid}, expected the user "
                f"{os.geteuid()} or root, because its owner can replace {resolved}; use a "
                "folder somewhere else"
            )
        if _POSIX and mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            raise BuildError(
                f"{above}: given a folder that every user may write (mode "
                f"{stat.S_IMODE(mode):o}), expected one in which no other user can replace "
                f"{resolved}; take the right away (chmod o-w) or use another folder"
            )
    return resolved


def verify_file(path: Path) -> Path:
    """The file that a path leads to, without symbolic links; BuildError where others could replace
    it.
    """
    resolved = path.resolve()
    return verify_folder(resolved.parent) / resolved.name


def read_verified(path: Path, advice: str = AGAIN) -> bytes:
    """Content of a regular file that no other user may write; OSError where it cannot be read,
    else BuildError.
    """
    with _open(path, advice) as descriptor, open(descriptor, "rb", closefd=False) as file:
        return file.read()


def read_library(path: Path, sha256: str | None = None, advice: str = AGAIN) -> bytes:
    """Content of a shared library that can be loaded; parameters and errors are those of
    `load_verified`.
    """
    content = read_verified(path, advice)
    given = hashlib.sha256(content).hexdigest()
    if sha256 not in (None, given):
        raise BuildError(
            f"{path}: given SHA-256 {given[:16]}..., expected {str(sha256)[:16]}...; {advice}"
        )
    problem = _elf_problem(content) if _ELF_SYSTEM else None
    if problem is not None:
        raise BuildError(f"{path}: given {problem}; {advice}")
    return content


def load_verified(path: Path, sha256: str | None = None, advice: str = AGAIN) -> ctypes.CDLL:
    """Load a shared library that no other user could have changed.

    The file is opened once: its owner, rights and content are those of the open file. Its parts
    must lie within it, as a cut file would kill the process. A copy of the verified content is
    loaded. The same content is loaded once.

    Parameters
    ----------
    path : Path
        Without symbolic links, below a folder that was checked: see `verify_folder` and
        `verify_file`.
    sha256 : str, optional
        What the content must have, in hexadecimal.
    advice : str
        What to do where the file cannot be used.

    Returns
    -------
    ctypes.CDLL
        It stays in memory until the process ends.

    Raises
    ------
    BuildError
        Where the file is not to be trusted, or not the one expected.
    OSError
        Where it cannot be read or loaded.
    """
    content = read_library(path, sha256, advice)
    digest = hashlib.sha256(content).hexdigest()
    with _LOCK:
        if digest not in LOADED:
            LOADED[digest] = load_copy(path.name, content)
        return LOADED[digest]


@contextmanager
def private_copy(name: str, content: bytes) -> Iterator[str]:
    """The path of a copy of a shared library that no other user can write, for a loader; it ends
    with the block.
    """
    if not hasattr(os, "memfd_create"):
        # of mode 700
        with tempfile.TemporaryDirectory(prefix="flexgen-", ignore_cleanup_errors=True) as folder:
            copy = Path(folder, name)
            copy.write_bytes(content)
            yield str(copy)
        return
    descriptor = os.memfd_create(name, os.MFD_CLOEXEC)
    try:
        with open(descriptor, "wb", closefd=False) as file:
            file.write(content)
        # The loader takes two libraries of one name for the same one, and numbers of descriptors
        # are used again. A path is different, and leads to the same file, with other "/" and "./"
        # in it: the digits of a counter.
        digits = "".join("./" if digit == "1" else "/" for digit in f"{next(_COUNTER):b}")
        # (CasADi appends .so to a path without a dot)
        yield f"/proc/self/fd/./{digits}{descriptor}"
    finally:
        os.close(descriptor)


def load_copy(name: str, content: bytes) -> ctypes.CDLL:
    """Load a private copy of a shared library; OSError where it cannot be loaded."""
    with private_copy(name, content) as path:
        return ctypes.CDLL(path)


@contextmanager
def _open(path: Path, advice: str) -> Iterator[int]:
    """Descriptor of a file that passed the checks of its owner and rights."""
    try:
        descriptor = os.open(path, _FLAGS)
    except OSError:
        if path.is_symlink():
            raise BuildError(
                f"{path}: given a symbolic link, expected the file itself: what it leads to may "
                f"change unseen; {advice}"
            ) from None
        raise
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise BuildError(f"{path}: given no regular file, expected one; {advice}")
        _refuse_others(path, found)
        yield descriptor
    finally:
        os.close(descriptor)


def _refuse_others(path: Path, found: os.stat_result) -> None:
    """BuildError where another user owns the file or folder, or every user may write it."""
    if not _POSIX:
        return
    if found.st_mode & stat.S_IWOTH:
        raise BuildError(
            f"{path}: given mode {stat.S_IMODE(found.st_mode):o}, which lets every user write "
            "it, expected that only its owner or group may; if you trust its content: chmod "
            f"o-w {path}"
        )
    if found.st_uid not in (0, os.geteuid()):
        raise BuildError(
            f"{path}: given the owner {found.st_uid}, expected the user {os.geteuid()} or root; "
            "copy what you trust"
        )


def _elf_problem(content: bytes) -> str | None:
    """Why a file is not a shared library in ELF that can be mapped into this process; None where
    it seems to be one.
    """
    wide = sys.maxsize > 2**32
    order = "<" if sys.byteorder == "little" else ">"
    if content[:4] != _ELF or len(content) < (64 if wide else 52):
        return "no shared library (its ELF header is missing or cut)"
    if content[4:6] != bytes([2 if wide else 1, 1 if order == "<" else 2]):
        return (
            f"a library of other addresses or byte order, expected {64 if wide else 32} bits, "
            f"{sys.byteorder}-endian"
        )
    kind, machine = struct.unpack_from(f"{order}HH", content, 16)
    if kind != _ET_DYN:
        return f"an ELF file of kind {kind}, expected a shared library"
    if machine != (here := _machine(order, machine)):
        return f"a library for another processor (ELF machine {machine}), expected {here}"
    (table,) = struct.unpack_from(f"{order}{'Q' if wide else 'I'}", content, 32 if wide else 28)
    entry_size, count = struct.unpack_from(f"{order}HH", content, 54 if wide else 42)
    layout = struct.Struct(f"{order}IIQQQQQQ" if wide else f"{order}IIIIIIII")
    if (
        entry_size != layout.size
        or not 0 < count < 0xFFFF
        or table + count * entry_size > len(content)
    ):
        return "a cut or garbled library (its table of segments)"
    loads = 0
    for k in range(count):
        fields = layout.unpack_from(content, table + k * entry_size)
        start, size, memory = (
            (fields[2], fields[5], fields[6]) if wide else (fields[1], fields[4], fields[5])
        )
        if start + size > len(content) or (fields[0] == _PT_LOAD and size > memory):
            return (
                f"a cut or garbled library (segment {k} ends at byte {start + size} of "
                f"{len(content)})"
            )
        loads += fields[0] == _PT_LOAD
    return None if loads else "a garbled library (nothing in it is to be loaded)"


def _machine(order: str, unknown: int) -> int:
    """ELF machine of the running interpreter, or the given number where it cannot be read."""
    try:
        with open("/proc/self/exe", "rb") as file:
            header = file.read(20)
    except OSError:
        return unknown
    return int(struct.unpack_from(f"{order}H", header, 18)[0]) if header[:4] == _ELF else unknown
