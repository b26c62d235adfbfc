"""The C library behind the methods that are solved in C: generated once for a model, kept in the user's cache."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

from flexgen.build.compiler import find_compiler
from flexgen.build.generate import MANIFEST, generate
from flexgen.build.library_cache import mark_used, prune
from flexgen.build.object_cache import cache_folder
from flexgen.codegen.spec import library_name, model_digest
from flexgen.errors import ArgumentError, BuildError
from flexgen.mechanics.equations import Equations
from flexgen.mechanics.signatures import INVERSION
from flexgen.model.elements import RobotModel
from flexgen.runtime import load
from flexgen.runtime.library import Library

KEPT = 32  # loaded libraries


def has_compiler() -> bool:
    """Whether this machine can build a library."""
    return find_compiler() is not None


def inversion_library(
    equations: Equations, method: str, *, native: bool = False, progress: Callable[[str], None] | None = None
) -> Library:
    """The library of a model with what inverts it.

    Parameters
    ----------
    equations : Equations
    method : str
        Who asks, for the errors.
    native : bool
        True: compiled for this processor; some times faster, and the last digits depend on the processor.
    progress : callable, optional
        Called with a line of text before something that takes long.

    Raises
    ------
    ArgumentError
        Where the model does not invert in C.
    BuildError
        Where there is no compiler, or it fails.
    """
    model = equations.model
    reason = model.inversion_obstacle()
    if reason is not None:
        raise ArgumentError(f"method {method}: {reason}; use --method full")
    return _loaded(_Key(model), native, progress if progress is not None else _silent)


def _silent(line: str) -> None:
    """Say nothing."""


class _Key:
    """A model, equal to another with the same data."""

    def __init__(self, model: RobotModel) -> None:
        self.model, self.digest = model, model_digest(model)

    def __hash__(self) -> int:
        return hash(self.digest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and other.digest == self.digest


@lru_cache(maxsize=KEPT)
def _built(key: _Key, native: bool) -> list[Library]:
    """Where the library of a model is kept while this process lives."""
    return []


def _loaded(key: _Key, native: bool, progress: Callable[[str], None]) -> Library:
    place = _built(key, native)
    if not place:
        model = key.model
        functions = [name for name in INVERSION if name != "inversion_jacobians" or model.n_e]
        root = cache_folder()
        mark = hashlib.sha256(f"{key.digest} {native}".encode()).hexdigest()[:16]
        if root is None:
            with tempfile.TemporaryDirectory() as folder:
                made = generate(model, Path(folder) / "library", functions=functions, native=native, progress=progress)
                place.append(load(made.directory))
        else:
            target = root / "libraries" / f"{library_name(model)}-{mark}"
            place.append(_kept(model, target, functions, native, progress))
    else:
        mark_used(place[0].directory)
    return place[0]


def _kept(
    model: RobotModel, target: Path, functions: list[str], native: bool, progress: Callable[[str], None]
) -> Library:
    """The library in a folder of the cache, made where it is missing."""
    there = (target / MANIFEST).exists()
    mark_used(target)
    try:
        made = generate(model, target, functions=functions, native=native, progress=progress)
        library = load(made.directory)
    except (BuildError, OSError):
        if not there or (target / MANIFEST).exists():
            raise
        # another process removed it in that moment; nobody does so with a new one
        made = generate(model, target, functions=functions, native=native, progress=progress)
        library = load(made.directory)
    if made.written:
        prune(target.parent)
    return library
