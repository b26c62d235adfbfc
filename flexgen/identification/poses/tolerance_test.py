"""Score test of the numbers that a calibration frees: whether one of them, a scale or gravity is
wrong by more than the tolerances of a data sheet.

Wide priors hide a fault: positions that are 1.6 % too small are lengths that differ by 14 mm each.
The poses are fitted twice more, with the noise of the first fit: with wide priors of places, which
find the least errors, and with the tolerances of `DATASHEET`. What the objective of the second fit
is larger by has a single reason where one candidate explains most of it. A candidate is a number
whose value in the file is wrong, a scale, or gravity: see
`flexgen.identification.estimator.score`.

Masses and centers of mass, whose loads multiply the compliances, are too far for a step: those
that may explain errors are fitted anew, with wide priors of their own.

A mass, a center of mass and a scale also have a limit below which the poses do not show that they
are wrong, since compliances do what they do. It is stated where it is large.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2, norm

from flexgen.base.errors import SolverError
from flexgen.identification.estimator.score import LEAST_TAIL, Limit, Score
from flexgen.identification.poses.fit import Minimum, Poses, fit
from flexgen.identification.poses.parameters import AXES, Priors, Unknown
from flexgen.identification.poses.score_test import (
    FALSE_ALARMS,
    SCALE_OF_POSITIONS,
    Suspect,
    candidates_of,
    is_plausible,
    test_of,
)
from flexgen.identification.poses.tree import Tree

# Of a robot that is as its data sheet says; a center of mass as a part of the size of its body.
DATASHEET = Priors(position=0.002, rotation=0.003, zero=0.01, mass=0.07, tracker=0.005)
CENTER = 0.07
SMALLEST = 0.02  # m: size of a body without inertia
LOOSE = 10.0  # factor of the priors of zeros and places of the fit that finds the least errors
# Part of what the tolerances leave that one reason explains, at least.
SHARE = 0.5
# Loss of the objective over that of the best reason below which another one is as likely: odds of
# one to twenty. Reasons with nearly the same loss do the same to the poses.
AS_GOOD = 6.0
SAME = 0.5
# Errors of a fit over the least ones above which it is at a minimum that says nothing.
ELSEWHERE = 3.0
SURE = 6.0  # standard deviations of a number that the fit holds
OTHER_ROBOT = "the scale of all lengths (as of another robot)"
# Score of a body from which on it is fitted anew; its prior then: a part of the mass, a length
# [m]; and the variance of the errors over that of noise, since bodies explain some of the errors
# of gears that are not linear.
WORTH = 2.0
FREE = {"mass": 0.5, "center": 0.5}
INFLATED = 2.0
# Parts of a mass and of a scale, and distance [m] of a center of mass: limits that are stated.
LONG = 1.0  # m: a center of mass that no poses show
STATED = {"mass": 0.25, "center": 0.1, "scale": 0.01}


@dataclass(frozen=True)
class ToleranceTest:
    """``causes``: the reason that explains most first; ``worse``: names of candidates that explain
    much less than it; ``limits``: faults that the poses hide; ``scale`` [m]: the least errors of
    the poses.
    """

    causes: tuple[Suspect, ...]
    worse: tuple[str, ...]
    limits: tuple[Limit, ...]
    scale: float


@dataclass(frozen=True)
class _Candidate:
    """A score with what it belongs to; ``own``: deviation of the prior that the user gave, 0 of a
    number without one; ``kind``: that of an unknown, ``scale`` or ``lengths``; empty of one that
    is held, and of gravity; ``reach`` [m]: largest step of a center of mass that was fitted anew,
    0 of other candidates.
    """

    suspect: Suspect
    score: Score
    kind: str
    own: float
    reach: float = 0.0

    @property
    def is_plausible(self) -> bool:
        """Whether it is a fault of a file: the user did not expect it, and it can be such."""
        step = float(np.linalg.norm(self.score.step))
        if self.reach and self.kind == "center":
            return self.own < step < self.reach
        held = np.array(self.suspect.held)
        value = np.array(self.suspect.value)
        return step > self.own and is_plausible(self.suspect.name, self.suspect.unit, held, value)


def check_tolerances(
    problem: Poses, found: Minimum, start: np.ndarray, taken: Sequence[str]
) -> ToleranceTest | None:
    """The test of all numbers; None: the poses have no noise, or no equilibrium.

    Parameters
    ----------
    problem : Poses
        Of all free numbers.
    found : Minimum
        Of a fit to the poses.
    start : array (p,)
        Frame, trackers and numbers of the file.
    taken : sequence of str
        Names of numbers that are free, or that the poses do not determine.
    """
    if found.scale <= problem.sharpest:
        return None
    try:
        loose = fit(_again(problem, _loosen(problem.unknowns)), start)
        scale = min(found.scale, loose.scale)
        tight = _again(problem, _tighten(problem.statics.tree, problem.unknowns), scale)
        there = fit(tight, loose.x)
    except SolverError:
        return None
    every = list(_candidates(tight, there, taken, problem.unknowns))
    limit = float(norm.isf(FALSE_ALARMS / 2 / max(len(every), 1)))
    objective = _objective(tight, there.x)
    excess = objective - tight.loss.value(tight.residual(loose.x), scale)
    if excess > limit**2:
        every = [_fit_anew(one, tight, there, loose.x, objective) for one in every]
    causes = _causes(every, limit, excess)
    named = [cause.name for cause in causes]
    limits = tuple(one for one in _limits(every, limit) if one.name not in named)
    best = max((one.score.gain for one in every if one.suspect.name in named), default=0.0)
    worse = tuple(one.suspect.name for one in every if one.score.gain < best - AS_GOOD)
    return ToleranceTest(causes, worse, limits, loose.scale)


def _objective(problem: Poses, x: np.ndarray) -> float:
    return problem.linearize(x).value + problem.prior.value(x)


def _fit_anew(
    one: _Candidate, tight: Poses, found: Minimum, start: np.ndarray, objective: float
) -> _Candidate:
    """A candidate of a body by a fit with a wide prior of its own, where it may be a reason."""
    name = one.suspect.name
    if one.kind not in FREE or (one.score.z < WORTH and not name.startswith("payload.")):
        return one
    wide = FREE[one.kind] * (one.suspect.held[0] if one.kind == "mass" else 1.0)
    own = [u.name == name or u.name.rpartition(".")[0] == name for u in tight.unknowns]
    unknowns = [
        replace(u, sd=wide) if is_own else u for u, is_own in zip(tight.unknowns, own, strict=True)
    ]
    problem = _again(tight, unknowns, tight.fixed_scale)
    try:
        best = min(
            (fit(problem, x) for x in (found.x, start)), key=lambda one: _objective(problem, one.x)
        )
    except SolverError:
        return one
    gain = max(objective - _objective(problem, best.x), 0.0)
    value = best.x[own]
    tail = chi2.sf(gain / INFLATED, len(value)) / 2
    score = replace(
        one.score,
        z=float(norm.isf(max(tail, LEAST_TAIL))),
        gain=gain,
        step=value - np.array(one.suspect.held),
    )
    suspect = replace(one.suspect, z=score.z, value=tuple(value.tolist()))
    return replace(one, score=score, suspect=suspect, reach=_reach(tight))


def _reach(problem: Poses) -> float:
    """Half of the range of the measured positions [m]."""
    return 0.5 * float(np.ptp(problem.measured[problem.valid], axis=0).max())


def _again(problem: Poses, unknowns: Sequence[Unknown], scale: float | None = None) -> Poses:
    measured = np.where(problem.valid[..., None], problem.measured, np.nan)
    robust = problem.robust
    return Poses(
        problem.statics, measured, unknowns, robust, problem.whitening, problem.weights, scale
    )


def _loosen(unknowns: Sequence[Unknown]) -> list[Unknown]:
    places = ("node", "tracker")
    return [replace(u, sd=LOOSE * u.sd) if u.kind in places else u for u in unknowns]


def _tighten(tree: Tree, unknowns: Sequence[Unknown]) -> list[Unknown]:
    return [replace(u, sd=min(u.sd, _tolerance(tree, u))) for u in unknowns]


def _tolerance(tree: Tree, unknown: Unknown) -> float:
    """Standard deviation of a number that a data sheet states."""
    if not unknown.is_stated:
        return np.inf
    if unknown.kind == "node":
        place = DATASHEET.rotation if unknown.unit == "rad" else DATASHEET.position
        return DATASHEET.zero if unknown.name.endswith(".zero") else place
    if unknown.kind == "tracker":
        return DATASHEET.tracker
    if unknown.kind == "mass":
        return DATASHEET.mass * unknown.start
    if unknown.kind == "center":
        body = tree.bodies[unknown.at[0]][2]
        size = np.sqrt(max(float(np.max(body.inertia)), 0.0) / max(body.mass, 1e-300))
        return CENTER * max(float(size), SMALLEST)
    return np.inf


def _candidates(
    problem: Poses, found: Minimum, taken: Sequence[str], own: Sequence[Unknown]
) -> Iterator[_Candidate]:
    """Scores of all numbers whose value in the file may be wrong, of scales and gravity."""
    test, here = test_of(problem, found)
    root = np.sqrt(np.diag(problem.prior.information))
    groups: dict[str, list[int]] = {}
    for k, u in enumerate(problem.unknowns):
        if u.is_stated and u.kind not in ("compliance", "tracker"):
            name = u.name.rpartition(".")[0] if u.kind == "center" else u.name
            groups.setdefault(name, []).append(k)
    nothing = np.zeros((len(here.gaps), 1))
    for name, at in groups.items():
        # the file's value would be another one: the prior moves with it
        priors = np.zeros((len(root), len(at)))
        priors[at, range(len(at))] = -root[at]
        score = test.of(np.repeat(nothing, len(at), axis=1), priors)
        first = problem.unknowns[at[0]]
        held = np.array([problem.unknowns[k].start for k in at])
        yield _candidate(name, held, first.unit, score, first.kind, own[at[0]].sd)
    lengths = _lengths(problem)
    if len(np.flatnonzero(lengths)) > 1:
        score = test.of(nothing, (-root * lengths)[:, None])
        yield _candidate(OTHER_ROBOT, np.ones(1), "", score, "lengths", 0.0)
    numbers = problem.numbers(found.x)
    for one in candidates_of(problem.statics, numbers, found.rest, taken):
        score = test.of(here.roots[:, None] * problem.whiten_columns(one.columns))
        kind = "scale" if one.name == SCALE_OF_POSITIONS else ""
        yield _candidate(one.name, one.value, one.unit, score, kind, 0.0)


def _lengths(problem: Poses) -> np.ndarray:
    """Change (p,) of the free numbers where all lengths of the file are larger by a part."""
    elements = {element.name: element for element in problem.statics.model.elements}
    out = np.zeros(len(problem.unknowns))
    for k, u in enumerate(problem.unknowns):
        name, _, axis = u.name.rpartition(".")
        if u.kind == "node" and u.is_stated and name in elements and axis in AXES:
            origin = elements[name].origin
            out[k] = (np.array(origin.rotation).T @ np.array(origin.position))[AXES.index(axis)]
    return out


def _candidate(
    name: str, held: np.ndarray, unit: str, score: Score | None, kind: str, own: float
) -> _Candidate:
    if score is None:
        nothing = np.zeros(len(held))
        score = Score(0.0, nothing, nothing + np.inf, 0.0)
    value = held + score.step
    suspect = Suspect(name, score.z, tuple(held.tolist()), tuple(value.tolist()), unit, 0.0, True)
    return _Candidate(suspect, score, kind, own)


def _causes(every: Sequence[_Candidate], limit: float, excess: float) -> tuple[Suspect, ...]:
    """The reasons that explain most of what the tolerances leave, the best first.

    Of numbers that the fit holds, which `score_test` tests too, those alone that are sure.
    """
    above = []
    for one in sorted(every, key=lambda one: -one.score.gain):
        share = one.score.gain / max(excess, 1e-300)
        if one.score.z <= limit or share <= SHARE:
            continue
        if one.is_plausible:
            same = tuple(
                other.suspect.name
                for other in every
                if abs(other.score.gain - one.score.gain) < SAME and other is not one
            )
            suspect = replace(one.suspect, share=min(share, 1.0), same=same)
            is_sure = bool(one.kind) or one.score.z > SURE
            above.append((one.score.gain, is_sure, suspect))
    best = above[0][0] if above else 0.0
    return tuple(suspect for gain, is_sure, suspect in above if is_sure and gain > best - AS_GOOD)


def _limits(every: Sequence[_Candidate], limit: float) -> Iterator[Limit]:
    """Faults of the payload and of the scale that the poses hide, where they are large."""
    for one in every:
        payload = one.suspect.name.startswith("payload.")
        if one.kind != "scale" and not (payload and one.kind in STATED):
            continue
        size = limit * float(one.score.sd.max())
        unit = "m" if one.kind == "center" else one.suspect.unit
        part = STATED[one.kind]
        if one.kind == "center" and size > LONG:
            size = np.inf
        most = part * abs(one.suspect.held[0]) if one.kind == "mass" else part
        if size > most:
            yield Limit(one.suspect.name, size, unit)
