"""Infeasible motors: a friction or rotor inertia below zero by more than its uncertainty and a
part of the torque.
"""

from __future__ import annotations

import numpy as np

from flexgen.model.elements import RobotModel

DOUBT = 3.0  # standard deviations below zero
SMALL = 0.02  # of the torque of a motor: smaller parts can be those of another law, or of a delay


def is_possible(
    model: RobotModel,
    columns: np.ndarray,
    numbers: np.ndarray,
    covariance: np.ndarray,
    torque: np.ndarray,
    fades: np.ndarray,
) -> bool:
    """Whether motors that were found in a motion are those of a robot.

    Parameters
    ----------
    model : RobotModel
        Its rotors have the inertia that the numbers add to.
    columns : array (n, n_m, k)
        What is multiplied by the numbers: speed over its largest ratio, direction, 1, acceleration
        over the ratio, ...
    numbers, covariance : arrays (n_m, k), (n_m k, n_m k)
    torque : array (n_m,) [N m]
        Deviation of the torques.
    fades : array (n_m,)
        Not zero for a friction that falls with speed: its size is in the last column but one.
    """
    count = numbers.shape[1]
    for j, motor in enumerate(model.motors):
        rotor = motor.inertia * np.abs(model.eta[j]).max() * (np.arange(count) == 3)
        for k in (0, 1, 3, *[count - 2] * bool(fades[j])):
            here = (numbers[j] + rotor)[k]
            sd = np.sqrt(covariance[j * count + k, j * count + k])
            if (
                here < -DOUBT * sd
                and -here * np.sqrt(np.mean(columns[:, j, k] ** 2)) > SMALL * torque[j]
            ):
                return False
    return True
