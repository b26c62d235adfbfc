"""The libraries in the user's cache: marked when they are used, and those used least lately
removed beyond limits.

Several processes may do so at once. A loaded library stays in the memory of its process even if
its files are removed; a library that is missing is built again.
"""

from __future__ import annotations

import os
import secrets
import shutil
import time
from contextlib import suppress
from pathlib import Path

MOST = 64  # libraries
LIMIT = 512 * 2**20  # bytes of all of them
IN_USE = 3600.0  # s: a library that was used within this time is not removed


def mark_used(library: Path) -> None:
    """Mark a library as in use now; without effect where it does not exist yet."""
    with suppress(OSError):
        os.utime(library)


def prune(folder: Path) -> None:
    """Remove the libraries in a folder that were used least lately, as long as they are too many
    or too large.
    """
    entries = []
    with suppress(OSError):
        for path in folder.iterdir():
            with suppress(OSError):  # another process was faster
                if path.is_dir() and not path.is_symlink():
                    entries.append((path.stat().st_mtime, _size(path), path))
    count = len(entries)
    total = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if count <= MOST and total <= LIMIT:
            break
        if not _remove_unused(path):
            continue
        count -= 1
        total -= size


def _remove_unused(path: Path) -> bool:
    """Remove a library unless it is in use.

    It is renamed first, so that no process finds half of it, and restored if another process marks
    it as in use in the meantime; by then there may be a new one in its place.
    """
    if _in_use(path):
        return False
    aside = path.with_name(f".old-{secrets.token_hex(8)}")
    try:
        path.rename(aside)
    except OSError:  # another process was faster
        return False
    if _in_use(aside):
        with suppress(OSError):
            aside.rename(path)
            return False
    shutil.rmtree(aside, ignore_errors=True)
    return True


def _in_use(path: Path) -> bool:
    try:
        return path.stat().st_mtime > time.time() - IN_USE
    except OSError:
        return True


def _size(folder: Path) -> int:
    """Bytes of the files in a folder."""
    with os.scandir(folder) as entries:
        return sum(entry.stat(follow_symlinks=False).st_size for entry in entries)
