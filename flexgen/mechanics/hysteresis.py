"""Hysteresis of gears by Dahl's law, in addition to the equations of motion: a torque of each gear with a state.

    tau_g = spring(d) + D d' + z,    z' = K_h (d' - |d'| z/W),    d: deflection of the gear, arm side

Poles, zeros, frequency responses and the growth of perturbations are those of the springs and dampers alone. What does
not take hysteresis into account refuses a model that has it: `flexgen.model.friction.refuse_hysteresis`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from flexgen.mechanics.equations import Equations
from flexgen.mechanics.force_laws import stiffness_at_zero
from flexgen.mechanics.lagrangian import gears
from flexgen.mechanics.motor_harmonics import gear_rates
from flexgen.model.elements import Dof, RobotModel
from flexgen.model.friction import hysteretic_joints


@dataclass(frozen=True)
class GearHysteresis:
    """Numbers of the law, arm side: ``stiffness`` K_h and ``slip`` W, (n_g,) [N m/rad], [N m]; zero where none is."""

    stiffness: np.ndarray
    slip: np.ndarray

    @property
    def present(self) -> np.ndarray:
        """Which gears have hysteresis (n_g,)."""
        return np.asarray(self.slip > 0.0)


def gear_hysteresis(model: RobotModel) -> GearHysteresis:
    """The numbers of Dahl's law of all gears."""
    stiffness, slip = np.zeros(model.n_g), np.zeros(model.n_g)
    for k, (gear, ratio) in enumerate(gears(model)):
        if gear.hysteresis is not None and gear.spring is not None:
            stiffness[k] = ratio**2 * gear.hysteresis.stiffness
            slip[k] = gear.hysteresis.lost_motion * ratio**2 * stiffness_at_zero(gear.spring) / 2
    return GearHysteresis(stiffness, slip)


def torque_along(law: GearHysteresis, p: np.ndarray) -> np.ndarray:
    """Torques z of the hysteresis (n, n_g) along deflections ``p`` (n, n_g) that reverse at samples, from z = 0."""
    out, slip = np.zeros_like(p), np.where(law.present, law.slip, 1.0)
    for k, change in enumerate(np.diff(p, axis=0), 1):
        end = np.sign(change) * law.slip
        out[k] = end + (out[k - 1] - end) * np.exp(-np.abs(change) * law.stiffness / slip)
    return out


def generalized_force(model: RobotModel, z: ca.SX, q_m: ca.SX) -> ca.SX:
    """Forces on y = (q_a, q_me) (n,) of additional gear torques ``z`` (n_g,) [N m]; ``q_m`` (n_m,): motor angles."""
    forces = ca.SX.zeros(model.dof)
    on_motors = ca.mtimes(gear_rates(model, q_m).T, z)
    for k, i in enumerate(model.i_g):
        forces[i] += z[k]
    for k, j in enumerate(model.i_m):
        forces[model.n_a + k] -= on_motors[j]
    return forces


def hysteretic_rate(equations: Equations) -> tuple[list[ca.SX], list[ca.SX]]:
    """Rates of the motion and of the hysteresis, for the definition's equations of motion.

    Returns
    -------
    inputs : list
        State (q_a, q_me, v_a, v_me) (2 n), torques z of all gears (n_g), motor torques (n_m); then the force on the
        tool (6,) where the equations have one.
    outputs : list
        Rate of the state (2 n), of z (n_g), and the power that goes into the hysteresis [W].
    """
    model, lag, (y, dy, _) = equations.model, equations.lagrangian, equations.y
    law, z = gear_hysteresis(model), ca.SX.sym("z", model.n_g)
    acceleration = equations.acceleration_under(generalized_force(model, z, lag.q_m))
    i_g = list(model.i_g)
    geared = ca.mtimes(ca.SX(ca.DM(model.eta)), lag.chain.v_a[i_g])
    v_m = ca.vertcat(*[lag.v_m[j] if j in model.i_m else geared[j] for j in range(model.n_m)])
    rate = ca.mtimes(gear_rates(model, lag.q_m), v_m) - lag.chain.v_a[i_g]
    slip = np.where(law.present, law.slip, 1.0)
    dz = ca.DM(law.stiffness) * (rate - ca.fabs(rate) * z / ca.DM(slip))
    x = ca.SX.sym("x", 2 * model.dof)
    outputs = ca.substitute([ca.vertcat(dy, acceleration), dz, ca.dot(z, rate)], [ca.vertcat(y, dy)], [x])
    return [x, z, lag.tau_m, *([] if equations.force is None else [equations.force])], outputs


def without_hysteresis(model: RobotModel) -> RobotModel:
    """The model with the springs and dampers of its gears alone."""
    if not hysteretic_joints(model):
        return model

    def plain(dof: Dof) -> Dof:
        return dof if dof.gear is None else replace(dof, gear=replace(dof.gear, hysteresis=None))

    elements = (replace(element, dofs=tuple(map(plain, element.dofs))) for element in model.elements)
    return replace(model, elements=tuple(elements))
