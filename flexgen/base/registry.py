"""Registry of additions by upper rooms and other packages to the rooms below them, by group and
name; an entry is imported when it is first used.

Groups, what their names refer to, and what uses them:

- ``results``: a function with the decorator `provides` (pictures, reports, searches); methods of
  results, such as ``Solution.plot``.
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

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple, TypeVar

from flexgen.base.errors import ArgumentError

T = TypeVar("T", bound=Callable[..., Any])


class Option(NamedTuple):
    """An option of a command.

    One that is a parameter of the public function of its command states its name, and no type, no
    allowed values and no help: these, and the default, are those of the parameter. What the
    command line alone has is stated.

    Attributes
    ----------
    name : str
        Of the parameter; ``no_X`` switches X off.
    help : str
        Of an option that belongs to no parameter, or to two functions.
    metavar : str, optional
        Placeholder of the value; default: of the type of the parameter. None without a parameter:
        a switch.
    kind : str
        Function of `flexgen.cli.argument_types` that reads the value, such as ``positive``.
    choices : tuple of str
        The words that the value may be.
    several, once, required : bool
        May be given several times; an error where it is given twice; must be given.
    place : bool
        A positional argument.
    group : str
        Options of a group exclude each other.
    word : str
        Name on the command line, where it is another one.
    old : tuple of str
        Former names, which work with a warning, such as ``--single=single``: with a value.
    more : str
        What the help of the command line has more than that of the parameter.
    of : str
        ``FUNCTION.PARAMETER``, where it is a parameter of another public function.
    """

    name: str
    help: str = ""
    metavar: str | None = None
    kind: str = ""
    choices: tuple[str, ...] = ()
    several: bool = False
    once: bool = False
    required: bool = False
    place: bool = False
    group: str = ""
    word: str = ""
    old: tuple[str, ...] = ()
    more: str = ""
    of: str = ""

    @property
    def takes_value(self) -> bool:
        """Whether it takes a value; False for a switch."""
        return bool(self.metavar or self.choices)

    @property
    def parameter(self) -> str:
        """The parameter of the public function."""
        return self.name if self.takes_value else self.name.removeprefix("no_")

    @property
    def option(self) -> str:
        """As it is written on the command line."""
        return self.word or f"--{self.name.replace('_', '-')}"


# Options by the titles of the sections of a help; a text is the name of a parameter.
Sections = Mapping[str, Sequence[str | Option]]


class Export(NamedTuple):
    """An export of flexgen: the module of its function, its page in docs/, what its command does,
    and its options.
    """

    module: str
    page: str
    summary: str
    options: Sections


EXPORTS: dict[str, Export] = {}  # by name of the command, filled by `flexgen`
_TARGETS: dict[str, dict[str, str]] = {}


def register(group: str, targets: Mapping[str, str]) -> None:
    """Add to a group: ``module:object`` by name; a later entry replaces an earlier one."""
    _TARGETS.setdefault(group, {}).update(targets)


def provides(*names: str) -> Callable[[T], T]:
    """Decorate a function of an upper room with the names under which lower rooms find it.

    The front room has the table of all names, so that nothing is imported before it is used:
    ``tests/golden/update.py front`` renders it from the decorators.

    Parameters
    ----------
    names : str
        ``CLASS.method`` of a result, such as ``Solution.plot``, or of what else calls
        `find_function`.

    Examples
    --------
    >>> from flexgen.base.registry import provides
    >>> @provides("Solution.plot")
    ... def plot_solution(solution):
    ...     return solution
    >>> plot_solution.provides
    ('Solution.plot',)
    """

    def mark(function: T) -> T:
        function.provides = names  # type: ignore[attr-defined]
        return function

    return mark


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
