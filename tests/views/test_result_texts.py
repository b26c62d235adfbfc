"""Texts of models, failures of sweeps, solutions, paths and libraries, as the command line prints
them.
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from emitted import made
from toolchain import needs_compiler

import flexgen
from flexgen.views.reports import texts

GEAR = "element.upper.dof.q1.gear"
SLIDE = "element.upper.dof.q1.type"


def row_of(text: str, name: str) -> list[str]:
    """The cells of the row of a table that begins with a name."""
    (line,) = [line for line in text.splitlines() if line.split()[:1] == [name]]
    return re.split(r" {2,}", line.strip())


@pytest.mark.parametrize(
    ("model", "changes", "name", "cells"),
    [
        ("elbow@rigid", {}, "q1", ["rigid gear", "-", "-"]),
        (
            "elbow",
            {f"{GEAR}.spring.stiffness": 2e4, f"{GEAR}.damping": 0.0},
            "q1",
            ["elastic gear, linear, arm side", "20000 N m/rad", "0 N m s/rad"],
        ),
        (
            "elbow",
            {f"{GEAR}.hysteresis": {"lost_motion": 0.02, "stiffness": 1e5}},
            "q1",
            ["elastic gear, linear, arm side, lost motion 0.02 rad", None, None],
        ),
        (
            "elbow",
            {f"{GEAR}.hysteresis": [{"lost_motion": x, "stiffness": 1e5} for x in (1e-3, 2.5e-4)]},
            "q1",
            ["elastic gear, linear, arm side, lost motion 0.00125 rad", None, None],
        ),
        (
            "elbow",
            {SLIDE: "translation", f"{GEAR}.hysteresis": {"lost_motion": 0.02, "stiffness": 1e5}},
            "q1",
            ["elastic gear, linear, arm side, lost motion 0.02 m", "7518900 N/m", "1400 N s/m"],
        ),
        (
            "elbow",
            {SLIDE: "translation", f"{GEAR}.side": "motor"},
            "q1",
            ["elastic gear, linear, motor side", "7518900 N m/rad", "1400 N m s/rad"],
        ),
        (
            "four_mass",
            {},
            "q1",
            ["elastic gear, smooth, motor side", "16.7 N m/rad", "0.08 N m s/rad"],
        ),
        ("four_mass", {}, "e3", ["spring, linear", "3872000 N m/rad", "3872 N m s/rad"]),
        ("beam_arm", {}, "fore_y1", ["beam bending", "-", "-"]),
    ],
)
def test_the_drive_of_a_coordinate_in_words(
    model: str, changes: dict[str, Any], name: str, cells: list[str | None]
) -> None:
    text = texts.description_text(flexgen.describe(flexgen.read(model, overrides=changes)))
    found = row_of(text, name)[-3:]
    for cell, expected in zip(found, cells, strict=True):
        assert expected is None or cell == expected, text


def test_reasons_of_failed_cases() -> None:
    """Five reasons, of each five cases; the others are counted."""
    groups = [{"cases": [3], "reason": "alone"}, {"cases": [1, 2], "reason": "both"}]
    groups += [{"cases": list(range(10, 16)), "reason": "many"}]
    assert texts.failure_lines(groups, "results.npz") == [
        "case 3 failed: alone",
        "2 cases failed (1, 2), for example case 1: both",
        "6 cases failed (10, 11, 12, 13, 14, ...), for example case 10: many",
    ]
    more = [{"cases": [k, k + 100], "reason": f"r{k}"} for k in range(7)]
    found = texts.failure_lines(more, "results.npz")
    assert len(found) == 6
    assert found[-1] == "4 more cases failed for other reasons; see results.npz"


@cache
def solution() -> flexgen.Solution:
    return flexgen.solve("elbow", "line")


@pytest.mark.parametrize("verified", [True, False])
def test_details_of_a_solution(verified: bool) -> None:
    """Details that are empty are left out; the simulation has its own figures."""
    run = solution().simulation
    assert run is not None
    details = {"a_b": 2.5, "c": [], "d": None, "e": {}, "f": "", "g": [1, 2], "h": 0}
    given = replace(solution(), details=details, simulation=run if verified else None)
    text = texts.solution_details(given)
    rows = [re.split(r" {2,}", line) for line in text.splitlines() if "  " in line][2:]
    own = [["a b", "2.5"], ["g", "[1, 2]"], ["h", "0"]]
    of_run = [
        ["integrator of the simulation", run.integrator],
        ["evaluations of the equations of motion", str(run.evaluations)],
        ["wall time of the simulation", f"{run.wall_s:.4g}", "s"],
    ]
    assert rows == own + of_run * verified
    meaning = f"{given.status}: {given.status.sentence} {given.status.advice}".rstrip()
    assert text.rstrip().endswith(meaning)
    bare = texts.solution_details(replace(given, details={}, simulation=None))
    assert bare.rstrip() == meaning


def test_segments_of_a_path_are_a_table_and_its_notes_are_printed_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A note that is also a warning is printed as a warning only."""
    told = ("the start is moved", "the samples are noisy")
    monkeypatch.setattr(flexgen.Path, "notes", property(lambda path: told))
    monkeypatch.setattr(flexgen.Path, "warnings", property(lambda path: told[1:]))
    path = flexgen.plan("elbow", "line")
    lines = path.to_text().splitlines()
    assert lines[0] == f"elbow, line: {path.duration:g} s"
    (segment,) = path.segments
    row = [1, segment.space, segment.start, segment.law.duration, segment.smoothness]
    shown = next(line.split() for line in lines if line.split()[:1] == ["1"])
    assert shown == [x if isinstance(x, str) else f"{x:g}" for x in row]
    assert lines[-2:] == ["", "note: the start is moved"]


@needs_compiler
@pytest.mark.parametrize(
    ("cached", "written", "done"),
    [
        (False, True, "built in 1.3 s"),
        (True, True, "written, not compiled"),
        (False, False, "nothing has changed"),
    ],
)
def test_files_of_a_library_that_a_user_needs_are_named(
    cached: bool, written: bool, done: str
) -> None:
    robot = flexgen.read("elbow")
    library = replace(made("elbow"), cached=cached, written=written, seconds=1.26)
    lines = texts.library_text(robot, library).splitlines()
    assert lines[0] == f"elbow: {done} in {library.directory}"
    assert "functions: " + ", ".join(library.functions) in lines
    sources = [x for x in library.files if x.suffix == ".c" or x.parent.name == "src"]
    others = [f"wrote {x}" for x in library.files if x not in sources]
    folder = f"wrote {sources[0].parent} ({len(sources)} sources)"
    named = [line for line in lines if line.startswith("wrote ")]
    assert named == ([*others, folder] if written else [])
    assert f"wrote {library.directory / 'elbow.h'}" in others


def test_a_library_without_the_inversion_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "flexgen.codegen.emission.c_functions.inversion_reason", lambda *given: "it has a beam"
    )
    library = flexgen.GeneratedLibrary(
        Path("o"), (Path("o/r.h"),), ("f", "g"), "0" * 20, 1.0, False, False
    )
    assert texts.library_text(flexgen.read("elbow"), library) == (
        "elbow: nothing has changed in o\n\nfunctions: f, g\n\n"
        "not in this library: invert and stream, because it has a beam"
    )


def test_a_description_names_ratios_and_outputs() -> None:
    """The ratio of a translation has a unit."""
    model = flexgen.read("elbow", overrides={SLIDE: "translation"})
    text = texts.description_text(flexgen.describe(model))
    assert "tool_position xz (2 scalars)" in text
    for motor, ratio, unit in zip(model.motors, np.diag(model.eta), (" rad/m", ""), strict=True):
        assert row_of(text, motor.name)[2] == f"{ratio:.4g}{unit}"
    masses = texts.description_text(flexgen.describe("four_mass"))
    assert "combination (1 scalars)" in masses
