"""Line elements as CasADi graphs: length and rate, energies, and tension.

    d = p2 - p1,    l = |d|,    l' = d.(v2 - v1)/l,
    T = m/6 (v1.v1 + v1.v2 + v2.v2),    V_g = -m g.(p1 + p2)/2
    forces on the coordinates  -(dl/dq)' F(l, l'),    F: the tension

The laws of the tension: `flexgen.base.spec.lines`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from flexgen.base.spec.arguments import is_number
from flexgen.base.spec.lines import CableLine, GasSpringLine, Line, RodLine, SpringLine


@dataclass(frozen=True)
class LineMotion:
    """Motion of a line: its ends in the world ``points`` (3, 2) [m], its ``length`` [m] and
    ``rate`` [m/s], and the energies of its mass, ``kinetic`` and ``gravity`` [J].
    """

    line: Line
    points: ca.SX
    length: ca.SX
    rate: ca.SX
    kinetic: ca.SX
    gravity: ca.SX

    @property
    def tension(self) -> ca.SX:
        """Force [N] that pulls the ends together, with that of the damper."""
        return elastic_tension(self.line, self.length) + self.damping_force

    @property
    def damping_force(self) -> ca.SX:
        """Part of the tension that the damper gives [N]."""
        return self.line.damping * _engagement(self.line, self.length) * self.rate

    @property
    def energy(self) -> ca.SX:
        """Energy that the spring or gas stores [J], up to a constant."""
        return stored_energy(self.line, self.length)


def line_motion(line: Line, points: ca.SX, velocities: ca.SX, gravity: ca.SX) -> LineMotion:
    """The motion of a line from the ``points`` (3, 2) [m] at its ends and their ``velocities``
    (3, 2) [m/s], in the world. ``gravity`` (3) [m/s^2].
    """
    first, second = ca.horzsplit(points)
    v1, v2 = ca.horzsplit(velocities)
    way = second - first
    length = ca.sqrt(ca.dot(way, way))
    kinetic = gravitational = ca.SX(0)
    if not (is_number(line.mass) and line.mass == 0.0):
        squares = ca.dot(v1, v1) + ca.dot(v1, v2) + ca.dot(v2, v2)
        kinetic = line.mass / 6 * squares
        gravitational = -line.mass / 2 * ca.dot(gravity, first + second)
    return LineMotion(
        line=line,
        points=points,
        length=length,
        rate=ca.dot(way, v2 - v1) / length,
        kinetic=kinetic,
        gravity=gravitational,
    )


def elastic_tension(line: Line, length: Any) -> Any:
    """Tension [N] of a line at rest at a length [m]."""
    if isinstance(line, GasSpringLine):
        ratio = line.volume / _gas_volume(line, length)
        pressure = line.pressure * _power(ratio, line.exponent)
        return -line.sign * line.area * (pressure - line.ambient_pressure)
    if isinstance(line, CableLine):
        x = _stretch(line, length)
        return line.stiffness * (x + ca.sqrt(x**2 + line.smoothing**2)) / 2
    if isinstance(line, SpringLine):
        return line.preload + line.stiffness * (length - line.length)
    assert isinstance(line, RodLine)  # the last of the kinds
    return line.stiffness * (length - line.length)


def stored_energy(line: Line, length: Any) -> Any:
    """Energy [J] whose derivative in the length is `elastic_tension`."""
    if isinstance(line, GasSpringLine):
        outside = line.sign * line.ambient_pressure * line.area * (length - line.length)
        ratio = line.volume / _gas_volume(line, length)
        if is_number(line.exponent) and line.exponent == 1.0:
            return line.pressure * line.volume * ca.log(ratio) + outside
        n = line.exponent
        work = (_power(ratio, n - 1.0) - 1.0) / (n - 1.0)
        return line.pressure * line.volume * work + outside
    if isinstance(line, CableLine):
        x = _stretch(line, length)
        width = line.smoothing
        root = ca.sqrt(x**2 + width**2)
        return line.stiffness / 4 * (x**2 + x * root + width**2 * ca.asinh(x / width))
    assert isinstance(line, SpringLine | RodLine)  # the others are above
    x = length - line.length
    preload = line.preload if isinstance(line, SpringLine) else 0.0
    return preload * x + line.stiffness * x**2 / 2


def _gas_volume(line: GasSpringLine, length: Any) -> Any:
    """Volume [m^3] of the gas at a length."""
    return line.volume + line.sign * line.area * (length - line.length)


def _power(base: Any, exponent: Any) -> Any:
    """A power > 0; one of 0, 1 or 2 without a function of the library for mathematics."""
    if is_number(exponent) and exponent in (0.0, 1.0, 2.0):
        return {0.0: 1.0, 1.0: base, 2.0: base * base}[float(exponent)]
    return ca.exp(exponent * ca.log(base))


def _stretch(line: CableLine, length: Any) -> Any:
    """Length [m] of a cable beyond that at which its tension is zero but for the rounding."""
    return length - line.length + line.preload / line.stiffness


def _engagement(line: Line, length: Any) -> Any:
    """Part of the damping that acts, between 0 of a slack cable and 1."""
    if not isinstance(line, CableLine):
        return 1.0
    x = _stretch(line, length)
    return (1 + x / ca.sqrt(x**2 + line.smoothing**2)) / 2
