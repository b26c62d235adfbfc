"""`invert` in C on the grid of `flexgen.solve`, with its default tolerance and the growth in its
info.
"""

from __future__ import annotations

from typing import Any

from flexgen.base.errors import FlexgenError
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.signatures import INVERSION
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import grid, samples
from flexgen.paths.path import Path
from flexgen.runtime.inversion.path_inversion import Inversion

MESH = 0.01  # s


def inversion_in_c(equations: Equations, name: str) -> Inversion:
    """The motion of a move."""
    functions = [
        each for each in INVERSION if each != "inversion_jacobians" or equations.model.n_e
    ]
    library = library_with(equations.model, (*functions, "linearize"), ("invert", "growth"))
    path = Path(equations, equations.model.move(name))
    n, period, samples_per_interval, n_pre, n_post = grid(
        InversionProblem(equations, path), min(MESH, path.duration / 50)
    )
    return library.invert(
        *samples(Reduction(equations), path, period, n),
        period=period,
        q_start=path.q_start,
        n_pre=n_pre,
        n_post=n_post,
        samples_per_interval=samples_per_interval,
        growth=True,
    )


def invert_in_c(equations: Equations, name: str) -> dict[str, Any]:
    """Whether it converged, and the growth; the reason where there is no result."""
    try:
        found = inversion_in_c(equations, name)
    except FlexgenError as error:
        return {"in_c": False, "reason_in_c": str(error)}
    return {"in_c": bool(found.converged), "growth_in_c": found.growth}
