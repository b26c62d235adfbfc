"""Errors of outputs in metres and radians: a figure for each unit, none where the output has no
such part.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

import flexgen
from flexgen.base.display import format_size
from flexgen.inversion import refinement
from flexgen.inversion.problem.problem_text import problem_of
from flexgen.simulation.simulate import simulate
from flexgen.studies.sweeps import worker
from flexgen.studies.sweeps.table import RESULTS
from flexgen.views.reports.texts import figure_rows

# a carriage that carries a turning table: the output is a distance and an angle
TABLE = """
name = "table"
description = "a carriage with a turning table"
source = "invented"
gravity = [0.0, 0.0, -9.81]
home_rad = [0.0, 0.0]
[[element]]
name = "carriage"
body = { mass = 5.0, com = [0, 0, 0], inertia = [0.01, 0.01, 0.01] }
[[element.dof]]
name = "x"
type = "translation"
axis = [1, 0, 0]
gear = { type = "elastic", side = "arm", spring = { type = "linear", stiffness = 1e6 }, damping = \
200.0 }
[[element]]
name = "table"
body = { mass = 2.0, com = [0, 0, 0], inertia = [0.01, 0.01, 0.02] }
[[element.dof]]
name = "turn"
type = "rotation"
axis = [0, 0, 1]
gear = { type = "elastic", side = "arm", spring = { type = "linear", stiffness = 500.0 }, damping \
= 0.05 }
[[motor]]
name = "mx"
drives = "x"
ratio = 200.0
inertia = 1e-4
[[motor]]
name = "mt"
drives = "turn"
ratio = 50.0
inertia = 1e-5
[output]
type = "joint"
joints = ["x", "turn"]
[[move]]
name = "both"
type = "joint"
start_rad = [0.0, 0.0]
end_rad = [0.2, 1.0]
duration = 0.4
smoothness = 5
"""


@pytest.fixture
def table(tmp_path: Path) -> Path:
    file = tmp_path / "table.toml"
    file.write_text(TABLE)
    return file


def test_an_error_of_the_angle_alone_is_shown_in_radians(
    table: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The torque of the table is wrong: the error in metres is rounding, the one in radians
    decides.
    """
    solution = flexgen.solve(table)
    assert solution.status == flexgen.Status.SOLVED
    trajectory = solution.trajectory
    wrong = trajectory["tau_m"].copy()
    wrong[:, 1] *= 1.003
    run = simulate(
        table, dataclasses.replace(trajectory, channels={**trajectory.channels, "tau_m": wrong})
    )
    assert run.tool_error_max_m is not None and run.tool_error_max_m < 1e-8
    assert run.tool_error_max_rad is not None and run.tool_error_max_rad > 1e-4
    shown = dataclasses.replace(solution, simulation=run, status=flexgen.Status.TOLERANCE_NOT_MET)
    for text in (str(shown), repr(run), problem_of(shown, 1e-5)):
        assert format_size(run.tool_error_max_rad, "rad") in text, text
    units = [
        unit
        for label, value, unit in figure_rows(shown)
        if label == "output error open loop, largest" and value
    ]
    assert units == ["um", "urad"] or units == ["um", "mrad"]

    method = refinement.run_method

    def planted(*arguments):  # type: ignore[no-untyped-def]
        found = method(*arguments)
        tau_m = found.motors.tau_m.copy()
        tau_m[:, 1] *= 1.001
        return dataclasses.replace(found, motors=dataclasses.replace(found.motors, tau_m=tau_m))

    monkeypatch.setattr(refinement, "run_method", planted)
    assert flexgen.solve(table, method="closed-form").status == flexgen.Status.TOLERANCE_NOT_MET


def test_every_column_of_a_sweep_has_one_unit(
    table: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Errors of a plan are a length and an angle, not the larger number of the two."""
    columns = {column.name: column.unit for column in RESULTS}
    assert " or " not in "".join(columns.values())

    def planted(*given: Any, **options: Any) -> flexgen.Solution:
        solution = flexgen.solve(*given, **(options | {"verify": False}))
        return dataclasses.replace(solution, plan_error_max_m=1e-6, plan_error_max_rad=3e-3)

    monkeypatch.setattr(worker, "solve", planted)
    rows = flexgen.sweep(flexgen.Grid([str(table)]), workers=1, progress=False).results
    found = {unit: rows[key][0] for key, unit in columns.items() if key.startswith("plan_")}
    assert found == {"m": 1e-6, "rad": 3e-3}


@pytest.mark.slow
def test_an_output_without_lengths_has_no_figure_in_metres() -> None:
    solution = flexgen.solve("abb_arm")
    assert solution.tool_error_max_m is None and solution.tool_error_max_rad is not None
    assert " um" not in str(solution).splitlines()[1]
