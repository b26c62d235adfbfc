"""Models compared: the torque of simpler models leaves the tool off the path, each by less than
the one before.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest

import flexgen
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.robustness import Plant, compare_plants, output_errors
from flexgen.inversion.comparison.comparison import compare_methods, error_rows, error_sizes
from flexgen.inversion.judge.verification import plan_error
from flexgen.inversion.solution import INTERRUPTED
from flexgen.model.elements import Output
from flexgen.model.reader import read
from flexgen.paths.path import Path
from flexgen.views.reports.html import write_report


@pytest.fixture(scope="module")
def compared():
    equations = derive("planar5_nmp")
    said: list[str] = []
    solutions = compare_methods(equations, flexgen.solve(equations), said.append)
    assert len(said) == 3
    return equations, solutions


@pytest.mark.slow
def test_each_model_is_better_than_the_simpler_one(compared) -> None:
    rows = error_rows(compared[1])
    assert [row["method"] for row in rows] == ["rigid", "fjm", "quasistatic", "lq"]
    largest = [row["largest_m"] for row in rows]
    assert largest[0] > 1e-4 and largest[1] > 1e-5  # m
    assert largest[0] > largest[1] > 10 * largest[2] > 100 * largest[3]


def test_an_arm_without_elastic_coordinates_is_compared_with_the_rigid_model_only() -> None:
    solution = flexgen.solve("elbow")
    said = []
    found = flexgen.compare(solution, progress=said.append)
    assert said == ["comparison: method rigid"]
    assert [one.method for one in found.solutions] == [
        "rigid",
        "closed-form",
    ] and found.robustness is None
    assert found.to_dict() == {"comparison": error_rows(found.solutions)}
    legend = found.plot().axes[0].get_legend()
    assert [text.get_text().partition(":")[0] for text in legend.get_texts()] == [
        "rigid",
        "closed-form",
    ]
    unverified = flexgen.solve("elbow", verify=False)
    assert flexgen.compare(unverified).solutions == ()
    with pytest.raises(flexgen.ArgumentError, match="interrupted"):
        flexgen.compare(replace(solution, stopped=INTERRUPTED))


@pytest.mark.slow
def test_the_report_of_a_comparison_has_its_table(tmp_path) -> None:
    page = flexgen.compare(flexgen.solve("elbow")).report(tmp_path).read_text("utf-8")
    assert "Tool error by method" in page and "Robustness" not in page


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_report_shows_them_together(compared, tmp_path) -> None:
    equations, solutions = compared
    named = {solution.method: solution for solution in solutions}
    rows = compare_plants(equations, named, plants=(Plant("stiffness -5 %", stiffness=0.95),))
    page = write_report(
        equations, solutions[-1], tmp_path, compared=solutions, robustness=rows
    ).read_text("utf-8")
    for text in (
        "Tool error by method",
        "quasistatic",
        "Robustness",
        "stiffness -5 %",
        'id="methods"',
    ):
        assert text in page
    # on another machine, too, the better model stays the better one
    errors = {(row["control"], row["method"]): row["error_max_m"] for row in rows}
    assert errors["feedback", "lq"] < errors["feedback", "rigid"]


def joints_of_both_units():
    """An arm with a slide, whose joints are the output."""
    model = read(FilePath(__file__).parents[1] / "support" / "robots" / "spatial.toml")
    weights = tuple(tuple(float(i == j) for i in range(model.n_a)) for j in model.i_g)
    return replace(model, output=Output("combination", "", weights, "mixed"))


@pytest.mark.parametrize(
    "name", ["joints of both units", "abb_arm", "planar5_nmp", "manutec_r3_18"]
)
def test_errors_are_reported_by_unit(name: str) -> None:
    """Those of the simulation, of the comparison and of the plants are the same."""
    equations = derive(joints_of_both_units() if name.startswith("joints") else name)
    solution = flexgen.solve(
        equations, next(m for m in equations.model.moves if m.type == "joint"), "rigid"
    )
    simulation = solution.simulation
    sizes = error_sizes(solution)
    assert simulation is not None
    known = {"m": simulation.tool_error_max_m, "rad": simulation.tool_error_max_rad}
    assert sizes.keys() == {unit for unit, size in known.items() if size is not None}
    done = simulation.trajectory
    apart = output_errors(equations, Path(equations, solution.move), done.time, done["q_a"])
    for unit, size in sizes.items():
        assert size.max() == known[unit] > 0
        # sine for angle
        assert np.abs(np.linalg.norm(apart[unit], axis=1) - size).max() < 1e-4 * size.max()


@pytest.mark.slow
def test_the_distance_from_a_plan_separates_meters_and_angles() -> None:
    equations = derive("manutec_r3")
    solution = flexgen.solve(equations)
    simulation = solution.simulation
    assert simulation is not None
    assert max(plan_error(equations, solution, simulation)) < 1e-6
    last = np.zeros(equations.model.n_a)
    last[-1] = 2e-3  # rad; the tool is at (0.1, 0.25, 0.1) m, and the last axis is y
    moved = replace(simulation.trajectory, channels={**simulation.trajectory.channels})
    moved.channels["q_a"] = simulation.trajectory["q_a"] + last
    in_m, in_rad = plan_error(equations, solution, replace(simulation, trajectory=moved))
    assert in_rad == pytest.approx(2e-3, rel=1e-3) and in_m == pytest.approx(
        2e-3 * np.hypot(0.1, 0.1), rel=1e-3
    )
