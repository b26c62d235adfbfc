"""Largest counts and times of calls, so that a mistake ends with a message and not in hours of
work.
"""

from __future__ import annotations

from typing import Any

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.arguments import is_number, is_whole

CASES = 10_000_000  # of a sweep
RANDOM_MOVES = 1_000_000
SAMPLES = 10_000_000  # of one motor in a recording or a simulation
ROBOTS = 10_000  # that are drawn at random and simulated
PERIODS = 10_000  # of an experiment; its poses and realizations
STARTS = 10_000  # of a search from random values
SECONDS = 86_400.0  # of a motion, a period of an excitation or a time limit


def count_of(name: str, value: Any, most: int, least: int = 1) -> int:
    """A count as an int; ArgumentError unless it is a whole number from ``least`` to ``most``."""
    if not is_whole(value, least, most):
        raise ArgumentError(
            f"{name}: given {show_value(value)}, expected a whole number from {least} to {most}"
        )
    return int(value)


def seconds_of(name: str, value: Any, most: float = SECONDS) -> float:
    """A time [s] as a float; ArgumentError unless it is a number above zero, at most ``most``."""
    if not is_number(value) or not 0 < value <= most:
        raise ArgumentError(
            f"{name}: given {show_value(value)}, expected a number above 0, at most {most:g} s"
        )
    return float(value)


def show_value(value: Any) -> str:
    """A value for a message: at most 80 characters, an integer of thousands of digits too."""
    try:
        text = repr(value)
    except ValueError:
        return (
            f"an integer of {value.bit_length()} bits"
            if isinstance(value, int)
            else "a value without a text"
        )
    return text if len(text) <= 80 else f"{text[:60]} ... ({len(text)} characters)"


def number_in(text: str) -> float:
    """The number in a text; ValueError where it has none.

    Python alone reads ``1_000`` and digits of other scripts, such as fullwidth ones: a file with
    these is one that something has damaged.

    Examples
    --------
    >>> from flexgen.base.checks.counts import number_in
    >>> number_in(" 1.5e3")
    1500.0
    """
    if not text.isascii() or "_" in text:
        raise ValueError(f"could not convert text to a number: {text[:40]!r}")
    return float(text)


def is_count(text: str) -> bool:
    """Whether a text consists of the digits 0 to 9 alone."""
    return text.isascii() and text.isdigit()
