"""The joint fit: all blocks of records as one problem of the estimator, each channel weighted by
its own misfit.

    min  sum_c |r_c(x)|^2 / (s_c^2 k_c) + (x - x_0)' P (x - x_0)

s_c: root mean square of the residuals of a channel, computed anew a few times; k_c: residuals for
one that is independent, see `Channel.count_correlated`. A channel with an effect that the model
lacks, such as hysteresis, has a large s_c and less weight. Steps to bodies whose inertia is not
positive are refused; the bodies that are written are the nearest ones that are physically
consistent. (Slender bodies are at the edge of these, where a search that stays within them ends.)

Directions that the records do not determine keep the numbers of the file: eigenvectors of the
covariance, in units of the deviations of the prior, whose deviation is more than a half,

    min (z - z_fit)' (A + 1) (z - z_fit),      z = sum of the other eigenvectors.

The covariance is that of the scatter of parts of the records. The information of residuals that a
wrong model leaves would determine too much: two zeros of a joint that differ by 0.04 rad.

Source: P. Wensing, S. Kim and J.-J. Slotine, IEEE RA-L 3(1), 2018 (physical bodies);
`flexgen.identification.estimator` (search, covariance of blocks).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from flexgen.base.calls.deadline import best_known, is_over
from flexgen.base.errors import SolverError
from flexgen.dynamics.mechanics.parameters import with_values
from flexgen.identification.commissioning.blocks import Block, Channel
from flexgen.identification.commissioning.motion_block import MotionBlock
from flexgen.identification.commissioning.reasons import NO_REASONS, Reasons, find_reasons
from flexgen.identification.commissioning.unknowns import (
    Unknowns,
    is_positive,
    make_physical,
)
from flexgen.identification.estimator.covariance import Blocks, covariance_of
from flexgen.identification.estimator.minimize import Search, minimize
from flexgen.identification.estimator.problem import Linearization, Prior, Problem

ROUNDS = 4  # of fits with weights from the residuals of the last one
STEPS = 6  # of the search in a round, with those that are refused; the last one has more
LAST_STEPS = 16
REFUSALS = 8  # steps in a row that are refused before a round ends
# Largest factors of a change of a stiffness and of a damping in a round. Far from the minimum
# dampings make up for stiffnesses and friction, and stiff dampers make the simulation slow.
FACTOR = 4.0
FACTOR_OF_DAMPING = 2.0
SETTLED = 0.05  # largest relative change of a weight from which on there are no more rounds
DISTANCE = 0.05  # standard deviations from the minimum where a search ends
# Part of the objective that a step promises below which a search ends.
GAIN = 1e-3
# Least size of residuals, as a part of the recorded signal: no model of a robot is more exact, and
# records without noise then do not decide everything.
EXACT = 1e-4
# Increase of the objective for numbers that go back to those of the file: a standard deviation.
SPENT = 1.0
# Standard deviations of a change of a zero or a length from which on it is written.
SEEN = 2.0
WEAK = 0.5  # posterior over prior deviation from which on the number of the file stays

Tell = Callable[[str], None]
Keep = Callable[[str, Channel], np.ndarray]


@dataclass(frozen=True)
class Weight:
    """Of one channel: ``size`` of its residuals and how many count as one."""

    size: float
    correlated: float

    @property
    def root(self) -> float:
        """Factor of the residuals."""
        return 1.0 / (self.size * np.sqrt(self.correlated))


@dataclass(frozen=True, eq=False)
class JointFit:
    """Result of a joint fit.

    Parameters
    ----------
    unknowns : Unknowns
    x : array (n,)
        At the minimum; ``written``: without changes along directions that are not determined.
    covariance : array (n, n)
        Of x, from the scatter of the parts of the records.
    determined : array of bool (n,)
    information : mapping of name of a record to array (n,)
        Diagonal of its information, in units of the prior.
    misfits : list of (record, kind, channel, rms, size, unit)
    converged : bool
    top_speeds : array (n_m,) [rad/s]
        Of the motors in all motions; empty: there is none.
    reasons : Reasons
        Single reasons for numbers that are far from the datasheet.
    """

    unknowns: Unknowns
    x: np.ndarray
    written: np.ndarray
    covariance: np.ndarray
    determined: np.ndarray
    information: dict[str, np.ndarray]
    misfits: list[tuple[str, str, str, float, float, str]]
    converged: bool
    top_speeds: np.ndarray
    reasons: Reasons = NO_REASONS

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations (n,); of numbers that are not determined that of the prior."""
        own = np.sqrt(np.diag(self.covariance))
        return np.where(self.determined, own, self.unknowns.sd)


def everything(name: str, channel: Channel) -> np.ndarray:
    """Rows of a channel that take part in a fit to all records."""
    return channel.told


class _Stack:
    """All blocks as residuals of one vector."""

    def __init__(
        self, unknowns: Unknowns, blocks: Sequence[Block], keep: Keep, tell: Tell, what: str
    ) -> None:
        self.unknowns = unknowns
        self.blocks = blocks
        self.keep = keep
        self.tell = tell
        self.what = what
        self.weights: dict[tuple[str, str], Weight] = {}
        self._known: tuple[np.ndarray, list[tuple[str, Channel]]] | None = None

    def channels(self, x: np.ndarray, derivatives: bool) -> list[tuple[str, Channel]]:
        """Name of the record and channel of all blocks, at physical bodies only."""
        named = self.unknowns.vector.named(x[self.unknowns.parts.model])
        robot = with_values(self.unknowns.robot, named)
        for element in robot.elements:
            if not is_positive(element.body):
                raise SolverError(
                    f"commission: the body of {element.name} has a negative inertia at this step"
                )
        out = []
        for block in self.blocks:
            self.tell(f"{self.what}: {block.name}")
            out += [(block.name, channel) for channel in block.channels(x, derivatives)]
        return out

    def reweigh(self, x: np.ndarray) -> float:
        """Weights from the residuals at x; returns the largest relative change of a size."""
        largest = 0.0
        for name, channel in self.channels(x, False):
            kept = channel.told & self.keep(name, channel)
            r = channel.residual[kept]
            size = max(float(np.sqrt(np.mean(r**2))) if len(r) else 0.0, EXACT * channel.size)
            size = max(size, 1e-300)
            new = Weight(size, channel.count_correlated())
            old = self.weights.get((name, channel.title))
            largest = max(largest, 1.0 if old is None else abs(np.log(size / old.size)))
            self.weights[name, channel.title] = new
        return largest

    def rows(self, x: np.ndarray, derivatives: bool) -> list[tuple[str, Channel, np.ndarray]]:
        """Record, channel and factor of each row."""
        out = []
        for name, channel in self.channels(x, derivatives):
            root = self.weights[name, channel.title].root
            out.append((name, channel, root * (channel.told & self.keep(name, channel))))
        return out

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Weighted residuals (N,)."""
        return np.concatenate([c.residual * factor for _, c, factor in self.rows(x, False)])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Their derivatives (N, n)."""
        return np.vstack([c.jacobian * factor[:, None] for _, c, factor in self.rows(x, True)])


def fit_jointly(
    unknowns: Unknowns,
    blocks: Sequence[Block],
    start: np.ndarray,
    tell: Tell,
    *,
    keep: Keep = everything,
    free: np.ndarray | None = None,
    rounds: int = ROUNDS,
    what: str = "fit",
) -> JointFit:
    """Fit all unknowns to all blocks.

    Parameters
    ----------
    unknowns : Unknowns
    blocks : sequence of Block
    start : array (n,)
    tell : callable
        Is given a line now and then.
    keep : callable
        Record and channel -> rows that take part.
    free : array of bool (n,), optional
        Others stay at the start.
    rounds : int
    what : str
        Of the lines.

    Raises
    ------
    SolverError
        The model has no equilibrium at the start.
    """
    stack = _Stack(unknowns, blocks, keep, tell, what)
    for block in blocks:
        block.set_free(np.ones(len(start), bool) if free is None else free)
    sd = unknowns.sd if free is None else np.where(free, unknowns.sd, 1e-9 * unknowns.sd)
    center = unknowns.start if free is None else np.where(free, unknowns.start, start)
    prior = Prior.of_sd(center, sd)
    x = start.copy()
    converged = False
    for k in range(rounds):
        began = time.perf_counter()
        for block in blocks:
            block.relinearize(x)
        change = stack.reweigh(x)
        is_last = k + 1 == rounds or (k > 1 and change < SETTLED)
        bounds = _bounds_near(unknowns, x)
        problem = Problem(stack.residual, stack.jacobian, prior, bounds)

        def show(step: int, here: Linearization, k: int = k) -> None:
            tell(f"{what}: round {k + 1}, step {step}, misfit {here.value:.4g}")

        steps = LAST_STEPS if is_last else STEPS
        search = Search(
            distance=DISTANCE, gain=GAIN, steps=steps, curvature=True, refusals=REFUSALS,
            stage="commission", tell=show,
        )  # fmt: skip
        found = minimize(problem, x, search)
        x = found.x
        converged = found.converged
        best_known(time.perf_counter() - began)
        if is_last or is_over():
            break
    for block in blocks:
        block.relinearize(x)
    stack.reweigh(x)
    return _result(stack, x, prior, converged)


def _bounds_near(unknowns: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of a round: stiffnesses and dampings stay within a factor."""
    lower, upper = (bound.copy() for bound in unknowns.bounds)
    model = unknowns.vector.unknowns
    scales = np.array([unknown.scale == "log" for unknown in model])
    damped = np.array([unknown.name.endswith(".damping") for unknown in model])
    way = np.log(np.where(damped, FACTOR_OF_DAMPING, FACTOR))[scales]
    rows = np.flatnonzero(scales) + unknowns.parts.model.start
    lower[rows] = np.maximum(lower[rows], x[rows] - way)
    upper[rows] = np.minimum(upper[rows], x[rows] + way)
    return lower, upper


def _result(stack: _Stack, x: np.ndarray, prior: Prior, converged: bool) -> JointFit:
    """Accuracy of a minimum, and the numbers that are written."""
    unknowns = stack.unknowns
    sd = 1.0 / np.sqrt(np.diag(prior.information))
    matrices: list[np.ndarray] = []
    scores: list[np.ndarray] = []
    information: dict[str, np.ndarray] = {}
    misfits = []
    kinds = {block.name: block.kind for block in stack.blocks}
    pieces: dict[tuple[str, int], int] = {}
    for name, channel, factor in stack.rows(x, True):
        J = channel.jacobian * factor[:, None] * sd
        r = channel.residual * factor
        kept = factor > 0.0
        used = np.sqrt(np.mean(channel.residual[kept] ** 2)) if kept.any() else 0.0
        row = (name, kinds[name], channel.title, float(used), channel.size, channel.unit)
        misfits.append(row)
        information[name] = information.get(name, np.zeros(len(x))) + (J**2).sum(axis=0)
        for piece in np.unique(channel.piece[kept]):
            rows = kept & (channel.piece == piece)
            key = name, int(piece)
            if key not in pieces:
                pieces[key] = len(matrices)
                matrices.append(np.zeros((len(x), len(x))))
                scores.append(np.zeros(len(x)))
            matrices[pieces[key]] += J[rows].T @ J[rows]
            scores[pieces[key]] += J[rows].T @ r[rows]
    A = np.sum(matrices, axis=0)
    blocks = Blocks(np.array(matrices), np.array(scores))
    covariance = covariance_of(blocks, np.eye(len(x))) * np.outer(sd, sd)
    determined = np.sqrt(np.diag(covariance)) < WEAK * sd
    shared = covariance / np.outer(sd, sd)
    away = (x - prior.center) / sd
    nominal = find_nominal(shared, away, _of_places(unknowns))
    written = prior.center + sd * _choose(A, shared, away, determined, nominal)
    written = make_physical(unknowns, np.clip(written, *unknowns.bounds))
    tops = [block.top for block in stack.blocks if isinstance(block, MotionBlock)]
    top = np.max(tops, axis=0) if tops else np.zeros(0)
    return JointFit(
        unknowns, x, written, covariance, determined, information, misfits, converged, top,
        find_reasons(unknowns, A, away),
    )  # fmt: skip


def _of_places(unknowns: Unknowns) -> list[int]:
    """Numbers of zeros and lengths."""
    parts = unknowns.parts
    return [int(k) for part in (parts.zeros, parts.lengths) for k in parts.entries(part)]


def find_nominal(covariance: np.ndarray, z: np.ndarray, candidates: Sequence[int]) -> list[int]:
    """Those among the candidates that may have exactly the value of the file: the change of each
    is at most `SEEN` of its deviations, the others without it given.

    A joint that was made as drawn and a zero that was set are common; a spring as in the
    catalogue is not.

    Parameters
    ----------
    covariance : array (n, n)
        In units of the deviations of the prior, as the changes z (n,).
    """
    C = (covariance + covariance.T) / 2
    out = z.copy()
    left = list(candidates)
    found: list[int] = []
    while left:
        costs = np.array([out[k] ** 2 / max(C[k, k], 1e-300) for k in left])
        best = int(np.argmin(costs))
        if costs[best] > SEEN**2:
            break
        k = left.pop(best)
        found.append(k)
        if C[k, k] > 0.0:
            column = C[:, k] / C[k, k]
            out = out - column * out[k]
            C = C - np.outer(column, C[k])
    return found


def _choose(
    A: np.ndarray,
    covariance: np.ndarray,
    z: np.ndarray,
    determined: np.ndarray,
    nominal: Sequence[int] = (),
) -> np.ndarray:
    """Changes that are written, from those of a fit, in units of the deviations of the prior.

    First the changes along directions that the data do not determine are left out, and those of
    the numbers that are nominal. Then as many of the numbers that are not determined alone go back
    to the file as the others can make up for, the cheapest first: the objective rises by `SPENT`
    at most.

    Parameters
    ----------
    A : array (n, n)
        Information of the data; with the prior it is A + 1.
    covariance : array (n, n)
        From the scatter of parts of the records.
    z : array (n,)
        Changes.
    determined : array of bool (n,)
    nominal : sequence of int
    """
    whole = A + np.eye(len(z))
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    known = vectors[:, values < WEAK**2]
    # the minimum of the objective without changes along the other directions
    weighted = known.T @ whole
    z = known @ np.linalg.solve(weighted @ known, weighted @ z)
    H = np.linalg.inv(whole)
    spent = 0.0
    out = z.copy()
    fixed: list[int] = []

    def fix(k: int) -> None:
        """Set a number to that of the file; H is the inverse of the matrix of the others."""
        column = H[:, k] / H[k, k]
        out[:] -= column * out[k]
        H[:] -= np.outer(column, H[k])
        fixed.append(k)
        out[fixed] = 0.0

    for k in nominal:
        fix(k)
    candidates = [int(k) for k in np.flatnonzero(~determined) if k not in fixed]
    while candidates:
        costs = np.array([out[k] ** 2 / H[k, k] for k in candidates])
        best = int(np.argmin(costs))
        if spent + costs[best] > SPENT:
            break
        spent += costs[best]
        fix(candidates.pop(best))
    return out
