"""Force laws of springs and frictions as CasADi expressions: torque over deflection or velocity,
and stored energy.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.parts import GearFriction
from flexgen.model.elements import (
    BacklashSpring,
    CubicSpring,
    Friction,
    LinearSpring,
    PiecewiseSpring,
    SmoothSpring,
    Spring,
)


def spring_torque(spring: Spring, d: ca.SX) -> ca.SX:
    """Torque [N m or N] of a spring at the deflection ``d`` [rad or m], odd in d; see
    `flexgen.model.elements`.
    """
    if isinstance(spring, LinearSpring):
        return spring.stiffness * d
    if isinstance(spring, CubicSpring):
        return spring.stiffness * d + spring.cubic * (d * d * d)
    if isinstance(spring, SmoothSpring):
        low = spring.low
        high = spring.high
        at = spring.break_at
        inside = low * d + (high - low) / (3 * at**2) * (d * d * d)
        at_break = low * at + (high - low) * at / 3
        return ca.if_else(
            ca.fabs(d) <= at, inside, ca.sign(d) * (at_break + high * (ca.fabs(d) - at))
        )
    if isinstance(spring, PiecewiseSpring):
        low = spring.low
        high = spring.high
        at = spring.break_at
        return ca.if_else(
            ca.fabs(d) <= at, low * d, ca.sign(d) * (low * at + high * (ca.fabs(d) - at))
        )
    gap = spring.gap
    eps = spring.smoothing
    clipped = (ca.sqrt((d + gap) ** 2 + eps**2) - ca.sqrt((d - gap) ** 2 + eps**2)) / 2
    return spring.stiffness * (d - clipped)


def stiffness_at_zero(spring: Spring) -> float:
    """Derivative of `spring_torque` at zero deflection [N m/rad or N/m]."""
    d = ca.SX.sym("d")
    return float(ca.Function("stiffness", [d], [ca.gradient(spring_torque(spring, d), d)])(0.0))


def spring_energy(spring: Spring, d: ca.SX) -> ca.SX:
    """Energy [J] stored at the deflection ``d``: the integral of `spring_torque` from 0, in closed
    form.
    """
    if isinstance(spring, LinearSpring):
        return spring.stiffness * d**2 / 2
    if isinstance(spring, CubicSpring):
        return spring.stiffness * d**2 / 2 + spring.cubic * d**4 / 4
    if isinstance(spring, BacklashSpring):
        gap = spring.gap
        eps = spring.smoothing

        def area(x: ca.SX) -> ca.SX:  # the integral of sqrt(x^2 + eps^2)
            return (x * ca.sqrt(x**2 + eps**2) + eps**2 * ca.asinh(x / eps)) / 2

        clipped = (area(d + gap) - area(d - gap) - area(gap) + area(-gap)) / 2
        return spring.stiffness * (d**2 / 2 - clipped)
    low = spring.low
    high = spring.high
    at = spring.break_at
    beyond = ca.fabs(d) - at
    if isinstance(spring, SmoothSpring):
        inside = low * d**2 / 2 + (high - low) / (12 * at**2) * d**4
        at_break = low * at**2 / 2 + (high - low) * at**2 / 12
        torque_at_break = low * at + (high - low) * at / 3
    else:
        inside = low * d**2 / 2
        at_break = low * at**2 / 2
        torque_at_break = low * at
    return ca.if_else(
        ca.fabs(d) <= at, inside, at_break + torque_at_break * beyond + high * beyond**2 / 2
    )


def friction_torque(
    friction: Friction,
    w: ca.SX,
    load: ca.SX | None = None,
    temperature: float | ca.SX | None = None,
) -> ca.SX:
    """Friction torque [N m or N] at the velocity ``w`` [rad/s or m/s]; it acts against the motion.

    The formula is that of the class of ``friction`` in `FRICTION_TORQUES`, or the method
    ``torque`` of a law of another package, see `flexgen.model.friction`. A `GearFriction` also
    depends on the torque of the gear on the motor side, ``load`` [N m], where it is loaded, and on
    the ``temperature`` [deg C]; ArgumentError without them.
    """
    if isinstance(friction, GearFriction):
        return _gear_friction(friction, w, load, temperature)
    if type(friction) in FRICTION_TORQUES:
        return FRICTION_TORQUES[type(friction)](friction, w)
    if not hasattr(friction, "torque"):
        raise ArgumentError(
            f"friction: given a {type(friction).__name__}, expected a law with a method torque"
        )
    return friction.torque(w)


def smooth_friction(friction: Friction, w: ca.SX) -> ca.SX:
    """Viscous friction, and a level that rises smoothly with the speed ``w`` [rad/s]."""
    torque = friction.viscous * w
    if _there(friction.coulomb) or _there(friction.stribeck):
        level = friction.coulomb
        if _there(friction.stribeck):
            level = level + friction.stribeck * _fade(friction.alpha * w)
        torque = torque + level * ca.tanh(friction.beta * w)
    return torque + friction.offset


def _gear_friction(
    law: GearFriction, w: ca.SX, load: ca.SX | None, temperature: float | ca.SX | None
) -> ca.SX:
    """Torque of a `GearFriction` at the speed ``w`` [rad/s], the torque ``load`` [N m] of the gear
    and the ``temperature`` [deg C].

    Viscous friction falls, the Stribeck part changes linearly with temperature; the Coulomb part
    grows with the size of the load, smooth at zero. ArgumentError without a quantity on which the
    law depends.
    """
    if temperature is None or (law.loaded and load is None):
        missing = "the temperature" if temperature is None else "the torque of the gear"
        raise ArgumentError(
            f'friction: given type = "gear" without {missing}, on which it depends'
        )
    warmer = temperature + law.temperature_rise - law.reference_temperature
    viscous = law.viscous
    stribeck = law.stribeck
    alpha = law.alpha
    level = law.coulomb
    if _there(law.viscous_share):
        viscous = viscous * (
            1 - law.viscous_share + law.viscous_share * ca.exp(-warmer / ca.SX(law.viscous_decay))
        )
    if _there(law.stribeck_slope):
        stribeck = ca.fmax(0, stribeck + law.stribeck_slope * ca.SX(warmer))
    if _there(law.stribeck_speed_slope):
        alpha = alpha / ca.fmax(0.01, 1 + alpha * law.stribeck_speed_slope * ca.SX(warmer))
    if _there(stribeck):
        level = level + stribeck * _fade(alpha * w)
    if law.loaded:
        assert load is not None  # (refused above)
        size = load * load / (ca.sqrt(load * load + law.load_smoothing**2) + law.load_smoothing)
        level = level + law.load_coulomb * size
        if _there(law.load_stribeck):
            level = level + law.load_stribeck * size * _fade(law.load_alpha * w)
    elif _there(law.load_coulomb) or _there(law.load_stribeck):
        raise ArgumentError(
            "load_coulomb, load_stribeck: given parameters, expected load_smoothing > 0 in the "
            "model"
        )
    return viscous * w + level * ca.tanh(law.beta * w) + law.offset


def _fade(x: ca.SX) -> ca.SX:
    """``1/cosh(x)``, written so that neither it nor its derivative overflows."""
    fade = ca.exp(-ca.fabs(x))
    return 2 * fade / (1 + fade * fade)


# Class of a friction law in `flexgen.model.elements` -> its torque.
FRICTION_TORQUES: dict[type[Friction], Callable[..., ca.SX]] = {Friction: smooth_friction}


def _there(x: float | ca.SX) -> bool:
    """True for a number that is not zero, and for a symbol in its place."""
    return isinstance(x, ca.SX) or x != 0.0
