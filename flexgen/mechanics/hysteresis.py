"""Hysteresis of gears by Dahl's law, in addition to the equations of motion: a torque of each gear with a state.

    tau_g = spring(d) + D d' + z,    z' = K_h (d' - |d'| z/W),    d: deflection of the gear, arm side

Poles, zeros, frequency responses and the growth of perturbations are those of the springs and dampers alone. What does
not take hysteresis into account refuses a model that has it: `flexgen.model.friction.refuse_hysteresis`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexgen.mechanics.force_laws import stiffness_at_zero
from flexgen.mechanics.lagrangian import gears
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


def without_hysteresis(model: RobotModel) -> RobotModel:
    """The model with the springs and dampers of its gears alone."""
    if not hysteretic_joints(model):
        return model

    def plain(dof: Dof) -> Dof:
        return dof if dof.gear is None else replace(dof, gear=replace(dof.gear, hysteresis=None))

    elements = (replace(element, dofs=tuple(map(plain, element.dofs))) for element in model.elements)
    return replace(model, elements=tuple(elements))
