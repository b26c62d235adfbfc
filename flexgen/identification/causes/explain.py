"""Explain: which single fault of the model or of the record explains the misfit of a fit.

A hypothesis adds one number, or two, to a fit: a mass, a delay, the scale of a channel, a spring.
The decrease of the cost is predicted by a score step from the residuals r at the fit, their
derivatives J in its parameters, and j in the number of the hypothesis,

    gain = (a^T r)^2 / a^T a,    a = j - J J^+ j

Faults that are too large for a step (signs, exchanged channels, degrees for radians) are compared
by the responses of the model file. The best ones are fitted, together with all parameters:

    share = (cost - cost with the hypothesis) / (cost - degrees of freedom)

A fit whose residuals noise explains is tested for hidden causes as well: a small fault is
significant in the gain of its own hypothesis long before it is in the cost, which contains the
noise of all data.

Source: C. R. Rao, Proc. Cambridge Philosophical Society 44, 1948 (score test).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.identification.causes.hypotheses import (
    Change,
    Changed,
    Number,
    changes_of,
    extend,
    numbers_of,
)
from flexgen.identification.estimator.minimize import Minimum, Search, minimize
from flexgen.identification.estimator.problem import Prior, Problem, as_real, normal, stack
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.local_model import with_sizes
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.residuals import Residuals
from flexgen.identification.rigid.missing_springs import PEDESTAL, additions, base_springs
from flexgen.model.elements import Dof, RobotModel

REFITS = 3  # of the hypotheses with the largest score steps, and as many of gross ones
LEAST_SHARE = 0.7  # of the misfit that a cause must explain to be named
EXPLAINED = 0.95  # a gross fault that explains so much is the cause
ALSO = 0.05  # a cause that explains so much less than the best one is named too
STEP = 1e-4  # of differences in the logarithm of the factor of a change
LARGEST_FACTOR = 3.0  # its logarithm
# decrease of chi-square by a hidden cause; the best of 100 by chance: 15 in one of 100 fits
SEEN = 30.0
NEAR = 0.03  # of the root of the cost, where it is that of the noise
ALIKE = 0.3  # relative difference of responses up to which they are alike


@dataclass(frozen=True)
class Cause:
    """A possible cause of a misfit: words, the part of the misfit that it explains, and the size
    of the fault.
    """

    words: str
    share: float
    size: float

    def __str__(self) -> str:
        return f"{self.words} explains {100 * self.share:.0f} % of the misfit"


@dataclass(frozen=True)
class Spring:
    """A missing spring without motor: the coordinate, and the model that has it with some
    stiffness; ``inertia``: name of the inertia of a pedestal that is not known, or empty.
    """

    name: str
    model: RobotModel
    inertia: str = ""


Hypothesis = Number | Changed | Spring


def explain(residuals: Residuals, x: np.ndarray) -> tuple[Cause, ...]:
    """The causes that explain most of the misfit of a fit, the best first.

    Parameters
    ----------
    residuals : Residuals
        With the weights of the noise alone.
    x : array (n,)
        The parameters of the fit.

    Returns
    -------
    tuple of Cause
        The best one, if it explains `LEAST_SHARE` of the misfit, and those that explain nearly as
        much.
    """
    best = _search(residuals, x)
    misfit = best.cost - (residuals.count - len(residuals.vector) / 2)
    if misfit <= 0:
        return ()
    changes = list(changes_of(residuals.data))

    def share(hypotheses: Sequence[Hypothesis]) -> list[Cause]:
        return [
            replace(cause, share=min(cause.share / misfit, 1.0))
            for cause in _refits(residuals, hypotheses, best)
        ]

    causes = share(_find_gross(residuals, changes))
    if not any(cause.share > EXPLAINED for cause in causes):
        causes += share(_find_small(residuals, changes, best.x))
        # a step says little of a resonance that is missing
        if all(cause.share < EXPLAINED for cause in causes):
            causes += share(_every_spring(residuals))
    return _best(causes)


def hidden_causes(residuals: Residuals, x: np.ndarray) -> tuple[Cause, ...]:
    """Causes that decrease chi-square by more than noise does, of a fit whose cost is that of the
    noise.

    Shares are those of the largest decrease.
    """
    found = _find_small(residuals, list(changes_of(residuals.data)), x, SEEN / 2)
    if not found:
        return ()
    causes = [
        each for each in _refits(residuals, found, _search(residuals, x)) if 2 * each.share > SEEN
    ]
    most = max((cause.share for cause in causes), default=1.0)
    return _best([replace(cause, share=cause.share / most) for cause in causes])


def _best(causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """The best one, and those that explain nearly as much."""
    best_of = {cause.words: cause for cause in sorted(causes, key=lambda cause: cause.share)}
    ordered = sorted(best_of.values(), key=lambda cause: -cause.share)
    return tuple(
        cause for cause in ordered if cause.share >= max(LEAST_SHARE, ordered[0].share - ALSO)
    )


def _refits(residuals: Residuals, hypotheses: Sequence[Hypothesis], best: Minimum) -> list[Cause]:
    """The decrease of the cost by each hypothesis, with all parameters fitted, as a share."""
    out = []
    for hypothesis in hypotheses:
        try:
            cost, words, size = refit(residuals, hypothesis, best.x)
        except (SolverError, ArgumentError, np.linalg.LinAlgError):
            continue  # no equilibrium, or a number that this model cannot have
        out.append(Cause(words, max(best.cost - cost, 0.0), size))
    return out


def _find_gross(residuals: Residuals, changes: Sequence[Changed]) -> list[Hypothesis]:
    """The gross faults whose change brings the responses nearest to those of the model file."""
    model = residuals.response(residuals.vector.start).G
    data = [
        (residuals.data if h is None else h.change(residuals.data, 1.0)) for h in (None, *changes)
    ]
    before, *after = (_distance(residuals, each, model) for each in data)
    rated = sorted(
        (distance, k) for k, distance in enumerate(after) if changes[k].gross and distance < before
    )
    return [changes[k] for _, k in rated[:REFITS]]


def _find_small(
    residuals: Residuals, changes: Sequence[Changed], x: np.ndarray, least: float = 0.0
) -> list[Hypothesis]:
    """The hypotheses with the largest score steps at x, above the ``least``."""
    r, J = as_real(*residuals.weight(x, True))
    basis = np.linalg.qr(J)[0]
    columns: list[tuple[Hypothesis, np.ndarray]] = [
        *columns_of_numbers(residuals, x),
        *columns_of_springs(residuals, x, r),
        *((h, stack(_slope(residuals, h.change, x, 0.0))) for h in changes if not h.gross),
    ]
    rated: dict[object, tuple[float, Hypothesis]] = {}
    for hypothesis, column in columns:
        gain = score(basis, r, column)
        key = hypothesis.name if isinstance(hypothesis, Spring) else hypothesis
        if key not in rated or rated[key][0] < gain:  # of one spring the best stiffness
            rated[key] = gain, hypothesis
    large = [pair for pair in rated.values() if pair[0] >= least]
    return [hypothesis for _, hypothesis in sorted(large, key=lambda pair: -pair[0])[:REFITS]]


def _every_spring(residuals: Residuals) -> list[Hypothesis]:
    """All missing springs, of two stiffnesses: searches from stiffer ones can end where there is
    no spring.
    """
    pose = residuals.data.poses[:1]
    return [
        Spring(dof.name, model, inertia)
        for dof, made, inertia in springs_of(residuals.vector.model)
        for model in with_sizes(made, dof.name, pose)[:2]
    ]


def springs_of(model: RobotModel) -> list[tuple[Dof, RobotModel, str]]:
    """Springs that the model lacks, between bodies and below its base: coordinate, model, and the
    inertia of the pedestal that is not known.
    """
    between = [(dof, made, "") for dof, made in additions(model)]
    below = [
        (dof, made, f"{PEDESTAL}.inertia_{2 * dof.name[-1]}") for dof, made in base_springs(model)
    ]
    return [*between, *below]


def score(basis: np.ndarray, r: np.ndarray, column: np.ndarray) -> float:
    """Decrease of ``|r|^2`` by the best step along a column and the columns of an orthonormal
    basis.
    """
    away = column - basis @ (basis.T @ column)
    size = float(away @ away)
    return float(away @ r) ** 2 / size if size > 1e-12 * float(column @ column) else 0.0


def refit(residuals: Residuals, hypothesis: Hypothesis, x: np.ndarray) -> tuple[float, str, float]:
    """The cost with a hypothesis, all parameters fitted; words for the fault, and its size."""
    if isinstance(hypothesis, Changed):
        cost, factor = _refit_change(residuals, hypothesis, x)
        return cost, hypothesis.say(factor), factor
    if isinstance(hypothesis, Spring):
        names = (f"{hypothesis.name}.stiffness", f"{hypothesis.name}.damping")
        more = (hypothesis.inertia,) if hypothesis.inertia else ()
        # below a base that gives way all parameters were misled
        begin = residuals.vector.start if more else x
        cost, stiffness = _refit_names(residuals, (*names, *more), begin, hypothesis.model)
        if more:
            words = f"a spring below the base about its axis {hypothesis.name[-1]}"
            return cost, f"{words} of {stiffness:.2g} N m/rad", stiffness
        return cost, f"a missing spring {hypothesis.name} of {stiffness:.2g} N m/rad", stiffness
    cost, value = _refit_names(residuals, hypothesis.names, x)
    size = value - hypothesis.stated
    return cost, hypothesis.say(size), size


def _refit_names(
    residuals: Residuals, names: tuple[str, ...], x: np.ndarray, model: RobotModel | None = None
) -> tuple[float, float]:
    """The cost with more numbers free, and the first of them: over that of the file, where it is
    positive there.
    """
    vector = extend(residuals.vector, names, model, residuals.data.delay_s)
    more = residuals.of(vector)
    fit = _search(more, _at(vector, residuals.vector, x))
    unknown = vector.unknowns[vector.names.index(names[0])]
    in_file = unknown.parameter.value if unknown.scale == "log" and model is None else 0.0
    return fit.cost, vector.named(fit.x)[names[0]] / (in_file or 1.0)


def _refit_change(residuals: Residuals, hypothesis: Changed, x: np.ndarray) -> tuple[float, float]:
    """The cost with changed responses, and the factor of the change."""
    data = residuals.data
    vector = residuals.vector
    if hypothesis.gross:  # from the start values: the fit was misled
        return _search(residuals.on(hypothesis.change(data, 1.0)), vector.start).cost, 1.0

    def weight(z: np.ndarray, derivatives: bool) -> tuple[np.ndarray, np.ndarray | None]:
        r, J = residuals.on(hypothesis.change(data, float(np.exp(z[-1])))).weight(
            z[:-1], derivatives
        )
        if J is None:
            return r, None
        slope = _slope(residuals, hypothesis.change, z[:-1], float(z[-1]))
        return r, np.concatenate([J, slope[..., None]], axis=-1)

    lower, upper = vector.bounds
    problem = Problem.of_sums(
        lambda z: normal(*weight(z, True)),
        lambda z: float((np.abs(weight(z, False)[0]) ** 2).sum()),
        Prior.of_sd(np.append(vector.start, 0.0), np.append(vector.prior_sd, LARGEST_FACTOR)),
        (np.append(lower, -LARGEST_FACTOR), np.append(upper, LARGEST_FACTOR)),
    )
    fit = minimize(problem, np.append(x, 0.0), Search(_distance_to_end(residuals)))
    return fit.cost, float(np.exp(fit.x[-1]))


def columns_of_numbers(
    residuals: Residuals, x: np.ndarray
) -> Iterator[tuple[Hypothesis, np.ndarray]]:
    """Derivatives of the residuals in the numbers that are not free; those without ties by one
    call.
    """
    late = residuals.data.delay_s
    numbers = numbers_of(residuals.vector, late)
    single = [number for number in numbers if len(number.names) == 1]
    for group in (single, *([number] for number in numbers if len(number.names) > 1)):
        with suppress(SolverError):  # the searches went where an equilibrium is not found anew
            names = tuple(name for number in group for name in number.names)
            model = residuals.vector.model if group is single else None
            vector = extend(residuals.vector, names, model, late)
            J = as_real(*residuals.of(vector).weight(_at(vector, residuals.vector, x), True))[1]
            yield from ((number, J[:, vector.names.index(number.names[0])]) for number in group)


def _at(vector: ParameterVector, old: ParameterVector, x: np.ndarray) -> np.ndarray:
    """The values x of an old vector in one that has more, which begin at their start."""
    known = dict(zip(old.names, x, strict=True))
    return np.array(
        [known.get(name, first) for name, first in zip(vector.names, vector.start, strict=True)]
    )


def columns_of_springs(
    residuals: Residuals, x: np.ndarray, r: np.ndarray
) -> Iterator[tuple[Hypothesis, np.ndarray]]:
    """Differences of the residuals by springs that the model does not have, of several
    stiffnesses.
    """
    old = residuals.vector
    for dof, changed, inertia in springs_of(old.model):
        for model in with_sizes(changed, dof.name, residuals.data.poses[:1]):
            more = residuals.of(extend(old, (), model))
            try:
                moved = more.weight(x, False)[0]
            except SolverError:  # so soft a spring does not hold the arm
                continue
            yield Spring(dof.name, model, inertia), stack(moved) - r


def _slope(residuals: Residuals, change: Change, x: np.ndarray, at: float) -> np.ndarray:
    """Derivative of the residuals in the logarithm of the factor of a change."""
    up, down = (
        residuals.on(change(residuals.data, float(np.exp(at + h)))).weight(x, False)[0]
        for h in (STEP, -STEP)
    )
    return np.asarray((up - down) / (2 * STEP))


def _search(residuals: Residuals, start: np.ndarray) -> Minimum:
    """The fit, ended where the cost is within a small part of itself from its minimum: the share
    needs no higher accuracy.
    """
    return minimize(residuals.problem, start, Search(_distance_to_end(residuals)))


def _distance_to_end(residuals: Residuals) -> float:
    """Distance to the minimum in standard deviations at which the cost per degree of freedom is
    near enough.
    """
    return NEAR * float(np.sqrt(residuals.count))


def _distance(residuals: Residuals, data: Frf, G: np.ndarray) -> float:
    """Mean difference of responses from a model's, on a scale on which all large differences count
    alike.
    """
    away = np.abs(G - data.G) ** 2 / (residuals.on(data).variance + ALIKE**2 * np.abs(data.G) ** 2)
    return float(np.log1p(away).mean())
