"""Any CasADi function as a small C library: written, compiled and called through its entry points,
for the tests.
"""

from __future__ import annotations

import ctypes
import dataclasses
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
from emitted import run
from toolchain import CC

from flexgen.base.spec.ports import Port
from flexgen.codegen.emission.emit import emit
from flexgen.codegen.emission.spec import FunctionSpec, LibrarySpec, library_spec
from flexgen.codegen.statements.routine import Expressions, Routine
from flexgen.dynamics.mechanics.equations import derive

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
WARNINGS = (
    "-pedantic -Wall -Wextra -Wconversion -Wshadow -Wstrict-prototypes -Wmissing-prototypes "
    "-Werror"
).split()


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


def spec_of(
    program: Routine, inputs: tuple[Port, ...], outputs: tuple[Port, ...], precision="double"
) -> LibrarySpec:
    """A library with one function ``f``."""
    extents = {port.name: tuple(map(str, port.shape)) for port in (*inputs, *outputs)}
    f = FunctionSpec("f", "A function.", "y = f(x)", inputs, outputs, extents, program)
    return dataclasses.replace(_elbow(), name="small", functions=(f,), precision=precision)


BEHIND = 40  # numbers behind an array that are watched: more than a vector


class Small:
    """The compiled library of one function, called by address: ``point`` and ``batch`` give
    (status, results).
    """

    def __init__(self, spec: LibrarySpec, folder: Path, flags=FLAGS, compiler=CC) -> None:
        self.spec = spec
        self.f = spec.functions[0]
        self.files = emit(spec)
        for name, text in self.files.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text, encoding="ascii")
        sources = [name for name in self.files if name.endswith(".c") and name != "example.c"]
        run(
            compiler,
            *flags,
            *WARNINGS,
            "-fPIC",
            "-shared",
            *sources,
            "-lm",
            "-o",
            "small.so",
            folder=folder,
        )
        library = ctypes.CDLL(str(folder / "small.so"))
        self._point = library.small_f
        self._batch = library.small_f_batch
        self._work = max(library.small_work(), library.small_batch_work())
        self.real = np.dtype(np.float64 if spec.precision == "double" else np.float32)

    def _call(self, function, count, inputs, shapes):
        """Status and results; what is behind the workspace and behind each result must stay as it
        was.
        """
        sizes = [self._work, *(int(np.prod(shape)) for shape in shapes)]
        memory = [np.full(size + BEHIND, 7.0, self.real) for size in sizes]
        memory[0][: self._work] = np.nan  # what is read there was written before
        work = memory[0]
        results = [x[:-BEHIND].reshape(shape) for x, shape in zip(memory[1:], shapes, strict=True)]
        # a function for one point takes the workspace only where it needs one; one argument more
        # does no harm
        pointers = [ctypes.c_void_p(x.ctypes.data) for x in (*inputs, *results, work)]
        status = function(*count, *pointers)
        assert all((x[-BEHIND:] == 7.0).all() for x in memory), "written behind an array"
        return status, results

    def point(self, *inputs):
        """At one point, arrays by columns."""
        given = [np.ascontiguousarray(np.ravel(x, order="F"), self.real) for x in inputs]
        return self._call(self._point, (), given, [(port.size,) for port in self.f.outputs])

    def batch(self, *inputs):
        """At N points: inputs (N, size), results (N, size)."""
        n = len(inputs[0])
        given = [np.ascontiguousarray(np.reshape(x, (n, -1)).T, self.real) for x in inputs]
        count = (ctypes.c_int(n),)
        status, results = self._call(
            self._batch, count, given, [(port.size, n) for port in self.f.outputs]
        )
        return status, [x.T for x in results]


def small(function: ca.Function, folder: Path, precision="double", **options) -> Small:
    """The library of an SX function."""
    program = Routine((Expressions(function),))
    return Small(spec_of(program, *ports_of(function), precision), folder, **options)
