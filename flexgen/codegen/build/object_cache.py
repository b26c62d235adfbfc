"""The user's cache of compiled objects: a source that was compiled before, for any directory, is
not compiled again.

An entry is named by the hash of all it depends on and begins with a hash of its own bytes, so that
a truncated, corrupted or renamed entry is rejected. Only the user can write to the folder (mode
0700, below folders that no other user can write to); where this is not possible there is no cache.
On Windows it is below ``LOCALAPPDATA``, which the system keeps from other users. ``FLEXGEN_CACHE``
names another folder; empty: none.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import stat
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from flexgen.base.errors import BuildError
from flexgen.runtime.files import read_verified, verify_folder

fcntl: Any = None
msvcrt: Any = None
try:
    import fcntl
except ImportError:  # Windows
    with contextlib.suppress(ImportError):
        import msvcrt

LIMIT = 256 * 2**20  # bytes of objects; the entries that were used least lately go first

# s, between two trials to lock a file on Windows, which cannot wait longer than ten seconds
_PAUSE = 0.05
_MARK = 64  # length of the hash that an entry begins with
_INCLUDE = re.compile(rb'^[ \t]*#[ \t]*include[ \t]+"([^"\n]+)"', re.MULTILINE)


class Objects:
    """Objects of one compiler.

    Parameters
    ----------
    identity : str
        What the output depends on, apart from the text.
    headers : mapping of str to bytes
        Name and text of everything that the sources may include in quotation marks.
    flags_of : callable, optional
        The flags of one source, by its name, that `identity` does not have.
    """

    def __init__(
        self,
        identity: str,
        headers: Mapping[str, bytes],
        flags_of: Callable[[str], Sequence[str]] = lambda name: (),
    ) -> None:
        """``identity``: of the compiler and its flags; ``headers``: text by name; ``flags_of``:
        further flags of a source.
        """
        self.folder = cache_folder()
        self.identity = identity
        self.flags_of = flags_of
        self.headers = {PurePosixPath(name).name: text for name, text in headers.items()}

    def fetch(self, source: Path) -> bool:
        """Copy the object of a source from the cache into the source's folder; False where the
        cache has none.
        """
        if self.folder is None:
            return False
        data = fetch_entry(self.folder, f"{self._key(source)}.o")
        if data is None:
            return False
        source.with_suffix(".o").write_bytes(data)
        return True

    def keep(self, source: Path) -> None:
        """Store the object of a source in the cache; errors of the cache directory are ignored."""
        if self.folder is not None:
            keep_entry(
                self.folder, f"{self._key(source)}.o", source.with_suffix(".o").read_bytes()
            )

    def _key(self, source: Path) -> str:
        """Hash of everything that the object depends on; the name too, as objects hold it."""
        text = source.read_bytes()
        digest = hashlib.sha256("\0".join([self.identity, *self.flags_of(source.name)]).encode())
        for name in sorted(self._find_includes(text, source.name)):
            digest.update(name.encode() + b"\0" + hashlib.sha256(self.headers[name]).digest())
        digest.update(source.name.encode() + b"\0" + text)
        return digest.hexdigest()

    def _find_includes(self, text: bytes, source: str) -> set[str]:
        """Names of the headers that a text includes, by way of others too; all of them where one
        is not known.
        """
        names: set[str] = set()
        texts = [text]
        while texts:
            for found in _INCLUDE.findall(texts.pop()):
                name = PurePosixPath(found.decode(errors="replace")).name
                if name == source:
                    continue
                if name not in self.headers:
                    return set(self.headers)
                if name not in names:
                    names.add(name)
                    texts.append(self.headers[name])
        return names


def fetch_entry(folder: Path, name: str) -> bytes | None:
    """The content of an entry; None where the cache has none, or one that is not whole."""
    try:
        entry = read_verified(folder / name)
    except (OSError, BuildError):
        return None
    if entry[:_MARK] != _mark(name, entry[_MARK:]):
        return None
    with contextlib.suppress(OSError):
        os.utime(folder / name)
    return entry[_MARK:]


def keep_entry(folder: Path, name: str, data: bytes) -> None:
    """Store an entry, whose name is the hash of all it depends on; errors of the cache directory
    are ignored.
    """
    with contextlib.suppress(OSError):
        handle, temporary = tempfile.mkstemp(prefix=".new-", dir=folder)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(_mark(name, data) + data)
            os.replace(temporary, folder / name)
        except BaseException:  # Ctrl-C too
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise
        _prune(folder)


def _mark(name: str, data: bytes) -> bytes:
    return hashlib.sha256(name.partition(".")[0].encode() + data).hexdigest().encode()


@contextlib.contextmanager
def one_at_a_time(
    folder: Path | None, name: str, log: Callable[[str], None] | None = None
) -> Iterator[None]:
    """Let one process at a time compile the object of this name: the others then find it in the
    cache.

    Without a cache, and where files cannot be locked, all compile at once.

    Parameters
    ----------
    folder : Path, optional
        Of the cache.
    name : str
        Of the object.
    log : callable, optional
        Called with one line of text before waiting.
    """
    file = None
    try:
        if folder is not None and (fcntl is not None or msvcrt is not None):
            with contextlib.suppress(OSError):
                locks = folder / "locks"
                locks.mkdir(mode=0o700, exist_ok=True)
                file = open(locks / name, "ab")  # noqa: SIM115
                if not _lock(file.fileno(), wait=False):
                    if log is not None:
                        log(f"waiting for another process that compiles {name}")
                    _lock(file.fileno(), wait=True)
        yield
    finally:
        if file is not None:
            with file, contextlib.suppress(OSError):
                _unlock(file.fileno())  # also where a child process has inherited the file


def _lock(descriptor: int, *, wait: bool) -> bool:
    """Lock an open file; False where another process has it; OSError where the file system has no
    locks.
    """
    if fcntl is not None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            return False
        return True
    while True:
        try:
            os.lseek(descriptor, 0, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            return True
        except PermissionError:  # another process has it
            if not wait:
                return False
        time.sleep(_PAUSE)


def _unlock(descriptor: int) -> None:
    if fcntl is not None:
        fcntl.flock(descriptor, fcntl.LOCK_UN)
    else:
        os.lseek(descriptor, 0, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 1)


def _prune(folder: Path) -> None:
    """Remove the entries that were used least lately, and what an interrupted process left, beyond
    the limit.

    Other processes may do the same at once. Folders are not counted: what is in ``libraries`` has
    limits of its own.
    """
    entries = []
    for path in folder.iterdir():
        with contextlib.suppress(FileNotFoundError):
            facts = path.lstat()
            if not stat.S_ISDIR(facts.st_mode):
                entries.append((facts.st_mtime, facts.st_size, path))
    total = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if total <= LIMIT:
            break
        path.unlink(missing_ok=True)
        total -= size


def cache_folder() -> Path | None:
    """The folder of the cache, made where it is missing; None where there shall be or can be none.

    Raises
    ------
    BuildError
        Where ``FLEXGEN_CACHE`` names a folder that others can write to.
    """
    given = os.environ.get("FLEXGEN_CACHE")
    if given == "":
        return None
    try:
        own = os.environ.get("XDG_CACHE_HOME" if hasattr(os, "geteuid") else "LOCALAPPDATA")
        home = own or Path.home() / ".cache"
        folder = Path(given or Path(home, "flexgen")).resolve()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        problem = _problem(folder)
    except (OSError, RuntimeError, ValueError, BuildError) as error:
        problem = str(error)
    if problem and given:
        raise BuildError(
            f"FLEXGEN_CACHE: given {given!r}, expected a folder that you alone can write to "
            f"({problem}); choose another, or set it to nothing to do without a cache"
        )
    return None if problem else folder


def _problem(folder: Path) -> str:
    """Why strangers could put something into a folder, empty where they cannot; BuildError for
    those above it.
    """
    if not hasattr(os, "geteuid"):  # Windows: its access control lists are not read
        return "" if os.access(folder, os.W_OK) else f"{folder} cannot be written"
    facts = folder.stat()
    if facts.st_uid != os.geteuid() or facts.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"others can write to {folder}"
    verify_folder(folder)
    if not os.access(folder, os.W_OK | os.X_OK):
        return f"{folder} cannot be written"
    return ""
