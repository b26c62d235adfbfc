"""Initial guesses: a slow motion between the ends, an inversion of the move, or another
solution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from flexgen.base.errors import FlexgenError, SolverError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.quasistatic import poses_along
from flexgen.dynamics.mechanics.statics import equilibrium_at
from flexgen.inversion.solution import Solution
from flexgen.inversion.solve import solve
from flexgen.paths.path import Path
from flexgen.paths.timing.time_laws import TimeLaw
from flexgen.planning.optimal.force import PlanForce

POSES = 60


@dataclass(frozen=True)
class Guess:
    """A motion over ``duration`` [s]: ``at(t)`` gives y, dy, ddy (k, dof) and torques (k, n_m)."""

    duration: float
    at: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]


def from_trajectory(
    equations: Equations, trajectory: Trajectory, begin: float, end: float
) -> Guess:
    """The motion of a trajectory between two instants."""
    i_m = list(equations.model.i_m)

    def at(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        found = trajectory.at(np.clip(t + begin, trajectory.time[0], trajectory.time[-1]))
        y, dy, ddy = (np.hstack([found[f"{x}_a"], found[f"{x}_m"][:, i_m]]) for x in "qva")
        return y, dy, ddy, found["tau_m"]

    return Guess(end - begin, at)


def from_inversion(equations: Equations, path: Path, push: PlanForce | None = None) -> Guess:
    """The exact inversion of the move by its default method."""
    force = None if push is None else push.along(path)
    found = solve(
        equations, path.move, force=force, verify=False, ignore_limits=True, progress=False
    )
    return from_trajectory(equations, found.trajectory, 0.0, path.duration)


def between(
    equations: Equations, ends: tuple[np.ndarray, np.ndarray], duration: float, path: Path | None
) -> Guess:
    """A slow motion of ``duration`` [s] from one equilibrium to another, along the path where that
    can be followed; rigid torques.

    ``ends``: coordinates (dof,) at start and end. Where the path leads elsewhere, the joints move
    straight.
    """
    model = equations.model
    times = np.linspace(0.0, duration, POSES + 1)
    n_a = model.n_a
    i_g = list(model.i_g)
    i_m = list(model.i_m)
    arm = _interpolate(ends, times, n_a)
    if path is not None:
        try:
            poses = poses_along(equations, path, times * (path.duration / duration))
            if np.abs(poses[[0, -1]] - arm[[0, -1]]).max() < 1e-3:
                arm = poses
        except FlexgenError:  # the straight motion of the joints serves
            pass
    curve = CubicSpline(times, arm, bc_type="clamped")
    q, v, a = (curve(times, k) for k in range(3))
    tau_g = evaluate(equations.function("inverse_dynamics"), q, v, a)[0].reshape(len(times), -1)[
        :, i_g
    ]
    inertia = np.array([motor.inertia for motor in model.motors])
    torque = CubicSpline(
        times, tau_g @ np.linalg.inv(model.eta) + (a[:, i_g] @ model.eta.T) * inertia
    )
    first, last = (end[n_a:] for end in ends)

    def at(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Coordinates, speeds, accelerations and torques at instants t [s]; motors without joint
        share the difference at the ends in proportion to time.
        """
        t = np.clip(t, 0.0, duration)
        geared = (curve(t)[:, i_g] @ model.eta.T)[:, i_m]
        share = (t / duration)[:, None]
        ends_m = [(arm[k][i_g] @ model.eta.T)[i_m] for k in (0, -1)]
        motors = geared + (1 - share) * (first - ends_m[0]) + share * (last - ends_m[1])
        rates = [(curve(t, k)[:, i_g] @ model.eta.T)[:, i_m] for k in (1, 2)]
        return (
            np.hstack([curve(t), motors]),
            np.hstack([curve(t, 1), rates[0]]),
            np.hstack([curve(t, 2), rates[1]]),
            torque(t),
        )

    return Guess(duration, at)


def _interpolate(ends: tuple[np.ndarray, np.ndarray], times: np.ndarray, n_a: int) -> np.ndarray:
    share = TimeLaw(float(times[-1]), 3)(times, 0)
    share = share / share[-1]
    return ends[0][:n_a] + share * (ends[1] - ends[0])[:n_a]


def rest_at(equations: Equations, q_a: np.ndarray) -> np.ndarray:
    """Coordinates (dof,) of the equilibrium at ``q_a``."""
    found = equilibrium_at(equations, q_a)
    return np.concatenate([found.q_a, found.q_m[list(equations.model.i_m)]])


def ends_of(
    equations: Equations, path: Path, push: PlanForce | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Equilibria at both ends of a path, under the force there."""
    times = np.array([0.0, path.duration])
    held = (
        [equations, equations]
        if push is None
        else [push.pushing(equations, s) for s in (0.0, 1.0)]
    )
    first = poses_along(held[0], path, times)
    last = first if push is None else poses_along(held[1], path, times)
    return rest_at(held[0], first[0]), rest_at(held[1], last[1])


def from_solution(equations: Equations, found: Solution | Trajectory) -> Guess:
    """The motion of a solution; SolverError where it is one of another robot."""
    trajectory = found.trajectory if isinstance(found, Solution) else found
    names = tuple(c.name for c in equations.model.coordinates)
    if trajectory.labels.get("q_a") != names or not {"q_m", "v_m", "a_m", "tau_m"} <= set(
        trajectory.channels
    ):
        raise SolverError(
            f"guess: given a trajectory of {trajectory.meta.get('model')}, expected one of "
            f"{equations.model.name} with the channels q_a v_a a_a q_m v_m a_m tau_m"
        )
    planned = trajectory.meta.get("kind") == "plan"
    begin = float(trajectory.time[0])
    end = float(trajectory.time[-1])
    if isinstance(found, Solution) and not planned:
        begin = 0.0
        end = float(found.move.duration)
    return from_trajectory(equations, trajectory, begin, end)
