"""Standard deviations of a calibration: from the scatter of the poses, and from the curvature of
the positions.

    x_true - x = v + w(v),      v ~ N(0, C),      w = -1/2 H^-1 J' W y''[v, v],
    covariance = C + E[w w']

C: the covariance from blocks, see `flexgen.identification.estimator.covariance`. A block is a
pose: the errors of one may depend on each other, since its trackers share what deflects below
them.

Joint zeros and placements that the poses do not separate keep the width of their priors, and move
together along an arc: a length across it changes with the square of their angle, by far more than
the noise of the measurement tells.

Numbers that the poses do not determine keep the value of the model file (`find_undetermined`),
with the standard deviation of their prior; `with_kept` adds what an error of theirs does to the
others.

Source: D. M. Bates and D. G. Watts, Nonlinear Regression Analysis and Its Applications, 1988,
ch. 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexgen.base.errors import SolverError
from flexgen.identification.estimator.covariance import block_covariance
from flexgen.identification.estimator.minimize import bend_of
from flexgen.identification.estimator.problem import Linearization
from flexgen.identification.poses.fit import Minimum, Poses
from flexgen.identification.poses.parameters import Unknown
from flexgen.identification.poses.statics import Near

# Standard deviation of a direction over that of its prior above which the poses say too little of
# it: three quarters of the variance of the prior are removed at it.
KEPT = 0.5
# Standard deviations by which an estimate differs from a right value of the file in 5 % of fits.
CONTRADICTED = 1.96
DRAWS = 20  # of v: the width of w to some ten percent
FLAT = 1e-12  # part of the curvature along a number that directions without any information get
ROUNDING = 1e-4  # of the variances of normalized numbers, far above that of the inverse


@dataclass(frozen=True)
class Accuracy:
    """Of the numbers of a minimum.

    ``covariance`` (p, p), zero for numbers at a bound; ``first`` (p, p): the same to first order;
    ``pull`` (p,): where these would be without it, in standard deviations from it.
    """

    covariance: np.ndarray
    first: np.ndarray
    pull: np.ndarray


def find_undetermined(
    unknowns: Sequence[Unknown], x: np.ndarray, covariance: np.ndarray
) -> tuple[int, ...]:
    """Indices of the numbers that keep the value of the model file.

    Of a direction that the poses do not determine one number is kept, the one with the largest
    standard deviation over that of its prior, unless the poses contradict the file there by more
    than `CONTRADICTED`. The others follow it: given this number, z becomes ``z - C_i z_i / C_ii``
    and the covariance ``C - C_i C_i' / C_ii``. Repeated until no deviation is above `KEPT`.

    Parameters
    ----------
    unknowns : sequence of Unknown (p,)
    x : array (p,)
        Their estimates.
    covariance : array (p, p)
        Of the estimates, with the priors.
    """
    stated = [k for k, u in enumerate(unknowns) if u.is_stated]
    sd = np.array([unknowns[k].sd for k in stated])
    z = (x[stated] - np.array([unknowns[k].start for k in stated])) / sd
    C = covariance[np.ix_(stated, stated)] / np.outer(sd, sd)
    is_open = np.ones(len(stated), bool)
    kept = []
    while is_open.any():
        variances = np.where(is_open, np.diag(C), 0.0)
        i = int(np.argmax(variances))
        if variances[i] <= KEPT**2:
            break
        is_open[i] = False
        # variance of z where the file is right: of z = (1 - C) data + C prior, without the prior
        if z[i] ** 2 > CONTRADICTED**2 * C[i, i] * max(1.0 - C[i, i], 0.0) and C[i, i] < 1.0:
            continue
        kept.append(stated[i])
        z = z - C[:, i] * (z[i] / C[i, i])
        C = C - np.outer(C[:, i], C[i]) / C[i, i]
        C[i] = 0.0
        C[:, i] = 0.0
    return tuple(sorted(kept))


def with_kept(
    problem: Poses, x: np.ndarray, near: Near, free: np.ndarray, first: np.ndarray
) -> np.ndarray:
    """Covariance (p, p) of all numbers where some keep the value of the model file.

    ``C_D + K P K' + E[w w']`` of those that are free, with ``K = -H_DD^-1 H_DF``, what an error of
    the kept numbers moves them by, and P, the variances of the priors of these.

    Parameters
    ----------
    problem : Poses
        Of all numbers.
    x : array (p,)
        The result, with the values of the file of those that are kept.
    near : Near
        Of the robot at rest with these numbers.
    free : array of bool (p,)
    first : array (d, d)
        C_D, of the free numbers where the others are known, to first order.

    Source: S. F. Schmidt, Application of state-space methods to navigation problems, Advances in
    Control Systems 3, 1966 (consider parameters).
    """
    problem.near = near
    here = problem.linearize(x)
    H = here.matrix + problem.prior.information
    moving = np.zeros(len(x), bool)
    moving[np.flatnonzero(free)[np.diag(first) > 0.0]] = True  # not held by a bound
    inner = H[np.ix_(moving, moving)]
    inner = inner + FLAT * np.diag(np.diag(inner))
    K = np.zeros((len(x), int((~free).sum())))
    K[moving] = -np.linalg.solve(inner, H[np.ix_(moving, ~free)])
    K[~free] = np.eye(K.shape[1])
    variances = np.array([u.sd**2 for u in problem.unknowns])[~free]
    out = (K * variances) @ K.T
    out[np.ix_(free, free)] += first
    out[np.ix_(moving, moving)] += _of_bends(problem, here, moving, np.linalg.inv(inner), out)
    return np.asarray(out)


def accuracy_of(problem: Poses, found: Minimum) -> Accuracy:
    """The covariance to second order at a minimum."""
    problem.near = found.rest.near
    here = problem.linearize(found.x)
    slope = here.slope + problem.prior.slope(found.x)
    matrix = here.matrix + problem.prior.information
    # also along numbers without any information
    matrix = matrix + FLAT * np.diag(np.diag(matrix))
    free = (found.x > problem.lower) | (slope < 0)
    inner = np.ix_(free, free)
    inverse = np.linalg.inv(matrix[inner])
    poses = len(problem.measured)
    rows = here.rows[:, free].reshape(poses, -1, int(free.sum()))
    gaps = here.gaps.reshape(poses, -1)
    first = block_covariance(rows, gaps, range(poses), problem.prior.information[inner])
    covariance = np.zeros(matrix.shape)
    covariance[inner] = first
    to_first = covariance.copy()
    covariance[inner] += _of_bends(problem, here, free, inverse, to_first)
    everything = np.linalg.inv(matrix)
    sd = np.sqrt(np.maximum(np.diag(everything), 1e-300))
    return Accuracy(covariance, to_first, np.where(free, 0.0, -everything @ slope / sd))


def _of_bends(
    problem: Poses,
    here: Linearization,
    free: np.ndarray,
    inverse: np.ndarray,
    covariance: np.ndarray,
) -> np.ndarray:
    """``E[w w']`` of the free numbers, from draws of all that have a covariance (p, p), to first
    order; ``inverse``: H^-1 of the free.
    """
    drawn = np.diag(covariance) > 0.0
    sd = np.sqrt(np.diag(covariance)[drawn])
    own = covariance[np.ix_(drawn, drawn)]
    variances, axes = np.linalg.eigh(own / np.outer(sd, sd))
    # roots; smooth at zero, where rounding has any sign
    widths = variances / np.sqrt(np.abs(variances) + ROUNDING)
    root = sd[:, None] * (axes * widths) @ axes.T
    bends = []
    for unit in np.random.default_rng(0).normal(size=(DRAWS, len(sd))):
        step = np.zeros(len(free))
        step[drawn] = root @ unit
        try:
            bends.append(bend_of(problem, here, step)[free])
        except SolverError:
            continue  # so far that the springs do not carry the arm
    if not bends:
        return np.zeros(inverse.shape)
    w = -0.5 * inverse @ np.transpose(bends)
    return np.asarray(w @ w.T / w.shape[1])
