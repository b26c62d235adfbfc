"""Types of arguments, checked against the annotations at every public function, constructor and
method.

The order of checks: a constructor first checks itself, since its own messages are more specific;
then its arguments, as a data class stored them, are compared with the annotations. A function or a
method compares first, so that nothing is written or computed for an argument of a wrong type,
except of the parameters that it checks itself as its first step, with a more specific message:
``own`` of `checked_types` names them.
"""

from __future__ import annotations

import functools
import inspect
import sys
from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import dataclass, is_dataclass, replace
from typing import Any, NamedTuple, NoReturn, TypeVar, overload

from flexgen.base.checks.counts import show_value
from flexgen.base.checks.types_of_values import (
    UNWRITABLE,
    Check,
    Names,
    check_of,
    is_infinite,
    is_text,
)
from flexgen.base.errors import (
    ArgumentError,
    FlexgenError,
    SolverError,
    computation_failed,
    is_numerical,
)
from flexgen.base.registry import find_function

T = TypeVar("T", bound=Callable[..., Any])
C = TypeVar("C", bound=type)
# the cause of a numerical error is looked for, which may fail likewise
_NAMING = ContextVar("_NAMING", default=False)

# What a parameter means, where the words of its type say less; the same in all functions.
WORDS = {
    "move": "the name of a move or a flexgen.Move",
    "overrides": "a mapping of dotted paths to values",
    "mesh": "a number of intervals, a length in s, or increasing relative nodes",
    "progress": "a function of one line, True, False or None",
    "limits": "flexgen.Limits(torque=..., speed=...)",
    "preview": "zero or a positive time in s",
    "plants": "a mapping of names to changes, such as {'soft': {'stiffness': 0.9}}",
}
FROM_FILES = "from_data"  # constructors of data that was checked when its file was read


@overload
def checked_types(function: T, /) -> T: ...


@overload
def checked_types(*, own: tuple[str, ...]) -> Callable[[T], T]: ...


def checked_types(function: Any = None, /, *, own: tuple[str, ...] = ()) -> Any:
    """Decorate a public function or method: ArgumentError where an argument is not what its
    annotation says.

    Numbers are finite and neither true, false nor a text; those of a sequence or an array may be
    infinite, as bounds are. Whole numbers have at most 63 bits; texts have no character that no
    file name can have. Sequences may be lists, tuples or arrays. Annotations are resolved at the
    first call.

    Parameters
    ----------
    own : tuple of str
        Parameters that the function checks itself, types included, before it does anything else.
    """
    if function is None:
        return functools.partial(_wrap, own=own)
    return _wrap(function)


def checked_class(cls: C) -> C:
    """Decorate a public class: its constructor and its public methods are checked as by
    `checked_types`.
    """
    cls.__init__ = _wrap(cls.__init__, cls=cls)  # type: ignore[misc]
    return checked_methods(cls)


def checked_result(cls: C) -> C:
    """Decorate a public data class of results: as `checked_class`, but its numbers may be infinite
    or nan.
    """
    cls.__init__ = _wrap(cls.__init__, cls=cls, result=True)  # type: ignore[misc]
    return checked_methods(cls)


def checked_methods(cls: C) -> C:
    """Decorate a public class that only flexgen makes objects of: its public methods are checked
    by `checked_types`.
    """
    for name, member in list(vars(cls).items()):
        if name.startswith("_") or name == FROM_FILES or hasattr(member, "__checks__"):
            continue
        kind = type(member) if isinstance(member, classmethod | staticmethod) else None
        function = member if kind is None else member.__func__
        if inspect.isfunction(function) and _parameters(function) > (
            0 if kind is staticmethod else 1
        ):
            setattr(cls, name, _wrap(function) if kind is None else kind(_wrap(function)))
    return cls


def checks_of(function: Callable[..., Any]) -> dict[str, Check]:
    """Checks of the parameters of a function, method or class by name, from its annotations,
    decorated or not.
    """
    constructor: Any = function
    if isinstance(function, type):
        constructor = function.__init__  # type: ignore[misc]
    entrance = getattr(constructor, "__checks__", None) or _Entrance(constructor)
    return replace(entrance, own=(), made=None).plan().by_name


class _Plan(NamedTuple):
    """Checks of the positional parameters, of all by name, of further positional ones; names of
    the positional ones.
    """

    positional: list[Check | None]
    by_name: dict[str, Check]
    others: Check | None
    names: list[str]


@dataclass(eq=False)
class _Entrance:
    """A decorated function; ``head`` is the beginning of its messages. Its plan is made at the
    first call.
    """

    function: Callable[..., Any]
    head: str = ""
    cls: type | None = None
    result: bool = False
    own: tuple[str, ...] = ()
    made: _Plan | None = None

    def plan(self) -> _Plan:
        """The checks of the parameters."""
        if self.made is None:
            self.made = _plan(self.function, self.cls, self.result, self.own)
        return self.made

    def check(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
        """ArgumentError where an argument is not what its annotation says."""
        positional, by_name, others, names = self.made or self.plan()
        for index, value in enumerate(args):
            check = positional[index] if index < len(positional) else others
            if check is not None and not check.passes(value):
                self.refuse(names[min(index, len(names) - 1)], value, check)
        for name, value in kwargs.items():
            check = by_name.get(name)
            if check is not None and not check.passes(value):
                self.refuse(name, value, check)

    def collect_stored(
        self, args: tuple[Any, ...], kwargs: dict[str, Any]
    ) -> tuple[tuple[()], dict[str, Any]]:
        """The arguments of a data class as it stored them: its `__post_init__` may have made a
        tuple of an array.
        """
        given = dict(zip(self.plan().names[1:], args[1:], strict=False)) | kwargs
        return (), {name: getattr(args[0], name, value) for name, value in given.items()}

    def refuse(self, name: str, value: Any, check: Check) -> NoReturn:
        """State what was given and what was expected."""
        words = (
            UNWRITABLE
            if isinstance(value, str) and not is_text(value)
            else WORDS.get(name, check.words)
        )
        raise ArgumentError(
            f"{self.head}{name}: given {show_value(value)}, expected {words}"
        ) from None


def _naming_numbers(function: Any) -> Any:
    """A function of a model whose numerical errors are a SolverError that names the likely
    cause.
    """

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        try:
            return function(*args, **kwargs)
        except (ArithmeticError, ValueError) as error:
            if not is_numerical(error) or _NAMING.get():
                raise
            naming = _NAMING.set(True)
            try:
                cause = find_function("Check.implausible")(args[0] if args else kwargs["model"])
            finally:
                _NAMING.reset(naming)
            raise SolverError(computation_failed(function.__name__, error) + cause) from error

    return call


def _wrap(
    function: Any, *, cls: type | None = None, result: bool = False, own: tuple[str, ...] = ()
) -> Any:
    """The function with a check of its arguments: before each call; after an error, of arguments
    that it checks itself (``own``); and of a constructor (``cls``) after it, with what it has
    stored, since it may convert. ``result``: flexgen makes the objects, so that numbers need not
    be finite.
    """
    head = "" if cls is None else f"{cls.__name__}, "
    if inspect.isfunction(function) and inspect.unwrap(function).__code__.co_varnames[:1] == (
        "model",
    ):
        function = _naming_numbers(function)
    entrance = _Entrance(function, head, cls, result, own)
    check = entrance.check
    check_all = replace(entrance, own=()).check
    stored = entrance.collect_stored
    # a class with an __init__ of its own may keep something else under the name of an argument
    made = getattr(cls, "__dataclass_params__", None)
    stores = made is not None and made.init

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        check(args, kwargs)
        return function(*args, **kwargs)

    @functools.wraps(function)
    def call_with_own(*args: Any, **kwargs: Any) -> Any:
        """Check own types before, and after an unexpected error all: it is then an ArgumentError
        where a type was the cause.
        """
        check(args, kwargs)
        try:
            return function(*args, **kwargs)
        except FlexgenError:
            raise
        except Exception:
            check_all(args, kwargs)
            raise

    @functools.wraps(function)
    def construct(*args: Any, **kwargs: Any) -> None:
        """Make the object, then check what it stores; after an unexpected error the arguments are
        checked first.
        """
        try:
            function(*args, **kwargs)
        except FlexgenError:
            raise
        except Exception:
            check(args, kwargs)
            raise
        check(*stored(args, kwargs) if stores else (args, kwargs))

    door: Any = construct if cls is not None else call_with_own if own else call
    door.__checks__ = entrance
    return door


def _parameters(function: Any) -> int:
    """Number of parameters of a function, ``self`` included; several where it is free."""
    code = function.__code__
    free = code.co_flags & (inspect.CO_VARARGS | inspect.CO_VARKEYWORDS)
    return int(code.co_argcount + code.co_kwonlyargcount + free)


def _plan(
    function: Callable[..., Any], cls: type | None, result: bool, own: tuple[str, ...]
) -> _Plan:
    """The checks of the arguments of a function, by their annotations.

    ``cls``: class of a method, for names in annotations; ``result``: flexgen computes the
    arguments, so that numbers may be infinite or nan; ``own``: names of the arguments that the
    function checks itself. Others without a check: those without annotation, and further keywords.
    """
    inner = inspect.unwrap(function)
    positional: list[Check | None] = []
    by_name: dict[str, Check] = {}
    others = None
    labels = []
    for name, parameter in inspect.signature(inner).parameters.items():
        annotation = parameter.annotation
        if isinstance(annotation, str):
            annotation = eval(annotation, Names(_namespace(inner, cls, name)))
        infinite = is_infinite(parameter.default)
        free = name in own or annotation is parameter.empty
        check = None if free else check_of(annotation, infinite=infinite, result=result)
        if parameter.kind is parameter.VAR_POSITIONAL:
            others = check
            labels.append(name)
        elif parameter.kind is not parameter.VAR_KEYWORD:
            if parameter.kind is not parameter.KEYWORD_ONLY:
                positional.append(check)
                labels.append(name)
            if check is not None:
                by_name[name] = check
    return _Plan(positional, by_name, others, labels)


def _namespace(function: Callable[..., Any], cls: type | None, name: str) -> dict[str, Any]:
    """The names of the module in which a parameter is annotated: that of a field is the module of
    its class.
    """
    for base in cls.__mro__ if cls is not None and is_dataclass(cls) else ():
        if name in vars(base).get("__annotations__", {}):
            return vars(sys.modules[base.__module__])
    return function.__globals__
