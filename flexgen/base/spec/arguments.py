"""Whether arguments of public functions are what they should be."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Integral, Real
from typing import Any

from flexgen.base.errors import ArgumentError


def is_number(value: Any) -> bool:
    """Whether a value is a finite real number; true, false and texts are not, an array without
    dimensions is.
    """
    if getattr(value, "shape", None) == () and callable(getattr(value, "item", None)):
        value = value.item()
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an integer too large for a float
        return False


def is_whole(value: Any, least: int = 1, most: int = 2**31 - 1) -> bool:
    """Whether a value is a whole number in a range; true and false are not."""
    return (
        isinstance(value, Integral) and not isinstance(value, bool) and least <= int(value) <= most
    )


def check_positive(name: str, value: Any, what: str = "a number > 0") -> None:
    """ArgumentError unless the value is a number above zero."""
    if not is_number(value) or value <= 0:
        raise ArgumentError(f"{name}: given {value!r}, expected {what}")


def check_not_negative(name: str, value: Any, what: str = "a finite number >= 0") -> None:
    """ArgumentError unless the value is a number of at least zero."""
    if not is_number(value) or value < 0:
        raise ArgumentError(f"{name}: given {value!r}, expected {what}")


def seed_of(value: Any) -> int:
    """The seed of noise as an int; ArgumentError where it cannot be one."""
    if not is_whole(value, 0, 2**63 - 1):
        raise ArgumentError(f"seed: given {value!r}, expected a whole number >= 0")
    return int(value)


def mapping_of(name: str, value: Any, what: str) -> dict[Any, Any]:
    """The mapping as a dict; ArgumentError for something else."""
    if not isinstance(value, Mapping):
        raise ArgumentError(f"{name}: given {value!r}, expected {what}")
    return dict(value)
