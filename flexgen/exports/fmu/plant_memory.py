"""Torques of hysteresis and bristles as states of the plant, behind those of its motion.

x = (q_a, q_m, v_a, v_m, z),
z: torques of elements of gears, arm side; s0 times deflections of bristles
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexgen.dynamics.hysteresis.hysteresis import gear_layers
from flexgen.dynamics.hysteresis.lugre import motor_bristles
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.exports.fmu.variables import STATE, Variable
from flexgen.model.elements import RobotModel
from flexgen.model.friction import memory_laws
from flexgen.simulation.integration.hysteretic_rate import (
    deflection_rates,
    memory_of,
    motor_speeds,
    slip_torques,
)


@dataclass(frozen=True)
class PlantMemory:
    """The equations of motion with the torques z (n_z,) among their forces.

    The functions of ``equations`` have z as their argument ``memory``. ``function``, from q_a,
    v_a, q_m, v_m, z: the rates of z (n_z,); a bound of those at which small changes of z fade,
    ``n (|gamma| + 1 - gamma) K_h |d'|/W`` and ``s0 |v|/F_c`` [1/s]; and the derivatives of the
    forces on (q_a, q_m) in z (n, n_z).
    """

    equations: Equations
    function: ca.Function
    size: int


def plant_memory(equations: Equations) -> PlantMemory | None:
    """The states of hysteresis and bristles of a plant, of gears and motors that have them only,
    with the rate at which they fade; None where there are none.
    """
    model = equations.model
    if not memory_laws(model):
        return None
    made = memory_of(equations)
    slip = slip_torques(model)
    kept = np.flatnonzero(slip)
    z = ca.SX.sym("memory", len(kept))
    full = ca.SX.zeros(len(slip))
    full[kept.tolist()] = z
    forces, rates = ca.substitute([made.forces, made.rates], [made.z], [full])
    fading = []
    turning = ca.fabs(deflection_rates(equations))
    speeds = ca.fabs(motor_speeds(equations))
    for layer in gear_layers(model):
        fading.append(ca.DM(layer.bend * layer.stiffness / layer.divisor) * turning)
    law = motor_bristles(model)
    fading.append(ca.DM(law.stiffness / np.where(law.present, law.coulomb, 1.0)) * speeds)
    lag = equations.lagrangian
    given = [lag.chain.q_a, lag.chain.v_a, lag.q_m, lag.v_m, z]
    fastest = ca.mmax(ca.vertcat(*fading))
    results = [ca.densify(x) for x in (rates[kept.tolist()], fastest, ca.jacobian(forces, z))]
    return PlantMemory(
        equations.with_memory(forces, z), ca.Function("memory", given, results), len(kept)
    )


def memory_variables(model: RobotModel, first: int) -> list[Variable]:
    """The states, indices from ``first`` on, in the order of `PlantMemory.z`."""
    rows = []
    layers = gear_layers(model)
    for k, layer in enumerate(layers):
        for gear in np.flatnonzero(layer.present):
            coordinate = model.coordinates[model.i_g[gear]]
            count = sum(each.present[gear] for each in layers)
            name = f"gear.{coordinate.name}.hysteresis{f'[{k + 1}]' if count > 1 else ''}"
            unit = "N.m" if coordinate.unit == "rad" else "N"
            rows.append(
                (name, unit, "torque of an element of hysteresis, arm side", layer.slip[gear])
            )
    law = motor_bristles(model)
    for j in np.flatnonzero(law.present):
        text = "stiffness times deflection of the bristles, motor side"
        rows.append((f"motor.{model.motors[j].name}.bristles", "N.m", text, law.static[j]))
    return [
        Variable(name, STATE, first + k, unit, text, 0.0, nominal=float(slip))
        for k, (name, unit, text, slip) in enumerate(rows)
    ]
