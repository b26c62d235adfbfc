"""C libraries of models that flexgen calls itself: generated once for each model, kept in the
user's cache.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from flexgen.base.calls.deadline import pause
from flexgen.base.errors import BuildError
from flexgen.base.files.atomic_files import temporary_folder
from flexgen.codegen.build.generate import MANIFEST, GeneratedLibrary, generate_parts
from flexgen.codegen.build.library_cache import mark_used, prune
from flexgen.codegen.build.object_cache import cache_folder
from flexgen.codegen.emission.digest import model_digest
from flexgen.codegen.emission.spec import library_name
from flexgen.model.elements import RobotModel
from flexgen.runtime import load
from flexgen.runtime.library import Library
from flexgen.runtime.processor import instruction_sets

KEPT = 32  # loaded libraries


def library_with(
    model: RobotModel,
    functions: Sequence[str],
    solvers: Sequence[str] = (),
    *,
    parameters: Sequence[str] = (),
    per_point: bool = False,
    native: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Library:
    """The library of a model with some functions of the C library, made once for each model and
    kept in the cache.

    Parameters
    ----------
    model : RobotModel
    functions : sequence of str
        Names of the functions.
    solvers : sequence of str
        Names of hand-written sources, such as ``invert``; those that are not named are not
        compiled.
    parameters : sequence of str
        Numbers of the model that are arguments of the functions.
    per_point : bool
        Batches take one vector of them for each point.
    native : bool
        Compile for this processor: often faster, and the last digits depend on the processor.
    progress : callable, optional
        Called with one line of text before a long step.

    Raises
    ------
    BuildError
        There is no compiler, or it fails.
    """
    with pause():
        what = _What(tuple(functions), tuple(solvers), tuple(parameters), native, per_point)
        return _load(model, what, progress if progress is not None else _silent)


def _silent(line: str) -> None:
    """Do not log."""


@dataclass(frozen=True)
class _What:
    """Content of a library: names of functions, solvers and parameters, and whether it is for this
    processor only.
    """

    functions: tuple[str, ...]
    solvers: tuple[str, ...]
    parameters: tuple[str, ...]
    native: bool
    per_point: bool = False

    def generate(
        self, model: RobotModel, folder: Path, progress: Callable[[str], None]
    ) -> GeneratedLibrary:
        """Generate the library, or find that it is there."""
        return generate_parts(
            model,
            folder,
            self.functions,
            self.solvers,
            parameters=self.parameters,
            per_point=self.per_point,
            native=self.native,
            progress=progress,
        )


@lru_cache(maxsize=KEPT)
def library_holder(digest: str, what: _What) -> list[Library]:
    """Holder of the library of the model with this digest, kept by this process."""
    return []


def _load(model: RobotModel, what: _What, progress: Callable[[str], None]) -> Library:
    """The library of a model with the choices ``what``: of this process, or of the cache.

    Its folder has a hash of model, choices and processor in its name, as computers can share a
    cache; without a cache it is in a temporary folder.
    """
    digest = model_digest(model)
    holder = library_holder(digest, what)
    if holder:
        mark_used(holder[0].directory)
        return holder[0]
    root = cache_folder()
    # computers that share the cache can differ
    processor = " ".join(sorted(instruction_sets() or ()))
    mark = hashlib.sha256(f"{digest} {what} {processor}".encode()).hexdigest()[:16]
    with temporary_folder() if root is None else nullcontext(root / "libraries") as folder:
        target = folder / f"{library_name(model)}-{mark}"
        holder.append(_load_from_cache(model, target, what, progress))
    return holder[0]


def _load_from_cache(
    model: RobotModel, target: Path, what: _What, progress: Callable[[str], None]
) -> Library:
    """The library in the folder ``target`` of the cache; generated where it is missing, and once
    more where another process removed it meanwhile.
    """
    for there in ((target / MANIFEST).exists(), False):
        mark_used(target)
        try:
            made = what.generate(model, target, progress)
            library = load(made.directory)
            break
        except (BuildError, OSError):  # another process may remove it meanwhile, but no new one
            if not there or (target / MANIFEST).exists():
                raise
    if made.written:
        prune(target.parent)
    return library
