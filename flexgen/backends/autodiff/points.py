"""The functions of a library for arrays whose last axes are one point, as JAX and PyTorch have
them.
"""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError, BuildError
from flexgen.base.spec.ports import Port
from flexgen.codegen.build.c_module import compile_module, load_module
from flexgen.runtime.arguments import PARAMETERS, bind
from flexgen.runtime.calls import Function, results_type
from flexgen.runtime.library import Library
from flexgen.runtime.structs import closed_error

MOST_PORTS = 24  # as in points.c
# ends of the names of arrays of NAME_jvp and NAME_vjp
TANGENT = "_tangent"
COTANGENT = "_cotangent"


class _Port(ctypes.Structure):
    _fields_ = [(name, ctypes.c_int32) for name in ("rank", "rows", "columns", "shared")]


class _Function(ctypes.Structure):
    _fields_ = [
        ("key", ctypes.c_uint64),
        ("single", ctypes.c_void_p),
        ("batch", ctypes.c_void_p),
        ("batch_work", ctypes.c_void_p),
        ("work", ctypes.c_int64),
        ("bytes", ctypes.c_int32),
        ("inputs", ctypes.c_int32),
        ("outputs", ctypes.c_int32),
        ("ports", _Port * MOST_PORTS),
    ]


@cache
def module(header: str = "", version: str = "") -> ctypes.CDLL:
    """The compiled ``points.c``; with XLA's header also the handler.

    Parameters
    ----------
    header : str
        Path of ``xla/ffi/api/c_api.h``; empty: without the handler.
    version : str
        Of the package that has the header: another one is compiled again.

    Raises
    ------
    BuildError
        There is no compiler, or it fails.
    """
    text = Path(__file__).with_name("points.c").read_text(encoding="ascii")
    text = text.replace(
        "/* CALLS */", "\n".join(_call(name, more) for name, more in (("single", 0), ("batch", 1)))
    )
    if header:
        text = text.replace('"xla/ffi/api/c_api.h"', f'"{header}"').replace(
            "#ifdef XLA_API", f"#if 1 /* {version} */"
        )
    return load_module(compile_module("points", text))


def _call(name: str, more: int) -> str:
    """A C function that calls a pointer with an array of arguments, for a batch behind the number
    of points.
    """
    cases = []
    for count in range(1, MOST_PORTS + 2):
        types = ", ".join(["int"] * more + ["void *"] * count)
        given = ", ".join(["n"] * more + [f"a[{k}]" for k in range(count)])
        cases.append(f"    case {count}: return ((int (*)({types}))f)({given});\n")
    head = f"static int call_{name}(void *f, int count, {'int n, ' * more}void **a)\n"
    return (
        head + "{\n    switch (count) {\n" + "".join(cases) + "    default: return -1;\n    }\n}\n"
    )


class Points:
    """The functions of a library with their C entry points; equal where the compiled libraries
    are.

    Parameters
    ----------
    library : Library
    """

    def __init__(self, library: Library) -> None:
        self.library = library
        self.functions: Mapping[str, Function] = library.functions
        self.real = np.dtype(np.float64 if library.precision == "double" else np.float32)
        if library.closed:
            raise closed_error(library.name)
        self.entries = {
            name: self._entry(function) for name, function in library.functions.items()
        }
        self._identity = (library.name, *(entry.key for entry in self.entries.values()))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Points) and self._identity == other._identity

    def __hash__(self) -> int:
        return hash(self._identity)

    def __repr__(self) -> str:
        return self.library.name

    def _entry(self, function: Function) -> _Function:
        """The function as C calls it: identity, addresses, workspace and sizes of its arrays.
        ``reduce`` of the function gives the hash of its library.
        """
        _, (_, sha256, name) = function.__reduce__()
        digest = hashlib.sha256(f"{sha256} {name}".encode()).digest()
        shared = "" if self.library.per_point else PARAMETERS
        ports = [*function.inputs, *function.outputs]
        if len(ports) > MOST_PORTS:
            raise BuildError(f"{name}: given {len(ports)} arrays, expected at most {MOST_PORTS}")
        single, work = function.single_address()
        rows = [(len(p.shape), p.shape[0], (*p.shape, 1)[1], int(p.name == shared)) for p in ports]
        return _Function(
            int.from_bytes(digest[:8], "little") | 1,
            single,
            function.batch_address()[0],
            ctypes.cast(function._entries.batch_work, ctypes.c_void_p),  # type: ignore[arg-type]
            work.size,
            self.real.itemsize,
            len(function.inputs),
            len(function.outputs),
            (_Port * MOST_PORTS)(*(_Port(*row) for row in rows)),
        )

    def key(self, name: str) -> int:
        """The number of a function in the handler's table, as a signed integer."""
        return int(np.uint64(self.entries[name].key).astype(np.int64))

    def product(self, name: str, kind: str) -> Function:
        """``NAME_jvp`` or ``NAME_vjp``; ArgumentError that names what to generate where the
        library lacks it.
        """
        found = self.functions.get(f"{name}_{kind}")
        if found is None:
            raise ArgumentError(
                f"{name}: given the library {self.library.name} without {name}_{kind}, expected "
                "one with derivatives: flexgen.generate(model, parts=['derivatives']) (--with "
                f"derivatives), or functions=[..., '{name}_jvp', '{name}_vjp']"
            )
        return found

    def check_order(self, name: str) -> None:
        """ArgumentError where a gradient of this function is none that a library can have."""
        if name.endswith(("_jvp", "_vjp", "_derivatives", "_jacobians")) or name == "linearize":
            raise ArgumentError(
                f"{name}: given a function that is a derivative itself, expected one that is "
                "not: flexgen has no second derivatives"
            )
        if f"{name}_vjp" not in self.functions:
            self.product(name, "jvp")

    def arguments(self, name: str, args: tuple[Any, ...], named: dict[str, Any]) -> list[Any]:
        """The arguments of a call in the order of the inputs; ArgumentError where the library was
        closed.
        """
        if self.library.closed:
            raise closed_error(self.library.name)
        default = self.library.parameters if self.library.parameters.size else None
        inputs = self.functions[name].inputs
        has = any(port.name == PARAMETERS for port in inputs)
        return bind(name, inputs, args, named, default if has else None)

    def lead(self, name: str, shapes: Sequence[tuple[int, ...]]) -> tuple[int, ...]:
        """Axes before those of one point; ArgumentError where the arrays do not fit."""
        return lead_of(name, self.functions[name].inputs, shapes)

    def results(self, name: str, arrays: Sequence[Any]) -> Any:
        """One array, or a named tuple of several."""
        outputs = self.functions[name].outputs
        return (
            arrays[0]
            if len(outputs) == 1
            else results_type(name, tuple(p.name for p in outputs))._make(arrays)
        )

    def own(self) -> list[str]:
        """Names of the functions that are not products with derivatives."""
        return [name for name in self.functions if not name.endswith(("_jvp", "_vjp"))]


def lead_of(
    name: str, ports: Sequence[Port], shapes: Sequence[tuple[int, ...]]
) -> tuple[int, ...]:
    """Axes of a batch: each array has none, or the same ones before its own; ArgumentError where
    one differs.
    """
    lead: tuple[int, ...] = ()
    for port, shape in zip(ports, shapes, strict=True):
        shape = tuple(shape)
        own = len(shape) - len(port.shape)
        fits = own >= 0 and shape[own:] == port.shape
        if not fits or (own and lead and shape[:own] != lead):
            many = ", ".join(map(str, (*(lead or ("...",)), *port.shape)))
            raise ArgumentError(
                f"{name}, {port.name}: given shape {shape}, expected {port.shape} or ({many})"
            )
        lead = shape[:own] or lead
    return lead


class Functions:
    """The functions of a library by name, as attributes; the products with derivatives are used by
    gradients.
    """

    def __init__(self, points: Points, functions: Mapping[str, Any]) -> None:
        self._points = points
        self._functions = dict(functions)

    def __getattr__(self, name: str) -> Any:
        functions = self.__dict__.get("_functions", {})
        if name in functions:
            return functions[name]
        raise AttributeError(
            f"given {name!r}, expected one of the library's functions: {', '.join(functions)}"
        )

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self._functions})

    def __repr__(self) -> str:
        return f"<Functions of {self._points}: {', '.join(self._functions)}>"
