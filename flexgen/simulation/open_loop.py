"""Accuracy of a simulation in open loop: growth of perturbations, defect, and errors that rounding
decides.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from flexgen.base.calls.deadline import check_time
from flexgen.base.motion.trajectory import Trajectory
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.simulation.result import Simulation
from flexgen.simulation.verification.defect import propagate_residual
from flexgen.simulation.verification.growth import Growth, growth_along, linearize_along, motion_of
from flexgen.simulation.verification.residual import midpoint_residual

# growth of perturbations from which on the torques are verified with motor feedback
UNSTABLE = 100.0
GROWING = 10.0  # growth from which on a simulation takes a tenth of its tolerance
RTOL_LEAST = 1e-13  # of that tolerance
ROUNDING = 1e-12  # rad, m: errors of any simulation that the growth makes larger
NEGLIGIBLE = 1e-10  # rad, m
# times the growth of rounding errors: least error in open loop that a simulation determines
RESOLVED = 10.0


def analyze(
    equations: Equations,
    data: Trajectory,
    given: dict[str, np.ndarray],
    held: float,
    own_torque: bool,
) -> tuple[Growth | None, dict[str, Any]]:
    """Growth of perturbations along a trajectory, and attributes of a `Simulation` by name: the
    growth, and the defect where ``own_torque`` says that the torques are those of the trajectory.

    ``given``: channels in the order of the model; ``held`` [s]: time after the end. Empty without
    speeds or accelerations.
    """
    count = len(data.time)
    motion = motion_of(equations.model, data, {name: x[:count] for name, x in given.items()})
    if motion is None:
        return None, {}
    check_time("growth of perturbations")
    along = linearize_along(equations, motion)
    growth = growth_along(along, held)
    known: dict[str, Any] = {"growth": growth.movement, "growth_whole": growth.whole}
    if not own_torque:
        return growth, known
    check_time("effect of the residuals between the samples")
    residual = midpoint_residual(equations, motion, data.meta.get("torque") == "limited")
    found = propagate_residual(equations, motion, along, residual, growth.movement > UNSTABLE)
    return growth, {**known, "defect_max_m": found[0], "defect_max_rad": found[1]}


def precise(rtol: float, growth: Growth | None) -> float:
    """The relative tolerance of a simulation in open loop: a tenth where perturbations grow."""
    return rtol if growth is None or growth.whole < GROWING else max(rtol / 10, RTOL_LEAST)


def without_lost_errors(simulation: Simulation, growth: Growth | None) -> Simulation:
    """The simulation in open loop without the later error where rounding errors grow to its size.

    The floor is `ROUNDING` times the growth of perturbations; a floor below `NEGLIGIBLE`, or an
    error of `RESOLVED` floors or more, stays.
    """
    later = max(simulation.later_error_max_m or 0.0, simulation.later_error_max_rad or 0.0)
    floor = 0.0 if growth is None else ROUNDING * growth.later
    if floor < NEGLIGIBLE or later >= RESOLVED * floor:
        return simulation
    return replace(simulation, later_error_max_m=None, later_error_max_rad=None)
