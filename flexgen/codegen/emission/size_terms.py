"""Sizes of arrays as terms: written once, read as C and as numbers of Python."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Linear:
    """``constant + per_interval * intervals + per_sample * samples_per_interval``."""

    constant: int
    per_interval: int = 0
    per_sample: int = 0

    def __add__(self, other: Linear | int) -> Linear:
        other = other if isinstance(other, Linear) else Linear(other)
        return Linear(
            self.constant + other.constant,
            self.per_interval + other.per_interval,
            self.per_sample + other.per_sample,
        )

    __radd__ = __add__

    def __mul__(self, factor: int) -> Linear:
        return self.times(factor)

    __rmul__ = __mul__

    def times(self, factor: int) -> Linear:
        """All three numbers times a factor."""
        return Linear(factor * self.constant, factor * self.per_interval, factor * self.per_sample)

    def at(self, intervals: int, samples_per_interval: int) -> int:
        """The value."""
        return (
            self.constant + self.per_interval * intervals + self.per_sample * samples_per_interval
        )


class Term:
    """A sum or a product of names and integers.

    Terms are written with ``+`` and ``*``; `c` is the text in C, `value` the number.
    """

    def __add__(self, other: Term | int) -> Term:
        return _Pair("+", self, _term(other))

    def __radd__(self, other: int) -> Term:
        return _Pair("+", _term(other), self)

    def __mul__(self, other: Term | int) -> Term:
        return _Pair("*", self, _term(other))

    def __rmul__(self, other: int) -> Term:
        return _Pair("*", _term(other), self)

    def c(self) -> str:
        """The text in C."""
        raise TypeError(f"{type(self).__name__}: given no kind of term")

    def value(self, names: Mapping[str, int | Linear]) -> int | Linear:
        """The number, where the names have these values."""
        raise TypeError(f"{type(self).__name__}: given no kind of term")


@dataclass(frozen=True)
class Name(Term):
    """A name, of a constant or a variable in C."""

    name: str

    def c(self) -> str:
        """The name."""
        return self.name

    def value(self, names: Mapping[str, int | Linear]) -> int | Linear:
        """Value of the name."""
        return names[self.name]


@dataclass(frozen=True)
class _Number(Term):
    number: int

    def c(self) -> str:
        """The digits."""
        return str(self.number)

    def value(self, names: Mapping[str, int | Linear]) -> int | Linear:
        """The integer itself."""
        return self.number


@dataclass(frozen=True)
class _Pair(Term):
    """Two terms and the operation between them."""

    operation: str
    left: Term
    right: Term

    def c(self) -> str:
        """Both, with parentheses where a product needs them."""
        parts = [self.left.c(), self.right.c()]
        if self.operation == "*":
            pairs = zip(parts, (self.left, self.right), strict=True)
            parts = [f"({text})" if _is_sum(term) else text for text, term in pairs]
        return f" {self.operation} ".join(parts)

    def value(self, names: Mapping[str, int | Linear]) -> int | Linear:
        """Sum or product; TypeError for a product of two that are linear."""
        left = self.left.value(names)
        right = self.right.value(names)
        if self.operation == "+":
            return left + right
        if not isinstance(left, Linear):
            return right * left
        if isinstance(right, Linear):
            raise TypeError(f"{self.c()}: given a product of two variables, expected one variable")
        return left.times(right)


def _is_sum(term: Term) -> bool:
    return isinstance(term, _Pair) and term.operation == "+"


def _term(given: Term | int) -> Term:
    return given if isinstance(given, Term) else _Number(given)


def pad(size: int, block: int) -> int:
    """A size rounded up to whole blocks."""
    return -(-size // block) * block


def pad_at_most(size: int | Linear, block: int) -> Linear:
    """A bound of a padded size that is linear: with a block less one more, where it may be padded
    at all.
    """
    size = size if isinstance(size, Linear) else Linear(pad(size, block))
    parts = (size.constant, size.per_interval, size.per_sample)
    return size if all(part % block == 0 for part in parts) else size + (block - 1)
