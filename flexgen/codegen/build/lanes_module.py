"""CasADi functions in C for several points at once, and a C text that calls them: compiled once,
kept in the cache.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import casadi as ca

from flexgen.codegen.build.c_module import compile_module
from flexgen.codegen.emission.amalgamation import merge_text
from flexgen.codegen.emission.clib_files import kernel_files
from flexgen.codegen.statements.function_text import FunctionText, function_text
from flexgen.codegen.statements.routine import Expressions, Routine

_NAME = "module"  # in the names of the kernel
_PORTS = ("given_{}", "found_{}")  # of arguments and results, by their numbers
# straight-line code in good order: a six-axis arm is 6 % faster with -O2, measured once
_FLAGS = "-O1"


def lanes_module(name: str, functions: Mapping[str, ca.Function], body: str) -> Path:
    """The shared library of a C text that evaluates functions at ``LANES`` points at once.

    The numbers of a point are in one lane of vectors: entry i of an argument or a result is at
    ``i * LANES``. Results have the same bits on every processor, and in every lane.

    Parameters
    ----------
    name : str
        Of the file.
    functions : mapping of str to casadi.Function
        Of scalar expressions, by the names of macros of the text:
        ``NAME(arguments and results, w)`` evaluates one, with a workspace of ``NAME_WORK`` lanes.
    body : str
        The C text. It also finds the functions of ``kernel.h`` in `flexgen.codegen.clib`.

    Raises
    ------
    BuildError
        There is no compiler, or it fails; or a function has an operation that has no C.
    """
    return compile_module(name, lanes_text(functions, body), level=_FLAGS)


def lanes_text(functions: Mapping[str, ca.Function], body: str) -> str:
    """The C text that `lanes_module` compiles: the functions by the key of their macros, then
    ``body``, which calls them.
    """
    written = {key: _write(key.lower(), function) for key, function in functions.items()}
    parts = [
        '#include "module_private.h"\n#include "module_lanes.h"\n',
        *(text.text for text in written.values()),
    ]
    parts += [
        '#include "module_undefine.h"\n',
        *(_macros(key, functions[key], written[key]) for key in written),
    ]
    files = kernel_files(_NAME, "double")
    files |= {
        "module.h": f"typedef double {_NAME}_real;\n",
        "module_batch.h": "",
        "body.c": "\n".join([*parts, body]),
    }
    return merge_text("body.c", files)


def _write(prefix: str, function: ca.Function) -> FunctionText:
    """The mathematics of a function, whose ports are numbered."""
    arguments = [ca.SX.sym("x", function.size1_in(i)) for i in range(function.n_in())]
    results = [ca.densify(result) for result in function.call(arguments)]
    given, found = (
        [port.format(k) for k in range(n)]
        for port, n in zip(_PORTS, (function.n_in(), function.n_out()), strict=True)
    )
    named = ca.Function(prefix, arguments, results, given, found)
    inputs = {port: function.size1_in(k) for k, port in enumerate(given)}
    outputs = {port: function.numel_out(k) for k, port in enumerate(found)}
    return function_text(Routine((Expressions(named),)), inputs, outputs, prefix=f"{prefix}_")


def _macros(key: str, function: ca.Function, text: FunctionText) -> str:
    """Macros with which the text calls a function."""
    ports = ", ".join(f"a{k}" for k in range(function.n_in() + function.n_out()))
    work = ", w" if text.work else ""
    call = f"{key.lower()}_evaluate_v({ports}{work}, LANES)"
    return f"#define {key}_WORK {text.work}\n#define {key}({ports}, w) (void){call}\n"
