"""Arguments of callers: put in order, made into arrays, laid out for C, and refused where they do
not fit.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from flexgen.base.checks.counts import show_value
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.ports import Port

PARAMETERS = "parameters"  # the port that has one vector for all points, and that may be left out
_SINGLE = np.dtype(np.float32)
_byte_of: Callable[[Any], ctypes.c_char] = ctypes.c_char.from_buffer


def bind(
    function: str,
    ports: Sequence[Port],
    args: tuple[Any, ...],
    named: dict[str, Any],
    default: Any,
) -> list[Any]:
    """Arguments in the order of the ports, from those by position and by name; parameters that are
    not given are those of the model, ``default``. ArgumentError for missing, double and unknown
    ones.
    """
    names = [port.name for port in ports]
    given = dict(zip(names, args, strict=False))
    double = [name for name in named if name in given]
    unknown = [name for name in named if name not in names]
    given.update(named)
    if default is not None:
        given.setdefault(PARAMETERS, default)
    missing = [name for name in names if name not in given]
    if len(args) > len(names) or double or unknown or missing:
        told = f"{len(args)} arguments" + (f" and {', '.join(named)}" if named else "")
        raise ArgumentError(f"{function}: given {told}, expected {', '.join(names)}")
    return [given[name] for name in names]


def numbers(function: str, port: Port, x: Any) -> np.ndarray:
    """The argument as an array of real numbers, not copied where it is one; ArgumentError where it
    holds others.
    """
    if type(x) is np.ndarray and x.dtype.kind == "f":
        return x
    try:
        array = np.asarray(x)
    except (ValueError, TypeError) as error:
        raise ArgumentError(
            f"{function}, {port.name}: given {error}, expected real numbers"
        ) from error
    if array.dtype.kind not in "iuf":
        raise ArgumentError(
            f"{function}, {port.name}: given entries of type {array.dtype}, expected real numbers"
        )
    if getattr(x, "mask", None) is not None and np.any(x.mask):
        raise ArgumentError(
            f"{function}, {port.name}: given an array with masked entries, expected real numbers"
        )
    return array


def convert(x: np.ndarray, real: np.dtype, order: Any = "K") -> np.ndarray:
    """The numbers in the library's precision; what is too large for it becomes infinite, which C
    notices.
    """
    if x.dtype == real and x.flags.aligned and (order == "K" or x.flags.f_contiguous):
        return x
    with np.errstate(over="ignore"):
        return x.astype(real, order=order)


def count_of_points(
    function: str,
    ports: Sequence[Port],
    arrays: Sequence[np.ndarray],
    most: int,
    shared: str = PARAMETERS,
) -> int | None:
    """Number of points in the arrays; None where all of them hold one; ArgumentError where shapes
    do not fit.

    ``shared``: name of the port with one vector for all points.
    """
    count: int | None = None
    for port, x in zip(ports, arrays, strict=True):
        if x.shape == port.shape:
            continue
        if port.name == shared:
            raise ArgumentError(
                f"{function}, {port.name}: given shape {x.shape}, expected {port.shape}: one "
                "vector for all points"
            )
        if x.shape[1:] != port.shape or x.ndim != len(port.shape) + 1:
            many = ", ".join(map(str, ("N", *port.shape)))
            raise ArgumentError(
                f"{function}, {port.name}: given shape {x.shape}, expected {port.shape} or "
                f"({many}) [{port.unit}]"
            )
        if count is not None and x.shape[0] != count:
            raise ArgumentError(
                f"{function}, {port.name}: given {x.shape[0]} points, expected {count} as in "
                "the inputs before"
            )
        count = x.shape[0]
    if count is not None and count > most:
        raise ArgumentError(
            f"{function}: given {count} points, expected at most {most}; call it for parts of them"
        )
    return count


def store(
    port: Port, x: np.ndarray, count: int, real: np.dtype, shared: str = PARAMETERS
) -> np.ndarray:
    """The array as the batch reads it, a structure of arrays: entry after entry, in each the
    ``count`` points side by side.

    That is the order of Fortran for the shape ``(N, n)`` or ``(N, rows, columns)``; an array that
    has it, in the type ``real``, is not copied. ``shared``: the port with one vector for all
    points.
    """
    if x.shape != port.shape:
        return (
            x
            if x.dtype is real and x.flags.f_contiguous and x.flags.aligned
            else convert(x, real, "F")
        )
    if port.name == shared:
        return np.ascontiguousarray(convert(x, real))
    held = np.empty((count, *port.shape), real, order="F")
    held[...] = convert(x, real)
    return held


def results(
    function: str, ports: Sequence[Port], out: Any, count: int | None, real: np.dtype
) -> list[np.ndarray]:
    """The arrays for the results: new ones, or those given in ``out``, checked.

    Parameters
    ----------
    function : str
        Name for messages.
    ports : sequence of Port
        The outputs.
    out : None, array, or sequence of array
        As the caller gave it.
    count : int or None
        Number of points; None for one point, whose results are copied, so that any memory will do.
    real : dtype
        Of the library.
    """
    lead = () if count is None else (count,)
    if out is None:
        return [np.empty((*lead, *port.shape), real, order="F") for port in ports]
    given = list(out) if isinstance(out, tuple | list) else [out]
    if len(given) != len(ports):
        expected = ", ".join(port.name for port in ports)
        raise ArgumentError(
            f"{function}, out: given {len(given)} arrays, expected {len(ports)}: {expected}"
        )
    for port, x in zip(ports, given, strict=True):
        shape = (*lead, *port.shape)
        if not isinstance(x, np.ndarray):
            raise ArgumentError(
                f"{function}, out for {port.name}: given {type(x).__name__}, expected a numpy "
                "array"
            )
        told = f"{function}, out for {port.name}: given"
        if x.shape != shape or x.dtype != real:
            raise ArgumentError(f"{told} shape {x.shape} of {x.dtype}, expected {shape} of {real}")
        if not x.flags.writeable:
            raise ArgumentError(f"{told} an array that is read-only, expected one to write")
        if count is not None and not (x.flags.f_contiguous and x.flags.aligned):
            raise ArgumentError(
                f"{told} an array in another order, expected points side by side: "
                f"np.empty({shape}, order='F')"
            )
    return given


def address(x: np.ndarray) -> int:
    """Where the entries of an array in C's or Fortran's order begin."""
    try:
        # Thrice as fast as x.ctypes.data; both orders are C's order for one of the two.
        return ctypes.addressof(_byte_of(x.T if x.flags.f_contiguous else x))
    except (TypeError, ValueError):  # read-only, or empty
        return int(x.ctypes.data)


def refuse_overlap(
    function: str,
    ports: Sequence[Port],
    written: Sequence[tuple[int, int]],
    read: Sequence[tuple[int, int]],
) -> None:
    """ArgumentError where a result shares memory, as (address, bytes), with an input or with
    another result.
    """
    for k, (port, (start, size)) in enumerate(zip(ports, written, strict=True)):
        for other, other_size in (*written[:k], *read):
            if start < other + other_size and other < start + size:
                raise ArgumentError(
                    f"{function}, out for {port.name}: given memory that another argument uses "
                    "too, expected its own"
                )


def refuse_not_finite(
    function: str, ports: Sequence[Port], arrays: Sequence[np.ndarray], real: np.dtype
) -> None:
    """ArgumentError that tells the first point with an entry that is not finite, and which;
    nothing without one.
    """
    found: list[tuple[int, str, Any]] = []
    for port, x in zip(ports, arrays, strict=True):
        bad = np.argwhere(~np.isfinite(convert(x, real)))
        if bad.size:
            at = tuple(int(k) for k in bad[0])
            found.append(
                (
                    at[0] if x.ndim > len(port.shape) else 0,
                    f"{port.name}[{', '.join(map(str, at))}]",
                    x[at],
                )
            )
    if found:
        _, where, value = min(found, key=lambda entry: entry[0])
        expected = "finite numbers of single precision" if real == _SINGLE else "finite numbers"
        raise ArgumentError(f"{function}, {where}: given {value}, expected {expected}")


def whole_of(function: str, name: str, x: Any) -> int:
    """An argument that is an int in C."""
    if (
        isinstance(x, bool)
        or not isinstance(x, int | np.integer)
        or not -(2**31) <= int(x) < 2**31
    ):
        raise ArgumentError(f"{function}, {name}: given {x!r}, expected a whole number")
    return int(x)


def number_of(function: str, name: str, x: Any) -> float:
    """An argument that is a number in C."""
    if isinstance(x, bool) or not isinstance(x, int | float | np.integer | np.floating):
        raise ArgumentError(f"{function}, {name}: given {x!r}, expected a number")
    try:
        return float(x)
    except OverflowError:
        raise ArgumentError(
            f"{function}, {name}: given {show_value(x)}, expected a number"
        ) from None
