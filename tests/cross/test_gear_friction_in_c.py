"""Friction that depends on load and temperature in the emitted C: whole paths, streams,
temperature at run time.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clib_planted import plant_in_c
from gear_friction import NUMBERS, loaded
from states_in_c import GEARS, path_of, stream_errors
from toolchain import needs_compiler

import flexgen
from flexgen.codegen.build.generate import generate_parts
from flexgen.codegen.build.model_library import library_with
from flexgen.codegen.emission import clib_files
from flexgen.dynamics.mechanics.signatures import INVERTING, offered_functions
from flexgen.runtime.library import Library

pytestmark = needs_compiler
SAME = 1e-7  # relative: at its first sample C has differences to one side
SUMS = {
    "element.upper.dof.q1.gear.transmission_error": {
        "harmonics": [1, 2],
        "cos": [1e-4, 0.0],
        "sin": [0.0, 5e-5],
    },
    "motor.m2.cogging": {"harmonics": [6], "sin": [0.1]},
}

LOSSY = {f"{gear}.hysteresis": {"lost_motion": 3e-4, "stiffness": 4e6} for gear in GEARS.values()}
MORE: dict[str, dict[str, Any]] = {"": {}, "harmonic": SUMS, "hysteresis": LOSSY}


@cache
def robot(kind: str = "") -> flexgen.RobotModel:
    """The elbow with this friction in both motors, and with Fourier sums of their angles or
    hysteresis of the gears.
    """
    table = {"type": "gear", **NUMBERS}
    frictions = {f"motor.{name}.friction": table for name in ("m1", "m2")}
    return flexgen.read("elbow", overrides=frictions | MORE[kind])


def functions_of(model: flexgen.RobotModel) -> list[str]:
    return [name for name in INVERTING if name in offered_functions(model)]


def library_of(model: flexgen.RobotModel) -> Library:
    return library_with(model, functions_of(model), ("invert", "stream"))


@cache
def solved(kind: str) -> Any:
    """The motor torques of the closed form in Python, and samples of its path."""
    path = flexgen.solve(
        robot(kind), method="closed-form", verify=False, progress=False
    ).trajectory
    move = flexgen.plan(robot(kind))
    t = np.clip(path.time, 0.0, move.duration)
    y, dy, ddy = (np.ascontiguousarray(x) for x in move.sample(t).y.transpose(2, 0, 1)[:3])
    inside = ((path.time > 0.0) & (path.time < move.duration))[:, None]
    return (
        path,
        (y, dy * inside, ddy * inside),
        {"period": float(path.time[1]), "q_start": move.q_start},
    )


def error_of(library: Library, kind: str = "") -> float:
    """Largest difference of the torques of C and Python, relative."""
    path, samples, options = solved(kind)
    found = library.invert(*samples, **options)
    n = min(len(found.tau_m), len(path.time))
    assert found.converged
    return float(np.abs(found.tau_m[:n] - path["tau_m"][:n]).max() / np.abs(path["tau_m"]).max())


@pytest.mark.parametrize(
    "kind",
    ["", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("harmonic", "hysteresis"))],
)
def test_whole_paths_and_streams_are_those_of_python(kind: str) -> None:
    library = library_of(robot(kind))
    assert error_of(library, kind) < SAME
    assert stream_errors(robot(kind), library) < 1e-8


@pytest.mark.slow
def test_arms_with_elastic_joints_stay_on_their_path() -> None:
    """The method lq, whose motors are those of C, in the simulation."""
    solution = flexgen.solve(loaded("planar5_nmp"), progress=False)
    assert solution.status == "solved" and solution.method == "lq"
    assert solution.simulation.tool_error_max_m < 1e-8


@pytest.mark.slow
def test_the_temperature_is_a_run_time_parameter(tmp_path: Path) -> None:
    """One library at 20, 45 and again 20 degrees C, whole path and stream, against models read at
    these.
    """
    made = flexgen.generate(robot(), tmp_path, parameters=["temperature"])
    move, samples = path_of(robot(), 1e-3)
    given = {"period": 1e-3, "q_start": move.q_start}
    with flexgen.load(made.directory) as library:
        assert library.parameter_names == ("temperature",) and library.parameters.tolist() == [
            20.0
        ]
        at = [library.invert(*samples, **given, parameters=[x]).tau_m for x in (20.0, 45.0, 20.0)]
        y, dy, ddy = samples
        stream = library.stream(y[0], move.q_start, period=1e-3, intervals=20, parameters=[45.0])
        streamed = [stream.update(y[k], dy[k], ddy[k]).tau_m for k in range(1, len(y))]
        many = library.invert_many(*samples, **given, parameters=[[20.0], [45.0]]).tau_m
        stream = library.stream(y[0], move.q_start, period=1e-3, intervals=20)
        stream.set_parameters([45.0])
        changed = [stream.update(y[k], dy[k], ddy[k]).tau_m for k in range(1, len(y))]
    own = [library_of(loaded("elbow", x)).invert(*samples, **given).tau_m for x in (20.0, 45.0)]
    assert (at[0] == at[2]).all() and np.abs(at[0] - own[0]).max() < 1e-12 * np.abs(own[0]).max()
    assert np.abs(at[1] - own[1]).max() < 1e-12 * np.abs(own[1]).max()
    assert np.abs(own[0] - own[1]).max() > 1e-2
    assert (many == np.stack(at[:2])).all()
    for torques in (np.concatenate(x)[19:] for x in (streamed, changed)):
        assert np.abs(torques - at[1][: len(torques)]).max() < 1e-6 * np.abs(at[1]).max()


PLANTED = {
    "whole path": (
        "carried += eta_inverse[i][j]",
        "carried -= 0.99 * eta_inverse[i][j]",
        "whole_path.h",
    ),
    "stream": (
        "load[j] += eta_inverse[i][j] * tau_g[i];",
        "load[j] += eta_inverse[j][i] * tau_g[0];",
        "motors.h",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("bug", PLANTED)
def test_planted_errors_of_the_c_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bug: str
) -> None:
    old, new, file = PLANTED[bug]
    plant_in_c(monkeypatch, file, old, new)
    functions = functions_of(robot())
    made = generate_parts(
        robot(), tmp_path, functions, ("invert", "stream"), progress=lambda line: None
    )
    with flexgen.load(made.directory) as library:
        if file == "motors.h":
            assert stream_errors(robot(), library) > 1e-4
        else:
            assert error_of(library) > 1e3 * SAME


def test_libraries_without_it_have_no_trace_of_it() -> None:
    for text in clib_files.read_clib().values():
        assert "loaded_friction" not in clib_files.render(text, "arm")
    whole = clib_files.read_clib()["whole_path.h"]
    with_both = clib_files.render(whole, "arm", parts=["LOAD", "HARMONICS"])
    _, begin, rest = with_both.partition("points load[NM]")
    inside, end, _ = rest.partition("loaded_f")
    assert begin and end and "carried *= " in inside and "#if" not in inside
