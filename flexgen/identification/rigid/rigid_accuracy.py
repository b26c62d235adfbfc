"""Status of a fit of a rigid arm, from its errors and from those on parts of the recordings that
were left out.

See also `flexgen.identification.estimator.validation`.
"""

from __future__ import annotations

import numpy as np

from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.estimator.validation import Errors, fails_elsewhere

# errors over the deviation of the torque: too small to fail, and a model error
SMALL = 0.1
LARGE = 1 / 3

NOTICED = 1e-3  # errors over the deviation of the torque, below which no mistake is looked for


# Where sentence and advice are not those of measured responses.
TEXTS = {
    FitStatus.FITTED: (
        "The model predicts motions that were not fitted about as well as those that were.",
        "Use the new model file for motions like these.",
    ),
    FitStatus.POORLY_VALIDATED: (
        "The model fails on motions that were not fitted.",
        "Do not use the new model file: the recordings do not determine its numbers. Fit more "
        "recordings that move all joints over their range, and fewer harmonics of a "
        "counterbalance.",
    ),
    FitStatus.MODEL_ERROR: (
        "The model leaves more than a third of the torque of a motor unexplained, has a "
        "friction or a rotor below zero or errors that one mistake explains, or the fit does "
        "not converge.",
        "Check units, signs, sides and offsets of the recordings, the directions of the joints, "
        "gear ratios, gravity, payload and counterbalance.",
    ),
}


def status_of(
    fitted: np.ndarray, scale: np.ndarray, there: np.ndarray | None, there_scale: np.ndarray | None
) -> FitStatus:
    """The status from the rms errors of each motor, of samples that move.

    Parameters
    ----------
    fitted, scale : arrays (n_m,) [N m]
        Rms errors of the fit, and deviations of the torques.
    there, there_scale : arrays (n_m,) [N m]
        The same of motions that were not fitted; None: there are none.
    """
    if (fitted > LARGE * scale).any():
        return FitStatus.MODEL_ERROR
    if there is None or there_scale is None:
        return FitStatus.NOT_CHECKED
    others = Errors(there, there / there_scale)
    worse = fails_elsewhere(Errors(fitted, fitted / scale), others, SMALL)
    return FitStatus.POORLY_VALIDATED if worse.any() else FitStatus.FITTED
