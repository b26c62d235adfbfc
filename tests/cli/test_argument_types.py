"""Types of arguments of the command line: what a text becomes, and the words where it is
refused.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flexgen.cli import argument_types as types

STEP = {
    "kind": "step",
    "where": "m1",
    "size": 2.0,
    "start_s": 0.5,
    "length_s": None,
    "frequency_hz": None,
}
GOOD: list[tuple[Callable[[str], Any], str, Any]] = [
    (types.numbers, "0.3,-1.1,0", [0.3, -1.1, 0.0]),
    (types.numbers, "1e-3", [1e-3]),
    (types.integers, "1,2,6", [1, 2, 6]),
    (types.integers, "123456789", [123456789]),
    (types.names, "a, b ,c", ("a", "b", "c")),
    (types.positive, "1e-9", 1e-9),
    (types.not_negative, "0", 0.0),
    (types.number, "-2.5", -2.5),
    (types.number, "0", 0.0),
    (types.integer, "-12", -12),
    (types.integer, "+0", 0),
    (types.whole(3), "3", 3),
    (types.whole(0), "0", 0),
    (types.spectrum, "optimal", "optimal"),
    (types.spectrum, "-0.5", -0.5),
    (types.factor_or_file, "0", 0.0),
    (types.factor_or_file, "0.5", 0.5),
    (types.factor_or_file, "prior.toml", Path("prior.toml")),
    (types.trajectory_file, "a.npz", Path("a.npz")),
    (types.trajectory_file, "a.mat", Path("a.mat")),
    (types.positions_file, "a.json", Path("a.json")),
    (types.npz_file, "b/a.npz", Path("b/a.npz")),
    (types.toml_file, "a.toml", Path("a.toml")),
    (types.text, " x ", " x "),
    (types.file_path, "a b", Path("a b")),
    (types.isa, "v3", "x86-64-v3"),
    (types.isa, "v33", "v33"),
    (types.isa, "native", "native"),
    (types.setting, "a.b = 0.5", ("a.b", 0.5)),
    (types.setting, 'x="y=z"', ("x", "y=z")),
    (types.setting, "x=[1, 2]", ("x", [1, 2])),
    (types.plant, "soft:stiffness=0.8, payload=5", ("soft", {"stiffness": 0.8, "payload": 5.0})),
    (types.plant, "stiffness=0.8", ("stiffness=0.8", {"stiffness": 0.8})),
    (types.changes, "x:mass=2", {"mass": 2.0}),
    (types.disturbance, "step:m1=2@0.5", STEP),
    (
        types.disturbance,
        "pulse:tool.x=-3e2@0.4+0.02",
        STEP
        | {"kind": "pulse", "where": "tool.x", "size": -300.0, "start_s": 0.4, "length_s": 0.02},
    ),
    (
        types.disturbance,
        "chirp:m1=1@-1e-1+2,0.5-30",
        STEP
        | {
            "kind": "chirp",
            "size": 1.0,
            "start_s": -0.1,
            "length_s": 2.0,
            "frequency_hz": (0.5, 30.0),
        },
    ),
    (
        types.wall,
        "1,2,3:-1,0,0:1e5",
        {"point": (1.0, 2.0, 3.0), "normal": (-1.0, 0.0, 0.0), "stiffness": 1e5},
    ),
    (
        types.wall,
        "0,0,0:0,0,1:2:3:4",
        {
            "point": (0.0,) * 3,
            "normal": (0.0, 0.0, 1.0),
            "stiffness": 2.0,
            "damping": 3.0,
            "gap": 4.0,
        },
    ),
    (types.joint_value, "q3=-0.5", ("q3", -0.5)),
]
NUMBERS = "expected numbers such as 0.3 -1.1 0 or 0.3,-1.1,0"
INTEGERS = "expected integers such as 1 2 6 or 1,2,6"
SETTING = (
    "expected KEY=VALUE with a TOML value, such as motor.m1.inertia=0.004 or "
    "'output.axes=\"xy\"' (text in quotes)"
)
PLANT = "expected such as soft:stiffness=0.8,payload=5"
PUSH = "expected such as step:m1=2@0.5, pulse:tool.x=300@0.4+0.02 or chirp:m1=1@0+2,0.5-30"
WALL = "expected X,Y,Z:NX,NY,NZ:K[:C[:GAP]], such as 1.2,0,0:-1,0,0:1e5:500"
BAD: list[tuple[Callable[[str], Any], str, str]] = [
    (types.numbers, "0.3,", NUMBERS),
    (types.numbers, "inf", NUMBERS),
    (types.numbers, "1,nan", NUMBERS),
    (types.integers, "1,-2", INTEGERS),
    (types.integers, "1234567890", INTEGERS),
    (types.positive, "0", "expected a number > 0, such as 0.01"),
    (types.positive, "inf", "expected a number > 0, such as 0.01"),
    (types.not_negative, "-1e-9", "expected a number >= 0, such as 0 or 0.01"),
    (types.not_negative, "x", "expected a number >= 0, such as 0 or 0.01"),
    (types.number, "nan", "expected a number, such as 0.01"),
    (types.number, "1e999", "expected a number, such as 0.01"),
    (types.integer, "1.0", "expected an integer"),
    (types.integer, "1" * 19, "expected an integer"),
    (types.whole(3), "2", "expected an integer >= 3"),
    (types.whole(3), "-4", "expected an integer >= 3"),
    (types.spectrum, "best", "expected a number such as 0.5, or optimal"),
    (types.factor_or_file, "-1", "expected a number >= 0, such as 0 or 0.01"),
    (types.factor_or_file, "", "expected a path"),
    (types.trajectory_file, "a.json", "expected a file name ending in .npz, .csv or .mat"),
    (types.positions_file, "a.xml", "expected a file name ending in .csv, .npz, .mat or .json"),
    (types.npz_file, "a.csv", "expected a file name ending in .npz"),
    (types.toml_file, "toml", "expected a file name ending in .toml"),
    (types.file_path, "a\0", "expected a path"),
    (types.setting, "a", SETTING),
    (types.setting, "=1", SETTING),
    (types.setting, "a=b", SETTING),
    (types.setting, "a=1\nb=2", SETTING),
    (types.plant, "soft", PLANT),
    (types.plant, "soft:=1", PLANT),
    (types.plant, "soft:stiffness=x", PLANT),
    (types.plant, "soft:stiffness=1,", PLANT),
    (types.disturbance, "step:m1=2", PUSH),
    (types.disturbance, "step:m1=e@0", PUSH),
    (types.wall, "1,2:1,0,0:1", WALL),
    (types.wall, "1,2,3:1,0,0", WALL),
    (types.wall, "1,2,3:1,0,0:1:2:3:4", WALL),
    (types.wall, "1,2,3:1,0,x:1", WALL),
    (types.joint_value, "q3", "expected such as q3=0.5"),
    (types.joint_value, "=1", "expected such as q3=0.5"),
    (types.joint_value, "q3=x", "expected such as q3=0.5"),
]


@pytest.mark.parametrize(("parse", "given", "value"), GOOD)
def test_texts_of_the_command_line_become_values(
    parse: Callable[[str], Any], given: str, value: Any
) -> None:
    assert parse(given) == value


@pytest.mark.parametrize(("parse", "given", "expected"), BAD)
def test_texts_of_the_command_line_that_are_refused(
    parse: Callable[[str], Any], given: str, expected: str
) -> None:
    with pytest.raises(argparse.ArgumentTypeError) as refused:
        parse(given)
    assert str(refused.value) == f"given {given!r}, {expected}"


@pytest.mark.parametrize("parse", [types.integers, types.integer, types.whole(0)])
def test_long_texts_are_shown_with_their_first_40_characters(parse: Callable[[str], Any]) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=f"^given '{'x' * 40}', expected"):
        parse("x" * 50)
