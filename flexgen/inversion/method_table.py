"""The methods of inverse dynamics: names, summaries and modules; strings only, quick to import."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from flexgen.errors import ArgumentError
from flexgen.registry import extension, names

AUTO = "auto"  # the method that `flexgen.solve` chooses by itself


@dataclass(frozen=True)
class Method:
    """A method of inverse dynamics.

    Attributes
    ----------
    name, summary : str
        For users.
    module, function : str
        Where it is; the function takes an `InversionProblem` and the length of the
        intervals of its mesh [s], and returns a `MethodResult`.
    keeps_limits : bool
        Keeps bounds on torque and speed.
    refines : bool
        More accurate on a finer mesh.
    algebraic : bool
        Computes each sample of the path by itself: no mesh, and no motion before the path.
    any_coupling : bool
        Solves models whose rotors turn with their carriers.
    """

    name: str
    summary: str
    module: str
    function: str = "solve"
    keeps_limits: bool = False
    refines: bool = True
    algebraic: bool = False
    any_coupling: bool = False


SOLVERS = (
    Method(
        "closed-form",
        "algebraic, for models without non-actuated coordinates",
        "flexgen.inversion.methods.closed_form",
        refines=False,
        algebraic=True,
    ),
    Method(
        "lq",
        "stable inversion by linear-quadratic steps, in C; keeps limits",
        "flexgen.inversion.methods.lq",
        keeps_limits=True,
    ),
    Method("bvp", "stable inversion as a two-point boundary value problem, in C", "flexgen.inversion.methods.bvp"),
    Method(
        "collocation",
        "optimal control on the reduced problem (IPOPT)",
        "flexgen.inversion.methods.collocation",
        keeps_limits=True,
    ),
    Method(
        "full",
        "optimal control on the full model, with limits (IPOPT)",
        "flexgen.inversion.methods.full_model",
        keeps_limits=True,
        any_coupling=True,
    ),
)
BASELINES = (
    Method(
        "rigid",
        "baseline: all springs stiff",
        "flexgen.inversion.methods.baselines",
        "rigid",
        refines=False,
        algebraic=True,
        any_coupling=True,
    ),
    Method(
        "fjm",
        "baseline: elastic gears only",
        "flexgen.inversion.methods.baselines",
        "fjm",
        refines=False,
        algebraic=True,
        any_coupling=True,
    ),
    Method(
        "quasistatic",
        "baseline: deflections in equilibrium with their loads",
        "flexgen.inversion.methods.baselines",
        "quasistatic",
        refines=False,
        algebraic=True,
        any_coupling=True,
    ),
)


def method_names() -> tuple[str, ...]:
    """The names of all methods, ``"auto"`` first."""
    own = [[method.name for method in rows] for rows in (SOLVERS, BASELINES)]
    return (AUTO, *own[0], *(name for name in names("methods") if name not in own[0] + own[1]), *own[1])


@cache
def methods() -> dict[str, Method]:
    """All methods by name: those of this table, and those that are registered, see `flexgen.registry`."""
    own = {method.name: method for method in (*SOLVERS, *BASELINES)}
    return {name: own[name] if name in own else _find_method(name) for name in method_names()[1:]}


def _find_method(name: str) -> Method:
    """The row of a registered method; ArgumentError where it is none."""
    found = extension("methods", name)
    if not isinstance(found, Method) or found.name != name:
        raise ArgumentError(f"entry point {name} of flexgen.methods: given {found!r}, expected a Method of this name")
    return found
