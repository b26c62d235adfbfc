"""The public interface: its functions, constructors and methods, and those without a check of
their types.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import flexgen
from flexgen.base.checks.type_checks import FROM_FILES, checks_of
from flexgen.dynamics.mechanics.system import ImplicitDae

# classes of results without a name in flexgen, documented in the reference
RETURNED = (ImplicitDae,)
# Called for each sample in a controller: they check their arrays themselves, and take anything
# that is one.
ARRAYS = {
    "Function.__call__",
    "Inverter.__call__",
    "LimitedInverter.__call__",
    "InverseKinematics.__call__",
}
ARRAYS |= {"PathSampler.__call__", "Stream.update"}
LOOKUPS = {"__getitem__"}  # errors of a key: KeyError and IndexError are what Python demands
MADE = {
    "Function",
    "Inverter",
    "LimitedInverter",
    "ManyInverter",
    "InverseKinematics",
    "Library",
    "PathSampler",
}
MADE |= {"Stream"}


@dataclass(frozen=True)
class Entrance:
    """A public callable; ``owner`` is the class of a method, and of a constructor."""

    name: str
    call: Callable[..., Any]
    owner: type | None = None

    @property
    def is_constructor(self) -> bool:
        return self.call is self.owner


def entrances() -> Iterator[Entrance]:
    """All functions and constructors of `flexgen.__all__`, and the public methods of their
    classes.
    """
    for name in flexgen.__all__:
        what = getattr(flexgen, name)
        if inspect.isclass(what):
            yield from of_class(what)
        elif callable(what):
            yield Entrance(name, what)
    for what in RETURNED:
        yield from of_class(what)


def of_class(what: type) -> Iterator[Entrance]:
    """Its constructor and its public methods, inherited ones of flexgen too; errors and
    enumerations have none.
    """
    if issubclass(what, Exception | str) or getattr(what, "_is_protocol", False):
        return
    if what.__name__ not in MADE and what.__init__ is not object.__init__:  # type: ignore[misc]
        yield Entrance(what.__name__, what, what)
    for name in dir(what):
        member = inspect.getattr_static(what, name)
        member = getattr(member, "__func__", member)
        public = not name.startswith("_") or name == "__call__"
        if (
            public
            and name != FROM_FILES
            and inspect.isfunction(member)
            and member.__module__.startswith("flexgen")
        ):
            yield Entrance(f"{what.__name__}.{name}", member, what)


def unchecked() -> list[str]:
    """Entrances with a parameter whose annotation says what it is, and no check."""
    found = []
    for each in entrances():
        call: Any = each.call.__init__ if each.is_constructor else each.call  # type: ignore[misc]
        if each.name not in ARRAYS and checks_of(each.call) and not hasattr(call, "__checks__"):
            found.append(each.name)
    return found
