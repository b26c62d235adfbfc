"""Motors that no robot has: a friction that gives energy, or a rotor with an inertia below zero."""

from __future__ import annotations

import numpy as np

from flexgen.model.elements import RobotModel

DOUBT = 3.0  # standard deviations below zero
SMALL = 0.02  # of the torque of a motor: smaller parts can be those of another law, or of a delay


def is_possible(
    model: RobotModel, columns: np.ndarray, numbers: np.ndarray, covariance: np.ndarray, torque: np.ndarray
) -> bool:
    """Whether motors that were found in a motion are those of a robot.

    Parameters
    ----------
    model : RobotModel
        Its rotors have the inertia that the numbers add to.
    columns : array (n, n_m, k)
        What is multiplied by the numbers: speed over its largest ratio, direction, 1, acceleration over the ratio, ...
    numbers, covariance : arrays (n_m, k), (n_m k, n_m k)
    torque : array (n_m,) [N m]
        Deviation of the torques.
    """
    count = numbers.shape[1]
    for j, motor in enumerate(model.motors):
        rotor = motor.inertia * np.abs(model.eta[j]).max() * (np.arange(count) == 3)
        for part in ([0, 1], [3]):
            X, here, at = columns[:, j, part], (numbers[j] + rotor)[part], j * count + np.array(part)
            power = X.T @ X[:, 0]  # of friction; of a rotor, times its acceleration
            sd = np.sqrt(power @ covariance[np.ix_(at, at)] @ power)
            if power @ here < -DOUBT * sd and np.sqrt(np.mean((X @ here) ** 2)) > SMALL * torque[j]:
                return False
    return True
