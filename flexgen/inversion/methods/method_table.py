"""The methods of inverse dynamics: names, summaries and modules; strings only, quick to import."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from flexgen.base.errors import ArgumentError
from flexgen.base.registry import extension, names, own_names

AUTO = "auto"  # the method that `flexgen.solve` chooses by itself
MethodName = str  # one of `method_names`


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
        Keeps bounds on torque, speed and deflection.
    refines : bool
        More accurate on a finer mesh.
    algebraic : bool
        Computes each sample of the path by itself: no mesh, and no motion before the path.
    any_coupling : bool
        Solves models whose rotors turn with their carriers.
    takes_force : bool
        Takes a force on the tool along the path, hysteresis of gears and Fourier sums of motor
        angles.
    """

    name: str
    summary: str
    module: str
    function: str = "solve"
    keeps_limits: bool = False
    refines: bool = True
    algebraic: bool = False
    any_coupling: bool = False
    takes_force: bool = False


SOLVERS = (
    Method(
        "closed-form",
        "algebraic, for models without non-actuated coordinates",
        "flexgen.inversion.methods.closed_form",
        refines=False,
        algebraic=True,
        takes_force=True,
    ),
    Method(
        "lq",
        "stable inversion by linear-quadratic steps, in C; keeps limits",
        "flexgen.inversion.methods.lq",
        keeps_limits=True,
        takes_force=True,
    ),
    Method(
        "bvp",
        "stable inversion as a two-point boundary value problem, in C",
        "flexgen.inversion.methods.bvp",
        takes_force=True,
    ),
    Method(
        "spline",
        "splines of the non-actuated coordinates, for outputs that are flat or nearly so",
        "flexgen.inversion.methods.spline",
    ),
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
    Method(
        "simplified",
        "baseline: exact, but for complete coupling of the rotors",
        "flexgen.inversion.methods.baselines",
        "without_coupling",
        refines=False,
        any_coupling=True,
    ),
)


def method_names() -> tuple[str, ...]:
    """The names of all methods, ``"auto"`` first; those of other packages before the baselines."""
    own = (*SOLVERS, *BASELINES)
    more = (name for name in names("methods") if all(name != method.name for method in own))
    return (
        AUTO,
        *(method.name for method in SOLVERS),
        *more,
        *(method.name for method in BASELINES),
    )


def find_method(name: str) -> Method:
    """The method of a name; one that another room or package has added is imported, all others are
    not.
    """
    for method in (*SOLVERS, *BASELINES):
        if method.name == name:
            return method
    if name not in names("methods"):
        raise ArgumentError(f"method: given {name!r}, expected one of {', '.join(method_names())}")
    found = extension("methods", name)
    if not isinstance(found, Method) or found.name != name:
        raise ArgumentError(
            f"entry point {name} of flexgen.methods: given {found!r}, expected a Method of this "
            "name"
        )
    return found


@cache
def methods() -> dict[str, Method]:
    """The methods of flexgen by name."""
    own = (*SOLVERS, *(find_method(name) for name in own_names("methods")), *BASELINES)
    return {method.name: method for method in own}
