"""Arguments of inverse dynamics in a loaded library, checked as C needs them."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.runtime.arguments import address, number_of
from flexgen.runtime.identity import TOLERANCES
from flexgen.runtime.structs import Interface

Rows = Sequence[Mapping[str, Any]]  # of the run-time parameters in the manifest
# of a force given to a function of a library that was generated without them
NO_FORCE = (
    "{}, force: given to a library without forces, expected one that was generated with "
    'parts=["force"] (--with force)'
)


def parameters_of(function: str, given: Any, of_model: np.ndarray, rows: Rows = ()) -> np.ndarray:
    """The run-time parameters of a call; ArgumentError where the library has none, or
    `check_bounds` refuses them.
    """
    if given is None:
        return of_model
    if not of_model.size:
        raise ArgumentError(
            f"{function}, parameters: given to a library without run-time parameters, expected "
            "one that was generated with parameters=[...] (--parameters)"
        )
    values = array_of(function, "parameters", given, of_model.shape, of_model.dtype)
    check_bounds(function, values, rows)
    return values


def check_bounds(function: str, values: np.ndarray, rows: Rows) -> None:
    """ArgumentError for parameters (..., n_p) that no model file may have, such as a negative
    mass.
    """
    for row, x in zip(rows, values.T, strict=False):
        bound = row.get("bound", "")
        if bound and (x.min(initial=np.inf) < 0.0 or (bound == "> 0" and not x.all())):
            raise ArgumentError(
                f"{function}, parameters: given {x.min():g} {row['unit']} as {row['name']}, "
                f"expected a number {bound}"
            )


def samples_of(
    function: str,
    path: Sequence[Any],
    force: Any,
    sizes: Mapping[str, int],
    real: np.dtype[Any],
    takes_force: bool,
    problems: bool = False,
) -> dict[str, np.ndarray]:
    """Checked samples (n, ...) of a path ``y, dy, ddy``, and of the force on it where it is given,
    with two derivatives; with ``problems`` also (problems, n, ...). ArgumentError for other
    shapes, and for a force where the library does not take one.
    """
    y = array_of(function, "y", path[0], None, real)
    n_y = sizes["n_y"]
    before = y.shape[:-1] if y.ndim == 2 or (problems and y.ndim == 3) else (-1,)
    if problems and before == (-1,):
        raise ArgumentError(
            f"{function}, y: given shape {y.shape}, expected (problems, n, {sizes['n_t']}) or "
            "(n, ...)"
        )
    columns = {"y": (y, sizes["n_t"]), "dy": (path[1], n_y), "ddy": (path[2], n_y)}
    if force is not None:
        if not takes_force:
            raise ArgumentError(NO_FORCE.format(function))
        columns["force"] = force, 3 * n_y
    return {
        key: array_of(function, key, x, (*before, width), real)
        for key, (x, width) in columns.items()
    }


def pointers(parameters: np.ndarray) -> tuple[ctypes.c_void_p, ...]:
    """The argument of the run-time parameters; none where the library has none."""
    return (pointer(parameters),) if parameters.size else ()


def tolerance_of(real: np.dtype[Any]) -> float:
    """The tolerance of a call that names none."""
    return TOLERANCES["double" if real == np.float64 else "single"]


def array_of(
    function: str, name: str, x: Any, shape: tuple[int, ...] | None, real: np.dtype[Any]
) -> np.ndarray:
    """An argument as C reads it: numbers of the library's precision, row after row; ``shape``:
    None where free.
    """
    try:
        array = np.asarray(x)
    except (ValueError, TypeError) as error:
        raise ArgumentError(f"{function}, {name}: given {error}, expected real numbers") from error
    if array.dtype.kind not in "iuf":
        raise ArgumentError(
            f"{function}, {name}: given entries of type {array.dtype}, expected real numbers"
        )
    if shape is not None and array.shape != shape:
        expected = ("n", *shape[1:]) if shape[0] < 0 else shape
        raise ArgumentError(
            f"{function}, {name}: given shape {array.shape}, expected "
            f"({', '.join(map(str, expected))})"
        )
    with np.errstate(over="ignore"):  # what is too large becomes infinite, which C refuses
        return np.ascontiguousarray(array, dtype=real)


def hold_of(interface: Interface, function: str, hold: Any, delay: Any) -> dict[str, Any]:
    """Members of the options in C for a ``hold`` by name and a ``delay`` in samples; ArgumentError
    for others.
    """
    holds = interface.enums["hold"]
    most = interface.limits["HOLD_DELAY_MAX"]
    if hold not in holds:
        raise ArgumentError(
            f"{function}, hold: given {hold!r}, expected one of {', '.join(holds)}"
        )
    late = number_of(function, "delay", delay)
    if not 0.0 <= late <= most:
        raise ArgumentError(
            f"{function}, delay: given {delay!r} samples, expected 0 to {most}; for a longer "
            "delay give the path earlier"
        )
    return {"hold": holds.index(hold), "delay": late}


def pointer(x: np.ndarray) -> ctypes.c_void_p:
    """Where an array begins, for C."""
    return ctypes.c_void_p(address(x))
