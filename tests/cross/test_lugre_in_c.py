"""Frictions with a state in the emitted C: whole paths and streams against the stage in Python;
planted errors.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bristled import NUMBERS, bristled, tables
from clib_planted import plant_in_c
from states_in_c import (
    GEARS,
    difference,
    functions_of,
    inverted,
    library_of,
    path_of,
    stream_errors,
)
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.codegen.build.generate import generate_parts
from flexgen.codegen.emission import clib_files
from flexgen.codegen.emission.c_functions import inversion_reason
from flexgen.dynamics.hysteresis.hysteresis import without_hysteresis
from flexgen.dynamics.hysteresis.lugre import without_lugre
from flexgen.dynamics.mechanics.signatures import offered_functions
from flexgen.inversion.problem.memory import with_memory
from flexgen.inversion.problem.motor_side import MotorMotion
from flexgen.inversion.problem.sampling import from_library

pytestmark = needs_compiler
SAME = 1e-8  # relative: rates of the motors are differences of rounded deflections
# the accelerations of the motors, which locate reversals, are differences of their speeds in
# Python, and not in C
OF_ARMS = 2e-7
OF_STIFF = 5e-5
STIFF = {"static": 0.5, "stiffness": 8e6, "damping": 0.0}  # Coulomb friction, as good as


def elbow(kind: str = "both") -> flexgen.RobotModel:
    """Both motors with the friction, one, very stiff bristles, in gears with hysteresis or in
    rigid ones.
    """
    made: dict[str, Any] = {}
    if kind == "hysteresis":
        made = {
            f"{gear}.hysteresis": {"lost_motion": 3e-4, "stiffness": 1e5}
            for gear in GEARS.values()
        }
    if kind == "rigid":
        made = {gear: {"type": "rigid"} for gear in GEARS.values()}
    both = {"m1": NUMBERS | (STIFF if kind == "stiff" else {}), "m2": NUMBERS | {"coulomb": 0.7}}
    return bristled("elbow", {"m2": NUMBERS} if kind == "one" else both, **made)


def by_the_stage(
    model: flexgen.RobotModel, samples: list[np.ndarray], **options: Any
) -> MotorMotion:
    """The motors of the C without elements that have a state, with those of the stages in
    Python.
    """
    found = library_of(without_lugre(without_hysteresis(model))).invert(*samples, **options)
    return with_memory(flexgen.derive(model), from_library(found)).motors


def there_and_back(model: flexgen.RobotModel) -> tuple[Any, list[np.ndarray]]:
    """A move, and samples of a path to its end and back in 0.4 s, which turns at a sample and does
    not rest there.
    """
    move, (y, _, _) = path_of(model, 1e-3)
    w = 2 * np.pi / 0.4
    t = np.linspace(0.0, 0.4, 401)[:, None]
    b = (1 - np.cos(w * t)) / 2
    db = w * np.sin(w * t) / 2
    ddb = w**2 * np.cos(w * t) / 2
    s = b**3, 3 * b**2 * db, 6 * b * db**2 + 3 * b**2 * ddb
    return move, [(k == 0) * y[0] + each * (y[-1] - y[0]) for k, each in enumerate(s)]


@pytest.mark.parametrize(
    "kind",
    [
        "both",
        *(
            pytest.param(x, marks=pytest.mark.slow)
            for x in ("one", "stiff", "hysteresis", "rigid")
        ),
    ],
)
def test_whole_paths_are_those_of_the_stage(kind: str) -> None:
    model = elbow(kind)
    move, samples = there_and_back(model)
    options = {"period": 1e-3, "q_start": move.q_start, "n_post": 100}
    found = library_of(model).invert(*samples, **options)
    assert found.converged
    assert difference(found, by_the_stage(model, samples, **options)) < (
        OF_STIFF if kind == "stiff" else SAME
    )


def test_where_the_motion_has_settled_the_torque_that_bristles_hold_stays() -> None:
    """Samples at rest after the motion, which are not integrated, and the same ones integrated."""
    model = elbow()
    move, samples = path_of(model, 1e-3)
    options = {"period": 1e-3, "q_start": move.q_start, "n_post": 400}
    long, short = (library_of(model).invert(*samples, **options, settled=x) for x in (0.0, 1e-5))
    assert np.abs(long.tau_m[-1] - short.tau_m[-1]).max() < 1e-4 * np.abs(long.tau_m).max()
    without = library_of(without_lugre(model)).invert(*samples, **options)
    assert np.abs(long.tau_m[-1] - without.tau_m[-1]).min() > 0.1


def test_torques_of_a_stream_at_rest_stay_where_friction_does_not_fall() -> None:
    """Rounded speeds of either sign do not turn the bristles: less than 1e-6 of the largest
    torque.
    """
    table = {"coulomb": 0.5, "stiffness": 800.0, "damping": 1.5}
    model = bristled("planar5_nmp", {"m1": table, "m2": table})
    move, (y, dy, ddy) = path_of(model, 2e-3, still=200)
    stream = library_of(model).stream(
        y[0], move.q_start, period=2e-3, intervals=30, samples_per_interval=4
    )
    torques = np.concatenate([stream.update(y[k], dy[k], ddy[k]).tau_m for k in range(1, len(y))])
    assert np.ptp(torques[-300:], axis=0).max() < 1e-6 * np.abs(torques).max()


@pytest.mark.parametrize(
    "name", ["planar5_nmp", pytest.param("manutec_r3_18", marks=pytest.mark.slow)]
)
def test_elastic_arms_are_those_of_the_stage_and_stay_on_their_path(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tool by the simulation, which integrates z itself: 0.05 um."""
    model = bristled(name, tables(name))
    solution, samples, options = inverted(model, monkeypatch)
    found = library_of(model).invert(*samples, **options)
    assert found.converged and difference(found, by_the_stage(model, samples, **options)) < OF_ARMS
    path = solution.trajectory
    n = len(solution.trajectory.time)
    channels = dict(path.channels) | {
        key: getattr(found, key)[:n] for key in ("q_m", "v_m", "tau_m")
    }
    by_c = flexgen.Trajectory(path.time, channels, path.ports, path.labels, path.meta)
    assert flexgen.simulate(model, by_c, feedback="ppi").tool_error_max_m < 5e-8


@pytest.mark.parametrize("kind", ["both", pytest.param("hysteresis", marks=pytest.mark.slow)])
def test_streams_are_whole_paths(kind: str) -> None:
    """Whatever they carry from update to update."""
    model = elbow(kind)
    assert stream_errors(model, library_of(model)) < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["zoh", "linear"])
def test_held_torques_of_streams_are_those_of_whole_paths(hold: str) -> None:
    model = elbow()
    library = library_of(model)
    (move, samples) = path_of(model, 1e-3, still=40)
    whole = library.invert(*samples, period=1e-3, q_start=move.q_start, hold=hold, delay=0.5).tau_m
    y, dy, ddy = samples
    stream = library.stream(y[0], move.q_start, period=1e-3, intervals=20, hold=hold, delay=0.5)
    found = np.concatenate([stream.update(y[k], dy[k], ddy[k]).tau_m for k in range(1, len(y))])[
        19:
    ]
    assert np.abs(found - whole[: len(found)]).max() < 1e-7 * np.abs(whole).max()


PLANTED = {
    "sign": ("r->tau_m[k * NM + j] += bristle", "r->tau_m[k * NM + j] -= bristle", "whole_path.h"),
    "static": ("level += more * exp_v", "level += 0.95 * more * exp_v", "lugre.h"),
    "one direction": (": -1.0 / per_turn", ": 1.0 / per_turn", "lugre.h"),
    "z not carried": ("                kept[j] = z;\n", "", "stream_update.h"),
    "impulses not carried": (
        "copy(&past[0][0], PAST_IMPULSES, kept + BRISTLES);",
        "(void)past;",
        "stream_update.h",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("bug", PLANTED)
def test_planted_errors_of_the_c_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bug: str
) -> None:
    old, new, file = PLANTED[bug]
    plant_in_c(monkeypatch, file, old, new)
    model = elbow()
    options = {"period": 1e-3}
    made = generate_parts(
        model, tmp_path, functions_of(model), ("invert", "stream"), progress=lambda line: None
    )
    move, samples = there_and_back(model)
    with flexgen.load(made.directory) as library:
        if file == "stream_update.h":
            assert stream_errors(model, library) > 1e-4
            return
        options["q_start"] = move.q_start
        found = library.invert(*samples, **options)
        assert difference(found, by_the_stage(model, samples, **options)) > 1e3 * SAME


def test_libraries_without_it_have_no_trace_of_it() -> None:
    for name, text in clib_files.read_clib().items():
        words = ("LUGRE", "lugre", "bristle")
        assert name == "lugre.h" or not any(
            word in clib_files.render(text, "arm") for word in words
        )
    assert "add_bristles" in clib_files.render(
        clib_files.read_clib()["whole_path.h"], "arm", parts=["LUGRE"]
    )


def test_fourier_sums_are_refused() -> None:
    model = bristled(
        "elbow", {"m1": NUMBERS}, **{"motor.m1.cogging": {"harmonics": [6], "sin": [0.1]}}
    )
    told = inversion_reason(model, offered_functions(model))
    assert told == "motor m1 has lugre and motor m1 has cogging, of which C has one or the other"
    with pytest.raises(ArgumentError, match="given a library without invert"):
        library_of(model).invert(*path_of(model, 1e-3)[1], period=1e-3, q_start=[0.5, -0.3])
    limits = flexgen.Limits(torque=(40.0, 40.0))
    for call in (
        lambda: flexgen.solve(model, limits=limits, progress=False),
        lambda: flexgen.fastest(model, limits=limits, progress=False),
        lambda: flexgen.export_fmu(model, "never.fmu", block="feedforward"),
    ):
        # not a library without a function, nor a failing compiler
        with pytest.raises(ArgumentError, match=told):
            call()
