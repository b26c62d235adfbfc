"""Numbers in files and options have the digits 0 to 9: others are damage, which is named."""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import flexgen
from flexgen.base.checks.counts import is_count, number_in
from flexgen.base.errors import FlexgenError
from flexgen.base.files.record_tables import read_arrays
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.units import conversion
from flexgen.cli import argument_types

# Fullwidth and Arabic digits, a digit that is a power, a grouping of Python.
TRACKER = {"name": "a", "type": "tracker", "unit": "m"}
STRANGE = ["\uff11\uff12", "1\uff12", "\u0663", "1.\u0665", "1_0"]


@pytest.mark.parametrize("text", STRANGE)
def test_other_digits_are_not_numbers(text: str) -> None:
    float(text)  # as Python reads them
    with pytest.raises(ValueError, match="could not convert"):
        number_in(text)
    assert not is_count("\uff12") and not is_count("\u00b2") and is_count("12")


def recorded(folder: Path, number: str) -> Any:
    file = folder / "log.csv"
    file.write_text(f"time,q1\n0,{number}\n1,\n", encoding="utf-8")
    return read_arrays(file, 1000)


def poses(folder: Path, number: str) -> Any:
    robot = flexgen.read("elbow", overrides={"sensor": [TRACKER]})
    names = [f"{c.name}_deg" for c in robot.coordinates]
    names += [f"a_{axis}_mm" for axis in "xyz"]
    file = folder / "poses.csv"
    cells = [number, *["1"] * (len(names) - 1)]
    file.write_text(f"{','.join(names)}\n{','.join(cells)}\n", encoding="utf-8")
    return flexgen.StaticPoses.read(file, robot)


@functools.cache
def solved() -> Trajectory:
    return flexgen.solve("elbow", verify=False).trajectory


def moved(folder: Path, number: str) -> Any:
    file = folder / "motion.csv"
    solved().save(file)
    lines = file.read_text(encoding="utf-8").splitlines()  # the last one counts the rows
    lines[-2] = ",".join([*lines[-2].split(",")[:-1], number])
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return Trajectory.load(file)


def current(folder: Path, number: str) -> Any:
    return conversion(str(folder), f"A ({number} N m/A)", "N m")


READERS: dict[str, Callable[[Path, str], Any]] = {
    "record": recorded,
    "poses": poses,
    "constant of a motor": current,
    "trajectory": moved,
    "numbers": lambda folder, number: argument_types.numbers(f"0,{number}"),
    "positive": lambda folder, number: argument_types.positive(number),
    "number": lambda folder, number: argument_types.number(number),
    "plant": lambda folder, number: argument_types.plant(f"a:stiffness={number}"),
    "joint": lambda folder, number: argument_types.joint_value(f"q1={number}"),
}


@pytest.mark.parametrize("number", STRANGE)
@pytest.mark.parametrize("reader", READERS)
def test_readers_refuse_other_digits(tmp_path: Path, reader: str, number: str) -> None:
    with pytest.raises((FlexgenError, argparse.ArgumentTypeError), match="given") as caught:
        READERS[reader](tmp_path, number)
    assert number in str(caught.value) or "given text, expected numbers" in str(caught.value)
    READERS[reader](tmp_path, "12")  # it takes a number
