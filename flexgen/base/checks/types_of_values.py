"""Whether a value is of the type that an annotation states, and the type in words."""

from __future__ import annotations

import builtins
import math
import os
import types
import typing
from collections.abc import Callable, Iterable, KeysView, Mapping, Sequence, Set
from numbers import Real
from typing import Annotated, Any, Union

from flexgen.base.checks.bounds import Bound
from flexgen.base.spec.arguments import is_number, is_whole

LARGEST = 2**63 - 1  # largest whole number accepted as a count or seed
UNWRITABLE = "a text in UTF-8 without the character 0"


class Check:
    """Whether a value is of a type, and the type in words.

    Attributes
    ----------
    passes : callable
        Of a value.
    words : str
        What is expected, such as ``a finite number``.
    """

    __slots__ = ("passes", "words")

    def __init__(self, passes: Callable[[Any], bool], words: str) -> None:
        self.passes = passes
        self.words = words


class LateClass(type):
    """A class that is imported for type checkers only, known by its name: an object of it comes
    from elsewhere.
    """

    def __instancecheck__(cls, value: object) -> bool:
        return any(base.__name__ == cls.__name__ for base in type(value).__mro__)


class Names(dict[str, Any]):
    """The names of a module; those that are imported for type checkers only are late classes."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, None) or LateClass(name, (), {})


def is_infinite(value: Any) -> bool:
    """Whether a value, such as a default, is infinite."""
    return isinstance(value, float) and math.isinf(value)


def check_of(  # noqa: C901
    annotation: Any, *, infinite: bool = False, result: bool = False
) -> Check | None:
    """The check of an annotation; None where every value passes.

    Parameters
    ----------
    annotation : type, union, generic alias or None
    infinite : bool
        Numbers may be infinite.
    result : bool
        Numbers may be infinite or nan, arrays and sequences may hold anything: what flexgen itself
        computed.
    """

    def part_of(part: Any, entry: bool = True) -> Check | None:
        return check_of(part, infinite=infinite or entry, result=result)

    if annotation is None or annotation is type(None):
        return Check(lambda value: value is None, "None")
    if annotation is str and result:
        return Check(lambda value: isinstance(value, str), "a text")
    if annotation in (float, int, bool, str):
        return _scalar(annotation, infinite, result)
    origin = typing.get_origin(annotation)
    parts = typing.get_args(annotation)
    if origin is Annotated:
        bounds = [part for part in parts[1:] if isinstance(part, Bound)]
        return _within(part_of(parts[0], False), bounds)
    if origin in (Union, types.UnionType):
        return _union([part_of(part, False) for part in parts])
    if origin is typing.Literal:
        return _literal(parts)
    if origin is None:
        return _of_class(annotation, result)
    if not isinstance(origin, type):
        return None
    if origin is Callable:
        return Check(callable, "a function")
    if issubclass(origin, os.PathLike):
        return _of_class(os.PathLike, result)
    if issubclass(origin, Mapping):
        return _mapping(part_of(parts[0]), part_of(parts[1]))
    if origin is tuple and Ellipsis not in parts:
        return _tuple([part_of(part) for part in parts])
    if issubclass(origin, Sequence):
        return _sequence(part_of(parts[0]))
    if origin is Iterable:
        return _sequence(part_of(parts[0]), iterators=True)
    return _of_class(origin, result)


# --- checks of one type --------------------------------------------------------------------------
def _scalar(kind: type, infinite: bool, result: bool) -> Check:
    """The check of a number, truth value or text. ``infinite``: the default of the argument is, so
    that others may be; ``result``: any real number, since flexgen computes it.
    """
    if kind is float and result:
        return Check(_is_real, "a number")
    if kind is float and infinite:
        return Check(
            lambda value: is_number(value) or (_is_real(value) and abs(value) == math.inf),
            "a number",
        )
    if kind is float:
        return Check(is_number, "a finite number")
    if kind is int:
        return Check(lambda value: is_whole(value, -LARGEST, LARGEST), "a whole number below 2^63")
    if kind is bool:
        return Check(lambda value: type(value).__name__ in ("bool", "bool_"), "True or False")
    return Check(is_text, "a text")


def _within(check: Check | None, bounds: Sequence[Bound]) -> Check | None:
    """The check of a number, and then its bounds."""
    if check is None or not bounds:
        return check
    passes = check.passes
    return Check(
        lambda value: passes(value) and all(bound.passes(value) for bound in bounds),
        bounds[-1].words,
    )


def _is_real(value: Any) -> bool:
    return is_number(value) or (isinstance(value, Real) and not isinstance(value, int))


def is_text(value: Any) -> bool:
    """Whether a value is a text that a file can have as its name or contents."""
    if not isinstance(value, str) or "\0" in value:
        return False
    return value.isascii() or not any("\ud800" <= character <= "\udfff" for character in value)


def _literal(parts: tuple[Any, ...]) -> Check:
    """The check of a ``Literal``: one of its ``parts``; 1 and 0 are not True and False."""
    others = [part for part in parts if not isinstance(part, bool)]

    def passes(value: Any) -> bool:
        if any(value is part for part in parts):  # True and False only so: they equal 1 and 0
            return True
        return (isinstance(value, str) or is_whole(value, -LARGEST, LARGEST)) and value in others

    return Check(passes, f"one of {', '.join(map(str, parts))}")


def _of_class(kind: Any, result: bool) -> Check | None:
    """The check of a class; None for ``Any``, objects of CasADi, and variables of types."""
    if not isinstance(kind, type) or kind in (object, Any) or kind.__module__.startswith("casadi"):
        return None
    if getattr(kind, "_is_protocol", False):
        return None
    if issubclass(kind, os.PathLike):
        return Check(
            lambda value: isinstance(value, os.PathLike) and is_text(os.fspath(value)), "a path"
        )
    if kind.__name__ == "ndarray":
        return (
            Check(_is_any_array, "an array")
            if result
            else Check(_is_array, "an array of numbers without nan")
        )
    if kind in (tuple, list) or kind is Sequence:
        return _sequence(None)
    own = kind.__module__.startswith("flexgen") or isinstance(kind, LateClass)
    return Check(
        lambda value: isinstance(value, kind),
        f"a flexgen.{kind.__name__}" if own else f"a {kind.__name__}",
    )


def _union(parts: Sequence[Check | None]) -> Check | None:
    """The check of a union: one of the parts; None, no check, where a part has none."""
    checks = [part for part in parts if part is not None]
    if len(checks) < len(parts):
        return None
    words = list(dict.fromkeys(check.words for check in checks))
    if any("; None " in text for text in words):  # a bound that says what None means
        words.remove("None")
    passes = [check.passes for check in checks]
    return Check(lambda value: any(found(value) for found in passes), " or ".join(words))


# --- arrays and collections ----------------------------------------------------------------------
def _is_array(value: Any) -> bool:
    """Whether a value is an array of numbers, or becomes one; infinite values are not accepted as
    bounds.
    """
    import numpy as np

    if isinstance(value, str | bytes | bytearray | Mapping):
        return False
    try:
        array = np.asarray(value)
        return array.dtype.kind in "biuf" and not np.isnan(array).any()
    except (TypeError, ValueError, OverflowError):
        return False


def _is_any_array(value: Any) -> bool:
    return hasattr(value, "dtype") or items_of(value) is not None


def items_of(value: Any) -> Sequence[Any] | None:
    """The entries of a list, a tuple, an array or a view of a mapping; None for something else."""
    if isinstance(value, list | tuple):
        return value
    if isinstance(value, str | bytes | bytearray | memoryview | Mapping) or not hasattr(
        value, "__len__"
    ):
        return None
    if (isinstance(value, Set) and not isinstance(value, KeysView)) or isinstance(value, type):
        return None
    if hasattr(value, "dtype") and not getattr(value, "shape", None):
        return None
    return list(value) if hasattr(value, "__iter__") else None


def _sequence(entry: Check | None, iterators: bool = False) -> Check:
    """The check of a sequence whose items pass ``entry``; None: any. With ``iterators`` also of an
    iterator, whose items are checked where they are taken.
    """

    def passes(value: Any) -> bool:
        """Whether a value is a sequence of entries that pass, or an iterator where these are
        allowed (it is not read).
        """
        items = items_of(value)
        if items is None:
            return (
                iterators
                and isinstance(value, Iterable)
                and not isinstance(value, str | bytes | bytearray | Mapping)
            )
        return entry is None or all(map(entry.passes, items))

    words = "" if entry is None else entry.words
    if words.startswith("a sequence"):
        return Check(passes, f"a sequence of {words[2:].replace('sequence', 'sequences', 1)}")
    return Check(passes, f"a sequence with {words} in each place" if words else "a sequence")


def _tuple(entries: Sequence[Check | None]) -> Check:
    """The check of a sequence with as many items as ``entries``, each with its own check."""

    def passes(value: Any) -> bool:
        """Whether a value has as many items as there are entries, and each passes its own."""
        items = items_of(value)
        if items is None or len(items) != len(entries):
            return False
        return all(
            entry is None or entry.passes(item) for entry, item in zip(entries, items, strict=True)
        )

    words = ", ".join("anything" if entry is None else entry.words for entry in entries)
    return Check(passes, f"a sequence of {len(entries)}: {words}")


def _mapping(key: Check | None, entry: Check | None) -> Check:
    """The check of a mapping with checks of its keys and values; None: any."""

    def passes(value: Any) -> bool:
        return isinstance(value, Mapping) and all(
            (key is None or key.passes(name)) and (entry is None or entry.passes(item))
            for name, item in value.items()
        )

    words = ["anything" if check is None else check.words for check in (key, entry)]
    return Check(
        passes, "a mapping" if key is entry is None else f"a mapping of {words[0]} to {words[1]}"
    )
