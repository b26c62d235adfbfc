"""Extensions: what applications and other packages add to the rooms below them, by group and name.

=============  =============================================================  ================================
group          what a name refers to                                          used by
=============  =============================================================  ================================
``methods``    a `flexgen.inversion.method_table.Method`                      `flexgen.solve`
``laws``       a class of feedback laws, see `flexgen.loop.model_law`         `flexgen.control`, controller files
=============  =============================================================  ================================

The applications of flexgen are registered when ``flexgen`` is imported. Another package declares an entry point of the
group ``flexgen.methods`` or ``flexgen.laws``:

    [project.entry-points."flexgen.methods"]
    my_method = "my_package.method:METHOD"

An object is imported when it is first used.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from flexgen.errors import ArgumentError

_registered: dict[str, dict[str, str]] = {}


def register(group: str, targets: dict[str, str]) -> None:
    """Add objects of flexgen itself: ``module:object`` by name."""
    _registered.setdefault(group, {}).update(targets)


@cache
def names(group: str) -> tuple[str, ...]:
    """All names of a group: those of flexgen first, then those of other packages by their names."""
    own = _registered.get(group, {})
    return (*own, *sorted({point.name for point in entry_points(group=f"flexgen.{group}")} - set(own)))


@cache
def extension(group: str, name: str) -> Any:
    """The object of a name; ArgumentError where it cannot be imported."""
    target = _registered.get(group, {}).get(name)
    if target is not None:
        module, _, attribute = target.partition(":")
        return getattr(import_module(module), attribute)
    found = {point.name: point for point in entry_points(group=f"flexgen.{group}")}[name]
    try:
        return found.load()
    except Exception as error:  # code of others
        raise ArgumentError(
            f"entry point {name} = {found.value!r} of flexgen.{group}: {type(error).__name__}: {error}; repair or "
            "uninstall that package"
        ) from error
