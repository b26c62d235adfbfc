"""Files that are written completely or not at all, and temporary files of killed processes.

A file is written next to its target under a temporary name, forced to the disk (fsync) and then
renamed: at any instant the target is the old file or the new one. A full disk or a killed process
leaves the old file as it was.

The process that owns a temporary file or folder holds a lock on it (flock), which the system
releases when the process ends in whatever way. A later process removes those whose lock is free:
never one that is in use.
"""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import BinaryIO

from flexgen.base.errors import ArgumentError

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None

# how the names of temporary files and folders begin
FILE = ".flexgen-"
FOLDER = ".staging-"
GRACE = 60.0  # s: what changed later than that is left alone
PARTS = 256  # of a path that is written
_LINKS = 40  # symbolic links on the way of a path that are followed, as in Linux
OLD = 86400.0  # s: what is older is abandoned where files cannot be locked

_ADVICE = {
    errno.ENOSPC: "free space on this disk or choose a path on another one",
    errno.EDQUOT: "your quota is used up: remove files or choose a path on another disk",
    errno.EFBIG: (
        "the file is larger than the system allows (ulimit -f): raise that limit or choose "
        "another disk"
    ),
    errno.EACCES: "choose a folder that you may write",
    errno.EPERM: "choose a folder that you may write",
    errno.EROFS: "choose a path on a disk that can be written",
}


def unwritable(path: str | Path, error: OSError) -> ArgumentError:
    """The error for a path that cannot be written: the reason and what to do."""
    advice = _ADVICE.get(error.errno or 0, "choose another path")
    return ArgumentError(
        f"output: given {str(path)!r}, which cannot be written ({error.strerror or error}); "
        f"{advice}; a file that was there is unchanged"
    )


@contextmanager
def atomic_file(path: str | Path) -> Iterator[BinaryIO]:
    """A binary stream whose content becomes the file when the block ends without an error.

    Missing folders are made. The new file has the mode of the old one, where that is the user's. A
    symbolic link stays: the file that it leads to is replaced, unless `follow_links` refuses it. A
    device or a pipe is written directly.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    ArgumentError
        The file cannot be written; the text has the reason and what to do.
    """
    try:
        target = follow_links(path)
        if target.exists() and not target.is_file():
            with open(target, "wb", opener=_opener_in(None)) as stream:
                yield stream
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(target.parent)
        part = f"{FILE}{secrets.token_hex(8)}"
        with _open_folder(target.parent) as folder:
            place = target.parent if folder is None else Path()
            try:
                with open(place / part, "xb", opener=_opener_in(folder)) as stream:
                    lock_file(stream.fileno())
                    yield stream
                    stream.flush()
                    if (old := _found(place / target.name, folder)) is not None and _is_own(old):
                        os.chmod(
                            stream.fileno() if folder is not None else place / part,
                            stat.S_IMODE(old.st_mode),
                        )
                    os.fsync(stream.fileno())
                os.replace(place / part, place / target.name, src_dir_fd=folder, dst_dir_fd=folder)
            finally:
                with suppress(OSError):
                    os.unlink(place / part, dir_fd=folder)
        _sync_folder(target.parent)
    except OSError as error:
        raise unwritable(path, error) from error


def check_writable(path: Path | None, *, folder: bool = False) -> None:
    """Check that an output path can be written, before a long computation starts.

    A file is made in the folder and removed again: rights alone do not show a disk that cannot be
    written.

    Raises
    ------
    ArgumentError
        It is a directory but a file is expected, or the reverse; or its folder cannot be written.
    """
    if path is None:
        return
    target = follow_links(path)
    if not folder and path.is_dir():
        raise ArgumentError(
            f"output: given {str(path)!r}, which is a directory, expected a file name"
        )
    ancestor = path if folder else path.parent
    while not ancestor.exists() and ancestor != ancestor.parent:
        ancestor = ancestor.parent
    if not ancestor.is_dir():
        raise ArgumentError(
            f"output: given {str(path)!r}, but {str(ancestor)!r} is not a directory"
        )
    if not folder and target.exists() and not target.is_file():  # a device or a pipe
        return
    place = ancestor if folder else target.parent
    while not place.exists() and place != place.parent:
        place = place.parent
    trial = place / f"{FILE}{secrets.token_hex(8)}"
    try:
        trial.touch(exist_ok=False)
        trial.unlink()
    except OSError as error:
        raise unwritable(path, error) from error


def follow_links(path: str | Path) -> Path:
    """Target of a path to be written, with all symbolic links resolved.

    A link in a folder that every user may write (such as /tmp) is followed only where it belongs
    to the user or to root: another user could have it lead to any file of this user.

    Raises
    ------
    ArgumentError
        A link on the way is that of another user in such a folder, the links lead nowhere, or the
        path has more than `PARTS` parts or a name that is too long.
    """
    if os.name != "posix":
        return Path(os.path.realpath(path))
    if len(Path(path).parts) > PARTS:
        raise ArgumentError(
            f"output: given a path of {len(Path(path).parts)} parts, expected at most {PARTS}: "
            f"{str(path)[:80]!r}..."
        )
    todo = list(reversed(Path(path).absolute().parts))
    reached = Path()
    links = 0
    while todo:
        part = todo.pop()
        here = reached.parent if part == ".." else reached / part
        try:
            found = here.lstat()
        except OSError as error:  # it is to be made
            if error.errno == errno.ENAMETOOLONG:
                raise ArgumentError(
                    f"output: given a path of {len(str(path))} characters, "
                    f"{str(path)[:80]!r}..., expected names and a path that the file system can "
                    "hold; choose a shorter one"
                ) from None
            reached = here
            continue
        if not stat.S_ISLNK(found.st_mode):
            reached = here
            continue
        folder = here.parent.stat()
        if folder.st_mode & stat.S_IWOTH and found.st_uid not in (0, os.geteuid()):
            raise ArgumentError(
                f"output: given {str(path)!r}, on whose way {str(here)!r} is a symbolic link of "
                f"the user {found.st_uid} in a folder that every user may write, expected no "
                "link or one of your own; choose another path"
            )
        links += 1
        if links > _LINKS:
            raise ArgumentError(
                f"output: given {str(path)!r}, whose symbolic links lead in a circle; choose "
                "another path"
            )
        todo.extend(reversed(Path(os.readlink(here)).parts))
    return reached


def _is_own(found: os.stat_result) -> bool:
    return not hasattr(os, "geteuid") or found.st_uid == os.geteuid()


def write_text(path: str | Path, text: str) -> Path:
    """Write a text in UTF-8 with ``\\n`` line ends by `atomic_file`; the path."""
    with atomic_file(path) as stream:
        stream.write(text.encode("utf-8"))
    return Path(path)


@contextmanager
def staging_folder(parent: Path) -> Iterator[Path]:
    """A temporary folder in ``parent``, locked while the block runs and removed after it; OSError
    where it fails.
    """
    folder = parent / f"{FOLDER}{secrets.token_hex(8)}"
    folder.mkdir(mode=0o700)
    descriptor = -1
    try:
        with suppress(OSError):
            descriptor = os.open(folder, os.O_RDONLY)
            lock_file(descriptor)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if descriptor >= 0:
            os.close(descriptor)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A `staging_folder` among the temporary files of the system; those of killed processes are
    removed first.
    """
    parent = Path(tempfile.gettempdir())
    remove_leftovers(parent)
    with staging_folder(parent) as folder:
        yield folder


def remove_leftovers(folder: Path) -> None:
    """Remove temporary files and folders that processes which ended left in a folder.

    One is removed where it belongs to the user, did not change for `GRACE` seconds and its lock is
    free; where files cannot be locked, where it is older than a day.
    """
    with suppress(OSError):
        for path in folder.iterdir():
            if path.name.startswith((FILE, FOLDER)):
                with suppress(OSError):  # another process was faster
                    _remove_abandoned(path)


def _remove_abandoned(path: Path) -> None:
    """Remove a temporary file or folder of this user that its process left: older than `GRACE` [s]
    and not locked, or older than `OLD` [s]. Others stay.
    """
    found = path.lstat()
    age = time.time() - found.st_mtime
    is_folder = stat.S_ISDIR(found.st_mode)
    if age < GRACE or not (is_folder or stat.S_ISREG(found.st_mode)):
        return
    if not _is_own(found):
        return
    remove: Callable[[Path], None] = shutil.rmtree if is_folder else os.unlink
    if fcntl is None:
        if age > OLD:
            remove(path)
        return
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    try:
        if lock_file(descriptor) or age > OLD:
            remove(path)
    except BlockingIOError:  # a process works with it
        pass
    finally:
        os.close(descriptor)


@contextmanager
def _open_folder(path: Path) -> Iterator[int | None]:
    """A folder as a descriptor, so that all of a file is written in the folder that was checked.

    Each part of the path is opened without following a symbolic link: one that took the place of
    a folder after `follow_links` is an error. None where the system has no such descriptors.
    """
    if os.open not in os.supports_dir_fd or os.name != "posix":
        yield None
        return
    # O_PATH: folders on the way may be ones that the user may pass and not list
    flags = getattr(os, "O_PATH", os.O_RDONLY) | os.O_DIRECTORY | os.O_NOFOLLOW
    parts = path.absolute().parts
    descriptor = os.open(parts[0], flags)
    try:
        for part in parts[1:]:
            inner = os.open(part, flags, dir_fd=descriptor)
            os.close(descriptor)
            descriptor = inner
        yield descriptor
    finally:
        os.close(descriptor)


def _opener_in(folder: int | None) -> Callable[[str, int], int]:
    """Open in a folder, no symbolic link, with the rights that the user's umask leaves."""

    def open_shared(name: str, flags: int) -> int:
        return os.open(name, flags | getattr(os, "O_NOFOLLOW", 0), 0o666, dir_fd=folder)

    return open_shared


def _found(path: Path, folder: int | None) -> os.stat_result | None:
    """Facts of a file in a folder; None where there is none, or a symbolic link."""
    try:
        found = os.stat(path, dir_fd=folder, follow_symlinks=False)
    except OSError:
        return None
    return found if stat.S_ISREG(found.st_mode) else None


def lock_file(descriptor: int) -> bool:
    """Lock an open file or folder; False where the file system has no locks, BlockingIOError where
    another has it.
    """
    if fcntl is None:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        return False
    return True


def _sync_folder(folder: Path) -> None:
    """Force the new name to the disk, where the system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
