"""A table of a Fourier sum of an angle: harmonics of a turn, with the coefficients of cosine and
sine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from flexgen.base.spec.keys import Context, Format, Key, Type, list_of, vector
from flexgen.base.spec.tables import Table

HIGHEST = 1000  # harmonic of a turn
MOST = 64  # harmonics of a sum
# rate of a transmission error, motor side: the motor angle behind it is found by a few steps
STEEPEST = 0.5


@dataclass(frozen=True)
class FourierSum:
    """``f(q) = sum_i cos_i cos(k_i q) + sin_i sin(k_i q)`` with the harmonics k_i of a turn, whole
    numbers >= 1.
    """

    harmonics: tuple[int, ...]
    cos: tuple[float, ...]
    sin: tuple[float, ...]

    def bound(self, order: int = 0) -> float:
        """A bound of the absolute value of the derivative of this order:
        ``sum_i k_i^order |(cos_i, sin_i)|``.
        """
        terms = zip(self.harmonics, self.cos, self.sin, strict=True)
        return float(sum(k**order * abs(complex(c, s)) for k, c, s in terms))


def _read_harmonics(table: Table, key: Key, here: Context) -> tuple[int, ...]:
    expected = f"1 to {MOST} different whole numbers from 1 to {HIGHEST}, the harmonics of a turn"
    given = table.plain(key.name, expected)
    found = given if isinstance(given, list) else []
    whole = all(type(x) is int and 1 <= x <= HIGHEST for x in found)
    if not whole or not 1 <= len(found) <= MOST or len(set(found)) < len(found):
        raise table.fail(key.name, expected)
    return tuple(found)


def _check_terms(table: Table, here: Context) -> None:
    count = len(here.values["harmonics"])
    if "cos" not in table and "sin" not in table:
        raise table.fail("cos", "a list cos or sin of numbers, one for each harmonic")
    for name in ("cos", "sin"):
        given = len(here.values[name])
        if name in table and given != count:
            raise table.fail(name, f"{count} numbers, one for each harmonic", f"{given} numbers")


def _made(
    harmonics: tuple[int, ...], cos: tuple[float, ...], sin: tuple[float, ...]
) -> FourierSum:
    """The sum of a table, in which cosines or sines may be left out: zeros."""
    none = (0.0,) * len(harmonics)
    return FourierSum(harmonics, cos or none, sin or none)


_ORDERS = Type(
    _read_harmonics,
    list_of({"type": "integer", "minimum": 1, "maximum": HIGHEST}, range(1, MOST + 1)),
)


def fourier_sum(unit: str, definition: str) -> Format:
    """The table of a Fourier sum with this unit."""
    cos = Key(
        "cos",
        vector(range(1, MOST + 1)),
        "coefficients of cos(k q), one for each harmonic k",
        unit,
        (),
    )
    sin = replace(cos, name="sin", doc="coefficients of sin(k q)", check=_check_terms)
    orders = Key("harmonics", _ORDERS, "whole numbers k of periods in a turn of the motor angle q")
    doc = "sum of cosines and sines of the harmonics of the motor angle"
    return Format(doc, (orders, cos, sin), make=_made, definition=definition)
