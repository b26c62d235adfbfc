"""Exports for the tests: the emitted library of planar5_nmp in two files, compiled once."""

from __future__ import annotations

import atexit
import shutil
import subprocess
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

from toolchain import tool

import flexgen
from flexgen.exports.c_code.emitted import Emitted, emit
from flexgen.model.elements import RobotModel

# the library's own warnings are tested elsewhere
PLAIN = ["-std=c99", "-O0", "-ffp-contract=off", "-fPIC"]


@cache
def folder() -> Path:
    """A folder for the session."""
    made = tempfile.mkdtemp(prefix="flexgen-exports-")
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return Path(made)


@cache
def library_object(
    name: str, precision: str = "double", parts: tuple[str, ...] = ()
) -> tuple[Emitted, Path]:
    """The emitted library of a model, and its object file."""
    library = emit(name, precision=precision, parts=parts)
    place = folder() / "-".join((name, precision, *parts))
    place.mkdir()
    for file, text in library.texts().items():
        (place / file).write_text(text, encoding="ascii")
    subprocess.run([tool("gcc"), *PLAIN, "-c", f"{library.name}.c"], cwd=place, check=True)
    return library, place / f"{library.name}.o"


def without_streams() -> RobotModel:
    """The model elbow with a rotor that turns with the joint that it drives: its torques do not
    follow from each other.
    """
    model = flexgen.read("elbow")
    carriers = zip(model.motors, ("base", "fore"), strict=True)
    motors = tuple(
        replace(motor, axis=(0.0, 1.0, 0.0), carrier=carrier) for motor, carrier in carriers
    )
    return replace(model, motors=motors, motor_coupling="complete")
