"""Gears with hysteresis in the emitted C: whole paths and streams against the stage in Python;
planted errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clib_planted import plant_in_c
from hysteretic import ARCMIN, BENT, SLIPS, Element, hysteretic, with_elements, with_law
from states_in_c import (
    GEARS,
    HORIZON,
    difference,
    functions_of,
    inverted,
    library_of,
    path_of,
    stream_errors,
    streamed,
)
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.codegen.build.generate import generate_parts
from flexgen.codegen.emission import clib_files
from flexgen.dynamics.hysteresis.hysteresis import without_hysteresis
from flexgen.inversion.problem.memory import with_hysteresis
from flexgen.inversion.problem.motor_side import MotorMotion
from flexgen.inversion.problem.sampling import from_library

pytestmark = needs_compiler
CUBIC = {"type": "cubic", "stiffness": 1e5, "cubic": 4e10}
SHARP = (Element(0.5, 0.6, 20.0, -1.0), Element(0.5, 0.4, 1.5))
SAME = 1e-9  # relative: second differences of rounded deflections


def by_the_stage(
    model: flexgen.RobotModel, samples: list[np.ndarray], **options: Any
) -> MotorMotion:
    """The motors behind the motion of the arm without hysteresis, which the C gives, by the stage
    in Python.
    """
    found = library_of(without_hysteresis(model)).invert(*samples, **options)
    return with_hysteresis(flexgen.derive(model), from_library(found)).motors


def elbow(kind: str) -> flexgen.RobotModel:
    """Gears with damping, without, with so much that their time constant is many samples, a stiff
    spring, elements.
    """
    made: dict[str, Any] = {
        "undamped": {f"{gear}.damping": 0.0 for gear in GEARS.values()},
        "slow": {f"{gear}.damping": 9e3 for gear in GEARS.values()},
        "mixed": {f"{GEARS['q1']}.damping": 0.0},
    }.get(kind, {})
    model = hysteretic("elbow", **made)
    if kind == "cubic":
        table = {"lost_motion": ARCMIN, "stiffness": 1e5}
        changed = {f"{gear}.hysteresis": table for gear in GEARS.values()} | {
            f"{GEARS['q1']}.spring": CUBIC
        }
        return flexgen.read("elbow", overrides=changed)
    if kind.startswith(("bent", "sharp")):
        undamped = (
            {f"{gear}.damping": 0.0 for gear in GEARS.values()} if kind == "bent undamped" else {}
        )
        elements = (
            (*SLIPS[:1], *BENT)
            if kind == "bent and dahl"
            else BENT
            if kind.startswith("bent")
            else SHARP
        )
        return with_elements("elbow", elements, **undamped)
    if kind == "of others":
        return with_law("elbow", **{f"{GEARS['q1']}.damping": 0.0})
    if kind.startswith("several"):
        undamped = (
            {f"{gear}.damping": 0.0 for gear in GEARS.values()}
            if kind == "several undamped"
            else {}
        )
        return with_elements("elbow", SLIPS, **undamped)
    if kind == "two and one":
        table = {"lost_motion": ARCMIN, "stiffness": 1e5}
        return flexgen.read(
            "elbow",
            overrides={
                f"{GEARS['q1']}.hysteresis": table,
                f"{GEARS['q2']}.hysteresis": [table, table],
            },
        )
    if kind == "one":
        return flexgen.read(
            "elbow",
            overrides={f"{GEARS['q2']}.hysteresis": {"lost_motion": ARCMIN, "stiffness": 1e5}},
        )
    return model


@pytest.mark.parametrize(
    "kind",
    [
        "undamped",
        "several",
        "of others",
        *(
            pytest.param(x, marks=pytest.mark.slow)
            for x in ("damped", "slow", "mixed", "cubic", "one")
        ),
        *(pytest.param(x, marks=pytest.mark.slow) for x in ("several undamped", "two and one")),
        *(
            pytest.param(x, marks=pytest.mark.slow)
            for x in ("bent", "bent undamped", "bent and dahl", "sharp")
        ),
    ],
)
def test_whole_paths_are_those_of_the_stage(kind: str) -> None:
    model = elbow(kind)
    move, samples = path_of(model, 1e-3)
    options = {"period": 1e-3, "q_start": move.q_start, "n_post": 100}
    found = library_of(model).invert(*samples, **options)
    assert found.converged
    assert difference(found, by_the_stage(model, samples, **options)) < SAME


@pytest.mark.parametrize(
    ("name", "elements"),
    [
        ("planar5_nmp", ()),
        *(pytest.param("planar5_nmp", x, marks=pytest.mark.slow) for x in (SLIPS, BENT)),
        *(pytest.param("manutec_r3_18", x, marks=pytest.mark.slow) for x in ((), SLIPS)),
    ],
)
def test_elastic_arms_are_those_of_the_stage_and_stay_on_their_path(
    name: str, elements: Sequence[Element], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tool by the simulation, which integrates z itself: 0.05 um, of some 400 um without
    hysteresis.
    """
    model = with_elements(name, elements) if elements else hysteretic(name)
    solution, samples, options = inverted(model, monkeypatch)
    found = library_of(model).invert(*samples, **options)
    assert found.converged and difference(found, by_the_stage(model, samples, **options)) < SAME
    path = solution.trajectory
    n = len(solution.trajectory.time)
    channels = dict(path.channels) | {
        key: getattr(found, key)[:n] for key in ("q_m", "v_m", "tau_m")
    }
    by_c = flexgen.Trajectory(path.time, channels, path.ports, path.labels, path.meta)
    assert flexgen.simulate(model, by_c, feedback="ppi").tool_error_max_m < 5e-8


@pytest.mark.parametrize(
    "kind",
    [
        "undamped",
        "several",
        "bent",
        "of others",
        *(pytest.param(x, marks=pytest.mark.slow) for x in ("damped", "several undamped")),
    ],
)
def test_streams_are_whole_paths(kind: str) -> None:
    """Whatever they carry from update to update."""
    model = elbow(kind)
    assert stream_errors(model, library_of(model)) < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["undamped", pytest.param("several", marks=pytest.mark.slow)])
def test_the_payload_may_be_a_parameter(tmp_path: Path, kind: str) -> None:
    """Whole paths and streams are those of the model with this payload; other numbers may not."""
    model = elbow(kind)
    mass = 40.0
    heavy = replace(model, payload=replace(model.payload, mass=mass))
    chosen = {"parameters": ["payload"], "progress": lambda line: None}
    made = generate_parts(model, tmp_path, functions_of(model), ("invert", "stream"), **chosen)
    (move, samples) = path_of(model, 1e-3, still=2 * HORIZON)
    number = np.array([mass, *model.payload.com])
    with flexgen.load(made.directory) as library:
        options = {"period": 1e-3, "q_start": move.q_start}
        found = library.invert(*samples, **options, parameters=number)
        assert difference(found, library_of(heavy).invert(*samples, **options)) < SAME
        torques = streamed(library, samples, move.q_start, 1e-3, parameters=number)
    assert np.abs(torques - found.tau_m[: len(torques)]).max() < 1e-8 * np.abs(found.tau_m).max()
    with pytest.raises(
        ArgumentError, match=r"parameters other than those of the payload: given .* has hysteresis"
    ):
        flexgen.derive(model, ["stiffness"])


@pytest.mark.parametrize("intervals", [4, 24])
def test_torques_that_are_not_smooth_do_not_end_a_stream(intervals: int) -> None:
    """A horizon that is too short, and held torques beyond it: several reversals between two
    samples.
    """
    model = elbow("undamped" if intervals == 4 else "damped")
    move, (y, dy, ddy) = path_of(model, 5e-3, still=intervals)
    stream = library_of(model).stream(
        y[0],
        move.q_start,
        period=5e-3,
        intervals=intervals,
        samples_per_interval=2,
        hold="zoh",
        delay=3.5,
    )
    for k in range(1, len(y)):
        assert np.isfinite(
            stream.update(y[k], dy[k] * (-1.0) ** k, ddy[k] * (-1.0) ** k).tau_m
        ).all()


# --- planted errors ------------------------------------------------------------------------------

LEAST = {"one element": 1e-4, "curve": 1e-6}
PLANTED = {
    "one element": (
        "        z += element_torque(b, e, i, x, &more);\n",
        "        (void)element_torque(b, e, i, x, &more);\n",
    ),
    "sign of z": ("store_v(value[k] + i, K * x + z);", "store_v(value[k] + i, K * x - z);"),
    "no reversal": ("store_v(b->s + i, select_v(is, -s, s));", "store_v(b->s + i, s);"),
    "curve at a reversal": (
        "                restart_curves(b, i);\n            }\n        }\n",
        "            }\n        }\n",
    ),
    "curve": ("z = s * slip * (y + slope", "z = s * slip * (1.0001 * y + slope"),
    "z not carried": ("        copy(b->z_r[e], NG, x + (3 + e) * NG);\n", ""),
}


@pytest.mark.slow
@pytest.mark.parametrize("bug", PLANTED)
def test_planted_errors_of_the_c_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bug: str
) -> None:
    old, new = PLANTED[bug]
    plant_in_c(monkeypatch, "hysteresis.h", old, new)
    model = elbow("bent" if "curve" in bug else "several")
    made = generate_parts(
        model, tmp_path, functions_of(model), ("invert", "stream"), progress=lambda line: None
    )
    move, samples = path_of(model, 1e-3)
    with flexgen.load(made.directory) as library:
        if bug == "z not carried":
            assert stream_errors(model, library) > 1e-3
            return
        options = {"period": 1e-3, "q_start": move.q_start}
        try:
            found = library.invert(*samples, **options)
        except SolverError as error:
            assert "did not converge" in str(error)
        else:
            assert difference(found, by_the_stage(model, samples, **options)) > LEAST.get(
                bug, 1e-3
            )


# --- what there is not ---------------------------------------------------------------------------


def test_libraries_without_hysteresis_have_no_trace_of_it() -> None:
    for name, text in clib_files.read_clib().items():
        words = ("HYSTERESIS", "hysteretic", "branches(")
        assert name == "hysteresis.h" or not any(
            word in clib_files.render(text, "arm") for word in words
        )
    dahl = clib_files.render(clib_files.read_clib()["hysteresis.h"], "arm", parts=["HYSTERESIS"])
    assert "curve" not in dahl and "element_torque" in dahl
    assert "hysteretic_rows" in clib_files.render(
        clib_files.read_clib()["whole_path.h"], "arm", parts=["HYSTERESIS"]
    )
