"""Checks of the arguments of `flexgen.solve`."""

from __future__ import annotations

from numbers import Real

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.inversion.methods.method_table import AUTO, find_method


def check_arguments(
    method: str,
    preview: float | None,
    mesh: float | None,
    accuracy: float,
    time_limit: float | None,
    limits: Limits | None,
) -> None:
    """ArgumentError where an argument of `solve` has a wrong type or value."""
    if method != AUTO:
        find_method(method)
    expected = {
        "preview": "zero or a positive time in s",
        "mesh": "a positive time in s",
        "accuracy": "a positive length",
        "time_limit": "a positive time in s; None or 0: no limit",
    }
    for name, value in zip(expected, (preview, mesh, accuracy, time_limit), strict=True):
        if value is None or (
            name in ("preview", "time_limit") and value == 0 and not isinstance(value, bool)
        ):
            continue
        if (
            not isinstance(value, Real)
            or isinstance(value, bool)
            or not (np.isfinite(value) and value > 0)
        ):
            raise ArgumentError(f"{name}: given {value!r}, expected {expected[name]}")
    if limits is not None and not isinstance(limits, Limits):
        raise ArgumentError(
            f"limits: given {limits!r}, expected flexgen.Limits(torque=..., speed=...)"
        )


def without_effect(method: str, preview: float | None, mesh: float | None) -> tuple[str, ...]:
    """Warnings about arguments that the method which found the solution does not use."""
    given = {"preview": preview, "mesh": mesh} if find_method(method).algebraic else {}
    return tuple(
        (
            f"{name}: given {value:g} s, which has no effect: method {method} computes each "
            "sample of the path by itself"
        )
        for name, value in given.items()
        if value is not None
    )
