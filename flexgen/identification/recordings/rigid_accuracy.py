"""Accuracy of a fit of a rigid arm: standard deviations, and errors on parts of the recordings that were left out.

The normal equations of all numbers theta = (pi, phi) and the scores g_b of blocks b of the recordings give

    H = (X' W X + P)^-1,      covariance = H (sum_b g_b g_b' + P) H

with the information P of the model file's bodies: errors of neighboring samples are alike, and so blocks are counted,
not samples. A model that is fitted to motions which do not excite it can be wrong elsewhere by any factor; that shows
where a part of the recordings is left out of the fit.

Source: B. Efron and R. Tibshirani, An Introduction to the Bootstrap, 1993, ch. 8 (blocks), ch. 17 (cross-validation).
"""

from __future__ import annotations

import numpy as np

from flexgen.spec.explained_status import ExplainedStatus

BLOCK_S = 0.5  # s: blocks whose errors are taken as independent
STEP = 1e-6  # relative, of differences
WORSE = 2.0  # errors on recordings that were left out over those of the fit, from which on the fit fails there
SMALL, LARGE = 0.1, 0.5  # errors over the deviation of the torque: too small to fail, and a model error


class RigidStatus(ExplainedStatus):
    """Status of a fit of a rigid arm."""

    FITTED = (
        "fitted",
        "The model predicts motions that were not fitted about as well as those that were.",
        "Use the new model file for motions like these.",
    )
    NOT_CHECKED = (
        "not checked",
        "The fit was not compared with motions that were left out.",
        "Validate it with other recordings before it is used.",
    )
    POORLY_VALIDATED = (
        "poorly validated",
        "The model fails on motions that were not fitted.",
        "Do not use the new model file: the recordings do not determine its numbers. Fit more recordings that move all "
        "joints over their range, and fewer harmonics of a counterbalance.",
    )
    MODEL_ERROR = (
        "model error",
        "The model leaves more than half of the torque of a motor unexplained.",
        "Check units, signs, sides and offsets of the recordings, the directions of the joints, and payload and "
        "counterbalance.",
    )

    @property
    def has_deviations(self) -> bool:
        """Whether standard deviations are stated: not where the fit fails."""
        return self in (RigidStatus.FITTED, RigidStatus.NOT_CHECKED)


def status_of(
    fitted: np.ndarray, scale: np.ndarray, there: np.ndarray | None, there_scale: np.ndarray | None
) -> RigidStatus:
    """The status from the rms errors of each motor, of samples that move.

    Parameters
    ----------
    fitted, scale : arrays (n_m,) [N m]
        Rms errors of the fit, and deviations of the torques.
    there, there_scale : arrays (n_m,) [N m]
        The same of motions that were not fitted; None: there are none.
    """
    if (fitted > LARGE * scale).any():
        return RigidStatus.MODEL_ERROR
    if there is None or there_scale is None:
        return RigidStatus.NOT_CHECKED
    worse = (there > WORSE * fitted) & (there / there_scale > WORSE * fitted / scale) & (there > SMALL * there_scale)
    return RigidStatus.POORLY_VALIDATED if worse.any() else RigidStatus.FITTED


def covariance(X: list[np.ndarray], error: np.ndarray, weight: np.ndarray, prior: np.ndarray, block: int) -> np.ndarray:
    """Covariance of the numbers of a linear fit from blocks of its errors.

    Parameters
    ----------
    X : list of arrays (n, parameters)
        Regressors of each motor.
    error : array (n, n_m) [N m]
    weight : array (n_m,)
        Of the errors of each motor in the fit.
    prior : array (parameters,)
        Information of the prior on each number.
    block : int
        Samples of a block.
    """
    scale = np.sqrt(sum(w**2 * (x**2).sum(axis=0) for x, w in zip(X, weight, strict=True)) + prior)
    scale = np.where(scale > 0, scale, 1.0)
    A, count = np.zeros((len(scale), len(scale))), -(-len(error) // block)
    scores = np.zeros((count, len(scale)))
    for j, x in enumerate(X):
        rows = x / scale * weight[j]
        A += rows.T @ rows
        each = rows * (error[:, j : j + 1] * weight[j])
        scores += np.add.reduceat(each, np.arange(0, len(error), block), axis=0)
    P = np.diag(prior / scale**2)
    H = np.linalg.pinv(A + P, hermitian=True)
    return np.asarray(H @ (scores.T @ scores + P) @ H / np.outer(scale, scale))


def parts_of(lengths: list[int], parts: int) -> list[tuple[int, slice]]:
    """Every recording in ``parts`` pieces: number of the recording and its samples."""
    return [
        (run, slice(k * length // parts, (k + 1) * length // parts))
        for run, length in enumerate(lengths)
        for k in range(parts)
    ]


def rms(error: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Root of the mean square of the errors (n, n_m) of samples that move; nan: none does."""
    count = moving.sum(axis=0)
    return np.asarray(np.sqrt((error**2 * moving).sum(axis=0) / np.where(count > 0, count, np.nan)))
