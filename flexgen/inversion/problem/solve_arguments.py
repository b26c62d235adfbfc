"""Checks of the arguments of `flexgen.solve`."""

from __future__ import annotations

from numbers import Real

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.inversion.methods.method_table import AUTO, find_method
from flexgen.inversion.problem.problem import SolveOptions

# What each number is to be.
EXPECTED = {
    "preview": "zero or a positive time in s",
    "mesh": "a positive time in s",
    "accuracy": "a positive length",
    "time_limit": "a positive time in s; None or 0: no limit",
}
# Numbers that may be zero.
WITH_ZERO = ("preview", "time_limit")


def check_arguments(method: str, time_limit: float | None, options: SolveOptions) -> None:
    """ArgumentError where an argument of `solve` has a wrong type or value."""
    if method != AUTO:
        find_method(method)
    given = {**options.fields(), "time_limit": time_limit}
    for name, expected in EXPECTED.items():
        value = given[name]
        if value is None:
            continue
        number = isinstance(value, Real) and not isinstance(value, bool)
        if number and value == 0 and name in WITH_ZERO:
            continue
        if not number or not (np.isfinite(value) and value > 0):
            raise ArgumentError(f"{name}: given {value!r}, expected {expected}")
    limits = options.limits
    if limits is not None and not isinstance(limits, Limits):
        raise ArgumentError(
            f"limits: given {limits!r}, expected flexgen.Limits(torque=..., speed=...)"
        )


def without_effect(method: str, options: SolveOptions) -> tuple[str, ...]:
    """Warnings about arguments that the method which found the solution does not use."""
    if not find_method(method).algebraic:
        return ()
    unused = {"preview": options.preview, "mesh": options.mesh}
    return tuple(
        (
            f"{name}: given {value:g} s, which has no effect: method {method} computes each "
            "sample of the path by itself"
        )
        for name, value in unused.items()
        if value is not None
    )
