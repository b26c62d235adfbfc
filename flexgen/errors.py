"""The errors that flexgen raises: each one tells what was given, what was expected and where."""

from __future__ import annotations


class FlexgenError(Exception):
    """Base of every error that flexgen raises on purpose; its text is meant for the user."""


class ModelError(FlexgenError):
    """A model file is wrong.

    The text reads ``file:line:key: given ..., expected ...``; the parts are kept as attributes.

    Parameters
    ----------
    file : str
        The file as the user named it.
    line : int
        Line of the offending key (1 is the first); 0 where the file as a whole is meant.
    key : str
        Dotted path of the key, such as ``element.joint1.dof.q1.axis``.
    given, expected : str
        What stood there and what should have.
    """

    def __init__(self, file: str, line: int, key: str, given: str, expected: str) -> None:
        self.file, self.line, self.key, self.given, self.expected = file, line, key, given, expected
        super().__init__(f"{file}:{line}:{key}: given {given}, expected {expected}")


class ArgumentError(FlexgenError, ValueError):
    """An argument of a public function has a wrong type, shape, unit or value."""


class SolverError(FlexgenError):
    """A solver could not reach an answer that satisfies the equations; the text says how far it got."""


class BuildError(FlexgenError):
    """The emitted C could not be written, compiled or loaded."""
