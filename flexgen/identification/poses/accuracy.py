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

Source: D. M. Bates and D. G. Watts, Nonlinear Regression Analysis and Its Applications, 1988,
ch. 7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.base.errors import SolverError
from flexgen.identification.estimator.covariance import block_covariance
from flexgen.identification.estimator.minimize import bend_of
from flexgen.identification.estimator.problem import Linearization
from flexgen.identification.poses.fit import Minimum, Poses

DRAWS = 20  # of v: the width of w to some ten percent
FLAT = 1e-12  # part of the curvature along a number that directions without any information get
ROUNDING = 1e-4  # of the variances of normalized numbers, far above that of the inverse


@dataclass(frozen=True)
class Accuracy:
    """Of the numbers of a minimum.

    ``covariance`` (p, p), zero for numbers at a bound; ``pull`` (p,): where these would be without
    it, in standard deviations from it.
    """

    covariance: np.ndarray
    pull: np.ndarray


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
    covariance[inner] = first + _of_bends(problem, here, free, inverse, first)
    everything = np.linalg.inv(matrix)
    sd = np.sqrt(np.maximum(np.diag(everything), 1e-300))
    return Accuracy(covariance, np.where(free, 0.0, -everything @ slope / sd))


def _of_bends(
    problem: Poses,
    here: Linearization,
    free: np.ndarray,
    inverse: np.ndarray,
    covariance: np.ndarray,
) -> np.ndarray:
    """``E[w w']`` of the free numbers, from draws with their covariance to first order;
    ``inverse``: H^-1.
    """
    sd = np.sqrt(np.diag(covariance))
    variances, axes = np.linalg.eigh(covariance / np.outer(sd, sd))
    # roots; smooth at zero, where rounding has any sign
    widths = variances / np.sqrt(np.abs(variances) + ROUNDING)
    root = sd[:, None] * (axes * widths) @ axes.T
    bends = []
    for unit in np.random.default_rng(0).normal(size=(DRAWS, len(sd))):
        step = np.zeros(len(free))
        step[free] = root @ unit
        try:
            bends.append(bend_of(problem, here, step)[free])
        except SolverError:
            continue  # so far that the springs do not carry the arm
    if not bends:
        return np.zeros(covariance.shape)
    w = -0.5 * inverse @ np.transpose(bends)
    return np.asarray(w @ w.T / w.shape[1])
