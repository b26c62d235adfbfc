"""The errors of flexgen: each text has what was given, what was expected, where, and what to do."""

from __future__ import annotations


class FlexgenError(Exception):
    """Base of all errors of flexgen; the text is for the user."""


class ModelError(FlexgenError):
    """A model file is wrong.

    The text reads ``file:line:key: given ..., expected ...``; the fields are attributes.

    Parameters
    ----------
    file : str
        The file as the user named it.
    line : int
        Line of the key, from 1; 0 for the whole file.
    key : str
        Dotted path of the key, such as ``element.joint1.dof.q1.axis``.
    given, expected : str
        The value in the file, and what is allowed.
    """

    def __init__(self, file: str, line: int, key: str, given: str, expected: str) -> None:
        self.file, self.line, self.key, self.given, self.expected = file, line, key, given, expected
        super().__init__(f"{file}:{line}:{key}: given {given}, expected {expected}")


class ArgumentError(FlexgenError, ValueError):
    """An argument of a public function has a wrong type, shape, unit or value."""


class ChannelError(ArgumentError, KeyError):
    """A trajectory has no channel of this name; also a KeyError."""

    __str__ = Exception.__str__  # KeyError shows the repr of the text


class SolverError(FlexgenError):
    """A solver found no solution; the text gives the reason and what to try."""


class BuildError(FlexgenError):
    """The emitted C could not be written, compiled or loaded."""
