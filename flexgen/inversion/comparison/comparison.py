"""Comparison of a solution with the baselines: tool errors of the same move with simpler
models.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.output_columns import output_units
from flexgen.inversion.solution import Solution
from flexgen.inversion.solve import solve
from flexgen.model.abilities import obstacle

BASELINES = ("rigid", "fjm", "quasistatic")


def compare_methods(
    equations: Equations, solution: Solution, progress: Callable[[str], None] | None = None
) -> tuple[Solution, ...]:
    """A verified solution and the baselines of its move, each simulated on the full model.

    Parameters
    ----------
    equations : Equations
        Of the solution's model.
    solution : Solution
    progress : callable, optional
        Called with one line of text before each of them.

    Returns
    -------
    tuple of Solution
        The baselines, the simplest first, then the solution. Without non-actuated coordinates only
        the rigid one differs from the closed form; in complete motor coupling the exact one
        without it does too. A baseline without a solution is left out, and
        the reason is reported; with a force on the tool or hysteresis of gears there is none.
    """
    wanted: tuple[str, ...] = BASELINES if equations.model.n_e else BASELINES[:1]
    if obstacle(equations.model, "simplified coupling") is not None:
        wanted = (*wanted, "simplified")
    for channel, what in (
        ("force", "the force on the tool"),
        ("tau_h", "the hysteresis of gears"),
    ):
        if channel in solution.trajectory:
            wanted = ()
            if progress is not None:
                progress(f"comparison: no other methods, since they do not take {what}")
    out = []
    for name in wanted:
        if name == solution.method:
            continue
        if progress is not None:
            progress(f"comparison: method {name}")
        try:
            baseline = solve(equations, solution.move, name, progress=False)
        except (ArgumentError, SolverError) as error:
            if progress is not None:
                progress(f"comparison: method {name} has no solution: {error}")
            continue
        if baseline.interrupted:
            raise KeyboardInterrupt
        out.append(baseline)
    return (*out, solution)


def error_rows(solutions: tuple[Solution, ...]) -> list[dict[str, Any]]:
    """Tool errors as JSON types: ``method``, error at the start of the path and largest error, m
    and rad.
    """
    rows = []
    for solution in solutions:
        row: dict[str, Any] = {"method": solution.method, "status": solution.status.value}
        for unit, values in error_sizes(solution).items():
            on_path = solution.trajectory.time >= 0
            row[f"start_{unit}"] = float(values[on_path][0])
            row[f"largest_{unit}"] = float(values.max())
        rows.append(row)
    return rows


def error_sizes(solution: Solution) -> dict[str, np.ndarray]:
    """Size of the simulated output error over time, (n,) each: ``m`` and ``rad`` where the output
    has them.
    """
    simulation = solution.simulation
    if simulation is None or "error" not in simulation.trajectory.channels:
        return {}
    done = simulation.trajectory
    units = np.array(output_units(solution.model))
    out = {
        unit: np.linalg.norm(done["error"][:, units == unit], axis=1)
        for unit in ("m", "rad")
        if (units == unit).any()
    }
    if "turn" in done.channels:
        out["rad"] = np.abs(done["turn"]).max(axis=1)
    return out
