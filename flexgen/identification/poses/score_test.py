"""Score test of the numbers that a calibration holds: whether the poses contradict one of them.

A number that is held at a wrong value hides in those that are free, as a payload in a compliance.
At the minimum of a fit the columns of a candidate, one number or a vector, say whether its
gradient is more than noise, without a further fit: `flexgen.identification.estimator.score`. Poses
are the blocks, since the errors of one may depend on each other.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import norm

from flexgen.base.display import plain
from flexgen.base.errors import SolverError
from flexgen.identification.estimator.problem import Linearization
from flexgen.identification.estimator.score import ScoreTest
from flexgen.identification.poses.fit import Minimum, Poses, fit
from flexgen.identification.poses.frame_changes import find_frame_change
from flexgen.identification.poses.parameters import GROUPS, Priors, Unknown, unknowns_of
from flexgen.identification.poses.statics import Numbers, Rest, Statics
from flexgen.identification.poses.tree import Tree

# Probability that a right model has any candidate above the limit.
FALSE_ALARMS = 0.01
MOVED = "a frame of the measurement that moved"
SCALE_OF_POSITIONS = "the scale of the measured positions"
# Steps [unit] below which a place, a zero or a center of mass is a likely fault.
LARGEST_STEP = {"m": 0.5, "rad": 0.5}
# Least ratio of a scale, a mass or a compliance that is a likely fault.
LEAST_RATIO = 0.2
# Part of the squared errors that a candidate explains at least: on a real robot with many poses
# all numbers are wrong by more than the noise.
LEAST_SHARE = 0.05
# Directions of gravity that are tried where a fit has suspects: of a robot on a floor, a ceiling
# or a wall; the error that is left, as a part, where one of them is named.
DIRECTIONS = np.vstack([np.eye(3), -np.eye(3)])
NAMED = 1 / 3
# Poses of these fits, at most.
ENOUGH = 60
STEP = 1e-3  # of gravity, as a part of it, for differences


@dataclass(frozen=True)
class Candidate:
    """Numbers that are held: ``name``, their ``value`` (m,), ``unit``, and the derivatives
    ``columns`` (N, k, 3, m) of the measured positions in them.
    """

    name: str
    value: np.ndarray
    unit: str
    columns: np.ndarray


@dataclass(frozen=True)
class Suspect:
    """A number that the poses contradict.

    ``name``; ``z``: its score in standard deviations, None of another direction of gravity, with
    which all numbers were fitted anew; ``held``, ``value`` (m,) [``unit``]: as it
    is, and as the poses would have it, to first order; ``share``: part of the squared errors that
    it explains, or, ``by_tolerances``, of what the tolerances of a data sheet leave;
    ``same``: names of numbers that do the same to the poses.
    """

    name: str
    z: float | None
    held: tuple[float, ...]
    value: tuple[float, ...]
    unit: str
    share: float
    by_tolerances: bool = False
    same: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """The fault in words."""
        others = f" (or {', '.join(self.same)}, with the same effect)" if self.same else ""
        return (
            f"{self.name} of about {_shown(self.value)}{_space(self.unit)} instead of "
            f"{_shown(self.held)}{others}"
        )

    def __str__(self) -> str:
        score = "" if self.z is None else f" (score of {self.z:.1f} standard deviations)"
        left = (
            "what tolerances of a data sheet leave" if self.by_tolerances else "the squared errors"
        )
        return f"{self.words} explains {100 * self.share:.0f} % of {left}{score}"

    def to_dict(self) -> dict[str, Any]:
        """The sentence and the figures, as JSON types."""
        return {"words": str(self)} | {k: plain(v) for k, v in vars(self).items()}


def _shown(values: Sequence[float]) -> str:
    near_one = all(0.9 < x < 1.1 for x in values)  # scales differ by parts of a percent
    text = ", ".join(f"{x:.5g}" if near_one else f"{x:.3g}" for x in values)
    return text if len(values) == 1 else f"({text})"


def _space(unit: str) -> str:
    return f" {unit}" if unit else ""


def candidates_of(
    statics: Statics, numbers: Numbers, rest: Rest, taken: Sequence[str]
) -> Iterator[Candidate]:
    """The numbers of the model that are not ``taken``, and scales, and gravity.

    Centers of mass and gravity are vectors: a direction in a wrong frame is one fault.
    """
    tree = statics.tree
    every = unknowns_of(tree, GROUPS, (), Priors())
    held = [u for u in every if u.name not in taken and u.kind not in ("frame", "tracker")]
    slopes = statics.slopes(numbers, rest, held)[0] if held else np.zeros((0,))
    for k, u in enumerate(held):
        if u.kind != "center":
            value = np.array([numbers_at(numbers, u)])
            yield Candidate(u.name, value, u.unit, slopes[..., k : k + 1])
    for body in {u.at[0]: None for u in held if u.kind == "center"}:
        own = [k for k, u in enumerate(held) if u.kind == "center" and u.at[0] == body]
        value = np.array([numbers_at(numbers, held[k]) for k in own])
        name = held[own[0]].name.rpartition(".")[0]
        yield Candidate(name, value, "m", slopes[..., own])
    yield from _scales(statics, numbers, rest)
    yield from _gravity(statics, numbers, rest)


def numbers_at(numbers: Numbers, unknown: Unknown) -> float:
    """The value of an unknown."""
    at = unknown.at
    where = {
        "node": numbers.shifts,
        "compliance": numbers.compliances,
        "mass": numbers.masses,
        "center": numbers.centers,
    }
    if unknown.kind == "factor":
        return numbers.factors[at[0], at[1]]
    return float(where[unknown.kind][at if len(at) > 1 else at[0]])


def _scales(statics: Statics, numbers: Numbers, rest: Rest) -> Iterator[Candidate]:
    """Scale of all measured positions, and of the commands of each joint."""
    measured = rest.measured.copy()
    if statics.groups is not None:
        measured[statics.groups >= 0] = 0.0
    if statics.touches is not None:
        measured[statics.touches.touched] = 0.0
    one = np.ones(1)
    if measured.any():
        yield Candidate(SCALE_OF_POSITIONS, one, "", measured[..., None])
    joints = [c for c in statics.model.coordinates if c.actuated]
    nodes = [
        Unknown(c.name, c.unit, "node", (statics.tree.index[c.name],), 0.0, 1.0) for c in joints
    ]
    slopes = statics.slopes(numbers, rest, nodes)[0]
    for k, c in enumerate(joints):
        by_command = slopes[..., k : k + 1] * statics.commands[:, k, None, None, None]
        yield Candidate(f"the scale of the commands of {c.name}", one, "", by_command)


def _gravity(statics: Statics, numbers: Numbers, rest: Rest) -> Iterator[Candidate]:
    """Gravity as a vector in the world, by central differences."""
    size = STEP * max(float(np.linalg.norm(statics.gravity)), 1.0)
    columns = []
    for axis in np.eye(3):
        ends = []
        for sign in (1.0, -1.0):
            turned = copy.copy(statics)
            turned.gravity = statics.gravity + sign * size * axis
            try:
                ends.append(turned.rest(numbers, rest.near).measured)
            except SolverError:
                return
        columns.append((ends[0] - ends[1]) / (2 * size))
    yield Candidate("gravity", statics.gravity, "m/s^2", np.stack(columns, axis=-1))


def is_plausible(name: str, unit: str, held: np.ndarray, value: np.ndarray) -> bool:
    """Whether a number can be such, so that the step to it is a fault of a file or of a record.

    The step is to first order: it says nothing where it is large. Of two candidates with the same
    effect on the poses the one whose step is possible is the fault.
    """
    step = float(np.linalg.norm(value - held))
    if name == "gravity":
        ratio = float(np.linalg.norm(value)) / max(float(np.linalg.norm(held)), 1e-300)
        return LEAST_RATIO < ratio < 1.0 / LEAST_RATIO
    if unit in LARGEST_STEP:
        return step < LARGEST_STEP[unit]
    ratio = float(value[0] / held[0]) if held[0] else 1.0
    return LEAST_RATIO < ratio < 1.0 / LEAST_RATIO or (unit == "" and held[0] != 1.0)


def score_test(problem: Poses, found: Minimum, taken: Sequence[str]) -> tuple[Suspect, ...]:
    """The candidates that the poses contradict, the one that explains most first.

    Parameters
    ----------
    problem : Poses
    found : Minimum
        Of the problem.
    taken : sequence of str
        Names of numbers that are free, or that the poses do not determine.

    Returns
    -------
    tuple of Suspect
        Above the limit that a right model exceeds with the probability `FALSE_ALARMS`.
    """
    every = scores(problem, found, taken)
    limit = norm.isf(FALSE_ALARMS / 2 / max(len(every), 1))
    if found.scale <= problem.sharpest:
        return ()  # errors of the rounding of poses without noise
    above = [one for one in every if (one.z or 0.0) > limit and one.share > LEAST_SHARE]
    return tuple(
        one
        for one in sorted(above, key=lambda one: -one.share)
        if is_plausible(one.name, one.unit, np.array(one.held), np.array(one.value))
    )


def find_causes(problem: Poses, found: Minimum, taken: Sequence[str]) -> tuple[Suspect, ...]:
    """`score_test`; first what explains most of the errors: a frame of the measurement that moved,
    or a direction of gravity.
    """
    suspects = score_test(problem, found, taken)
    change = frame_that_moved(problem, found)
    # a sag against gravity asks for negative compliances, and these are held by their bounds
    held = bool((found.x <= problem.lower).any())
    doubtful = bool(suspects) or held
    gross = gross_gravity(problem, found) if doubtful and change is None else None
    first = [suspect for suspect in (change, gross) if suspect is not None]
    return (*first, *suspects)


def frame_that_moved(problem: Poses, found: Minimum) -> Suspect | None:
    """A tracker or a base that moved between two poses."""
    groups = problem.statics.groups
    touched = groups is not None and bool((groups >= 0).any())
    if touched or problem.statics.touches is not None or found.scale <= problem.sharpest:
        return None
    valid = problem.valid[..., None]
    residuals = np.where(valid, problem.measured - found.rest.measured, np.nan)
    change = find_frame_change(residuals, FALSE_ALARMS)
    if change is None:
        return None
    name = f"{MOVED}: its shift from row {change.row} of the poses"
    shift = tuple(change.shift.tolist())
    return Suspect(name, change.score, (0.0, 0.0, 0.0), shift, "m", change.share)


def test_of(problem: Poses, found: Minimum) -> tuple[ScoreTest, Linearization]:
    """The score test at a minimum, with poses as blocks, and the problem there."""
    problem.near = found.rest.near
    here = problem.linearize(found.x)
    slope = here.slope + problem.prior.slope(found.x)
    moving = (found.x > problem.lower) | (slope < 0)  # the others are held by a bound
    root = np.sqrt(np.diag(problem.prior.information))  # of independent priors
    rows = len(here.gaps) // len(problem.measured)
    test = ScoreTest(
        np.where(moving, here.rows, 0.0),
        here.gaps,
        root,
        found.x - problem.prior.center,
        np.arange(0, len(here.gaps), rows),
        3 * int(problem.valid.sum()),
    )
    return test, here


def scores(problem: Poses, found: Minimum, taken: Sequence[str]) -> tuple[Suspect, ...]:
    """All candidates with their scores, the largest first."""
    test, here = test_of(problem, found)
    misfit = float(here.gaps @ here.gaps)
    numbers = problem.numbers(found.x)
    out = []
    for one in candidates_of(problem.statics, numbers, found.rest, taken):
        score = test.of(here.roots[:, None] * problem.whiten_columns(one.columns))
        if score is None:
            continue
        share = min(score.gain / max(misfit, 1e-300), 1.0)
        held = tuple(one.value.tolist())
        value = tuple((one.value + score.step).tolist())
        out.append(Suspect(one.name, score.z, held, value, one.unit, share))
    return tuple(sorted(out, key=lambda one: -(one.z or 0.0)))


def gross_gravity(problem: Poses, found: Minimum) -> Suspect | None:
    """Another direction of gravity that explains most of the errors, as of a robot on a wall.

    It is too far for a step: compliances that were fitted to wrong loads say nothing. All numbers
    are fitted anew with each of `DIRECTIONS`.
    """
    statics = problem.statics
    rows = np.arange(0, len(problem.measured), max(1, len(problem.measured) // ENOUGH))
    measured = np.where(problem.valid[..., None], problem.measured, np.nan)[rows]
    weights = None if problem.weights is None else problem.weights[rows]
    size = float(np.linalg.norm(statics.gravity))
    start = np.array(
        [u.start if u.is_stated else x for u, x in zip(problem.unknowns, found.x, strict=True)]
    )
    best: tuple[float, np.ndarray] = (np.inf, statics.gravity)
    for direction in DIRECTIONS:
        model = replace(statics.model, gravity=tuple((size * direction).tolist()))
        other = Statics(Tree(model), statics.commands, statics.groups, statics.touches)
        again = Poses(other.among(rows), measured, problem.unknowns, True, None, weights)
        try:
            there = fit(again, start)
        except SolverError:
            continue
        if there.scale < best[0]:
            best = there.scale, size * direction
    scale, gravity = best
    if not scale < NAMED * found.scale or np.allclose(gravity, statics.gravity, atol=0.1 * size):
        return None
    held = tuple(statics.gravity.tolist())
    share = 1.0 - (scale / found.scale) ** 2
    return Suspect("gravity", None, held, tuple(gravity.tolist()), "m/s^2", share)
