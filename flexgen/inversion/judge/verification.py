"""Verification of a solution by a forward simulation of the full model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.output_columns import output_units, turn_angle
from flexgen.dynamics.mechanics.statics import reach
from flexgen.inversion.judge.status import Status
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.solution import Solution
from flexgen.simulation.integration.hold import TorqueCommand
from flexgen.simulation.result import Simulation, error_text
from flexgen.simulation.simulate import AUTO, NONE, simulate


@dataclass(frozen=True)
class Verification:
    """A simulation of a solution and its errors.

    Attributes
    ----------
    simulation : Simulation
    plan_error : (float or None, float or None) or None [m], [rad]
        Where limits are active: how far the simulated output is from the planned one.
    path_distance_m : float or None [m]
        Where limits are active: largest distance of the simulated tool from the path, whatever the
        time.
    worst : float [rad, and m for each meter of reach, at most m]
        Largest error, from the planned output where limits are active.
    defect : float [the same]
        What the residuals between the samples do to the output without feedback; infinite where it
        is not known.
    alone: float [the same]
        Error of the simulation without feedback; infinite where there is none, or none that can be
        determined.
    """

    simulation: Simulation
    plan_error: tuple[float | None, float | None] | None
    path_distance_m: float | None
    worst: float
    defect: float = np.inf
    alone: float = np.inf


def verify_by_simulation(
    problem: InversionProblem, solution: Solution, command: TorqueCommand | None = None
) -> Verification:
    """Simulate a solution under its continuous torque, or under the ``command`` that a controller
    sends, and measure its errors; with active limits also those from the planned motion and from
    the path.
    """
    simulation = simulate(
        problem.equations,
        solution.trajectory,
        start=problem.equilibrium,
        # its motor angles are not those of the robot
        feedback=NONE if solution.status == Status.BASELINE else AUTO,
        command=command,
        progress=problem.progress,
    )
    plan = None
    distance = None
    if solution.status == Status.LIMITS_ACTIVE:
        plan = plan_error(problem.equations, solution, simulation)
        distance = path_distance(problem.equations, solution, simulation)
    size = min(1.0, reach(problem.equations))
    in_m, in_rad = plan or (simulation.tool_error_max_m, simulation.tool_error_max_rad)
    worst = max((in_m or 0.0) / size, in_rad or 0.0)
    defect = _size((simulation.defect_max_m, simulation.defect_max_rad), size)
    run = simulation.open_loop
    alone = np.inf if run is None else _size((run.tool_error_max_m, run.tool_error_max_rad), size)
    return Verification(simulation, plan, distance, worst, defect, alone)


def _size(errors: tuple[float | None, float | None], reach: float) -> float:
    """The larger of a distance [m], for each meter of reach, and an angle [rad].

    Infinite where neither is known.
    """
    in_m, in_rad = errors
    if in_m is None and in_rad is None:
        return np.inf
    return max((in_m or 0.0) / reach, in_rad or 0.0)


def with_simulation(solution: Solution, checked: Verification) -> Solution:
    """The solution with its simulation and what this found; its trajectory, and so a saved file,
    states the errors.
    """
    simulation = checked.simulation
    plan = checked.plan_error or (None, None)
    meta = {**solution.trajectory.meta, "errors": error_text(simulation, "output")}
    return replace(
        solution,
        trajectory=replace(solution.trajectory, meta=meta),
        simulation=simulation,
        warnings=(*solution.warnings, *simulation.warnings),
        plan_error_max_m=plan[0],
        plan_error_max_rad=plan[1],
        path_distance_max_m=checked.path_distance_m,
    )


def plan_error(
    equations: Equations, solution: Solution, simulation: Simulation
) -> tuple[float | None, float | None]:
    """Largest distance [m] and angle [rad] of the simulated output from the planned one; None: no
    such output.
    """
    both = (solution.trajectory, simulation.trajectory)
    planned, found = (
        evaluate(equations.function("output"), t["q_a"])[0].reshape(len(t.time), -1) for t in both
    )
    units = np.array(output_units(equations.model))
    columns = ((found - planned)[:, units == u] for u in ("m", "rad"))
    in_m, in_rad = (
        float(np.linalg.norm(x, axis=1).max()) if x.shape[1] else None for x in columns
    )
    if equations.model.output.type == "tool_pose":
        R, S = (evaluate(equations.function("forward_kinematics"), t["q_a"])[1] for t in both)
        in_rad = max(in_rad or 0.0, float(turn_angle(S, R).max()))
    return in_m, in_rad


def path_distance(
    equations: Equations, solution: Solution, simulation: Simulation
) -> float | None:
    """Largest distance [m] of the simulated tool from the path of the solution, at any time of it;
    None for other outputs.
    """
    from flexgen.paths.geometry.path_distance import distance_from_path

    if equations.model.output.type == "combination":
        return None
    y = evaluate(equations.function("output"), simulation.trajectory["q_a"])[0]
    path = solution.trajectory["y_ref"]
    columns = len(equations.model.output.axes)
    y = y.reshape(-1, path.shape[1])[:, :columns]
    return float(distance_from_path(y, path[:, :columns]).max())
