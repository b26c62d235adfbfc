"""Names of columns in records: quantity, label and unit.

``q_m[m1] rad`` (quantity of a motor), ``q1 deg``, ``q1 [deg]``, ``q1 (deg)`` and ``q1_deg`` (a
word with a unit). A unit that is not known is not taken for a part of the name: a column whose
unit cannot be told is refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.units import CONSTANT, FACTORS, conversion, kind_of

TIMES = ("time", "t", "timestamp")
ALIKE = 10  # names in a message, at most
_LABEL = re.compile(r"(?P<name>[^\[\]()]+)\[(?P<label>[^\[\]]*)\]\s*(?P<unit>.*)\Z", re.DOTALL)
_BRACKETS = re.compile(r"(?P<name>.*\S)\s*(?:\((?P<round>[^()]*)\)|\[(?P<square>[^\[\]]*)\])\Z")


@dataclass(frozen=True)
class Column:
    """Name of a column: quantity, label (None: none) and unit (empty: none stated)."""

    text: str
    name: str
    label: str | None = None
    unit: str = ""

    def factor(self, where: str, si: str, *, plain: bool = False) -> float:
        """Factor to SI; ``plain``: without a unit the column is in SI units.

        Raises
        ------
        ArgumentError
            The unit is missing, not known, or of another kind.
        """
        if not self.unit and plain:
            return 1.0
        if not self.unit:
            name = self.text.strip()
            words = " or ".join(f"'{name} {unit}'" for unit in list(FACTORS[si])[:3])
            raise ArgumentError(
                f"{where}: given the column {name!r} without a unit, expected {words}"
            )
        return conversion(f"{where}: column {self.text.strip()!r}", self.unit, si)


def column_of(text: str) -> Column:
    """The parts of the name of a column."""
    stripped = text.strip()
    found = _LABEL.match(stripped)
    if found and found["unit"].strip():
        return Column(text, found["name"].strip(), found["label"], found["unit"].strip())
    if found and found["label"] and kind_of(found["label"]) is None:
        return Column(text, found["name"].strip(), found["label"])
    bracket = _BRACKETS.match(stripped)
    unit = (bracket["round"] or bracket["square"] or "").strip() if bracket else ""
    if bracket and kind_of(unit) is not None:
        return Column(text, bracket["name"].strip(), None, unit)
    word, _, unit = stripped.partition(" ")
    if unit.strip():
        return Column(text, word, None, unit.strip())
    name, _, unit = stripped.rpartition("_")
    if name and (kind_of(unit) is not None or CONSTANT.match(unit)):
        return Column(text, name, None, unit)
    return Column(text, stripped)


def find_column(
    where: str, header: Sequence[str], name: str, si: str, *, plain: bool = False
) -> tuple[int, float]:
    """Index of the column of a quantity, and the factor to its SI unit.

    Parameters
    ----------
    where : str
        File and line, for the error.
    header : sequence of str
    name : str
        Such as ``q1`` of the columns ``q1_deg`` and ``q1 deg``.
    si : str
        A key of `flexgen.base.spec.units.FACTORS`.
    plain : bool
        Without a unit the column is in SI units.

    Raises
    ------
    ArgumentError
        There is no such column, or there are two; its unit is missing, not known, or of another
        kind.
    """
    columns = [column_of(text) for text in header]
    found = [k for k, c in enumerate(columns) if name in (c.name, c.text) and c.label is None]
    units = list(FACTORS[si])
    words = f"{name}_{units[0]} or {name}_{'deg' if si == 'rad' else units[1]}"
    if len(found) == 1 and not columns[found[0]].unit and not plain:
        raise ArgumentError(
            f"{where}: given no column of {name}, expected one, {words}: the column "
            f"{columns[found[0]].text.strip()!r} states no unit"
        )
    if len(found) == 1:
        return found[0], columns[found[0]].factor(where, si, plain=plain)
    if found:
        raise ArgumentError(f"{where}: given two columns of {name}, expected one, {words}")
    near = [c for c in columns if c.name.startswith(f"{name}_") and not c.unit]
    if near:
        tail = near[0].name.removeprefix(f"{name}_")
        conversion(f"{where}: column {near[0].text.strip()!r}", tail, si)
    shown = ", ".join(text.strip() for text in header[:ALIKE])[:200]
    raise ArgumentError(
        f"{where}: given no column of {name}, expected one, {words}; the columns are {shown}"
    )


def find_time(where: str, header: Sequence[str], *, plain: bool = False) -> tuple[int, float]:
    """Index of the column of the time, and the factor to seconds; see `find_column`."""
    columns = [column_of(text) for text in header]
    found = [k for k, c in enumerate(columns) if c.name.lower() in TIMES and c.label is None]
    if len(found) == 1:
        return found[0], columns[found[0]].factor(where, "s", plain=plain)
    if found:
        raise ArgumentError(f"{where}: given two columns of the time, expected one")
    one = len(header) == 1 and (";" in header[0] or "\t" in header[0])
    more = " and commas between the columns, points in the numbers" if one else ""
    shown = ", ".join(text.strip() for text in header)[:200]
    raise ArgumentError(f"{where}: given the columns {shown}, expected time_s or time_ms{more}")
