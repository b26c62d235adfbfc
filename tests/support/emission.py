"""Any CasADi function as a small C library: written, compiled and called through its entry points, for the tests."""

from __future__ import annotations

import ctypes
import dataclasses
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
from emitted import run
from toolchain import CC

from flexgen.codegen.emit import emit
from flexgen.codegen.spec import FunctionSpec, LibrarySpec, library_spec
from flexgen.expressions.routine import Expressions, Routine
from flexgen.mechanics.equations import derive
from flexgen.ports import Port

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
WARNINGS = ("-pedantic -Wall -Wextra -Wconversion -Wshadow -Wstrict-prototypes -Wmissing-prototypes -Werror").split()


@cache
def _elbow() -> LibrarySpec:
    return library_spec(derive("elbow"), ["gravity"])


def ports_of(function: ca.Function) -> tuple[tuple[Port, ...], tuple[Port, ...]]:
    """Vectors and matrices as the function has them."""

    def port(name: str, rows: int, columns: int) -> Port:
        return Port(name, (rows,) if columns == 1 else (rows, columns), "1", "an array")

    inputs = [port(function.name_in(i), *function.size_in(i)) for i in range(function.n_in())]
    outputs = [port(function.name_out(i), *function.size_out(i)) for i in range(function.n_out())]
    return tuple(inputs), tuple(outputs)


def spec_of(program: Routine, inputs: tuple[Port, ...], outputs: tuple[Port, ...], precision="double") -> LibrarySpec:
    """A library with one function ``f``."""
    extents = {port.name: tuple(map(str, port.shape)) for port in (*inputs, *outputs)}
    f = FunctionSpec("f", "A function.", "y = f(x)", inputs, outputs, extents, program)
    return dataclasses.replace(_elbow(), name="small", functions=(f,), precision=precision)


class Small:
    """The compiled library of one function, called by address: ``point`` and ``batch`` give (status, results)."""

    def __init__(self, spec: LibrarySpec, folder: Path, flags=FLAGS, compiler=CC) -> None:
        self.spec, self.f = spec, spec.functions[0]
        self.files = emit(spec)
        for name, text in self.files.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text, encoding="ascii")
        sources = [name for name in self.files if name.endswith(".c") and name != "example.c"]
        run(compiler, *flags, *WARNINGS, "-fPIC", "-shared", *sources, "-lm", "-o", "small.so", folder=folder)
        library = ctypes.CDLL(str(folder / "small.so"))
        self._point, self._batch = library.small_f, library.small_f_batch
        self._work = max(library.small_work(), library.small_batch_work())
        self.real = np.dtype(np.float64 if spec.precision == "double" else np.float32)

    def _call(self, function, count, inputs, shapes):
        work = np.zeros(self._work, self.real)
        results = [np.full(shape, 7.0, self.real) for shape in shapes]
        # a function for one point takes the workspace only where it needs one; one argument more does no harm
        pointers = [ctypes.c_void_p(x.ctypes.data) for x in (*inputs, *results, work)]
        return function(*count, *pointers), results

    def point(self, *inputs):
        """At one point, arrays by columns."""
        given = [np.ascontiguousarray(np.ravel(x, order="F"), self.real) for x in inputs]
        return self._call(self._point, (), given, [(port.size,) for port in self.f.outputs])

    def batch(self, *inputs):
        """At N points: inputs (N, size), results (N, size)."""
        n = len(inputs[0])
        given = [np.ascontiguousarray(np.reshape(x, (n, -1)).T, self.real) for x in inputs]
        count = (ctypes.c_int(n),)
        status, results = self._call(self._batch, count, given, [(port.size, n) for port in self.f.outputs])
        return status, [x.T for x in results]


def small(function: ca.Function, folder: Path, precision="double", **options) -> Small:
    """The library of an SX function."""
    program = Routine((Expressions(function),))
    return Small(spec_of(program, *ports_of(function), precision), folder, **options)
