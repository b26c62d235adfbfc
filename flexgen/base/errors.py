"""The errors of flexgen: each text has what was given, what was expected, where, and what to
do.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

# characters of what was given, and of a message, that are shown
GIVEN = 600
MESSAGE = 4000

_LONG = re.compile(rf"(?s)(given )((?:(?!, expected ).){{{GIVEN},}})(?=, expected )")


def printable(text: str) -> str:
    """A text without control characters, which a terminal would obey; line ends and tabs stay."""
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode("ascii")
        for c in text
    )


def message_of(text: str) -> str:
    """A message for the user: printable, and with the beginning and the end of what is long."""
    text = _shorten(printable(text), MESSAGE)
    return _LONG.sub(lambda found: found[1] + _shorten(found[2], GIVEN), text)


def _shorten(text: str, most: int) -> str:
    left = len(text) - most
    if left <= 0:
        return text
    return f"{text[: most * 3 // 5]} ... ({left} characters) ... {text[len(text) - most // 4 :]}"


def suggestion(word: str, known: Iterable[str]) -> str:
    """``; did you mean 'solve'?`` if a known word is similar; else an empty text."""
    import difflib

    similar = difflib.get_close_matches(word, list(known), 1)
    return f"; did you mean {similar[0]!r}?" if similar else ""


class FlexgenError(Exception):
    """Base of all errors of flexgen; the text is for the user: control characters are escaped,
    long texts shortened.
    """

    def __init__(self, *args: object) -> None:
        super().__init__(*(message_of(x) if isinstance(x, str) else x for x in args))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled with its text and fields: errors of worker processes reach the user, whatever
        `__init__` takes.
        """
        return _restore, (type(self), self.args, self.__dict__)


def _restore(
    kind: type[FlexgenError], args: tuple[Any, ...], fields: dict[str, Any]
) -> FlexgenError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(fields)
    return error


class ModelError(FlexgenError):
    """A model file is wrong.

    The text reads ``file:line:key: given ..., expected ...``, or ``file: key: ...`` without a
    line; fields: attributes.

    Parameters
    ----------
    file : str
        The file as the user named it.
    line : int
        Line of the key, from 1; 0 for the whole file, or a value that is on no line of it.
    key : str
        Dotted path of the key, such as ``element.joint1.dof.q1.axis``.
    given, expected : str
        The value in the file, and what is allowed.
    """

    def __init__(self, file: str, line: int, key: str, given: str, expected: str) -> None:
        self.file = file
        self.line = line
        self.key = key
        self.given = given
        self.expected = expected
        place = f"{file}:{line}:{key}" if line else f"{file}: {key}"
        super().__init__(f"{place}: given {given}, expected {expected}")


class ArgumentError(FlexgenError, ValueError):
    """An argument of a public function has a wrong type, shape, unit or value."""


class FileError(ModelError, ArgumentError):
    """A file of a controller, a scenario or a grid is wrong: an ArgumentError with the fields of a
    ModelError.
    """


class ChannelError(ArgumentError, KeyError):
    """A trajectory has no channel of this name; also a KeyError."""

    __str__ = Exception.__str__  # KeyError shows the repr of the text


class SolverError(FlexgenError):
    """A solver found no solution; the text gives the reason and what to try."""


class BuildError(FlexgenError):
    """The emitted C could not be written, compiled or loaded."""


def is_numerical(error: BaseException) -> bool:
    """Whether an error is numerical: overflow, division by zero, a singular matrix, numbers that
    are not finite.
    """
    if isinstance(error, FlexgenError):
        return False
    if isinstance(error, ArithmeticError) or any(
        kind.__name__ == "LinAlgError" for kind in type(error).__mro__
    ):
        return True
    # raised by scipy for its arguments
    return isinstance(error, ValueError) and "infs or nans" in str(error).lower()


def computation_failed(what: str, error: BaseException) -> str:
    """The message for a numerical error of a function or command."""
    return (
        f"{what}: the computation failed ({str(error) or type(error).__name__}); check the "
        "numbers of the model with flexgen.check or 'flexgen check': masses, inertias, "
        "lengths, stiffnesses, dampings, frictions and gravity"
    )
