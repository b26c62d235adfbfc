"""CasADi functions in C: written by CasADi, compiled once and kept in the user's cache."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import casadi as ca

from flexgen.codegen.build.c_module import compile_module, module_copy

FAST = 30_000  # operations: above it the compiler takes too long to optimize
LONG = 5_000  # operations: above it the compiler takes a second or more
_EXPORTED = (
    "#ifdef __GNUC__\n"
    '#define CASADI_SYMBOL_EXPORT __attribute__((visibility("default")))\n'
    "#endif\n"
)


def casadi_module(function: ca.Function, before: Callable[[str], None] | None = None) -> Path:
    """The shared library of a CasADi function, which exports it under its name.

    Parameters
    ----------
    function : casadi.Function
        Of scalar expressions.
    before : callable, optional
        Called with one line of text before a long compilation.

    Raises
    ------
    BuildError
        There is no compiler, or it fails.
    """
    size = function.n_instructions()
    generator = ca.CodeGenerator(function.name(), {"with_header": False})
    generator.add(function)

    def announce() -> None:
        if before is not None and size > LONG:
            before(f"compiling {size} operations")

    level = "-O1" if size < FAST else "-O0"
    return compile_module(
        function.name(), _EXPORTED + generator.dump(), level=level, before=announce
    )


def in_c(function: ca.Function) -> ca.Function:
    """Copy of a function that is evaluated by compiled C."""
    return external(function.name(), casadi_module(function))


def external(name: str, module: Path) -> ca.Function:
    """The function of this name in a module of `casadi_module`; BuildError where others could have
    changed it.
    """
    with module_copy(module) as copy:
        return ca.external(name, copy)
