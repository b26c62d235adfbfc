"""Data classes of parts of a model: friction laws, slender elastic links, and how accurate the
numbers are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.arguments import is_number

# whose standard deviations are relative
KINDS = ("stiffness", "damping", "friction", "masses", "motor_inertia", "lost_motion")


@dataclass(frozen=True)
class Tolerances:
    """Relative standard deviations of all numbers of a kind, or by name (names as in
    `flexgen.derive`).

    ``payload`` [kg]; ``delay`` [s] of the drives; ``misfit``: rms of the errors of positions that
    no number explains, over the elastic displacement; ``common``: kinds with one relative error;
    ``correlation``: of the named ones, row by row.
    """

    stiffness: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    masses: float = 0.0
    motor_inertia: float = 0.0
    lost_motion: float = 0.0
    payload: float = 0.0
    delay: float = 0.0
    misfit: float = 0.0
    common: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    sd: tuple[float, ...] = ()
    correlation: tuple[float, ...] = ()


@dataclass(frozen=True)
class Bending:
    """Bending of a beam in one direction (``"y"`` or ``"z"``): flexural stiffness EI [N m^2],
    modes, damping ratio.
    """

    direction: str
    stiffness: float
    modes: int
    damping_ratio: float


@dataclass(frozen=True)
class Torsion:
    """Torsion of a beam about its axis: torsional stiffness G J [N m^2], polar moment of inertia
    per length [kg m], modes, damping ratio.
    """

    stiffness: float
    inertia_per_length: float
    modes: int
    damping_ratio: float


@dataclass(frozen=True)
class Stretch:
    """Elongation of a beam along its axis: axial stiffness E A [N], modes, damping ratio."""

    stiffness: float
    modes: int
    damping_ratio: float


@dataclass(frozen=True)
class BeamTip:
    """Rigid body at the end of a beam for which its modes are computed: mass [kg] and moments of
    inertia [kg m^2] about x, y and z of the tip.

    Only the shapes of the modes depend on it: its mass is that of the payload or of the elements
    that follow.
    """

    mass: float = 0.0
    inertia: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Beam:
    """A slender elastic link along the x axis of its body's frame, clamped at the origin
    (Euler-Bernoulli).

    Its deflection is a sum of modes that are clamped at the origin and carry ``tip`` at the end;
    each modal coordinate is a non-actuated coordinate: deflection of the tip in its mode [m], or
    twist of the tip [rad]. Foreshortening is neglected. ``length`` [m], ``mass_per_length``
    [kg/m]; ``axial_load`` [N]: constant tension along the beam, negative where it is compressed.
    """

    length: float
    mass_per_length: float
    bendings: tuple[Bending, ...]
    torsion: Torsion | None = None
    stretch: Stretch | None = None
    tip: BeamTip | None = None
    axial_load: float = 0.0


def friction_key(
    unit: str,
    doc: str = "",
    *,
    signed: bool = False,
    needs: str = "",
    most: float = math.inf,
    default: float = 0.0,
    alone: bool = False,
) -> Any:
    """A number of a friction law, which is also a key of the model file.

    ``unit`` is that of a rotation; ``[]`` in the text is replaced by it. A number that is not
    ``signed`` must be >= 0, and none above ``most``. ``needs`` names other numbers that must be >
    0 where this one is not 0. A number that is ``alone`` is a run-time parameter by its own name
    only, and no plant with another friction changes it.
    """
    return field(
        default=default,
        metadata={
            "unit": unit,
            "doc": doc,
            "signed": signed,
            "needs": needs,
            "most": most,
            "alone": alone,
        },
    )


@dataclass(frozen=True)
class Friction:
    """The default friction law, ``type = "smooth"``: torque against the speed w.

    ``f(w) = viscous w + (coulomb + stribeck / cosh(alpha w)) tanh(beta w) + offset``. The offset
    makes it asymmetric. The base of all friction laws.
    """

    about: ClassVar[str] = "friction torque against the speed"

    viscous: float = friction_key("N m s/rad", "viscous friction")
    coulomb: float = friction_key(
        "N m", "Coulomb friction [], smoothed by tanh(beta speed)", needs="beta"
    )
    stribeck: float = friction_key(
        "N m",
        "Stribeck friction at low speed []: stribeck / cosh(alpha speed)",
        needs="beta alpha",
    )
    alpha: float = friction_key("s/rad", "decay of the Stribeck friction with the speed")
    beta: float = friction_key("s/rad", "steepness of the Coulomb friction at zero speed")
    offset: float = friction_key("N m", "constant torque against positive motion", signed=True)

    @property
    def loaded(self) -> bool:
        """Whether it depends on the torque of the gear."""
        return False

    def __post_init__(self) -> None:
        """ArgumentError for a number without effect, as ``coulomb`` without ``beta``."""
        for key in fields(self):
            for needed in key.metadata.get("needs", "").split():
                if _is_zero(getattr(self, needed)) and not _is_zero(
                    value := getattr(self, key.name)
                ):
                    raise ArgumentError(
                        f"friction: given {key.name} = {value} with {needed} = 0, expected "
                        f"{needed} > 0 together with {key.name}: without it the friction has no "
                        "effect"
                    )

    def viscous_at(self, temperature: float) -> float:
        """Viscous friction [N m s/rad] at a temperature [deg C]."""
        return self.viscous


def _is_zero(x: Any) -> bool:
    """Whether a number is zero; symbols in its place are not."""
    return is_number(x) and float(x) == 0.0


@dataclass(frozen=True)
class GearFriction(Friction):
    """Friction of a motor and its gear, ``type = "gear"``: against speed w, gear torque tau and
    temperature T.

        f = F_v w + offset + tanh(beta w) (coulomb + load_coulomb L
            + F_s / cosh(a w) + load_stribeck L / cosh(load_alpha w))
        L = sqrt(tau^2 + s^2) - s,    s = load_smoothing,    d = T + temperature_rise - T_r

        F_v = viscous (1 - viscous_share + viscous_share exp(-d / viscous_decay))
        F_s = max(0, stribeck + stribeck_slope d),
        a = alpha / max(0.01, 1 + alpha stribeck_speed_slope d)

    tau: torque of the gear on the motor side; T: `RobotModel.temperature`; T_r:
    ``reference_temperature``.

    Source: A. C. Bittencourt, S. Gunnarsson, ASME J. Dyn. Syst. Meas. Control 134(5), 2012.
    """

    about: ClassVar[str] = (
        "friction torque of a motor against speed, torque of its gear and temperature"
    )

    load_coulomb: float = friction_key(
        "N m/N m",
        "Coulomb friction for each N m of gear torque on the motor side",
        needs="beta load_smoothing",
    )
    load_stribeck: float = friction_key(
        "N m/N m",
        "the same of Stribeck friction at low speed",
        needs="beta load_alpha load_smoothing",
    )
    load_alpha: float = friction_key("s/rad", "decay of load_stribeck with the speed")
    load_smoothing: float = friction_key(
        "N m",
        "rounds the magnitude of the gear torque at zero: sqrt(torque^2 + load_smoothing^2) - "
        "load_smoothing",
        alone=True,
    )
    reference_temperature: float = friction_key(
        "deg C",
        "temperature at which viscous, stribeck and alpha hold",
        signed=True,
        default=20.0,
        alone=True,
    )
    temperature_rise: float = friction_key(
        "K", "temperature of this motor above that of the robot", signed=True, alone=True
    )
    viscous_share: float = friction_key(
        "",
        "part of the viscous friction, at most 1, that decays with the temperature",
        needs="viscous_decay",
        most=1.0,
    )
    viscous_decay: float = friction_key("K", "temperature over which it decays by the factor e")
    stribeck_slope: float = friction_key(
        "N m/K", "change of stribeck", signed=True, needs="beta alpha"
    )
    stribeck_speed_slope: float = friction_key(
        "rad/s/K", "change of the speed 1/alpha", signed=True, needs="alpha"
    )

    def viscous_at(self, temperature: float) -> float:
        """Viscous friction F_v [N m s/rad] at a temperature of the robot [deg C]."""
        if self.viscous_share == 0.0:
            return self.viscous
        warmer = temperature + self.temperature_rise - self.reference_temperature
        return self.viscous * (1 + self.viscous_share * math.expm1(-warmer / self.viscous_decay))

    @property
    def loaded(self) -> bool:
        """Whether it depends on the torque of the gear, with ``load_smoothing`` > 0 or a run-time
        parameter.
        """
        return not isinstance(self.load_smoothing, (int, float)) or self.load_smoothing != 0.0
