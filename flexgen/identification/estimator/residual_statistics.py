"""What the residuals of a fit say: covariance from blocks of them, their size, and whether they
are white.

The normal equations of all numbers theta with the regressors X, the weights W and the residuals
e_b of blocks b give

    H = (X' W X + P)^-1,      g_b = (1 - X_b' W X_b H)^-1 X_b' W e_b,
    covariance = H (sum_b g_b g_b' + P) H

with the information P of a prior: errors of neighboring samples are alike, and so blocks are
counted, not samples. The scores g_b are those with the residuals of a fit without the block, since
the fit makes residuals small. Along the principal axes of H they are larger by Student's quantile
over the normal one, such that 1.96 deviations are 95 % also where few blocks have the information
on an axis.

Source: B. Efron and R. Tibshirani, An Introduction to the Bootstrap, 1993, ch. 8 (blocks); R. Cook
and S. Weisberg, Residuals and Influence in Regression, 1982, ch. 3 (fits without samples); R. Bell
and D. McCaffrey, Survey Methodology 28(2), 2002 (degrees of freedom of few blocks); L. Ljung,
System Identification, 2nd ed. 1999, sec. 16.5 (whiteness).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtri, stdtrit

LEAST = 1e-9  # of the information of a block that other blocks have too
LAGS = 20  # of the autocorrelations that are compared with those of white noise


def covariance(
    X: list[np.ndarray], error: np.ndarray, weight: np.ndarray, prior: np.ndarray, block: int
) -> np.ndarray:
    """Covariance of the numbers of a linear fit from blocks of its errors.

    Parameters
    ----------
    X : list of arrays (n, parameters)
        Regressors of each output.
    error : array (n, outputs)
    weight : array (outputs,)
        Of the errors of each output in the fit.
    prior : array (parameters,)
        Information of the prior on each number.
    block : int
        Samples of a block.
    """
    scale = np.sqrt(sum(w**2 * (x**2).sum(axis=0) for x, w in zip(X, weight, strict=True)) + prior)
    scale = np.where(scale > 0, scale, 1.0)
    starts = range(0, len(error), block)
    unit = np.eye(len(scale))
    A = np.zeros((len(starts), *unit.shape))
    scores = np.zeros((len(starts), len(scale)))
    for j, x in enumerate(X):
        for b, start in enumerate(starts):
            rows = x[start : start + block] / scale * weight[j]
            A[b] += rows.T @ rows
            scores[b] += rows.T @ (error[start : start + block, j] * weight[j])
    P = np.diag(prior / scale**2)
    H = np.linalg.pinv(A.sum(axis=0) + P, hermitian=True)
    g = np.linalg.solve((1 + LEAST) * unit - A @ H, scores[..., None])[..., 0]
    axes = np.linalg.eigh(A.sum(axis=0) + P)[1]
    shares = np.einsum("ji,bjk,ki->bi", axes, A, axes)
    g = g @ (axes * _student(shares)) @ axes.T
    return np.asarray(H @ (g.T @ g + P) @ H / np.outer(scale, scale))


def _student(shares: np.ndarray) -> np.ndarray:
    """Student's 97.5 % quantiles over the normal one, for numbers with the information ``shares``
    (blocks, n).

    Degrees of freedom (sum_b s_b)^2 / sum_b s_b^2: a deviation from few blocks is uncertain
    itself.
    """
    squares = (shares**2).sum(axis=0)
    freedom = shares.sum(axis=0) ** 2 / np.where(squares > 0, squares, 1.0)
    quantiles: np.ndarray = stdtrit(np.maximum(freedom, 1.0), 0.975) / ndtri(0.975)
    return quantiles


def parts_of(lengths: list[int], parts: int) -> list[tuple[int, slice]]:
    """Every recording in ``parts`` pieces: number of the recording and its samples."""
    return [
        (run, slice(k * length // parts, (k + 1) * length // parts))
        for run, length in enumerate(lengths)
        for k in range(parts)
    ]


def rms(error: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Root of the mean square of the errors (n, outputs) of samples that move; nan: none does."""
    count = moving.sum(axis=0)
    return np.asarray(
        np.sqrt((error**2 * moving).sum(axis=0) / np.where(count > 0, count, np.nan))
    )


def whiteness(errors: np.ndarray, Q: np.ndarray) -> tuple[float, ...]:
    """Part of the autocorrelations of residuals (segments, samples, n_y) within the 99 % band of
    white noise.

    ``Q`` (segments, samples * n_y, n_z): what was fitted in each segment; residuals are orthogonal
    to it, and so not quite white even where the noise is.
    """
    P = Q.reshape(*errors.shape, -1)
    count = errors.shape[0] * errors.shape[1]
    power = (errors**2).sum(axis=(0, 1))
    left = count - (P**2).sum(axis=(0, 1, 3))
    inside = []
    for lag in range(1, min(LAGS, errors.shape[1] - 1) + 1):
        found = (errors[:, lag:] * errors[:, :-lag]).sum(axis=(0, 1)) / power
        expected = -(P[:, lag:] * P[:, :-lag]).sum(axis=(0, 1, 3)) / left
        inside.append(np.abs(found - expected) < 2.58 / math.sqrt(count))
    return tuple(np.mean(inside, axis=0).tolist())
