"""A move of a self-test: samples of its path, and motor torques that a method of the definition
finds for it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flexgen.base.errors import FlexgenError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.exports.c_code.emitted import StreamOptions
from flexgen.inversion.judge.status import Status
from flexgen.inversion.solve import solve
from flexgen.model.friction import memory_laws
from flexgen.model.moves import Move
from flexgen.paths.path import Path, PathSample, find_move

SMALL = 8  # coordinates of a robot for which collocation takes seconds
UPDATES = 120  # of the stream beyond its horizon, at most
# smallest singular value of the output's Jacobian, relative to the largest: below it no stream
# passes
SINGULAR = 1e-3


@dataclass(frozen=True)
class Motion:
    """A stream along a move.

    Parameters
    ----------
    y : ndarray (n + 1, n_t)
        Samples of the output, one update apart; the first one is where the stream starts.
    dy, ddy : ndarray (n + 1, n_y)
        Their derivatives.
    q_start : ndarray (n_a)
        Where the search of the equilibrium starts.
    tau_m : ndarray (n, n_m)
        Motor torques at the begin of the interval that each update gives [N m].
    options : StreamOptions
    """

    y: np.ndarray
    dy: np.ndarray
    ddy: np.ndarray
    q_start: np.ndarray
    tau_m: np.ndarray
    options: StreamOptions


def motion_of(
    equations: Equations, options: StreamOptions, move: str | Move | None = None
) -> Motion:
    """The first move of a model, or the named one.

    The torques are those of the method "collocation" on the definition, which shares no code with
    the stream (without coordinates without motor: "closed-form"). Of robots with more than `SMALL`
    coordinates, for which it takes minutes, and of those whose gears or motors have memory, they
    are those of `flexgen.solve`. A simulation of the full model by the definition verifies them in
    each case.

    Raises
    ------
    ArgumentError, SolverError
        The move does not exist, or its torques are not found; `motion=False` leaves this test out.
    """
    model = equations.model
    chosen = find_move(model, move)
    path = Path(equations, chosen)
    n = min(math.ceil(path.duration / options.period), UPDATES) + options.intervals
    sample = path.sample(np.arange(n + 1) * options.period)
    quick = model.n_a <= SMALL and not memory_laws(model)
    method = "closed-form" if not model.n_e else "collocation" if quick else "auto"
    try:
        found = solve(equations, chosen, method, ignore_limits=True, progress=False)
        if found.status is not Status.SOLVED:
            raise SolverError(f"method {method}: {found.status}")
    except FlexgenError as error:
        raise SolverError(
            f"self-test of the stream, move {chosen.name}: {error}; choose another move, or "
            "leave this test out: motion=False (--no-motion)"
        ) from error
    trajectory = found.trajectory
    # update k takes sample k, which is the end of the horizon; the interval that begins is
    # `intervals` updates earlier
    t = (np.arange(1, n + 1) - options.intervals) * options.period
    at = trajectory.at(np.clip(t, trajectory.time[0], trajectory.time[-1]))
    _refuse_singular(equations, at["q_a"], chosen.name)
    tau = at["tau_m"]
    return Motion(
        targets(sample), sample.derivative(1), sample.derivative(2), path.q_start, tau, options
    )


def _refuse_singular(equations: Equations, q_a: np.ndarray, move: str) -> None:
    """Refuse a ``move`` on whose way ``q_a`` (n, n_a) the motors cannot move the output in some
    direction: SolverError.
    """
    model = equations.model
    zero = np.zeros(model.n_a)
    target = np.zeros(model.output.target_size)
    W = evaluate(equations.function("output_constraint"), q_a, zero, target)[1].reshape(
        len(q_a), -1, model.n_a
    )
    values = np.linalg.svd(W[:, :, list(model.i_g)], compute_uv=False)
    if (values[:, -1] < SINGULAR * values[:, 0]).any():
        raise SolverError(
            f"self-test of the stream, move {move}: given a move through a singular pose, which "
            "no stream passes; choose another move (move=, --move), or leave this test out: "
            "motion=False (--no-motion)"
        )


def targets(sample: PathSample) -> np.ndarray:
    """Samples of the output (n, n_t); of a pose the position, then the matrix by columns."""
    if sample.R is None:
        return np.ascontiguousarray(sample.y[:, :, 0])
    return np.hstack([sample.y[:, :, 0], sample.R.transpose(0, 2, 1).reshape(len(sample.R), 9)])
