"""The model of a rigid fit: its bodies, counterbalances, frictions and rotors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from flexgen.identification.rigid.counterbalances import fitted_balances
from flexgen.identification.rigid.rigid_columns import COULOMB_SPEED
from flexgen.model.elements import Body, Friction, Motor, RobotModel


def rigid_model(
    robot: RobotModel,
    bodies: Sequence[Body],
    counterbalance: Mapping[str, int],
    friction: np.ndarray,
    fades: np.ndarray,
    speed: np.ndarray,
) -> RobotModel:
    """The model with what was found, and its payload.

    Parameters
    ----------
    robot : RobotModel
    bodies : sequence of Body
        Without the payload.
    counterbalance : mapping
        Name of a joint -> number of harmonics that were fitted.
    friction, fades, speed : arrays (n_m, columns), (n_m,), (n_m,)
        As in `flexgen.identification.rigid.rigid_columns.Columns`.
    """
    balances = fitted_balances(robot, counterbalance, friction)
    elements = tuple(
        replace(
            e,
            body=body,
            dofs=tuple(replace(dof, counterbalance=balances[dof.name]) for dof in e.dofs),
        )
        for e, body in zip(robot.elements, bodies, strict=True)
    )
    return replace(robot, elements=elements, motors=motors_of(robot, friction, fades, speed))


def motors_of(
    model: RobotModel, friction: np.ndarray, fades: np.ndarray, speed: np.ndarray
) -> tuple[Motor, ...]:
    """The motors with the friction and the inertia that were found; see `in_a_file`."""
    out = []
    numbers = in_a_file(model, friction, fades)
    for j, motor in enumerate(model.motors):
        ratio = float(np.abs(model.eta[j]).max())
        viscous, coulomb, offset, rotor = numbers[j, :4].tolist()
        falling = float(numbers[j, -2]) if fades[j] else 0.0
        law = Friction(
            viscous=viscous / ratio,
            coulomb=coulomb,
            beta=1.0 / (COULOMB_SPEED * float(speed[j]) * ratio)
            if max(coulomb, falling) > 0
            else 0.0,
            stribeck=falling,
            alpha=float(fades[j]) / ratio if falling else 0.0,
            offset=offset,
        )
        out.append(replace(motor, friction=law, inertia=motor.inertia + rotor / ratio))
    return tuple(out)


def in_a_file(model: RobotModel, friction: np.ndarray, fades: np.ndarray) -> np.ndarray:
    """Coefficients of the motors (n_m, columns) that a model file can have, near those found.

    A friction below zero becomes zero; a rotor below zero keeps the inertia of the file; changes
    of fades are zero.
    """
    out = np.array(friction)
    ratio = np.abs(model.eta).max(axis=1)
    out[:, :2] = np.maximum(out[:, :2], 0.0)
    rotor = np.array([motor.inertia for motor in model.motors]) + out[:, 3] / ratio
    out[rotor <= 0, 3] = 0.0
    if fades.any():
        out[:, -2] = np.where(fades > 0, np.maximum(out[:, -2], 0.0), 0.0)
        out[:, -1] = 0.0
    return out
