"""Columns of a table of Denavit-Hartenberg parameters: names, units and factors to SI units."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

DEGREE = math.pi / 180.0
ARCMIN = DEGREE / 60.0
RPM = 2.0 * math.pi / 60.0

Units = Mapping[str, float]

NO_UNIT: Units = {"": 1.0}
ANGLE: Units = {"deg": DEGREE, "rad": 1.0, "arcmin": ARCMIN}
LENGTH: Units = {"mm": 1e-3, "m": 1.0, "cm": 1e-2}
MASS: Units = {"kg": 1.0, "g": 1e-3}
INERTIA: Units = {
    "kg m^2": 1.0,
    "kg cm^2": 1e-4,
    "kg mm^2": 1e-6,
    "g cm^2": 1e-7,
    "g mm^2": 1e-9,
}
TORQUE: Units = {"N m": 1.0, "kN m": 1e3, "N cm": 1e-2, "mN m": 1e-3}
SPEED: Units = {"deg/s": DEGREE, "rad/s": 1.0, "rpm": RPM, "1/min": RPM, "r/min": RPM}
SPEED_TRANSLATION: Units = {"mm/s": 1e-3, "m/s": 1.0}
STIFFNESS: Units = {
    "N m/arcmin": 1.0 / ARCMIN,
    "kN m/arcmin": 1e3 / ARCMIN,
    "N m/rad": 1.0,
    "kN m/rad": 1e3,
    "N m/deg": 1.0 / DEGREE,
}
STIFFNESS_TRANSLATION: Units = {"N/um": 1e6, "N/mm": 1e3, "N/m": 1.0, "kN/mm": 1e6}
DAMPING: Units = {"N m s/rad": 1.0, "N m s/deg": 1.0 / DEGREE}
DAMPING_TRANSLATION: Units = {"N s/m": 1.0, "N s/mm": 1e3}
FRACTION: Units = {"": 1.0, "1": 1.0, "%": 1e-2}
RATIO_TRANSLATION: Units = {"rad/m": 1.0, "rad/mm": 1e3}
VISCOUS: Units = {"N m s/rad": 1.0, "mN m s/rad": 1e-3, "N m/rpm": 1.0 / RPM}
STEEPNESS: Units = {"s/rad": 1.0}


@dataclass(frozen=True)
class Column:
    """A quantity of the table.

    ``units``: of a rotation or of any row; ``translation``: of a translation, where they differ.
    ``least``, ``above``: smallest value, and the value that it must exceed; ``other``: further
    names.
    """

    name: str
    text: str
    units: Units
    translation: Units | None = None
    other: tuple[str, ...] = ()
    least: float | None = None
    above: float | None = None
    not_zero: bool = False

    def units_of(self, kind: str) -> Units:
        """The units of a row of this type."""
        return self.translation if kind == "translation" and self.translation else self.units

    def all_units(self) -> list[str]:
        """The units of all types."""
        return [*self.units, *(unit for unit in self.translation or {} if unit not in self.units)]


_JOINT = (
    Column("a", "distance along x", LENGTH, other=("a_prev", "a_i_1")),
    Column("alpha", "angle about x", ANGLE, other=("alpha_prev", "alpha_i_1")),
    Column("d", "distance along z", LENGTH),
    Column("theta", "constant part of the angle about z", ANGLE, other=("theta_offset", "offset")),
    Column("direction", "1, or -1 where the axis turns against z", NO_UNIT, other=("sign",)),
    Column("lower", "limit of the joint", ANGLE, LENGTH, ("min", "lower_limit")),
    Column("upper", "limit of the joint", ANGLE, LENGTH, ("max", "upper_limit")),
    Column("home", "position of the joint where moves begin", ANGLE, LENGTH),
    Column(
        "joint_speed_max",
        "largest speed of the joint",
        SPEED,
        SPEED_TRANSLATION,
        ("joint_speed", "axis_speed"),
        above=0.0,
    ),
)
_BODY = (
    Column("mass", "mass of the link", MASS, least=0.0),
    *(
        Column(
            f"com_{axis}", "center of mass in the frame of the link", LENGTH, other=(f"c{axis}",)
        )
        for axis in "xyz"
    ),
    *(
        Column(
            f"i{pair}",
            "inertia about the center of mass, axes of the frame of the link",
            INERTIA,
            other=(f"i_{pair}",),
        )
        for pair in ("xx", "yy", "zz", "xy", "yz", "xz")
    ),
)
_DRIVE = (
    Column(
        "ratio",
        "motor angle / joint angle",
        NO_UNIT,
        RATIO_TRANSLATION,
        ("gear_ratio",),
        not_zero=True,
    ),
    Column("lead", "travel per turn of the motor", LENGTH, other=("pitch",), not_zero=True),
    Column(
        "gear_stiffness",
        "stiffness of the gear on the side of the joint",
        STIFFNESS,
        STIFFNESS_TRANSLATION,
        ("stiffness",),
        above=0.0,
    ),
    Column(
        "gear_damping",
        "damping of the gear on the side of the joint",
        DAMPING,
        DAMPING_TRANSLATION,
        ("damping",),
        least=0.0,
    ),
    Column("damping_ratio", "damping ratio of the gear", FRACTION, least=0.0),
    Column(
        "rotor_inertia",
        "of rotor, brake and input of the gear, at the motor",
        INERTIA,
        other=("motor_inertia",),
        above=0.0,
    ),
    Column(
        "torque_max", "largest torque of the motor", TORQUE, other=("motor_torque",), above=0.0
    ),
    Column(
        "speed_max",
        "largest speed of the motor",
        SPEED,
        other=("motor_speed", "motor_speed_max"),
        above=0.0,
    ),
    Column("coulomb", "Coulomb friction at the motor", TORQUE, least=0.0),
    Column("viscous", "viscous friction at the motor", VISCOUS, least=0.0),
    Column("beta", "steepness of Coulomb friction at rest", STEEPNESS, above=0.0),
)
COLUMNS = {column.name: column for column in (*_JOINT, *_BODY, *_DRIVE)}
TEXTS = {"name": ("joint",), "type": ("kind",)}
PREVIOUS = ("a_prev", "alpha_prev", "a_i_1", "alpha_i_1")

_NAMES = {
    name: column.name for column in COLUMNS.values() for name in (column.name, *column.other)
}
_NAMES |= {name: key for key, other in TEXTS.items() for name in (key, *other)}


def column_name(text: str) -> str:
    """A name as it is compared: small letters, with underscores."""
    return re.sub(r"[^a-z0-9]+", "_", text.strip().lower()).strip("_")


def known_name(text: str) -> str | None:
    """The name of the column in `COLUMNS` or `TEXTS`; None where there is none."""
    return _NAMES.get(column_name(text))


def known_names() -> list[str]:
    """All names that a header may have."""
    return sorted(_NAMES)


def _plain(unit: str) -> str:
    """A unit without spaces, powers and products, as it is compared."""
    text = unit.replace("²", "2").replace("°", "deg").replace("µ", "u").replace("μ", "u")
    return re.sub(r"[\s^*·⋅.]", "", text)


def find_unit(given: str, units: list[str]) -> str | None:
    """The unit that a text of the header means, such as ``Nm/arcmin`` or ``kg*cm²``; else None."""
    return next((unit for unit in units if _plain(unit) == _plain(given)), None)
