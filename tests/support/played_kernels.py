"""Kernels for `FakeDriver` that are not compiled: the C library of the CPU does their work.

They read their arguments as a card does, from addresses of values, when they are started, and
compute when the stream comes to them.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from array_cases import library
from inversion_cases import MODEL

from flexgen.runtime import Library
from flexgen.runtime.inversion.path_inversion import Inverter


def with_parameters() -> Library:
    """The library with run-time parameters that tests/runtime/test_many_inversion.py compiles."""
    return library(MODEL, None, ("payload", "stiffness", "damping"), "double", ("bvp",))


def _values(where: ctypes.c_void_p, kinds: list[Any]) -> list[Any]:
    """Copies of the arguments of a kernel."""
    place = ctypes.cast(where, ctypes.POINTER(ctypes.c_void_p))
    return [
        kind.from_buffer_copy(ctypes.string_at(place[k] or 0, ctypes.sizeof(kind)))
        for k, kind in enumerate(kinds)
    ]


class Played:
    """A kernel: arguments, and the grid of each start."""

    def __init__(self) -> None:
        self.started: list[list[Any]] = []
        self.grids: list[tuple[int, int]] = []

    def kinds(self) -> list[Any]:
        """Types of the arguments."""
        raise AssertionError("a kernel states its arguments")

    def compute(self, given: list[Any]) -> None:
        """The work of all threads."""
        raise AssertionError("a kernel computes")

    def bind_arguments(self, where: ctypes.c_void_p) -> int:
        """Number of a call, from 1 on."""
        self.started.append(_values(where, self.kinds()))
        return len(self.started)

    def run(self, call: ctypes.c_void_p, blocks: int, threads: int) -> None:
        """Do the work of a call."""
        self.grids.append((blocks, threads))
        self.compute(self.started[(call.value or 0) - 1])


class PlayedFunction(Played):
    """A function of a library, point by point."""

    def __init__(self, function: Any, per_point: bool = False, reports: int | None = None) -> None:
        super().__init__()
        self.function = function
        self.per_point = per_point
        self.reports = reports

    def kinds(self) -> list[Any]:
        """The number of points, arrays, and what is reported."""
        count = len(self.function.inputs) + len(self.function.outputs)
        return [ctypes.c_int64, *[ctypes.c_void_p] * (count + 1)]

    def compute(self, given: list[Any]) -> None:
        """Results of all points; entry i of point k is ``x[i * n + k]``."""
        n = given[0].value
        arrays = []
        ports = (*self.function.inputs, *self.function.outputs)
        for port, address in zip(ports, given[1:-1], strict=True):
            shared = port.name == "parameters" and not self.per_point
            count = port.size * (1 if shared else n)
            memory = np.frombuffer((ctypes.c_double * count).from_address(address.value))
            rows = memory[None] if shared else memory.reshape(port.size, n).T
            arrays.append((port, rows))
        flag = ctypes.c_uint64.from_address(given[-1].value)
        assert flag.value == 2**64 - 1
        if self.reports is not None:
            flag.value = self.reports
        inputs = len(self.function.inputs)
        for k in range(n):
            at = [x[min(k, len(x) - 1)].reshape(port.shape) for port, x in arrays[:inputs]]
            found = self.function(*at)
            for (_, to), x in zip(
                arrays[inputs:], found if isinstance(found, tuple) else (found,), strict=True
            ):
                to[k] = x.ravel(order="F") if x.ndim > 1 else x


class PlayedInversion(Played):
    """Whole inversions, by ``NAME_invert_many`` of the library."""

    def __init__(self, inverter: Inverter, work: int) -> None:
        super().__init__()
        self.inverter = inverter
        self.work = work

    def kinds(self) -> list[Any]:
        """As `flexgen.backends.cuda.sources.inversion_text` declares them."""
        names = ("problems", "samples", "", "", "inversion_options", "motion", "", "")
        return [self.inverter.structs[name] if name else ctypes.c_void_p for name in names]

    def compute(self, given: list[Any]) -> None:
        """All problems in a workspace of the size for which the kernel was loaded."""
        work = (ctypes.c_double * self.work)()
        last = [ctypes.byref(work), ctypes.c_int64(self.work)]
        byref = [x if isinstance(x, ctypes.c_void_p) else ctypes.byref(x) for x in given]
        entry: Any = self.inverter.entry_many
        entry(*byref, *last)
