"""One function of a library on the GPU, called on device arrays."""

from __future__ import annotations

import ctypes
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np

from flexgen.backends.cuda.arrays import DeviceArray, Given, stream_handle
from flexgen.backends.cuda.driver import Card
from flexgen.backends.cuda.sources import STATUS_BITS
from flexgen.base.errors import ArgumentError
from flexgen.runtime.arguments import PARAMETERS, bind
from flexgen.runtime.calls import Function
from flexgen.runtime.structs import closed_error, failure_of

_FLAG = 8  # bytes of what a kernel reports
_NONE = 2 ** (8 * _FLAG) - 1  # no point failed


class CudaFunction:
    """One function of a library on many points: ``f(q_a, ...)`` on device arrays, a thread a
    point.

    Every array has its points along the first axis, in the order of Fortran, as CuPy makes it by
    ``cupy.asfortranarray``: it is read where it is. Types are those of the library.
    ``parameters``, where the library has any, are one vector for all points, by default that of
    the model; with ``per_point`` one for each.

    ``stream`` is the caller's: a stream of CuPy, PyTorch or cuda.core, or its handle; default: the
    default stream. ``out`` takes a device array for the result, or a tuple of them. A call waits
    for its results and raises an error where a point failed; ``check=False`` returns at once: the
    results of points that failed are NaN.

    Parameters
    ----------
    function : Function
        The same on the CPU.
    """

    def __init__(
        self,
        function: Function,
        card: Card,
        real: np.dtype[Any],
        load: Callable[[str], Any],
        per_point: bool,
    ) -> None:
        self.name = function.name
        self.summary = function.summary
        self.equation = function.equation
        self.inputs = function.inputs
        self.outputs = function.outputs
        self.__name__ = function.name
        self.__doc__ = function.__doc__
        self._card = card
        self._real = real
        self._load = load
        self._closed_by = ""
        self._shared = "" if per_point else PARAMETERS
        self._failures = function._failures
        self._parameters = function._parameters
        self._lock = Lock()
        self._of_model: DeviceArray | None = None  # the parameters of the model, on the card

    def __repr__(self) -> str:
        return f"{self.name}({', '.join(port.name for port in self.inputs)})"

    def close(self, library: str) -> None:
        """Refuse every call from now on."""
        self._closed_by = library

    @cached_property
    def _results(self) -> Any:
        return namedtuple(self.name, [port.name for port in self.outputs])

    def compile(self) -> Any:
        """Compile and load the kernel, as the first call does; the kernel."""
        with self._lock:
            return self._kernel

    @cached_property
    def _kernel(self) -> Any:
        return self._load(self.name)

    def __call__(
        self, *args: Any, out: Any = None, stream: Any = None, check: bool = True, **named: Any
    ) -> Any:
        """Evaluate at many points; see the class."""
        if self._closed_by:
            raise closed_error(self._closed_by)
        if not isinstance(check, bool):
            raise ArgumentError(f"{self.name}, check: given {check!r}, expected True or False")
        handle = stream_handle(self.name, stream)
        default = None if self._parameters is None else self._model_parameters(handle)
        given: list[Given] = []
        try:
            for port, x in zip(
                self.inputs, bind(self.name, self.inputs, args, named, default), strict=True
            ):
                given.append(Given(self._card, self.name, port.name, x, handle))
            points = self._count(given)
            for port, x in zip(self.outputs, self._outs(out), strict=True):
                if x is not None:
                    given.append(Given(self._card, self.name, f"out, {port.name}", x, handle))
                    given[-1].demand((points, *port.shape), self._real, "F")
            made = [
                DeviceArray.empty(self._card, (points, *port.shape), self._real, stream)
                for port in self.outputs
                if out is None
            ]
            addresses = [x.address for x in given] + [x._address for x in made]
            self._refuse_overlap(points, addresses)
            self._launch(points, addresses, handle, check)
        finally:
            for x in given:
                x.release()
        results = made if out is None else self._outs(out)
        return results[0] if len(results) == 1 else self._results._make(results)

    def _model_parameters(self, stream: int) -> DeviceArray:
        """The parameters of the model, on the card."""
        with self._lock:
            if self._of_model is None:
                values = np.ascontiguousarray(self._parameters)
                self._of_model = DeviceArray.empty(self._card, values.shape, self._real, None)
                self._card.write(self._of_model._address, values.ctypes.data, values.nbytes, 0)
            return self._of_model

    def _outs(self, out: Any) -> Sequence[Any]:
        """The arrays of a caller for the results, one for each."""
        if out is None:
            return [None] * len(self.outputs)
        arrays = out if isinstance(out, tuple) else (out,)
        if len(arrays) != len(self.outputs):
            names = ", ".join(port.name for port in self.outputs)
            raise ArgumentError(
                f"{self.name}, out: given {len(arrays)} arrays, expected one for each of {names}"
            )
        return arrays

    def _count(self, given: Sequence[Given]) -> int:
        """Number of points of the inputs; ArgumentError where they differ, or an array does not
        fit.
        """
        points: int | None = None
        for port, x in zip(self.inputs, given, strict=True):
            if port.name == self._shared:
                x.demand(port.shape, self._real, "C")
                continue
            x.demand((points, *port.shape), self._real, "F")
            points = x.shape[0]
        return points or 0

    def _refuse_overlap(self, points: int, addresses: Sequence[int]) -> None:
        """Refuse results that share memory with an input or another result. ``addresses``: of
        inputs, then results.
        """
        ports = (*self.inputs, *self.outputs)
        sizes = [
            port.size * (1 if port.name == self._shared else points) * self._real.itemsize
            for port in ports
        ]
        spans = list(zip(addresses, sizes, strict=True))
        for i in range(len(self.inputs), len(ports)):
            begin, size = spans[i]
            if any(a < begin + size and begin < a + s for k, (a, s) in enumerate(spans) if k != i):
                raise ArgumentError(
                    f"{self.name}, out, {ports[i].name}: given memory of another array, "
                    "expected memory of its own"
                )

    def _launch(self, points: int, addresses: Sequence[int], stream: int, check: bool) -> None:
        """Run the kernel for ``points`` points in a stream; with ``check`` wait for it, and raise
        the error of the first point that failed.
        """
        if points == 0:
            return
        kernel = self.compile()
        card = self._card
        flag = card.allocate(_FLAG, stream)
        found = ctypes.c_uint64(_NONE)
        try:
            card.fill(flag, 0xFF, _FLAG, stream)
            arguments = [ctypes.c_ssize_t(points), *map(ctypes.c_void_p, (*addresses, flag))]
            card.launch(kernel, points, arguments, stream)
            if check:
                card.read(flag, ctypes.addressof(found), _FLAG, stream)
        finally:
            card.free(flag, stream)
        if found.value != _NONE:
            status = -(found.value & (2**STATUS_BITS - 1))
            exception, text = failure_of(self._failures, status)
            raise exception(f"{self.name}, point {found.value >> STATUS_BITS}: {text}")


def functions_of(
    functions: Mapping[str, Function],
    card: Card,
    real: np.dtype[Any],
    load: Callable[[str], Any],
    per_point: bool,
) -> dict[str, CudaFunction]:
    """All functions of a library on a card; `load` gives the kernel of a function."""
    return {name: CudaFunction(f, card, real, load, per_point) for name, f in functions.items()}
