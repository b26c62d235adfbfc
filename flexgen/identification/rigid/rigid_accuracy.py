"""Accuracy of a fit of a rigid arm: standard deviations, and errors on parts of the recordings
that were left out.

See also `flexgen.identification.estimator.residual_statistics`. A model that is fitted to motions
which do not excite it can be wrong elsewhere by any factor; that shows where a part of the
recordings is left out of the fit.

Source: B. Efron and R. Tibshirani, An Introduction to the Bootstrap, 1993, ch. 17
(cross-validation).
"""

from __future__ import annotations

import numpy as np

from flexgen.base.spec.explained_status import OUT_OF_TIME, STOPPED, ExplainedStatus

# errors on recordings that were left out over those of the fit, from which on the fit fails there
WORSE = 2.0
# errors over the deviation of the torque: too small to fail, and a model error
SMALL = 0.1
LARGE = 1 / 3

NOTICED = 1e-3  # errors over the deviation of the torque, below which no mistake is looked for


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
        "Do not use the new model file: the recordings do not determine its numbers. Fit more "
        "recordings that move all joints over their range, and fewer harmonics of a "
        "counterbalance.",
    )
    MODEL_ERROR = (
        "model error",
        "The model leaves more than a third of the torque of a motor unexplained, has a "
        "friction or a rotor below zero or errors that one mistake explains, or the fit does "
        "not converge.",
        "Check units, signs, sides and offsets of the recordings, the directions of the joints, "
        "gear ratios, gravity, payload and counterbalance.",
    )
    TIME_LIMIT = OUT_OF_TIME
    INTERRUPTED = STOPPED

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
    worse = (
        (there > WORSE * fitted)
        & (there / there_scale > WORSE * fitted / scale)
        & (there > SMALL * there_scale)
    )
    return RigidStatus.POORLY_VALIDATED if worse.any() else RigidStatus.FITTED
