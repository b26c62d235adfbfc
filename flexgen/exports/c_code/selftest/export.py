"""`export_selftest`: the emitted library with a program that compares it with the definition on
its target.
"""

from __future__ import annotations

import os

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import SolverError
from flexgen.codegen.build.template_files import template
from flexgen.codegen.emission.spec import PrecisionName
from flexgen.exports.c_code.emitted import ModelLike, emit
from flexgen.exports.c_code.selftest.cases import cases
from flexgen.exports.c_code.selftest.golden import at_rest, compute_expected, states
from flexgen.exports.c_code.selftest.motion import motion_of
from flexgen.exports.exported import Exported
from flexgen.model.friction import memory_laws
from flexgen.model.moves import Move

PACKAGE = "flexgen.exports.c_code.selftest"


@checked_types(own=("model", "directory"))
def export_selftest(
    model: ModelLike,
    directory: str | os.PathLike[str] | None = None,
    *,
    precision: PrecisionName = "double",
    move: str | Move | None = None,
    motion: bool = True,
    force: bool = False,
) -> Exported:
    """Write a program in ISO C99 that tests the emitted library on the computer that it runs on.

    The program calls every function of one point at two states and compares the results with those
    of the definition, Lagrange's equations, which CasADi evaluates while it is exported. Where the
    model has streams, one stays at the home pose, and one follows a move; the torques are those of
    the static equations, and of a solution that a simulation of the definition verifies. It prints
    PASS or FAIL and the largest error, and returns 0 or 1. It opens no file and allocates nothing.
    The largest error of a point function is 1e-9 of an entry plus 1e-3 of the largest entry of its
    array (single precision: 2e-2 and 1e-1).

    Parameters
    ----------
    model : str, Path, RobotModel or Equations
    directory : str or Path, optional
        Where to write; default: ``exports/<name>_selftest``.
    precision : str
        Of the library.
    move : str or Move, optional
        The move that the stream follows; default: the first.
    motion : bool
        With a stream along a move. False: without a stream along a move. That takes the time of a
        verified solution.
    force : bool
        Also replace files that were changed since the export.

    Returns
    -------
    Exported

    Raises
    ------
    ModelError, ArgumentError, BuildError, SolverError
        The model cannot be read or has a name that C does not allow; the folder holds other files;
        the torques of the move are not found.

    Examples
    --------
    >>> print(flexgen.export_selftest("elbow", motion=False))
    exports/elbow_selftest
    """
    library = emit(model, precision=precision)
    name = library.name
    equations = library.equations
    given = states(equations, precision, library.functions)
    results = compute_expected(equations, library.functions, given)
    rest = None
    moving = None
    if library.streams and library.stream is not None:
        try:
            rest = at_rest(equations)
        except SolverError:  # the home pose has no equilibrium
            rest = None
        if motion and equations.model.moves:
            moving = motion_of(equations, library.stream, move)
    exponential = any(law.exponential for law in memory_laws(equations.model))
    words = {"LIBM": " -lm" * exponential}
    texts = library.texts() | {
        f"{name}_selftest.c": template(PACKAGE, "selftest.c", name, words),
        f"{name}_selftest_cases.h": cases(library, given, results, rest, moving),
    }
    return library.write("selftest", directory, texts, force=force)
