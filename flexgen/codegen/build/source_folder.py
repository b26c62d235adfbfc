"""A folder of exported source files: written completely or not at all; files that a user changed
are not replaced.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from flexgen.base.errors import ArgumentError, BuildError
from flexgen.base.files.atomic_files import follow_links, remove_leftovers, staging_folder
from flexgen.base.version import __version__

RECORD = "flexgen_export.json"
_FILE = re.compile(r"[A-Za-z+][A-Za-z0-9_.+]*(/[A-Za-z+][A-Za-z0-9_.+]*)*\Z")
_ADVICE = "choose another folder (directory= in Python, --out on the command line)"


def folder_of(given: Any, default: str) -> Path:
    """The folder to write to; ArgumentError for something else than a path."""
    if given is None:
        return Path("exports", default)
    if (
        not isinstance(given, str | os.PathLike)
        or not isinstance(os.fspath(given), str)
        or "\0" in os.fspath(given)
    ):
        raise ArgumentError(f"directory: given {given!r}, expected the path of a folder")
    return Path(given)


def write_folder(
    target: Path, kind: str, name: str, texts: Mapping[str, str], *, force: bool = False
) -> tuple[Path, ...]:
    """Write the texts, and return the paths of all files; the same texts give the same bytes.

    Parameters
    ----------
    target : Path
    kind, name : str
        Of the export; a folder holds one.
    texts : mapping of str to str
        Text by path below the folder; ASCII, with ``\\n``.
    force : bool
        True: also replace files that were changed since the last export.

    Raises
    ------
    BuildError
        The folder holds another export or files of the user, or cannot be written; it stays as it
        was.
    """
    assert all(_FILE.match(file) and ".." not in file for file in texts), sorted(texts)
    content = {file: texts[file].encode("ascii") for file in sorted(texts)}
    follow_links(target)
    old = _record(target, kind, name)
    _refuse_folders(target, (*content, RECORD))
    _refuse_foreign(target, content, old, force)
    record = {
        "format": 1,
        "generator": f"flexgen {__version__}",
        "kind": kind,
        "name": name,
        "files": {file: hashlib.sha256(data).hexdigest() for file, data in content.items()},
    }
    try:
        target.mkdir(parents=True, exist_ok=True)
        remove_leftovers(target)
        with staging_folder(target) as folder:
            for file, data in {
                **content,
                RECORD: (json.dumps(record, indent=2) + "\n").encode(),
            }.items():
                (folder / file).parent.mkdir(parents=True, exist_ok=True)
                (folder / file).write_bytes(data)
            # of an earlier version of flexgen
            gone = [
                file for file in old if file not in content and _digest(target / file) == old[file]
            ]
            with _undone_on_error(target, folder / ".kept", (*content, RECORD, *gone)):
                for file in (*content, RECORD):
                    (target / file).parent.mkdir(parents=True, exist_ok=True)
                    os.replace(folder / file, target / file)
                for file in gone:
                    (target / file).unlink()
    except OSError as error:
        raise BuildError(
            f"directory: given {str(target)!r}, which cannot be written "
            f"({error.strerror or error}); {_ADVICE}"
        ) from error
    return tuple(target / file for file in (*content, RECORD))


def _record(target: Path, kind: str, name: str) -> dict[str, str]:
    """Digests of the files of the last export to the folder; empty where there is none."""
    try:
        record = json.loads((target / RECORD).read_text(encoding="utf-8"))
    except OSError:
        return {}
    except (ValueError, RecursionError):
        record = None
    found = record if isinstance(record, dict) else {}
    files = found.get("files")
    if (
        not isinstance(files, dict)
        or not all(
            isinstance(text, str)
            for text in (found.get("kind"), found.get("name"), *files.values())
        )
        or not all(_FILE.match(file) and ".." not in file for file in files)
    ):
        raise BuildError(
            f"{target / RECORD}: given a file that flexgen did not write, expected none; {_ADVICE}"
        )
    if (found["kind"], found["name"]) != (kind, name):
        raise BuildError(
            f"{target}: given a folder with the export {found['kind'][:40]} of "
            f"{found['name'][:40]!r}, expected an empty one or one of {kind} of {name!r}; "
            f"{_ADVICE}"
        )
    return files


@contextmanager
def _undone_on_error(target: Path, kept: Path, files: Sequence[str]) -> Iterator[None]:
    """Where the block ends with an error, the files are as before it, and new folders are removed.

    The copies are in the folder ``kept``. A process that is killed in the block leaves some files
    new and some old.
    """
    folders = {
        parent
        for file in files
        for parent in (target / file).parents
        if parent.is_relative_to(target)
    }
    made = [folder for folder in folders if not folder.exists()]
    there = [file for file in files if os.path.lexists(target / file)]
    for file in there:
        (kept / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(target / file, kept / file, follow_symlinks=False)
    try:
        yield
    except BaseException:
        for file in files:
            with suppress(OSError):
                if file in there:
                    os.replace(kept / file, target / file)
                else:
                    (target / file).unlink()
        for folder in sorted(made, reverse=True):  # the inner ones first
            with suppress(OSError):
                folder.rmdir()
        raise


def _refuse_folders(target: Path, files: Sequence[str]) -> None:
    """BuildError where a folder has the name of a file."""
    folders = [file for file in files if (target / file).is_dir()]
    if folders:
        raise BuildError(
            f"{target}: given folders with the names of files ({', '.join(folders[:8])}), "
            f"expected files or nothing; move them away, or {_ADVICE}"
        )


def _refuse_foreign(
    target: Path, content: Mapping[str, bytes], old: Mapping[str, str], force: bool
) -> None:
    """BuildError where a file would be lost that flexgen did not write, or that was changed
    since.
    """
    foreign: list[str] = []
    changed: list[str] = []
    for file, data in content.items():
        path = target / file
        if not os.path.lexists(path) or _digest(path) in (
            hashlib.sha256(data).hexdigest(),
            old.get(file),
        ):
            continue
        (changed if file in old else foreign).append(file)
    if foreign:
        raise BuildError(
            f"{target}: given a folder with files that flexgen did not write "
            f"({', '.join(foreign[:8])}), expected only its own of these names; move them away, "
            f"or {_ADVICE}"
        )
    if changed and not force:
        raise BuildError(
            f"{target}: given files that were changed since the export "
            f"({', '.join(changed[:8])}), expected unchanged ones; move them away, choose "
            "another folder, or replace them with force=True (--force)"
        )


def _digest(path: Path) -> str | None:
    """SHA-256 of a file; None where it is not a file that can be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return None
