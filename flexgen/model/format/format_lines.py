"""Rows of the tables of line elements: springs, gas springs, rods and cables between two
points.
"""

from __future__ import annotations

from dataclasses import replace

from flexgen.base.spec.keys import (
    Context,
    Format,
    Key,
    Kinds,
    choice,
    known,
    name,
    number,
    sub,
    vector,
)
from flexgen.base.spec.lines import (
    ATMOSPHERE,
    Anchor,
    CableLine,
    GasSpringLine,
    Line,
    RodLine,
    SpringLine,
)
from flexgen.base.spec.tables import Table
from flexgen.model.elements import ZERO

ANCHOR = Format(
    "end of a line",
    (
        Key(
            "element",
            known(lambda here: ["base", *here.names["element"]]),
            'element whose body the end is fixed to, or "base"',
        ),
        Key("position", vector(3), "position in the frame of that body", "m", ZERO),
    ),
    make=Anchor,
    definition="anchor",
)


def _check_name(table: Table, here: Context) -> None:
    """Raise an error for the name of another part: numbers are named by their part."""
    for kind in ("element", "coordinate", "motor", "sensor"):
        if here.values["name"] in here.names[kind]:
            raise table.fail("name", f"a name that no {kind} has")


def _check_ends(table: Table, here: Context) -> None:
    if here.values["from"].element == here.values["to"].element:
        raise table.fail(
            "to",
            "a point of another body than that of from: between points of one body no force does "
            "work",
        )


def _check_range(table: Table, here: Context) -> None:
    """Raise an error for limits of the length that no length keeps."""
    low = here.values["length_min"]
    high = here.values["length_max"]
    if low is not None and high is not None and low >= high:
        raise table.fail("length_min", "a smallest length below length_max")


def _check_gas(table: Table, here: Context) -> None:
    """Raise an error for a gas spring whose gas has no volume before the end of its stroke."""
    swept = here.values["area"] * here.values["stroke"]
    if here.values["volume"] <= swept:
        raise table.fail(
            "volume",
            f"a volume of gas above area times stroke, {swept:.6g} m^3: none would be left",
        )
    if here.values["acts"] == "push" and here.values["stroke"] >= here.values["length"]:
        raise table.fail("stroke", "a stroke below the largest length")


_ENDS = (
    Key("from", sub(ANCHOR), "one end", attribute="start"),
    Key("to", sub(ANCHOR), "the other end", attribute="end", check=_check_ends),
)
_SHARED = (
    Key("mass", number(least=0.0), "mass, uniform along the line", "kg", 0.0),
    Key("damping", number(least=0.0), "damping along the line", "N s/m", 0.0),
    Key("length_min", number(least=0.0), "limit of the length", "m", None),
    Key("length_max", number(above=0.0), "limit of the length", "m", None, check=_check_range),
)
_STIFFNESS = Key("stiffness", number(above=0.0), "stiffness along the line", "N/m")
_FREE = Key("length", number(least=0.0), "length without force", "m")
_PRELOAD = Key("preload", number(), "tension at that length", "N", 0.0)
_GAS = (
    Key("area", number(above=0.0), "area on which the gas acts", "m^2"),
    Key("pressure", number(above=0.0), "absolute pressure of the gas at length", "Pa"),
    Key("volume", number(above=0.0), "volume of the gas at length", "m^3"),
    Key(
        "exponent",
        number(least=1.0, most=2.0),
        "n of p V^n = constant: 1 for slow motion, 1.4 for fast motion of a diatomic gas",
    ),
    Key("length", number(above=0.0), "largest length of push, smallest of pull", "m"),
    Key("stroke", number(above=0.0), "way from length to the other end", "m"),
    Key("ambient_pressure", number(least=0.0), "absolute pressure outside", "Pa", ATMOSPHERE),
    Key(
        "acts",
        choice("push", "pull"),
        "whether the gas pushes the ends apart or pulls them together",
        default="push",
        check=_check_gas,
    ),
)


def _kind(doc: str, make: type[Line], *own: Key) -> Format:
    """The table of a kind of line: its two ends, its ``own`` keys, and those of all lines."""
    return Format(doc, (*_ENDS, *own, *_SHARED), make)


_AT = replace(_FREE, doc="length at which its tension is preload")
LINE = Kinds(
    "line element between two points",
    {
        "spring": _kind(
            "tension = preload + stiffness (l - length), also a spring balancer",
            SpringLine,
            _STIFFNESS,
            _AT,
            _PRELOAD,
        ),
        "gas_spring": _kind("gas of p V^n = constant in a cylinder", GasSpringLine, *_GAS),
        "rod": _kind(
            "tension = stiffness (l - length)",
            RodLine,
            Key(
                "stiffness",
                number(least=0.0),
                "stiffness along the line, E A / length; 0: a loop keeps the length",
                "N/m",
            ),
            replace(_FREE, type=number(above=0.0)),
        ),
        "cable": _kind(
            "tension = stiffness (x + sqrt(x^2 + smoothing^2)) / 2, never a push, with "
            "x = l - length + preload / stiffness",
            CableLine,
            _STIFFNESS,
            _AT,
            replace(_PRELOAD, type=number(least=0.0)),
            Key("smoothing", number(above=0.0), "rounds the change from slack to taut", "m"),
        ),
    },
    shared=(Key("name", name("line"), "name of the line", check=_check_name),),
    definition="line",
)
