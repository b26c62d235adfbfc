"""The pictures of a report: figures with names and captions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from flexgen.analysis.analyze import Analysis
from flexgen.analysis.zero_dynamics.zeros_along_path import zero_path
from flexgen.base.errors import SolverError
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.inversion.judge.status import Status
from flexgen.inversion.solution import Solution
from flexgen.model.abilities import obstacle
from flexgen.paths.path import Path
from flexgen.views.plots import along_path
from flexgen.views.plots import solution as plots

GRAVITY_POLE = (
    "The slow pole in the right half plane is the arm falling under gravity with free motors, "
    "not a fault of the controller."
)


@dataclass(frozen=True)
class Picture:
    """A figure of the report; ``name``: of its file and its element in the page."""

    name: str
    figure: Figure
    caption: str


def pictures(
    equations: Equations,
    solution: Solution,
    analysis: Analysis | None,
    limits: Limits,
    verified: tuple[Solution, ...] = (),
) -> list[Picture]:
    """Draw all pictures of the report of a solution.

    Parameters
    ----------
    equations : Equations
    solution : Solution
    analysis : Analysis or None
        At the start of the move; None if there is no equilibrium.
    limits : Limits
        Limits to draw; those of the model where not given.
    verified : tuple of Solution
        Verified solutions of the same move by several methods.
    """
    out = _motion(equations, solution, analysis, limits)
    if analysis is not None:
        out += linear_pictures(analysis, "at the start of the move")
    zeros = _zeros_along(equations, solution)
    if len(verified) > 1:
        caption = (
            "Tool error of the full model under the torques of several methods, simulated open "
            "loop from the equilibrium with the tool at the start of the path."
        )
        zeros.append(
            Picture("methods", along_path.errors_of_methods(equations.model, verified), caption)
        )
    return out + zeros


def is_limited(solution: Solution) -> bool:
    """Whether limits keep the motion off the path."""
    return solution.status == Status.LIMITS_ACTIVE or solution.plan_error_max is not None


def _motion(
    equations: Equations, solution: Solution, analysis: Analysis | None, limits: Limits
) -> list[Picture]:
    """Robot, torques, speeds, deflections and errors over time."""
    trajectory = solution.trajectory
    simulation = solution.simulation
    given = (equations, trajectory, simulation)
    end = solution.move.duration
    source = "planned" if simulation is None else "simulated"
    limited = (
        " The limits are active: the robot deviates from the path." if is_limited(solution) else ""
    )
    early = _early_torque(solution, analysis)
    # the full method does not track the path exactly
    exact = analysis if solution.method != "full" else None
    out = [
        Picture(
            "robot",
            plots.robot(*given, end=end),
            f"The robot along the move, with the {source} path and the reference.{limited}",
        ),
        Picture(
            "torques",
            plots.torques(*given, analysis=exact, end=end, limits=limits.torque),
            f"Torque of each motor. {early}".rstrip() + limited,
        ),
        Picture(
            "speeds",
            plots.speeds(*given, end=end, limits=limits.speed),
            "Speed of each motor. Dashed: its limits, if they are near.",
        ),
    ]
    if plots.elastic_groups(equations, trajectory):
        text = "Non-actuated coordinates and deflections of the gears, with the sag under gravity."
        out.append(Picture("deflections", plots.deflections(*given, end=end), text))
    if simulation is not None and "error" in simulation.trajectory.channels:
        text = (
            "Error of the full model under this torque, from a forward simulation by an "
            "integrator that is independent of the solver."
        ) + _after_the_samples(solution)
        out.append(Picture("errors", plots.errors(*given, end=end), text + limited))
    return out


def _after_the_samples(solution: Solution) -> str:
    """A sentence where the largest error is reached after the samples, so that plot and summary
    differ.
    """
    simulation = solution.simulation
    if simulation is None:
        return ""
    drawn = float(np.abs(simulation.trajectory["error"]).max())
    errors = [
        x for x in (simulation.tool_error_max_m, simulation.tool_error_max_rad) if x is not None
    ]
    if max(errors, default=0.0) < 2 * drawn:  # components drawn, norms in the summary
        return ""
    return (
        " The errors in the summary are larger: they also cover the time after the samples, in "
        "which the last torque is held."
    )


def _early_torque(solution: Solution, analysis: Analysis | None) -> str:
    """Explanation of the torque before the path."""
    if analysis is None:
        return ""
    if solution.method == "full":
        return (
            "Before the path it results from the optimization, which weighs the tool error and "
            "changes of torque."
        )
    if analysis.zeros.phase == "non-minimum phase" and solution.trajectory.time[0] < 0:
        return (
            "It starts before the path because the zero dynamics is unstable: only "
            "pre-actuation keeps it bounded. The lower panel shows this early torque on a "
            "logarithmic scale, with the exponential growth of the slowest unstable zero "
            "(dashed)."
        )
    return "No zero is unstable, so no pre-actuation is needed."


def linear_pictures(analysis: Analysis, where: str) -> list[Picture]:
    """Poles and zeros, and frequency response; ``where``: of the pose, for the captions."""
    what = "output" if analysis.model.output.type == "combination" else "tool"
    text = f"Poles and zeros {where}; {plots.phase_summary(analysis)}."
    if plots.falls_under_gravity(analysis):
        text += f" {GRAVITY_POLE}"
    response = (
        f"Frequency response {where}, from each motor torque to the acceleration of the same "
        f"motor (upper panel) and of the {what} (lower panel). Dashed lines: modes. At the "
        "minima of the upper panel the robot vibrates while that motor stands still."
    )
    return [
        Picture("pole_zero_map", plots.pole_zero_map(analysis), text),
        Picture("frequency_response", plots.frequency_response(analysis), response),
    ]


def _zeros_along(equations: Equations, solution: Solution) -> list[Picture]:
    """Zeros at the poses along the path; empty if there are none."""
    model = equations.model
    if not (model.n_e and obstacle(model, "reduced problem") is None):
        return []
    try:
        found = zero_path(equations, Path(equations, solution.move))
    except SolverError:
        return []
    if not np.isfinite(found.zeros).any():
        return []
    caption = (
        "Zeros at the equilibrium poses along the path. "
        f"{found.verdict[:1].upper()}{found.verdict[1:]}."
    )
    return [Picture("zeros_along", along_path.zeros_along(model, found), caption)]
