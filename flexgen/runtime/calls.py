"""One function of a loaded library, called on numpy arrays.

What a call costs: buffers and the arguments in C are bound once and kept in a pool, a set per call
under way, so that calls from several threads (ctypes releases the interpreter's lock) never share
one. Python looks at types and shapes; that all numbers are finite C finds out, and only where it
says no does Python look for the one that is not.
"""

from __future__ import annotations

import ctypes
from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.ports import Port
from flexgen.runtime.arguments import (
    PARAMETERS,
    address,
    bind,
    count_of_points,
    numbers,
    refuse_not_finite,
    refuse_overlap,
    results,
    store,
)
from flexgen.runtime.structs import Failures, closed_error, failure_of

_MOST_POINTS = 2 ** (8 * ctypes.sizeof(ctypes.c_int) - 1) - 1
_ARRAY = np.ndarray


@dataclass(frozen=True)
class Entries:
    """Entry points of one function in C: one point, many points, and the sizes of their workspaces
    in reals.
    """

    single: Callable[..., int]
    batch: Callable[..., int]
    work: int  # 0: the function for one point takes no workspace
    batch_work: Callable[[], int]  # it may depend on the number of threads of the moment


class _Buffers:
    """Memory of one call: inputs, outputs, workspace for one point, with their addresses for C;
    workspace for many.
    """

    def __init__(
        self, inputs: tuple[Port, ...], outputs: tuple[Port, ...], work: int, real: np.dtype
    ) -> None:
        """Arrays of one point in the order of the C function, and their addresses; ``work``: reals
        of workspace, ``real``: float or double.
        """
        self.inputs = [np.zeros(port.shape, real, order="F") for port in inputs]
        self.outputs = [np.zeros(port.shape, real, order="F") for port in outputs]
        self.work = np.zeros(max(work, 1), real)
        self.batch_work = self.work
        self.batch_where = address(self.work)
        # Objects of ctypes, not numbers: nothing is left to convert, and no declaration of types
        # has to be looked up.
        passed = (*self.inputs, *self.outputs, *([self.work] if work else []))
        self.arguments = tuple(ctypes.c_void_p(address(x)) for x in passed)


class _Closed:
    """The pool of a closed library: taking buffers from it raises an ArgumentError."""

    def __init__(self, library: str) -> None:
        self.library = library

    def pop(self) -> _Buffers:
        """Raise the ArgumentError of a call after `close`."""
        raise closed_error(self.library)

    def append(self, buffers: _Buffers) -> None:
        """The call that used them began before the library was closed."""


class Function:
    """One function of a library: ``f(q_a, ...)`` on arrays of one point, or of many points along a
    first axis.

    Inputs of one point are held for all where others have many. One output is returned as an
    array, several as a named tuple; matrices have the shape (rows, columns). Every input is
    checked: shape, type, finiteness.

    Many points are fastest in a structure of arrays, which is the order of Fortran: ``(N, n)``
    arrays made by ``np.empty((N, n), order="F")`` are read where they are, all others are copied
    once. Results have that order. ``out`` takes an array for the result, or a tuple of them: no
    memory has to be found for it, and the function returns what it was given. Where one point of
    many fails, an error is raised; ``out`` then holds the results of all points, NaN where one
    failed.

    A library of single precision takes numbers of any precision, rounds them, and returns
    ``float32``. ``parameters``, where the library has any, is one vector for all points, by
    default that of the model; in a library with parameters ``per_point`` also one for each point.

    Copies are the same function; pickled, it is loaded again from its directory, or refused where
    the library there is another one.

    Parameters
    ----------
    name, summary, equation : str
        What it computes.
    inputs, outputs : tuple of Port
        The arrays.

    Examples
    --------
    >>> library = flexgen.load(flexgen.generate("elbow", functions=["gravity"]).directory)
    >>> library.gravity([[0.0, 0.0], [0.5, -0.3]]).shape  # points, rows
    (2, 2)
    >>> library.gravity.equation
    'g = dU(q_a)/dq_a'
    """

    def __init__(
        self,
        name: str,
        summary: str,
        equation: str,
        inputs: tuple[Port, ...],
        outputs: tuple[Port, ...],
        entries: Entries,
        real: np.dtype,
        failures: Failures,
        parameters: np.ndarray | None,
        again: tuple[Callable[..., Any], tuple[Any, ...]],
        shared: str = PARAMETERS,
    ) -> None:
        self.name = name
        self.summary = summary
        self.equation = equation
        self.inputs = inputs
        self.outputs = outputs
        self.__name__ = name
        self.__doc__ = _docstring(summary, equation, inputs, outputs)
        self._entries = entries
        self._real = real
        self._failures = failures
        self._again = again
        self._single = entries.single
        self._shared = shared
        self._results = (
            None if len(outputs) == 1 else results_type(name, tuple(port.name for port in outputs))
        )
        self._shapes = [port.shape for port in inputs]
        self._parameters = parameters if any(port.name == PARAMETERS for port in inputs) else None
        self._count = len(inputs)
        self._required = self._count - (self._parameters is not None)
        self._pool: list[_Buffers] | _Closed = []

    def __repr__(self) -> str:
        return f"{self.name}({', '.join(port.name for port in self.inputs)})"

    def __copy__(self) -> Function:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Function:
        return self

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        self._pool.append(self._buffers())  # refused where closed
        return self._again

    def batch_address(self) -> tuple[int, np.ndarray]:
        """Address of the function for many points in C, and a workspace for it.

        For C that calls it by itself, without the checks of a call from Python; the library must
        not be closed before.
        """
        where: Any = self._entries.batch
        work = np.zeros(max(self._entries.batch_work(), 1), self._real)
        return ctypes.cast(where, ctypes.c_void_p).value or 0, work

    def single_address(self) -> tuple[int, np.ndarray]:
        """Address of the function for one point in C, and a workspace; empty where the function
        takes none.
        """
        where: Any = self._entries.single
        return ctypes.cast(where, ctypes.c_void_p).value or 0, np.zeros(
            self._entries.work, self._real
        )

    def __call__(self, *args: Any, out: Any = None, **named: Any) -> Any:
        """Evaluate at one point or at many; see the class."""
        if named or len(args) != self._count:
            if not named and len(args) == self._required:
                args = (*args, self._parameters)
            else:
                args = tuple(bind(self.name, self.inputs, args, named, self._parameters))
        pool = self._pool
        real = self._real
        try:
            buffers = pool.pop()
        except IndexError:
            buffers = self._buffers()
        # As many of each: they were bound above.
        for x, memory, shape in zip(args, buffers.inputs, self._shapes):  # noqa: B905
            if type(x) is not _ARRAY or x.dtype is not real or x.shape != shape:
                pool.append(buffers)
                return self._general(args, out)
            memory[...] = x
        status = self._single(*buffers.arguments)
        if status:
            pool.append(buffers)
            self._fail(status, args)
        if out is not None:
            result = self._copy(buffers, out)
        elif self._results is None:
            result = buffers.outputs[0].copy()
        else:
            result = self._results._make([memory.copy() for memory in buffers.outputs])
        pool.append(buffers)
        return result

    @checked_types
    def close(self, library: str) -> None:
        """Refuse every call from now on; calls under way end as usual."""
        self._pool = _Closed(library)

    def _buffers(self) -> _Buffers:
        """A set of buffers for one call: a free one of the pool, or a new one.

        The caller puts it back into the pool, so that calls of several threads each have their own
        and memory is used again. ArgumentError where the library is closed: then the pool is a
        `_Closed`, whose `pop` raises it.
        """
        try:
            return self._pool.pop()
        except IndexError:
            return _Buffers(self.inputs, self.outputs, self._entries.work, self._real)

    def _copy(self, buffers: _Buffers, out: Any) -> Any:
        """Copy the results of one point to where the caller wants them."""
        usual = (
            self._results is None and type(out) is _ARRAY and out.shape == self.outputs[0].shape
        )
        if usual and out.dtype is self._real and out.flags.writeable:
            out[...] = buffers.outputs[0]
            return out
        given = results(self.name, self.outputs, out, None, self._real)
        for i, x in enumerate(given):
            if any(np.may_share_memory(x, other) for other in given[:i]):
                raise ArgumentError(
                    f"{self.name}, out: given arrays that share memory, expected memory of its own"
                )
            x[...] = buffers.outputs[i]
        return given[0] if self._results is None else self._results._make(given)

    def _general(self, args: tuple[Any, ...], out: Any) -> Any:
        """Evaluate where an argument is not an array of the library's type for one point: convert
        it, and call the batch for many points. An error names the first point that failed.
        """
        arrays = [numbers(self.name, port, x) for port, x in zip(self.inputs, args, strict=True)]
        count = count_of_points(self.name, self.inputs, arrays, _MOST_POINTS, self._shared)
        if count is None:
            # A dtype that equals the library's may be another object: astype gives the array the
            # library's.
            with np.errstate(over="ignore"):
                return self(*(x.astype(self._real) for x in arrays), out=out)
        memories = [
            store(port, x, count, self._real, self._shared)
            for port, x in zip(self.inputs, arrays, strict=True)
        ]
        made = results(self.name, self.outputs, out, count, self._real)
        buffers = self._buffers()
        if buffers.batch_work.size < (work := self._entries.batch_work()):
            buffers.batch_work = np.zeros(work, self._real)
            buffers.batch_where = address(buffers.batch_work)
        read = [address(x) for x in memories]
        written = [address(x) for x in made]
        if out is not None:
            sizes = [x.nbytes for x in (*made, *memories)]
            spans = list(zip((*written, *read), sizes, strict=True))
            refuse_overlap(self.name, self.outputs, spans[: len(made)], spans[len(made) :])
        where = map(ctypes.c_void_p, (*read, *written, buffers.batch_where))
        status = self._entries.batch(count, *where)
        self._pool.append(buffers)
        if status:
            # the results of a point that failed are NaN
            first = np.isnan(made[0].reshape(count, -1, order="F")[:, 0])
            self._fail(status, arrays, int(np.argmax(first)) if first.any() else None)
        return made[0] if self._results is None else self._results._make(made)

    def _fail(self, status: int, args: Any, point: int | None = None) -> None:
        """Raise what the status means."""
        exception, text = failure_of(self._failures, status)
        if issubclass(exception, ArgumentError):
            refuse_not_finite(self.name, self.inputs, args, self._real)
        where = "" if point is None else f", point {point}"
        raise exception(f"{self.name}{where}: {text}")


@cache
def results_type(name: str, fields: tuple[str, ...]) -> Any:
    """Class of the results of a function with several: a named tuple that can be pickled."""
    plain = namedtuple(name, fields)  # type: ignore[misc]

    def reduce(self: Any) -> Any:
        return _results_again, (name, fields, tuple(self))

    return type(name, (plain,), {"__slots__": (), "__reduce__": reduce, "__module__": __name__})


def _results_again(name: str, fields: tuple[str, ...], values: tuple[Any, ...]) -> Any:
    return results_type(name, fields)._make(values)


def _docstring(
    summary: str, equation: str, inputs: tuple[Port, ...], outputs: tuple[Port, ...]
) -> str:
    """Docstring of a function with its ports, their shapes and units."""

    def rows(ports: tuple[Port, ...]) -> str:
        return "".join(f"{p.name} : array {p.shape} [{p.unit}]\n    {p.doc}\n" for p in ports)

    return (
        f"{summary}\n"
        "\n"
        f"    {equation}\n"
        "\n"
        "Parameters\n"
        "----------\n"
        f"{rows(inputs)}\n"
        "Returns\n"
        "-------\n"
        f"{rows(outputs)}"
    )
