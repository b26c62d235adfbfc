"""C libraries of the methods that are solved in C: generated once for each model, kept in the
user's cache.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.signatures import INVERTING, offered_functions
from flexgen.model.abilities import obstacle

if TYPE_CHECKING:
    from flexgen.runtime.library import Library

SOLVERS = {"lq": "invert", "bvp": "bvp"}  # hand-written sources of the methods


def has_compiler() -> bool:
    """Whether there is a C compiler."""
    from flexgen.codegen.build.compiler import find_compiler

    return find_compiler() is not None


def inversion_library(
    equations: Equations,
    method: str,
    solvers: Sequence[str] = (),
    *,
    native: bool = False,
    memory: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Library:
    """The library of a model with the functions that a method calls.

    It is made once for each model; the time that this takes does not count in a time limit.

    Parameters
    ----------
    equations : Equations
    method : str
        ``"lq"`` or ``"bvp"``; also for error messages.
    solvers : sequence of str
        The hand-written sources that it calls; default: the one of the method.
    native : bool
        Compile for this processor: often faster, and the last digits depend on the processor.
    memory : bool
        With hysteresis of gears and frictions with a state, which the methods add to the motion of
        the arm.
    progress : callable, optional
        Called with one line of text before a long step.

    Raises
    ------
    ArgumentError
        The model cannot be inverted in C.
    BuildError
        There is no compiler, or it fails.
    """
    from flexgen.codegen.build.model_library import library_with
    from flexgen.codegen.emission.c_functions import inversion_reason
    from flexgen.dynamics.hysteresis.lugre import without_states
    from flexgen.inversion.problem.reduced_problem import advise_full

    model = equations.model if memory else without_states(equations.model)
    offered = offered_functions(model)
    functions = tuple(name for name in INVERTING if name in offered)
    if (reason := inversion_reason(model, functions)) is not None:
        advice = advise_full(model)
        if obstacle(model, "reduced problem") is None:
            advice = "; remove one of them"
        raise ArgumentError(f"method {method}: {reason}{advice}")
    check_time(f"method {method}")
    return library_with(
        model, functions, solvers or (SOLVERS[method],), native=native, progress=progress
    )
