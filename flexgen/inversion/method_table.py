"""The table of methods: their names, what they are, and where they are found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

from flexgen.inversion.method_result import MethodResult
from flexgen.inversion.problem import InversionProblem


@dataclass(frozen=True)
class Method:
    """``name`` as a user says it; ``what`` it does; ``module`` and ``function`` of flexgen.solvers that do it.

    ``keeps_limits``: knows bounds. ``refines``: a finer mesh makes it more accurate, so that it is tried.
    ``any_coupling``: works for rotors that turn with their carriers.
    """

    name: str
    what: str
    module: str
    function: str = "answer"
    keeps_limits: bool = False
    refines: bool = True
    any_coupling: bool = False

    def __call__(self, problem: InversionProblem, h: float) -> MethodResult:
        """Solve the problem on a mesh of intervals of ``h`` [s]."""
        found: Callable[[InversionProblem, float], MethodResult] = getattr(
            import_module(f"flexgen.inversion.methods.{self.module}"), self.function
        )
        return found(problem, h)


METHODS = {
    method.name: method
    for method in (
        Method(
            "closed-form",
            "exact, for models without non-actuated coordinates",
            "closed_form",
            "closed_form",
            refines=False,
        ),
        Method("lq", "stable inversion by linear-quadratic steps, in C; keeps limits", "lq", keeps_limits=True),
        Method("bvp", "stable inversion as a two-point boundary value problem, in C", "bvp"),
        Method("collocation", "optimal control on the reduced problem (IPOPT)", "closed_form", "collocation", True),
        Method(
            "full", "optimal control on the full model, with limits (IPOPT)", "closed_form", "full", True, True, True
        ),
        Method("rigid", "baseline: all springs stiff", "baselines", "rigid", refines=False, any_coupling=True),
        Method("fjm", "baseline: elastic gears only", "baselines", "fjm", refines=False, any_coupling=True),
        Method(
            "quasistatic",
            "baseline: deflections follow their loads at once",
            "baselines",
            "quasistatic",
            refines=False,
            any_coupling=True,
        ),
        Method(
            "discretized", "optimisation of the DAE on an even grid, smoothest torque", "discretized", any_coupling=True
        ),
        Method("bdf", "BDF with constant steps on the original DAE of high index", "bdf"),
        Method("reduced", "index reduction by dummy derivatives, SUNDIALS", "dummy_derivatives", refines=False),
        Method("kunkel-mehrmann", "regularised DAE, Radau IIA", "kunkel_mehrmann"),
    )
}
