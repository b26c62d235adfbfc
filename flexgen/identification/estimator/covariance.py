"""Covariance of an estimate from blocks of its residuals: the errors of neighboring samples are
alike.

The normal equations with the weighted Jacobian J, the residuals r and the information P of a prior
give, for the blocks b,

    H = (J'J + P)^-1,      c_b = (J'J + P - J_b'J_b)^-1 J_b' r_b,
    covariance = sum_b c_b c_b' + H P H

c_b: change of the estimate when block b is left out (jackknife). It is H g_b with the scores
``g_b = J_b' r`` for the residuals r of a fit without the block, since a fit makes residuals small.
Along the principal axes of J'J + P the changes are larger by Student's quantile over the normal
one, such that 1.96 deviations are 95 % also where few blocks have the information on an axis. A
block that determines a number alone has no errors in any fit: its residuals count with the unit
variance of their weights.

Source: B. Efron, The Jackknife, the Bootstrap and Other Resampling Plans, 1982, ch. 3; R. Cook and
S. Weisberg, Residuals and Influence in Regression, 1982, ch. 3 (fits without samples); R. Bell and
D. McCaffrey, Survey Methodology 28(2), 2002 (degrees of freedom of few blocks).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import ndtri, stdtrit

# Part of the information of a block that other blocks have too, at least.
LEAST = 1e-9
# Part of the information of a block in a direction that others have too, below which the block
# determines it alone.
ALONE = 1e-6
# Eigenvalues of the information over the largest one, below which they are rounding.
ROUNDING = 1e-14
# Quantile of an interval of 95 %.
QUANTILE = 0.975


@dataclass(frozen=True)
class Blocks:
    """Normal equations of each block: ``matrices`` (B, n, n), J_b'J_b, and ``scores`` (B, n), J_b'
    r_b.
    """

    matrices: np.ndarray
    scores: np.ndarray

    @classmethod
    def of(cls, J: np.ndarray, r: np.ndarray, starts: Sequence[int] | np.ndarray) -> Blocks:
        """Of a Jacobian (N, ..., n) and residuals (N, ...), cut along the first axis at
        ``starts``, 0 first.
        """
        n = J.shape[-1]
        bounds = [*np.asarray(starts).tolist(), len(J)]
        matrices = np.zeros((len(bounds) - 1, n, n))
        scores = np.zeros((len(bounds) - 1, n))
        for b, (first, last) in enumerate(pairwise(bounds)):
            rows = J[first:last].reshape(-1, n)
            matrices[b] = rows.T @ rows
            scores[b] = rows.T @ r[first:last].ravel()
        return cls(matrices, scores)

    @classmethod
    def of_outputs(
        cls, X: Sequence[np.ndarray], error: np.ndarray, weight: np.ndarray, block: int
    ) -> Blocks:
        """Of regressors (N, n) of each output, errors (N, outputs) and weights (outputs,),
        ``block`` samples each.
        """
        starts = range(0, len(error), block)
        each = [cls.of(x * w, e * w, starts) for x, e, w in zip(X, error.T, weight, strict=True)]
        matrices = np.sum([one.matrices for one in each], axis=0)
        return cls(matrices, np.sum([one.scores for one in each], axis=0))

    def over(self, size: np.ndarray) -> Blocks:
        """For numbers in units (n,)."""
        return Blocks(self.matrices * np.outer(size, size), self.scores * size)


def block_covariance(
    J: np.ndarray,
    r: np.ndarray,
    starts: Sequence[int] | np.ndarray,
    prior: np.ndarray,
    by_axis: bool = True,
) -> np.ndarray:
    """Covariance (n, n) of an estimate.

    Parameters
    ----------
    J : array (N, ..., n)
        Derivatives of the weighted residuals.
    r : array (N, ...)
        Residuals, weighted such that their variance is 1.
    starts : sequence of int
        First rows of the blocks; the first one is 0.
    prior : array (n, n)
        Information of the prior.
    by_axis : bool
        Degrees of freedom of Student's quantiles are those of each principal axis; else the number
        of blocks, where priors make the axes of few blocks wide already.

    Examples
    --------
    >>> import numpy as np
    >>> from flexgen.identification.estimator.covariance import block_covariance
    >>> r = np.random.default_rng(0).normal(size=4000)  # of the mean of 4000 numbers
    >>> sd = np.sqrt(
    ...     block_covariance(
    ...         np.ones((4000, 1)), r - r.mean(), range(0, 4000, 20), np.zeros((1, 1))
    ...     )
    ... )
    >>> f"{sd.item():.4f}, expected {4000**-0.5:.4f}"
    '0.0160, expected 0.0158'
    """
    return covariance_of(Blocks.of(J, r, starts), prior, by_axis)


def covariance_of(
    blocks: Blocks, prior: np.ndarray, by_axis: bool = True, corrected: bool = False
) -> np.ndarray:
    """Covariance (n, n) of an estimate with these normal equations; see `block_covariance`.

    Numbers without any information have none: zero. ``corrected``: the matrices are not those of
    residuals with unit variance, and no block counts as one that determines a number alone.
    """
    whole = blocks.matrices.sum(axis=0) + prior
    known = np.diag(whole) > 0
    inner = np.ix_(known, known)
    scale = np.sqrt(np.diag(whole)[known])
    sizes = np.outer(scale, scale)
    A = blocks.matrices[:, known][:, :, known] / sizes
    P = prior[inner] / sizes
    total = whole[inner] / sizes
    H = np.linalg.pinv(total, hermitian=True)
    unit = np.eye(len(scale))
    scores = (blocks.scores[:, known] / scale)[..., None]
    left = (1 + LEAST) * unit - A @ H
    alone = np.zeros(len(A), bool) if corrected else _determine_alone(left, A, total)
    scores = np.linalg.solve(left[~alone], scores[~alone])[..., 0]
    axes = np.linalg.eigh(total)[1]
    shares = ((A @ axes) * axes).sum(axis=1) if by_axis else np.ones((len(A), len(scale)))
    wider = (axes * student(shares)) @ axes.T
    spread = wider.T @ (scores.T @ scores + A[alone].sum(axis=0)) @ wider
    out = np.zeros(whole.shape)
    out[inner] = H @ (spread + P) @ H / sizes
    return out


def _determine_alone(left: np.ndarray, A: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Mask (B,) of the blocks that alone determine some direction of the n parameters.

    Without such a block the fit is singular in this direction, so the block cannot be left out
    for the jackknife. A block b is one if an eigenvalue of ``A_b`` relative to ``total``, the
    share of the block in the information on a direction, exceeds 1 - `ALONE`. Directions on which
    nothing has information (`ROUNDING`) do not count.

    Parameters
    ----------
    left : array (B, n, n)
        ``1 - A_b H`` with ``H = total^-1``: its eigenvalues are the shares of all other blocks
        and of the prior.
    A : array (B, n, n)
        Information ``J_b' J_b`` of each block.
    total : array (n, n)
        Information of all blocks and of the prior.
    """
    # The eigenvalues of `left` are at most 1, so their product, the determinant, is a lower bound
    # of the least one. Few blocks, if any, need the eigenvalues below.
    out = np.linalg.slogdet(left)[1] < np.log(ALONE)
    if not out.any():
        return out
    values, axes = np.linalg.eigh(total)
    known = values > ROUNDING * values[-1]
    root = axes[:, known] / np.sqrt(values[known])  # root' total root = 1
    largest_shares = np.linalg.eigvalsh(root.T @ A[out] @ root)[:, -1]
    out[out] = largest_shares > 1.0 - ALONE
    return out


def student(shares: np.ndarray) -> np.ndarray:
    """Student's 97.5 % quantiles over the normal one (n,), for numbers with the information
    ``shares`` (blocks, n).

    Degrees of freedom (sum_b s_b)^2 / sum_b s_b^2: a deviation from few blocks is uncertain
    itself.
    """
    squares = (shares**2).sum(axis=0)
    freedom = shares.sum(axis=0) ** 2 / np.where(squares > 0, squares, 1.0)
    quantiles: np.ndarray = stdtrit(np.maximum(freedom, 1.0), QUANTILE) / ndtri(QUANTILE)
    return quantiles
