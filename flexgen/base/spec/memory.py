"""Tables of elements with a state: hysteresis of gears, friction of motors.

The law of a hysteresis is in `flexgen.dynamics.hysteresis.hysteresis_law`.
"""

from __future__ import annotations

from dataclasses import dataclass

from flexgen.base.spec.keys import Context, Format, Key, number
from flexgen.base.spec.tables import Table

SHARPEST = 20.0  # exponent of an element of hysteresis, at most


@dataclass(frozen=True)
class HysteresisLaw:
    """Hysteresis of a gear, or one of its elements: a torque z in parallel with the spring, after
    the deflection d.

        z' = K_h d' g(s z/W),    s = sign(d')

    with the torque W = K lost_motion/2 at which it slips; K: stiffness of the spring at zero. A
    law of another package is a subclass with its own numbers and a method ``slope(y)``: g of an
    array or a CasADi expression, for y from -1 to
    1. It is smooth, positive before 1, g(0) = 1, g(1) = 0, and g'(1) < 0.
    """

    lost_motion: float  # at the joint: width of the hysteresis at zero torque, 2 W/K [rad or m]
    stiffness: float  # K_h, added after a reversal [N m/rad or N/m], on the side of the spring


@dataclass(frozen=True)
class Hysteresis(HysteresisLaw):
    """The law of Bouc and Wen.

        z' = K_h (d' (1 - gamma |x|^n) - (1 - gamma) |d'| |x|^n sign(x)),    x = z/W

    With n = 1 and gamma = 0 it is that of Dahl, ``z' = K_h (d' - |d'| z/W)``, with a large n
    Coulomb friction behind a spring. Several elements add up to Maxwell's slip model.

    Sources: P. R. Dahl, AIAA Journal 14(12), 1976; Y.-K. Wen, J. Eng. Mech. Div. ASCE
    102(2), 1976.
    """

    exponent: float = 1.0  # n
    gamma: float = 0.0


HYSTERESIS = Format(
    "hysteresis of a gear in parallel with its spring; several elements as a list of tables",
    (
        Key(
            "lost_motion",
            number(above=0.0),
            "width of the hysteresis at zero torque, at the joint",
            "rad or m",
        ),
        Key(
            "stiffness",
            number(above=0.0),
            "stiffness that is added after a reversal, on the side of the spring",
            "N m/rad or N/m",
        ),
        Key(
            "exponent",
            number(least=1.0, most=SHARPEST),
            "how sharply it begins to slip, n; 1: Dahl's law",
            "",
            1.0,
        ),
        Key(
            "gamma",
            number(least=-1.0, most=0.5),
            "shape of its return; 0.5: along a straight line",
            "",
            0.0,
        ),
    ),
    make=Hysteresis,
    definition="hysteresis",
)


@dataclass(frozen=True)
class LuGre:
    """Friction of bristles that deflect by z before they slip; all numbers on the side of the
    motor.

        tau = s0 z + s1 z',    z' = v - s0 |v| z/g(v),    g(v) = F_c + (F_s - F_c) exp(-(v/v_s)^2)

    Source: C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, IEEE TAC 40(3), 1995.
    """

    coulomb: float  # F_c [N m]
    static: float  # F_s [N m]
    stribeck_speed: float  # v_s [rad/s]
    stiffness: float  # s0 [N m/rad]
    damping: float = 0.0  # s1 [N m s/rad]


def _check_static(table: Table, here: Context) -> None:
    """The error of a table where static friction is below coulomb, or is larger without the speed
    at which it fades.
    """
    static = here.values["static"]
    least = here.values["coulomb"]
    if static is not None and static < least:
        raise table.fail("static", "a number >= coulomb")
    if static is not None and static > least and here.values["stribeck_speed"] is None:
        raise table.fail("stribeck_speed", "stribeck_speed in addition to static")


def _made(
    coulomb: float,
    static: float | None,
    stribeck_speed: float | None,
    stiffness: float,
    damping: float,
) -> LuGre:
    # without effect where static = coulomb
    """The friction of a table: without ``static`` this is the Coulomb torque, and the speed of
    Stribeck has no effect.
    """
    speed = 1.0 if stribeck_speed is None else stribeck_speed
    return LuGre(coulomb, coulomb if static is None else static, speed, stiffness, damping)


LUGRE = Format(
    "friction with a state, by the LuGre law, in addition to the friction of the motor",
    (
        Key(
            "coulomb",
            number(above=0.0),
            "torque F_c at high speed, without viscous friction",
            "N m",
        ),
        Key(
            "static",
            number(above=0.0),
            "torque F_s at the lowest speed; default: coulomb",
            "N m",
            None,
        ),
        Key(
            "stribeck_speed",
            number(above=0.0),
            "speed v_s over which it falls from static to coulomb",
            "rad/s",
            None,
            check=_check_static,
        ),
        Key(
            "stiffness",
            number(above=0.0),
            "stiffness s0 of the bristles before they slip",
            "N m/rad",
        ),
        Key("damping", number(least=0.0), "damping s1 of the bristles", "N m s/rad", 0.0),
    ),
    make=_made,
    definition="lugre",
)
