"""The methods of inverse dynamics: names, summaries and modules; strings only, quick to import."""

from __future__ import annotations

from dataclasses import dataclass

AUTO = "auto"  # the method that `flexgen.solve` chooses by itself


@dataclass(frozen=True)
class Method:
    """A method of inverse dynamics.

    Attributes
    ----------
    name, summary : str
        For users.
    module, function : str
        Where it is, in `flexgen.inversion.methods`; the function takes an `InversionProblem` and the length of the
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


METHODS = {
    method.name: method
    for method in (
        Method(
            "closed-form",
            "algebraic, for models without non-actuated coordinates",
            "closed_form",
            refines=False,
            algebraic=True,
        ),
        Method(
            "lq",
            "stable inversion by linear-quadratic steps, in C; keeps limits",
            "lq",
            keeps_limits=True,
        ),
        Method("bvp", "stable inversion as a two-point boundary value problem, in C", "bvp"),
        Method(
            "collocation",
            "optimal control on the reduced problem (IPOPT)",
            "collocation",
            keeps_limits=True,
        ),
        Method(
            "full",
            "optimal control on the full model, with limits (IPOPT)",
            "full_model",
            keeps_limits=True,
            any_coupling=True,
        ),
        Method(
            "discretized",
            "optimization of the DAE on a uniform grid, smoothest torque",
            "discretized",
            any_coupling=True,
        ),
        Method("bdf", "BDF with constant steps on the original DAE of high index", "bdf"),
        Method("reduced", "index reduction by dummy derivatives, SUNDIALS", "dummy_derivatives", refines=False),
        Method("kunkel-mehrmann", "regularized DAE, Radau IIA", "kunkel_mehrmann"),
        Method(
            "rigid",
            "baseline: all springs stiff",
            "baselines",
            "rigid",
            refines=False,
            algebraic=True,
            any_coupling=True,
        ),
        Method(
            "fjm", "baseline: elastic gears only", "baselines", "fjm", refines=False, algebraic=True, any_coupling=True
        ),
        Method(
            "quasistatic",
            "baseline: deflections in equilibrium with their loads",
            "baselines",
            "quasistatic",
            refines=False,
            algebraic=True,
            any_coupling=True,
        ),
    )
}
NAMES = (AUTO, *METHODS)
