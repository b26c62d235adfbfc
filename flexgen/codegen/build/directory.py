"""The directory of a library: only files that flexgen wrote there are replaced or removed, all of
them or none.

Files belong to flexgen where the manifest of the same library lists them, where they state that
flexgen wrote them, or where they have exactly the bytes that are to be written. All other files
belong to the user: they are refused, not replaced.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from flexgen.base.errors import BuildError
from flexgen.base.files.atomic_files import remove_leftovers, staging_folder

MANIFEST = "manifest.json"
# largest rights of files and folders, whatever the umask: what every user may write is not loaded
OPEN = 0o775
SOURCES = "src"  # folder of the private files
MANIFEST_MAX = 20_000_000  # bytes

_FILE = re.compile(
    r"(CMakeLists\.txt|(src/)?[A-Za-z][A-Za-z0-9_]*(-[0-9a-f]{16})?\.(h|c|pc|a|so|dylib|dll))\Z"
)
_HASHED = re.compile(
    r"lib(?P<name>[A-Za-z][A-Za-z0-9_]*)-(?P<hash>[0-9a-f]{16})\.(so|dylib|dll)\Z"
)
_MARK = b"written by flexgen"
_HEAD = 4096  # bytes at the top of a file, in which the mark is


def read_manifest(directory: Path, name: str) -> dict[str, Any] | None:
    """The manifest of the library in a directory; None where there is none, or one that cannot be
    used.

    Parameters
    ----------
    directory : Path
    name : str
        The library that is to be written there.

    Raises
    ------
    BuildError
        The manifest is that of another library or of another program.
    """
    path = directory / MANIFEST
    advice = "choose another folder (directory=... in Python, --out DIR on the command line)"
    try:
        with path.open("rb") as stream:
            raw = stream.read(MANIFEST_MAX + 1)
        manifest = json.loads(raw) if len(raw) <= MANIFEST_MAX else None
    except OSError:
        return None
    except (ValueError, RecursionError):
        manifest = None
    if isinstance(manifest, dict):
        generator = manifest.get("generator")
        other = manifest.get("name")
        if not isinstance(generator, str) or not generator.startswith("flexgen "):
            raise BuildError(
                f"{path}: given the file of another program, expected none or one of flexgen; "
                f"{advice}"
            )
        if other != name:
            raise BuildError(
                f"{directory}: given a folder with the library {str(other)[:80]!r}, expected an "
                f"empty one or one of {name!r}; {advice}, or remove that library first"
            )
        return manifest if _is_complete(manifest) else None
    if not _is_marked(directory / f"{name}.h", name):
        raise BuildError(
            f"{path}: given a file that flexgen did not write, expected none; {advice}"
        )
    return None


def _is_complete(manifest: dict[str, Any]) -> bool:
    """Whether what `generate` reads of a manifest has the right types."""
    files = manifest.get("files")
    functions = manifest.get("functions")
    build = manifest.get("build")
    if not (
        isinstance(files, dict)
        and all(isinstance(sha, str) and _FILE.match(key) for key, sha in files.items())
    ):
        return False
    if not (isinstance(functions, list) and isinstance(manifest.get("digest"), str)):
        return False
    if not all(
        isinstance(function, dict) and isinstance(function.get("name"), str)
        for function in functions
    ):
        return False
    if build is None:
        return "build" in manifest
    names = [build.get(key) for key in ("library", "static")] if isinstance(build, dict) else []
    return bool(names) and all(isinstance(name, str) and _FILE.match(name) for name in names)


def libraries(manifest: Mapping[str, Any] | None) -> list[str]:
    """Names of the compiled files of a manifest."""
    return (
        [manifest["build"]["library"], manifest["build"]["static"]]
        if manifest and manifest["build"]
        else []
    )


def is_unchanged(directory: Path, files: Mapping[str, str]) -> bool:
    """True where every file is there with its SHA-256."""
    try:
        return all(
            _FILE.match(file) and _sha256(directory / file) == digest
            for file, digest in files.items()
        )
    except OSError:
        return False


def check_owned(
    directory: Path, name: str, texts: Mapping[str, str], old: Mapping[str, Any] | None
) -> None:
    """Refuse to replace files that flexgen did not write.

    Parameters
    ----------
    directory : Path
    name : str
        The library.
    texts : mapping of str to str
        Name and text of each file to be written.
    old : mapping, optional
        The manifest of the directory.

    Raises
    ------
    BuildError
        With the names of the files.
    """
    listed = {*(old or {}).get("files", ()), *libraries(old)}
    # the manifest was removed, the library not
    lost = old is None and _is_marked(directory / f"{name}.h", name)
    foreign = []
    for file, text in texts.items():
        path = directory / file
        own = (
            file in listed
            or (lost and file.startswith((name, f"{SOURCES}/")))
            or not os.path.lexists(path)
        )
        if not own and not _is_marked(path, name) and not _has_bytes(path, text.encode("ascii")):
            foreign.append(file)
    static = directory / f"lib{name}.a"
    if static.name not in listed and not lost and os.path.lexists(static):
        foreign.append(static.name)
    if foreign:
        shown = ", ".join(sorted(foreign)[:8]) + (", ..." if len(foreign) > 8 else "")
        raise BuildError(
            f"{directory}: given a folder with files that flexgen did not write ({shown}), "
            "expected only its own of these names; move them away or choose another folder "
            "(directory=..., --out DIR)"
        )


def _is_marked(path: Path, name: str) -> bool:
    """Whether a file states at its top that flexgen wrote it for this library."""
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD)
    except OSError:
        return False
    return _MARK in head.lower() and name.encode("ascii") in head


def _has_bytes(path: Path, content: bytes) -> bool:
    try:
        return path.stat().st_size == len(content) and path.read_bytes() == content
    except OSError:
        return False


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@contextmanager
def staging(target: Path) -> Iterator[Path]:
    """A temporary folder inside the directory to be written; with it goes a directory that it had
    to create.

    Raises
    ------
    BuildError
        The directory cannot be written, or the disk is full; the directory is as it was before.
    """
    created = not target.exists()
    done = False
    try:
        for folder in reversed([path for path in (target, *target.parents) if not path.exists()]):
            folder.mkdir(mode=OPEN, exist_ok=True)
        with staging_folder(target) as folder:
            yield folder
        done = True
    except OSError as error:
        raise BuildError(
            f"directory: given {target}, which cannot be written ({error.strerror or error}); "
            "the old content is unchanged; free space or choose another directory"
        ) from error
    finally:
        if not done and created and target.is_dir() and not any(target.iterdir()):
            target.rmdir()


def install(
    staged: Path, target: Path, manifest: dict[str, Any], old: Mapping[str, Any] | None
) -> None:
    """Move everything into place, the manifest last, then remove files of the last generation that
    are not needed.
    """
    (staged / MANIFEST).write_text(
        json.dumps(manifest, indent=2) + "\n", encoding="utf-8", newline="\n"
    )
    built = libraries(manifest)
    for file in [
        *manifest["files"],
        *(file for file in built if (staged / file).exists()),
        MANIFEST,
    ]:
        (target / file).parent.mkdir(mode=OPEN, exist_ok=True)
        (staged / file).chmod((staged / file).stat().st_mode & OPEN)
        os.replace(staged / file, target / file)
    kept = {target / file for file in (*manifest["files"], *built)}
    for path in {*_list_files(target, old), *_stale_libraries(target, manifest["name"])} - kept:
        path.unlink(missing_ok=True)
    with suppress(OSError):
        (target / SOURCES).rmdir()  # where no file is left in it


def _list_files(target: Path, old: Mapping[str, Any] | None) -> Iterable[Path]:
    return [
        target / file
        for file in (*(old or {}).get("files", ()), *libraries(old))
        if _FILE.match(file)
    ]


def _stale_libraries(target: Path, name: str) -> Iterator[Path]:
    """Compiled files of earlier generations: shared libraries named by their own hash, and the
    static one.
    """
    for path in target.glob(f"lib{name}-*"):
        found = _HASHED.match(path.name)
        if (
            found
            and found["name"] == name
            and path.is_file()
            and _sha256(path)[:16] == found["hash"]
        ):
            yield path
    yield target / f"lib{name}.a"  # its ownership was checked before


def clean(target: Path) -> None:
    """Remove what killed runs left in the directory."""
    if target.is_dir():
        remove_leftovers(target)
