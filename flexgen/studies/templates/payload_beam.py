"""An elastic beam as the payload of a robot: one hinge with the numbers of its first mode.

A beam of length L and mass per length mu, clamped at the flange, bends by its first mode
phi(x/L) w, with the natural frequency of Euler and Bernoulli,

    omega = lambda^2 sqrt(E I / (mu L^4)),  lambda = 1.8751: cos(lambda) cosh(lambda) = -1

A point mass m_e on a hinge with a spring moves the flange as this mode does if

    m_e = mu L (int phi)^2 / int phi^2 = 0.6131 mu L,
    its distance from the flange is L int s phi / int phi = 0.7265 L,
    the stiffness of the hinge is k = m_e r^2 omega^2

for any distance r from the hinge to the mass. Gravity along the beam, and the acceleration of the
flange along it, change the stiffness of the mode by mu g int (1 - s) phi'^2, that of the hinge by
m_e g r: they agree with

    r = L int phi^2 / int (1 - s) phi'^2 = L / 1.5709

The rest of the beam is rigid, with the mass, center and inertia that make the whole right: modes
above the first one follow the flange. s = x/L, 0 to 1, all integrals over it.

Source: R. Blevins, Formulas for Natural Frequency and Mode Shape, 1979, table 8-1 (clamped-free);
L. Howell, Compliant Mechanisms, 2001, ch. 5 (hinges in place of beams).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexgen.base.checks.counts import number_in
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.toml_text import toml

LAMBDA = 1.875104068711961  # root of cos(x) cosh(x) = -1, the first one
POINTS = 40  # of a Gauss-Legendre rule: integrals of the mode shape are exact to rounding
KIND = "beam"
DAMPING = 0.02  # ratio of the mode: steel that is screwed to a flange
NEEDED = ("length", "width", "height", "modulus", "density")
OPTIONAL = ("angle_deg", "damping")
EXAMPLE = "beam:length=0.52,width=0.08,height=0.001,modulus=190e9,density=7870,angle_deg=30"
SLENDER = 10.0  # length over height, at least: shear and rotary inertia are below 1 %


@dataclass(frozen=True)
class Beam:
    """A beam from its drawing.

    ``length``, ``width``, ``height`` [m]: height in the direction in which it bends;
    ``modulus``: of Young [Pa]; ``density`` [kg/m^3]; ``angle_deg``: of the beam's axis in the
    plane of the flange, from its x axis about its z axis; ``damping``: ratio of the first mode.
    """

    length: float
    width: float
    height: float
    modulus: float
    density: float
    angle_deg: float = 0.0
    damping: float = DAMPING


@dataclass(frozen=True)
class Hinge:
    """A point mass on a hinge with a spring, and a rigid rest.

    ``frequency_hz``: of the mode; ``mass`` [kg] of the point, ``reach`` [m] from the hinge to it,
    ``offset`` [m] from the flange to the hinge, ``stiffness`` [N m/rad], ``damping`` [N m s/rad];
    ``rest_mass`` [kg], ``rest_com`` [m] along the beam, ``rest_inertia`` (3,) [kg m^2] about its
    center: along the beam, about the axis of bending, and about the direction of bending.
    """

    frequency_hz: float
    mass: float
    reach: float
    offset: float
    stiffness: float
    damping: float
    rest_mass: float
    rest_com: float
    rest_inertia: tuple[float, float, float]


def read_beam(text: str, option: str = "payload") -> Beam:
    """The beam of an option: ``beam:length=0.52,width=...``, in SI units and degrees.

    ``option``: its name, for messages.

    Raises
    ------
    ArgumentError
        Another kind of payload; a key is unknown, missing or given twice; a value is not a number
        in its range.
    """
    kind, _, rest = text.partition(":")
    if kind.strip() != KIND:
        raise ArgumentError(f"{option}: given {kind.strip()!r}, expected {EXAMPLE}")
    values: dict[str, Any] = {}
    for part in rest.split(",") if rest.strip() else ():
        key, _, given = (word.strip() for word in part.partition("="))
        if key not in (*NEEDED, *OPTIONAL) or key in values:
            raise ArgumentError(
                f"{option}: given {key!r}, expected each of {', '.join(NEEDED)} [m, Pa, kg/m^3] "
                f"and at most {', '.join(OPTIONAL)}, once"
            )
        values[key] = _number(option, key, given)
    missing = [key for key in NEEDED if key not in values]
    if missing:
        raise ArgumentError(f"{option}: given no {', '.join(missing)}, expected {EXAMPLE}")
    beam = Beam(**values)
    if beam.length < SLENDER * beam.height:
        raise ArgumentError(
            f"{option}: given a beam of {beam.length:g} m that is {beam.height:g} m high, "
            f"expected at least {SLENDER:g} times as long as high: one that is slender"
        )
    return beam


def _number(option: str, key: str, given: str) -> float:
    """The value of a key, in its range."""
    try:
        value = number_in(given)
    except ValueError:
        value = math.nan
    low = -360.0 if key == "angle_deg" else 0.0
    high = {"angle_deg": 360.0, "damping": 1.0}.get(key, 1e12)
    is_inside = low <= value <= high if key in OPTIONAL else low < value <= high
    if not is_inside:
        bounds = f"{low:g} to {high:g}" if key in OPTIONAL else "> 0"
        raise ArgumentError(f"{option}: {key}: given {given!r}, expected a number {bounds}")
    return value


def hinge_of(beam: Beam) -> Hinge:
    """The hinge with the first mode of a beam; see the head of this module."""
    per_length = beam.density * beam.width * beam.height
    mass = per_length * beam.length
    bending = beam.modulus * beam.width * beam.height**3 / 12.0
    omega = LAMBDA**2 * math.sqrt(bending / (per_length * beam.length**4))
    point, center, softening = mode_numbers()
    moved = point * mass
    at = center * beam.length
    reach = beam.length / softening
    stiffness = moved * reach**2 * omega**2
    rest = mass - moved
    com = (mass * beam.length / 2.0 - moved * at) / rest
    about_flange = mass * beam.length**2 / 3.0 - moved * at**2
    across = about_flange - rest * com**2
    of_width = mass * beam.width**2 / 12.0
    return Hinge(
        frequency_hz=omega / (2.0 * math.pi),
        mass=moved,
        reach=reach,
        offset=at - reach,
        stiffness=stiffness,
        damping=2.0 * beam.damping * stiffness / omega,
        rest_mass=rest,
        rest_com=com,
        rest_inertia=(of_width, across, across + of_width),
    )


def mode_numbers() -> tuple[float, float, float]:
    """Of the first mode: effective mass over that of the beam, its distance from the flange over
    the length, and int (1 - s) phi'^2 / int phi^2.
    """
    nodes, weights = np.polynomial.legendre.leggauss(POINTS)
    s = (nodes + 1.0) / 2.0
    weights = weights / 2.0
    x = LAMBDA * s
    ratio = (math.cosh(LAMBDA) + math.cos(LAMBDA)) / (math.sinh(LAMBDA) + math.sin(LAMBDA))
    shape = np.cosh(x) - np.cos(x) - ratio * (np.sinh(x) - np.sin(x))
    slope = LAMBDA * (np.sinh(x) + np.sin(x) - ratio * (np.cosh(x) - np.cos(x)))
    area = float(weights @ shape)
    power = float(weights @ shape**2)
    moment = float(weights @ (s * shape))
    geometric = float(weights @ ((1.0 - s) * slope**2))
    return area**2 / power, moment / area, geometric / power


def text_of_payload(beam: Beam) -> list[str]:
    """The lines of an overlay with the payload on the tip."""
    hinge = hinge_of(beam)
    inertia = ", ".join(_short(x) for x in hinge.rest_inertia)
    return [
        f"# Payload: a beam, {beam.length:g} x {beam.width:g} x {beam.height:g} m, modulus",
        f"# {beam.modulus:g} Pa, {beam.density:g} kg/m^3, clamped at the tip. First mode at",
        f"# {hinge.frequency_hz:.4g} Hz, damping ratio {beam.damping:g} (ASSUMED unless",
        "# measured): a point mass on a hinge moves the tip as this mode does, the rest is rigid.",
        "# The beam is along x of its frame, bends along z: change origin for another mounting.",
        "[[element]]",
        'name = "payload_root"',
        f"origin = {{ rpy_deg = [0.0, 0.0, {toml(beam.angle_deg)}] }}",
        f"body = {{ mass = {_short(hinge.rest_mass)}, com = [{_short(hinge.rest_com)}, 0.0, 0.0], "
        f"inertia = [{inertia}] }}",
        "",
        "[[element]]",
        'name = "payload_tip"',
        f"origin = {{ position = [{_short(hinge.offset)}, 0.0, 0.0] }}  # m, to the hinge",
        f"body = {{ mass = {_short(hinge.mass)}, com = [{_short(hinge.reach)}, 0.0, 0.0] }}",
        "",
        "[[element.dof]]",
        'name = "payload_bend"',
        'type = "rotation"',
        "axis = [0.0, 1.0, 0.0]",
        f'spring = {{ type = "linear", stiffness = {_short(hinge.stiffness)} }}  # N m/rad',
        f"damping = {_short(hinge.damping)}  # N m s/rad",
        "",
    ]


def _short(value: float) -> str:
    """A number with nine digits."""
    return toml(float(f"{value:.9g}"))
