"""The unknowns of a problem where the search starts, and their sizes."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.inversion.solution import Solution
from flexgen.paths.path import Path
from flexgen.planning.optimal import guesses
from flexgen.planning.optimal.force import PlanForce
from flexgen.planning.optimal.phase import Phase
from flexgen.planning.optimal.transcribe import Layout

REST = 1e-6  # of a value: by so much it may exceed its bound at rest
RATE = 10.0  # scale of the second derivative in relative time: a quintic law has 5.8
SMALL_TORQUE = 1e-3  # of the largest: least scale of a motor's torque


@dataclass(frozen=True)
class Parameter:
    """An unknown number with bounds, and its value where the search starts."""

    symbol: ca.SX
    lower: float
    upper: float
    guess: float


def start_of(
    layout: Layout,
    path: Path,
    ends: tuple[np.ndarray, np.ndarray],
    guess: str | Solution | Trajectory | None,
    parameters: list[Parameter],
    *,
    free: bool,
    push: PlanForce | None = None,
) -> np.ndarray:
    """The unknowns of a motion; ``free``: the path parameter is one of them; ``push``: on the
    tool.

    Raises
    ------
    ArgumentError
        The guess is unknown or not finite.
    """
    equations = path.equations
    if isinstance(guess, Solution | Trajectory):
        found = guesses.from_solution(equations, guess)
    elif guess is not None and not isinstance(guess, str):
        raise ArgumentError(
            f"guess: given {guess!r}, expected 'rest', 'lq', a Solution or a Trajectory"
        )
    elif guess == "lq" or (guess is None and free):
        found = guesses.from_inversion(equations, path, push)
    elif guess is None or guess == "rest":
        found = guesses.between(equations, ends, path.duration, path)
    else:
        raise ArgumentError(
            f"guess: given {guess!r}, expected 'rest', 'lq', a Solution or a Trajectory"
        )
    x = []
    begun = 0.0
    ratio = found.duration / sum(phase.given_duration for phase in layout.phases)
    for phase in layout.phases:
        mesh = phase.mesh
        T = phase.given_duration
        levels = []
        for sigma in (mesh.nodes, mesh.times):
            t = (begun + T * sigma) * ratio
            y, dy, ddy, tau = found.at(t)
            if free:
                u = path.duration / found.duration
                law = path.segments[0].law(np.clip(t * u, 0.0, path.duration), 2)
                law = law / path.segments[0].law(np.array([1e9]), 0)[0, 0]
                y, dy, ddy = (
                    np.column_stack([part, law[:, k] * u**k])
                    for k, part in enumerate((y, dy, ddy))
                )
            levels.append((y, dy * ratio * T, ddy * (ratio * T) ** 2, tau))
        x.append(mesh.pack(np.hstack([levels[0][0], levels[0][1]]), levels[1][2], levels[1][3]))
        begun += T
    theta = [phase.given_duration for phase in layout.phases] + [
        parameter.guess for parameter in parameters
    ]
    out = np.concatenate([*x, theta])
    if not np.isfinite(out).all():
        raise ArgumentError("guess: given a motion that is not finite, expected finite numbers")
    return np.asarray(out)


def check_rest(phase: Phase, y: np.ndarray, where: str, s: float | None = None) -> None:
    """Check the constraints on coordinates and speeds at rest at an end.

    ``y``: the coordinates there; ``s``: the path parameter where it is known. SolverError where a
    constraint does not hold, ArgumentError where its value is not finite.
    """
    signals = phase.signals
    content = phase.content
    inputs = [part if s is not None else part[: len(y)] for part in (signals.y, signals.dy)]
    stated = [
        (row.name, row.value, row.lower, row.upper)
        for row in content.rows["path"] + content.rows[where]
    ]
    stated += [
        (f"bound of {band.name}", band.value, band.lower, band.upper)
        for band in content.bands.values()
    ]
    for name, value, low, high in stated:
        known = ca.Function("rest", inputs, [value], {"allow_free": True})
        if known.has_free():
            continue
        found = np.array(known(y if s is None else np.r_[y, s], 0.0)).ravel()
        if not np.isfinite(found).all():
            raise ArgumentError(
                f"plan: {name!r} is NaN or infinite at the {where}, expected a finite number"
            )
        excess = np.maximum(low - found, found - high)
        k = int(np.argmax(excess))
        if not excess[k] <= REST * max(1.0, float(np.abs(found).max())):
            raise SolverError(
                f"plan: {name!r} is violated by {excess[k]:.3g} at the {where}, where the arm "
                "is at rest; change the constraint or the move"
            )


def scales(layout: Layout, parameters: list[Parameter], start: np.ndarray) -> np.ndarray:
    """Sizes of the scaled unknowns: 1 of arm coordinates, the ratio of motors, `RATE` of
    accelerations, the largest torque of the motion ``start``, durations and parameters.
    """
    model = layout.phases[0].equations.model
    out = []
    torques = []
    ratio = np.abs(model.eta).max(axis=1)[list(model.i_m)]
    for first, phase in zip(layout.first, layout.phases, strict=False):
        torques.append(
            phase.mesh.unpack(start[first : first + phase.mesh.size])[3].reshape(-1, model.n_m)
        )
    torque = np.abs(np.vstack(torques)).max(axis=0)
    torque = np.maximum(torque, max(SMALL_TORQUE * float(torque.max()), 1e-6))
    for phase in layout.phases:
        mesh = phase.mesh
        side = np.r_[np.ones(model.n_a), ratio, np.ones(mesh.n - model.dof)]
        inner = np.r_[np.tile(RATE * side, mesh.s), np.tile(torque, mesh.s)]
        out.append(np.r_[np.tile(np.r_[side, side], mesh.N + 1), np.tile(inner, mesh.N)])
    theta = [phase.given_duration for phase in layout.phases]
    theta += [max(abs(parameter.guess), 1.0) for parameter in parameters]
    return np.concatenate([*out, theta])
