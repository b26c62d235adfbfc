"""A robot whose gears and motors have memory, for the exports: a path, the torques of `solve`,
errors in the C.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np
from bristled import NUMBERS
from exports import PLAIN, folder
from gear_friction import NUMBERS as LOADED
from toolchain import tool

import flexgen
from flexgen.exports.c_code.emitted import emit
from flexgen.exports.c_code.selftest.golden import output_at
from flexgen.exports.c_code.selftest.motion import targets
from flexgen.inversion.hold import Hold, torque_command

NAME = "elbow"
PERIOD = 5e-3
INTERVALS = 10
SAMPLES = 5
GEARS = {"q1": "element.upper.dof.q1.gear", "q2": "element.fore.dof.q2.gear"}
SLIPPING = [{"lost_motion": 2e-5, "stiffness": 4e6}, {"lost_motion": 5e-5, "stiffness": 2e6}]
# a stream in its C that forgets at the end of each update how far its gears, or its bristles, are
FORGETS = {
    "hysteresis": ("hysteresis.h", "        copy(b->z_r[e], NG, x + (3 + e) * NG);\n", ""),
    "lugre": ("stream_update.h", "                kept[j] = z;\n", ""),
}
# of the largest torque of a motor; a held torque is a mean, of a quintic in C and of a spline in
# Python, which differ where gears reverse; with one of the errors
SAME = {"spline": 1e-6, "zoh": 3e-5}
WRONG = 1e-3


@cache
def remembering() -> flexgen.RobotModel:
    """The model elbow with two elements of hysteresis in each gear, bristles and friction of the
    load in each motor.
    """
    made: dict[str, object] = {f"{gear}.hysteresis": SLIPPING for gear in GEARS.values()}
    for motor in ("m1", "m2"):
        made |= {
            f"motor.{motor}.lugre": NUMBERS,
            f"motor.{motor}.friction": {"type": "gear", **LOADED},
        }
    return flexgen.read(NAME, overrides=made)


@cache
def start() -> tuple[np.ndarray, np.ndarray]:
    """Output and arm coordinates where the path starts."""
    path = flexgen.plan(remembering())
    return output_at(flexgen.derive(remembering()), np.asarray(path.q_start)), np.asarray(
        path.q_start
    )


@cache
def samples() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples for the updates of a stream: the output of the move and its derivatives (n, 2), then
    as many at rest.
    """
    path = flexgen.plan(remembering())
    t = np.arange(1, round(path.duration / PERIOD) + INTERVALS) * PERIOD
    sample = path.sample(t)
    return targets(sample), sample.derivative(1), sample.derivative(2)


@cache
def solved(hold: Literal["spline", "zoh"]) -> np.ndarray:
    """Torques (n, n_m) that a controller sends by `solve`, whose stages are in Python, at all
    samples of a stream.
    """
    solution = flexgen.solve(remembering(), method="closed-form", verify=False, progress=False)
    given = solution.trajectory
    time = given.time
    tau = given["tau_m"]
    if hold != "spline":
        sent = torque_command(given, Hold(hold, PERIOD / SAMPLES))
        time = sent.time
        tau = sent.values
    assert time[0] == 0.0 and np.allclose(np.diff(time), PERIOD / SAMPLES)
    n = SAMPLES * (len(samples()[0]) - INTERVALS)
    return np.concatenate([np.tile(tau[0], (SAMPLES * (INTERVALS - 1), 1)), tau[:n]])


def torque_error(found: np.ndarray, hold: Literal["spline", "zoh"]) -> float:
    """Largest difference of torques (n, n_m) to `solved`, relative to the largest torque of each
    motor.
    """
    expected = solved(hold)[: len(found)]
    return float(
        (
            np.abs(found[: len(expected)] - expected).max(axis=0) / np.abs(expected).max(axis=0)
        ).max()
    )


@cache
def compiled(forgets: str = "", parts: tuple[str, ...] = ()) -> Path:
    """The object file of the C of an export with these parts, with one of the errors."""
    library = emit(remembering(), parts=parts)
    place = folder() / "-".join(("remembering", forgets, *parts))
    text = library.source
    if forgets:
        _, old, new = FORGETS[forgets]
        assert text.count(old) == 1
        text = text.replace(old, new)
    place.mkdir()
    for file, content in {f"{NAME}.h": library.header, f"{NAME}.c": text}.items():
        (place / file).write_text(content, encoding="ascii")
    subprocess.run([tool("gcc"), *PLAIN, "-c", f"{NAME}.c"], cwd=place, check=True)
    return place / f"{NAME}.o"


def check(torques: Callable[[str], np.ndarray], hold: Literal["spline", "zoh"] = "spline") -> None:
    """The torques (n, n_m) of an export are those of `solve`; ``torques``: with one of `FORGETS`,
    or an empty text.
    """
    assert torque_error(torques(""), hold) < SAME[hold]
    for forgets in FORGETS:
        assert torque_error(torques(forgets), hold) > WRONG, forgets
