"""Hysteresis of gears, in addition to the equations of motion: torques of each gear with states.

    tau_g = spring(d) + D d' + sum z_i,    z_i: see `flexgen.dynamics.hysteresis.hysteresis_law`,
    d: deflection of the gear

Numbers are on the arm side. Elements of all gears are arranged in layers, each with one element of
each gear at most. Poles, zeros, frequency responses and the growth of perturbations are those of
the springs and dampers alone. What does not take hysteresis into account refuses a model that has
it: `flexgen.model.friction.refuse_hysteresis`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from flexgen.base.spec.memory import Hysteresis, HysteresisLaw
from flexgen.dynamics.hysteresis.hysteresis_law import (
    bend_of,
    curve_of,
    is_dahl,
    law_rate,
    shape_of,
    sharpness_of,
)
from flexgen.dynamics.mechanics.force_laws import stiffness_at_zero
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.model.elements import Dof, RobotModel
from flexgen.model.friction import hysteretic_joints

PLAIN = Hysteresis(1.0, 1.0)  # where there is none


@dataclass(frozen=True)
class GearHysteresis:
    """``stiffness`` K_h and ``slip`` W, arm side, (n_g,) [N m/rad], [N m]; zero where none is."""

    stiffness: np.ndarray
    slip: np.ndarray

    @cached_property
    def present(self) -> np.ndarray:
        """Which gears have hysteresis (n_g,)."""
        return np.asarray(self.slip > 0.0)

    @cached_property
    def divisor(self) -> np.ndarray:
        """W, and 1 where none is."""
        return np.where(self.present, self.slip, 1.0)


@dataclass(frozen=True)
class Layer(GearHysteresis):
    """An element of each gear, with its law (n_g), see
    `flexgen.dynamics.hysteresis.hysteresis_law.shape_of`.
    """

    laws: tuple[HysteresisLaw, ...]

    @cached_property
    def curved(self) -> list[int]:
        """The gears whose element has another law than Dahl's."""
        return [k for k, law in enumerate(self.laws) if not is_dahl(law)]

    @property
    def bend(self) -> np.ndarray:
        """Bounds of the second derivatives of the curves, (n_g,)."""
        return np.array([bend_of(law) for law in self.laws])

    @property
    def sharpness(self) -> np.ndarray:
        """Sharpness of the onset of slip, 1 for Dahl's law, (n_g,)."""
        return np.array([sharpness_of(law) for law in self.laws])

    def rates(self, rate: ca.SX, z: ca.SX, slip: ca.SX | np.ndarray) -> ca.SX:
        """Rates of the torques ``z`` over K_h (n_g,), for rates of deflection; ``slip``: W in the
        units of z.
        """
        return ca.vertcat(
            *[law_rate(law, rate[k], z[k], slip[k]) for k, law in enumerate(self.laws)]
        )

    def paths(self, part: np.ndarray) -> np.ndarray:
        """Where on their curves elements are (n_g,) that begin with ``part`` s z/W; zero for those
        by Dahl's law.
        """
        out = np.zeros(len(part))
        for k in self.curved:
            out[k] = curve_of(self.laws[k]).path(np.clip(part[k], -1.0, 1.0))
        return out

    def along(
        self, way: np.ndarray, z_r: np.ndarray, s: np.ndarray, start: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Torques z, and how they rise with the deflection, after paths ``way`` K_h |p - p_r|/W
        (..., n_g).

        ``z_r``: torques at p_r, in the direction ``s``, where `paths` are ``start``, (n_g,) each.
        By Dahl's law ``z = s W + (z_r - s W) exp(-way)``; others follow their curve. On a negative
        way, where Newton's method may try a deflection before p_r, the branch is its tangent.
        """
        end = s * self.slip
        passed = np.maximum(way, 0.0)
        behind = np.minimum(way, 0.0)
        fade = np.exp(-passed)
        z = end + (z_r - end) * fade * (1.0 - behind)
        rise = np.where(self.present, self.stiffness * (1.0 - s * z_r / self.divisor) * fade, 0.0)
        for k in self.curved:
            curve = curve_of(self.laws[k])
            y = curve.at(start[k] + passed[..., k])
            slope = curve.slope(y)
            z[..., k] = s[k] * self.slip[k] * (y + slope * behind[..., k])
            rise[..., k] = self.stiffness[k] * slope
        return z, rise


def elements_of(
    hysteresis: HysteresisLaw | Sequence[HysteresisLaw] | None,
) -> tuple[HysteresisLaw, ...]:
    """The elements of the hysteresis of a gear."""
    if hysteresis is None or isinstance(hysteresis, HysteresisLaw):
        return () if hysteresis is None else (hysteresis,)
    return tuple(hysteresis)


def gear_layers(model: RobotModel) -> tuple[Layer, ...]:
    """The elements of all gears in layers, one layer at least."""
    found = [(elements_of(gear.hysteresis), gear, ratio) for gear, ratio in gears(model)]
    count = max((len(each) for each, _, _ in found), default=0)
    layers = []
    for layer in range(max(1, count)):
        numbers = np.zeros((2, model.n_g))
        laws: list[HysteresisLaw] = [PLAIN] * model.n_g
        for k, (each, gear, ratio) in enumerate(found):
            if layer < len(each) and gear.spring is not None:
                slip = each[layer].lost_motion * ratio**2 * stiffness_at_zero(gear.spring) / 2
                numbers[:, k] = (ratio**2 * each[layer].stiffness, slip)
                laws[k] = shape_of(each[layer])
        layers.append(Layer(numbers[0], numbers[1], tuple(laws)))
    return tuple(layers)


def gear_hysteresis(model: RobotModel) -> GearHysteresis:
    """The stiffness that all elements of a gear add, and the torque at which all slip."""
    layers = gear_layers(model)
    return GearHysteresis(
        *(np.sum([getattr(x, name) for x in layers], axis=0) for name in ("stiffness", "slip"))
    )


def torque_along(layers: Sequence[Layer], p: np.ndarray) -> np.ndarray:
    """Torques of the hysteresis (n, n_g) [N m], the sum of its layers, along deflections ``p`` (n,
    n_g) [rad or m] that reverse at samples only, from rest without torque.
    """
    out = np.zeros_like(p)
    for layer in layers:
        z = np.zeros(p.shape[1])
        way = np.zeros(p.shape[1])
        begin = np.zeros(p.shape[1])
        direction = np.zeros(p.shape[1])
        for k, change in enumerate(np.diff(p, axis=0), 1):
            s = np.sign(change)
            turned = (s * direction < 0.0) | ((direction == 0.0) & (s != 0.0))
            if turned.any() and layer.curved:
                begin = np.where(turned, layer.paths(s * z / layer.divisor), begin + way)
            else:
                begin = begin + way
            way = s * layer.stiffness * change / layer.divisor
            direction = np.where(s != 0.0, s, direction)
            z = np.where(change == 0.0, z, layer.along(way, z, s, begin)[0])
            out[k] += z
    return out


def without_hysteresis(model: RobotModel) -> RobotModel:
    """The model with the springs and dampers of its gears alone."""
    if not hysteretic_joints(model):
        return model

    def plain(dof: Dof) -> Dof:
        return dof if dof.gear is None else replace(dof, gear=replace(dof.gear, hysteresis=None))

    elements = (
        replace(element, dofs=tuple(map(plain, element.dofs))) for element in model.elements
    )
    return replace(model, elements=tuple(elements))
