"""Data classes of two optional parts of a model: slender elastic links, and how accurate the numbers are."""

from __future__ import annotations

from dataclasses import dataclass

KINDS = ("stiffness", "damping", "friction", "masses", "motor_inertia")  # whose standard deviations are relative


@dataclass(frozen=True)
class Tolerances:
    """Relative standard deviations of all numbers of a kind, or by name (names as in `flexgen.derive`).

    ``payload`` [kg]; ``common``: kinds with one relative error; ``correlation``: of the named ones, row by row.
    """

    stiffness: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    masses: float = 0.0
    motor_inertia: float = 0.0
    payload: float = 0.0
    common: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    sd: tuple[float, ...] = ()
    correlation: tuple[float, ...] = ()


@dataclass(frozen=True)
class Bending:
    """Bending of a beam in one direction (``"y"`` or ``"z"``): flexural stiffness EI [N m^2], modes, damping ratio."""

    direction: str
    stiffness: float
    modes: int
    damping_ratio: float


@dataclass(frozen=True)
class Beam:
    """A slender elastic link along the x axis of its body's frame, clamped at the origin (Euler-Bernoulli).

    Its deflection is a sum of clamped-free modes; each modal coordinate (tip deflection of the mode [m]) is a
    non-actuated coordinate. Foreshortening is neglected. ``length`` [m], ``mass_per_length`` [kg/m].
    """

    length: float
    mass_per_length: float
    bendings: tuple[Bending, ...]
