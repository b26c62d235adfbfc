"""Counterbalances of a rigid fit: the harmonics of the model file that stay, and those that were
fitted.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexgen.model.elements import RobotModel


def held_balances(
    model: RobotModel, fitted: Mapping[str, int]
) -> dict[str, tuple[tuple[float, float], ...]]:
    """The counterbalances of the file without the harmonics that are fitted, by the names of the
    joints.
    """
    return {
        dof.name: tuple(
            (0.0, 0.0) if 2 <= k < fitted.get(dof.name, 0) + 2 else pair
            for k, pair in enumerate(dof.counterbalance, 1)
        )
        for element in model.elements
        for dof in element.dofs
    }


def fitted_balances(
    model: RobotModel, fitted: Mapping[str, int], friction: np.ndarray
) -> dict[str, tuple[tuple[float, float], ...]]:
    """The counterbalances of all joints, arm side: those of the file, and the harmonics that were
    fitted.
    """
    out = held_balances(model, fitted)
    names = [model.coordinates[i].name for i in model.i_g]
    for name, count in fitted.items():
        j = int(np.argmax(np.abs(model.eta[:, names.index(name)])))
        pairs = [*out[name], *[(0.0, 0.0)] * (count + 1 - len(out[name]))]
        for k in range(count):  # a torque that relieves the motor
            sine, cosine = (
                -model.eta[j, names.index(name)] * friction[j, 4 + 2 * k : 6 + 2 * k]
            ).tolist()
            pairs[k + 1] = (sine, cosine)
        out[name] = tuple(pairs)
    return out
