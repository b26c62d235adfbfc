"""Units of recorded quantities, by the SI unit of their kind: what files may state, and the factor
to SI.

Spelling: ``N m``, ``Nm``, ``N*m`` and ``N·m`` are one unit, and so are ``us`` and ``µs``, ``deg``
and ``°``. A current becomes a torque by a constant [N m/A], which a record does not have.
"""

from __future__ import annotations

import math
import re

from flexgen.base.checks.counts import number_in
from flexgen.base.errors import ArgumentError

DEGREE = math.pi / 180
TURN = 2 * math.pi

# Factors to the SI unit by which the kind is named. The first unit of each kind is that SI unit.
FACTORS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "rad": {
        "rad": 1.0,
        "mrad": 1e-3,
        "urad": 1e-6,
        "deg": DEGREE,
        "arcmin": DEGREE / 60,
        "rev": TURN,
    },
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6},
    "rad/s": {
        "rad/s": 1.0,
        "mrad/s": 1e-3,
        "deg/s": DEGREE,
        "rpm": TURN / 60,
        "rev/min": TURN / 60,
        "rev/s": TURN,
    },
    "m/s": {"m/s": 1.0, "mm/s": 1e-3, "m/min": 1 / 60},
    "rad/s^2": {"rad/s^2": 1.0, "deg/s^2": DEGREE, "rev/s^2": TURN},
    "m/s^2": {"m/s^2": 1.0, "mm/s^2": 1e-3, "g": 9.80665},
    "N m": {"N m": 1.0, "N cm": 1e-2, "N mm": 1e-3, "mN m": 1e-3, "kN m": 1e3},
    "N": {"N": 1.0, "kN": 1e3, "mN": 1e-3},
}
CURRENTS = {"A": 1.0, "mA": 1e-3}
VOLTAGES = {"V": 1.0, "mV": 1e-3}
# What a torque may be recorded as, with a constant [N m/A or N m/V].
ELECTRIC = {**CURRENTS, **VOLTAGES}
KINDS = {
    "s": "a time",
    "rad": "an angle",
    "m": "a length",
    "rad/s": "a speed of rotation",
    "m/s": "a speed",
    "rad/s^2": "an angular acceleration",
    "m/s^2": "an acceleration",
    "N m": "a torque",
    "N": "a force",
}
ELECTRIC_WORDS = {"A": "a current", "V": "a voltage"}
SPELLINGS = {"degree": "deg", "degrees": "deg", "turn": "rev", "sec": "s"}
CONSTANT = re.compile(
    r"(?P<given>m?(?P<letter>[AV]))\s*\(\s*(?P<constant>[^()]*?)\s*N[ *·]?m/(?P=letter)\s*\)\Z"
)


def spelling(unit: str) -> str:
    """The unit without what its spellings differ in: spaces, signs of products, Greek letters."""
    text = unit.strip().replace("µ", "u").replace("μ", "u").replace("²", "^2").replace("°", "deg")
    text = re.sub(r"[\s*·]+", "", text)
    return SPELLINGS.get(text, text)


def factor_of(unit: str, si: str) -> float | None:
    """Factor from a unit to the SI unit of the same kind; None: not a unit of this kind."""
    word = spelling(unit)
    return next((x for name, x in FACTORS[si].items() if spelling(name) == word), None)


def kind_of(unit: str) -> str | None:
    """The SI unit of the kind of a unit, ``"A"`` for a current, ``"V"`` for a voltage; None: not a
    known unit.
    """
    for si, units in (("A", CURRENTS), ("V", VOLTAGES)):
        if any(spelling(name) == spelling(unit) for name in units):
            return si
    return next((si for si in FACTORS if factor_of(unit, si) is not None), None)


def expected_units(si: str) -> str:
    """The units of a kind, for a message."""
    return f"{KINDS[si]} in {', '.join(FACTORS[si])}"


def conversion(where: str, unit: str, si: str, constant: float | None = None) -> float:
    """Factor to SI of a column.

    Parameters
    ----------
    where : str
        File and column, for the error.
    unit : str
        As the file states it. Also ``A (0.12 N m/A)`` or ``V (0.1 N m/V)``, a current or a voltage
        with its constant.
    si : str
        A key of `FACTORS`.
    constant : float, optional [N m/A or N m/V]
        Of a torque that is recorded as a current or a voltage.

    Raises
    ------
    ArgumentError
        The unit is not known, or is of another kind; a current or voltage has no constant.
    """
    own = CONSTANT.match(unit.strip())
    if own is not None:
        unit = own["given"]
        constant = _constant(where, own["constant"], own["letter"])
    factor = factor_of(unit, si)
    if factor is not None:
        return factor
    kind = kind_of(unit)
    if kind in ELECTRIC and si == "N m":
        if constant is None:
            raise ArgumentError(
                f"{where}: given {ELECTRIC_WORDS[kind]} in {unit}, expected a torque in "
                f"{', '.join(FACTORS[si])}; state the constant of the axis in the unit of the "
                f"column: '{unit} (0.12 N m/{kind})', or as constant = 0.12 in a description file"
            )
        size = next(x for name, x in ELECTRIC.items() if spelling(name) == spelling(unit))
        return constant * size
    given = "an unknown unit" if kind is None else (KINDS | ELECTRIC_WORDS)[kind]
    raise ArgumentError(f"{where}: given {unit!r}, {given}, expected {expected_units(si)}")


def _constant(where: str, text: str, letter: str) -> float:
    """The constant [N m/A or N m/V] of a unit such as ``A (0.12 N m/A)``; ArgumentError unless it
    is above zero.
    """
    try:
        constant = number_in(text)
    except ValueError:
        constant = math.nan
    if not (math.isfinite(constant) and constant > 0.0):
        raise ArgumentError(
            f"{where}: given the constant {text!r}, expected a number > 0 [N m/{letter}], "
            f"such as '{letter} (0.12 N m/{letter})'"
        )
    return constant
