"""Digest of the sources that the text of a library depends on: all that the emission imports.

The modules are found by following the imports written in the sources, those inside of functions
and those by a name in a text too, as the test of the architecture does. A change in any of them
makes new libraries; no list has to be kept.
"""

from __future__ import annotations

import hashlib
import os
import re
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

# The emission begins in these: all modules of the package, and the file that calls it.
EMISSION = "flexgen.codegen.emission"
CALLER = "codegen/build/generate.py"
# Files next to the modules of a package that become part of a library: the fixed C.
C_FILES = (".c", ".h")
# The other packages whose version affects the text: their symbols and last bits of numbers.
NUMERICAL = ("casadi", "numpy", "scipy")

# The front room hands names of all rooms to `flexgen.base.registry`; nothing of it gets into a
# library.
_FRONT = "flexgen"
# One space each, as the formatter writes them: a fixed beginning is found fast.
_FROM = re.compile(rb"from (flexgen[\w.]*) import (\([^)]*\)|[^\n]*)")
_IMPORT = re.compile(rb"import (flexgen[\w.]*)")
# A text with the name of a module, imported by that name; with a dot at its end, of any below it.
_NAMED = re.compile(rb"flexgen\.(?<=[\"']flexgen\.)\w[\w.]*")
_WORD = re.compile(rb"\w+")


@cache
def sources_digest(root: Path | None = None) -> str:
    """SHA-256 of the sources of `emission_files` and of the versions of the packages they import.

    It is computed once in a process, which has imported the sources as they were at that time.

    Parameters
    ----------
    root : Path, optional
        The folder ``flexgen``; where not given, the one of this module.
    """
    root = Path(__file__).resolve().parents[2] if root is None else root
    digest = hashlib.sha256()
    for file, text in emission_files(root).items():
        digest.update(file.encode() + b"\0" + hashlib.sha256(text).digest())
    for package in NUMERICAL:
        digest.update(f"{package} {package_version(package)}\n".encode())
    return digest.hexdigest()


def emission_files(root: Path) -> dict[str, bytes]:
    """The sources that writing a library imports, by their paths below ``root``, sorted.

    Parameters
    ----------
    root : Path
        The folder ``flexgen``.
    """
    tree = _Tree(root)
    found: dict[str, bytes] = {}
    seen = {_FRONT}
    caller = ".".join([_FRONT, *CALLER.removesuffix(".py").split("/")])
    wanted = {caller, *tree.below(EMISSION)}
    while wanted:
        name = wanted.pop()
        seen.add(name)
        file = tree.file(name)
        if file is None:  # not a module: a name in one, whose module is wanted too
            continue
        found[file] = text = tree.content(file)
        if file.endswith("/__init__.py"):
            found |= {other: tree.content(other) for other in tree.c_files(name)}
        wanted |= {name.rpartition(".")[0], *_find_names(tree, text)} - seen
    return dict(sorted(found.items()))


@cache
def package_version(package: str) -> str:
    """Version of an installed package, found without importing it."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


class _Tree:
    """The files of the modules below a folder, by dotted names; each folder is listed once.

    Parameters
    ----------
    root : Path
        The folder ``flexgen``.
    """

    def __init__(self, root: Path) -> None:
        self._root = os.fspath(root)
        self._listings: dict[str, frozenset[str]] = {}

    def _list(self, folder: str) -> frozenset[str]:
        """Names in a folder of the package, read once; none where it is a file or absent."""
        if folder not in self._listings:
            try:
                self._listings[folder] = frozenset(os.listdir(f"{self._root}/{folder}"))
            except OSError:  # not a folder
                self._listings[folder] = frozenset()
        return self._listings[folder]

    def content(self, file: str) -> bytes:
        """The bytes of a file, by its path below the root."""
        with open(f"{self._root}/{file}", "rb") as opened:
            return opened.read()

    def file(self, name: str) -> str | None:
        """The file of a module, below the root; None where there is none."""
        *parents, last = name.split(".")[1:]
        folder = "".join(f"{parent}/" for parent in parents)
        inside = self._list(folder)
        if f"{last}.py" in inside:
            return f"{folder}{last}.py"
        if last in inside and "__init__.py" in self._list(f"{folder}{last}/"):
            return f"{folder}{last}/__init__.py"
        return None

    def c_files(self, package: str) -> list[str]:
        """The C files next to the modules of a package."""
        folder = "".join(f"{part}/" for part in package.split(".")[1:])
        return [f"{folder}{file}" for file in self._list(folder) if file.endswith(C_FILES)]

    def below(self, package: str) -> set[str]:
        """Dotted names of a package and of all modules below it."""
        folder = "".join(f"{part}/" for part in package.split(".")[1:])
        found = {package}
        for file in self._list(folder):
            stem, dot, _ = file.partition(".")
            if file.endswith(".py"):
                found.add(f"{package}.{stem}")
            elif not dot and "__init__.py" in self._list(f"{folder}{file}/"):
                found |= self.below(f"{package}.{file}")
        return found


def _find_names(tree: _Tree, text: bytes) -> set[str]:
    """Dotted names that a source imports or names in a text, of modules and of names in
    modules.
    """
    found: set[str] = set()
    for base, names in _FROM.findall(text):
        module = base.decode()
        found |= {module, *(f"{module}.{word.decode()}" for word in _WORD.findall(names))}
    found |= {name.decode() for name in _IMPORT.findall(text)}
    for named in _NAMED.findall(text):
        name = named.decode()
        # the beginning of an f-string: each module below that package may be meant
        if name.endswith("."):
            found |= tree.below(name.rstrip("."))
        else:
            found |= {name, name.rpartition(".")[0]}
    return found
