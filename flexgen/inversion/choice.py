"""Which method solves an inverse dynamics problem: the default one, those tried after it, and
whether one applies.
"""

from __future__ import annotations

import numpy as np

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.inversion.methods.method_table import Method, find_method, methods
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.model.abilities import obstacle
from flexgen.model.elements import RobotModel

# methods that search for minutes (IPOPT)
SEARCHES = ("collocation", "full")
# Times the accuracy: up to this error a method that is exact on fine meshes needs no search of
# minutes after it.
NEARLY = 100.0
# coordinates: "auto" takes the full method up to here; with 12 it needs many minutes
FULL_LARGEST = 8
# Parts of the table of abilities, of methods without a force on the tool: without limits, and
# within limits.
FORCELESS = ("path without force", "limits without force")


def _inverts(robot: RobotModel) -> bool:
    """Whether "lq" applies: the model can be reduced, and there is a C compiler."""
    # here: other methods need no code generation
    from flexgen.inversion.problem.model_library import has_compiler

    return obstacle(robot, "reduced problem") is None and has_compiler()


def _has_undamped_motion(problem: InversionProblem) -> bool:
    """Whether nothing damps an internal motion, or the output is flat; False: not known."""
    try:
        return problem.undamped is not None
    except SolverError:
        return False


def default_method(robot: RobotModel, limits: Limits | None) -> str:
    """Name of the default method."""
    if obstacle(robot, "differentiated equations") is not None:
        return "full"
    if limits is not None:
        return "lq" if _inverts(robot) else "full"
    if robot.n_e == 0:
        return "closed-form"
    return "lq" if _inverts(robot) else "collocation"


def further_methods(problem: InversionProblem, method: Method) -> tuple[Method, ...]:
    """Methods that "auto" tries after its default method, the quickest first."""
    robot = problem.equations.model
    names = []
    if method.name == "closed-form" and _inverts(robot):
        names.append("lq")
    if method.name == "lq" and robot.n_e and _has_undamped_motion(problem):
        # there is no dichotomy for "bvp", and IPOPT wanders among the oscillations for minutes
        names.append("spline")
    else:
        if method.name == "lq" and robot.n_e:
            names += ["bvp", "collocation"]
        if method.name != "full" and robot.n_a <= FULL_LARGEST:
            names.append("full")
    found = (find_method(name) for name in names)
    able = (method for method in found if problem.limits is None or method.keeps_limits)
    part = FORCELESS[problem.limits is not None]
    known = problem.force is None and obstacle(robot, part) is None
    return tuple(method for method in able if known or method.takes_force)


def is_worth_a_search(problem: InversionProblem, method: Method, error: float) -> bool:
    """Whether "auto" tries a method after another one has found a motion.

    ``error``: verified, of that motion; infinite: none. A search cannot gain where the motion is
    exact at its samples, as without non-actuated coordinates, where the torque has kinks that no
    mesh resolves, or where the error is near the accuracy already.
    """
    if method.name not in SEARCHES or not np.isfinite(error):
        return True
    if problem.equations.model.n_e == 0 and problem.limits is None:
        return False
    return problem.smoothness.sufficient and error > NEARLY * problem.accuracy


def check_applies(
    method: Method, robot: RobotModel, limits: Limits | None, pushed: bool = False
) -> None:
    """Refuse a method that cannot keep ``limits``, take a force on the tool (``pushed``), or solve
    the motor coupling of the model: ArgumentError with the methods that can.
    """
    if not method.takes_force:
        able = ", ".join(m.name for m in methods().values() if m.takes_force)
        if pushed:
            raise ArgumentError(
                f"force: given with method {method.name!r}, expected one of the methods {able}"
            )
        # Such methods leave out some features of robots too: others without limits than within.
        if (reason := obstacle(robot, FORCELESS[limits is not None])) is not None:
            given = f"given {robot.title}, whose {reason.removeprefix('the ')}"
            raise ArgumentError(
                f"method {method.name!r}: {given}, or one of the methods {able}, "
                "which take it into account"
            )
    if limits is not None and not method.keeps_limits:
        able = ", ".join(m.name for m in methods().values() if m.keeps_limits)
        raise ArgumentError(
            f"limits: method {method.name!r} tracks the path exactly and cannot keep limits, "
            f"expected one of {able}"
        )
    reason = None if method.any_coupling else obstacle(robot, "reduced problem")
    if reason is not None:
        able = ", ".join(m.name for m in methods().values() if m.any_coupling)
        raise ArgumentError(f"method {method.name}: {reason}, or one of the methods {able}")
