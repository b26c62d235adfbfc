"""Prediction of the tool error of a robot that is known up to its tolerances.

Robots are drawn from the table ``[uncertainty]`` of the model file and simulated under the torques
of a solution with the motor feedback of `flexgen.simulation.motor_feedback`, whose gains are those
of the model. Their errors e and those to first order, l, give log e = a + b log l; 95 % of many
robots of the first order, corrected by that line and its residuals, are below the stated error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path as FilePath
from time import perf_counter
from typing import Any

import numpy as np

from flexgen.base.calls.deadline import (
    check_time,
    has_limit,
    is_over,
    keep_best,
    limit_fit,
    part_known,
    reason_of_end,
)
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import Count, Seed, TimeLimit
from flexgen.base.checks.counts import ROBOTS, count_of
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.registry import provides
from flexgen.base.spec.arguments import seed_of
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.inversion.judge.status import Status
from flexgen.inversion.solution import Solution
from flexgen.inversion.solve import solve
from flexgen.model.elements import Move, RobotModel
from flexgen.studies.tolerances.misfit import (
    MISFIT,
    add_misfit,
    append_misfit,
    elastic_displacement,
    merge_names,
    merge_shares,
    misfit_rows,
    with_misfit,
)
from flexgen.studies.tolerances.response import (
    Along,
    Response,
    linear_response,
    linearize,
    response,
)
from flexgen.studies.tolerances.result import UNITS, Band, Prediction, Share
from flexgen.studies.tolerances.sources import Sources, sources_of

LEVEL = 0.95  # of the robots are below the error
# robots to first order; of them in bands; instants of both
DRAWN = 4000
IN_BANDS = 400
INSTANTS = 200
FEWEST = 16  # robots
# Error of a simulated robot over their median from which on it is unstable: it grew until the
# end of the motion, and is finite by chance.
DIVERGED = 1e3
USABLE = (Status.SOLVED, Status.LIMITS_EXCEEDED)


@checked_types
@reported("predict")
def predict(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None = None,
    *,
    solution: Solution | None = None,
    robots: Count = 48,
    seed: Seed = 0,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> Prediction:
    """Predict the tool error, motor torques and deflections of robots that are known up to the
    tolerances of the model.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
        With a table ``[uncertainty]``.
    move : str or Move, optional
        A move or program of the model file; default: the first.
    solution : Solution, optional
        The move solved before; default: `flexgen.solve` with its default method.
    robots : int
        That are simulated, 16 or more.
    seed : int
        Of the draws.
    time_limit : float, optional [s]
        Time limit; default: no limit. Then, or after Ctrl-C, the figures are those of the robots
        that were simulated, 16 or more, and ``ended`` says so. None or 0: unlimited.
    progress : callable or bool, optional

    Returns
    -------
    Prediction

    Raises
    ------
    ArgumentError
        The model has no table ``[uncertainty]``, or none of its numbers; the solution is not
        solved.
    OutOfTime
        The time was over before 16 robots were simulated.
    SolverError
        The move has no solution.

    Examples
    --------
    >>> known_up_to = {"uncertainty": {"stiffness": 0.1, "masses": 0.03}}
    >>> found = flexgen.predict(flexgen.read("elbow", overrides=known_up_to))
    >>> f"95 % of the robots within {1e6 * found.error_m:.0f} um"
    '95 % of the robots within 170 um'
    >>> found.shares[0].name, found.to_halve
    ('q1.stiffness', ('q1.stiffness',))
    """
    tell: Callable[[str], None] = progress if callable(progress) else lambda line: None
    equations = model if isinstance(model, Equations) else derive(model)
    robot = equations.model
    if robot.uncertainty is None:
        raise ArgumentError(
            f"predict: given {robot.title}, which has no table [uncertainty], expected one in "
            "the model file, such as [uncertainty] with stiffness = 0.1 and masses = 0.03 "
            "(relative standard deviations)"
        )
    count_of("robots", robots, ROBOTS)
    if robots < FEWEST:
        raise ArgumentError(f"robots: given {robots}, expected at least {FEWEST}")
    sources = sources_of(robot, robot.uncertainty)
    with limit_fit("predict", time_limit, tell, first=f"{FEWEST} robots"):
        if solution is None:
            solution = solve(equations, move, progress=progress)
            check_time("solving the move")
        if solution.status not in USABLE:
            raise ArgumentError(
                f"predict: given a solution with the status {solution.status}, expected one that "
                "is solved: only then are its errors those of the robot"
            )
        tell("linearizing along the motion")
        along = linearize(equations, solution.trajectory, sources)
        first = linear_response(along)
        tell(f"simulating {robots} robots")
        errors = sources.errors(
            np.random.default_rng(seed_of(seed)).standard_normal((DRAWN, sources.root.shape[1]))
        )
        found = _simulate(along, errors[:robots])
        ended = reason_of_end() if found.error.shape[1] < robots else ""
        if robot.uncertainty.misfit > 0.0:
            u = elastic_displacement(robot, along)
            rows = misfit_rows(u, along.units, robot.uncertainty.misfit)
            # of their own, so that the other errors are those without a misfit
            drawn = np.random.default_rng([seed_of(seed), rows.shape[1]])
            lacking = drawn.standard_normal((DRAWN, rows.shape[1]))
            found = add_misfit(found, rows, lacking)
            first = append_misfit(first, rows)
            sources = with_misfit(sources, rows.shape[1])
            errors = np.hstack([errors, lacking])
        return replace(
            _prediction(solution, sources, along, first, found, errors, seed), ended=ended
        )


def _simulate(along: Along, errors: np.ndarray) -> Response:
    """The response of robots with ``errors`` (robots, sources); with a time limit in groups, of
    those that are done at its end.
    """
    robots = len(errors)
    size = FEWEST if has_limit() else robots
    parts: list[Response] = []
    for begin in range(0, robots, size):
        began = perf_counter()
        with keep_best():
            parts.append(response(along, errors[begin : begin + size]))
        done = min(len(parts) * size, robots)
        if done <= begin or is_over():
            break
        part_known("robots", (perf_counter() - began) / size, robots - done)
    if len(parts) == 1:
        return parts[0]
    names = ("error", "tau_m", "deflection")
    return Response(*(np.concatenate([getattr(x, n) for x in parts], axis=1) for n in names))


@provides("FastestMove.torques")
def torque_band(solution: Solution, progress: Choice = None) -> tuple[np.ndarray, np.ndarray]:
    """Limits (k, n_m) [N m] between which the motor torques of 95 % of the robots are;
    `flexgen.fastest` calls it.
    """
    found = predict(solution.model, solution=solution, progress=progress).torque
    return found.low, found.high


def _prediction(
    solution: Solution,
    sources: Sources,
    along: Along,
    first: Response,
    found: Response,
    errors: np.ndarray,
    seed: int,
) -> Prediction:
    """The figures of simulated robots ``found``, whose errors are the first of ``errors`` (N,
    sources).

    ``first``: response to one unit of each source, by which all N errors are known to first order.
    """
    robots = found.error.shape[1]
    at = np.unique(np.linspace(0, len(along.t) - 1, INSTANTS).astype(int))
    # a deflection is a force over a stiffness
    effective = np.where(sources.springs, errors / (1.0 + errors), errors)
    simulated: dict[str, np.ndarray | None] = {}
    stated: dict[str, float | None] = {}
    sizes: dict[str, Any] = {}
    for unit in UNITS:
        columns = [k for k, own in enumerate(along.units) if own == unit]
        simulated[unit] = None
        stated[unit] = None
        if columns:
            sizes[unit] = first.error[at][:, :, columns]
            exact = np.linalg.norm(found.error[:, :, columns], axis=2).max(axis=0)
            simulated[unit] = exact
            stated[unit] = quantile_of_robots(exact, largest_errors(sizes[unit], effective), seed)
    main = next(iter(sizes))
    shares = variance_shares(sources, sizes[main])
    bands = _bands(along, first, effective[:IN_BANDS], at)
    names = merge_names(sources.names)
    sd = sources.sd[: len(names)].copy()
    if MISFIT in names:
        assert solution.model.uncertainty is not None
        sd[-1] = solution.model.uncertainty.misfit
    return Prediction(
        solution,
        along.feedback,
        names,
        sd,
        robots,
        seed,
        stated["m"],
        stated["rad"],
        simulated["m"],
        simulated["rad"],
        along.t[at],
        *bands,
        merge_shares(shares),
        merge_names(find_sources_to_halve(sources, shares, sizes[main], effective[:1000])),
    )


def largest_errors(rows: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Largest errors of the output (robots,) over time, from those of each source ``rows`` (k,
    sources, parts).
    """
    k, n, parts = rows.shape
    found = errors @ rows.transpose(1, 0, 2).reshape(n, k * parts)
    return np.asarray(np.linalg.norm(found.reshape(len(errors), k, parts), axis=2).max(axis=1))


def quantile_of_robots(exact: np.ndarray, first: np.ndarray, seed: int) -> float | None:
    """The error that the share `LEVEL` of the robots keeps; None where a simulated robot is
    unstable.

    ``exact``: largest errors of the simulated robots; ``first`` (N): to first order, those of the
    simulated ones at the beginning. A line between their logarithms, with its scatter drawn again,
    takes the N errors to exact ones.
    """
    if not np.isfinite(exact).all() or exact.max() > DIVERGED * np.median(exact):
        return None
    x = np.log(np.maximum(first, 1e-300))
    y = np.log(np.maximum(exact, 1e-300))
    own = x[: len(y)]
    slope = float(np.polyfit(own, y, 1)[0]) if np.ptp(own) > 1e-6 else 1.0
    rest = y - y.mean() - slope * (own - own.mean())
    scatter = np.random.default_rng(seed).choice(rest, len(x))
    return float(np.quantile(np.exp(y.mean() + slope * (x - own.mean()) + scatter), LEVEL))


def _bands(along: Along, first: Response, errors: np.ndarray, at: np.ndarray) -> tuple[Band, Band]:
    """Bands of motor torque and deflection that the share `LEVEL` of the robots keeps at each of
    the instants ``at``; ``errors`` (robots, sources), ``first``: response to one unit of each
    source.
    """
    out = []
    for own, planned, names in (
        (first.tau_m, along.motion["tau_m"], along.motors),
        (first.deflection, along.motion["deflection"], along.springs),
    ):
        found = np.einsum("rs,ksj->rkj", errors, own[at], optimize=True)
        low, high = np.quantile(found, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
        out.append(Band(names, planned[at], planned[at] + low, planned[at] + high))
    return out[0], out[1]


def variance_shares(sources: Sources, rows: np.ndarray) -> tuple[Share, ...]:
    """Parts of the variance of the error where it is largest, to first order; the largest first.

    ``rows`` (instants, sources, components): error for one unit of each source. Of sources that
    are correlated each has half of what both have in common.
    """
    scaled = rows * sources.sd[None, :, None]
    correlation = sources.root @ sources.root.T
    products = np.einsum("ksp,ktp->kst", scaled, scaled, optimize=True) * correlation
    k = int(products.sum(axis=(1, 2)).argmax())
    parts = products[k].sum(axis=1) / products[k].sum()
    order = np.argsort(-parts, kind="stable")
    return tuple(Share(sources.names[i], sources.kinds[i], float(parts[i])) for i in order)


def find_sources_to_halve(
    sources: Sources, shares: tuple[Share, ...], rows: np.ndarray, errors: np.ndarray
) -> tuple[str, ...]:
    """The fewest of the largest sources without which the error is half of what it is, to first
    order; ``rows`` as for `variance_shares`, ``errors`` (robots, sources). A search by halves.
    """
    half = np.quantile(largest_errors(rows, errors), LEVEL) / 2
    order = [sources.names.index(share.name) for share in shares]
    fewest = 1
    most = len(order)
    while fewest < most:
        count = (fewest + most) // 2
        left = errors.copy()
        left[:, order[:count]] = 0.0
        if np.quantile(largest_errors(rows, left), LEVEL) <= half:
            most = count
        else:
            fewest = count + 1
    return tuple(sources.names[i] for i in order[:most])
