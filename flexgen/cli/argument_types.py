"""Types of arguments of the command line: each turns a text into a value, or states what was
expected.
"""

from __future__ import annotations

import argparse
import math
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from flexgen.base.checks.counts import number_in

_DISTURBANCE = re.compile(
    r"(?P<kind>\w+):(?P<where>[\w.]+)=(?P<size>[-+.\deE]+)@(?P<start>[-+]?[.\d]+(?:[eE][-+]?\d+)?)"
    r"(?:\+(?P<length>[.\d]+(?:[eE][-+]?\d+)?))?(?:,(?P<low>[.\deE]+)-(?P<high>[.\deE]+))?\Z"
)


def numbers(text: str) -> list[float]:
    """Numbers with commas between them."""
    try:
        values = [number_in(part) for part in text.split(",")]
    except ValueError:
        values = [math.nan]
    if not all(math.isfinite(value) for value in values):
        raise argparse.ArgumentTypeError(
            f"given {text!r}, expected numbers such as 0.3 -1.1 0 or 0.3,-1.1,0"
        )
    return values


def pose(text: str) -> list[float]:
    """Joint positions [rad or m] of one pose."""
    return numbers(text)


def integers(text: str) -> list[int]:
    """Integers with commas between them."""
    if not re.fullmatch(r"[0-9]{1,9}(,[0-9]{1,9})*", text):
        raise argparse.ArgumentTypeError(
            f"given {text[:40]!r}, expected integers such as 1 2 6 or 1,2,6"
        )
    return [int(part) for part in text.split(",")]


def _number(text: str) -> float:
    """One finite number, else NaN."""
    try:
        value = number_in(text)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def names(text: str) -> tuple[str, ...]:
    """Names with commas between them."""
    return tuple(word.strip() for word in text.split(","))


def positive(text: str) -> float:
    """A number > 0."""
    value = _number(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"given {text!r}, expected a number > 0, such as 0.01")
    return value


def not_negative(text: str) -> float:
    """A number >= 0."""
    value = _number(text)
    if not value >= 0:
        raise argparse.ArgumentTypeError(
            f"given {text!r}, expected a number >= 0, such as 0 or 0.01"
        )
    return value


def number(text: str) -> float:
    """A finite number."""
    value = _number(text)
    if math.isnan(value):
        raise argparse.ArgumentTypeError(f"given {text!r}, expected a number, such as 0.01")
    return value


def integer(text: str) -> int:
    """An integer."""
    if not re.fullmatch(r"[-+]?[0-9]{1,18}", text):
        raise argparse.ArgumentTypeError(f"given {text[:40]!r}, expected an integer")
    return int(text)


def whole(least: int) -> Callable[[str], int]:
    """The type of integers that are at least this."""

    def parse(text: str) -> int:
        if not re.fullmatch(r"[0-9]{1,18}", text) or int(text) < least:
            raise argparse.ArgumentTypeError(
                f"given {text[:40]!r}, expected an integer >= {least}"
            )
        return int(text)

    return parse


def spectrum(text: str) -> float | str:
    """A power of the frequency, or ``optimal``."""
    if text == "optimal":
        return text
    value = _number(text)
    if math.isnan(value):
        raise argparse.ArgumentTypeError(
            f"given {text!r}, expected a number such as 0.5, or optimal"
        )
    return value


def factor_or_file(text: str) -> float | Path:
    """A number that is not negative, or the path of a file."""
    value = _number(text)
    return file_path(text) if math.isnan(value) else not_negative(text)


def _file(text: str, *endings: str) -> Path:
    """A file name with one of these endings."""
    path = Path(text)
    if path.suffix not in endings:
        expected = " or ".join(filter(None, (", ".join(endings[:-1]), endings[-1])))
        raise argparse.ArgumentTypeError(
            f"given {text!r}, expected a file name ending in {expected}"
        )
    return path


def trajectory_file(text: str) -> Path:
    """A file name ending in .npz, .csv or .mat."""
    return _file(text, ".npz", ".csv", ".mat")


def positions_file(text: str) -> Path:
    """A file name ending in .csv, .npz, .mat or .json."""
    return _file(text, ".csv", ".npz", ".mat", ".json")


def npz_file(text: str) -> Path:
    """A file name ending in .npz."""
    return _file(text, ".npz")


def toml_file(text: str) -> Path:
    """A file name ending in .toml."""
    return _file(text, ".toml")


def text(text: str) -> str:
    """Any text."""
    return text


def file_path(text: str) -> Path:
    """A path."""
    if not text or "\0" in text:
        raise argparse.ArgumentTypeError(f"given {text!r}, expected a path")
    return Path(text)


def isa(text: str) -> str:
    """An instruction set; ``v3`` means ``x86-64-v3``."""
    return f"x86-64-{text}" if re.fullmatch(r"v\d", text) else text


def setting(text: str) -> tuple[str, Any]:
    """A key and its value in TOML."""
    key, equals, value = text.partition("=")
    try:
        parsed = tomllib.loads(f"value = {value}")
    except (ValueError, RecursionError):  # ValueError: integers of thousands of digits too
        parsed = {}
    if not key.strip() or not equals or list(parsed) != ["value"]:
        hint = "such as motor.m1.inertia=0.004 or 'output.axes=\"xy\"' (text in quotes)"
        raise argparse.ArgumentTypeError(
            f"given {text!r}, expected KEY=VALUE with a TOML value, {hint}"
        )
    return key.strip(), parsed["value"]


def plant(text: str) -> tuple[str, dict[str, float]]:
    """``NAME:stiffness=0.8,payload=5``; without a name the text itself is the name."""
    name, colon, rest = text.partition(":")
    changes: dict[str, float] = {}
    for item in (rest if colon else text).split(","):
        key, equals, value = item.partition("=")
        try:
            changes[key.strip()] = number_in(value)
        except ValueError:
            equals = ""
        if not equals or not key.strip():
            raise argparse.ArgumentTypeError(
                f"given {text!r}, expected such as soft:stiffness=0.8,payload=5"
            )
    return (name if colon else text), changes


def changes(text: str) -> dict[str, float]:
    """Changes of a plant as in `plant`, without its name."""
    return plant(text)[1]


def disturbance(text: str) -> dict[str, Any]:
    """``KIND:WHERE=SIZE@START+LENGTH,LOW-HIGH``; length and frequencies where the kind has
    them.
    """
    found = _DISTURBANCE.match(text)
    try:
        if found is None:
            raise ValueError
        band = (number_in(found["low"]), number_in(found["high"])) if found["low"] else None
        return {
            "kind": found["kind"],
            "where": found["where"],
            "size": number_in(found["size"]),
            "start_s": number_in(found["start"]),
            "length_s": number_in(found["length"]) if found["length"] else None,
            "frequency_hz": band,
        }
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"given {text!r}, expected such as step:m1=2@0.5, pulse:tool.x=300@0.4+0.02 or "
            "chirp:m1=1@0+2,0.5-30"
        ) from None


def wall(text: str) -> dict[str, Any]:
    """``X,Y,Z:NX,NY,NZ:K[:C[:GAP]]``: the numbers of a `flexgen.Wall` by name."""
    parts = text.split(":")
    try:
        vectors = [tuple(map(float, part.split(","))) for part in parts[:2]]
        scalars = list(map(float, parts[2:]))
        if not (1 <= len(scalars) <= 3 and all(len(vector) == 3 for vector in vectors)):
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"given {text!r}, expected X,Y,Z:NX,NY,NZ:K[:C[:GAP]], such as 1.2,0,0:-1,0,0:1e5:500"
        ) from None
    return dict(
        zip(("point", "normal", "stiffness", "damping", "gap"), (*vectors, *scalars), strict=False)
    )


def box(text: str) -> dict[str, tuple[float, ...]]:
    """``X,Y,Z:X,Y,Z``: the corners of a `flexgen.Box` by name, which may be infinite."""
    try:
        corners = [tuple(map(float, part.split(","))) for part in text.split(":")]
        if len(corners) != 2 or any(len(c) != 3 or any(map(math.isnan, c)) for c in corners):
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"given {text!r}, expected X,Y,Z:X,Y,Z, lower and upper corner in m, such as "
            "-inf,-inf,-inf:inf,inf,0 for a floor"
        ) from None
    return dict(zip(("lower", "upper"), corners, strict=True))


def joint_value(text: str) -> tuple[str, float]:
    """``NAME=X``."""
    name, equals, value = text.partition("=")
    try:
        if not (name and equals):
            raise ValueError
        return name, number_in(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"given {text!r}, expected such as q3=0.5") from None
