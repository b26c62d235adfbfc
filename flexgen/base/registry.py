"""Registry of additions by upper rooms and other packages to the rooms below them, by group and
name; an entry is imported when it is first used.

Groups, what their names refer to, and what uses them:

- ``results``: a function (pictures, reports, searches); methods of results, such as
  ``Solution.plot``.
- ``methods``: a `Method` of `flexgen.inversion.methods.method_table`; `flexgen.solve`.
- ``laws``: a class of feedback laws, see `flexgen.feedback.loop.model_law`; `flexgen.control` and
  controller files.
- ``frictions``: a class, see `flexgen.model.friction`; the key ``type`` of friction in model
  files.
- ``hysteresis``: a class, see `flexgen.base.spec.memory`; the key ``type`` of hysteresis in model
  files.
- ``exports``: a function, see `flexgen.exports.c_code.added`; `flexgen.export` and
  ``flexgen export``.
- ``devices``: a class, see `flexgen.runtime.library.Library`; `flexgen.load`.

The front room, `flexgen`, hands down the tables of flexgen itself; no room below names a room
above. Another package declares an entry point of such a group:

    [project.entry-points."flexgen.methods"]
    my_method = "my_package.method:METHOD"
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

from flexgen.base.errors import ArgumentError


class Export(NamedTuple):
    """An export of flexgen: the module of its function, its page in docs/, what its command does,
    and its options.

    The options are rows of `flexgen.cli.verb_tables.verb_rows`.
    """

    module: str
    page: str
    summary: str
    options: str


EXPORTS: dict[str, Export] = {}  # by name of the command, filled by `flexgen`
_TARGETS: dict[str, dict[str, str]] = {}


def register(group: str, targets: Mapping[str, str]) -> None:
    """Add to a group: ``module:object`` by name; a later entry replaces an earlier one."""
    _TARGETS.setdefault(group, {}).update(targets)


def import_object(target: str) -> Any:
    """The object ``module:object``."""
    module, _, name = target.partition(":")
    return getattr(import_module(module), name)


def find_function(name: str) -> Any:
    """The function of the group ``results`` with a name."""
    return import_object(_TARGETS["results"][name])


def own_names(group: str) -> tuple[str, ...]:
    """The names of a group that flexgen itself has registered."""
    return tuple(_TARGETS.get(group, {}))


@cache
def _points(group: str) -> dict[str, Any]:
    """The entry points of a group by name."""
    # here: it takes as long to import as the rest of ``--version``
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group=f"flexgen.{group}")}


@cache
def added_names(group: str) -> tuple[str, ...]:
    """The names of a group that other packages have added."""
    return tuple(sorted(_points(group).keys() - set(own_names(group))))


def names(group: str) -> tuple[str, ...]:
    """All names of a group: those of flexgen first."""
    return (*own_names(group), *added_names(group))


@cache
def extension(group: str, name: str) -> Any:
    """The object of a name; ArgumentError where it cannot be imported."""
    target = _TARGETS.get(group, {}).get(name)
    if target is not None:
        return import_object(target)
    found = _points(group)[name]
    try:
        return found.load()
    except Exception as error:  # code of others
        raise ArgumentError(
            f"entry point {name} = {found.value!r} of flexgen.{group}: {type(error).__name__}: "
            f"{error}; repair or uninstall that package"
        ) from error
